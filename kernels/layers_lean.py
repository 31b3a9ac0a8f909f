# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as layers.py for scenes in which the lean node machine runs all transparency programs."""

from __future__ import annotations

import warp as wp

from .filter_lean import WALK_ON, WALK_OVERRUN, WALK_STOPPED, LayerWalk, accept_layer, start_walk
from .layers import LAYER_STREAM
from .list_order import first_listed
from .paths import Paths, has_layers, load_hit, load_layer, store_hit
from .sampling import hash_combine
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def meet_layer(scene: Scene, paths: Paths, path: int, walk: LayerWalk) -> LayerWalk:
    """Take one layer of a path, see layers.filter_paths."""
    # Read anew for each layer: registers are scarcer than loads.
    surfaces = paths.state[path]
    seed = hash_combine(paths.seed[path], wp.uint32(surfaces + LAYER_STREAM))
    return accept_layer(
        scene, walk, paths.origin[path], paths.direction[path], load_hit(paths, path).t, paths.kind[path], surfaces,
        paths.cone[path], seed, paths.index[path])


@wp.func
def finish_path(paths: Paths, path: int, walk: LayerWalk):
    """Store what a path through layers has come to."""
    if walk.state == WALK_STOPPED:
        store_hit(paths, path, walk.hit)
    if walk.state == WALK_OVERRUN:
        paths.overruns[path] = paths.overruns[path] + 1
    paths.throughput[path] = wp.cw_mul(paths.throughput[path], walk.weight)


@wp.func
def filter_path(scene: Scene, paths: Paths, path: int):
    """Walk through the layers of one path, see layers.filter_paths."""
    if not has_layers(paths, path):
        return
    walk = start_walk(load_layer(paths, path))
    while walk.state == WALK_ON:
        walk = meet_layer(scene, paths, path, walk)
    finish_path(paths, path, walk)


@wp.kernel(cuda_max_registers=128)
def filter_paths_lean(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Walk through the layers of triangles that need a test, in front of the opaque hits of listed paths."""
    i = first_listed(wp.tid(), stride, count[0])
    path = int(-1)
    walk = LayerWalk()
    while path >= 0 or i < count[0]:
        if path < 0:
            path = queue[i]
            i = i + stride
            walk = start_walk(load_layer(paths_out, path))
            if not has_layers(paths_out, path):
                path = int(-1)
        if path >= 0:
            walk = meet_layer(scene, paths_out, path, walk)
            if walk.state != WALK_ON:
                finish_path(paths_out, path, walk)
                path = int(-1)
