# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as shadow_layers.py for scenes in which the lean node machine runs all transparency programs."""

from __future__ import annotations

import warp as wp

from .filter_lean import WALK_ON, WALK_OVERRUN, WALK_PASSED, LayerWalk, pass_layer, start_walk
from .intersect import MISS
from .light_linking import shadow_set
from .list_order import first_listed
from .paths import Options, Paths, load_layer
from .shadow_layers import add_weakened
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def finish_ray(options: Options, bounce: int, paths: Paths, path: int, walk: LayerWalk):
    """Store what is left of a shadow ray's light, see shadow_layers.weaken_shadow_rays."""
    if walk.state == WALK_OVERRUN:
        paths.overruns[path] = paths.overruns[path] + 1
    add_weakened(options, bounce, paths, path, wp.cw_mul(paths.shadow_light[path], walk.weight))


@wp.kernel(cuda_max_registers=128)
def weaken_shadow_rays_lean(
    # In:
    scene: Scene,
    options: Options,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Multiply the light of listed rays by the layers' transparencies; add it where no program of it is pending."""
    i = first_listed(wp.tid(), stride, count[0])
    path = int(-1)
    walk = LayerWalk()
    while path >= 0 or i < count[0]:
        if path < 0:
            path = queue[i]
            i = i + stride
            walk = start_walk(load_layer(paths_out, path))
            distance = paths_out.shadow_distance[path]
            if distance == 0.0 or walk.hit.instance == MISS:
                path = int(-1)
            elif not distance > 0.0:
                # Nothing can be in its way.
                walk.state = WALK_PASSED
        if path >= 0:
            if walk.state == WALK_ON:
                walk = pass_layer(
                    scene, walk, paths_out.shadow_origin[path], paths_out.shadow_direction[path],
                    paths_out.shadow_distance[path], bounces[0] + 1, shadow_set(scene, paths_out, path))
            if walk.state != WALK_ON:
                finish_ray(options, bounces[0], paths_out, path, walk)
                path = int(-1)
