# SPDX-License-Identifier: GPL-3.0-or-later
"""The real-time frame's rays in scenes without instances of their own: all triangles lie in flattened structures.

The same as trace_* of gbuffer_rays.py, cache_rays.py, direct_shadow.py and tracing.py with `closest_hit` and the like
cut down to what such scenes need. Kernels that may also walk the second level keep its state in registers: 90 to 104,
so that of a GPU's 65536 a multiprocessor 18 to 22 warps are under way there, and 36 to 42 with the 48 to 56 of these.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import finish_cache_shadow
from .gbuffer_rays import PrimaryHits, primary_ray, store_primary_hit, store_primary_layer
from .intersect import MISS, Hit, Layer, any_static, closest_static, static_layer, static_shadow_layer
from .list_order import first_dealt
from .paths import ENDED, Options, Paths, load_hit, store_hit, take_layer
from .pixel_order import pixel_in_blocks
from .tracing import meet_shadow_layer
from .types import Geometry, Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def no_hit(t_max: float) -> Hit:
    """Return that nothing was hit."""
    hit = Hit()
    hit.t = t_max
    hit.instance = MISS
    return hit


@wp.func
def closest_flat(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Hit:
    """Return intersect.closest_hit."""
    return closest_static(geometry.flat, origin, direction, no_hit(t_max))


@wp.func
def closest_flat_layer(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Layer:
    """Return intersect.closest_layer."""
    return static_layer(geometry.flat_filtered, origin, direction, t_max)


@wp.func
def shadow_flat_layer(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Layer:
    """Return intersect.shadow_layer."""
    return static_shadow_layer(geometry.flat_filtered, origin, direction, t_max)


@wp.func
def any_flat(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, t_max: float) -> bool:
    """Return intersect.any_hit."""
    return any_static(geometry.flat, origin, direction, t_max)


@wp.kernel(cuda_max_registers=56)
def trace_flat_primary(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    height: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Find what each pixel shows, in the order of pixel_in_blocks; see gbuffer_rays.trace_primary."""
    pixel = pixel_in_blocks(first + wp.tid(), width, height)
    if pixel < 0:
        return
    ray = primary_ray(views[0], pixel % width, pixel // width)
    store_primary_hit(hits_out, pixel, closest_flat(scene.geometry, ray.origin, ray.direction, ray.t_max))


@wp.kernel(cuda_max_registers=56)
def trace_flat_layered_primary(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    height: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Find what each pixel shows and the first triangle before it that needs a test; see trace_primary_layers."""
    pixel = pixel_in_blocks(first + wp.tid(), width, height)
    if pixel < 0:
        return
    ray = primary_ray(views[0], pixel % width, pixel // width)
    hit = closest_flat(scene.geometry, ray.origin, ray.direction, ray.t_max)
    store_primary_hit(hits_out, pixel, hit)
    store_primary_layer(hits_out, pixel, closest_flat_layer(scene.geometry, ray.origin, ray.direction, hit.t))


@wp.kernel(cuda_max_registers=56)
def trace_flat_rays(
    # In:
    first: int,
    scene: Scene,
    offset: int,
    # Out:
    paths_out: Paths,
):
    """Find the closest opaque hit of every ray from slot `offset` on; see cache_rays.trace_cache_rays."""
    slot = offset + first + wp.tid()
    if paths_out.state[slot] == ENDED:
        paths_out.hit[slot] = wp.vec2i(MISS, 0)
        return
    store_hit(paths_out, slot, closest_flat(
        scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))


@wp.kernel(cuda_max_registers=56)
def trace_flat_further(
    # In:
    scene: Scene,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find what the further segments of listed rays meet; see reflection_trace.trace_further."""
    i = first_dealt(wp.tid(), stride)
    while i < count[0]:
        slot = queue[i]
        if paths_out.state[slot] != ENDED:
            store_hit(paths_out, slot, closest_flat(
                scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))
            if filtered == 1:
                # Read anew: registers are scarcer than loads.
                take_layer(paths_out, slot, closest_flat_layer(
                    scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))
        i = i + stride


@wp.kernel(cuda_max_registers=56)
def trace_flat_layers(
    # In:
    first: int,
    scene: Scene,
    offset: int,
    # Out:
    paths_out: Paths,
):
    """Find the first triangle that needs a test before each ray's opaque hit; see tracing.trace_layers."""
    slot = offset + first + wp.tid()
    if paths_out.state[slot] == ENDED:
        return
    take_layer(paths_out, slot, closest_flat_layer(
        scene.geometry, paths_out.origin[slot], paths_out.direction[slot], load_hit(paths_out, slot).t))


@wp.kernel(cuda_max_registers=48)
def trace_flat_shadows(
    # In:
    first: int,
    scene: Scene,
    # Out:
    rays_out: Paths,
):
    """Set the distance of blocked shadow rays to 0; see direct_shadow.trace_direct_shadows."""
    slot = first + wp.tid()
    distance = rays_out.shadow_distance[slot]
    if distance > 0.0:
        if any_flat(scene.geometry, rays_out.shadow_origin[slot], rays_out.shadow_direction[slot], distance):
            rays_out.shadow_distance[slot] = 0.0


@wp.kernel(cuda_max_registers=48)
def trace_flat_cache_shadows(
    # In:
    scene: Scene,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Trace listed shadow rays against opaque triangles; see cache_rays.trace_cache_shadows."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        distance = paths_out.shadow_distance[slot]
        if distance != 0.0:
            blocked = bool(False)
            if distance > 0.0:
                blocked = any_flat(
                    scene.geometry, paths_out.shadow_origin[slot], paths_out.shadow_direction[slot], distance)
            finish_cache_shadow(paths_out, slot, blocked, filtered)
        i = i + stride


@wp.kernel(cuda_max_registers=56)
def trace_flat_shadow_layers(
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
    """Find the first triangle that needs a test on each listed shadow ray; see tracing.trace_shadow_layers."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        distance = paths_out.shadow_distance[slot]
        if distance != 0.0:
            meet_shadow_layer(options, bounces, paths_out, slot, shadow_flat_layer(
                scene.geometry, paths_out.shadow_origin[slot], paths_out.shadow_direction[slot], distance))
        i = i + stride
