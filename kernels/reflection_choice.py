# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that chooses a light for every hit of a reflection ray: the best of a few, before one shadow ray.

What a mirror shows is not blurred afterwards as the cache's cells are, so the choice is worth more here: resampled
importance sampling (Talbot et al. 2005) by the light that would arrive unshadowed. It needs to know what lights emit:
where that is a program the hit gets one sample, as in the cache.
"""

from __future__ import annotations

import warp as wp

from .cache_lights import sampled_density, send_to_light
from .cache_rays import Vertices
from .environment_table import texel_of
from .geometry_math import mean_component
from .hash_grid import NO_CELL, HashGrid
from .intersect import surface_point, triangle_material
from .lamp_sample import LightSample
from .light_linking import kinds_lit
from .lights import cell_side, sample_light
from .packing import unpack_normal
from .paths import Paths, has_hit, load_hit
from .reflection_rays import FOUND_DIRECT, ReflectionRays
from .sampling import BELOW_ONE, hashed_unit, sample_number, sample_pair
from .types import LIGHT_ENVIRONMENT, LIGHT_TRIANGLE, VISIBLE_DIFFUSE, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Dimensions of the candidates' random numbers, three for each.
DIMENSION_CANDIDATE = wp.constant(400)
STREAM_PICK = wp.constant(wp.uint32(0x5049434B))


@wp.func
def emitted(scene: Scene, world: wp.array[wp.vec3], s: LightSample) -> wp.vec3:
    """Return what a light sample's radiance is to be multiplied by, as set_shadow_ray does it; 1 for programs."""
    if s.kind == LIGHT_TRIANGLE:
        return scene.materials.materials[triangle_material(scene, s.instance, s.triangle)].emission
    if s.kind == LIGHT_ENVIRONMENT:
        if scene.environment.constant == 0:
            return world[texel_of(scene.environment, s.wi)]
        return scene.environment.radiance
    return wp.vec3(1.0, 1.0, 1.0)


@wp.kernel
def choose_reflection_lights(
    # In:
    first: int,
    scene: Scene,
    world: wp.array[wp.vec3],
    grid: HashGrid,
    candidates: int,
    # Out:
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Choose one of `candidates` samples of light at every hit and set up its shadow ray; see choose_cache_lights.

    The cells take these samples in, and know the rest of what triangles emit by their bounce rays (`grid.weighed`).
    Hits that show direct light alone (FOUND_DIRECT) need all of it and give nothing to cells.
    """
    slot = first + wp.tid()
    paths_out.shadow_distance[slot] = 0.0
    paths_out.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if not has_hit(paths_out, slot) or scene.lights.class_count == 0:
        return
    reflectance = vertices_out.reflectance[slot]
    if not wp.max(reflectance[0], wp.max(reflectance[1], reflectance[2])) > 0.0:
        return
    point = surface_point(scene, load_hit(paths_out, slot), paths_out.direction[slot])
    normal = unpack_normal(vertices_out.normal[slot])
    weighed = grid.weighed
    if rays_out.found[slot] == FOUND_DIRECT:
        weighed = 0
        vertices_out.cell[slot] = NO_CELL
    seed = paths_out.seed[slot]
    index = paths_out.index[slot]
    side = cell_side(normal, reflectance[3], weighed)
    chosen = LightSample()
    target = float(0.0)
    total = float(0.0)
    k = int(0)
    while k < candidates:
        dimension = DIMENSION_CANDIDATE + 3 * k
        # Stratified over the classes of lights.
        u = sample_pair(seed, index, dimension)
        choice = wp.min((float(k) + u[0]) / float(candidates), BELOW_ONE)
        s = sample_light(
            scene, point.position, side, wp.vec2(choice, u[1]), sample_number(seed, index, dimension + 1))
        if s.kind >= 0 and (kinds_lit(scene, s.visibility, point.instance) & VISIBLE_DIFFUSE) != 0:
            value = wp.float32(1.0)
            if candidates > 1:
                value = mean_component(wp.cw_mul(s.radiance, emitted(scene, world, s)))
            density = sampled_density(normal, reflectance[3], weighed, s)
            weight = value * density / s.pdf
            if weight > 0.0 and wp.isfinite(weight):
                total = total + weight
                if hashed_unit(seed ^ STREAM_PICK, index * wp.uint32(candidates) + wp.uint32(k)) * total < weight:
                    chosen = s
                    target = value
        k = k + 1
    if not target > 0.0:
        return
    light = chosen.radiance * (total / (target * float(candidates)))
    send_to_light(scene, world, grid.ways, point, chosen, light, paths_out, slot)
