# SPDX-License-Identifier: GPL-3.0-or-later
"""What materials of a scene reflect sharply or let through, so that a frame records no rays that nothing needs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ..kernels import node_codes as codes
from ..kernels import types as kernel_types
from ..kernels.reflection_chain import MIRROR_ROUGHNESS
from .closure_arguments import closures
from .program import Program

__all__ = ["Reflectors", "find_reflectors"]


@dataclass(frozen=True)
class Reflectors:
    """What the sharpest materials of a scene do."""

    sharpest: float = math.inf
    """Least roughness of any reflection; endless where nothing reflects"""
    polished: float = math.inf
    """The same of metal and glossy surfaces, which mostly reflect"""
    refracts: bool = False
    """Whether any is glass"""
    scatters: bool = False
    """Whether any scatters light from behind"""
    glossy: bool = False
    """Whether any shows highlights of lights: reflects, but neither as a mirror alone nor as glass alone"""
    shaped: bool = False
    """Whether any has lobes that the G-buffer doesn't hold: rough diffuse, sheen, toon, stretched reflection"""


def find_reflectors(programs: Iterable[Program]) -> Reflectors:
    """Return what the materials with these programs do; what varies may be anything."""
    sharpest, polished, refracts, scatters, glossy, shaped = math.inf, math.inf, False, False, False, False
    for program in programs:
        for kind, arguments in closures(program):
            sharpest = min([sharpest, *roughnesses(kind, arguments)])
            if is_polished(kind, arguments):
                polished = min(polished, arguments[codes.ARG_ROUGHNESS] or 0.0)
            refracts |= kind in (kernel_types.CLOSURE_GLASS, kernel_types.CLOSURE_REFRACTION) or (
                kind == kernel_types.CLOSURE_PRINCIPLED and arguments[codes.ARG_TRANSMISSION] != 0.0)
            scatters |= is_translucent(kind, arguments)
            glossy |= is_glossy(kind, arguments)
            shaped |= is_shaped(kind, arguments)
    return Reflectors(sharpest, polished, refracts, scatters, glossy, shaped)


def is_polished(kind: int, arguments: list[float | None]) -> bool:
    """Return whether a closure may reflect most light that it gets, if it is smooth."""
    if kind == kernel_types.CLOSURE_PRINCIPLED:
        return arguments[codes.ARG_METALLIC] != 0.0
    return kind == kernel_types.CLOSURE_GLOSSY


def is_shaped(kind: int, arguments: list[float | None]) -> bool:
    """Return whether a closure's direct light is not that of Lambert's lobe and a round one, or may not be."""
    if kind == kernel_types.CLOSURE_PRINCIPLED:
        names = (codes.ARG_DIFFUSE_ROUGHNESS, codes.ARG_SHEEN, codes.ARG_ANISOTROPIC)
        return any(arguments[slot] != 0.0 for slot in names)
    if kind == kernel_types.CLOSURE_DIFFUSE:
        return arguments[codes.ARG_ROUGHNESS] != 0.0
    if kind == kernel_types.CLOSURE_GLOSSY:
        return arguments[codes.ARG_ANISOTROPIC] != 0.0
    return kind in (kernel_types.CLOSURE_SHEEN, kernel_types.CLOSURE_TOON_DIFFUSE, kernel_types.CLOSURE_TOON_GLOSSY)


def is_translucent(kind: int, arguments: list[float | None]) -> bool:
    """Return whether a closure scatters light from behind, or may where it varies."""
    if kind == kernel_types.CLOSURE_PRINCIPLED:
        return arguments[codes.ARG_THIN_WALL] != 0.0 and arguments[codes.ARG_SUBSURFACE] != 0.0
    return kind == kernel_types.CLOSURE_TRANSLUCENT


def is_glossy(kind: int, arguments: list[float | None]) -> bool:
    """Return whether rays that meet a closure may end there and leave a reflecting lobe; over mirrors they go on."""
    if kind == kernel_types.CLOSURE_GLASS or not list(roughnesses(kind, arguments)):
        return False
    roughness, coat = arguments[codes.ARG_ROUGHNESS], 0.0
    whole = kind == kernel_types.CLOSURE_GLOSSY
    if kind == kernel_types.CLOSURE_PRINCIPLED:
        coat = arguments[codes.ARG_COAT]
        whole = 1.0 in (arguments[codes.ARG_METALLIC], arguments[codes.ARG_TRANSMISSION])
    return coat != 0.0 or not whole or roughness is None or roughness >= MIRROR_ROUGHNESS


def roughnesses(kind: int, arguments: list[float | None]) -> Iterator[float]:
    """Yield the least roughness of each reflecting lobe of a closure, whose arguments are None where they vary."""
    roughness = arguments[codes.ARG_ROUGHNESS] or 0.0
    if kind in (kernel_types.CLOSURE_GLOSSY, kernel_types.CLOSURE_GLASS):
        yield roughness
    if kind == kernel_types.CLOSURE_PRINCIPLED:
        level, ior, metallic = (
            arguments[slot] for slot in (codes.ARG_SPECULAR_LEVEL, codes.ARG_IOR, codes.ARG_METALLIC))
        if metallic != 0.0 or (level != 0.0 and ior != 1.0) or arguments[codes.ARG_TRANSMISSION] != 0.0:
            yield roughness
        if arguments[codes.ARG_COAT] != 0.0:
            yield arguments[codes.ARG_COAT_ROUGHNESS] or 0.0
