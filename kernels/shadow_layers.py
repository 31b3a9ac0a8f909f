# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel that weakens shadow rays by the transparent layers on their way."""

from __future__ import annotations

import warp as wp

from .filter import transmittance
from .geometry_math import max_component
from .light_linking import shadow_set
from .list_order import first_listed
from .paths import PENDING_NONE, Options, Paths, add_shadow_light, has_shadow_layers, load_layer
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def add_weakened(options: Options, bounce: int, paths: Paths, path: int, light: wp.vec3):
    """Add the light that a shadow ray brings; where a program of it is pending only keep it."""
    if not max_component(light) > 0.0:
        paths.shadow_distance[path] = 0.0
    elif paths.shadow_pending[path] == PENDING_NONE:
        add_shadow_light(paths, options, bounce, path, light)
    else:
        paths.shadow_light[path] = light


@wp.kernel
def weaken_shadow_rays(
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
    """Multiply the light by the layers' transparencies; add it where no program of the light is pending."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if has_shadow_layers(paths_out, path):
            distance = paths_out.shadow_distance[path]
            light = paths_out.shadow_light[path]
            if distance > 0.0:
                passed = transmittance(
                    scene, paths_out.shadow_origin[path], paths_out.shadow_direction[path], distance,
                    load_layer(paths_out, path), bounces[0] + 1, shadow_set(scene, paths_out, path))
                light = wp.cw_mul(light, passed.weight)
                paths_out.overruns[path] = paths_out.overruns[path] + passed.overrun
            add_weakened(options, bounces[0], paths_out, path, light)
