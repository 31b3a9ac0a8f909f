# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog along the rays of frames: those of the radiance cache, of reflections and refraction, and shadow rays.

Launched in scenes with fog alone, between the kernels that find what rays meet and those that take in its light.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import IDLE, Vertices
from .fog import Fog, cells_a_grid, scattered_light
from .fog_passage import FogLink, link_fog, passing_between, through_fog
from .geometry_math import is_finite3
from .intersect import MISS
from .lamp_hit import FAR
from .packing import rgb, rgba
from .paths import ENDED, Paths
from .probe_rays import ProbeRays
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


@wp.struct
class FogWays:
    """What fog is on the ways of the radiance cache's rays, one slot a ray."""

    varies: wp.array[int]
    """1: the ray goes through fog that varies"""
    place: wp.array[wp.vec4]
    """Of rays before Fog.first_ray: a place where light is scattered, which stands for all; w = mean cosine of that"""
    weight: wp.array[wp.vec4]
    """Of what is scattered there, in rgb"""


@wp.func
def way_of(
    view: View, scene: Scene, fog: Fog, paths: Paths, slot: int, walks: bool,
) -> FogLink:
    """Return what fog does on a ray's way to its hit; `walks`: see link_fog."""
    length = paths.t[slot]
    if paths.hit[slot][0] == MISS:
        length = FAR
    return link_fog(
        scene, fog, paths.origin[slot], paths.direction[slot], length, VISIBLE_DIFFUSE, 0.0, walks,
        ray_seed(view, slot))


@wp.func
def take_way(view: View, fog: Fog, paths: Paths, slot: int, way: FogLink, vertices_out: Vertices, ways_out: FogWays):
    """Let fog on its way take its part of what a ray brings, and add its own light to bounces.

    Cells learn of the hits' light as it is there. Other rays get what fog scatters once its cells have learnt of this
    frame's light (add_fog_light, fog_cells.spread_fog).
    """
    emission = vertices_out.emission[slot]
    light = wp.cw_mul(rgb(emission), way.passing)
    if slot < fog.first_ray:
        light = light + way.light
        ways_out.place[slot] = rgba(way.place, way.anisotropy)
        ways_out.weight[slot] = rgba(way.weight, 0.0)
    elif slot >= fog.first_ray + fog.levels * cells_a_grid(fog):
        light = light + way.light
        if way.total > 0.0:
            light = light + wp.cw_mul(way.weight, scattered_light(
                fog, eye_position(view.camera), way.place, paths.direction[slot], way.anisotropy, 1,
                ray_seed(view, slot)))
    if not is_finite3(light):
        light = wp.vec3(0.0, 0.0, 0.0)
    vertices_out.emission[slot] = rgba(light, emission[3])
    r = vertices_out.reflectance[slot]
    vertices_out.reflectance[slot] = rgba(wp.cw_mul(rgb(r), way.passing), r[3])


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
    ways_out: FogWays,
):
    """Let the fog before what cache rays have hit take its part, but of those that walk_cache_rays is for.

    Comes after their materials.
    """
    slot = offset + first + wp.tid()
    varies = int(0)
    if vertices_out.emission[slot][3] != IDLE:
        view = views[0]
        way = way_of(view, scene, fog, paths, slot, False)
        varies = way.varies
        if varies == 0:
            take_way(view, fog, paths, slot, way, vertices_out, ways_out)
    ways_out.varies[slot] = varies


@wp.kernel(cuda_max_registers=128)
def walk_cache_rays(
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    vertices_out: Vertices,
    ways_out: FogWays,
):
    """Do the same for listed rays that go through fog that varies: few do, and these take many steps."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        if ways_out.varies[slot] == 1:
            view = views[0]
            way = way_of(view, scene, fog, paths, slot, True)
            take_way(view, fog, paths, slot, way, vertices_out, ways_out)


@wp.kernel
def add_fog_light(
    first: int,
    # In:
    views: wp.array[View],
    fog: Fog,
    ways: FogWays,
    # Out:
    rays_out: ProbeRays,
):
    """Add to the answers to probe rays what the fog before their hits scatters."""
    slot = first + wp.tid()
    if not rays_out.t_max[slot] > 0.0:
        return
    weight = rgb(ways.weight[slot])
    if wp.length_sq(weight) > 0.0:
        view = views[0]
        place = ways.place[slot]
        answer = rays_out.radiance[slot]
        scattered = scattered_light(
            fog, eye_position(view.camera), rgb(place), rays_out.direction[slot], place[3], 1, ray_seed(view, slot))
        light = rgb(answer) + wp.cw_mul(weight, scattered) * view.exposure
        if is_finite3(light):
            rays_out.radiance[slot] = rgba(light, answer[3])


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


@wp.func
def dim_shadow_ray(view: View, scene: Scene, fog: Fog, paths_out: Paths, slot: int):
    """Multiply the light of a shadow ray that is not traced yet, if there is one, by what fog lets through."""
    distance = paths_out.shadow_distance[slot]
    if distance > 0.0:
        share = passing_between(
            scene, fog, paths_out.shadow_origin[slot], paths_out.shadow_direction[slot], distance, VISIBLE_SHADOW,
            hash_combine(ray_seed(view, slot), SHADOW_STREAM))
        paths_out.shadow_light[slot] = wp.cw_mul(paths_out.shadow_light[slot], share)


@wp.kernel(cuda_max_registers=128)
def dim_shadow_rays(
    first: int,
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    # Out:
    paths_out: Paths,
):
    """Multiply the light of shadow rays that are not traced yet by what fog lets through."""
    dim_shadow_ray(views[0], scene, fog, paths_out, first + wp.tid())


@wp.kernel(cuda_max_registers=128)
def dim_listed_shadow_rays(
    # In:
    views: wp.array[View],
    scene: Scene,
    fog: Fog,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Do the same for listed ones."""
    i = wp.tid()
    while i < count[0]:
        dim_shadow_ray(views[0], scene, fog, paths_out, queue[i])
        i = i + stride
