# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel that runs programs of materials in scenes with hair that scatters; materials_exact's twin.

Such a material has a program of its own for the path tracer, whose closures are hair's lobes; others run as ever.
"""

from __future__ import annotations

import warp as wp

from .materials_exact import exact_closure
from .node_rays import program_start
from .paths import Paths, has_hit, hit_point
from .types import MATERIAL_HAIR, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def traced_start(scene: Scene, material: int) -> int:
    """Return the first instruction of what the path tracer runs."""
    if (scene.materials.materials[material].flags & MATERIAL_HAIR) != 0:
        return scene.materials.code[scene.materials.materials[material].surface_start - 1][2]
    return program_start(scene, material)


@wp.kernel
def evaluate_hair_materials(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Run the programs of the materials that listed paths have hit, those of hair as the path tracer has them."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            start = traced_start(scene, point.material)
            paths_out.closure[path] = exact_closure(scene, point, start, paths_out, path)
