# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's kernel for lights whose radiance is a program: textured emitters and a world that varies."""

from __future__ import annotations

import warp as wp

from .geometry_math import is_finite3
from .intersect import surface_point
from .nodes import run, world_point
from .paths import PENDING_NONE, PENDING_TRIANGLE, Paths, make_hit
from .types import VISIBLE_DIFFUSE, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def finish_cache_lights(
    first: int,
    # In:
    scene: Scene,
    # Out:
    paths_out: Paths,
):
    """Keep the light of the shadow rays that got through, times what the light's program says."""
    slot = first + wp.tid()
    distance = paths_out.shadow_distance[slot]
    pending = paths_out.shadow_pending[slot]
    if distance == 0.0 or pending == PENDING_NONE:
        return
    paths_out.shadow_distance[slot] = 0.0
    direction = paths_out.shadow_direction[slot]
    # Unfiltered: a sun of a few texels must keep the brightness for which the table chose it.
    point = world_point(direction, VISIBLE_DIFFUSE, 2, 0.0)
    start = scene.materials.world_start
    if pending == PENDING_TRIANGLE:
        hit = make_hit(wp.abs(distance), paths_out.shadow_emitter[slot], paths_out.shadow_barycentrics[slot])
        point = surface_point(scene, hit, direction)
        point.ray_visibility = VISIBLE_DIFFUSE
        point.ray_length = hit.t
        point.ray_depth = 2
        start = scene.materials.materials[point.material].emission_start
    # One call of the machine for both kinds, see reference.py.
    light = wp.cw_mul(paths_out.shadow_light[slot], run(scene, point, start, 0.0).emission)
    if is_finite3(light):
        light = wp.max(light, wp.vec3(0.0, 0.0, 0.0))
        paths_out.radiance[slot] = wp.vec4(light[0], light[1], light[2], paths_out.radiance[slot][3])
