# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's kernel for hits whose programs the lean node machine runs: most of them; see cache_materials.py."""

from __future__ import annotations

import warp as wp

from .cache_materials import LEFT, emission_weight, flat_start, hit_point, sane, store_surface
from .cache_rays import IDLE, Vertices
from .environment_split import NO_THRESHOLD, soft_radiance
from .environment_table import has_texels, texel_of
from .intersect import MISS
from .node_lean import lean_surface, run_lean
from .paths import ENDED, Paths
from .probe_rays import MISS_DISTANCE
from .types import MATERIAL_LEAN_FLAT, VISIBLE_DIFFUSE, Scene
from .view import View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def store_miss(
    scene: Scene, world: wp.array[wp.vec3], bounce: int, threshold: float, direction: wp.vec3, weight: wp.vec3,
    vertices: Vertices, slot: int,
):
    """Store what a ray brings that missed, as far as that takes no program."""
    light = wp.vec3(0.0, 0.0, 0.0)
    seen = (scene.environment.visibility & VISIBLE_DIFFUSE) != 0
    if seen and not (bounce == 1 and scene.lights.environment_class >= 0):
        radiance = scene.environment.radiance
        if scene.environment.constant == 0:
            if not has_texels(world):
                vertices.emission[slot] = wp.vec4(0.0, 0.0, 0.0, LEFT)
                return
            radiance = world[texel_of(scene.environment, direction)]
        limit = wp.where(bounce == 1, NO_THRESHOLD, threshold)
        light = sane(wp.cw_mul(soft_radiance(sane(radiance), limit, scene.luminance), weight))
    vertices.emission[slot] = wp.vec4(light[0], light[1], light[2], MISS_DISTANCE)


@wp.kernel(cuda_max_registers=80)
def evaluate_cache_lean(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    world: wp.array[wp.vec3],
    offset: int,
    bounce: int,
    weighed: int,
    threshold: float,
    filtered: int,
    paths: Paths,
    # Out:
    vertices_out: Vertices,
):
    """Do what evaluate_cache_materials does wherever the full machine is not needed, and note where it is (LEFT).

    `world`: its radiance by texels where that is known (DeviceScene.world_texels), which does for rays of this width.
    """
    slot = offset + first + wp.tid()
    if paths.state[slot] == ENDED:
        vertices_out.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
        vertices_out.emission[slot] = wp.vec4(0.0, 0.0, 0.0, IDLE)
        return
    weight = wp.vec3(1.0, 1.0, 1.0)
    if filtered == 1:
        weight = paths.throughput[slot]
    if paths.hit[slot][0] == MISS:
        vertices_out.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
        store_miss(scene, world, bounce, threshold, paths.direction[slot], weight, vertices_out, slot)
        return
    view = load_view(views)
    point = hit_point(view, scene, paths, slot, bounce)
    if (scene.materials.materials[point.material].flags & MATERIAL_LEAN_FLAT) == 0:
        vertices_out.emission[slot] = wp.vec4(0.0, 0.0, 0.0, LEFT)
        return
    closure = run_lean(scene, point, flat_start(scene, point))
    surface = lean_surface(scene.tables, closure, point)
    share = float(1.0)
    if wp.length_sq(closure.emission) > 0.0:
        share = emission_weight(scene, point, paths, slot, bounce == 1 and weighed == 1)
    store_surface(point, surface.albedo, surface.normal, closure.emission, weight, share, vertices_out, slot)
