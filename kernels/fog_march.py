# SPDX-License-Identifier: GPL-3.0-or-later
"""What a pixel shows of fog: the integral over its froxels, from the camera to its surface. Functions only.

Boundaries are met at their exact places, in every pixel; froxels tell of the light between them alone. Each slice is
integrated as if its light were even (Hillaire 2015).
"""

from __future__ import annotations

import warp as wp

from .fog import WALLS_MAX, Fog, fog_about, next_wall
from .fog_passage import FogPassage, fog_varies, passing_between
from .froxels import EyeRay, FroxelOptions, eye_ray, froxel_range, slice_at, slice_distance, surface_distance
from .geometry_math import max_component
from .lamp_hit import FAR
from .lamp_tables import meet_lamp
from .media import Inside, Mixture, emitted, mixture_of, passing
from .packing import from_half, rgb
from .sampling import fraction, hash_combine, hashed_unit, pixel_seed_of
from .types import LIGHT_HITTABLE, VISIBLE_CAMERA, Scene
from .view import View, film_position
from .volume_bounds import bound_at
from .volume_grids import mixture_at

STREAM = wp.constant(0x464F474D)
STEP_DEPTH = wp.constant(0.5)
"""Most that a step through fog that varies is deep, by its block's largest extinction"""
THIN = wp.constant(0.1)
"""The same, up to which a step may lead through a wide block"""
STEPS_MAX = wp.constant(1024)
"""Blocks at most that a pixel looks through"""
BLOCK_STEPS = wp.constant(8.0)
"""Steps at most in each: one a cell"""
TURN = wp.constant(0.61803399)
"""By which the steps of a pixel are moved from frame to frame"""
NOTHING_LEFT = wp.constant(1.0e-4)
"""Share of light from which on nothing is looked at behind"""


@wp.struct
class Looked:
    """How far a pixel has been looked into the fog."""

    passing: wp.vec3
    light: wp.vec3
    """Exposed"""
    known: wp.vec3
    """What the froxel before scatters: for those that nothing is known of"""


@wp.func
def even_fog(mixture: Mixture, scattered: wp.vec3, exposure: float, length: float, looked: Looked) -> Looked:
    """Return what has been seen after a stretch of even light, which adds the same for each unit of scattering."""
    lit = Mixture()
    lit.extinction = mixture.extinction
    lit.emission = mixture.emission * exposure + wp.cw_mul(mixture.scattering, scattered)
    out = looked
    out.light = looked.light + wp.cw_mul(looked.passing, emitted(lit, length))
    out.passing = wp.cw_mul(looked.passing, passing(mixture.extinction, length))
    return out


@wp.func
def look_on(
    view: View, fog: Fog, options: FroxelOptions, froxels: wp.array[wp.vec4h], mixture: Mixture, tile: int,
    span: wp.vec2, start: float, end: float, looked: Looked,
) -> Looked:
    """Return what has been seen after a stretch of one medium."""
    out = looked
    at = float(start)
    if max_component(mixture.scattering) > 0.0:
        slice = wp.clamp(int(slice_at(span, options.slices, start)), 0, options.slices)
        while slice < options.slices and at < end and max_component(out.passing) > NOTHING_LEFT:
            next = wp.clamp(slice_distance(span, options.slices, float(slice + 1)), at, end)
            froxel = from_half(froxels[slice * options.columns * options.rows + tile])
            if froxel[3] > 0.0:
                out.known = rgb(froxel)
            out = even_fog(mixture, out.known, view.exposure, next - at, out)
            at = next
            slice = slice + 1
        if not max_component(out.passing) > NOTHING_LEFT:
            out.passing = wp.vec3(0.0, 0.0, 0.0)
            return out
        if at < end:
            # Farther than all froxels light falls off as the square of the distance, if it comes from some place: it
            # adds up to that of so long a stretch.
            length = end - at
            rest = length
            if fog.media.reach > 0.0:
                rest = wp.min(length, at)
            glow = Mixture()
            glow.extinction = mixture.extinction
            glow.scattering = mixture.scattering
            behind = even_fog(glow, out.known, view.exposure, rest, out)
            out.light = behind.light
    return even_fog(mixture, wp.vec3(0.0, 0.0, 0.0), view.exposure, end - at, out)


@wp.func
def look_into(
    view: View, fog: Fog, options: FroxelOptions, froxels: wp.array[wp.vec4h], inside: Inside, tile: int,
    ray: EyeRay, span: wp.vec2, start: float, end: float, seed: wp.uint32, looked: Looked,
) -> Looked:
    """Return what has been seen after a stretch of fog that varies, by steps of which each is looked at in a place."""
    out = looked
    within = fraction(hashed_unit(seed, wp.uint32(2)) + float(view.frame & 1023) * TURN)
    at = float(start)
    step = int(0)
    while at < end and step < STEPS_MAX and max_component(out.passing) > NOTHING_LEFT:
        bound = bound_at(fog.media, fog.volumes, inside, ray.origin, ray.direction, at, end, THIN)
        if bound.majorant > 0.0:
            length = bound.end - at
            count = wp.clamp(wp.ceil(bound.majorant * length / STEP_DEPTH), 1.0, BLOCK_STEPS)
            piece = length / count
            k = float(0.0)
            while k < count:
                t = at + (k + within) * piece
                mixture = mixture_at(fog.media, fog.volumes, inside, ray.origin + ray.direction * t)
                slice = wp.clamp(int(slice_at(span, options.slices, t)), 0, options.slices - 1)
                froxel = from_half(froxels[slice * options.columns * options.rows + tile])
                if froxel[3] > 0.0:
                    out.known = rgb(froxel)
                scattered = out.known
                if fog.media.reach > 0.0 and t > span[1]:
                    # Farther than all froxels light falls off as the square of the distance, if it has a place.
                    scattered = scattered * (span[1] / t * span[1] / t)
                out = even_fog(mixture, scattered, view.exposure, piece, out)
                k = k + 1.0
        at = bound.end
        step = step + 1
    if not max_component(out.passing) > NOTHING_LEFT:
        out.passing = wp.vec3(0.0, 0.0, 0.0)
    return out


@wp.func
def tile_near(options: FroxelOptions, x: int, y: int, seed: wp.uint32) -> int:
    """Return one of the four tiles about a pixel, drawn by their bilinear weights."""
    scale = 1.0 / float(options.tile)
    column = int(wp.floor((float(x) + 0.5) * scale - 0.5 + hashed_unit(seed, wp.uint32(0))))
    row = int(wp.floor((float(y) + 0.5) * scale - 0.5 + hashed_unit(seed, wp.uint32(1))))
    return wp.clamp(row, 0, options.rows - 1) * options.columns + wp.clamp(column, 0, options.columns - 1)


@wp.func
def pixel_ray(view: View, x: int, y: int) -> EyeRay:
    """Return the ray that a pixel of this frame looks along."""
    return eye_ray(view.camera, film_position(view, x, y))


@wp.func
def look_through(
    view: View, scene: Scene, fog: Fog, options: FroxelOptions, froxels: wp.array[wp.vec4h], depth: float, x: int,
    y: int,
) -> FogPassage:
    """Return what fog does to the light of a pixel whose surface is at a depth; its own light is exposed."""
    ray = pixel_ray(view, x, y)
    end = surface_distance(ray, depth)
    start = view.camera.clip_start * ray.slant
    looked = Looked()
    looked.passing = wp.vec3(1.0, 1.0, 1.0)
    fixed = pixel_seed_of(x, y, STREAM)
    tile = tile_near(options, x, y, hash_combine(fixed, wp.uint32(view.frame)))
    span = froxel_range(fog, view.camera)
    inside = fog_about(scene, fog, ray.origin + ray.direction * start)
    look = float(start)
    step = int(0)
    while look < end and step < WALLS_MAX and max_component(looked.passing) > 0.0:
        wall = next_wall(scene, fog, ray.origin, ray.direction, look, end, VISIBLE_CAMERA, inside)
        if fog_varies(fog, inside):
            looked = look_into(
                view, fog, options, froxels, inside, tile, ray, span, start, wall.t, fixed, looked)
        else:
            mixture = mixture_of(fog.media, inside)
            if max_component(mixture.extinction) + max_component(mixture.emission) > 0.0:
                looked = look_on(view, fog, options, froxels, mixture, tile, span, start, wall.t, looked)
        inside = wall.inside
        start = wall.t
        look = wall.look
        step = step + 1
    out = FogPassage()
    out.passing = looked.passing
    out.light = looked.light
    return out


@wp.func
def lamps_before(
    view: View, scene: Scene, fog: Fog, depth: float, behind: wp.vec3, x: int, y: int,
) -> wp.vec3:
    """Return what lamps in view have more of than if they were at a pixel's surface; `behind` gets through from there.

    Exposed. The G-buffer has their light with that of the surface.
    """
    ray = pixel_ray(view, x, y)
    start = view.camera.clip_start * ray.slant
    origin = ray.origin + ray.direction * start
    seed = hash_combine(hash_combine(pixel_seed_of(x, y, STREAM), wp.uint32(view.frame)), wp.uint32(3))
    end = wp.min(surface_distance(ray, depth), FAR) - start
    total = wp.vec3(0.0, 0.0, 0.0)
    for i in range(scene.lights.lamp_count):
        flags = scene.lights.lamps[i].flags
        if (flags & LIGHT_HITTABLE) != 0 and (scene.lights.lamps[i].visibility & VISIBLE_CAMERA) != 0:
            hit = meet_lamp(scene.lights, i, origin, ray.direction, end)
            if hit.t > 0.0:
                share = passing_between(
                    scene, fog, origin, ray.direction, hit.t, VISIBLE_CAMERA, hash_combine(seed, wp.uint32(i))) - behind
                total = total + wp.cw_mul(hit.radiance, wp.max(share, wp.vec3(0.0, 0.0, 0.0)))
    return total * view.exposure
