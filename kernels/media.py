# SPDX-License-Identifier: GPL-3.0-or-later
"""Participating media: which a path is in, and what homogeneous ones do to light. No kernels.

As in Cycles a path carries the pairs of object and medium that it has entered and not left, and all of them add up,
with the world's medium everywhere (kernel/integrator/volume_stack.h of Cycles). Where they scatter
it: media_distance.py.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import mean_component, transform_point
from .intersect import triangle_material
from .lamp_hit import FAR
from .paths import Paths
from .subsurface import phase
from .types import Scene, ShadingPoint
from .wide_loads import load_corner, load_instance

STACK_SIZE = wp.constant(4)
"""Media of objects that a path can be in at once, beside the world's; it does not notice that it enters more"""
HELD = wp.constant(STACK_SIZE + 1)
"""The same with the world's"""
NO_MEDIUM = wp.constant(-1)


RETURN_MIN = wp.constant(0.05)
"""Chance that a path has at least of coming back from far away"""


@wp.struct
class Medium:
    """What fills a closed mesh or the world."""

    extinction: wp.vec3
    """[1/m]"""
    emission: wp.vec3
    """Radiance per metre"""
    first: int
    """First of its phase functions"""
    count: int


@wp.struct
class Phase:
    """One way in which a medium scatters: Henyey and Greenstein's."""

    scattering: wp.vec3
    """[1/m]"""
    anisotropy: float


@wp.struct
class Media:
    """All media of a scene."""

    of_material: wp.array[int]
    """Medium of each material, NO_MEDIUM without one"""
    media: wp.array[Medium]
    phases: wp.array[Phase]
    world: int
    """NO_MEDIUM without one"""
    low: wp.vec3
    high: wp.vec3
    """Bounds of all objects with a medium"""
    middle: wp.vec3
    reach: float
    """Sphere about all lights with a place [m]; 0: light may come from anywhere"""


@wp.struct
class MediaPaths:
    """What is kept of each path, one slot a path as in Paths."""

    objects: wp.array[wp.vec4i]
    media: wp.array[wp.vec4i]
    """Pairs of instance and medium that the path is in; NO_MEDIUM for free places"""
    backfacing: wp.array[int]
    """1: the path has come to its hit from behind; written where the hit's material has a medium"""
    first: wp.array[int]
    """1: the path was scattered by a medium before it met a surface"""


@wp.struct
class Inside:
    """MediaPaths.objects and .media of one path."""

    objects: wp.vec4i
    media: wp.vec4i


@wp.struct
class Mixture:
    """All media at a place, added up."""

    extinction: wp.vec3
    scattering: wp.vec3
    emission: wp.vec3


@wp.func
def nowhere() -> Inside:
    """Return what a path outside of all objects is in."""
    inside = Inside()
    inside.objects = wp.vec4i(-1, -1, -1, -1)
    inside.media = wp.vec4i(NO_MEDIUM, NO_MEDIUM, NO_MEDIUM, NO_MEDIUM)
    return inside


@wp.func
def load_inside(kept: MediaPaths, path: int) -> Inside:
    """Return which media a path is in."""
    inside = Inside()
    inside.objects = kept.objects[path]
    inside.media = kept.media[path]
    return inside


@wp.func
def store_inside(kept: MediaPaths, path: int, inside: Inside):
    """Store which media a path is in."""
    kept.objects[path] = inside.objects
    kept.media[path] = inside.media


@wp.func
def place_in(inside: Inside, instance: int, medium: int) -> int:
    """Return the place of an object's medium in a stack, -1 where it is not there."""
    found = int(-1)
    for i in range(STACK_SIZE):
        if inside.media[i] == medium and inside.objects[i] == instance:
            found = i
    return found


@wp.func
def cross(inside: Inside, instance: int, medium: int, leaving: bool) -> Inside:
    """Return what a path is in that crosses the boundary of an object's medium, out through its back or in."""
    out = Inside()
    out.objects = inside.objects
    out.media = inside.media
    found = place_in(inside, instance, medium)
    free = int(-1)
    for i in range(STACK_SIZE):
        if inside.media[i] == NO_MEDIUM and free < 0:
            free = i
    for i in range(STACK_SIZE):
        if leaving and i == found:
            out.media[i] = NO_MEDIUM
        if not leaving and found < 0 and i == free:
            out.media[i] = medium
            out.objects[i] = instance
    return out


@wp.func
def past_layer(
    scene: Scene, media: Media, inside: Inside, instance: int, point: ShadingPoint, kind: int,
) -> Inside:
    """Return what a ray of a kind (VISIBLE_*) is in behind a layer that it passes."""
    medium = media.of_material[point.material]
    if medium != NO_MEDIUM and (scene.geometry.instances[instance].visibility & kind) != 0:
        return cross(inside, instance, medium, point.backfacing == 1)
    return inside


@wp.func
def entry(values: wp.vec4i, i: int) -> int:
    """Return one of four numbers, without a place in memory for them."""
    return wp.where(i < 2, wp.where(i == 0, values[0], values[1]), wp.where(i == 2, values[2], values[3]))


@wp.func
def held_medium(media: Media, inside: Inside, k: int) -> int:
    """Return one of the HELD media of a path: the world's for k = 0, else that of a boundary.

    Loops over these stay loops, whose code is once in a kernel: written out for each it does not fit into a GPU's
    instruction cache, which kernels of media wait for.
    """
    if k == 0:
        return media.world
    return entry(inside.media, k - 1)


@wp.func
def held_object(inside: Inside, k: int) -> int:
    """Return the object whose medium held_medium returns; -1 for the world."""
    if k == 0:
        return -1
    return entry(inside.objects, k - 1)


@wp.func
def add_medium(media: Media, mixture: Mixture, index: int) -> Mixture:
    """Return a mixture with one more medium in it."""
    out = mixture
    if index != NO_MEDIUM:
        medium = media.media[index]
        out.extinction = out.extinction + medium.extinction
        out.emission = out.emission + medium.emission
        k = int(0)
        while k < medium.count:
            out.scattering = out.scattering + media.phases[medium.first + k].scattering
            k = k + 1
    return out


@wp.func
def mixture_of(media: Media, inside: Inside) -> Mixture:
    """Return what a path is in, added up."""
    out = Mixture()
    k = int(0)
    while k < HELD:
        out = add_medium(media, out, held_medium(media, inside, k))
        k = k + 1
    return out


@wp.func
def passing(extinction: wp.vec3, t: float) -> wp.vec3:
    """Return the share of light that gets a distance far."""
    return wp.vec3(wp.exp(-extinction[0] * t), wp.exp(-extinction[1] * t), wp.exp(-extinction[2] * t))


@wp.func
def glow(extinction: float, t: float) -> float:
    """Return the integral of the share that passes over a distance; none over an infinite one that nothing dims."""
    depth = extinction * t
    if depth < 1.0e-3:
        return wp.where(t < 0.5 * FAR, t * (1.0 - depth * (0.5 - depth / 6.0)), 0.0)
    return (1.0 - wp.exp(-depth)) / extinction


@wp.func
def emitted(mixture: Mixture, t: float) -> wp.vec3:
    """Return what a stretch of media shines towards its begin."""
    e = mixture.emission
    x = mixture.extinction
    return wp.vec3(e[0] * glow(x[0], t), e[1] * glow(x[1], t), e[2] * glow(x[2], t))


@wp.struct
class PhaseChoice:
    """One of the phase functions at a place, drawn by how much it scatters."""

    anisotropy: float
    total: float
    """Sum of the weights so far"""
    left: float
    """What is left of the number that draws, in [0, 1)"""
    instance: int
    """The object whose medium it is of"""


@wp.func
def choose_among(media: Media, choice: PhaseChoice, index: int, instance: int) -> PhaseChoice:
    """Take the phase functions of one medium into a choice."""
    out = choice
    if index != NO_MEDIUM:
        medium = media.media[index]
        k = int(0)
        while k < medium.count:
            other = media.phases[medium.first + k]
            weight = mean_component(other.scattering)
            if weight > 0.0:
                out.total = out.total + weight
                share = weight / out.total
                # What is left of a number after each decision is uniform again.
                if out.left < share:
                    out.left = out.left / share
                    out.anisotropy = other.anisotropy
                    out.instance = instance
                else:
                    out.left = (out.left - share) / (1.0 - share)
            k = k + 1
    return out


@wp.func
def choose_phase(media: Media, inside: Inside, u: float) -> PhaseChoice:
    """Draw one of the phase functions where a path is."""
    choice = PhaseChoice()
    choice.left = u
    choice.instance = -1
    k = int(0)
    while k < HELD:
        choice = choose_among(media, choice, held_medium(media, inside, k), held_object(inside, k))
        k = k + 1
    return choice


@wp.func
def add_phases(media: Media, sums: wp.vec2, index: int, cosine: float) -> wp.vec2:
    """Add what one medium scatters by an angle, and what in all, in the mean of the channels."""
    out = sums
    if index != NO_MEDIUM:
        medium = media.media[index]
        k = int(0)
        while k < medium.count:
            part = media.phases[medium.first + k]
            weight = mean_component(part.scattering)
            out = out + wp.vec2(weight * phase(cosine, part.anisotropy), weight)
            k = k + 1
    return out


@wp.func
def phase_value(media: Media, inside: Inside, cosine: float) -> float:
    """Return the share of scattered light that goes on at an angle per solid angle: also the density of drawing it.

    As in Cycles (kernel/integrator/volume_shader.h) it is one for all channels. `cosine` is that between the
    directions of travel before and after.
    """
    sums = wp.vec2(0.0, 0.0)
    k = int(0)
    while k < HELD:
        sums = add_phases(media, sums, held_medium(media, inside, k), cosine)
        k = k + 1
    return sums[0] / wp.max(sums[1], 1.0e-36)


@wp.func
def return_chance(media: Media, inside: Inside, position: wp.vec3) -> float:
    """Return the chance with which a path that the world's medium has scattered goes on.

    An endless medium loses no path, but what is far from all lights adds little: as the square of the distance tells.
    """
    for i in range(STACK_SIZE):
        if inside.media[i] != NO_MEDIUM:
            return 1.0
    distance = wp.length(position - media.middle)
    if distance <= media.reach or media.reach <= 0.0:
        return 1.0
    return wp.max((media.reach / distance) * (media.reach / distance), RETURN_MIN)


@wp.func
def medium_at(scene: Scene, media: Media, instance: int, triangle: int) -> int:
    """Return the medium behind a triangle, NO_MEDIUM for none."""
    return media.of_material[triangle_material(scene, instance, triangle)]


@wp.func
def faces_along(scene: Scene, instance: int, triangle: int, direction: wp.vec3) -> bool:
    """Return whether a triangle's front looks along a direction: a ray in it comes from inside."""
    row = load_instance(scene.geometry.instances, instance)
    p0 = transform_point(row.to_world, load_corner(scene.geometry, triangle, 0))
    p1 = transform_point(row.to_world, load_corner(scene.geometry, triangle, 1))
    p2 = transform_point(row.to_world, load_corner(scene.geometry, triangle, 2))
    side = wp.dot(wp.cross(p1 - p0, p2 - p0), direction)
    return wp.where(row.flipped == 1, -side, side) > 0.0


@wp.func
def after_hit(
    scene: Scene, media: Media, kept: MediaPaths, paths: Paths, path: int, inside: Inside, direction: wp.vec3,
) -> Inside:
    """Return what a ray is in that leaves a path's hit, by the side of the surface that it leaves for."""
    hit = paths.hit[path]
    if hit[0] < 0:
        return inside
    medium = medium_at(scene, media, hit[0], hit[1])
    if medium == NO_MEDIUM:
        return inside
    outwards = faces_along(scene, hit[0], hit[1], direction)
    from_behind = kept.backfacing[path] == 1
    if outwards != from_behind:
        # It stays on its side.
        return inside
    return cross(inside, hit[0], medium, from_behind)
