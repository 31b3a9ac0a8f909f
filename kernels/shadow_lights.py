# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel for lights whose radiance is a program: textured emitters and a world that varies."""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component
from .intersect import surface_point
from .nodes import run, world_point
from .paths import PENDING_NONE, PENDING_TRIANGLE, Options, Paths, add_light, limit_at, make_hit
from .types import VISIBLE_DIFFUSE, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def shade_lights(
    # In:
    scene: Scene,
    options: Options,
    bounce: int,
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Add the light of the shadow rays that got through, times what the light's program says."""
    path = queue[wp.tid()]
    distance = paths_out.shadow_distance[path]
    pending = paths_out.shadow_pending[path]
    if distance == 0.0 or pending == PENDING_NONE:
        return
    paths_out.shadow_distance[path] = 0.0
    direction = paths_out.shadow_direction[path]
    # Unfiltered: a sun of a few texels must keep the brightness for which the table chose it.
    point = world_point(direction, VISIBLE_DIFFUSE, bounce + 1, 0.0)
    start = scene.materials.world_start
    if pending == PENDING_TRIANGLE:
        hit = make_hit(wp.abs(distance), paths_out.shadow_emitter[path], paths_out.shadow_barycentrics[path])
        point = surface_point(scene, hit, direction)
        point.footprint = paths_out.cone[path][0]
        point.ray_visibility = VISIBLE_DIFFUSE
        point.ray_length = hit.t
        point.ray_depth = bounce + 1
        start = scene.materials.materials[point.material].emission_start
    # One call of the machine for both kinds, see reference.py.
    light = wp.cw_mul(paths_out.shadow_light[path], run(scene, point, start, 0.0).emission)
    if max_component(light) > 0.0:
        add_light(paths_out, path, light, limit_at(options, bounce + 1))
