# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel that runs exact programs where hit materials have them; the twin of materials.py."""

from __future__ import annotations

import warp as wp

from .list_order import first_listed
from .node_rays import Rays, is_blurred, program_start, run_exact
from .paths import Paths, has_hit, hit_point
from .sampling import DIMENSION_FIRST_BOUNCE, DIMENSION_LOBE, DIMENSIONS_PER_BOUNCE, hash_combine, sample_pair
from .types import Closure, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def exact_closure(scene: Scene, point: ShadingPoint, start: int, paths: Paths, path: int) -> Closure:
    """Return what a program comes to at a path's hit, with the nodes that send rays."""
    dimension = DIMENSION_FIRST_BOUNCE + paths.state[path] * DIMENSIONS_PER_BOUNCE
    lobe = sample_pair(paths.seed[path], paths.index[path], dimension + DIMENSION_LOBE)
    rays = Rays()
    rays.seed = hash_combine(paths.seed[path], wp.uint32(paths.state[path]))
    rays.index = paths.index[path]
    rays.blurred = is_blurred(paths.kind[path], paths.pdf[path])
    return run_exact(scene, point, start, lobe[1], rays)


@wp.kernel
def evaluate_exact_materials(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Run the programs of the materials that listed paths have hit, exact ones where there are any."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            start = program_start(scene, point.material)
            paths_out.closure[path] = exact_closure(scene, point, start, paths_out, path)
