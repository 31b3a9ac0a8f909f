# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures drawn at a multiple of their size, and averaged: each pixel is the mean of its block."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def block_pixel(pixel: int, width: int, factor: int, k: int) -> int:
    """Return the k-th pixel of a pixel's block in the larger picture; `width` is that of the smaller one [px]."""
    x = pixel % width * factor + k % factor
    y = pixel // width * factor + k // factor
    return y * width * factor + x


@wp.kernel
def average_colors(
    first: int,
    # In:
    picture: wp.array[wp.vec4],
    width: int,
    factor: int,
    # Out:
    averaged_out: wp.array[wp.vec4],
):
    """Average blocks of factor x factor premultiplied colours, in linear light."""
    pixel = first + wp.tid()
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(factor * factor):
        total += picture[block_pixel(pixel, width, factor, k)]
    averaged_out[pixel] = total / float(factor * factor)


@wp.kernel
def average_light(
    first: int,
    # In:
    light: wp.array[wp.vec3],
    width: int,
    factor: int,
    # Out:
    averaged_out: wp.array[wp.vec3],
):
    """Average blocks of factor x factor values of light."""
    pixel = first + wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(factor * factor):
        total += light[block_pixel(pixel, width, factor, k)]
    averaged_out[pixel] = total / float(factor * factor)
