# SPDX-License-Identifier: GPL-3.0-or-later
"""Constant folding for engine/program.py: calls the kernels' own functions, so that both always agree."""

from __future__ import annotations

import functools

import warp as wp

from ..kernels import node_codes as codes
from ..kernels.node_color import adjust_color, mix_color
from ..kernels.node_math import math as node_math
from ..kernels.node_vector import vector_math

__all__ = ["fold"]

Vec4 = tuple[float, float, float, float]


@functools.lru_cache(maxsize=4096)
def fold(op: int, sub: int, operands: tuple[Vec4, ...]) -> Vec4 | None:
    """Return an operation's constant result by calling the kernel's own function, None where that can't be done.

    Known ones are kept: Warp takes 0.2 ms to find a function for a call from Python, and materials repeat each other.
    """
    vectors = [wp.vec3(*operand[:3]) for operand in operands]
    try:
        if op == codes.OP_MATH:
            x = node_math(sub, operands[0][0], operands[1][0], operands[2][0])
            return x, x, x, 0.0
        if op == codes.OP_VECTOR:
            return tuple(vector_math(sub, *(wp.vec4(*operand) for operand in operands)))
        if op == codes.OP_MIX:
            return (*mix_color(sub, operands[0][0], vectors[1], vectors[2]), 0.0)
        if op == codes.OP_COLOR and sub != codes.COLOR_LUMINANCE:
            return (*adjust_color(sub, *vectors, wp.vec3(0.0)), 0.0)
    except (RuntimeError, ArithmeticError, ValueError):
        # Some of Warp's functions exist in kernels only; the operation then stays in the program.
        return None
    return None
