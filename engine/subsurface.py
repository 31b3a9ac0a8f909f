# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials scatter light below the surface, so that other scenes record no walks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..kernels import node_codes as codes
from ..kernels.types import MATERIAL_SUBSURFACE, MATERIAL_SUBSURFACE_BUMP
from .program import Program

__all__ = ["SubsurfaceUse", "subsurface_flags", "subsurface_use"]


@dataclass(frozen=True)
class SubsurfaceUse:
    """What the materials in use do below the surface."""

    scatters: bool = False
    bumped: bool = False
    """Whether any that does bends normals"""


def subsurface_use(flags: Iterable[int]) -> SubsurfaceUse:
    """Return what materials with these flags do."""
    flags, bits = tuple(flags), (MATERIAL_SUBSURFACE, MATERIAL_SUBSURFACE_BUMP)
    return SubsurfaceUse(*(any(each & bit for each in flags) for bit in bits))


def subsurface_flags(program: Program) -> int:
    """Return the MATERIAL_SUBSURFACE* bits of a material."""
    flags = 0
    for at, (head, *_) in enumerate(program.surface):
        if head & 255 != codes.OP_CLOSURE or not head >> 16 & codes.CLOSURE_SUBSURFACE:
            continue

        def constant(slot: int, at: int = at) -> tuple[float, ...] | None:
            """Return an argument, None where it varies."""
            operand = program.surface[at + 1 + slot // 3][1 + slot % 3]
            return None if operand >= 0 else program.constants[-1 - operand][:3]

        if any(constant(codes.ARG_THIN_WALL) or ()):
            # Nothing is below.
            continue
        flags |= MATERIAL_SUBSURFACE
        normal = constant(codes.ARG_NORMAL)
        flags |= MATERIAL_SUBSURFACE_BUMP if normal is None or any(normal) else 0
    return int(flags)
