# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's rays in scenes without instances of their own: tracing.py's kernels with the queries that suffice.

Each kernel also looks for layers and lists what has met one: where few paths live, launches are what takes time. See
flat_tracing.py about registers.
"""

from __future__ import annotations

import warp as wp

from .flat_tracing import any_flat, closest_flat, closest_flat_layer, shadow_flat_layer
from .intersect import MISS
from .list_order import first_listed
from .paths import ENDED, Options, Paths, store_hit, take_layer
from .tracing import finish_shadow, meet_shadow_layer
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel(cuda_max_registers=64)
def trace_flat_paths(
    # In:
    scene: Scene,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Find the closest opaque hit of every path in the queue; see tracing.trace_paths.

    `filtered` 1: also find the first triangle that needs a test before it, and list the paths that have one.
    """
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if paths_out.state[path] != ENDED:
            store_hit(paths_out, path, closest_flat(
                scene.geometry, paths_out.origin[path], paths_out.direction[path], paths_out.t[path]))
            if filtered == 1:
                # Read anew: registers are scarcer than loads.
                layer = closest_flat_layer(
                    scene.geometry, paths_out.origin[path], paths_out.direction[path], paths_out.t[path])
                take_layer(paths_out, path, layer)
                if layer.hit.instance != MISS and layer.solid == 0:
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path


@wp.kernel(cuda_max_registers=64)
def trace_flat_path_shadows(
    # In:
    scene: Scene,
    options: Options,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Trace the shadow rays against opaque triangles; see tracing.trace_shadows.

    Where triangles need a test find the first of them too, and list the rays that have one; see trace_shadow_layers.
    """
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[path]
        blocked = False
        if distance > 0.0:
            blocked = any_flat(
                scene.geometry, paths_out.shadow_origin[path], paths_out.shadow_direction[path], distance)
        finish_shadow(options, bounces, paths_out, path, distance, blocked)
        if options.filtered == 1 and distance != 0.0 and not blocked:
            layer = shadow_flat_layer(
                scene.geometry, paths_out.shadow_origin[path], paths_out.shadow_direction[path], distance)
            meet_shadow_layer(options, bounces, paths_out, path, layer)
            if layer.hit.instance != MISS and layer.solid == 0:
                queue_out[wp.atomic_add(count_out, 0, 1)] = path
