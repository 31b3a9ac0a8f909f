# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels of decided_layers.py for scenes with instances that are not flattened.

First the flattened triangles, then the instances before what was found there: each query needs fewer registers than one
for both.
"""

from __future__ import annotations

import warp as wp

from .decided_layers import stop_at, stopping_hit
from .intersect import MISS, any_hit, closest_hit, hit_at
from .layers import LAYER_STREAM
from .list_order import first_dealt, first_listed
from .paths import ENDED, Options, Paths, load_hit, store_hit
from .sampling import hash_combine
from .shadow_layers import add_weakened
from .types import Geometry, Scene
from .wide_instances import chance_layer_in_instances, passing_layers_in_instances
from .wide_layers import LayerHit, chance_layer_wide, passing_layers_wide

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def meet_all_layers(geometry: Geometry, paths: Paths, slot: int):
    """Let layers before a ray's hit stop it by chance; see decided_layers.meet_layers."""
    seed = hash_combine(
        hash_combine(paths.seed[slot], wp.uint32(paths.state[slot] + LAYER_STREAM)), paths.index[slot])
    origin = paths.origin[slot]
    direction = paths.direction[slot]
    flat = LayerHit(load_hit(paths, slot).t, 0.0, 0.0, wp.cast(MISS, float), 0.0)
    if geometry.flat_filtered.nodes.shape[0] > 0:
        flat = chance_layer_wide(
            geometry.flat_filtered.nodes, geometry.flat_filtered.triangles, origin, direction, flat[0], seed)
    level = geometry.instanced_filtered
    found = chance_layer_in_instances(level.nodes, level.records, origin, direction, flat[0], seed)
    hit = stopping_hit(geometry, flat)
    passing = flat[4]
    face = wp.cast(found[3], int)
    if face >= 0:
        passing = found[5]
        hit = hit_at(wp.cast(found[4], int), geometry.mesh_faces[face], found[0], found[1], found[2])
    stop_at(paths, slot, hit, passing)


@wp.func
def share_through_all(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, distance: float) -> float:
    """Return what share of light comes through everything before a distance; see decided_layers.passing_share."""
    if any_hit(geometry, origin, direction, distance):
        return 0.0
    share = float(1.0)
    if geometry.flat_filtered.nodes.shape[0] > 0:
        share = passing_layers_wide(
            geometry.flat_filtered.nodes, geometry.flat_filtered.triangles, origin, direction, distance)
    if share > 0.0:
        level = geometry.instanced_filtered
        share = share * passing_layers_in_instances(level.nodes, level.records, origin, direction, distance)
    return share


@wp.kernel(cuda_max_registers=64)
def trace_all_decided_rays(
    # In:
    first: int,
    scene: Scene,
    offset: int,
    # Out:
    paths_out: Paths,
):
    """Find what stops every ray from slot `offset` on; see cache_rays.trace_cache_rays."""
    slot = offset + first + wp.tid()
    if paths_out.state[slot] == ENDED:
        paths_out.hit[slot] = wp.vec2i(MISS, 0)
        return
    store_hit(paths_out, slot, closest_hit(
        scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))
    meet_all_layers(scene.geometry, paths_out, slot)


@wp.kernel(cuda_max_registers=64)
def trace_all_decided_further(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find what stops the further segments of listed rays; see reflection_trace.trace_further."""
    i = first_dealt(wp.tid(), stride)
    while i < count[0]:
        slot = queue[i]
        if paths_out.state[slot] != ENDED:
            store_hit(paths_out, slot, closest_hit(
                scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))
            meet_all_layers(scene.geometry, paths_out, slot)
        i = i + stride


@wp.kernel(cuda_max_registers=64)
def trace_all_decided_shadows(
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
    """Weaken the light of listed shadow rays by all that stands in their way; see trace_decided_shadows."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[slot]
        if distance != 0.0:
            share = float(1.0)
            if distance > 0.0:
                share = share_through_all(
                    scene.geometry, paths_out.shadow_origin[slot], paths_out.shadow_direction[slot], distance)
            add_weakened(options, bounces[0], paths_out, slot, paths_out.shadow_light[slot] * share)
