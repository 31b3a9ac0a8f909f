# SPDX-License-Identifier: GPL-3.0-or-later
"""Walks through media that vary in space: where these scatter a path, and what of light they let through. No kernels.

Distances are those of delta tracking (Woodcock et al. 1965), shares those of ratio tracking (Novák et al. 2014,
"Residual Ratio Tracking for Estimating Attenuation in Participating Media"), both by the largest extinction of each
block. All channels share a walk; whether it is scattered at a point is drawn by what it carries on (Kutz et al. 2017,
"Spectral and Decomposition Tracking for Rendering Heterogeneous Volumes", section 5.1): weights stay bounded.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component, mean_component
from .light_groups import GroupLight, GroupTables
from .media import HELD, NO_MEDIUM, Inside, Media, Mixture, add_medium, mixture_of, passing
from .media_distance import Passage
from .media_steps import add_met, group_of
from .paths import Options, Paths, add_light, limit_at
from .sampling import hash_combine, hashed_unit
from .volume_bounds import WIDE_POINTS, Bound, bound_at
from .volume_grids import Volumes, add_grid, held_at, mixture_at, varies

WALK_STEPS = wp.constant(1 << 16)
"""Points and blocks that a walk meets at most"""
FAINT = wp.constant(0.05)
"""Of what a walk began with, what is left where chance decides whether it goes on"""


@wp.func
def next_point(t: float, end: float, majorant: float, number: wp.uint32) -> float:
    """Return how far from its origin a walk at `t` meets the next point; `end` or more: none up to there [m]."""
    if majorant > 0.0:
        return t - wp.log(1.0 - hashed_unit(number, wp.uint32(0))) / majorant
    return end


@wp.func
def halved(share: wp.vec3, u: float) -> wp.vec3:
    """Return what becomes of a faint share: half go on, twice as bright."""
    return wp.where(u < 0.5, share * 2.0, wp.vec3(0.0, 0.0, 0.0))


@wp.func
def gather_shine(
    options: Options, media: Media, volumes: Volumes, inside: Inside, tables: GroupTables, groups: GroupLight,
    paths: Paths, path: int, position: wp.vec3, emission: wp.vec3, share: wp.vec3,
):
    """Add what media emit at a point, as much as `share` says, with light groups to these as well."""
    add_light(paths, path, wp.cw_mul(share, emission), limit_at(options, paths.state[path]))
    if groups.known.shape[0] > 0:
        k = int(0)
        while k < HELD:
            held = held_at(media, volumes, inside, position, k)
            part = Mixture()
            if held.grid >= 0:
                part = add_grid(volumes, part, held.grid, position)
            else:
                part = add_medium(media, part, held.medium)
            if held.medium != NO_MEDIUM:
                add_met(options, groups, group_of(tables, held.object), paths, path, wp.cw_mul(share, part.emission))
            k = k + 1


@wp.func
def walk_media(
    options: Options, media: Media, volumes: Volumes, inside: Inside, tables: GroupTables, groups: GroupLight,
    paths: Paths, path: int, throughput: wp.vec3, start: float, end: float, seed: wp.uint32,
) -> Passage:
    """Return whether and where a path is scattered on a stretch of its ray, from its origin, and the weight of that.

    Adds what the media on the way emit. `throughput`: at the stretch's begin.
    """
    origin = paths.origin[path]
    direction = paths.direction[path]
    out = Passage()
    out.weight = wp.vec3(1.0, 1.0, 1.0)
    t = float(start)
    bound = Bound()
    step = int(0)
    going = bool(t < end)
    while going and step < WALK_STEPS:
        if t >= bound.end:
            bound = bound_at(media, volumes, inside, origin, direction, t, end, WIDE_POINTS)
        number = hash_combine(seed, wp.uint32(step))
        ahead = next_point(t, bound.end, bound.majorant, number)
        if ahead >= bound.end:
            t = bound.end
            going = t < end
        else:
            t = ahead
            position = origin + direction * t
            mixture = mixture_at(media, volumes, inside, position)
            carried = wp.cw_mul(throughput, out.weight)
            if max_component(mixture.emission) > 0.0:
                gather_shine(options, media, volumes, inside, tables, groups, paths, path, position, mixture.emission,
                             carried / bound.majorant)
            majorant = wp.vec3(bound.majorant, bound.majorant, bound.majorant)
            passed = wp.max(majorant - mixture.extinction, wp.vec3(0.0, 0.0, 0.0))
            scattered = wp.abs(mean_component(wp.cw_mul(carried, mixture.scattering)))
            left = wp.abs(mean_component(wp.cw_mul(carried, passed)))
            chance = scattered / wp.max(scattered + left, 1.0e-36)
            if not scattered + left > 0.0:
                # All is absorbed.
                out.weight = wp.vec3(0.0, 0.0, 0.0)
                going = False
            elif hashed_unit(number, wp.uint32(1)) < chance:
                out.weight = wp.cw_mul(out.weight, mixture.scattering) / (bound.majorant * chance)
                out.scattered = 1
                out.t = t
                going = False
            else:
                out.weight = wp.cw_mul(out.weight, passed) / (bound.majorant * (1.0 - chance))
                if max_component(out.weight) < FAINT:
                    out.weight = halved(out.weight, hashed_unit(number, wp.uint32(2)))
                    going = max_component(out.weight) > 0.0
        step = step + 1
    return out


@wp.func
def share_of_way(
    media: Media, volumes: Volumes, inside: Inside, origin: wp.vec3, direction: wp.vec3, start: float, end: float,
    seed: wp.uint32,
) -> wp.vec3:
    """Return an estimate of the share of light that media let through on a stretch of a ray."""
    if not varies(media, volumes, inside):
        return passing(mixture_of(media, inside).extinction, end - start)
    share = wp.vec3(1.0, 1.0, 1.0)
    t = float(start)
    bound = Bound()
    step = int(0)
    while t < end and step < WALK_STEPS:
        if t >= bound.end:
            bound = bound_at(media, volumes, inside, origin, direction, t, end, WIDE_POINTS)
        number = hash_combine(seed, wp.uint32(step))
        ahead = next_point(t, bound.end, bound.majorant, number)
        if ahead >= bound.end:
            t = bound.end
        else:
            t = ahead
            extinction = mixture_at(media, volumes, inside, origin + direction * t).extinction
            share = wp.cw_mul(share, wp.max(
                wp.vec3(1.0, 1.0, 1.0) - extinction / bound.majorant, wp.vec3(0.0, 0.0, 0.0)))
            if max_component(share) < FAINT:
                share = halved(share, hashed_unit(number, wp.uint32(1)))
                if not max_component(share) > 0.0:
                    t = end
        step = step + 1
    return share
