# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel for lights whose radiance is a program: textured emitters and a world that varies."""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component
from .intersect import surface_point
from .list_order import first_listed
from .nodes import run, world_point
from .paths import PENDING_TRIANGLE, Options, Paths, add_light, limit_at, make_hit, waits_for_program
from .types import VISIBLE_DIFFUSE, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel
def shade_lights(
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
    """Add the light of the shadow rays that got through, times what the light's program says."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if waits_for_program(paths_out, path):
            distance = paths_out.shadow_distance[path]
            paths_out.shadow_distance[path] = 0.0
            direction = paths_out.shadow_direction[path]
            # Unfiltered: a sun of a few texels must keep the brightness for which the table chose it.
            point = world_point(direction, VISIBLE_DIFFUSE, bounces[0] + 1, 0.0)
            start = scene.materials.world_start
            if paths_out.shadow_pending[path] == PENDING_TRIANGLE:
                hit = make_hit(wp.abs(distance), paths_out.shadow_emitter[path], paths_out.shadow_barycentrics[path])
                point = surface_point(scene, hit, direction)
                point.footprint = paths_out.cone[path][0]
                point.ray_visibility = VISIBLE_DIFFUSE
                point.ray_length = hit.t
                point.ray_depth = bounces[0] + 1
                start = scene.materials.materials[point.material].emission_start
            # One call of the machine for both kinds, see reference.py.
            light = wp.cw_mul(paths_out.shadow_light[path], run(scene, point, start, 0.0).emission)
            if max_component(light) > 0.0:
                add_light(paths_out, path, light, limit_at(options, bounces[0] + 1))
