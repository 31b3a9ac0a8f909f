# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of a closure's arguments, and how a closure instruction is written and read: slots, flags, constants."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..kernels import node_codes as codes
from ..kernels import types as kernel_types

if TYPE_CHECKING:
    from .program import Program

__all__ = ["ARGUMENTS", "HAIR_ARGUMENTS", "closure_code", "closure_constants", "closures", "is_hair_alone",
           "slot_count"]

ARGUMENTS = {
    "weight": codes.ARG_WEIGHT, "color": codes.ARG_COLOR, "normal": codes.ARG_NORMAL,
    "roughness": codes.ARG_ROUGHNESS, "ior": codes.ARG_IOR, "tangent": codes.ARG_TANGENT,
    "anisotropic": codes.ARG_ANISOTROPIC, "anisotropic_rotation": codes.ARG_ANISOTROPIC_ROTATION,
    "diffuse_roughness": codes.ARG_DIFFUSE_ROUGHNESS, "metallic": codes.ARG_METALLIC,
    "specular_level": codes.ARG_SPECULAR_LEVEL, "specular_tint": codes.ARG_SPECULAR_TINT,
    "transmission": codes.ARG_TRANSMISSION, "subsurface": codes.ARG_SUBSURFACE, "coat": codes.ARG_COAT,
    "coat_roughness": codes.ARG_COAT_ROUGHNESS, "coat_ior": codes.ARG_COAT_IOR, "coat_tint": codes.ARG_COAT_TINT,
    "coat_normal": codes.ARG_COAT_NORMAL, "sheen": codes.ARG_SHEEN, "sheen_roughness": codes.ARG_SHEEN_ROUGHNESS,
    "sheen_tint": codes.ARG_SHEEN_TINT, "emission": codes.ARG_EMISSION, "thin_wall": codes.ARG_THIN_WALL,
    "subsurface_radius": codes.ARG_SUBSURFACE_RADIUS, "subsurface_ior": codes.ARG_SUBSURFACE_IOR,
    "subsurface_anisotropy": codes.ARG_SUBSURFACE_ANISOTROPY, "film_thickness": codes.ARG_FILM_THICKNESS,
    "film_ior": codes.ARG_FILM_IOR,
}
"""Names of a closure's arguments and their slots"""

HAIR_ARGUMENTS = {
    "strand": codes.ARG_NORMAL, "absorption": codes.ARG_TANGENT, "radial_roughness": codes.ARG_ANISOTROPIC,
    "tilt": codes.ARG_ANISOTROPIC_ROTATION, "primary_roughness": codes.ARG_FILM_THICKNESS,
}
"""Of the kind HAIR beside weight, roughness and ior: the strand's direction in the world, absorption over its radius,
roughness around it, the scales' lean [rad], and R's roughness by that of the others. Its color is factors on R, TT and
TRT (kernels/hair_lobes.py)"""

SIMPLE_SLOTS = 9
"""Slots that BSDFs other than the Principled one pass"""


def slot_count(kind: str, subsurface_method: str, *, film: bool) -> int:
    """Return how many slots a closure passes: its kind of kernels.types.CLOSURE_*, others as of closure_code."""
    if film:
        return int(codes.FILM_ARGUMENT_COUNT)
    if subsurface_method:
        return int(codes.SUBSURFACE_ARGUMENT_COUNT)
    return int(codes.ARGUMENT_COUNT) if kind == "PRINCIPLED" else SIMPLE_SLOTS


def closure_code(kind: str, multiscatter: bool, subsurface_method: str, *, film: bool) -> int:
    """Return a closure instruction's sub-operation; method: one of codes.SUBSURFACE_*, empty for none."""
    method = getattr(codes, "SUBSURFACE_" + subsurface_method) if subsurface_method else 0
    flags = (codes.CLOSURE_MULTISCATTER if multiscatter else 0) | (codes.CLOSURE_FILM if film else 0)
    return getattr(kernel_types, "CLOSURE_" + kind) | flags | method << codes.CLOSURE_SUBSURFACE_SHIFT


def closure_constants(program: Program) -> Iterator[tuple[int, list[tuple[float, ...] | None]]]:
    """Yield each closure's kind (kernels.types.CLOSURE_*) and arguments by slot: four numbers, None where they vary."""
    code = program.surface
    for position, (head, _, words, _) in enumerate(code):
        if head & 255 != codes.OP_CLOSURE:
            continue
        operands = [operand for line in code[position + 1:position + 1 + words] for operand in line[1:]]
        arguments = [program.constants[-1 - operand] if operand < 0 else None for operand in operands]
        yield head >> 16 & 255, arguments + [(0.0,) * 4] * (codes.ARGUMENT_COUNT - len(arguments))


def closures(program: Program) -> Iterator[tuple[int, list[float | None]]]:
    """Yield the same with the first number of each argument."""
    for kind, arguments in closure_constants(program):
        yield kind, [None if each is None else each[0] for each in arguments]


def is_hair_alone(program: Program) -> bool:
    """Return whether all closures of a program are hair's."""
    return all(kind == kernel_types.CLOSURE_HAIR for kind, _ in closures(program))
