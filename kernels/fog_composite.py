# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that lay fog over the picture, or show what it does."""

from __future__ import annotations

import warp as wp

from .fog import Fog
from .fog_march import lamps_before, look_through
from .froxels import FroxelOptions
from .gbuffer import GBuffer
from .geometry_math import is_finite3, mean_component
from .packing import HALF_MAX, from_half, rgb, rgba, to_half
from .types import Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

SHOW_LIGHT = wp.constant(0)
SHOW_PASSING = wp.constant(1)


@wp.kernel(cuda_max_registers=128)
def lay_fog(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    options: FroxelOptions,
    froxels: wp.array[wp.vec4h],
    gbuffer: GBuffer,
    color: wp.array[wp.vec4h],
    # Out:
    color_out: wp.array[wp.vec4h],
):
    """Write each pixel's exposed color as it is seen through the fog before it; fog covers what is transparent."""
    pixel = first + wp.tid()
    view = views[0]
    x = pixel % options.width
    y = pixel // options.width
    depth = gbuffer.depth[pixel]
    through = look_through(view, scene, fog, options, froxels, depth, x, y)
    seen = from_half(color[pixel])
    light = wp.cw_mul(rgb(seen), through.passing) + through.light
    if scene.lights.lamp_count > 0:
        light = light + lamps_before(view, scene, fog, depth, through.passing, x, y)
    if not is_finite3(light):
        light = rgb(seen)
    light = wp.vec3(wp.min(light[0], HALF_MAX), wp.min(light[1], HALF_MAX), wp.min(light[2], HALF_MAX))
    color_out[pixel] = to_half(rgba(light, 1.0 - (1.0 - seen[3]) * mean_component(through.passing)))


@wp.kernel
def show_fog(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    options: FroxelOptions,
    froxels: wp.array[wp.vec4h],
    gbuffer: GBuffer,
    channel: int,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw one of SHOW_*."""
    pixel = first + wp.tid()
    view = views[0]
    through = look_through(
        view, scene, fog, options, froxels, gbuffer.depth[pixel], pixel % options.width, pixel // options.width)
    picture_out[pixel] = rgba(wp.where(channel == SHOW_LIGHT, through.light, through.passing), 1.0)
