# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that runs the material programs of what reflection rays hit, and the world's of what misses."""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .environment_split import EnvironmentSplit
from .intersect import MISS
from .layering import prepare_bsdf
from .nodes import run, world_point
from .paths import ENDED, Paths, hit_point
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
from .reflection_glass import sample_transmission
from .reflection_rays import DIMENSION_CLOSURE, DIMENSION_DIRECTION, DIMENSIONS, LEFT, ReflectionRays
from .sampling import sample_pair
from .types import VISIBLE_TRANSMISSION, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def follow_one(
    scene: Scene, split: EnvironmentSplit, reflection: int, last: int, rays: ReflectionRays, paths: Paths,
    vertices: Vertices, slot: int,
):
    """Take in what a segment has met that the lean machine has left."""
    surfaces = paths.state[slot]
    if surfaces == ENDED or vertices.reflectance[slot][3] != LEFT:
        return
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
    albedo = bsdf_albedo(scene.tables, bsdf, point.wo)
    cosine = wp.dot(bsdf.specular_normal, point.wo)
    add_emission(scene, point, bsdf.emission, reflection, rays, paths, vertices, slot)
    lobe = mirror_material(albedo)
    branch = choose_branch(albedo, lobe.specular, last, paths, slot, surfaces)
    if branch.kind == BRANCH_MIRROR:
        mirror_ray(scene, point, albedo, lobe, bsdf.normal, cosine, branch.chance, paths, slot)
    elif branch.kind == BRANCH_GLASS:
        s = sample_transmission(
            bsdf, point.wo, sample_pair(seed, index, DIMENSION_DIRECTION + DIMENSIONS * surfaces))
        follow(point, s.wi, s.weight / branch.chance, s.pdf, VISIBLE_TRANSMISSION, paths, slot)
    else:
        end_ray(point, albedo, lobe.specular, bsdf.normal, branch, rays, paths, vertices, slot)


@wp.kernel
def follow_full(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    reflection: int,
    last: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Take in what the segments of listed rays have met, and send the rays on or end them; `last` 1: end them.

    Only what follow_lean has left. `reflection` 1: the rays are reflections, 0: refracted.
    """
    i = wp.tid()
    while i < count[0]:
        follow_one(scene, split, reflection, last, rays_out, paths_out, vertices_out, queue[i])
        i = i + stride
