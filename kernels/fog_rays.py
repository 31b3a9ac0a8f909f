# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog along the rays of frames: those of the radiance cache, of reflections and refraction, and shadow rays.

Launched in scenes with fog alone, between the kernels that find what rays meet and those that take in its light.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import IDLE, Vertices
from .fog import Fog
from .fog_passage import passing_between, through_fog
from .geometry_math import is_finite3
from .intersect import MISS
from .lamp_hit import FAR
from .packing import rgb
from .paths import ENDED, Paths
from .probe_rays import MISS_DISTANCE, ProbeRays
from .reflection_rays import gather
from .sampling import hash_combine, pixel_seed_of
from .types import VISIBLE_DIFFUSE, VISIBLE_SHADOW, Scene
from .view import View, eye_position

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

STREAM = wp.constant(0x464F47)
SHADOW_STREAM = wp.constant(wp.uint32(0x53000000))
"""Sets the numbers of shadow rays' walks apart from all others"""
PLACES = wp.constant(4)
"""Of which segments of reflections and refraction ask for the light of fog: fewer pixels share these rays"""


@wp.func
def ray_seed(view: View, slot: int) -> wp.uint32:
    """Return the seed of a ray's random numbers in this frame."""
    return hash_combine(pixel_seed_of(slot, 0, STREAM), wp.uint32(view.frame))


@wp.kernel
def dim_cache_rays(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    offset: int,
    paths: Paths,
    # Out:
    vertices_out: Vertices,
):
    """Let the fog before what cache rays have hit take its part of what these bring, and add its own light to bounces.

    Comes after their materials. Cells learn of the hits' light as it is there. Other rays get the fog's light once the
    fog's cells have learnt of this frame's (add_fog_light, fog_blend.spread_fog).
    """
    slot = offset + first + wp.tid()
    emission = vertices_out.emission[slot]
    if emission[3] == IDLE:
        return
    view = views[0]
    length = paths.t[slot]
    if paths.hit[slot][0] == MISS:
        length = FAR
    through = through_fog(
        scene, fog, eye_position(view.camera), paths.origin[slot], paths.direction[slot], length, VISIBLE_DIFFUSE, 1,
        ray_seed(view, slot))
    light = wp.cw_mul(rgb(emission), through.passing)
    if slot >= fog.first_ray + fog.levels * fog.side * fog.side * fog.side:
        light = light + through.light
    if not is_finite3(light):
        light = wp.vec3(0.0, 0.0, 0.0)
    vertices_out.emission[slot] = wp.vec4(light[0], light[1], light[2], emission[3])
    r = vertices_out.reflectance[slot]
    left = wp.cw_mul(rgb(r), through.passing)
    vertices_out.reflectance[slot] = wp.vec4(left[0], left[1], left[2], r[3])


@wp.kernel
def add_fog_light(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    # Out:
    rays_out: ProbeRays,
):
    """Add to the answers to probe rays what the fog before their hits adds."""
    slot = first + wp.tid()
    if not rays_out.t_max[slot] > 0.0:
        return
    view = views[0]
    answer = rays_out.radiance[slot]
    length = wp.where(answer[3] < MISS_DISTANCE, answer[3], FAR)
    through = through_fog(
        scene, fog, eye_position(view.camera), rays_out.origin[slot], rays_out.direction[slot], length, VISIBLE_DIFFUSE,
        1, ray_seed(view, slot))
    light = rgb(answer) + through.light * view.exposure
    if is_finite3(light):
        rays_out.radiance[slot] = wp.vec4(light[0], light[1], light[2], answer[3])


@wp.kernel
def dim_fog_segments(
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    segment: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Weaken listed rays of reflections or refraction by the fog on a segment and add its light.

    Comes before what they meet is taken in; `segment` is the number of it.
    """
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        if paths_out.state[slot] != ENDED:
            view = views[0]
            length = paths_out.t[slot]
            if paths_out.hit[slot][0] == MISS:
                length = FAR
            through = through_fog(
                scene, fog, eye_position(view.camera), paths_out.origin[slot], paths_out.direction[slot], length,
                paths_out.kind[slot], PLACES, hash_combine(ray_seed(view, slot), wp.uint32(segment)))
            throughput = paths_out.throughput[slot]
            light = wp.cw_mul(throughput, through.light)
            if is_finite3(light):
                gather(vertices_out, slot, light, 0.0)
            paths_out.throughput[slot] = wp.cw_mul(throughput, through.passing)


@wp.kernel
def dim_shadow_rays(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    offset: int,
    # Out:
    paths_out: Paths,
):
    """Multiply the light of shadow rays that are not traced yet by what fog lets through."""
    slot = offset + first + wp.tid()
    distance = paths_out.shadow_distance[slot]
    if distance > 0.0:
        share = passing_between(
            scene, fog, paths_out.shadow_origin[slot], paths_out.shadow_direction[slot], distance, VISIBLE_SHADOW,
            hash_combine(ray_seed(views[0], slot), SHADOW_STREAM))
        paths_out.shadow_light[slot] = wp.cw_mul(paths_out.shadow_light[slot], share)
