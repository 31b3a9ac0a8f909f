# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that vary in space: grids of their coefficients. No kernels.

What a medium's program comes to is tabled over the box of each object that it fills (volume_bake.py). The world's box
is far larger than the scene: its cells get wider with the distance from the middle planes, along each axis by itself,
so that ground fog is as low far away. Coefficients are trilinear between the middles of cells. A grid's cells lie in
blocks, of which the largest extinction is known: walks take each block with its own (Szirmay-Kalos et al. 2011, "Free
Path Sampling in High Resolution Inhomogeneous Participating Media").
"""

from __future__ import annotations

import warp as wp

from .geometry_math import transform_point
from .media import HELD, NO_MEDIUM, STACK_SIZE, Inside, Media, Mixture, add_medium, held_medium, held_object

BLOCK = wp.constant(8)
"""Sides of a block in cells"""
FIELD_EXTINCTION = wp.constant(0)
FIELD_EMISSION = wp.constant(1)
FIELD_PHASES = wp.constant(2)
"""Places in a grid's fields; from the last one on a scattering and an anisotropy for each phase function"""
WIDE = wp.constant(32)
"""Sides of a wide block in cells"""

@wp.struct
class Field:
    """A coefficient: a constant colour, or one times what is tabled."""

    color: wp.vec3
    channel: int
    """The first of a grid's channels, -1: constant"""
    wide: int
    """1: three channels, 0: one for all"""


@wp.struct
class VolumeGrid:
    """What fills the box of one object, or one of the world's boxes."""

    to_cells: wp.mat44
    """From scene coordinates to cells"""
    x: int
    y: int
    z: int
    """Number of cells"""
    values: int
    """Place of its first cell; channels lie one after the other"""
    blocks: int
    """Place of its first block"""
    blocks_x: int
    blocks_y: int
    blocks_z: int
    fields: int
    """Place of its first field"""
    phases: int
    """Number of its phase functions"""
    density: float
    """Factor on extinction and scattering"""
    octaves: wp.vec3
    """The world's: cells along each axis for each doubling of the distance from the middle; 0: all are alike, and
    `to_cells` leads to cells, else to distances from the middle"""


@wp.struct
class Volumes:
    """All that varies in a scene's media."""

    places: wp.array[int]
    """By medium, where its objects' grids begin in `grid_of`; -1: nowhere does it vary"""
    grid_of: wp.array[int]
    """By instance; -1: there the medium is the same everywhere"""
    grids: wp.array[VolumeGrid]
    fields: wp.array[Field]
    values: wp.array[float]
    bounds: wp.array[wp.vec2]
    """The largest extinction [1/m], before `density`, and the largest emission of each grid's blocks, then of its wide
    ones, then of all of it"""
    world: int
    """Grid of the world's; -1 where its medium does not vary"""


@wp.struct
class Spot:
    """Where a point lies among cells: the lowest of the eight about it, the way to the others, weights of the upper."""

    cell: int
    count: int
    dx: int
    dy: int
    dz: int
    wx: float
    wy: float
    wz: float


@wp.func
def grid_of(volumes: Volumes, medium: int, instance: int) -> int:
    """Return the grid of an object's medium, -1 where it is the same everywhere."""
    place = volumes.places[medium]
    if place < 0:
        return -1
    return volumes.grid_of[place + instance]


@wp.func
def varies(media: Media, volumes: Volumes, inside: Inside) -> bool:
    """Return whether anything that a path is in varies in space."""
    out = bool(volumes.world >= 0)
    for i in range(STACK_SIZE):
        if inside.media[i] != NO_MEDIUM:
            out = out or grid_of(volumes, inside.media[i], inside.objects[i]) >= 0
    return out


@wp.func
def widened(x: float, count: int, octave: float) -> float:
    """Return the place among so many cells of a distance from the middle."""
    way = octave * wp.log2(1.0 + wp.abs(x))
    return 0.5 * float(count) + wp.where(x < 0.0, -way, way)


@wp.func
def narrowed(cell: float, count: int, octave: float) -> float:
    """Return the distance from the middle of a place among cells, the inverse of widened()."""
    if octave == 0.0:
        return cell
    beside = cell - 0.5 * float(count)
    way = wp.pow(2.0, wp.abs(beside) / octave) - 1.0
    return wp.where(beside < 0.0, -way, way)


@wp.func
def cells_of(grid: VolumeGrid, p: wp.vec3) -> wp.vec3:
    """Return a place among cells, of what `to_cells` leads to."""
    if grid.octaves[0] == 0.0:
        return p
    return wp.vec3(widened(p[0], grid.x, grid.octaves[0]), widened(p[1], grid.y, grid.octaves[1]),
                   widened(p[2], grid.z, grid.octaves[2]))


@wp.func
def world_grid(volumes: Volumes, position: wp.vec3) -> int:
    """Return the world's grid, -1 beyond its box."""
    grid = volumes.grids[volumes.world]
    p = cells_of(grid, transform_point(grid.to_cells, position))
    if (p[0] >= 0.0 and p[1] >= 0.0 and p[2] >= 0.0
            and p[0] <= float(grid.x) and p[1] <= float(grid.y) and p[2] <= float(grid.z)):
        return volumes.world
    return -1


@wp.func
def spot_of(grid: VolumeGrid, position: wp.vec3) -> Spot:
    """Return where a point lies among a grid's cells; outside as at the nearest of them."""
    p = cells_of(grid, transform_point(grid.to_cells, position)) - wp.vec3(0.5, 0.5, 0.5)
    x = wp.clamp(p[0], 0.0, float(grid.x - 1))
    y = wp.clamp(p[1], 0.0, float(grid.y - 1))
    z = wp.clamp(p[2], 0.0, float(grid.z - 1))
    i = wp.min(int(x), wp.max(grid.x - 2, 0))
    j = wp.min(int(y), wp.max(grid.y - 2, 0))
    k = wp.min(int(z), wp.max(grid.z - 2, 0))
    out = Spot()
    out.count = grid.x * grid.y * grid.z
    out.cell = grid.values + (k * grid.y + j) * grid.x + i
    out.dx = wp.where(grid.x > 1, 1, 0)
    out.dy = wp.where(grid.y > 1, grid.x, 0)
    out.dz = wp.where(grid.z > 1, grid.x * grid.y, 0)
    out.wx = x - float(i)
    out.wy = y - float(j)
    out.wz = z - float(k)
    return out


@wp.func
def tabled(volumes: Volumes, spot: Spot, channel: int) -> float:
    """Return a channel at a point."""
    a = spot.cell + channel * spot.count
    b = a + spot.dy
    c = a + spot.dz
    d = b + spot.dz
    near = wp.lerp(wp.lerp(volumes.values[a], volumes.values[a + spot.dx], spot.wx),
                   wp.lerp(volumes.values[b], volumes.values[b + spot.dx], spot.wx), spot.wy)
    far = wp.lerp(wp.lerp(volumes.values[c], volumes.values[c + spot.dx], spot.wx),
                  wp.lerp(volumes.values[d], volumes.values[d + spot.dx], spot.wx), spot.wy)
    return wp.lerp(near, far, spot.wz)


@wp.func
def with_channel(field: Field, found: wp.vec3, c: int, value: float) -> wp.vec3:
    """Return a coefficient once channel c of it has been looked up."""
    if field.wide == 0:
        return field.color * value
    return wp.vec3(wp.where(c == 0, value, found[0]), wp.where(c == 1, value, found[1]),
                   wp.where(c == 2, value, found[2]))


@wp.func
def field_at(volumes: Volumes, spot: Spot, index: int) -> wp.vec3:
    """Return a coefficient at a point."""
    field = volumes.fields[index]
    if field.channel < 0:
        return field.color
    out = field.color
    c = int(0)
    # One look-up in the code for all channels, see media.held_medium.
    while c < 1 + 2 * field.wide:
        out = with_channel(field, out, c, tabled(volumes, spot, field.channel + c))
        c = c + 1
    return out


@wp.func
def add_grid(volumes: Volumes, mixture: Mixture, index: int, position: wp.vec3) -> Mixture:
    """Return a mixture with what a grid holds at a point."""
    out = mixture
    grid = volumes.grids[index]
    spot = spot_of(grid, position)
    channel = int(-1)
    value = float(0.0)
    k = int(FIELD_EXTINCTION)
    # One look-up in the code for all coefficients, see media.held_medium.
    while k < FIELD_PHASES + 2 * grid.phases:
        field = volumes.fields[grid.fields + k]
        found = field.color
        c = int(0)
        while field.channel >= 0 and c < 1 + 2 * field.wide:
            # Most coefficients are the same number times a colour.
            if field.channel + c != channel:
                channel = field.channel + c
                value = tabled(volumes, spot, channel)
            found = with_channel(field, found, c, value)
            c = c + 1
        if k == FIELD_EXTINCTION:
            out.extinction = out.extinction + found * grid.density
        elif k == FIELD_EMISSION:
            out.emission = out.emission + found
        else:
            out.scattering = out.scattering + found * grid.density
        k = k + wp.where(k < FIELD_PHASES, 1, 2)
    return out


@wp.struct
class Held:
    """One of what a path is in at a point."""

    medium: int
    """NO_MEDIUM: nothing"""
    grid: int
    """-1: the medium is the same everywhere"""
    object: int
    """Instance; -1 for the world"""


@wp.func
def held_at(media: Media, volumes: Volumes, inside: Inside, position: wp.vec3, k: int) -> Held:
    """Return one of the HELD media of a path; see media.held_medium."""
    held = Held()
    held.grid = -1
    held.object = -1
    held.medium = held_medium(media, inside, k)
    if k == 0:
        if volumes.world >= 0:
            held.grid = world_grid(volumes, position)
            if held.grid < 0:
                held.medium = NO_MEDIUM
    elif held.medium != NO_MEDIUM:
        held.object = held_object(inside, k)
        held.grid = grid_of(volumes, held.medium, held.object)
    return held


@wp.func
def mixture_at(media: Media, volumes: Volumes, inside: Inside, position: wp.vec3) -> Mixture:
    """Return what a path is in at a point, added up."""
    out = Mixture()
    k = int(0)
    while k < HELD:
        held = held_at(media, volumes, inside, position, k)
        if held.grid >= 0:
            out = add_grid(volumes, out, held.grid, position)
        else:
            out = add_medium(media, out, held.medium)
        k = k + 1
    return out
