# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's thin kernels: camera rays, closest hits and shadow rays. They know no materials.

Traversal is bound by registers and cache; keeping shading out of these kernels keeps many rays in flight.
"""

from __future__ import annotations

import warp as wp

from .camera import filter_offset
from .intersect import MISS, Layer, any_hit, closest_hit, closest_layer, shadow_layer
from .list_order import first_listed
from .panorama import film_ray
from .paths import (
    ENDED,
    PENDING_NONE,
    Options,
    Paths,
    add_shadow_light,
    load_hit,
    store_hit,
    store_layer,
    take_layer,
)
from .sampling import DIMENSION_FILTER, DIMENSION_LENS, pixel_seed_of, sample_pair
from .types import VISIBLE_CAMERA, FrameData, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Share of a pixel's footprint that textures are filtered over. Samples are spread over the pixel anyway; mips only
# save memory traffic where a texel is far smaller than a pixel, and the less they do the closer is the picture to
# one of unfiltered look-ups (a footprint of 1 darkened a fine checker by 2 %).
FOOTPRINT_SCALE = wp.constant(0.125)


@wp.func
def finish_shadow(
    options: Options, bounces: wp.array[int], paths: Paths, path: int, distance: float, blocked: bool,
):
    """End a shadow ray that is blocked; add the light of one that nothing more can stop."""
    if blocked:
        paths.shadow_distance[path] = 0.0
    elif distance != 0.0 and options.filtered == 0 and paths.shadow_pending[path] == PENDING_NONE:
        add_shadow_light(paths, options, bounces[0], path, paths.shadow_light[path])


@wp.func
def meet_shadow_layer(options: Options, bounces: wp.array[int], paths: Paths, path: int, layer: Layer):
    """Keep the first triangle that needs a test on a shadow ray; end the ray at a solid one, add the light at none."""
    store_layer(paths, path, layer.hit)
    if layer.solid == 1:
        paths.shadow_distance[path] = 0.0
    elif layer.hit.instance == MISS and paths.shadow_pending[path] == PENDING_NONE:
        add_shadow_light(paths, options, bounces[0], path, paths.shadow_light[path])


@wp.func
def end_unseen(paths: Paths, path: int):
    """End a path before it begins, where a fisheye's film shows nothing: transparent black that has met nothing."""
    paths.state[path] = ENDED
    paths.radiance[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    paths.throughput[path] = wp.vec3(0.0, 0.0, 0.0)
    paths.hit[path] = wp.vec2i(MISS, MISS)
    paths.layer[path] = wp.vec2i(MISS, MISS)
    paths.shadow_distance[path] = 0.0


@wp.kernel
def generate_paths(
    # In:
    frames: wp.array[FrameData],
    filter_table: wp.array[float],
    first_pixel: int,
    pixel_count: int,
    # Out:
    paths_out: Paths,
):
    """Start a path per pixel and sample: slot = sample * pixel_count + pixel."""
    path = wp.tid()
    frame = frames[0]
    pixel = first_pixel + path % pixel_count
    x = frame.crop_x + pixel % frame.crop_width
    y = frame.crop_y + pixel // frame.crop_width
    seed = pixel_seed_of(x, y, frame.seed)
    index = wp.uint32(frame.sample + path // pixel_count)
    jitter = sample_pair(seed, index, DIMENSION_FILTER)
    film = wp.vec2(
        float(x) + 0.5 + filter_offset(filter_table, jitter[0]),
        float(y) + 0.5 + filter_offset(filter_table, jitter[1]))
    ray = film_ray(frame, film, sample_pair(seed, index, DIMENSION_LENS))
    paths_out.state[path] = 0
    paths_out.overruns[path] = 0
    paths_out.seed[path] = seed
    paths_out.index[path] = index
    paths_out.origin[path] = ray.origin
    paths_out.direction[path] = ray.direction
    paths_out.t[path] = ray.t_max
    paths_out.throughput[path] = wp.vec3(1.0, 1.0, 1.0)
    paths_out.radiance[path] = wp.vec4(0.0, 0.0, 0.0, 1.0)
    paths_out.pdf[path] = 0.0
    paths_out.kind[path] = VISIBLE_CAMERA
    paths_out.cone[path] = wp.vec2(frame.pixel_size, frame.spread) * FOOTPRINT_SCALE
    if ray.t_max < 0.0:
        end_unseen(paths_out, path)


@wp.kernel(cuda_max_registers=64)
def trace_paths(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the closest opaque hit of every path in the queue."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        if paths_out.state[path] != ENDED:
            store_hit(paths_out, path, closest_hit(
                scene.geometry, paths_out.origin[path], paths_out.direction[path], paths_out.t[path]))
        i = i + stride


@wp.kernel(cuda_max_registers=64)
def trace_layers(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the first triangle that needs a test before each path's opaque hit; most have none."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        if paths_out.state[path] != ENDED:
            take_layer(paths_out, path, closest_layer(
                scene.geometry, paths_out.origin[path], paths_out.direction[path], load_hit(paths_out, path).t))
        i = i + stride


@wp.kernel(cuda_max_registers=64)
def trace_shadows(
    # In:
    scene: Scene,
    options: Options,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Trace the shadow rays against opaque triangles; add the light where no program is needed.

    `bounces`: how many surfaces the paths have met before, one element.
    """
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[path]
        blocked = False
        if distance > 0.0:
            blocked = any_hit(
                scene.geometry, paths_out.shadow_origin[path], paths_out.shadow_direction[path], distance)
        finish_shadow(options, bounces, paths_out, path, distance, blocked)


@wp.kernel(cuda_max_registers=64)
def trace_shadow_layers(
    # In:
    scene: Scene,
    options: Options,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the first triangle that needs a test on each shadow ray; add the light where there is none."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[path]
        if distance != 0.0:
            meet_shadow_layer(options, bounces, paths_out, path, shadow_layer(
                scene.geometry, paths_out.shadow_origin[path], paths_out.shadow_direction[path], distance))
