# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that traces the further segments of reflection rays: few, and anywhere. It knows no materials."""

from __future__ import annotations

import warp as wp

from .intersect import closest_hit, closest_layer
from .list_order import first_dealt
from .paths import ENDED, Paths, store_hit, take_layer
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel(cuda_max_registers=64)
def trace_further(
    # In:
    scene: Scene,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Find the closest opaque hit of listed segments; the last hits of rays that have ended are kept.

    `filtered` 1: the first triangle before it that needs a test, too. For flat scenes see trace_flat_further.
    """
    i = first_dealt(wp.tid(), stride)
    while i < count[0]:
        slot = queue[i]
        if paths_out.state[slot] != ENDED:
            origin = paths_out.origin[slot]
            direction = paths_out.direction[slot]
            hit = closest_hit(scene.geometry, origin, direction, paths_out.t[slot])
            store_hit(paths_out, slot, hit)
            if filtered == 1:
                take_layer(paths_out, slot, closest_layer(scene.geometry, origin, direction, hit.t))
        i = i + stride
