# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel for reflection rays whose hits the lean node machine runs, most of them; see reflection_materials.py."""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .environment_split import EnvironmentSplit
from .environment_table import has_texels, texel_of
from .geometry_math import PI
from .intersect import MISS
from .node_lean import plain_bsdf, run_lean
from .paths import ENDED, Paths, hit_point
from .reflection_chain import meet_surface
from .reflection_found import miss_light
from .reflection_rays import LEFT, ReflectionRays
from .types import MATERIAL_PLAIN, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Texels of the world's table that a ray's lobe must cover for it to take a texel's mean.
TEXELS_COVERED = wp.constant(16.0)


@wp.func
def texel_behind(
    scene: Scene, split: EnvironmentSplit, world: wp.array[wp.vec3], direction: wp.vec3, pdf: float,
) -> int:
    """Return the texel that stands for the world along a ray drawn with density `pdf`; -1: its program must be run.

    That is so for mirrors, and where a texel holds excess: light samples know it more closely.
    """
    if not has_texels(world):
        return -1
    largest = 2.0 * PI * PI / float(scene.environment.width * scene.environment.height)
    if pdf * largest * TEXELS_COVERED > 1.0:
        return -1
    texel = texel_of(scene.environment, direction)
    if split.share > 0.0:
        if split.table.weight[texel] > 0.0:
            return -1
    return texel


@wp.func
def follow_one(
    scene: Scene, split: EnvironmentSplit, world: wp.array[wp.vec3], reflection: int, last: int, rays: ReflectionRays,
    paths: Paths, vertices: Vertices, slot: int,
):
    """Take in what a segment has met, if the lean machine can."""
    surfaces = paths.state[slot]
    if surfaces == ENDED:
        return
    if paths.hit[slot][0] == MISS:
        radiance = scene.environment.radiance
        if scene.environment.constant == 0:
            texel = texel_behind(scene, split, world, paths.direction[slot], paths.pdf[slot])
            if texel < 0:
                vertices.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, LEFT)
                return
            radiance = world[texel]
        miss_light(scene, split, radiance, reflection, rays, paths, vertices, slot)
        return
    point = hit_point(scene, paths, slot, surfaces)
    if (scene.materials.materials[point.material].flags & MATERIAL_PLAIN) == 0:
        vertices.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, LEFT)
        return
    closure = run_lean(scene, point, scene.materials.materials[point.material].surface_start)
    bsdf = plain_bsdf(scene.tables, closure, point)
    meet_surface(scene, point, bsdf, reflection, last, rays, paths, vertices, slot)


@wp.kernel(cuda_max_registers=128)
def follow_lean(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    world: wp.array[wp.vec3],
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
    """Do what follow_full does wherever the full machine is not needed, and note where it is (LEFT).

    `world`: its radiance by texels where that is known (DeviceScene.world_texels).
    """
    i = wp.tid()
    while i < count[0]:
        follow_one(scene, split, world, reflection, last, rays_out, paths_out, vertices_out, queue[i])
        i = i + stride
