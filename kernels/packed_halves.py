# SPDX-License-Identifier: GPL-3.0-or-later
"""Four half-floats as one word of 64 bits: a vec4h is loaded and stored in four steps, its word in one.

The bits are those of a vec4h, so that either can be a view of the other's array (`array.view(wp.uint64)`).
"""

from __future__ import annotations

import warp as wp

from .packing import HALF_MAX


# On a GPU each pair is put together as a register: told by shifts, the assembler (ptxas) of CUDA 13.4 and 13.5 was seen
# to write the upper word of two pairs over the lower one.
@wp.func_native("""
#ifdef __CUDA_ARCH__
    wp::uint32 pair;
    asm("{ .reg .b16 low, high; cvt.rn.f16.f32 low, %1; cvt.rn.f16.f32 high, %2; mov.b32 %0, {low, high}; }"
        : "=r"(pair) : "f"(first), "f"(second));
    return pair;
#else
    return wp::uint32(wp::float_to_half(first).u) | (wp::uint32(wp::float_to_half(second).u) << 16);
#endif
""")
def round_pair(first: float, second: float) -> wp.uint32:
    """Round two numbers of at most HALF_MAX to half-floats, the first in the lower bits."""
    ...


@wp.func_native("""
#ifdef __CUDA_ARCH__
    wp::uint64 word;
    asm("mov.b64 %0, {%1, %2};" : "=l"(word) : "r"(low), "r"(high));
    return word;
#else
    return wp::uint64(low) | (wp::uint64(high) << 32);
#endif
""")
def join_words(low: wp.uint32, high: wp.uint32) -> wp.uint64:
    """Return one word of two."""
    ...


@wp.func
def within_halves(x: float) -> float:
    """Clamp what is too large for a half-float, so that it doesn't become infinite."""
    return wp.clamp(x, -HALF_MAX, HALF_MAX)


@wp.func
def pack_pair(first: float, second: float) -> wp.uint32:
    """Round two numbers to half-floats, the first in the lower bits; too large ones are clamped, not made infinite."""
    return round_pair(within_halves(first), within_halves(second))


@wp.func
def pack_halves(v: wp.vec4) -> wp.uint64:
    """Round to half-floats, the first in the lowest bits; too large ones are clamped, not made infinite."""
    return join_words(pack_pair(v[0], v[1]), pack_pair(v[2], v[3]))


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
