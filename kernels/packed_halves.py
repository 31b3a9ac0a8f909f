# SPDX-License-Identifier: GPL-3.0-or-later
"""Four half-floats as one word of 64 bits: a vec4h is loaded and stored in four steps, its word in one.

The bits are those of a vec4h, so that either can be a view of the other's array (`array.view(wp.uint64)`).
"""

from __future__ import annotations

import warp as wp

from .packing import HALF_MAX


@wp.func
def half_bits(x: float) -> wp.uint32:
    """Return the bits of a number rounded to a half-float; too large ones are clamped, not made infinite."""
    return wp.uint32(wp.cast(wp.float16(wp.clamp(x, -HALF_MAX, HALF_MAX)), wp.uint16))


@wp.func
def pack_halves(v: wp.vec4) -> wp.uint64:
    """Round to half-floats, the first in the lowest bits."""
    low = half_bits(v[0]) | (half_bits(v[1]) << wp.uint32(16))
    high = half_bits(v[2]) | (half_bits(v[3]) << wp.uint32(16))
    return wp.uint64(low) | (wp.uint64(high) << wp.uint64(32))


@wp.func
def low_half(pair: wp.uint32) -> float:
    """Return the half-float in the lower bits."""
    return float(wp.cast(wp.uint16(pair & wp.uint32(65535)), wp.float16))


@wp.func
def high_half(pair: wp.uint32) -> float:
    """Return the half-float in the upper bits."""
    return float(wp.cast(wp.uint16(pair >> wp.uint32(16)), wp.float16))


@wp.func
def unpack_first(packed: wp.uint64) -> float:
    """Return the first of the four numbers of pack_halves."""
    return low_half(wp.uint32(packed & wp.uint64(0xFFFFFFFF)))


@wp.func
def unpack_halves(packed: wp.uint64) -> wp.vec4:
    """Return the four numbers of pack_halves."""
    low = wp.uint32(packed & wp.uint64(0xFFFFFFFF))
    high = wp.uint32(packed >> wp.uint64(32))
    return wp.vec4(low_half(low), high_half(low), low_half(high), high_half(high))
