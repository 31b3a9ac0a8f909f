# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials are clear glass, behind which light goes on in real-time frames (kernels/clear_glass.py).

A single closure of glass that lets all light through but what it reflects, with one colour. What varies, is rough, is
mixed with something else or filled with a volume stops light as before. Where a program makes it transparent (a Light
Path trick) rays ask that program.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import node_codes as codes
from ..kernels import types as kernel_types
from ..kernels.types import Scene
from .history import copy_struct
from .program import Program
from .scene import MaterialData
from .settings import DirectLightSettings

__all__ = ["clear_glass", "light_scene", "passes_glass", "path_scene"]

ROUGHNESS_MAX = 0.3
"""Glass that is rougher spreads light instead"""

TRANSMISSION_MIN = 0.95
"""Least share of a Principled BSDF's base that is glass"""


def clear_glass(data: MaterialData) -> tuple[float, float, float, float]:
    """Return the tint of light that passes a surface of a material, and its index.

    The index is 0 where it isn't clear glass, and negative where paths don't share light behind it
    (kernels/clear_paths.py): it is not smooth, or reflects otherwise than by Fresnel's equations alone.
    """
    none = (0.0, 0.0, 0.0, 0.0)
    code = data.program.surface
    sinks = [at for at, (head, *_) in enumerate(code) if head & 255 in (codes.OP_CLOSURE, codes.OP_HOLDOUT)]
    more = data.has_transparency or data.has_emission or data.medium is not None
    if more or len(sinks) != 1 or code[sinks[0]][0] & 255 != codes.OP_CLOSURE:
        return none
    read = _Arguments(data.program, sinks[0])
    if read.number(codes.ARG_WEIGHT, 0.0) != 1.0 or read.number(codes.ARG_ROUGHNESS, 0.0) > ROUGHNESS_MAX:
        return none
    color = read.color(codes.ARG_COLOR)
    if color is None:
        return none
    kind, ior = code[sinks[0]][0] >> 16 & 255, read.number(codes.ARG_IOR, 1.5)
    smooth = read.constant(codes.ARG_NORMAL) is not None and read.number(codes.ARG_ROUGHNESS, 1.0) == 0.0
    ior = max(ior, 1.0e-3) * (1.0 if smooth else -1.0)
    if kind == kernel_types.CLOSURE_PRINCIPLED:
        share = read.number(codes.ARG_TRANSMISSION, 0.0) * (1.0 - read.number(codes.ARG_METALLIC, 1.0))
        if share < TRANSMISSION_MIN or read.number(codes.ARG_COAT, 1.0) > 0.0:
            return none
        if read.number(codes.ARG_THIN_WALL, 0.0) != 0.0:
            # One surface, which bends nothing; with what two reflect of light from straight ahead.
            reflected = ((abs(ior) - 1.0) / (abs(ior) + 1.0)) ** 2
            return *(share * c * (1.0 - reflected) / (1.0 + reflected) for c in color), -1.0
        # A slab, with its two surfaces, has the colour.
        plain = share == 1.0 and read.constant(codes.ARG_SPECULAR_TINT)[:3] == (1.0, 1.0, 1.0)
        return *(share * c**0.5 for c in color), ior if plain else -abs(ior)
    if kind == kernel_types.CLOSURE_GLASS:
        return *color, ior
    if kind == kernel_types.CLOSURE_REFRACTION:
        # Reflects nothing.
        return *color, -1.0
    return none


class _Arguments:
    """What a closure is given, where it is the same everywhere."""

    def __init__(self, program: Program, at: int):
        self.program = program
        self.operands = [word for line in program.surface[at + 1 : at + 1 + program.surface[at][2]]
                         for word in line[1:]]

    def constant(self, slot: int) -> tuple[float, ...] | None:
        """Return an argument, None where it varies."""
        if slot >= len(self.operands):
            return (0.0, 0.0, 0.0, 0.0)
        operand = self.operands[slot]
        return self.program.constants[-1 - operand] if operand < 0 else None

    def number(self, slot: int, varying: float) -> float:
        """Return a number, or `varying` where it varies."""
        constant = self.constant(slot)
        return varying if constant is None else float(constant[0])

    def color(self, slot: int) -> tuple[float, ...] | None:
        """Return a colour from 0 to 1, None where it varies."""
        constant = self.constant(slot)
        return None if constant is None else tuple(float(np.clip(c, 0.0, 1.0)) for c in constant[:3])


def passes_glass(scene: Scene) -> bool:
    """Return whether a scene has clear glass."""
    return scene.materials.clear.shape[0] > 0


def light_scene(scene: Scene, settings: DirectLightSettings) -> Scene:
    """Return the scene as rays of real-time frames meet it: without clear glass where settings leave it out."""
    if settings.clear_glass or not passes_glass(scene):
        return scene
    return without_clear_glass(scene)


def path_scene(scene: Scene, *, plain: bool) -> Scene:
    """Return the scene as the path tracer meets it: with light samples through panes.

    Not where paths keep more than their light (`plain` False: media, passes of light, shadow catchers), nor where
    lights are linked.
    """
    if not passes_glass(scene) or (plain and scene.lights.linked == 0):
        return scene
    return without_clear_glass(scene)


def without_clear_glass(scene: Scene) -> Scene:
    """Return a scene without any clear glass."""
    changed, materials = copy_struct(scene), copy_struct(scene.materials)
    materials.clear = wp.empty(0, dtype=wp.vec4, device=scene.materials.clear.device)
    # Structs hold copies of those in them.
    changed.materials = materials
    return changed
