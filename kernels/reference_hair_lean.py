# SPDX-License-Identifier: GPL-3.0-or-later
"""The twin of reference_hair.shade_hair_paths where all programs of hair are lean: it runs them itself."""

from __future__ import annotations

import warp as wp

from .list_order import first_listed
from .node_strands import run_strand, strand_start
from .path_shading import is_held_out
from .paths import ENDED, Options, Paths, has_hit, hit_point
from .reference_hair import shade_hair
from .types import MATERIAL_LEAN_STRANDS, FrameData, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel(cuda_max_registers=128)
def shade_lean_hair_paths(
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
    others_out: wp.array[int],
    other_count_out: wp.array[int],
):
    """Shade listed hits on hair and list the paths that go on; list other hits too, whose closures are not known."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            if (scene.materials.materials[point.material].flags & MATERIAL_LEAN_STRANDS) == 0:
                others_out[wp.atomic_add(other_count_out, 0, 1)] = path
            else:
                paths_out.closure[path] = run_strand(scene, point, strand_start(scene, point.material))
                paths_out.state[path] = ENDED
                if not is_held_out(scene, point, paths_out, path):
                    shade_hair(frames[0], scene, options, point, paths_out, path)
                    if paths_out.state[path] != ENDED:
                        queue_out[wp.atomic_add(count_out, 0, 1)] = path
