# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels that find where light has gone into an object that comes out of it at a pixel, in real-time frames.

One place for each block of pixels, channel and frame: as the channels spread light over different distances, noise of
what all share would be coloured. Where the surface is about flat and the body thick, the profile of diffusion tells the
place, else a walk (channel_walk.py). What goes in there is what this frame finds, where it shows the place, or what the
radiance cache knows. Others are lit as other rays' hits are, as white and diffuse, by a light sample and the cache;
where that knows no indirect light, as few rays meet the backs of things, half of the rays go on for it
(reflection_below.py).
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .channel_walk import walk_channel
from .composite import Lights, indirect_light, light_or_none
from .gbuffer import GBuffer, load_surface, plane_distance
from .gbuffer_store import stored_point
from .geometry_math import finite_or_zero
from .hash_grid import NO_CELL, HashGrid, find_lit_cell, read_cell
from .homes import cell_place
from .intersect import surface_point
from .light_linking import note_receiver
from .packed_halves import pack_halves, unpack_halves
from .packing import HALF_MAX, pack_normal, pack_unorm16, rgb, rgba, unpack_normal, unpack_unorm16
from .paths import ENDED, Paths, make_hit
from .reflection_rays import FOUND_BELOW, FOUND_EXIT, FOUND_NONE, ReflectionRays, ray_count
from .reflection_resolve import CELL_SAMPLES
from .reflection_types import ReflectionOptions, ReflectionSamples, sample_pixel
from .sampling import hash_combine, hashed_unit
from .subsurface import Medium
from .types import Scene, ShadingPoint
from .view import View, pixel_footprint, pixel_of, project
from .wide_loads import load_vec4h

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Walks.face of channels that have not walked yet, and of those that won't or have not come out.
WALKS = wp.constant(-2)
NO_WALK = wp.constant(-1)
# What a pixel must have to show a place: cosine of the normals, distance from its plane in pixels' widths.
SEEN_COSINE = wp.constant(0.7)
SEEN_PIXELS = wp.constant(2.0)
# Samples of indirect light in a cell from which on it answers for a place in it.
KNOWN_SAMPLES = wp.constant(4.0)
# Chance with which a place that its cell answers for gets a light sample all the same.
LEARNING = wp.constant(0.25)
STREAM_HIDDEN = wp.constant(wp.uint32(0x48494444))


@wp.struct
class Walks:
    """What rays below surfaces have found so far: one entry a ray, from `face` to `brought` three for the channels."""

    medium: wp.array[Medium]
    depth: wp.array[float]
    """Of the other side of the object below the pixel [m], 0 where it is far"""
    face: wp.array[int]
    """Of the object, that the channel's walk has met; WALKS: it is under way, NO_WALK: there is none"""
    place: wp.array[wp.uint32]
    """pack_unorm16 of the weights of the face's second and third vertex"""
    arriving: wp.array[wp.uint32]
    """pack_normal of the direction of a ray from outside"""
    brought: wp.array[float]
    """What the light that goes in there is worth"""
    share: wp.array[wp.vec3]
    """Of all that the ray stands for: what is to be multiplied by light that goes in near by"""
    nearby: wp.array[wp.vec3i]
    """Pixel that the profile tells instead of a walk, for each channel; -1: none"""
    pixel: wp.array[wp.vec3i]
    """Those of the places that walks have found, where the frame shows them"""
    weight: wp.array[wp.vec3]
    """What the light that goes in there is worth; 0: there is none"""
    light: wp.array[wp.vec3]
    """What is known already of other places, exposed"""


@wp.func
def goes_below(options: ReflectionOptions, rays: ReflectionRays, slot: int) -> bool:
    """Return whether a slot holds a ray that goes below its surface."""
    if slot >= ray_count(rays, options.columns * options.rows):
        return False
    return rays.found[slot] == FOUND_BELOW


@wp.kernel
def append_below(
    # In:
    options: ReflectionOptions,
    rays: ReflectionRays,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """List the rays that go below the surface (CUDA only, see compaction.py)."""
    slot = wp.tid()
    if goes_below(options, rays, slot):
        queue_out[wp.atomic_add(count_out, 0, 1)] = slot


@wp.kernel
def append_walks(
    # In:
    options: ReflectionOptions,
    rays: ReflectionRays,
    walks: Walks,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """List the walks, three a ray at most (CUDA only)."""
    item = wp.tid()
    if goes_below(options, rays, item // 3):
        if walks.face[item] == WALKS:
            queue_out[wp.atomic_add(count_out, 0, 1)] = item


@wp.func
def pixel_showing(
    view: View, options: ReflectionOptions, gbuffer: GBuffer, place: ShadingPoint, slack: float, cosine: float,
) -> int:
    """Return the pixel of this frame that shows a place of an object; -1 for none.

    It lies up to `slack` [m] off the place's plane, or two of its widths, and has a normal of that least `cosine`.
    """
    film = project(view.camera, place.position)
    pixel = pixel_of(view.camera, view.jitter, film, options.width, options.height)
    if pixel < 0:
        return -1
    if gbuffer.hit[pixel][0] != place.instance:
        return -1
    seen = load_surface(view, gbuffer, options.width, pixel)
    if wp.dot(seen.geometric_normal, place.geometric_normal) < cosine:
        return -1
    if plane_distance(seen, place.position) > wp.max(slack, SEEN_PIXELS * pixel_footprint(view.camera, seen.depth)):
        return -1
    return pixel


@wp.func
def cell_light(grid: HashGrid, view: View, place: ShadingPoint, arriving: wp.vec3, seed: wp.uint32) -> wp.vec4:
    """Return irradiance / pi at a place as its cell has it; w = 0 where that has too few samples."""
    at = cell_place(grid.homes, place.instance, place.position, place.geometric_normal)
    cell = find_lit_cell(grid, view, at, arriving, seed)
    if cell == NO_CELL:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    if grid.direct[cell][3] < CELL_SAMPLES or grid.indirect[cell][3] < KNOWN_SAMPLES:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    return read_cell(grid, cell)


@wp.func
def make_hit_of(
    place: ShadingPoint, arriving: wp.vec3, distance: float, rays: ReflectionRays, paths: Paths, vertices: Vertices,
    slot: int,
):
    """Let a ray end at a place where light goes in, for the cache's kernels to light."""
    paths.hit[slot] = wp.vec2i(place.instance, place.triangle)
    paths.barycentrics[slot] = wp.vec2(place.u, place.v)
    paths.direction[slot] = arriving
    # For the choice between the place's own light and that of its cell.
    paths.t[slot] = distance
    p = place.position
    vertices.position[slot] = wp.vec4(p[0], p[1], p[2], place.error)
    vertices.geometric_normal[slot] = pack_normal(place.geometric_normal)
    vertices.normal[slot] = pack_normal(place.normal)
    vertices.reflectance[slot] = wp.vec4(1.0, 1.0, 1.0, 0.0)
    rays.found[slot] = FOUND_EXIT
    if rays.glossy == 1:
        rays.lobe[slot] = wp.uint64(0)


@wp.kernel
def walk_below_pixels(
    # In:
    views: wp.array[View],
    scene: Scene,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    samples: ReflectionSamples,
    rays: ReflectionRays,
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    walks_out: Walks,
):
    """Walk below the pixels of the listed channels of rays (append_walks), each for itself."""
    i = wp.tid()
    while i < count[0]:
        item = queue[i]
        i = i + stride
        slot = item // 3
        c = item % 3
        if goes_below(options, rays, slot):
            if walks_out.face[item] == WALKS:
                point = stored_point(
                    views[0], scene, gbuffer, options.width, sample_pixel(options, samples, rays.block[slot]))
                # load_instance leaves out the mesh.
                instance = scene.geometry.instances[point.instance]
                medium = walks_out.medium[slot]
                end = walk_channel(
                    instance, point, medium.extinction[c], medium.albedo[c], medium.anisotropy, walks_out.depth[slot],
                    paths.direction[slot], paths.throughput[slot][c] * medium.factor[c],
                    hash_combine(paths.seed[slot], wp.uint32(c)), paths.index[slot])
                walks_out.face[item] = NO_WALK
                if end.met.face >= 0:
                    walks_out.face[item] = end.met.face
                    walks_out.place[item] = pack_unorm16(end.met.u, end.met.v)
                    walks_out.arriving[item] = pack_normal(-end.direction)
                    walks_out.brought[item] = end.weight


@wp.func
def settle(
    view: View, scene: Scene, options: ReflectionOptions, gbuffer: GBuffer, grid: HashGrid, point: ShadingPoint,
    walks: Walks, rays: ReflectionRays, paths: Paths, vertices: Vertices, slot: int,
):
    """Look for the light of the places that a ray's walks have found.

    Of those that neither the frame shows nor the cache knows chance takes one, as a hit; now and then it is one that
    the cache does know, which must learn of changes.
    """
    instance = scene.geometry.instances[point.instance]
    pixels = wp.vec3i(-1, -1, -1)
    weights = wp.vec3(0.0, 0.0, 0.0)
    light = wp.vec3(0.0, 0.0, 0.0)
    unknown = int(0)
    kept = wp.vec3(0.0, 0.0, 0.0)
    chosen = ShadingPoint()
    chosen.instance = -1
    chosen_from = wp.vec3(0.0, 0.0, 0.0)
    c = int(0)
    while c < 3:
        item = 3 * slot + c
        if walks.face[item] >= 0:
            arriving = unpack_normal(walks.arriving[item])
            hit = make_hit(
                0.0, wp.vec2i(point.instance, instance.triangle_offset + walks.face[item]),
                unpack_unorm16(walks.place[item]))
            place = surface_point(scene, hit, arriving)
            pixel = pixel_showing(view, options, gbuffer, place, 0.0, SEEN_COSINE)
            if pixel >= 0:
                pixels[c] = pixel
                weights[c] = walks.brought[item]
            else:
                number = hash_combine(hash_combine(paths.seed[slot], wp.uint32(c)), paths.index[slot] ^ STREAM_HIDDEN)
                u = hashed_unit(number, wp.uint32(0))
                known = cell_light(grid, view, place, arriving, number)
                takes = bool(False)
                if known[3] > 0.0:
                    light[c] = walks.brought[item] * known[c] * view.exposure
                    takes = unknown == 0 and u < LEARNING
                else:
                    unknown = unknown + 1
                    takes = u * float(unknown) < 1.0
                    if takes:
                        kept = wp.vec3(0.0, 0.0, 0.0)
                        kept[c] = walks.brought[item]
                if takes:
                    chosen = place
                    chosen_from = arriving
        c = c + 1
    walks.pixel[slot] = pixels
    walks.weight[slot] = weights
    walks.light[slot] = light
    paths.state[slot] = ENDED
    rays.found[slot] = FOUND_NONE
    if chosen.instance >= 0:
        paths.throughput[slot] = kept * float(unknown)
        note_receiver(scene, chosen.instance, paths, slot)
        make_hit_of(chosen, chosen_from, wp.length(chosen.position - point.position), rays, paths, vertices, slot)


@wp.kernel
def settle_walks(
    # In:
    views: wp.array[View],
    scene: Scene,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    samples: ReflectionSamples,
    grid: HashGrid,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    walks_out: Walks,
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Find what is known of the light that goes in where the walks of those listed rays that go below have ended."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        if goes_below(options, rays_out, slot):
            view = views[0]
            point = stored_point(
                view, scene, gbuffer, options.width, sample_pixel(options, samples, rays_out.block[slot]))
            settle(view, scene, options, gbuffer, grid, point, walks_out, rays_out, paths_out, vertices_out, slot)


@wp.func
def light_going_in(gbuffer: GBuffer, lights: Lights, pixel: int) -> wp.vec3:
    """Return irradiance / pi at the surface of a pixel, exposed."""
    arrives = light_or_none(load_vec4h(lights.direct_diffuse, pixel)) + indirect_light(gbuffer, lights, pixel)
    return wp.max(arrives, wp.vec3(0.0, 0.0, 0.0))


@wp.kernel
def add_seen_light(
    # In:
    first: int,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    lights: Lights,
    rays: ReflectionRays,
    # Out:
    walks_out: Walks,
    samples_out: ReflectionSamples,
):
    """Add the light of the places that the frame shows to the rays' samples, once it is known."""
    slot = first + wp.tid()
    if slot >= ray_count(rays, options.columns * options.rows):
        return
    light = walks_out.light[slot]
    weights = walks_out.weight[slot]
    pixels = walks_out.pixel[slot]
    nearby = walks_out.nearby[slot]
    # Other rays that have this slot later know of no places.
    walks_out.light[slot] = wp.vec3(0.0, 0.0, 0.0)
    walks_out.weight[slot] = wp.vec3(0.0, 0.0, 0.0)
    walks_out.nearby[slot] = wp.vec3i(-1, -1, -1)
    block = rays.block[slot]
    sample = unpack_halves(samples_out.radiance[block])
    for c in range(3):
        if weights[c] > 0.0:
            light[c] = light[c] + weights[c] * light_going_in(gbuffer, lights, pixels[c])[c]
        if nearby[c] >= 0:
            light[c] = light[c] + walks_out.share[slot][c] * light_going_in(gbuffer, lights, nearby[c])[c]
    light = finite_or_zero(rgb(sample) + light)
    samples_out.radiance[block] = pack_halves(rgba(wp.min(light, wp.vec3(HALF_MAX, HALF_MAX, HALF_MAX)), sample[3]))
