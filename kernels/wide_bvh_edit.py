# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that take triangles out of an 8-wide BVH (wide_bvh.py), or move them, and fit its boxes to what is there."""

from __future__ import annotations

import warp as wp

from .triangle_split import Box, part_box
from .tube_items import tube_at, tube_box, write_tube
from .wide_bvh import NODE_WORDS, TRIANGLE_WORDS, TUBE
from .wide_bvh_build import FAR, Grid, add_box, add_byte, grid_about, write_grid

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# In place of the face of a triangle that was taken out.
GONE = wp.constant(wp.uint32(0xFFFFFFFF))
# What references may stand for besides triangles: parts of them (triangle_split.py) and tubes (tube_items.py).
SPLIT_PARTS = wp.constant(1)
TUBE_PARTS = wp.constant(2)
# Corners of the box of nothing.
NOWHERE = wp.constant(3.0e38)


@wp.struct
class Child:
    """What a slot of a node holds."""

    meta: wp.uint32
    """Its byte, see wide_bvh.py; 0 where nothing is left"""
    low: wp.vec3
    high: wp.vec3


@wp.kernel
def mark_gone(
    # In:
    faces: wp.array[wp.vec2i],
    leaving: wp.array[int],
    # Out:
    triangles_out: wp.array[wp.uint32],
):
    """Mark all references to instances for which `leaving` is 1; `faces` holds (instance, triangle) by face."""
    word = TRIANGLE_WORDS * wp.tid() + 3
    face = triangles_out[word]
    if face != GONE:
        if leaving[faces[int(face)][0]] == 1:
            triangles_out[word] = GONE


@wp.kernel
def place_triangles(
    # In:
    points: wp.array[wp.vec3],
    indices: wp.array[int],
    parts: int,
    # Out:
    triangles_out: wp.array[wp.uint32],
):
    """Put all references' vertices where they are now.

    In detail:
        indices: As those that the triangles were written from.
        parts: What references may stand for: TUBE_PARTS.
    """
    word = TRIANGLE_WORDS * wp.tid()
    face = int(triangles_out[word + 3])
    if (parts & TUBE_PARTS) != 0 and (triangles_out[word + 7] & TUBE) != wp.uint32(0):
        write_tube(triangles_out, wp.tid(), int(triangles_out[word + 11]), points, tube_at(indices, face), face)
        return
    reach = float(0.0)
    for k in range(3):
        reach = wp.max(reach, wp.length(points[indices[3 * face + k]]))
    for k in range(3):
        point = points[indices[3 * face + k]]
        # False for NaN too: as triangle_bounds takes it.
        if not (reach < FAR):
            point = wp.vec3(0.0, 0.0, 0.0)
        for axis in range(3):
            triangles_out[word + 4 * k + axis] = wp.cast(point[axis], wp.uint32)


@wp.func
def corner_at(triangles: wp.array[wp.uint32], word: int) -> wp.vec3:
    """Return a vertex."""
    return wp.vec3(
        wp.cast(triangles[word], float), wp.cast(triangles[word + 1], float), wp.cast(triangles[word + 2], float))


@wp.func
def reference_box(triangles: wp.array[wp.uint32], word: int, parts: int) -> Box:
    """Return the box of the tube, the triangle or the part of one that a reference stands for."""
    if (parts & TUBE_PARTS) != 0 and (triangles[word + 7] & TUBE) != wp.uint32(0):
        return tube_box(triangles, int(triangles[word + 11]))
    p = corner_at(triangles, word)
    q = corner_at(triangles, word + 4)
    r = corner_at(triangles, word + 8)
    steps = wp.vec2ui(wp.uint32(0), wp.uint32(0))
    if (parts & SPLIT_PARTS) != 0:
        steps = wp.vec2ui(triangles[word + 7], triangles[word + 11])
    return part_box(wp.min(p, wp.min(q, r)), wp.max(p, wp.max(q, r)), steps)


@wp.func
def child_in(
    words: wp.array[wp.uint32], triangles: wp.array[wp.uint32], lower: wp.array[wp.vec3], upper: wp.array[wp.vec3],
    base: int, meta: wp.uint32, node: int, parts: int,
) -> Child:
    """Return a slot's child without the triangles that are gone; `node` is the child's number where it is a node."""
    child = Child()
    child.low = wp.vec3(NOWHERE, NOWHERE, NOWHERE)
    child.high = -child.low
    if (meta & wp.uint32(0x18)) == wp.uint32(0x18):
        child.low = lower[node]
        child.high = upper[node]
        if child.low[0] <= child.high[0]:
            child.meta = meta
        return child
    first = int(words[base + 5]) + int(meta & wp.uint32(31))
    for k in range(3):
        bit = wp.uint32(32 << k)
        word = TRIANGLE_WORDS * (first + k)
        if (meta & bit) != wp.uint32(0):
            if triangles[word + 3] != GONE:
                child.meta = child.meta | bit
                part = reference_box(triangles, word, parts)
                child.low = wp.min(child.low, part.low)
                child.high = wp.max(child.high, part.high)
    if child.meta != wp.uint32(0):
        child.meta = child.meta | (meta & wp.uint32(31))
    return child


@wp.kernel
def refit_nodes(
    # In:
    first: int,
    triangles: wp.array[wp.uint32],
    parts: int,
    # Out:
    words_out: wp.array[wp.uint32],
    lower_out: wp.array[wp.vec3],
    upper_out: wp.array[wp.vec3],
):
    """Write a level's nodes from number `first` on anew, those of the levels below done.

    `parts`: what references may stand for. What is empty now keeps its number and, where it is a node, its bit among
    those that are: both count for others.
    """
    node = first + wp.tid()
    base = NODE_WORDS * node
    bits = (words_out[base + 3] >> wp.uint32(24)) << wp.uint32(24)
    meta = wp.vec2ui(words_out[base + 6], words_out[base + 7])
    low = wp.vec3(NOWHERE, NOWHERE, NOWHERE)
    high = -low
    # First the box of all, which decides the grid; then the children's boxes in it.
    grid = Grid()
    turn = int(0)
    while turn < 2:
        number = int(words_out[base + 4])
        slot = int(0)
        while slot < 8:
            byte = (meta[slot // 4] >> wp.uint32(8 * (slot % 4))) & wp.uint32(255)
            child = child_in(words_out, triangles, lower_out, upper_out, base, byte, number, parts)
            if child.meta != wp.uint32(0):
                if turn == 0:
                    low = wp.min(low, child.low)
                    high = wp.max(high, child.high)
                else:
                    add_byte(words_out, base + 6, slot, child.meta)
                    add_box(words_out, base, slot, grid, child.low, child.high)
            if (bits & (wp.uint32(1) << wp.uint32(24 + slot))) != wp.uint32(0):
                number = number + 1
            slot = slot + 1
        if turn == 0 and low[0] <= high[0]:
            grid = grid_about(low, high)
        if turn == 0:
            word = int(6)
            while word < NODE_WORDS:
                words_out[base + word] = wp.uint32(0)
                word = word + 1
        turn = turn + 1
    lower_out[node] = low
    upper_out[node] = high
    write_grid(words_out, base, grid, bits)
