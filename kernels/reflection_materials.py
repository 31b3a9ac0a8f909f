# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that runs the material programs of what reflection rays hit, and the world's of what misses.

It also follows the few rays that are still under way after some segments to their ends: a launch takes at least as
long as its longest ray, so a launch for each segment and kernel costs more than threads that wait for each other.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .environment_split import EnvironmentSplit
from .intersect import MISS
from .layering import prepare_bsdf
from .nodes import run, world_point
from .paths import ENDED, Paths, hit_point
from .reflection_chain import last_of, meet_surface
from .reflection_found import miss_light
from .reflection_rays import DIMENSION_CLOSURE, DIMENSIONS, LEFT, ReflectionRays
from .reflection_tail import trace_segment
from .sampling import sample_pair
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


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
    meet_surface(scene, point, bsdf, reflection, last, rays, paths, vertices, slot)


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
        segments: 0: take in what follow_lean has left of the segment that has been traced. Otherwise trace and take in
            all segments that are left of so many, the last of which ends the rays; first what follow_tail has left.
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
        surfaces = paths_out.state[slot]
        left = vertices_out.reflectance[slot][3] == LEFT
        under_way = surfaces != ENDED and (left or segments > 0)
        while under_way:
            if not left:
                trace_segment(scene, reflection, filtered, rays_out, paths_out, vertices_out, slot)
            final = last
            if segments > 0:
                final = last_of(surfaces, segments)
            follow_one(scene, split, reflection, final, rays_out, paths_out, vertices_out, slot)
            left = False
            surfaces = paths_out.state[slot]
            under_way = segments > 0 and surfaces != ENDED
        i = i + stride
