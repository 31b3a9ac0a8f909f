# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's kernel for lamps that rays over mirrors meet; recorded for scenes that have lamps and mirrors."""

from __future__ import annotations

import warp as wp

from .cache_materials import sane
from .cache_mirrors import Mirrors, limit_followed, way_weight
from .cache_rays import Vertices
from .geometry_math import max_component
from .intersect import MISS
from .lamp_hit import FAR
from .paths import ENDED, Paths
from .reflection_lights import lamps_along
from .types import VISIBLE_GLOSSY, Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Instance.receives of mirrors: rays don't know which they have left.
ALL_SETS = wp.constant(-1)


@wp.kernel(cuda_max_registers=64)
def meet_mirrored_lamps(
    # In:
    views: wp.array[View],
    scene: Scene,
    filtered: int,
    paths: Paths,
    mirrors: Mirrors,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    vertices_out: Vertices,
):
    """Add the lamps that listed rays meet after a mirror; they hide nothing."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        if mirrors.state[slot] != ENDED:
            t_max = paths.t[slot]
            if paths.hit[slot][0] == MISS:
                t_max = FAR
            light = lamps_along(
                scene.lights, VISIBLE_GLOSSY, ALL_SETS, 0.0, 0.0, paths.origin[slot], paths.direction[slot], t_max)
            if max_component(light) > 0.0:
                light = sane(wp.cw_mul(
                    limit_followed(views[0], scene, light), way_weight(mirrors, filtered, paths, slot)))
                e = vertices_out.emission[slot]
                vertices_out.emission[slot] = wp.vec4(e[0] + light[0], e[1] + light[1], e[2] + light[2], e[3])
