# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference path tracer's shading of hits on plain glass, which the lean node machine runs too.

Kept apart from reference_lean.py: the lobes of glass make a kernel larger, and most hits have none.
"""

from __future__ import annotations

import warp as wp

from .list_order import first_listed
from .node_lean import plain_bsdf, run_lean
from .path_shading import is_held_out, shade_hit
from .paths import ENDED, Options, Paths, has_hit, hit_point
from .types import FrameData, Scene
from .wide_loads import load_material_flags

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel(cuda_max_registers=168)
def shade_plain_paths(
    # In:
    frames: wp.array[FrameData],
    scene: Scene,
    options: Options,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Shade listed hits, all on plain materials, and list the paths that go on."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            paths_out.state[path] = ENDED
            if not is_held_out(scene, point, paths_out, path):
                starts = load_material_flags(scene.materials.materials, point.material)
                bsdf = plain_bsdf(scene.tables, run_lean(scene, point, starts[0]), point)
                shade_hit(frames[0], scene, options, point, bsdf, paths_out, path)
                if paths_out.state[path] != ENDED:
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path
