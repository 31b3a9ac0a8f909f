# SPDX-License-Identifier: GPL-3.0-or-later
"""How media that vary in space scatter light at a point: phase functions, drawn and weighed. No kernels."""

from __future__ import annotations

import warp as wp

from .geometry_math import mean_component
from .media import HELD, NO_MEDIUM, Inside, Media, PhaseChoice, add_phases, choose_among
from .subsurface import phase
from .volume_grids import FIELD_PHASES, Volumes, field_at, held_at, spot_of


@wp.func
def weigh_phases(
    volumes: Volumes, choice: PhaseChoice, index: int, instance: int, position: wp.vec3,
) -> PhaseChoice:
    """Take a grid's phase functions into a choice; see media.choose_among."""
    out = choice
    grid = volumes.grids[index]
    spot = spot_of(grid, position)
    k = int(0)
    while k < grid.phases:
        place = grid.fields + FIELD_PHASES + 2 * k
        weight = mean_component(field_at(volumes, spot, place)) * grid.density
        if weight > 0.0:
            out.total = out.total + weight
            share = weight / out.total
            if out.left < share:
                out.left = out.left / share
                out.anisotropy = field_at(volumes, spot, place + 1)[0]
                out.instance = instance
            else:
                out.left = (out.left - share) / (1.0 - share)
        k = k + 1
    return out


@wp.func
def choose_phase_at(media: Media, volumes: Volumes, inside: Inside, position: wp.vec3, u: float) -> PhaseChoice:
    """Draw one of the phase functions at a point."""
    choice = PhaseChoice()
    choice.left = u
    choice.instance = -1
    k = int(0)
    while k < HELD:
        held = held_at(media, volumes, inside, position, k)
        if held.grid >= 0:
            choice = weigh_phases(volumes, choice, held.grid, held.object, position)
        else:
            choice = choose_among(media, choice, held.medium, held.object)
        k = k + 1
    return choice


@wp.func
def add_phases_of(volumes: Volumes, sums: wp.vec2, index: int, position: wp.vec3, cosine: float) -> wp.vec2:
    """Add what a grid scatters by an angle at a point, and what in all; see media.add_phases."""
    out = sums
    grid = volumes.grids[index]
    spot = spot_of(grid, position)
    k = int(0)
    while k < grid.phases:
        place = grid.fields + FIELD_PHASES + 2 * k
        weight = mean_component(field_at(volumes, spot, place)) * grid.density
        if weight > 0.0:
            out = out + wp.vec2(weight * phase(cosine, field_at(volumes, spot, place + 1)[0]), weight)
        k = k + 1
    return out


@wp.func
def phase_value_at(media: Media, volumes: Volumes, inside: Inside, position: wp.vec3, cosine: float) -> float:
    """Return the share of light scattered at a point that goes on at an angle; see media.phase_value."""
    sums = wp.vec2(0.0, 0.0)
    k = int(0)
    while k < HELD:
        held = held_at(media, volumes, inside, position, k)
        if held.grid >= 0:
            sums = add_phases_of(volumes, sums, held.grid, position, cosine)
        else:
            sums = add_phases(media, sums, held.medium, cosine)
        k = k + 1
    return sums[0] / wp.max(sums[1], 1.0e-36)


@wp.func
def add_cosines(media: Media, sums: wp.vec2, index: int) -> wp.vec2:
    """Add the mean cosine of what one medium scatters, weighed by how much that is, and what in all."""
    out = sums
    if index != NO_MEDIUM:
        medium = media.media[index]
        k = int(0)
        while k < medium.count:
            part = media.phases[medium.first + k]
            weight = mean_component(part.scattering)
            out = out + wp.vec2(weight * part.anisotropy, weight)
            k = k + 1
    return out


@wp.func
def add_cosines_of(volumes: Volumes, sums: wp.vec2, index: int, position: wp.vec3) -> wp.vec2:
    """Add the mean cosine of what a grid scatters at a point, and what in all; see add_cosines."""
    out = sums
    grid = volumes.grids[index]
    spot = spot_of(grid, position)
    k = int(0)
    while k < grid.phases:
        place = grid.fields + FIELD_PHASES + 2 * k
        weight = mean_component(field_at(volumes, spot, place)) * grid.density
        out = out + wp.vec2(weight * field_at(volumes, spot, place + 1)[0], weight)
        k = k + 1
    return out


@wp.func
def mean_cosine_at(media: Media, volumes: Volumes, inside: Inside, position: wp.vec3) -> float:
    """Return the mean cosine of scattering at a point."""
    sums = wp.vec2(0.0, 0.0)
    k = int(0)
    while k < HELD:
        held = held_at(media, volumes, inside, position, k)
        if held.grid >= 0:
            sums = add_cosines_of(volumes, sums, held.grid, position)
        else:
            sums = add_cosines(media, sums, held.medium)
        k = k + 1
    return sums[0] / wp.max(sums[1], 1.0e-36)
