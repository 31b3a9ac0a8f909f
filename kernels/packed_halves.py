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
def pack_pair(first: float, second: float) -> wp.uint32:
    """Round two numbers to half-floats, the first in the lower bits."""
    return half_bits(first) | (half_bits(second) << wp.uint32(16))


@wp.func
def pack_halves(v: wp.vec4) -> wp.uint64:
    """Round to half-floats, the first in the lowest bits."""
    low = half_bits(v[0]) | (half_bits(v[1]) << wp.uint32(16))
    high = half_bits(v[2]) | (half_bits(v[3]) << wp.uint32(16))
    return wp.uint64(low) | (wp.uint64(high) << wp.uint64(32))


# A GPU converts either half of a register as it lies there; told by shifts and casts, it shifts first.
@wp.func_native("""
#ifdef __CUDA_ARCH__
    float a, b;
    asm("{ .reg .b16 low, high; mov.b32 {low, high}, %2; cvt.f32.f16 %0, low; cvt.f32.f16 %1, high; }"
        : "=f"(a), "=f"(b) : "r"(pair));
    return wp::vec_t<2, float>(a, b);
#else
    wp::half low, high;
    low.u = (unsigned short)(pair & 65535u);
    high.u = (unsigned short)(pair >> 16);
    return wp::vec_t<2, float>(wp::half_to_float(low), wp::half_to_float(high));
#endif
""")
def unpack_pair(pair: wp.uint32) -> wp.vec2:
    """Return two half-floats, that in the lower bits first."""
    ...


@wp.func
def unpack_pairs(low: wp.uint32, high: wp.uint32) -> wp.vec4:
    """Return the four numbers of pack_halves, of its lower and its upper bits."""
    a = unpack_pair(low)
    b = unpack_pair(high)
    return wp.vec4(a[0], a[1], b[0], b[1])


@wp.func
def unpack_first(packed: wp.uint64) -> float:
    """Return the first of the four numbers of pack_halves."""
    return unpack_pair(wp.uint32(packed & wp.uint64(0xFFFFFFFF)))[0]


@wp.func
def unpack_halves(packed: wp.uint64) -> wp.vec4:
    """Return the four numbers of pack_halves."""
    return unpack_pairs(wp.uint32(packed & wp.uint64(0xFFFFFFFF)), wp.uint32(packed >> wp.uint64(32)))
