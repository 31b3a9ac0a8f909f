# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel that runs programs of materials in scenes with hair that scatters; materials_exact's twin.

Such a material has a program of its own for the path tracer, whose closures are hair's lobes; others run as ever.
"""

from __future__ import annotations

import warp as wp

from .list_order import first_listed
from .materials_exact import exact_closure
from .node_rays import program_start
from .node_strands import run_strand, strand_start
from .paths import Paths, has_hit, hit_point
from .types import MATERIAL_HAIR, MATERIAL_LEAN_STRANDS, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


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
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            flags = scene.materials.materials[point.material].flags
            if (flags & MATERIAL_LEAN_STRANDS) != 0:
                paths_out.closure[path] = run_strand(scene, point, strand_start(scene, point.material))
            else:
                start = int(0)
                if (flags & MATERIAL_HAIR) != 0:
                    start = strand_start(scene, point.material)
                else:
                    start = program_start(scene, point.material)
                paths_out.closure[path] = exact_closure(scene, point, start, paths_out, path)
