# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's rays in scenes without instances of their own: tracing.py's kernels with the queries that suffice.

See flat_tracing.py about registers.
"""

from __future__ import annotations

import warp as wp

from .flat_tracing import any_flat, closest_flat, closest_flat_layer
from .intersect import MISS
from .paths import ENDED, PENDING_NONE, Options, Paths, add_shadow_light, load_hit, store_hit, store_layer
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel(cuda_max_registers=56)
def trace_flat_paths(
    # In:
    scene: Scene,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the closest opaque hit of every path in the queue; see tracing.trace_paths."""
    path = queue[wp.tid()]
    if paths_out.state[path] == ENDED:
        return
    store_hit(paths_out, path, closest_flat(
        scene.geometry, paths_out.origin[path], paths_out.direction[path], paths_out.t[path]))


@wp.kernel(cuda_max_registers=56)
def trace_flat_path_layers(
    # In:
    scene: Scene,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the first triangle that needs a test before each path's opaque hit; see tracing.trace_layers."""
    path = queue[wp.tid()]
    if paths_out.state[path] == ENDED:
        return
    store_layer(paths_out, path, closest_flat_layer(
        scene.geometry, paths_out.origin[path], paths_out.direction[path], load_hit(paths_out, path).t))


@wp.kernel(cuda_max_registers=48)
def trace_flat_path_shadows(
    # In:
    scene: Scene,
    options: Options,
    bounce: int,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Trace the shadow rays against opaque triangles; see tracing.trace_shadows."""
    path = queue[wp.tid()]
    distance = paths_out.shadow_distance[path]
    if distance == 0.0:
        return
    if distance > 0.0:
        if any_flat(scene.geometry, paths_out.shadow_origin[path], paths_out.shadow_direction[path], distance):
            paths_out.shadow_distance[path] = 0.0
            return
    if options.filtered == 0 and paths_out.shadow_pending[path] == PENDING_NONE:
        add_shadow_light(paths_out, options, bounce, path, paths_out.shadow_light[path])


@wp.kernel(cuda_max_registers=56)
def trace_flat_path_shadow_layers(
    # In:
    scene: Scene,
    options: Options,
    bounce: int,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the first triangle that needs a test on each shadow ray; see tracing.trace_shadow_layers."""
    path = queue[wp.tid()]
    distance = paths_out.shadow_distance[path]
    if distance == 0.0:
        return
    hit = closest_flat_layer(
        scene.geometry, paths_out.shadow_origin[path], paths_out.shadow_direction[path], distance)
    store_layer(paths_out, path, hit)
    if hit.instance == MISS and paths_out.shadow_pending[path] == PENDING_NONE:
        add_shadow_light(paths_out, options, bounce, path, paths_out.shadow_light[path])
