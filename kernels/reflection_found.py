# SPDX-License-Identifier: GPL-3.0-or-later
"""What reflection rays find on their way: the world's light and that of surfaces, by their share in it. Functions."""

from __future__ import annotations

import warp as wp

from .cache_materials import sane
from .cache_rays import Vertices
from .environment_split import EnvironmentSplit, excess_radiance, soft_radiance
from .environment_table import environment_pdf
from .geometry_math import max_component, power_heuristic
from .light_linking import emission_counts
from .lights import emitter_pdf, environment_chance
from .paths import ENDED, Paths
from .reflection_lights import emitter_ray_share, world_ray_share
from .reflection_rays import (
    FOUND_EMITTER,
    FOUND_WORLD,
    GATHERED,
    ReflectionRays,
    clear_length,
    comes_straight,
    first_density,
    gather,
    shared_with_samples,
)
from .reflection_types import SAMPLE_FAR
from .types import VISIBLE_DIFFUSE, Scene, ShadingPoint


@wp.func
def miss_light(
    scene: Scene, split: EnvironmentSplit, radiance: wp.vec3, reflection: int, rays: ReflectionRays, paths: Paths,
    vertices: Vertices, slot: int,
):
    """End a ray in the world; `radiance` is the world's there."""
    light = wp.vec3(0.0, 0.0, 0.0)
    if (scene.environment.visibility & paths.kind[slot]) != 0:
        world = sane(radiance)
        density = first_density(reflection, paths, slot)
        share = world_ray_share(split, density, paths.direction[slot])
        light = soft_radiance(world, split.threshold, scene.luminance)
        light = light + excess_radiance(world, split.threshold, scene.luminance) * share
        sampled = paths.kind[slot] == VISIBLE_DIFFUSE or (reflection == GATHERED and density < 0.0)
        if sampled and not comes_straight(paths, slot):
            # Hits that such rays go on from sample the whole world, if anyone does (branch.direct).
            light = world * wp.where(scene.lights.environment_class >= 0, 0.0, 1.0)
        shared = shared_with_samples(rays, paths, slot)
        if density == 0.0 and shared > 0.0 and scene.lights.environment_class >= 0:
            chance = environment_chance(scene, wp.vec3(0.0, 0.0, 0.0))
            light = world * power_heuristic(shared, environment_pdf(scene.environment, paths.direction[slot]) * chance)
    gather(vertices, slot, sane(wp.cw_mul(paths.throughput[slot], light)), SAMPLE_FAR)
    rays.found[slot] = FOUND_WORLD
    paths.state[slot] = ENDED


@wp.func
def add_emission(
    scene: Scene, point: ShadingPoint, emission: wp.vec3, reflection: int, rays: ReflectionRays, paths: Paths,
    vertices: Vertices, slot: int,
):
    """Add what a hit emits, and the way to it."""
    light = wp.vec3(0.0, 0.0, 0.0)
    if max_component(emission) > 0.0:
        before = clear_length(paths, vertices, slot)
        density = first_density(reflection, paths, slot)
        share = emitter_ray_share(
            scene, density, point.instance, point.triangle, paths.origin[slot] - paths.direction[slot] * before,
            paths.direction[slot], point.ray_length + before)
        shared = shared_with_samples(rays, paths, slot)
        if density == 0.0 and shared > 0.0:
            light_pdf = emitter_pdf(
                scene, point.instance, point.triangle, paths.origin[slot], wp.vec3(0.0, 0.0, 0.0),
                paths.direction[slot], point.ray_length)
            share = power_heuristic(shared, light_pdf)
        if emission_counts(scene, point.instance, 1, paths, slot):
            light = sane(wp.cw_mul(paths.throughput[slot], emission) * share)
        rays.found[slot] = FOUND_EMITTER
    gather(vertices, slot, light, point.ray_length)
