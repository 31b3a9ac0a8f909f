# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels by which rays of real-time frames go below surfaces, and on outside of where they come out.

What is below is a material's program's to say; the walks that it is for are in reflection_walks.py.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices, cell_seed, hit_place
from .channel_walk import place_about, profile_radius
from .gather_start import PDF_MIN
from .gbuffer import GBuffer, load_surface
from .gbuffer_store import closure_number, stored_point
from .geometry_math import INV_PI, TWO_PI, max_component, mean_component, to_frame
from .hash_grid import HashGrid, cell_key, cell_level, coarse_key, find_key, indirect_of
from .homes import CellPlace
from .intersect import surface_point
from .layering import unit_normal
from .nodes import run
from .normals import valid_specular_normal
from .packing import unpack_normal
from .paths import Paths, load_hit
from .reflection_rays import (
    DIMENSION_DIRECTION,
    DIMENSION_LOBE,
    FOUND_DIRECT,
    FOUND_EXIT,
    FOUND_NONE,
    ReflectionRays,
    ray_count,
    send_ray,
)
from .reflection_types import SAMPLE_FAR, ReflectionOptions, ReflectionSamples, sample_pixel
from .reflection_walks import KNOWN_SAMPLES, NO_WALK, WALKS, Walks, goes_below, pixel_showing
from .sampling import hash_combine, hashed_unit, sample_cosine, sample_number, sample_pair
from .subsurface import entry_direction, medium_of, plane_albedo, spread_distance
from .subsurface_walk import FAR_SIDE, WALK_SEED, meet_other
from .types import VISIBLE_DIFFUSE, Scene, ShadingPoint
from .view import View, pixel_footprint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Chance with which a place whose light the cache does not know brings its direct light.
DIRECT_CHANCE = wp.constant(0.5)
# Thickness of an object, in mean distances of light, from which on what is below a surface has no end for it.
THICK = wp.constant(4.0)
# Places that are looked at to tell whether a surface is flat, and how far off, in mean distances of light.
LOOKS = wp.constant(4)
LOOKED_FAR = wp.constant(2.5)
# What they must have to lie in its plane: distance from it in mean distances of light, cosine of the normals.
FLATNESS = wp.constant(0.3)
FLAT_COSINE = wp.constant(0.9)
# Draws from the profile before a walk stands in, where the frame does not show what is drawn.
DRAWS = wp.constant(3)
DIMENSION_PROFILE = wp.constant(510)
STREAM_LOOKS = wp.constant(wp.uint32(0x4C4F4F4B))
# Distance to a hit that filters go by, in those over which light spreads: they blur less than that has done already.
FILTER_DISTANCE = wp.constant(3.0)


@wp.func
def thickness_below(scene: Scene, point: ShadingPoint, reach: float) -> float:
    """Return how far the other side of an object is below a point [m]; 0: farther than `reach`, or there is none."""
    # load_instance leaves out the mesh.
    instance = scene.geometry.instances[point.instance]
    start = point.position - point.geometric_normal * point.error
    found = meet_other(
        instance, start, -point.geometric_normal, reach, point.triangle - instance.triangle_offset, point.error)
    return wp.where(found.face >= 0, found.t, 0.0)


@wp.func
def nearby_pixel(
    view: View, options: ReflectionOptions, gbuffer: GBuffer, point: ShadingPoint, position: wp.vec3, spread: float,
) -> int:
    """Return the pixel that shows a place in a point's plane; -1 where it shows no plane."""
    place = point
    place.position = position
    pixel = pixel_showing(view, options, gbuffer, place, FLATNESS * spread, FLAT_COSINE)
    if pixel >= 0:
        seen = load_surface(view, gbuffer, options.width, pixel)
        if wp.length(seen.position - place.position) > wp.max(spread, 2.0 * pixel_footprint(view.camera, seen.depth)):
            pixel = -1
    return pixel


@wp.func
def is_flat_about(
    view: View, options: ReflectionOptions, gbuffer: GBuffer, point: ShadingPoint, spread: float, number: wp.uint32,
) -> bool:
    """Return whether some places about a point lie in its plane; which ones is chance."""
    flat = bool(True)
    k = int(0)
    while k < LOOKS and flat:
        angle = TWO_PI * (hashed_unit(number, STREAM_LOOKS) + float(k)) / float(LOOKS)
        position = place_about(point, LOOKED_FAR * spread, angle)
        flat = nearby_pixel(view, options, gbuffer, point, position, spread) >= 0
        k = k + 1
    return flat


@wp.func
def draw_nearby(
    view: View, options: ReflectionOptions, gbuffer: GBuffer, point: ShadingPoint, spread: float, seed: wp.uint32,
    index: wp.uint32,
) -> int:
    """Draw a pixel where light goes in that comes out at a point, by the profile below a plane; -1: it is no plane."""
    pixel = int(-1)
    if is_flat_about(view, options, gbuffer, point, spread, hash_combine(seed, index)):
        k = int(0)
        while k < DRAWS and pixel < 0:
            angle = TWO_PI * sample_number(seed, index, DIMENSION_PROFILE + 2 * k + 1)
            radius = profile_radius(spread, sample_pair(seed, index, DIMENSION_PROFILE + 2 * k))
            pixel = nearby_pixel(view, options, gbuffer, point, place_about(point, radius, angle), spread)
            k = k + 1
    return pixel


@wp.kernel
def enter_surfaces(
    # In:
    views: wp.array[View],
    scene: Scene,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    samples: ReflectionSamples,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    walks_out: Walks,
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Find out what is below the pixels of those listed rays that go there, and which channels walk.

    Where the surface is about flat and the body thick, for what a channel spreads, the profile tells a place.
    """
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        for c in range(3):
            walks_out.face[3 * slot + c] = NO_WALK
        if not goes_below(options, rays_out, slot):
            continue
        view = views[0]
        pixel = sample_pixel(options, samples, rays_out.block[slot])
        point = stored_point(view, scene, gbuffer, options.width, pixel)
        closure = run(
            scene, point, scene.materials.materials[point.material].surface_start,
            closure_number(view, options.width, pixel))
        seed = hash_combine(paths_out.seed[slot], WALK_SEED)
        index = paths_out.index[slot]
        paths_out.seed[slot] = seed
        normal = valid_specular_normal(
            point.geometric_normal, point.wo, unit_normal(closure.normal, point.normal))
        paths_out.direction[slot] = entry_direction(closure, normal, point.wo, sample_pair(seed, index, 0))
        medium = medium_of(closure)
        walks_out.medium[slot] = medium
        spread = spread_distance(closure, medium)
        # As far as walks look for it, too.
        far = FAR_SIDE / wp.min(medium.extinction[0], wp.min(medium.extinction[1], medium.extinction[2]))
        depth = thickness_below(scene, point, wp.max(THICK * max_component(spread), far))
        walks_out.depth[slot] = depth
        weight = paths_out.throughput[slot]
        nearby = wp.vec3i(-1, -1, -1)
        enters = wp.dot(paths_out.direction[slot], point.geometric_normal) < 0.0
        for c in range(3):
            if weight[c] > 0.0 and enters:
                if depth == 0.0 or depth > THICK * spread[c]:
                    nearby[c] = draw_nearby(
                        view, options, gbuffer, point, spread[c], hash_combine(seed, wp.uint32(c)), index)
                walks_out.face[3 * slot + c] = wp.where(nearby[c] < 0, WALKS, NO_WALK)
        walks_out.nearby[slot] = nearby
        walks_out.share[slot] = wp.cw_mul(weight, plane_albedo(closure, normal, point.wo))
        spread_mean = mean_component(spread)
        vertices_out.emission[slot] = wp.vec4(
            0.0, 0.0, 0.0, wp.clamp(FILTER_DISTANCE * spread_mean, 0.0, SAMPLE_FAR))


@wp.func
def knows_indirect(grid: HashGrid, view: View, place: CellPlace, direction: wp.vec3, seed: wp.uint32) -> bool:
    """Return whether the cache knows the indirect light of a place from near by."""
    level = cell_level(grid, view, place.position, seed)
    known = indirect_of(grid, find_key(grid, cell_key(grid, level, place, direction)))
    if known[3] < KNOWN_SAMPLES:
        known = indirect_of(grid, find_key(grid, coarse_key(grid, view, place, direction, seed)))
    return known[3] >= KNOWN_SAMPLES


@wp.kernel
def go_on_outside(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    options: ReflectionOptions,
    grid: HashGrid,
    # Out:
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Send rays on from places that the frame does not show, where the cache does not know their light either."""
    slot = first + wp.tid()
    if slot >= ray_count(rays_out, options.columns * options.rows):
        return
    if rays_out.found[slot] != FOUND_EXIT:
        return
    view = views[0]
    side = unpack_normal(vertices_out.geometric_normal[slot])
    place = hit_place(grid, paths_out, vertices_out, slot)
    if knows_indirect(grid, view, place, paths_out.direction[slot], cell_seed(slot, view.frame)):
        return
    seed = paths_out.seed[slot]
    index = paths_out.index[slot]
    paths_out.throughput[slot] = paths_out.throughput[slot] / DIRECT_CHANCE
    if sample_number(seed, index, DIMENSION_LOBE) < DIRECT_CHANCE:
        rays_out.found[slot] = FOUND_DIRECT
        return
    rays_out.found[slot] = FOUND_NONE
    vertices_out.reflectance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    point = surface_point(scene, load_hit(paths_out, slot), paths_out.direction[slot])
    local = sample_cosine(sample_pair(seed, index, DIMENSION_DIRECTION))
    direction = wp.normalize(to_frame(unpack_normal(vertices_out.normal[slot]), local))
    # Below the triangle it is absorbed.
    if wp.dot(direction, side) > 0.0:
        paths_out.pdf[slot] = wp.max(local[2] * INV_PI, PDF_MIN)
        # It has met a surface more than the pixel's: light samples there show all of the world that they know.
        send_ray(scene, paths_out, slot, point, direction, VISIBLE_DIFFUSE, 2)
