# SPDX-License-Identifier: GPL-3.0-or-later
"""A resolved picture in the formats that a viewport uploads: 4 bytes a pixel, or half floats.

The 4-byte format is RGB9E5 with exponent codes that never make the float's exponent all zeros or all ones; the same
as addon/picture.py packs with NumPy (a test compares them bit by bit) and as the viewport's shader unpacks.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

EXPONENT_MIN = wp.constant(-10)
EXPONENT_LAST = wp.constant(27)
"""Largest exponent code: 28 codes from 2**-10 on."""
COLOR_MAX = wp.constant(131071.0)
HALF_MAX = wp.constant(65504.0)
"""Largest finite half float."""


@wp.func
def displayable(value: float, largest: float) -> float:
    """Return `value` within 0..largest; NaN becomes 0, since a comparison with it is false."""
    result = float(0.0)
    if value > 0.0:
        result = wp.min(value, largest)
    return result


@wp.func
def exponent_code(largest: float) -> int:
    """Return the code of the smallest power of two above `largest`, by its bits: log2 rounds at powers of two."""
    biased = int(wp.cast(largest, wp.uint32) >> wp.uint32(23)) & 255
    return wp.clamp(biased - 126 - EXPONENT_MIN, 0, EXPONENT_LAST)


@wp.func
def pack_color(color: wp.vec4) -> wp.uint32:
    """Return a colour's 32 bits."""
    r = displayable(color[0], COLOR_MAX)
    g = displayable(color[1], COLOR_MAX)
    b = displayable(color[2], COLOR_MAX)
    code = exponent_code(wp.max(r, wp.max(g, b)))
    # 2**(9 - exponent), made of its bits so that it is exact.
    scale = wp.cast(wp.uint32(127 + 9 - EXPONENT_MIN - code) << wp.uint32(23), wp.float32)
    stored = code + wp.where(code < 14, 1, 3)
    mr = wp.uint32(wp.min(r * scale + 0.5, 511.0))
    mg = wp.uint32(wp.min(g * scale + 0.5, 511.0))
    mb = wp.uint32(wp.min(b * scale + 0.5, 511.0))
    return (wp.uint32(stored) << wp.uint32(27)) | (mb << wp.uint32(18)) | (mg << wp.uint32(9)) | mr


@wp.kernel
def pack_picture(
    # In:
    picture: wp.array[wp.vec4],
    # Out:
    packed_out: wp.array[wp.uint32],
):
    """Pack opaque colours into 4 bytes a pixel."""
    pixel = wp.tid()
    packed_out[pixel] = pack_color(picture[pixel])


@wp.kernel
def halve_picture(
    # In:
    picture: wp.array[wp.vec4],
    # Out:
    halves_out: wp.array[wp.vec4h],
):
    """Turn premultiplied colours into finite half floats."""
    pixel = wp.tid()
    c = picture[pixel]
    halves_out[pixel] = wp.vec4h(
        wp.float16(displayable(c[0], HALF_MAX)), wp.float16(displayable(c[1], HALF_MAX)),
        wp.float16(displayable(c[2], HALF_MAX)), wp.float16(displayable(c[3], 1.0)))
