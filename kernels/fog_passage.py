# SPDX-License-Identifier: GPL-3.0-or-later
"""What fog does to light on a way: how much gets through, and what the fog adds. Functions only, no kernels.

Where nothing varies in space shares are exponentials, and places are drawn by what gets through. Else a walk (delta and
ratio tracking, see volume_walk.py) meets points of the fog; the light of one of them stands for all.
"""

from __future__ import annotations

import warp as wp

from .fog import WALLS_MAX, Fog, fog_about, next_wall, scattered_light
from .geometry_math import max_component, mean_component
from .media import HELD, Inside, Media, Mixture, emitted, held_medium, mixture_of, passing
from .sampling import hash_combine, hashed_unit
from .types import Scene
from .volume_bounds import WIDE_POINTS, Bound, bound_at
from .volume_grids import mixture_at, varies
from .volume_phases import add_cosines, mean_cosine_at
from .volume_walk import FAINT, halved, next_point, share_of_way

LEAST_DEPTH = wp.constant(1.0e-3)
"""Optical depth below which places on a stretch are drawn evenly"""
POINTS_MAX = wp.constant(1024)
"""Points and blocks of fog that varies which a ray meets at most"""
BLOCK_POINTS = wp.constant(1.0)
"""Points at least in the mean that a ray meets between two bounds of what there is: thin fog would be noise"""


@wp.struct
class FogPassage:
    """What fog does on a way."""

    passing: wp.vec3
    """Share of light that gets through"""
    light: wp.vec3
    """What the fog adds, unexposed"""


@wp.struct
class FogLink:
    """What fog does on a way, of which one place stands for all that scatters light."""

    passing: wp.vec3
    light: wp.vec3
    """What the fog emits"""
    place: wp.vec3
    anisotropy: float
    weight: wp.vec3
    """Of what is scattered there, per unit of scattering; 0: nothing is scattered anywhere"""
    total: float
    """Sum of the mean weights of all places so far"""
    left: float
    """What is left of the number that draws the place, in [0, 1)"""
    varies: int
    """1: the way ends before fog that varies, through which it was not to go"""


@wp.func
def fog_varies(fog: Fog, inside: Inside) -> bool:
    """Return whether anything at a place varies in space."""
    if fog.varying == 0:
        return False
    return varies(fog.media, fog.volumes, inside)


@wp.func
def fog_at(fog: Fog, inside: Inside, position: wp.vec3) -> Mixture:
    """Return what is at a place, added up."""
    if fog.varying == 1:
        return mixture_at(fog.media, fog.volumes, inside, position)
    return mixture_of(fog.media, inside)


@wp.func
def mean_anisotropy(media: Media, inside: Inside) -> float:
    """Return the mean cosine of scattering of all that is the same everywhere at a place."""
    sums = wp.vec2(0.0, 0.0)
    k = int(0)
    while k < HELD:
        sums = add_cosines(media, sums, held_medium(media, inside, k))
        k = k + 1
    return sums[0] / wp.max(sums[1], 1.0e-36)


@wp.func
def anisotropy_at(fog: Fog, inside: Inside, position: wp.vec3) -> float:
    """Return the mean cosine of scattering at a place."""
    if fog.varying == 1:
        return mean_cosine_at(fog.media, fog.volumes, inside, position)
    return mean_anisotropy(fog.media, inside)


@wp.func
def share_on(
    fog: Fog, inside: Inside, origin: wp.vec3, direction: wp.vec3, start: float, end: float, seed: wp.uint32,
) -> wp.vec3:
    """Return the share of light that fog lets through on a stretch of a ray; an estimate where it varies."""
    if fog.varying == 1:
        return share_of_way(fog.media, fog.volumes, inside, origin, direction, start, end, seed)
    return passing(mixture_of(fog.media, inside).extinction, end - start)


@wp.func
def passing_between(
    scene: Scene, fog: Fog, origin: wp.vec3, direction: wp.vec3, length: float, kind: int, seed: wp.uint32,
) -> wp.vec3:
    """Return the share of light that fog lets through on a way; an estimate where it varies."""
    inside = fog_about(scene, fog, origin)
    share = wp.vec3(1.0, 1.0, 1.0)
    start = float(0.0)
    look = float(0.0)
    step = int(0)
    while look < length and step < WALLS_MAX:
        wall = next_wall(scene, fog, origin, direction, look, length, kind, inside)
        share = wp.cw_mul(share, share_on(
            fog, inside, origin, direction, start, wall.t, hash_combine(seed, wp.uint32(step))))
        inside = wall.inside
        start = wall.t
        look = wall.look
        step = step + 1
    return share


@wp.func
def drawn_distance(extinction: float, length: float, u: float) -> wp.vec2:
    """Draw a distance on a stretch by what gets through; return it and one over its density."""
    depth = extinction * length
    if depth < LEAST_DEPTH:
        return wp.vec2(u * length, length)
    share = 1.0 - wp.exp(-depth)
    t = wp.min(-wp.log(1.0 - u * share) / extinction, length)
    return wp.vec2(t, share / (extinction * wp.exp(-extinction * t)))


@wp.func
def shortened(extinction: wp.vec3, anisotropy: float, blur: float) -> float:
    """Return the share of a way to where light is scattered that is gone, for cells of width `blur` that ask cells.

    A ray begins anywhere in its cell and asks one of the eight about a place: that alone spreads light by a variance of
    a quarter of the width's square along each axis, as if each way were longer than its own 2 / (3 extinction^2).
    """
    depth = mean_component(extinction) * blur
    return wp.sqrt(wp.max(1.0 - 0.375 * depth * depth * (1.0 - anisotropy), 0.0))


@wp.func
def stretch_light(
    fog: Fog, eye: wp.vec3, origin: wp.vec3, direction: wp.vec3, inside: Inside, mixture: Mixture, length: float,
    places: int, seed: wp.uint32,
) -> wp.vec3:
    """Return what a stretch of fog adds to a ray at its begin: an estimate from some places of what it scatters."""
    light = emitted(mixture, length)
    if max_component(mixture.scattering) > 0.0:
        anisotropy = mean_anisotropy(fog.media, inside)
        u = hashed_unit(seed, wp.uint32(0))
        share = 1.0 / float(places)
        k = int(0)
        while k < places:
            drawn = drawn_distance(mean_component(mixture.extinction), length, (float(k) + u) * share)
            scattered = scattered_light(
                fog, eye, origin + direction * drawn[0], direction, anisotropy, 1, hash_combine(seed, wp.uint32(k)))
            weight = wp.cw_mul(mixture.scattering, passing(mixture.extinction, drawn[0])) * (drawn[1] * share)
            light = light + wp.cw_mul(weight, scattered)
            k = k + 1
    return light


@wp.func
def offer_place(link: FogLink, place: wp.vec3, anisotropy: float, weight: wp.vec3) -> FogLink:
    """Return a link that has considered one more place, by its weight."""
    out = link
    worth = mean_component(weight)
    if worth > 0.0:
        out.total = link.total + worth
        share = worth / out.total
        # What is left of a number after each decision is uniform again.
        if link.left < share:
            out.left = link.left / share
            out.place = place
            out.anisotropy = anisotropy
            out.weight = weight / worth
        else:
            out.left = (link.left - share) / (1.0 - share)
    return out


@wp.func
def walk_through(
    fog: Fog, origin: wp.vec3, direction: wp.vec3, inside: Inside, start: float, end: float, seed: wp.uint32,
    link: FogLink,
) -> FogLink:
    """Return a link that has gone through a stretch of fog that varies; `anisotropy` is left out."""
    out = link
    begun = wp.max(max_component(link.passing), 1.0e-30)
    t = float(start)
    bound = Bound()
    majorant = float(0.0)
    step = int(0)
    while t < end and step < POINTS_MAX:
        if t >= bound.end:
            bound = bound_at(fog.media, fog.volumes, inside, origin, direction, t, end, WIDE_POINTS)
            majorant = wp.where(
                bound.majorant > 0.0, wp.max(bound.majorant, BLOCK_POINTS / wp.max(bound.end - t, 1.0e-30)), 0.0)
        number = hash_combine(seed, wp.uint32(step))
        ahead = next_point(t, bound.end, majorant, number)
        if ahead >= bound.end:
            t = bound.end
        else:
            t = ahead
            position = origin + direction * t
            mixture = mixture_at(fog.media, fog.volumes, inside, position)
            carried = out.passing / majorant
            out.light = out.light + wp.cw_mul(carried, mixture.emission)
            out = offer_place(out, position, 0.0, wp.cw_mul(carried, mixture.scattering))
            out.passing = wp.cw_mul(out.passing, wp.max(
                wp.vec3(1.0, 1.0, 1.0) - mixture.extinction / majorant, wp.vec3(0.0, 0.0, 0.0)))
            if max_component(out.passing) < FAINT * begun:
                out.passing = halved(out.passing, hashed_unit(number, wp.uint32(1)))
                if not max_component(out.passing) > 0.0:
                    t = end
        step = step + 1
    return out


@wp.func
def walk_link(
    fog: Fog, origin: wp.vec3, direction: wp.vec3, inside: Inside, start: float, end: float, blur: float,
    seed: wp.uint32, link: FogLink,
) -> FogLink:
    """Return a link that has gone through a stretch of fog that varies; `blur`: see shortened."""
    before = link.total
    out = link
    chosen = link.weight
    out.weight = wp.vec3(0.0, 0.0, 0.0)
    out = walk_through(fog, origin, direction, inside, start, end, seed, out)
    if max_component(out.weight) > 0.0:
        # The place is on this stretch.
        out.anisotropy = anisotropy_at(fog, inside, out.place)
        if blur > 0.0:
            begin = origin + direction * start
            short = shortened(fog_at(fog, inside, out.place).extinction, out.anisotropy, blur)
            out.place = begin + (out.place - begin) * short
    elif before > 0.0:
        out.weight = chosen
    return out


@wp.func
def even_link(
    fog: Fog, origin: wp.vec3, direction: wp.vec3, inside: Inside, start: float, end: float, blur: float,
    seed: wp.uint32, link: FogLink,
) -> FogLink:
    """Return a link that has gone through a stretch of fog that is the same everywhere; `blur`: see shortened."""
    out = link
    mixture = mixture_of(fog.media, inside)
    length = end - start
    out.light = out.light + wp.cw_mul(link.passing, emitted(mixture, length))
    if max_component(mixture.scattering) > 0.0:
        anisotropy = mean_anisotropy(fog.media, inside)
        drawn = drawn_distance(mean_component(mixture.extinction), length, hashed_unit(seed, wp.uint32(0)))
        weight = wp.cw_mul(mixture.scattering, passing(mixture.extinction, drawn[0])) * drawn[1]
        t = start + drawn[0] * shortened(mixture.extinction, anisotropy, blur)
        out = offer_place(out, origin + direction * t, anisotropy, wp.cw_mul(link.passing, weight))
    out.passing = wp.cw_mul(link.passing, passing(mixture.extinction, length))
    return out


@wp.func
def link_fog(
    scene: Scene, fog: Fog, origin: wp.vec3, direction: wp.vec3, length: float, kind: int, blur: float,
    walks: bool, seed: wp.uint32,
) -> FogLink:
    """Return what fog does to light that comes to a ray's origin from its end, and the place that stands for all.

    Args:
        scene: The scene.
        fog: Its fog.
        origin: Of the ray [m].
        direction: Its direction.
        length: Its length [m].
        kind: VISIBLE_*.
        blur: Width of the cells [m] whose means rays are sent from, else 0; see shortened.
        walks: False: to go no farther than to fog that varies, and tell.
        seed: Of its random numbers.
    """
    out = FogLink()
    out.passing = wp.vec3(1.0, 1.0, 1.0)
    out.left = hashed_unit(seed, wp.uint32(WALLS_MAX))
    inside = fog_about(scene, fog, origin)
    start = float(0.0)
    look = float(0.0)
    step = int(0)
    while look < length and step < WALLS_MAX:
        wall = next_wall(scene, fog, origin, direction, look, length, kind, inside)
        number = hash_combine(seed, wp.uint32(step))
        if fog_varies(fog, inside):
            if not walks:
                out.varies = 1
                return out
            out = walk_link(fog, origin, direction, inside, start, wall.t, blur, number, out)
        else:
            out = even_link(fog, origin, direction, inside, start, wall.t, blur, number, out)
        inside = wall.inside
        start = wall.t
        look = wall.look
        step = step + 1
    out.weight = out.weight * out.total
    return out


@wp.func
def through_fog(
    scene: Scene, fog: Fog, eye: wp.vec3, origin: wp.vec3, direction: wp.vec3, length: float, kind: int,
    places: int, seed: wp.uint32,
) -> FogPassage:
    """Return what fog does to light that comes to a ray's origin from its end; each stretch asks so many places.

    One, where it varies.
    """
    out = FogPassage()
    out.passing = wp.vec3(1.0, 1.0, 1.0)
    inside = fog_about(scene, fog, origin)
    start = float(0.0)
    look = float(0.0)
    step = int(0)
    while look < length and step < WALLS_MAX:
        wall = next_wall(scene, fog, origin, direction, look, length, kind, inside)
        number = hash_combine(seed, wp.uint32(step))
        if fog_varies(fog, inside):
            link = FogLink()
            link.passing = out.passing
            link.left = hashed_unit(number, wp.uint32(WALLS_MAX))
            link = walk_link(fog, origin, direction, inside, start, wall.t, 0.0, number, link)
            out.light = out.light + link.light
            out.passing = link.passing
            if link.total > 0.0:
                light = scattered_light(fog, eye, link.place, direction, link.anisotropy, 1, number)
                out.light = out.light + wp.cw_mul(link.weight, light) * link.total
        else:
            mixture = mixture_of(fog.media, inside)
            if max_component(mixture.extinction) + max_component(mixture.emission) > 0.0:
                light = stretch_light(
                    fog, eye, origin + direction * start, direction, inside, mixture, wall.t - start, places, number)
                out.light = out.light + wp.cw_mul(out.passing, light)
                out.passing = wp.cw_mul(out.passing, passing(mixture.extinction, wall.t - start))
        inside = wall.inside
        start = wall.t
        look = wall.look
        step = step + 1
    return out
