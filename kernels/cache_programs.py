# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's kernel for lights whose radiance is a program: textured emitters and a world that varies."""

from __future__ import annotations

import warp as wp

from .geometry_math import is_finite3
from .intersect import surface_point
from .nodes import run, world_point
from .paths import PENDING_TRIANGLE, Paths, make_hit, waits_for_program
from .types import VISIBLE_DIFFUSE, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def finish_light(scene: Scene, paths: Paths, slot: int):
    """Keep the light of one shadow ray, if it waits for a program."""
    if not waits_for_program(paths, slot):
        return
    distance = paths.shadow_distance[slot]
    paths.shadow_distance[slot] = 0.0
    direction = paths.shadow_direction[slot]
    # Unfiltered: a sun of a few texels must keep the brightness for which the table chose it.
    point = world_point(direction, VISIBLE_DIFFUSE, 2, 0.0)
    start = scene.materials.world_start
    if paths.shadow_pending[slot] == PENDING_TRIANGLE:
        hit = make_hit(wp.abs(distance), paths.shadow_emitter[slot], paths.shadow_barycentrics[slot])
        point = surface_point(scene, hit, direction)
        point.ray_visibility = VISIBLE_DIFFUSE
        point.ray_length = hit.t
        point.ray_depth = 2
        start = scene.materials.materials[point.material].emission_start
    # One call of the machine for both kinds, see reference.py.
    light = wp.cw_mul(paths.shadow_light[slot], run(scene, point, start, 0.0).emission)
    if is_finite3(light):
        light = wp.max(light, wp.vec3(0.0, 0.0, 0.0))
        paths.radiance[slot] = wp.vec4(light[0], light[1], light[2], paths.radiance[slot][3])


@wp.kernel
def finish_cache_lights(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Keep the light of the listed shadow rays that got through, times what the light's program says."""
    i = wp.tid()
    while i < count[0]:
        finish_light(scene, paths_out, queue[i])
        i = i + stride
