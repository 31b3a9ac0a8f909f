# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as shadow_layers.py for scenes in which the lean node machine runs all transparency programs."""

from __future__ import annotations

import warp as wp

from .filter_lean import transmittance_lean
from .intersect import MISS
from .paths import Options, Paths, load_layer
from .shadow_layers import add_weakened
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def weaken_ray(scene: Scene, options: Options, bounce: int, paths: Paths, path: int):
    """Weaken the light of one shadow ray, see shadow_layers.weaken_shadow_rays."""
    distance = paths.shadow_distance[path]
    if distance == 0.0 or paths.layer[path][0] == MISS:
        return
    light = paths.shadow_light[path]
    if distance > 0.0:
        passed = transmittance_lean(
            scene, paths.shadow_origin[path], paths.shadow_direction[path], distance, load_layer(paths, path),
            bounce + 1)
        light = wp.cw_mul(light, passed.weight)
        paths.overruns[path] = paths.overruns[path] + passed.overrun
    add_weakened(options, bounce, paths, path, light)


@wp.kernel(cuda_max_registers=128)
def weaken_shadow_rays_lean(
    # In:
    scene: Scene,
    options: Options,
    bounce: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Multiply the light of listed rays by the layers' transparencies; add it where no program of it is pending."""
    i = wp.tid()
    while i < count[0]:
        weaken_ray(scene, options, bounce, paths_out, queue[i])
        i = i + stride
