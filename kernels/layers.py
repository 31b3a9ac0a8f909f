# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel that looks through transparent layers in front of a hit."""

from __future__ import annotations

import warp as wp

from .filter import accept_hit
from .list_order import first_listed
from .paths import Paths, has_layers, load_hit, load_layer, store_hit
from .sampling import hash_combine
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Sets the layers' random numbers apart from all other streams.
LAYER_STREAM = wp.constant(0x4C000000)


@wp.kernel
def filter_paths(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Walk through the layers of triangles that need a test, in front of the opaque hit."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_layers(paths_out, path):
            seed = hash_combine(paths_out.seed[path], wp.uint32(paths_out.state[path] + LAYER_STREAM))
            found = accept_hit(
                scene, paths_out.origin[path], paths_out.direction[path], load_hit(paths_out, path),
                load_layer(paths_out, path), paths_out.kind[path], paths_out.state[path], paths_out.cone[path], seed,
                paths_out.index[path])
            store_hit(paths_out, path, found.hit)
            paths_out.overruns[path] = paths_out.overruns[path] + found.overrun
            paths_out.throughput[path] = wp.cw_mul(paths_out.throughput[path], found.weight)
