# SPDX-License-Identifier: GPL-3.0-or-later
"""The hash grid of the radiance cache: cells by place, size and side of the surface (GI-1.0, section 4.1).

A key holds the cell's place, its level of detail and the face of a cube that the surface's normal points through, so
that the two sides of a wall and the two walls of a corner never share light (Boisse et al. 2023 key cells by the
ray's direction instead; `directions` does so for study). A cell keeps light without the surface's colour, as mean
irradiance / pi of its samples: plain radiance units, not exposed. Buckets of 16 slots are always searched to the
end: freed slots leave holes anywhere in them.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import orthonormal_tangent
from .homes import MOVER_BIT, CellPlace, Homes
from .sampling import hash32, hash_combine, to_unit
from .view import View, eye_position, pixel_footprint

BUCKET = wp.constant(16)
"""Slots of a bucket"""
BASE_SIZE = wp.constant(9.765625e-4)
"""Size [m] of cells of level 0: a power of two"""
# With the levels of wide cells it leaves a key's seven bits: the eighth is MOVER_BIT.
LEVEL_LIMIT = wp.constant(59)

# Lines of the screen that HashGrid.pixels counts in. A smaller picture shows the same light, whose detail asks for
# cells of the same size, but has fewer rays, of which each cell must get enough: cells shrink with the root of the
# lines.
SCREEN_LINES = wp.constant(1080.0)
NO_CELL = wp.constant(-1)
EMPTY = wp.constant(wp.int64(0))

# Cells are taken from a little in front of the surface: modelled walls love to lie at round numbers, exactly on the
# border of two cells, where rounding would deal their samples to both.
LIFT = wp.constant(0.3)

# Thickness of a cell along the axis of its face, by its width: layers that hang close before each other (a curtain
# before a wall) face the same way in different light.
THICKNESS = wp.constant(0.25)

# Exact diagonals are common too: normals there belong to x before y before z, whichever way they are rounded.
FACE_BIAS_Y = wp.constant(0.995)
FACE_BIAS_Z = wp.constant(0.99)

# Levels between a cell and the coarse one that stands in for its indirect light until it has some of its own. Cells
# that rays seldom meet (behind the camera, far off) would otherwise end the light's way after one bounce. A wide one
# stands in for the coarse one: where something small has come to, or is seen in a mirror alone, nothing else is known.
COARSE_LEVELS = wp.constant(2)

# Frames between which cells shrink to HashGrid.finest of their width. Few rays have met the first ones, of which each
# needs some; until frame REBALANCE_FRAMES of cache_cells.py all new ones send bounce rays on.
REFINE_START = wp.constant(4.0)
REFINE_END = wp.constant(16.0)

# Streams of random numbers of a look-up.
STREAM_LEVEL = wp.constant(wp.uint32(0x4C45564C))
STREAM_JITTER = wp.constant(wp.uint32(0x4A495454))


@wp.struct
class HashGrid:
    """Table of cells. All arrays have one entry a slot, unless stated otherwise."""

    keys: wp.array[wp.int64]
    """EMPTY: free"""
    direct: wp.array[wp.vec4]
    """Mean irradiance / pi from lights; w = samples in it"""
    indirect: wp.array[wp.vec4]
    """The same from surfaces"""
    spread: wp.array[wp.vec4]
    """The same in the midst of a frame's sweeps, while light spreads (cache_spread.py)"""
    touched: wp.array[int]
    """Frame in which a ray last met the cell"""
    linked: wp.array[int]
    """While light spreads: one more than the frame in which a bounce ray last started from the cell, or in which a wide
    cell last stood in for others"""
    sums: wp.array[wp.int64]
    """This frame's samples, 6 a slot (direct, indirect), in units of 1 / FIXED_ONE"""
    counts: wp.array[int]
    """This frame's samples, 2 a slot"""
    crossing: wp.array[int]
    """This frame's samples that came through `ways`, 2 a slot"""
    way_share: wp.array[float]
    """Their mean share, 2 a slot; of before where there are no ways"""
    live: wp.array[int]
    """[1] cells in use"""
    bucket_mask: int
    """Number of buckets (a power of two) - 1"""
    pixels: float
    """Size of a cell on a screen of SCREEN_LINES lines [px]"""
    finest: float
    """Factor on `pixels` once rays have met the cells for some frames, 0.5 to 1"""
    minimum: float
    """Smallest cell [m]"""
    level_blend: int
    """1: choose between adjacent levels by chance, so that the mean size grows evenly with distance"""
    scan_all: int
    """0: searches end at the first hole, as published"""
    directions: int
    """1: key by the ray's direction instead of the normal's face, as published"""
    weighed: int
    """1: bounce rays bring `indirect` a share of what triangles emit, samples of lights bring `direct` the rest"""
    homes: Homes
    """Of what has moved"""
    ways: wp.array[wp.vec3]
    """Where it has moved of late (moved_ways.crosses_way)"""


@wp.func
def normal_face(normal: wp.vec3) -> int:
    """Return the face of a cube that a normal points through: 2 * axis + (1 where it is negative)."""
    x = wp.abs(normal[0])
    y = wp.abs(normal[1]) * FACE_BIAS_Y
    z = wp.abs(normal[2]) * FACE_BIAS_Z
    axis = int(0)
    if y > x and y >= z:
        axis = 1
    elif z > x and z > y:
        axis = 2
    return 2 * axis + wp.where(normal[axis] < 0.0, 1, 0)


@wp.func
def wanted_size(grid: HashGrid, view: View, position: wp.vec3) -> float:
    """Return the size [m] that cells should have at a point: `pixels` on the screen, at least `minimum`."""
    distance = wp.length(position - eye_position(view.camera))
    filled = wp.clamp((float(view.frame) - REFINE_START) / (REFINE_END - REFINE_START), 0.0, 1.0)
    # Of the full frame, so that a cropped region has the same cells.
    pixels = grid.pixels * wp.lerp(1.0, grid.finest, filled) * wp.sqrt(float(view.camera.height) / SCREEN_LINES)
    return wp.max(wp.max(pixels * pixel_footprint(view.camera, distance), grid.minimum), 1.0e-15)


@wp.func
def cell_level(grid: HashGrid, view: View, position: wp.vec3, seed: wp.uint32) -> int:
    """Return the level of detail of a point's cell for one look-up.

    The logarithm of the size is rounded up with the probability of its fraction, so levels change over gradually.
    """
    u = float(0.0)
    if grid.level_blend == 1:
        u = to_unit(hash_combine(seed, STREAM_LEVEL))
    level = int(wp.floor(wp.log2(wanted_size(grid, view, position) / BASE_SIZE) + u))
    return wp.clamp(level, -LEVEL_LIMIT, LEVEL_LIMIT)


@wp.func
def cell_size(level: int) -> float:
    """Return the size [m] of cells of a level."""
    return BASE_SIZE * wp.pow(2.0, float(level))


@wp.func
def cell_index(x: float, size: float) -> int:
    """Return a cell's index along an axis."""
    return int(wp.floor(wp.clamp(x / size, -2.0e9, 2.0e9)))


@wp.func
def wrapped(index: int, bits: int) -> wp.uint64:
    """Return the lowest bits of an index; cells so far apart never are in use together."""
    return wp.uint64(wp.uint32(index) & ((wp.uint32(1) << wp.uint32(bits)) - wp.uint32(1)))


@wp.func
def direction_bits(direction: wp.vec3) -> int:
    """Return the published 5 x 5 x 5 quantisation of a direction (method of Boisse et al., section 4)."""
    x = int(wp.floor(2.5 + 2.0 * direction[0]))
    y = int(wp.floor(2.5 + 2.0 * direction[1]))
    z = int(wp.floor(2.5 + 2.0 * direction[2]))
    return wp.clamp(x, 0, 4) + 5 * wp.clamp(y, 0, 4) + 25 * wp.clamp(z, 0, 4)


@wp.func
def cell_key(grid: HashGrid, level: int, place: CellPlace, direction: wp.vec3) -> wp.int64:
    """Return the key of a point's cell; never EMPTY.

    Args:
        grid: The grid.
        level: Of detail.
        place: Of the point.
        direction: Of the ray that arrives; used by the published key alone, which knows no homes.
    """
    size = cell_size(level)
    detail = wp.uint64(level + 64)
    if grid.directions == 1:
        position = place.position
        key = wrapped(cell_index(position[0], size), 16)
        key = (key << wp.uint64(16)) | wrapped(cell_index(position[1], size), 16)
        key = (key << wp.uint64(16)) | wrapped(cell_index(position[2], size), 16)
        key = (key << wp.uint64(7)) | detail
        key = (key << wp.uint64(7)) | wp.uint64(direction_bits(direction))
        return wp.int64(key | (wp.uint64(1) << wp.uint64(62)))
    face = normal_face(place.normal)
    axis = face // 2
    p = place.home
    p[axis] = p[axis] / THICKNESS + wp.where(face % 2 == 1, -LIFT, LIFT) * size
    cell = wrapped(cell_index(p[0], size), 17)
    cell = (cell << wp.uint64(17)) | wrapped(cell_index(p[1], size), 17)
    cell = (cell << wp.uint64(17)) | wrapped(cell_index(p[2], size), 17)
    cell = (cell << wp.uint64(8)) | detail
    cell = (cell << wp.uint64(3)) | wp.uint64(face)
    return wp.int64((cell ^ place.mover) | (wp.uint64(1) << wp.uint64(62)))


@wp.func
def is_mover(grid: HashGrid, key: wp.int64) -> bool:
    """Return whether a cell is one of something that has moved."""
    return grid.directions == 0 and (wp.uint64(key) & MOVER_BIT) != wp.uint64(0)


@wp.func
def first_slot(grid: HashGrid, key: wp.int64) -> int:
    """Return the first slot of a key's bucket."""
    bits = wp.uint64(key)
    low = wp.uint32(bits & wp.uint64(0x7FFFFFFF))
    high = wp.uint32(bits >> wp.uint64(31))
    return int(hash_combine(hash32(low), high) & wp.uint32(grid.bucket_mask)) * BUCKET


@wp.func
def find_key(grid: HashGrid, key: wp.int64) -> int:
    """Return the slot of a key, or NO_CELL."""
    first = first_slot(grid, key)
    i = int(0)
    while i < BUCKET:
        found = grid.keys[first + i]
        if found == key:
            return first + i
        if found == EMPTY and grid.scan_all == 0:
            return NO_CELL
        i = i + 1
    return NO_CELL


@wp.func
def insert_key(grid: HashGrid, key: wp.int64) -> int:
    """Return the slot of a key, which is taken if need be; NO_CELL where the bucket is full. Atomic: no bands.

    All threads take holes from the front, and none is made meanwhile, so no key can end up in two of them.
    """
    if grid.scan_all == 1:
        present = find_key(grid, key)
        if present != NO_CELL:
            return present
    first = first_slot(grid, key)
    i = int(0)
    while i < BUCKET:
        found = grid.keys[first + i]
        if found == EMPTY:
            found = wp.atomic_cas(grid.keys, first + i, EMPTY, key)
            if found == EMPTY:
                wp.atomic_add(grid.live, 0, 1)
                return first + i
        if found == key:
            return first + i
        i = i + 1
    return NO_CELL


@wp.func
def jittered(place: CellPlace, size: float, seed: wp.uint32) -> CellPlace:
    """Move a point at home by up to half a cell in its tangent plane, triangularly (Binder et al. 2019)."""
    a = hash_combine(seed, STREAM_JITTER)
    b = hash32(a)
    c = hash32(b)
    x = to_unit(a) + to_unit(b) - 1.0
    y = to_unit(c) + to_unit(hash32(c)) - 1.0
    t = orthonormal_tangent(place.normal)
    aside = place
    aside.home = place.home + (t * x + wp.cross(place.normal, t) * y) * (0.5 * size)
    return aside


@wp.func
def insert_cell(grid: HashGrid, view: View, place: CellPlace, direction: wp.vec3, seed: wp.uint32) -> int:
    """Return the cell of a point, made if need be; NO_CELL where its bucket is full. Atomic: no bands."""
    cell = insert_key(grid, cell_key(grid, cell_level(grid, view, place.position, seed), place, direction))
    if cell != NO_CELL:
        # Cells of one launch all write the same frame.
        grid.touched[cell] = view.frame
    return cell


@wp.func
def is_lit(grid: HashGrid, cell: int) -> bool:
    """Return whether a cell, or NO_CELL, has samples of direct light."""
    if cell == NO_CELL:
        return False
    return grid.direct[cell][3] > 0.0


@wp.func
def find_lit_cell(grid: HashGrid, view: View, place: CellPlace, direction: wp.vec3, seed: wp.uint32) -> int:
    """Return a cell with samples at about a point: the one half a cell aside, else its own, else of the next levels.

    Jitter in the surface's plane hides the borders of cells; NO_CELL where no cell knows anything.
    """
    level = cell_level(grid, view, place.position, seed)
    cell = find_key(grid, cell_key(grid, level, jittered(place, cell_size(level), seed), direction))
    step = int(0)
    while step < 3:
        if is_lit(grid, cell):
            return cell
        other = level
        if step == 1:
            other = level + 1
        if step == 2:
            other = level - 1
        cell = find_key(grid, cell_key(grid, other, place, direction))
        step = step + 1
    if not is_lit(grid, cell):
        cell = NO_CELL
    return cell


@wp.func
def coarse_key(grid: HashGrid, view: View, place: CellPlace, direction: wp.vec3, seed: wp.uint32) -> wp.int64:
    """Return the key of the coarse cell about a point; such cells hold indirect light alone."""
    level = cell_level(grid, view, place.position, seed) + COARSE_LEVELS
    return cell_key(grid, level, place, direction)


@wp.func
def quartered(index: wp.uint64) -> wp.uint64:
    """Return the index of the cell four times as wide, of the 17 bits in a key."""
    return (index & wp.uint64(0x1FFFF)) >> wp.uint64(2)


@wp.func
def wide_key(grid: HashGrid, coarse: wp.int64) -> wp.int64:
    """Return the key of the cell four times as wide as one, which holds indirect light alone; not of published keys."""
    if grid.directions == 1:
        return coarse
    key = wp.uint64(coarse)
    wide = wp.uint64(1) << wp.uint64(62)
    wide = wide | (quartered(key >> wp.uint64(45)) << wp.uint64(45))
    wide = wide | (quartered(key >> wp.uint64(28)) << wp.uint64(28))
    wide = wide | (quartered(key >> wp.uint64(11)) << wp.uint64(11))
    wide = wide | ((((key >> wp.uint64(3)) + wp.uint64(2)) & wp.uint64(255)) << wp.uint64(3))
    return wp.int64(wide | (key & wp.uint64(7)))


@wp.func
def indirect_of(grid: HashGrid, cell: int) -> wp.vec4:
    """Return a cell's indirect light (irradiance / pi), black for NO_CELL; w = samples in it, 0: nothing is known.

    Means of few samples with highlights may be below 0. They stay so in the cell, and count as black.
    """
    if cell == NO_CELL:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    return wp.max(grid.indirect[cell], wp.vec4(0.0, 0.0, 0.0, 0.0))


@wp.func
def known_indirect(
    grid: HashGrid, view: View, cell: int, place: CellPlace, direction: wp.vec3, seed: wp.uint32,
) -> wp.vec4:
    """Return the indirect light of a point's cell (irradiance / pi), else of the coarse one, else of the wide one.

    w = samples in it; 0: nothing is known.
    """
    light = indirect_of(grid, cell)
    if not light[3] > 0.0:
        key = coarse_key(grid, view, place, direction, seed)
        light = indirect_of(grid, find_key(grid, key))
        if not light[3] > 0.0:
            light = indirect_of(grid, find_key(grid, wide_key(grid, key)))
    return light


@wp.func
def indirect_light(
    grid: HashGrid, view: View, cell: int, place: CellPlace, direction: wp.vec3, seed: wp.uint32,
) -> wp.vec3:
    """Return the light of known_indirect, black where nothing is known."""
    light = known_indirect(grid, view, cell, place, direction, seed)
    return wp.vec3(light[0], light[1], light[2])


@wp.func
def read_cell(grid: HashGrid, cell: int) -> wp.vec4:
    """Return a cell's light as irradiance / pi [W/m2/sr]; w = samples of its direct light."""
    d = grid.direct[cell]
    i = indirect_of(grid, cell)
    return wp.vec4(d[0] + i[0], d[1] + i[1], d[2] + i[2], d[3])
