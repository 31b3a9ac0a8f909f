# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as denoise_guides.find_surfaces for hits whose materials the lean node machine runs."""

from __future__ import annotations

import warp as wp

from .denoise_guides import meet_guide
from .node_lean import lean_bsdf, run_lean
from .paths import Paths, has_hit, hit_point
from .types import MATERIAL_LEAN, Scene
from .wide_loads import load_material_flags

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel(cuda_max_registers=128)
def find_lean_surfaces(
    # In:
    scene: Scene,
    exposure: float,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Take in the hits of listed paths that the lean machine can run."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            starts = load_material_flags(scene.materials.materials, point.material)
            if (starts[3] & MATERIAL_LEAN) != 0:
                bsdf = lean_bsdf(scene.tables, run_lean(scene, point, starts[0]), point)
                meet_guide(scene, exposure, point, bsdf, paths_out, path)
