# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as layers.py for scenes in which the lean node machine runs all transparency programs."""

from __future__ import annotations

import warp as wp

from .filter_lean import accept_lean
from .intersect import MISS
from .layers import LAYER_STREAM
from .paths import ENDED, Paths, load_hit, load_layer, store_hit
from .sampling import hash_combine
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def filter_path(scene: Scene, paths: Paths, path: int):
    """Walk through the layers of one path, see layers.filter_paths."""
    if paths.state[path] == ENDED or paths.layer[path][0] == MISS:
        return
    noise = hash_combine(
        hash_combine(paths.seed[path], paths.index[path]), wp.uint32(paths.state[path] + LAYER_STREAM))
    found = accept_lean(
        scene, paths.origin[path], paths.direction[path], load_hit(paths, path), load_layer(paths, path),
        paths.kind[path], paths.state[path], paths.cone[path], noise)
    store_hit(paths, path, found.hit)
    paths.overruns[path] = paths.overruns[path] + found.overrun
    paths.throughput[path] = wp.cw_mul(paths.throughput[path], found.weight)


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
    i = wp.tid()
    while i < count[0]:
        filter_path(scene, paths_out, queue[i])
        i = i + stride
