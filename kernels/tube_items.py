# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that find tubes of six sides among triangles and write them for the 8-wide BVH, each as one item.

Hair is drawn as tubes around strands (engine/hair.py). A piece of one has twelve long triangles of about the same box,
so that a ray which comes close meets all their boxes. As one item it has one box, and most rays that meet it are turned
away by their distance from its axis. The others meet its triangles as they would alone: hits are the same bit by bit.

wide_bvh.py tells what an item looks like in memory.
"""

from __future__ import annotations

import warp as wp

from .triangle_split import Box
from .wide_bvh import (
    TRIANGLE_WORDS,
    TUBE,
    TUBE_CROOKED,
    TUBE_HALF,
    TUBE_LEFT,
    TUBE_ROWS,
    TUBE_SIDES,
    TUBE_STEPS,
)
from .wide_bvh_build import FAR

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Of its own widest radius, how long a tube is at least: boxes of a short one's triangles are apart.
SLIMNESS = wp.constant(1.5)

# How far its vertices are from two regular rings at most.
CROOKED = wp.constant(0.3)

# By how much a tube's radius is widened against rounding.
WIDER = wp.constant(1.00001)

Ring = wp.types.vector(length=6, dtype=int)


@wp.struct
class Tube:
    """A closed strip of faces around an axis; `faces` is 0 where there is none."""

    faces: int
    """12 of two triangles on a side, 6 of one"""
    first: Ring
    """Vertices at its beginning, by side"""
    last: Ring
    """Vertices at its end"""


@wp.func
def tube_at(indices: wp.array[int], face: int) -> Tube:
    """Return the tube whose faces begin with one.

    Sides k have the triangles (first k, first k + 1, last k + 1) and, of twelve, (first k, last k + 1, last k).
    """
    tube = Tube()
    count = indices.shape[0] // 3
    step = int(1)
    if face + 12 <= count:
        if indices[3 * face] == indices[3 * face + 3] and indices[3 * face + 2] == indices[3 * face + 4]:
            step = 2
    if face + 6 * step > count:
        return tube
    k = int(0)
    while k < TUBE_SIDES:
        at = 3 * (face + k * step)
        following = wp.where(k == TUBE_SIDES - 1, 3 * face, at + 3 * step)
        if indices[at + 1] != indices[following]:
            return tube
        tube.first[k] = indices[at]
        tube.last[wp.where(k == TUBE_SIDES - 1, 0, k + 1)] = indices[at + 2]
        if step == 2:
            # The second triangle on the side, which ends where the first one of the side before does.
            before = wp.where(k == 0, 3 * (face + 10), at - 6)
            if indices[at + 3] != indices[at] or indices[at + 4] != indices[at + 2]:
                return tube
            if indices[at + 5] != indices[before + 2]:
                return tube
        k = k + 1
    tube.faces = 6 * step
    return tube


@wp.struct
class Shape:
    """A tube as two regular rings around an axis, and how far its vertices are off that."""

    start: wp.vec3
    """Middle of the first ring"""
    end: wp.vec3
    radius: float
    """Of a cylinder around the axis that holds the tube's sides, however long"""
    ratios: wp.uint32
    """Words 9 and 10 of a record, see wide_bvh.py"""
    frame: wp.uint32
    left: int
    """1: vertices go round the axis as a left-handed screw does"""
    fits: int
    """1: it is slim and straight enough to be one item"""


@wp.func
def vertex_of_tube(tube: Tube, k: int) -> int:
    """Return the first ring's vertices, then the second's."""
    if k < TUBE_SIDES:
        return tube.first[k]
    return tube.last[k - TUBE_SIDES]


@wp.func
def across_axis(points: wp.array[wp.vec3], vertex: int, start: wp.vec3, way: wp.vec3) -> wp.vec3:
    """Return where a vertex lies from an axis, at a right angle to it."""
    off = points[vertex] - start
    return off - way * wp.dot(off, way)


@wp.func
def sixteen_bits(share: float) -> wp.uint32:
    """Return a share of 1 in steps of which there are 65,535."""
    return wp.uint32(wp.clamp(65535.0 * share + 0.5, 0.0, 65535.0))


@wp.func
def shape_of(points: wp.array[wp.vec3], tube: Tube) -> Shape:
    """Return a tube's shape."""
    shape = Shape()
    k = int(0)
    while k < TUBE_SIDES:
        shape.start = shape.start + points[tube.first[k]] / 6.0
        shape.end = shape.end + points[tube.last[k]] / 6.0
        k = k + 1
    length = wp.length(shape.end - shape.start)
    way = (shape.end - shape.start) / wp.max(length, 1.0e-30)
    radii = wp.vec2(0.0, 0.0)
    k = int(0)
    while k < 2 * TUBE_SIDES:
        off = wp.length(across_axis(points, vertex_of_tube(tube, k), shape.start, way))
        shape.radius = wp.max(shape.radius, WIDER * off)
        radii[k // TUBE_SIDES] = radii[k // TUBE_SIDES] + off / 6.0
        k = k + 1
    scale = 1.0 / wp.max(shape.radius, 1.0e-30)
    begin = sixteen_bits(radii[0] * scale)
    end = sixteen_bits(radii[1] * scale)
    shape.ratios = begin | (end << wp.uint32(16))
    # The direction of the first vertex, as rays read it.
    first = across_axis(points, tube.first[0], shape.start, way)
    if wp.length(first) < 0.25 * shape.radius:
        first = across_axis(points, tube.last[0], shape.start, way)
    first = first / wp.max(wp.length(first), 1.0e-30)
    read = wp.vec3(0.0, 0.0, 0.0)
    for axis in range(3):
        steps = wp.floor(255.0 * first[axis] + 255.5)
        shape.frame = shape.frame | (wp.uint32(steps) << wp.uint32(9 * axis))
        read[axis] = (steps - 255.0) / 255.0
    # Rays take away what rounding lets it lean.
    read = read - way * wp.dot(way, read)
    other = wp.cross(way, read)
    if wp.dot(other, points[tube.first[1]] - points[tube.first[0]]) + wp.dot(
            other, points[tube.last[1]] - points[tube.last[0]]) < 0.0:
        shape.left = 1
        other = -other
    away = float(0.0)
    k = int(0)
    while k < 2 * TUBE_SIDES:
        angle = float(k % TUBE_SIDES) * (wp.pi / 3.0)
        ring = wp.where(k < TUBE_SIDES, float(begin), float(end)) * shape.radius / 65535.0
        away = wp.max(away, wp.length(
            across_axis(points, vertex_of_tube(tube, k), shape.start, way)
            - ring * (wp.cos(angle) * read + wp.sin(angle) * other)))
        k = k + 1
    # The most steps are more than twice the radius: all sides count then.
    steps = wp.min(wp.ceil(TUBE_STEPS * WIDER * away * scale), 31.0)
    shape.frame = shape.frame | (wp.uint32(steps) << wp.uint32(27))
    if shape.radius > 0.0 and length >= SLIMNESS * shape.radius and away <= CROOKED * shape.radius:
        shape.fits = 1
    return shape


@wp.func
def is_finite_tube(points: wp.array[wp.vec3], tube: Tube) -> bool:
    """Return whether boxes of its triangles have an area."""
    finite = bool(True)
    k = int(0)
    while k < 2 * TUBE_SIDES:
        # False for NaN too.
        finite = finite and wp.length(points[vertex_of_tube(tube, k)]) < FAR
        k = k + 1
    return finite


@wp.kernel
def find_tubes(
    # In:
    points: wp.array[wp.vec3],
    indices: wp.array[int],
    # Out:
    faces_out: wp.array[wp.uint8],
    found_out: wp.array[int],
):
    """Find how many faces the tube has that begins with each face, 0 where none does; found_out[0] is 1 if any does."""
    face = wp.tid()
    faces_out[face] = wp.uint8(0)
    tube = tube_at(indices, face)
    if tube.faces == 0:
        return
    if is_finite_tube(points, tube) and shape_of(points, tube).fits == 1:
        faces_out[face] = wp.uint8(tube.faces)
        found_out[0] = 1


@wp.kernel
def bound_tubes(
    # In:
    points: wp.array[wp.vec3],
    indices: wp.array[int],
    heads: wp.array[int],
    places: wp.array[int],
    # Out:
    lower_out: wp.array[wp.vec3],
    upper_out: wp.array[wp.vec3],
):
    """Find the boxes of tubes by their first faces, and write them to `places`."""
    i = wp.tid()
    tube = tube_at(indices, heads[i])
    low = points[tube.first[0]]
    high = low
    for k in range(6):
        a = points[tube.first[k]]
        b = points[tube.last[k]]
        low = wp.min(low, wp.min(a, b))
        high = wp.max(high, wp.max(a, b))
    lower_out[places[i]] = low
    upper_out[places[i]] = high


@wp.func
def tube_corners(row: int, number: int, half: bool) -> wp.vec3i:
    """Return the rows of a face's vertices, by its number in a tube whose vertices begin at a row."""
    side = wp.where(half, number, number // 2)
    following = wp.where(side == TUBE_SIDES - 1, 0, side + 1)
    if not half and number % 2 == 1:
        return wp.vec3i(row + side, row + TUBE_SIDES + following, row + TUBE_SIDES + side)
    return wp.vec3i(row + side, row + following, row + TUBE_SIDES + following)


@wp.func
def write_vector(words: wp.array[wp.uint32], word: int, value: wp.vec3):
    """Write three words."""
    for axis in range(3):
        words[word + axis] = wp.cast(value[axis], wp.uint32)


@wp.func
def write_tube(words: wp.array[wp.uint32], record: int, row: int, points: wp.array[wp.vec3], tube: Tube, face: int):
    """Write a tube's record and its vertices, which begin at a row; what is not finite lies in the origin."""
    shape = Shape()
    finite = is_finite_tube(points, tube)
    if finite:
        shape = shape_of(points, tube)
    word = TRIANGLE_WORDS * record
    write_vector(words, word, shape.start)
    write_vector(words, word + 4, shape.end)
    words[word + 3] = wp.uint32(face)
    flags = TUBE
    if tube.faces == 6:
        flags = flags | TUBE_HALF
    if shape.left == 1:
        flags = flags | TUBE_LEFT
    if shape.fits == 0:
        flags = flags | TUBE_CROOKED
    words[word + 7] = flags
    words[word + 8] = wp.cast(shape.radius, wp.uint32)
    words[word + 9] = shape.ratios
    words[word + 10] = shape.frame
    words[word + 11] = wp.uint32(row)
    k = int(0)
    while k < TUBE_ROWS:
        write_vector(words, 4 * (row + k), wp.where(finite, points[vertex_of_tube(tube, k)], wp.vec3(0.0, 0.0, 0.0)))
        k = k + 1


@wp.kernel
def write_tubes(
    # In:
    points: wp.array[wp.vec3],
    indices: wp.array[int],
    heads: wp.array[int],
    places: wp.array[int],
    first: int,
    # Out:
    words_out: wp.array[wp.uint32],
):
    """Write tubes by their first faces into the records `places`, their vertices behind `first` records."""
    i = wp.tid()
    write_tube(words_out, places[i], 3 * first + TUBE_ROWS * i, points, tube_at(indices, heads[i]), heads[i])


@wp.func
def tube_box(words: wp.array[wp.uint32], row: int) -> Box:
    """Return the box of the vertices that begin at a row."""
    box = Box()
    for axis in range(3):
        box.low[axis] = wp.cast(words[4 * row + axis], float)
        box.high[axis] = box.low[axis]
        k = int(1)
        while k < TUBE_ROWS:
            value = wp.cast(words[4 * (row + k) + axis], float)
            box.low[axis] = wp.min(box.low[axis], value)
            box.high[axis] = wp.max(box.high[axis], value)
            k = k + 1
    return box
