# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference path tracer's shading of hits in scenes with thin films, in place of reference.py's.

Kept apart: interference makes each evaluation of a BSDF several times as long, and few scenes have any.
"""

from __future__ import annotations

import warp as wp

from .list_order import first_listed
from .path_shading import is_held_out, shade_hit
from .paths import ENDED, Options, Paths, has_hit, hit_point
from .principled import prepare_bsdf
from .types import FrameData, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel
def shade_film_paths(
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
    """Do what reference.shade_paths does, of closures that may have a thin film."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_hit(paths_out, path):
            point = hit_point(scene, paths_out, path, paths_out.state[path])
            paths_out.state[path] = ENDED
            if not is_held_out(scene, point, paths_out, path):
                bsdf = prepare_bsdf(scene.tables, paths_out.closure[path], point)
                shade_hit(frames[0], scene, options, point, bsdf, paths_out, path)
                if paths_out.state[path] != ENDED:
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path
