# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that traces the further segments of reflection rays: few, and anywhere. It knows no materials."""

from __future__ import annotations

import warp as wp

from .intersect import closest_hit
from .paths import ENDED, Paths, store_hit
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def trace_further(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the closest opaque hit of listed segments; the last hits of rays that have ended are kept."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        if paths_out.state[slot] != ENDED:
            store_hit(paths_out, slot, closest_hit(
                scene.geometry, paths_out.origin[slot], paths_out.direction[slot], paths_out.t[slot]))
        i = i + stride
