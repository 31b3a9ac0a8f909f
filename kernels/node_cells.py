# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of a lattice in one to four dimensions, for the node machine's patterns: neighborhoods and random numbers.

The cells around one are told apart by keys: three bits for each dimension, which count from 0 what is -reach to reach;
a key takes one register where an offset takes four. Random numbers are those of Cycles 5.2, by the PCG hashes of
Jarzynski and Olano, "Hash Functions for GPU Rendering" (2020).
"""

from __future__ import annotations

import warp as wp

__all__ = ["as_floats", "cell_offset", "cell_random", "floor4", "next_key", "used"]


@wp.func
def used(dimensions: int, v: wp.vec4) -> wp.vec4:
    """Return v with 0 in the components beyond the dimensions."""
    return wp.vec4(
        v[0], wp.where(dimensions > 1, v[1], 0.0), wp.where(dimensions > 2, v[2], 0.0),
        wp.where(dimensions > 3, v[3], 0.0))


@wp.func
def floor4(v: wp.vec4) -> wp.vec4:
    """Return the floor of each component."""
    return wp.vec4(wp.floor(v[0]), wp.floor(v[1]), wp.floor(v[2]), wp.floor(v[3]))


@wp.func
def as_floats(v: wp.vec4i) -> wp.vec4:
    """Return whole numbers as floats."""
    return wp.vec4(float(v[0]), float(v[1]), float(v[2]), float(v[3]))


@wp.func
def scramble(x: int) -> wp.uint32:
    """Return one step of a linear congruential generator (Numerical Recipes)."""
    return wp.uint32(x) * wp.uint32(1664525) + wp.uint32(1013904223)


@wp.func
def fold_bits(x: wp.uint32) -> wp.uint32:
    """Return x with its upper half folded into the lower one; the shift keeps the sign, as in Cycles."""
    return x ^ wp.uint32(int(x) >> 16)


@wp.func
def unit_interval(x: wp.uint32) -> float:
    """Return the lower 31 bits as 0..1."""
    return float(x & wp.uint32(0x7FFFFFFF)) * (1.0 / 2147483648.0)


@wp.func
def cell_random(dimensions: int, cell: wp.vec4i) -> wp.vec4:
    """Return as many numbers in 0..1 as a cell has dimensions, two to four (PCG of Jarzynski and Olano); the rest 0.

    The variants for fewer dimensions differ by what takes the place of the coordinates they lack.
    """
    x = scramble(cell[0])
    y = scramble(cell[1])
    z = scramble(cell[2])
    w = scramble(cell[3])
    for step in range(2):
        if step == 1:
            x = fold_bits(x)
            y = fold_bits(y)
            z = fold_bits(z)
            w = fold_bits(w)
        if dimensions == 2:
            z = wp.uint32(1664525)
        if dimensions < 4:
            w = z
        x += y * w
        y += z * x
        if dimensions > 2:
            z += x * y
        if dimensions > 3:
            w += y * z
    return used(dimensions, wp.vec4(unit_interval(x), unit_interval(y), unit_interval(z), unit_interval(w)))


@wp.func
def cell_offset(dimensions: int, key: int, reach: int) -> wp.vec4i:
    """Return the offset of the cell that a key stands for, each component within +-reach."""
    return wp.vec4i(
        (key & 7) - reach, wp.where(dimensions > 1, ((key >> 3) & 7) - reach, 0),
        wp.where(dimensions > 2, ((key >> 6) & 7) - reach, 0), wp.where(dimensions > 3, (key >> 9) - reach, 0))


@wp.func
def next_key(key: int, reach: int) -> int:
    """Return the key after `key`, the first dimension first; after the last one comes 1 << 3 * dimensions."""
    side = 2 * reach + 1
    next = key + 1
    if (next & 7) == side:
        next += 8 - side
        if ((next >> 3) & 7) == side:
            next += (8 - side) << 3
            if ((next >> 6) & 7) == side:
                next += (8 - side) << 6
                if (next >> 9) == side:
                    next += (8 - side) << 9
    return next
