# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of bytes: their fourth channel, and their mip levels, averaged in 16 bits of linear light.

For the processor, which reads the images: many are made ready at the same time, in threads (engine/mip_levels.py). Both
sides of what is halved are even. In whole numbers, so that the results are those of NumPy in engine/texels.py.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

LINEAR_BYTE = wp.constant(257)
"""Linear 16 bits of each step of a byte"""


@wp.func
def mean_of_four(a: int, b: int, c: int, d: int) -> int:
    """Return the rounded mean."""
    return (a + b + c + d + 2) >> 2


@wp.func
def narrow(value: int) -> wp.uint8:
    """Round linear 16 bits to a byte."""
    return wp.uint8((value + LINEAR_BYTE / 2) / LINEAR_BYTE)


@wp.func
def encode_texel(mean: wp.vec4i, srgb: int, encode: wp.array[wp.uint8]) -> wp.vec4ub:
    """Return linear 16 bits as the bytes of a texel."""
    if srgb == 1:
        return wp.vec4ub(encode[mean[0]], encode[mean[1]], encode[mean[2]], narrow(mean[3]))
    return wp.vec4ub(narrow(mean[0]), narrow(mean[1]), narrow(mean[2]), narrow(mean[3]))


@wp.func
def decode_texel(texel: wp.vec4ub, srgb: int, decode: wp.array[wp.uint16]) -> wp.vec4i:
    """Return the bytes of a texel as linear 16 bits."""
    alpha = int(texel[3]) * LINEAR_BYTE
    if srgb == 1:
        return wp.vec4i(int(decode[int(texel[0])]), int(decode[int(texel[1])]), int(decode[int(texel[2])]), alpha)
    return wp.vec4i(int(texel[0]) * LINEAR_BYTE, int(texel[1]) * LINEAR_BYTE, int(texel[2]) * LINEAR_BYTE, alpha)


@wp.func
def mean_texel(a: wp.vec4i, b: wp.vec4i, c: wp.vec4i, d: wp.vec4i) -> wp.vec4i:
    """Return the rounded mean of four texels."""
    return wp.vec4i(
        mean_of_four(a[0], b[0], c[0], d[0]), mean_of_four(a[1], b[1], c[1], d[1]),
        mean_of_four(a[2], b[2], c[2], d[2]), mean_of_four(a[3], b[3], c[3], d[3]))


@wp.kernel
def widen_bytes(
    # In:
    pixels: wp.array[wp.vec3ub],
    # Out:
    texels_out: wp.array[wp.vec4ub],
):
    """Give pixels of three channels an alpha of 1."""
    i = wp.tid()
    pixel = pixels[i]
    texels_out[i] = wp.vec4ub(pixel[0], pixel[1], pixel[2], wp.uint8(255))


@wp.func
def wide_texel(texel: wp.vec4us) -> wp.vec4i:
    """Return linear 16 bits as whole numbers."""
    return wp.vec4i(int(texel[0]), int(texel[1]), int(texel[2]), int(texel[3]))


@wp.kernel
def build_levels(
    # In:
    width: int,
    height: int,
    levels: int,
    srgb: int,
    decode: wp.array[wp.uint16],
    encode: wp.array[wp.uint8],
    texels: wp.array[wp.vec4ub],
    # Out:
    linear_out: wp.array[wp.vec4us],
    texels_out: wp.array[wp.vec4ub],
):
    """Write the levels from 1 on, one after another, in linear 16 bits and as bytes as level 0 has them; one thread.

    In detail:
        width: Of level 0; both its sides are even, and those of all levels but the last.
        levels: How many there are.
    """
    across = width
    down = height
    above = int(0)
    start = int(0)
    for level in range(levels):
        half = across / 2
        rows = down / 2
        for y in range(rows):
            for x in range(half):
                first = above + 2 * y * across + 2 * x
                mean = wp.vec4i(0, 0, 0, 0)
                if level == 0:
                    mean = mean_texel(
                        decode_texel(texels[first], srgb, decode), decode_texel(texels[first + 1], srgb, decode),
                        decode_texel(texels[first + across], srgb, decode),
                        decode_texel(texels[first + across + 1], srgb, decode))
                else:
                    mean = mean_texel(
                        wide_texel(linear_out[first]), wide_texel(linear_out[first + 1]),
                        wide_texel(linear_out[first + across]), wide_texel(linear_out[first + across + 1]))
                place = start + y * half + x
                linear_out[place] = wp.vec4us(
                    wp.uint16(mean[0]), wp.uint16(mean[1]), wp.uint16(mean[2]), wp.uint16(mean[3]))
                texels_out[place] = encode_texel(mean, srgb, encode)
        above = start
        start = start + rows * half
        across = half
        down = rows
