# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's cellular pattern: distances to random points, one in each cell of a lattice (Worley 1996).

The same numbers as Cycles 5.2's Voronoi Texture in one to four dimensions: smooth minima of distances after Quilez'
"Voronoi - smooth" (2014), distances to the borders after his "Voronoi - edges" (2012), points from node_cells.py.
Coordinates are vec4 whose unused components are 0.

A kernel with the node machine has no registers to spare, and compilers fill as many as loops within loops let them.
So one loop looks at one cell a turn, whatever the octave and whatever for (see Search).
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .node_cells import as_floats, cell_offset, cell_random, floor4, next_key, used
from .node_noise import hash_floats

__all__ = ["voronoi"]

FAR = wp.constant(1.0e30)

SAME_POINT = wp.constant(1.0e-4)
"""Squared distance up to which two points count as one, which has no border with itself"""


@wp.struct
class Shape:
    """How the points are spread, and distances measured."""

    randomness: float
    smoothness: float
    """Width of the blend between cells, 0 for none"""
    exponent: float


# What a turn looks at a cell for.
SEEK = wp.constant(0)
"""Whether its point is the nearest one, or the second"""
BORDER = wp.constant(1)
"""Where the border between its point and the nearest one is"""
VISIT = wp.constant(2)
"""Because it is the one sought"""
BLEND = wp.constant(3)
"""To blend it with the others"""

OVER = wp.constant(-1)
"""Key of no cell"""


@wp.struct
class Search:
    """One look at the cells around a place."""

    cell: wp.vec4i
    """Cell of the place"""
    local: wp.vec4
    """The place, relative to the corner of `cell`"""
    aim: int
    """What the next turn looks at a cell for"""
    key: int
    """The next turn's cell, OVER after the last one"""
    round: int
    """How often a cell was found before"""
    least: float
    """Rank of the least distance so far, distance to the nearest border, or smooth minimum; at the end the result"""
    second: float
    """Rank of the second distance"""
    found: wp.vec2i
    """Keys of the nearest and the second cell"""
    value: wp.vec4
    """Blend so far; color of the cell found, or its point relative to `cell`"""


@wp.func
def dimensions_of(sub: int) -> int:
    """Return the number of dimensions, 1 to 4."""
    return (sub & codes.VORONOI_4D) + 1


@wp.func
def cell_point(sub: int, shape: Shape, cell: wp.vec4i, offset: wp.vec4i) -> wp.vec4:
    """Return the point of the cell at `offset` from `cell`, relative to the corner of `cell`."""
    place = cell + offset
    random = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if dimensions_of(sub) == 1:
        random[0] = hash_floats(float(place[0]), 0.0, 0.0, 0.0, 1)
    else:
        random = cell_random(dimensions_of(sub), place)
    return as_floats(offset) + random * shape.randomness


@wp.func
def cell_color(sub: int, cell: wp.vec4i) -> wp.vec4:
    """Return the color of a cell; w is 0."""
    if dimensions_of(sub) == 1:
        x = float(cell[0])
        return wp.vec4(
            hash_floats(x, 0.0, 0.0, 0.0, 1), hash_floats(x, 1.0, 0.0, 0.0, 2), hash_floats(x, 2.0, 0.0, 0.0, 2), 0.0)
    color = cell_random(wp.max(dimensions_of(sub), 3), cell)
    color[3] = 0.0
    return color


@wp.func
def rank(sub: int, shape: Shape, d: wp.vec4) -> float:
    """Return what grows with the length of d by the metric: its square, its sum of powers, or itself."""
    metric = sub & codes.VORONOI_METRICS
    if metric == codes.VORONOI_EUCLIDEAN:
        return wp.dot(d, d)
    x = wp.abs(d[0])
    y = wp.abs(d[1])
    z = wp.abs(d[2])
    w = wp.abs(d[3])
    if metric == codes.VORONOI_MANHATTAN:
        return x + y + z + w
    if metric == codes.VORONOI_CHEBYCHEV:
        return wp.max(wp.max(x, y), wp.max(z, w))
    sum = wp.pow(x, shape.exponent) + wp.pow(y, shape.exponent)
    if dimensions_of(sub) > 2:
        sum += wp.pow(z, shape.exponent)
    if dimensions_of(sub) > 3:
        sum += wp.pow(w, shape.exponent)
    return sum


@wp.func
def length_of(sub: int, shape: Shape, rank: float) -> float:
    """Return the length by the metric from what rank() returned."""
    metric = sub & codes.VORONOI_METRICS
    if metric == codes.VORONOI_EUCLIDEAN:
        return wp.sqrt(rank)
    if metric == codes.VORONOI_MINKOWSKI:
        return wp.pow(rank, 1.0 / shape.exponent)
    return rank


@wp.func
def start_search(sub: int, shape: Shape, place: wp.vec4) -> Search:
    """Return a search around a place that has not begun yet."""
    corner = floor4(place)
    s = Search()
    s.cell = wp.vec4i(int(corner[0]), int(corner[1]), int(corner[2]), int(corner[3]))
    s.local = place - corner
    s.aim = wp.where(shape.smoothness > 0.0, BLEND, SEEK)
    s.least = wp.where(shape.smoothness > 0.0, 0.0, FAR)
    s.second = FAR
    return s


@wp.func
def note_cell(search: Search, rank: float) -> Search:
    """Return a search that knows how far this turn's point is."""
    s = search
    if rank < s.least:
        s.second = s.least
        s.least = rank
        s.found = wp.vec2i(s.key, s.found[0])
    elif rank < s.second:
        s.second = rank
        s.found = wp.vec2i(s.found[0], s.key)
    return s


@wp.func
def blend_cell(search: Search, smoothness: float, value: wp.vec4, distance: float) -> Search:
    """Return a search with this turn's cell blended in: the smooth minimum of Quilez."""
    s = search
    t = wp.clamp(0.5 + 0.5 * (s.least - distance) / smoothness, 0.0, 1.0)
    h = wp.where(s.key == 0, 1.0, t * t * (3.0 - 2.0 * t))
    dip = smoothness * h * (1.0 - h)
    s.least = wp.lerp(s.least, distance, h) - dip
    dip = dip / (1.0 + 3.0 * smoothness)
    s.value = wp.lerp(s.value, value, h) - wp.vec4(dip, dip, dip, dip)
    return s


@wp.func
def border_distance(sub: int, search: Search, point: wp.vec4) -> float:
    """Return the least distance to the planes halfway between the nearest point and others, `point` too (Quilez)."""
    apart = point - search.value
    square = wp.dot(apart, apart)
    # On a line no two points count as one.
    if square <= wp.where(dimensions_of(sub) > 1, SAME_POINT, 0.0):
        return search.least
    halfway = (point + search.value) * 0.5 - search.local
    return wp.min(search.least, wp.dot(halfway, apart) / wp.sqrt(square))


@wp.func
def visit_cell(sub: int, search: Search, offset: wp.vec4i, point: wp.vec4) -> Search:
    """Return a search that has found its cell: over, or begun anew for what is asked of that cell."""
    s = search
    feature = sub & codes.VORONOI_FEATURES
    s.key = OVER
    if feature == codes.VORONOI_EDGE:
        s.aim = BORDER
        s.key = 0
        s.least = FAR
    elif feature == codes.VORONOI_RADIUS and s.round == 0:
        # The sphere's center is the point found; the second round finds it again, and its neighbor.
        s.cell = s.cell + offset
        s.local = point - as_floats(offset)
        s.aim = SEEK
        s.key = 0
        s.least = FAR
        s.second = FAR
        s.round = 1
    return s


@wp.func
def look(sub: int, shape: Shape, search: Search) -> Search:
    """Return a search after one turn."""
    s = search
    feature = sub & codes.VORONOI_FEATURES
    reach = wp.where(s.aim == BLEND, 2, 1)
    offset = cell_offset(dimensions_of(sub), s.key, reach)
    point = cell_point(sub, shape, s.cell, offset)
    distance = rank(sub, shape, point - s.local)
    value = point
    if s.aim >= VISIT:
        distance = length_of(sub, shape, distance)
        if (sub & codes.VORONOI_COLOR) != 0:
            value = cell_color(sub, s.cell + offset)
    if s.aim == VISIT:
        s.value = value
        s.least = distance
        return visit_cell(sub, s, offset, point)
    if s.aim == SEEK:
        s = note_cell(s, distance)
    elif s.aim == BORDER:
        s.least = border_distance(sub, s, point)
    else:
        s = blend_cell(s, shape.smoothness, value, distance)
    s.key = next_key(s.key, reach)
    if s.key == 1 << (3 * dimensions_of(sub)):
        s.key = OVER
        if s.aim == SEEK:
            s.aim = VISIT
            s.key = wp.where(feature == codes.VORONOI_F2 or s.round == 1, s.found[1], s.found[0])
    return s


@wp.func
def result(sub: int, search: Search) -> wp.vec4:
    """Return what a search has found: color, if asked for, and distance, or the position."""
    if (sub & codes.VORONOI_POSITION) != 0:
        return used(dimensions_of(sub), search.value + as_floats(search.cell))
    distance = search.least
    if (sub & codes.VORONOI_FEATURES) == codes.VORONOI_RADIUS:
        distance = 0.5 * distance
    color = wp.vec4(0.0, 0.0, 0.0, distance)
    if (sub & codes.VORONOI_COLOR) != 0:
        color = wp.vec4(search.value[0], search.value[1], search.value[2], distance)
    return color


@wp.func
def greatest_distance(sub: int, shape: Shape) -> float:
    """Return the greatest distance that a feature but the edge is expected to have."""
    side = 0.5 + 0.5 * shape.randomness
    longest = length_of(sub, shape, rank(sub, shape, used(dimensions_of(sub), wp.vec4(side, side, side, side))))
    return wp.where((sub & codes.VORONOI_FEATURES) == codes.VORONOI_F2, 2.0 * longest, longest)


@wp.func
def voronoi_sum(sub: int, shape: Shape, place: wp.vec4, b: wp.vec4) -> wp.vec4:
    """Return the sum of b.x + 1 octaves (the last one partly), normalized where `sub` says so."""
    feature = sub & codes.VORONOI_FEATURES
    is_edge = feature == codes.VORONOI_EDGE
    detail = wp.clamp(b[0], 0.0, 15.0)
    roughness = wp.clamp(b[1], 0.0, 1.0)
    if roughness == 0.0 or feature == codes.VORONOI_RADIUS:
        detail = 0.0
    side = 0.5 + 0.5 * shape.randomness
    scale = float(1.0)
    amplitude = float(1.0)
    sum = wp.vec4(0.0, 0.0, 0.0, wp.where(is_edge, FAR, 0.0))
    reach = wp.where(is_edge, side, 0.0)
    # Octaves still to come, this one included.
    rest = detail + 1.0
    search = start_search(sub, shape, place)
    while rest > 0.0:
        search = look(sub, shape, search)
        if search.key == OVER:
            octave = result(sub, search)
            weight = amplitude * wp.min(rest, 1.0)
            if is_edge:
                # Finer borders come on top of coarser ones: a mix instead of a sum.
                reach = wp.lerp(reach, side / scale, weight)
                sum[3] = wp.lerp(sum[3], wp.min(sum[3], octave[3] / scale), weight)
            elif (sub & codes.VORONOI_POSITION) != 0:
                sum = wp.lerp(sum, octave / scale, weight)
            else:
                reach += weight
                sum += octave * weight
            scale *= b[2]
            amplitude *= roughness
            rest -= 1.0
            search = start_search(sub, shape, place * scale)
    if (sub & codes.VORONOI_NORMALIZE) != 0:
        sum = sum / reach
        if not is_edge:
            sum[3] = sum[3] / greatest_distance(sub, shape)
    return sum


@wp.func
def finite_or_zero(x: float) -> float:
    """Return x, or 0 for what is no number."""
    return wp.where(wp.isfinite(x), x, 0.0)


@wp.func
def voronoi(sub: int, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate the Voronoi Texture.

    Args:
        sub: codes.PROCEDURAL_VORONOI and the codes of dimensions, metric and feature, and flags.
        a: Coordinate, scaled; what the dimensions leave out is ignored.
        b: detail, roughness, lacunarity.
        c: randomness, smoothness (0..1; 0 for the features that know none), exponent of Minkowski's metric.

    Returns:
        color (0 unless `sub` has codes.VORONOI_COLOR) and distance or radius; with codes.VORONOI_POSITION the scaled
        position of the point.
    """
    shape = Shape()
    shape.randomness = wp.clamp(c[0], 0.0, 1.0)
    shape.smoothness = wp.clamp(0.5 * c[1], 0.0, 0.5)
    shape.exponent = c[2]
    sum = voronoi_sum(sub, shape, used(dimensions_of(sub), a), b)
    # Minkowski's metric grows without bounds as its exponent nears 0, and so do octaves as their scale does.
    return wp.vec4(finite_or_zero(sum[0]), finite_or_zero(sum[1]), finite_or_zero(sum[2]), finite_or_zero(sum[3]))
