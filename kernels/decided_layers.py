# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays where they decide by themselves what stops them of the triangles that need a test (opacity_answers.py).

Flattened scenes alone. One look through all layers takes the place of lists, of materials' programs, and of a query
from each layer on: see layers.py and shadow_layers.py, whose answers these are. See flat_tracing.py about registers.
"""

from __future__ import annotations

import warp as wp

from .flat_tracing import any_flat, closest_flat, closest_flat_layer
from .gbuffer_behind import shining
from .gbuffer_layers import layer_seed, store_stop
from .gbuffer_rays import LAYERS_LIT, PrimaryHits, primary_ray, store_primary_layer
from .geometry_math import max_component
from .intersect import MISS, Hit
from .layers import LAYER_STREAM
from .packing import rgba
from .paths import ENDED, Options, Paths, load_hit, store_hit
from .pixel_order import pixel_in_blocks
from .sampling import hash_combine, sample_number
from .shadow_layers import add_weakened
from .types import Geometry, Scene
from .view import View
from .wide_layers import LayerHit, chance_layer_wide, passing_layers_wide
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# After so many draws that let a ray pass which is to be stopped it passes: layers that let nearly all pass.
MAX_TRIES = wp.constant(32)


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
        hit.instance = face[0]
        hit.triangle = face[1]
        # The weights found are those of the first and second vertex.
        hit.u = found[2]
        hit.v = 1.0 - found[1] - found[2]
    return hit


@wp.func
def meet_layers(geometry: Geometry, paths: Paths, slot: int):
    """Let layers before a ray's hit stop it by chance; see filter.accept_hit."""
    seed = hash_combine(paths.seed[slot], wp.uint32(paths.state[slot] + LAYER_STREAM))
    found = chance_layer_wide(
        geometry.flat_filtered.nodes, geometry.flat_filtered.triangles, paths.origin[slot], paths.direction[slot],
        load_hit(paths, slot).t, hash_combine(seed, paths.index[slot]))
    hit = stopping_hit(geometry, found)
    if hit.instance != MISS:
        store_hit(paths, slot, hit)
        # The rest of its closures make up for the rays that pass.
        paths.throughput[slot] = paths.throughput[slot] / (1.0 - found[4])
    paths.layer[slot] = wp.vec2i(MISS, 0)


@wp.func
def meet_veil(
    view: View, scene: Scene, width: int, layers: int, origin: wp.vec3, direction: wp.vec3, hits: PrimaryHits,
    pixel: int,
):
    """Let the half transparent layers before a pixel's hit stop its ray by chance; see gbuffer_layers.filter_primary.

    Whether any does is one number of the pixel's sequence, so that frames take turns evenly; which of several does is
    drawn until one has. `layers`: LAYERS_LIT where what shines behind them is to be found, see gbuffer_behind.py.
    """
    flat = scene.geometry.flat_filtered
    t_max = hits.t[pixel]
    share = passing_layers_wide(flat.nodes, flat.triangles, origin, direction, t_max)
    lit = wp.where(layers == LAYERS_LIT, 1, 0)
    if lit == 1:
        light = shining(view, scene, hits, pixel)
        hits.behind[pixel] = rgba(light * share, wp.where(max_component(light) > 0.0, 1.0, 0.0))
    seed = layer_seed(view, pixel, width)
    if sample_number(seed, wp.uint32(view.frame), 0) >= share:
        tries = int(0)
        while tries < MAX_TRIES:
            tries = tries + 1
            found = chance_layer_wide(
                flat.nodes, flat.triangles, origin, direction, t_max,
                hash_combine(seed, wp.uint32(view.frame * MAX_TRIES + tries)))
            hit = stopping_hit(scene.geometry, found)
            if hit.instance != MISS:
                store_stop(hits, pixel, hit, lit)
                weight = 1.0 / (1.0 - found[4])
                hits.weight[pixel] = wp.vec3(weight, weight, weight)
                tries = MAX_TRIES


@wp.kernel(cuda_max_registers=64)
def trace_decided_primary(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    height: int,
    layers: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Find what each pixel shows, behind layers too; see flat_tracing.trace_flat_primary. `layers`: LAYERS_*."""
    pixel = pixel_in_blocks(first + wp.tid(), width, height)
    if pixel < 0:
        return
    ray = primary_ray(views[0], pixel % width, pixel // width)
    hit = closest_flat(scene.geometry, ray.origin, ray.direction, ray.t_max)
    hits_out.t[pixel] = hit.t
    hits_out.hit[pixel] = wp.vec2i(hit.instance, hit.triangle)
    hits_out.barycentrics[pixel] = wp.vec2(hit.u, hit.v)
    store_primary_layer(hits_out, pixel, closest_flat_layer(scene.geometry, ray.origin, ray.direction, hit.t))
    if hits_out.layer[pixel][0] != MISS:
        meet_veil(load_view(views), scene, width, layers, ray.origin, ray.direction, hits_out, pixel)


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
    i = wp.tid()
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
    i = wp.tid()
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
