# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel that runs the programs of the materials that were hit."""

from __future__ import annotations

import warp as wp

from .list_order import first_listed
from .nodes import evaluate_surface
from .paths import Paths, has_hit, hit_point
from .sampling import DIMENSION_FIRST_BOUNCE, DIMENSION_LOBE, DIMENSIONS_PER_BOUNCE, sample_pair
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel
def evaluate_materials(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Run the programs of the materials that listed paths have hit."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            bounce = paths_out.state[path]
            point = hit_point(scene, paths_out, path, bounce)
            dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE
            lobe = sample_pair(paths_out.seed[path], paths_out.index[path], dimension + DIMENSION_LOBE)
            # The part that lets light through unchanged was taken by filter_paths with the probability of its weight.
            paths_out.closure[path] = evaluate_surface(scene, point, lobe[1])
