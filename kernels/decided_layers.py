# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays where they decide by themselves what stops them of the triangles that need a test (opacity_answers.py).

Flattened scenes alone; decided_instances.py has these kernels for others. One look through all layers takes the place
of lists, of materials' programs, and of a query from each layer on: see layers.py and shadow_layers.py, whose answers
these are. See flat_tracing.py about registers.
"""

from __future__ import annotations

import warp as wp

from .flat_tracing import any_flat, closest_flat
from .intersect import MISS, Hit, hit_at
from .layers import LAYER_STREAM
from .list_order import first_dealt, first_listed
from .paths import ENDED, Options, Paths, load_hit, store_hit
from .sampling import hash_combine
from .shadow_layers import add_weakened
from .types import Geometry, Scene
from .wide_layers import LayerHit, chance_layer_wide, passing_layers_wide

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def passing_share(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, distance: float) -> float:
    """Return what share of light comes through everything before a distance."""
    if any_flat(geometry, origin, direction, distance):
        return 0.0
    return passing_layers_wide(
        geometry.flat_filtered.nodes, geometry.flat_filtered.triangles, origin, direction, distance)


@wp.func
def stopping_hit(geometry: Geometry, found: LayerHit) -> Hit:
    """Return where a layer has stopped a ray; instance MISS where none has."""
    hit = Hit()
    hit.t = found[0]
    hit.instance = MISS
    number = wp.cast(found[3], int)
    if number >= 0:
        face = geometry.flat_filtered.faces[number]
        hit = hit_at(face[0], face[1], found[0], found[1], found[2])
    return hit


@wp.func
def stop_at(paths: Paths, slot: int, hit: Hit, passing: float):
    """Let a layer that lets some light pass stop a ray, or none."""
    if hit.instance != MISS:
        store_hit(paths, slot, hit)
        # The rest of its closures make up for the rays that pass.
        paths.throughput[slot] = paths.throughput[slot] / (1.0 - passing)
    paths.layer[slot] = wp.vec2i(MISS, 0)


@wp.func
def meet_layers(geometry: Geometry, paths: Paths, slot: int):
    """Let layers before a ray's hit stop it by chance; see filter.accept_hit."""
    seed = hash_combine(paths.seed[slot], wp.uint32(paths.state[slot] + LAYER_STREAM))
    found = chance_layer_wide(
        geometry.flat_filtered.nodes, geometry.flat_filtered.triangles, paths.origin[slot], paths.direction[slot],
        load_hit(paths, slot).t, hash_combine(seed, paths.index[slot]))
    stop_at(paths, slot, stopping_hit(geometry, found), found[4])


@wp.kernel(cuda_max_registers=64)
def trace_decided_rays(
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
    store_hit(paths_out, slot, closest_flat(
        scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))
    meet_layers(scene.geometry, paths_out, slot)


@wp.kernel(cuda_max_registers=64)
def trace_decided_further(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find what stops the further segments of listed rays; see flat_tracing.trace_flat_further."""
    i = first_dealt(wp.tid(), stride)
    while i < count[0]:
        slot = queue[i]
        if paths_out.state[slot] != ENDED:
            store_hit(paths_out, slot, closest_flat(
                scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))
            meet_layers(scene.geometry, paths_out, slot)
        i = i + stride


@wp.kernel(cuda_max_registers=56)
def trace_decided_shadows(
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
    """Weaken the light of listed shadow rays by all that stands in their way, and add it where no program is pending.

    `bounces`: how many surfaces the paths have met before, one element.
    """
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[slot]
        if distance != 0.0:
            share = float(1.0)
            if distance > 0.0:
                share = passing_share(
                    scene.geometry, paths_out.shadow_origin[slot], paths_out.shadow_direction[slot], distance)
            add_weakened(options, bounces[0], paths_out, slot, paths_out.shadow_light[slot] * share)
