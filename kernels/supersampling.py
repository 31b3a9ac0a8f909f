# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures drawn at a multiple of their size, and averaged: each pixel is the mean of its block."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def first_of_block(pixel: int, width: int, factor: int) -> int:
    """Return where the block of a pixel begins in the larger picture; `width` is that of the smaller one [px]."""
    return (pixel // width * factor * width + pixel % width) * factor


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
    start = first_of_block(pixel, width, factor)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(factor * factor):
        total += picture[start + k // factor * factor * width + k % factor]
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
    start = first_of_block(pixel, width, factor)
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(factor * factor):
        total += light[start + k // factor * factor * width + k % factor]
    averaged_out[pixel] = total / float(factor * factor)
