# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel that weakens shadow rays in scenes with media that vary in space; see media_shadows.py."""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS, layer_point, layer_transparency, step_past
from .geometry_math import max_component
from .intersect import MISS, closest_layer
from .light_linking import shadow_set
from .media import Inside, Media, MediaPaths, after_hit, load_inside, past_layer, store_inside
from .paths import ENDED, Options, Paths
from .sampling import hash_combine
from .shadow_layers import add_weakened
from .types import VISIBLE_SHADOW, Scene
from .volume_grids import Volumes
from .volume_walk import share_of_way

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

SHADOW_STREAM = wp.constant(0x53000000)
"""Sets the numbers of shadow rays' walks apart from all others"""


@wp.func
def share_through_volumes(
    scene: Scene, media: Media, volumes: Volumes, begin: Inside, depth: int, paths: Paths, path: int,
) -> wp.vec3:
    """Return the share of light that gets through all on the way of a shadow ray; see media_shadows.share_through."""
    origin = paths.shadow_origin[path]
    direction = paths.shadow_direction[path]
    distance = paths.shadow_distance[path]
    blocking = shadow_set(scene, paths, path)
    seed = hash_combine(hash_combine(paths.seed[path], paths.index[path]), wp.uint32(depth + SHADOW_STREAM))
    inside = begin
    product = wp.vec3(1.0, 1.0, 1.0)
    start = float(0.0)
    look = float(0.0)
    for layer in range(MAX_LAYERS + 1):
        further = closest_layer(scene.geometry, origin + direction * look, direction, distance - look)
        met = bool(further.hit.instance != MISS)
        hit = further.hit
        hit.t = hit.t + look
        if further.solid == 1 and met:
            return wp.vec3(0.0, 0.0, 0.0)
        stretch = wp.max(wp.where(met, hit.t, distance) - start, 0.0)
        product = wp.cw_mul(product, share_of_way(
            media, volumes, inside, origin, direction, start, start + stretch, hash_combine(seed, wp.uint32(layer))))
        if not met:
            return product
        point = layer_point(scene, hit, direction, VISIBLE_SHADOW, depth, wp.vec2(0.0, 0.0))
        product = wp.cw_mul(product, layer_transparency(scene, point, VISIBLE_SHADOW, blocking))
        if not max_component(product) > 0.0:
            return wp.vec3(0.0, 0.0, 0.0)
        inside = past_layer(scene, media, inside, hit.instance, point, VISIBLE_SHADOW)
        start = hit.t
        look = step_past(point, direction, hit.t)
        if look >= distance:
            return product
    paths.overruns[path] = paths.overruns[path] + 1
    return wp.vec3(0.0, 0.0, 0.0)


@wp.kernel(cuda_max_registers=128)
def weaken_in_volumes(
    # In:
    scene: Scene,
    options: Options,
    media: Media,
    volumes: Volumes,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    kept_out: MediaPaths,
):
    """Multiply the light of listed paths' shadow rays by what gets through; see media_shadows.weaken_in_media."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[path]
        inside = load_inside(kept_out, path)
        if distance != 0.0:
            light = paths_out.shadow_light[path]
            if distance > 0.0:
                begin = after_hit(
                    scene, media, kept_out, paths_out, path, inside, paths_out.shadow_direction[path])
                light = wp.cw_mul(light, share_through_volumes(
                    scene, media, volumes, begin, bounces[0] + 1, paths_out, path))
            add_weakened(options, bounces[0], paths_out, path, light)
        if paths_out.state[path] != ENDED:
            store_inside(kept_out, path, after_hit(
                scene, media, kept_out, paths_out, path, inside, paths_out.direction[path]))
