# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernels for what lies in the way: transparent layers, and lights whose radiance is a program."""

from __future__ import annotations

import warp as wp

from .filter import accept_hit, transmittance
from .geometry_math import max_component
from .intersect import MISS, Hit, surface_point
from .nodes import evaluate_emission, evaluate_world
from .paths import (
    ENDED,
    PENDING_TRIANGLE,
    PENDING_WORLD,
    Options,
    Paths,
    add_light,
    limit_at,
    load_hit,
    load_layer,
    store_hit,
)
from .sampling import hash_combine
from .types import VISIBLE_DIFFUSE, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Sets the layers' random numbers apart from all other streams.
LAYER_STREAM = wp.constant(0x4C000000)


@wp.kernel
def filter_paths(
    # In:
    scene: Scene,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Walk through the layers of triangles that need a test, in front of the opaque hit."""
    path = queue[wp.tid()]
    if paths_out.state[path] == ENDED or paths_out.layer[path][0] == MISS:
        return
    noise = hash_combine(
        hash_combine(paths_out.seed[path], paths_out.index[path]), wp.uint32(paths_out.state[path] + LAYER_STREAM))
    found = accept_hit(
        scene, paths_out.origin[path], paths_out.direction[path], load_hit(paths_out, path),
        load_layer(paths_out, path), paths_out.kind[path], paths_out.state[path], paths_out.cone[path], noise)
    store_hit(paths_out, path, found.hit)
    paths_out.throughput[path] = wp.cw_mul(paths_out.throughput[path], found.weight)


@wp.kernel
def shade_shadows(
    # In:
    scene: Scene,
    options: Options,
    bounce: int,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Finish shadow rays that need programs: transparent layers in between, textured emitters, the world."""
    path = queue[wp.tid()]
    distance = paths_out.shadow_distance[path]
    if distance == 0.0:
        return
    paths_out.shadow_distance[path] = 0.0
    light = paths_out.shadow_light[path]
    origin = paths_out.shadow_origin[path]
    direction = paths_out.shadow_direction[path]
    cone = paths_out.cone[path]
    pending = paths_out.shadow_pending[path]
    if pending == PENDING_TRIANGLE:
        hit = Hit()
        hit.t = wp.abs(distance)
        hit.instance = paths_out.shadow_emitter[path][0]
        hit.triangle = paths_out.shadow_emitter[path][1]
        hit.u = paths_out.shadow_barycentrics[path][0]
        hit.v = paths_out.shadow_barycentrics[path][1]
        point = surface_point(scene, hit, direction)
        point.footprint = cone[0]
        point.ray_visibility = VISIBLE_DIFFUSE
        point.ray_length = hit.t
        point.ray_depth = bounce + 1
        light = wp.cw_mul(light, evaluate_emission(scene, point))
    if pending == PENDING_WORLD:
        # Unfiltered: a sun of a few texels must keep the brightness for which the table chose it.
        light = wp.cw_mul(light, evaluate_world(scene, direction, VISIBLE_DIFFUSE, bounce + 1, 0.0))
    if options.filtered == 1 and distance > 0.0 and paths_out.layer[path][0] != MISS:
        light = wp.cw_mul(
            light, transmittance(scene, origin, direction, distance, load_layer(paths_out, path), bounce + 1))
    if max_component(light) > 0.0:
        add_light(paths_out, path, light, limit_at(options, bounce + 1))
