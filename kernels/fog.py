# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog in real-time frames: what is in the air, and how much light goes about in it. Functions only, no kernels.

Fog is the world's medium and those in boundaries without a surface. How much light goes about is kept in cells of
grids about the scene, each of which has twice the cells' width of the one before: the mean radiance there and its first
moment over directions. Cells stand in for all light but that from lights straight to what the
camera sees: rays that go through fog ask them once on their way.
"""

from __future__ import annotations

import warp as wp

from .filter import step_past
from .geometry_math import PI
from .intersect import MISS, closest_layer, surface_point
from .lamp_hit import FAR
from .media import (
    NO_MEDIUM,
    Inside,
    Media,
    cross,
    nowhere,
    place_in,
)
from .sampling import hash_combine, hashed_unit
from .subsurface import phase
from .types import Scene
from .volume_grids import Volumes

MOMENTS = wp.constant(6)
"""Words of a cell: (mean, moments in x, y, z) of each channel for light from lights, then for all other"""
WALLS_MAX = wp.constant(16)
"""Boundaries at most that a ray goes through"""


@wp.struct
class FogGrid:
    """A grid of cells."""

    middle: wp.vec3
    cell: float
    """Width of its cells [m]"""
    room: float
    """How far it follows the camera from `middle`, along each axis [m]"""


@wp.struct
class Fog:
    """All fog of a scene."""

    media: Media
    """The world's medium, and those of boundaries without a surface; others are not in it"""
    volumes: Volumes
    varying: int
    """1: some of it varies in space, as `volumes` tells"""
    walls: int
    """1: there are boundaries"""
    even: int
    """1: as if what rays ask the cells for were scattered alike in all directions"""
    light: wp.array[wp.vec4]
    """MOMENTS words a cell, level by level; unexposed"""
    towards: wp.array[wp.vec4]
    """The same, of which the directions count. While light goes on from cell to cell they are those of the frame
    before: cells that asked along the very ray by which they have learnt would grow brighter"""
    count: wp.array[float]
    """Samples in a cell's means"""
    key: wp.array[int]
    """Which place a cell stands for, see cell_key"""
    side: int
    """Cells along a side of each grid, a power of 2"""
    levels: int
    """Grids"""
    own: int
    """How many of these, the first ones, are of bodies: others know nothing of what is in them"""
    grids: wp.array[FogGrid]
    middle: wp.vec3
    radius: float
    """Sphere about all that lights or is lit [m]; the widest grid covers it"""
    reach: float
    """How far one sees at most [m]"""
    first_ray: int
    """Slot of the first cell's ray among the radiance cache's: each cell has one"""


@wp.func
def cells_a_grid(fog: Fog) -> int:
    """Return how many cells each grid has."""
    return fog.side * fog.side * fog.side


@wp.func
def cell_width(fog: Fog, level: int) -> float:
    """Return the width of a level's cells [m]."""
    return fog.grids[level].cell


@wp.func
def first_cell(fog: Fog, eye: wp.vec3, level: int, axis: int) -> int:
    """Return the lowest coordinate [cells] of a level's grid: about the camera, as far as the widest reaches."""
    grid = fog.grids[level]
    at = grid.middle[axis] + wp.clamp(eye[axis] - grid.middle[axis], -grid.room, grid.room)
    return int(wp.floor(at / grid.cell + 0.5)) - fog.side / 2


@wp.func
def wrapped(fog: Fog, coordinate: int) -> int:
    """Return a coordinate's place along a side: grids that move with the camera keep what they know."""
    return coordinate & (fog.side - 1)


@wp.func
def cell_place(fog: Fog, level: int, x: int, y: int, z: int) -> int:
    """Return the index of the cell of these coordinates."""
    return ((level * fog.side + wrapped(fog, z)) * fog.side + wrapped(fog, y)) * fog.side + wrapped(fog, x)


@wp.func
def cell_key(level: int, x: int, y: int, z: int) -> int:
    """Return what tells the places apart that share a cell as a grid moves; never 0."""
    h = hash_combine(hash_combine(hash_combine(wp.uint32(level), wp.uint32(x)), wp.uint32(y)), wp.uint32(z))
    return int(h & wp.uint32(0x7FFFFFFF)) | 1


@wp.func
def known_cell(fog: Fog, eye: wp.vec3, level: int, place: wp.vec3) -> int:
    """Return the cell of a level at a place [cells] if it knows its light, else -1."""
    x = int(wp.floor(place[0]))
    y = int(wp.floor(place[1]))
    z = int(wp.floor(place[2]))
    i = x - first_cell(fog, eye, level, 0)
    j = y - first_cell(fog, eye, level, 1)
    k = z - first_cell(fog, eye, level, 2)
    if wp.min(wp.min(i, j), k) < 0 or wp.max(wp.max(i, j), k) >= fog.side:
        return -1
    cell = cell_place(fog, level, x, y, z)
    if not fog.count[cell] > 0.0 or fog.key[cell] != cell_key(level, x, y, z):
        return -1
    return cell


@wp.func
def is_own(fog: Fog, eye: wp.vec3, position: wp.vec3) -> bool:
    """Return whether a place is in a body's own grid."""
    for level in range(fog.own):
        inside = bool(True)
        for c in range(3):
            k = int(wp.floor(position[c] / cell_width(fog, level))) - first_cell(fog, eye, level, c)
            inside = inside and k >= 0 and k < fog.side
        if inside:
            return True
    return False


@wp.func
def find_cell(fog: Fog, eye: wp.vec3, position: wp.vec3, seed: wp.uint32) -> int:
    """Return a cell about a place that knows its light, of the finest grid that has one; -1 for none.

    Which of the eight about it is drawn by their trilinear weights; where that one is outside of the fog it is that of
    the place itself.
    """
    jitter = wp.vec3(
        hashed_unit(seed, wp.uint32(1)) - 0.5, hashed_unit(seed, wp.uint32(2)) - 0.5,
        hashed_unit(seed, wp.uint32(3)) - 0.5)
    for level in range(fog.levels):
        place = position / cell_width(fog, level)
        cell = known_cell(fog, eye, level, place + jitter)
        if cell < 0:
            cell = known_cell(fog, eye, level, place)
        if cell >= 0:
            return cell
    return -1


@wp.func
def scattered_part(mean: float, moments: wp.vec4, direction: wp.vec3, anisotropy: float) -> float:
    """Return what is scattered into a ray of light of a mean and of directions with such moments.

    Light of a mean direction, spread about it as Henyey and Greenstein's function has it, which the medium spreads as
    much again: mean cosines multiply. `direction` is the ray's own, against which the light goes on.
    """
    towards = wp.vec3(moments[1], moments[2], moments[3])
    length = wp.length(towards)
    if not mean > 0.0 or length <= 1.0e-6 * moments[0] or not moments[0] > 0.0 or anisotropy == 0.0:
        return wp.max(mean, 0.0)
    spread = anisotropy * wp.min(length / moments[0], 1.0)
    return mean * 4.0 * PI * phase(wp.dot(direction, towards) / length, spread)


@wp.func
def scattered_light(
    fog: Fog, eye: wp.vec3, position: wp.vec3, direction: wp.vec3, anisotropy: float, all_light: int, seed: wp.uint32,
) -> wp.vec3:
    """Return what the air at a place scatters into a ray, per unit of scattering; unexposed.

    `all_light` 0: without what comes straight from lights. Beyond the widest grid light falls off by the square of the
    distance, where lights have places.
    """
    place = position
    share = float(1.0)
    inner = fog.radius * 0.9
    away = wp.length(position - fog.middle)
    if away > inner and fog.media.world != NO_MEDIUM:
        place = fog.middle + (position - fog.middle) * (inner / away)
        if fog.media.reach > 0.0:
            share = (inner / away) * (inner / away)
    cell = find_cell(fog, eye, place, seed)
    if cell < 0:
        return wp.vec3(0.0, 0.0, 0.0)
    out = wp.vec3(0.0, 0.0, 0.0)
    for c in range(3):
        word = cell * MOMENTS + c
        light = scattered_part(fog.light[word + 3][0], fog.towards[word + 3], direction, anisotropy)
        if all_light == 1:
            light = light + scattered_part(fog.light[word][0], fog.towards[word], direction, anisotropy)
        out[c] = light * share
    return out


@wp.func
def fog_about(scene: Scene, fog: Fog, position: wp.vec3) -> Inside:
    """Return which boundaries' media a place is in, by what a ray upwards leaves without entering it.

    See media_march.start_media.
    """
    inside = nowhere()
    if fog.walls == 0:
        return inside
    for c in range(3):
        if position[c] < fog.media.low[c] or position[c] > fog.media.high[c]:
            return inside
    entered = nowhere()
    up = wp.vec3(0.0, 0.0, 1.0)
    start = float(0.0)
    step = int(0)
    while step < WALLS_MAX:
        layer = closest_layer(scene.geometry, position + up * start, up, FAR)
        if layer.hit.instance == MISS:
            return inside
        hit = layer.hit
        hit.t = hit.t + start
        point = surface_point(scene, hit, up)
        medium = fog.media.of_material[point.material]
        if medium != NO_MEDIUM and point.backfacing == 0:
            entered = cross(entered, hit.instance, medium, False)
        elif medium != NO_MEDIUM and place_in(entered, hit.instance, medium) < 0:
            inside = cross(inside, hit.instance, medium, False)
        start = step_past(point, up, hit.t)
        step = step + 1
    return inside


@wp.struct
class Wall:
    """The next boundary on a ray's way, and what lies behind it."""

    t: float
    """The way's end where there is none"""
    look: float
    """From where to look for the one after; the way's end where there is none"""
    inside: Inside


@wp.func
def next_wall(
    scene: Scene, fog: Fog, origin: wp.vec3, direction: wp.vec3, look: float, end: float, kind: int, inside: Inside,
) -> Wall:
    """Return the first boundary between `look` and `end` on a ray, for a kind of ray (VISIBLE_*)."""
    wall = Wall()
    wall.inside = inside
    start = float(look)
    step = int(0)
    while fog.walls == 1 and step < WALLS_MAX and start < end:
        layer = closest_layer(scene.geometry, origin + direction * start, direction, end - start)
        if layer.hit.instance == MISS:
            start = end
        else:
            hit = layer.hit
            hit.t = hit.t + start
            point = surface_point(scene, hit, direction)
            start = step_past(point, direction, hit.t)
            medium = fog.media.of_material[point.material]
            if medium != NO_MEDIUM and (scene.geometry.instances[hit.instance].visibility & kind) != 0:
                wall.t = hit.t
                wall.look = start
                wall.inside = cross(inside, hit.instance, medium, point.backfacing == 1)
                return wall
        step = step + 1
    wall.t = end
    wall.look = end
    return wall
