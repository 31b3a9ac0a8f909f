# SPDX-License-Identifier: GPL-3.0-or-later
"""Debug views of the reflections' denoiser."""

from __future__ import annotations

import warp as wp

from .debug_colors import heat
from .denoise_debug import length_color
from .long_mean import unpack_mean
from .packed_halves import unpack_first, unpack_halves
from .packing import rgb, rgba
from .reflection_blocks import (
    MARK_MISSING,
    MARK_SPARK,
    ReflectionBlocks,
    ReflectionHistory,
    ReflectionLight,
    block_depth,
    light_strength,
)
from .reflection_types import NO_SAMPLE, ReflectionOptions, ReflectionSamples, block_of
from .view import SKY_DEPTH, View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def show_filtered_reflections(
    first: int,
    # In:
    views: wp.array[View],
    options: ReflectionOptions,
    samples: ReflectionSamples,
    lights: ReflectionLight,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show what the filter makes of this frame's samples, without colours and exposure; banded over pixels."""
    pixel = first + wp.tid()
    light = wp.vec3(0.0, 0.0, 0.0)
    if samples.place[block_of(options, pixel)] != NO_SAMPLE:
        light = rgb(unpack_halves(lights.light[pixel]))
    picture_out[pixel] = rgba(light / wp.max(views[0].exposure, 1.0e-30), 1.0)


@wp.kernel
def show_reflection_history(
    first: int,
    # In:
    history: ReflectionHistory,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show how many samples are in the mean of reflections; banded over pixels."""
    pixel = first + wp.tid()
    picture_out[pixel] = length_color(wp.abs(unpack_first(history.state[pixel])))


@wp.kernel
def show_reflection_variance(
    first: int,
    # In:
    history: ReflectionHistory,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show the relative error that is left in the mean of reflections, white from 100 % on; banded over pixels."""
    pixel = first + wp.tid()
    state = unpack_halves(history.state[pixel])
    error = state[2] / wp.sqrt(wp.max(wp.abs(state[0]), 1.0))
    strength = light_strength(unpack_mean(history.light[pixel]))
    picture_out[pixel] = rgba(heat(error / wp.max(strength, 1.0e-6)), 1.0)


@wp.kernel
def show_marked_samples(
    first: int,
    # In:
    options: ReflectionOptions,
    blocks: ReflectionBlocks,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show what clean-up replaces: sparks red, missing samples blue, other samples grey; banded over pixels."""
    pixel = first + wp.tid()
    block = block_of(options, pixel)
    color = wp.vec3(0.0, 0.0, 0.0)
    if block_depth(blocks.surface[block]) < SKY_DEPTH:
        color = wp.vec3(0.1, 0.1, 0.1)
    mark = int(blocks.mark[block])
    if (mark & MARK_SPARK) != 0:
        color = wp.vec3(1.0, 0.1, 0.0)
    if (mark & MARK_MISSING) != 0:
        color = wp.vec3(0.0, 0.2, 1.0)
    picture_out[pixel] = rgba(color, 1.0)
