# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds of media that vary in space, for walks: how dense they are at most on the next part of a ray. No kernels.

See volume_grids.py.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component, transform_direction, transform_point
from .lamp_hit import FAR
from .media import HELD, NO_MEDIUM, Inside, Media
from .volume_grids import BLOCK, WIDE, VolumeGrid, Volumes, cells_of, held_at, narrowed

WIDE_POINTS = wp.constant(1.5)
"""Points in the mean up to which a walk goes through a wide block, or the whole box, by the bound of that"""
GLOW_POINTS = wp.constant(2.0)
"""Points at least in the mean that a walk takes in a block that shines"""
NUDGE = wp.constant(1.0e-4)
"""Of a block's way, how far beyond a boundary the next block is looked for"""


@wp.struct
class Bound:
    """What media come to at most up to a distance."""

    majorant: float
    """Of the extinction [1/m]; not below what finds enough of what shines"""
    end: float
    """From the ray's origin [m]"""


@wp.func
def side_exit(p: float, d: float, low: float, high: float) -> float:
    """Return how far it is along d from p, between two planes, to the one ahead."""
    if d > 0.0:
        return (high - p) / d
    if d < 0.0:
        return (low - p) / d
    return 2.0 * FAR


@wp.func
def block_width(p: float, octave: float) -> float:
    """Return about how wide a block is, in what `to_cells` leads to."""
    if octave == 0.0:
        return float(BLOCK)
    return 0.7 * float(BLOCK) / octave * (1.0 + wp.abs(p))


@wp.func
def axis_exit(p: float, d: float, block: int, side: int, count: int, octave: float) -> float:
    """Return how far it is along an axis out of a block. The last may be less than whole: none of its box is beyond."""
    low = narrowed(float(block * side), count, octave)
    high = narrowed(float(wp.min((block + 1) * side, count)), count, octave)
    return side_exit(p, d, low, high)


@wp.func
def block_exit(grid: VolumeGrid, p: wp.vec3, d: wp.vec3, i: int, j: int, k: int, side: int) -> float:
    """Return how far it is along d from p, in a block of some side in cells, out of that."""
    return wp.min(axis_exit(p[0], d[0], i, side, grid.x, grid.octaves[0]),
                  wp.min(axis_exit(p[1], d[1], j, side, grid.y, grid.octaves[1]),
                         axis_exit(p[2], d[2], k, side, grid.z, grid.octaves[2])))


@wp.func
def bound_in(
    volumes: Volumes, bound: Bound, index: int, origin: wp.vec3, direction: wp.vec3, t: float, thin: float,
) -> Bound:
    """Return a bound with that of a grid's block at a distance.

    `thin`: points in the mean up to which a wide block's serves, or that of all.
    """
    grid = volumes.grids[index]
    o = transform_point(grid.to_cells, origin)
    d = transform_direction(grid.to_cells, direction)
    p = o + d * t
    way = wp.min(block_width(p[0], grid.octaves[0]) / wp.max(wp.abs(d[0]), 1.0e-30),
                 wp.min(block_width(p[1], grid.octaves[1]) / wp.max(wp.abs(d[1]), 1.0e-30),
                        block_width(p[2], grid.octaves[2]) / wp.max(wp.abs(d[2]), 1.0e-30)))
    begin = t + NUDGE * way
    p = o + d * begin
    cell = cells_of(grid, p) / float(BLOCK)
    i = wp.clamp(int(wp.floor(cell[0])), 0, grid.blocks_x - 1)
    j = wp.clamp(int(wp.floor(cell[1])), 0, grid.blocks_y - 1)
    k = wp.clamp(int(wp.floor(cell[2])), 0, grid.blocks_z - 1)
    wide = grid.blocks + grid.blocks_x * grid.blocks_y * grid.blocks_z
    ratio = WIDE / BLOCK
    wide_x = (grid.blocks_x + ratio - 1) / ratio
    wide_y = (grid.blocks_y + ratio - 1) / ratio
    wide_z = (grid.blocks_z + ratio - 1) / ratio
    # All of it, a wide block, a block: once in the code (media.held_medium).
    place = wide + wide_x * wide_y * wide_z
    side = wp.max(grid.x, wp.max(grid.y, grid.z))
    first = wp.vec3i(0, 0, 0)
    held = wp.vec2(0.0, 0.0)
    end = float(0.0)
    level = int(0)
    while level < 3:
        held = volumes.bounds[place]
        end = block_exit(grid, p, d, first[0], first[1], first[2], side)
        if level == 0 and end <= 0.0:
            # Past the box, as by an edge of its mesh that rounding has let through: in the outermost cells a ray would
            # go on by the least of steps.
            return bound
        level = level + 1
        if held[1] > 0.0 or held[0] * grid.density * end > thin:
            side = wp.where(level == 1, WIDE, BLOCK)
            first = wp.where(level == 1, wp.vec3i(i / ratio, j / ratio, k / ratio), wp.vec3i(i, j, k))
            place = wp.where(
                level == 1, wide + (first[2] * wide_y + first[1]) * wide_x + first[0],
                grid.blocks + (k * grid.blocks_y + j) * grid.blocks_x + i)
        else:
            level = 3
    out = Bound()
    out.end = wp.min(bound.end, begin + wp.max(end, 0.0))
    majorant = held[0] * grid.density
    if held[1] > 0.0:
        majorant = wp.max(majorant, GLOW_POINTS / way)
    out.majorant = bound.majorant + majorant
    return out


@wp.func
def world_entry(grid: VolumeGrid, origin: wp.vec3, direction: wp.vec3) -> float:
    """Return the distance at which a ray from outside enters the world's box, FAR if it does not."""
    o = transform_point(grid.to_cells, origin)
    d = transform_direction(grid.to_cells, direction)
    high = wp.vec3(narrowed(float(grid.x), grid.x, grid.octaves[0]), narrowed(float(grid.y), grid.y, grid.octaves[1]),
                   narrowed(float(grid.z), grid.z, grid.octaves[2]))
    near = float(0.0)
    far = float(FAR)
    for c in range(3):
        if d[c] != 0.0:
            a = (-high[c] - o[c]) / d[c]
            b = (high[c] - o[c]) / d[c]
            near = wp.max(near, wp.min(a, b))
            far = wp.min(far, wp.max(a, b))
        elif wp.abs(o[c]) > high[c]:
            near = FAR
    return wp.where(near < far, near, FAR)


@wp.func
def bound_at(
    media: Media, volumes: Volumes, inside: Inside, origin: wp.vec3, direction: wp.vec3, t: float, limit: float,
    thin: float,
) -> Bound:
    """Return what media come to at most from a distance on, and how far that holds, at most to `limit`.

    `thin`: see bound_in.
    """
    out = Bound()
    out.end = limit
    shining = bool(False)
    position = origin + direction * t
    k = int(0)
    while k < HELD:
        held = held_at(media, volumes, inside, position, k)
        if held.grid >= 0:
            out = bound_in(volumes, out, held.grid, origin, direction, t, thin)
        elif held.medium != NO_MEDIUM:
            out.majorant = out.majorant + max_component(media.media[held.medium].extinction)
            shining = shining or max_component(media.media[held.medium].emission) > 0.0
        elif k == 0 and volumes.world >= 0:
            # Beyond the world's box. Rounding, of what lies that far away.
            entry = world_entry(volumes.grids[volumes.world], position, direction)
            out.end = wp.min(out.end, (t + entry) * (1.0 + 1.0e-5))
        k = k + 1
    if shining:
        out.majorant = wp.max(out.majorant, GLOW_POINTS / wp.max(out.end - t, 1.0e-30))
    return out
