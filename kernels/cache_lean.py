# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's kernel for hits whose programs the lean node machine runs: most of them; see cache_materials.py."""

from __future__ import annotations

import warp as wp

from .cache_materials import LEFT, emission_weight, flat_start, hit_point, sane, store_surface, store_world
from .cache_mirrors import Mirrors, over_mirror
from .cache_rays import IDLE, Vertices
from .environment_table import has_texels, texel_of
from .intersect import MISS
from .node_lean import lean_surface, run_lean
from .paths import ENDED, Paths
from .probe_rays import MISS_DISTANCE
from .types import MATERIAL_LEAN_FLAT, VISIBLE_DIFFUSE, VISIBLE_GLOSSY, Scene
from .view import View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def store_miss(
    view: View, scene: Scene, world: wp.array[wp.vec3], bounce: int, threshold: float, filtered: int, paths: Paths,
    mirrors: Mirrors, vertices: Vertices, slot: int,
):
    """Store what a ray brings that missed, as far as that takes no program."""
    vertices.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    vertices.emission[slot] = wp.vec4(0.0, 0.0, 0.0, MISS_DISTANCE)
    kind = VISIBLE_DIFFUSE
    sampled = bounce == 1 and scene.lights.environment_class >= 0
    if over_mirror(mirrors, slot):
        kind = VISIBLE_GLOSSY
        sampled = False
    if (scene.environment.visibility & kind) != 0 and not sampled:
        radiance = scene.environment.radiance
        if scene.environment.constant == 0:
            if not has_texels(world):
                vertices.emission[slot] = wp.vec4(0.0, 0.0, 0.0, LEFT)
                return
            radiance = world[texel_of(scene.environment, paths.direction[slot])]
        store_world(view, scene, sane(radiance), bounce, threshold, filtered, paths, mirrors, vertices, slot)


@wp.func
def evaluate_lean_hit(
    view: View, scene: Scene, world: wp.array[wp.vec3], bounce: int, weighed: int, threshold: float, filtered: int,
    paths: Paths, mirrors: Mirrors, vertices: Vertices, slot: int,
):
    """Find what a ray's hit is made of, or note that the full machine is needed (LEFT)."""
    if paths.hit[slot][0] == MISS:
        store_miss(view, scene, world, bounce, threshold, filtered, paths, mirrors, vertices, slot)
        return
    point = hit_point(view, scene, paths, slot, bounce)
    if (scene.materials.materials[point.material].flags & MATERIAL_LEAN_FLAT) == 0:
        vertices.emission[slot] = wp.vec4(0.0, 0.0, 0.0, LEFT)
        return
    closure = run_lean(scene, point, flat_start(scene, point))
    surface = lean_surface(scene.tables, closure, point)
    share = float(1.0)
    if wp.length_sq(closure.emission) > 0.0:
        share = emission_weight(scene, point, paths, mirrors, slot, bounce == 1 and weighed == 1)
    store_surface(
        view, scene, point, surface.albedo, surface.normal, closure.emission, share, filtered, paths, mirrors, vertices,
        slot)


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
    # Out:
    paths_out: Paths,
    mirrors_out: Mirrors,
    vertices_out: Vertices,
):
    """Do what evaluate_cache_materials does wherever the full machine is not needed, and note where it is (LEFT).

    `world`: its radiance by texels where that is known (DeviceScene.world_texels), which does for rays of this width.
    """
    slot = offset + first + wp.tid()
    if mirrors_out.state.shape[0] > 0:
        mirrors_out.state[slot] = ENDED
    if paths_out.state[slot] == ENDED:
        vertices_out.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
        vertices_out.emission[slot] = wp.vec4(0.0, 0.0, 0.0, IDLE)
        return
    evaluate_lean_hit(
        load_view(views), scene, world, bounce, weighed, threshold, filtered, paths_out, mirrors_out, vertices_out,
        slot)


@wp.kernel(cuda_max_registers=80)
def evaluate_mirrored_lean(
    # In:
    views: wp.array[View],
    scene: Scene,
    world: wp.array[wp.vec3],
    bounce: int,
    weighed: int,
    threshold: float,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    mirrors_out: Mirrors,
    vertices_out: Vertices,
):
    """Do as evaluate_cache_lean for what listed rays have met over a mirror."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        if mirrors_out.state[slot] != ENDED:
            evaluate_lean_hit(
                load_view(views), scene, world, bounce, weighed, threshold, filtered, paths_out, mirrors_out,
                vertices_out, slot)
