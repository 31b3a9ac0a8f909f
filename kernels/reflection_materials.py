# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that runs the material programs of what reflection rays hit, and the world's of what misses.

It also follows the few rays that are still under way after some segments to their ends: a launch takes at least as
long as its longest ray, so a launch for each segment and kernel costs more than threads that wait for each other.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .environment_split import EnvironmentSplit
from .intersect import MISS, closest_filtered_hit, closest_hit
from .layering import prepare_bsdf
from .layers_lean import filter_path
from .nodes import run, world_point
from .paths import ENDED, Paths, hit_point, load_hit, store_hit, store_layer
from .reflectance import bsdf_albedo
from .reflection_chain import (
    BRANCH_GLASS,
    BRANCH_MIRROR,
    add_emission,
    choose_branch,
    end_ray,
    follow,
    mirror_material,
    mirror_ray,
    miss_light,
)
from .reflection_glass import (
    GlassSample,
    as_cached,
    is_inside,
    sample_inside,
    sample_transmission,
    trapped_albedo,
)
from .reflection_lamps import add_lamps
from .reflection_rays import (
    DIMENSION_CLOSURE,
    DIMENSION_DIRECTION,
    DIMENSION_LOBE,
    DIMENSIONS,
    LEFT,
    ReflectionRays,
)
from .sampling import sample_pair
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def follow_one(
    scene: Scene, split: EnvironmentSplit, reflection: int, last: int, rays: ReflectionRays, paths: Paths,
    vertices: Vertices, slot: int,
):
    """Take in what a segment has met."""
    surfaces = paths.state[slot]
    vertices.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    missed = paths.hit[slot][0] == MISS
    seed = paths.seed[slot]
    index = paths.index[slot]
    point = world_point(paths.direction[slot], paths.kind[slot], surfaces, 0.0)
    start = scene.materials.world_start
    if not missed:
        point = hit_point(scene, paths, slot, surfaces)
        start = scene.materials.materials[point.material].surface_start
    u = sample_pair(seed, index, DIMENSION_CLOSURE + DIMENSIONS * surfaces)
    # One call of the machine for both, see reference.py.
    closure = run(scene, point, start, u[0])
    if missed:
        miss_light(scene, split, closure.emission, reflection, rays, paths, vertices, slot)
        return
    bsdf = prepare_bsdf(scene.tables, closure, point)
    inside = is_inside(bsdf, point)
    outer = bsdf
    if inside:
        outer.pick_glass = 0.0
    albedo = bsdf_albedo(scene.tables, outer, point.wo)
    if inside:
        # Both halves of the glass go on together.
        albedo.transmitted = trapped_albedo(scene.tables, bsdf, point.wo)
    cosine = wp.dot(bsdf.specular_normal, point.wo)
    add_emission(scene, point, bsdf.emission, reflection, rays, paths, vertices, slot)
    lobe = mirror_material(albedo)
    branch = choose_branch(albedo, lobe.specular, last, paths, slot, surfaces)
    if branch.kind == BRANCH_MIRROR:
        mirror_ray(scene, point, albedo, lobe, bsdf.normal, cosine, branch.chance, paths, slot)
    elif branch.kind == BRANCH_GLASS:
        place = sample_pair(seed, index, DIMENSION_DIRECTION + DIMENSIONS * surfaces)
        s = GlassSample()
        if inside:
            choice = sample_pair(seed, index, DIMENSION_LOBE + DIMENSIONS * surfaces)
            s = sample_inside(bsdf, albedo.transmitted, point.wo, place, choice[0], surfaces)
        else:
            s = sample_transmission(bsdf, point.wo, place)
        follow(point, s.wi, s.weight / branch.chance, s.pdf, s.kind, paths, slot)
    else:
        if inside:
            albedo = as_cached(bsdf, albedo, point.wo)
        end_ray(point, albedo, lobe.specular, bsdf.normal, branch, rays, paths, vertices, slot)


@wp.func
def trace_segment(scene: Scene, reflection: int, filtered: int, paths: Paths, vertices: Vertices, slot: int):
    """Find what a segment meets; `filtered` 1: behind transparent layers, all of which the lean machine knows."""
    store_hit(paths, slot, closest_hit(
        scene.geometry, paths.origin[slot], paths.direction[slot], paths.t[slot]))
    if filtered == 1:
        store_layer(paths, slot, closest_filtered_hit(
            scene.geometry, paths.origin[slot], paths.direction[slot], load_hit(paths, slot).t))
        filter_path(scene, paths, slot)
    if scene.lights.lamp_count > 0:
        add_lamps(scene, reflection, paths, vertices, slot)


@wp.kernel
def follow_full(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    reflection: int,
    last: int,
    segments: int,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Take in what listed rays have met, and send them on or end them.

    Args:
        scene: The scene.
        split: Of the world.
        reflection: REFLECTED, REFRACTED or GATHERED.
        last: 1: end them.
        segments: 0: what follow_lean has left of the segment that has been traced. Otherwise trace so many segments
            more and take in all of them; the last ends the rays.
        filtered: For traced segments, whether there are triangles that need a test.
        stride: Number of threads.
        count: Number of rays.
        queue: Their slots.
        rays_out: The rays.
        paths_out: Theirs.
        vertices_out: Theirs.
    """
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        k = int(0)
        under_way = paths_out.state[slot] != ENDED
        if segments == 0:
            under_way = under_way and vertices_out.reflectance[slot][3] == LEFT
        while under_way:
            k = k + 1
            final = last
            if segments > 0:
                trace_segment(scene, reflection, filtered, paths_out, vertices_out, slot)
                final = wp.where(k == segments, 1, 0)
            follow_one(scene, split, reflection, final, rays_out, paths_out, vertices_out, slot)
            under_way = k < segments and paths_out.state[slot] != ENDED
        i = i + stride
