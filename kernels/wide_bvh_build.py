# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that turn a binary BVH over triangles into the 8-wide one of wide_bvh.py.

Which binary nodes become children is chosen by dynamic programming over the surface area heuristic (Ylitie et al.
2017, section 3): for every binary node the least cost of making it at most 1 to 7 wide subtrees, from the leaves up;
then wide nodes are opened from the root down, a level at a time. Nothing here depends on the order of threads.
"""

from __future__ import annotations

import warp as wp

from .cluster_tree import half_area
from .wide_bvh import LEAF_SIZE, NODE_WORDS, TRIANGLE_WORDS

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Squares of this are far from the largest float32.
FAR = wp.constant(1.0e15)

# Child boxes are widened by so many quanta, more than rounding moves a plane by.
MARGIN = wp.constant(0.015625)

# Cost of testing a triangle, in visits of nodes.
TRIANGLE_COST = wp.constant(0.3)

Slots = wp.types.vector(8, int)


@wp.kernel
def triangle_bounds(
    # In:
    points: wp.array[wp.vec3],
    indices: wp.array[int],
    faces: wp.array[int],
    # Out:
    lower_out: wp.array[wp.vec3],
    upper_out: wp.array[wp.vec3],
):
    """Find the boxes of triangles; what lies too far out for its box to have an area is taken to lie in the origin."""
    i = wp.tid()
    first = 3 * faces[i]
    p = points[indices[first]]
    q = points[indices[first + 1]]
    r = points[indices[first + 2]]
    low = wp.min(p, wp.min(q, r))
    high = wp.max(p, wp.max(q, r))
    reach = wp.max(wp.length(p), wp.max(wp.length(q), wp.length(r)))
    # False for NaN too.
    if not (reach < FAR):
        low = wp.vec3(0.0, 0.0, 0.0)
        high = low
    lower_out[i] = low
    upper_out[i] = high


@wp.kernel
def plan_nodes(
    # In:
    first: int,
    children: wp.array[wp.vec2i],
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    cost_out: wp.array[float],
    choice_out: wp.array[wp.uint8],
    count_out: wp.array[int],
):
    """Find the least costs of binary nodes from `first` on as at most 1 to 7 subtrees, those of their children known.

    Costs are in visits of nodes times half areas. choice_out holds 9 values a node. At 1: whether one subtree is best
    a leaf (1) or a node (0); at 2 to 8: how many of so many subtrees the left child gets, 0 where one fewer cost the
    same.
    """
    node = first + wp.tid()
    area = half_area(upper[node] - lower[node])
    left = children[node][0]
    right = children[node][1]
    if left < 0:
        count_out[node] = right
        choice_out[9 * node + 1] = wp.uint8(1)
        i = int(0)
        while i < 7:
            cost_out[7 * node + i] = area * TRIANGLE_COST * float(right)
            i = i + 1
        return
    count = count_out[left] + count_out[right]
    count_out[node] = count
    last = float(0.0)
    j = int(8)
    while j > 1:
        best = float(1.0e38)
        best_k = int(1)
        k = int(1)
        while k < j:
            cost = cost_out[7 * left + k - 1] + cost_out[7 * right + j - k - 1]
            if cost < best:
                best = cost
                best_k = k
            k = k + 1
        choice_out[9 * node + j] = wp.uint8(best_k)
        if j == 8:
            last = best
        else:
            cost_out[7 * node + j - 1] = best
        j = j - 1
    alone = last + area
    choice_out[9 * node + 1] = wp.uint8(0)
    if count <= LEAF_SIZE and area * TRIANGLE_COST * float(count) < alone:
        alone = area * TRIANGLE_COST * float(count)
        choice_out[9 * node + 1] = wp.uint8(1)
    cost_out[7 * node] = alone
    j = int(2)
    while j < 8:
        if cost_out[7 * node + j - 2] <= cost_out[7 * node + j - 1]:
            cost_out[7 * node + j - 1] = cost_out[7 * node + j - 2]
            choice_out[9 * node + j] = wp.uint8(0)
        j = j + 1


@wp.func
def chosen_children(children: wp.array[wp.vec2i], choice: wp.array[wp.uint8], root: int) -> Slots:
    """Return the binary nodes that become the children of a wide node, -1 after the last."""
    found = Slots(-1, -1, -1, -1, -1, -1, -1, -1)
    nodes = Slots(0, 0, 0, 0, 0, 0, 0, 0)
    shares = Slots(0, 0, 0, 0, 0, 0, 0, 0)
    nodes[0] = root
    shares[0] = 8
    waiting = int(1)
    emitted = int(0)
    while waiting > 0:
        waiting = waiting - 1
        node = nodes[waiting]
        share = shares[waiting]
        left = children[node][0]
        if share == 1 or left < 0:
            found[emitted] = node
            emitted = emitted + 1
        else:
            to_left = int(choice[9 * node + share])
            if to_left == 0:
                shares[waiting] = share - 1
                waiting = waiting + 1
            else:
                nodes[waiting] = left
                shares[waiting] = to_left
                nodes[waiting + 1] = children[node][1]
                shares[waiting + 1] = share - to_left
                waiting = waiting + 2
    return found


@wp.func
def in_octants(found: Slots, center: wp.vec3, lower: wp.array[wp.vec3], upper: wp.array[wp.vec3]) -> Slots:
    """Return children in slots such that a ray of octant o meets them, roughly, in the order of slot xor o."""
    slots = Slots(-1, -1, -1, -1, -1, -1, -1, -1)
    left = found
    taken = int(0)
    while taken < 8:
        best = float(1.0e38)
        best_child = int(-1)
        best_slot = int(-1)
        c = int(0)
        while c < 8:
            node = left[c]
            if node >= 0:
                offset = 0.5 * (lower[node] + upper[node]) - center
                s = int(0)
                while s < 8:
                    if slots[s] < 0:
                        x = wp.where((s & 4) != 0, -offset[0], offset[0])
                        y = wp.where((s & 2) != 0, -offset[1], offset[1])
                        z = wp.where((s & 1) != 0, -offset[2], offset[2])
                        if best_child < 0 or x + y + z < best:
                            best = x + y + z
                            best_child = c
                            best_slot = s
                    s = s + 1
            c = c + 1
        if best_child >= 0:
            slots[best_slot] = left[best_child]
            left[best_child] = -1
            taken = taken + 1
        else:
            taken = 8
    return slots


@wp.kernel
def open_nodes(
    # In:
    roots: wp.array[int],
    children: wp.array[wp.vec2i],
    choice: wp.array[wp.uint8],
    count: wp.array[int],
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    slots_out: wp.array[int],
    inner_out: wp.array[int],
    triangles_out: wp.array[int],
):
    """Choose the children of a level's wide nodes; count those that are nodes, and the triangles of the others."""
    i = wp.tid()
    root = roots[i]
    slots = in_octants(
        chosen_children(children, choice, root), 0.5 * (lower[root] + upper[root]), lower, upper)
    inner = int(0)
    triangles = int(0)
    s = int(0)
    while s < 8:
        node = slots[s]
        slots_out[8 * i + s] = node
        if node >= 0:
            if choice[9 * node + 1] == wp.uint8(1):
                triangles = triangles + count[node]
            else:
                inner = inner + 1
        s = s + 1
    inner_out[i] = inner
    triangles_out[i] = triangles


@wp.func
def spacing_exponent(size: float) -> wp.uint32:
    """Return the biased exponent of the least power of two of which 250 are as much as `size`."""
    bits = wp.cast(size / 250.0, wp.uint32)
    return wp.clamp((bits + wp.uint32(0x007FFFFF)) >> wp.uint32(23), wp.uint32(1), wp.uint32(254))


@wp.struct
class Grid:
    """The grid of a node's child boxes."""

    origin: wp.vec3
    quantum: wp.vec3


@wp.func
def grid_about(low: wp.vec3, high: wp.vec3) -> Grid:
    """Return the finest grid that holds a box."""
    grid = Grid()
    for axis in range(3):
        reach = wp.max(wp.abs(low[axis]), wp.abs(high[axis]))
        exponent = spacing_exponent((high[axis] - low[axis]) + 4.0e-7 * reach + 1.0e-30)
        grid.quantum[axis] = wp.cast(exponent << wp.uint32(23), float)
        # At least one step of float32 below the box, and more than the margin.
        grid.origin[axis] = low[axis] - wp.max(2.0 * MARGIN * grid.quantum[axis], 1.2e-7 * reach)
    return grid


@wp.func
def write_grid(words: wp.array[wp.uint32], base: int, grid: Grid, bits: wp.uint32):
    """Write the first four words of a node; `bits` tells in the top byte which slots are nodes."""
    packed = bits
    for axis in range(3):
        words[base + axis] = wp.cast(grid.origin[axis], wp.uint32)
        packed = packed | ((wp.cast(grid.quantum[axis], wp.uint32) >> wp.uint32(23)) << wp.uint32(8 * axis))
    words[base + 3] = packed


@wp.func
def list_items(children: wp.array[wp.vec2i], root: int, first: int, items: wp.array[int]):
    """Write the items of a leaf, a subtree of at most three binary leaves of one item each."""
    nodes = Slots(0, 0, 0, 0, 0, 0, 0, 0)
    nodes[0] = root
    waiting = int(1)
    written = int(0)
    while waiting > 0:
        waiting = waiting - 1
        node = nodes[waiting]
        if children[node][0] < 0:
            items[first + written] = -1 - children[node][0]
            written = written + 1
        else:
            nodes[waiting] = children[node][0]
            nodes[waiting + 1] = children[node][1]
            waiting = waiting + 2


@wp.func
def add_byte(words: wp.array[wp.uint32], word: int, slot: int, value: wp.uint32):
    """Put a byte in its place of two words of eight."""
    at = word + slot // 4
    words[at] = words[at] | (value << wp.uint32(8 * (slot % 4)))


@wp.func
def add_box(words: wp.array[wp.uint32], base: int, slot: int, grid: Grid, low: wp.vec3, high: wp.vec3):
    """Put a child's box into a node whose planes are zeroed."""
    for axis in range(3):
        first = wp.floor((low[axis] - grid.origin[axis]) / grid.quantum[axis] - MARGIN)
        last = wp.ceil((high[axis] - grid.origin[axis]) / grid.quantum[axis] + MARGIN)
        add_byte(words, base + 8 + 2 * axis, slot, wp.uint32(wp.clamp(first, 0.0, 255.0)))
        add_byte(words, base + 14 + 2 * axis, slot, wp.uint32(wp.clamp(last, 0.0, 255.0)))


@wp.kernel
def write_nodes(
    # In:
    roots: wp.array[int],
    slots: wp.array[int],
    inner: wp.array[int],
    triangles: wp.array[int],
    first_node: int,
    first_child: int,
    first_triangle: int,
    children: wp.array[wp.vec2i],
    choice: wp.array[wp.uint8],
    count: wp.array[int],
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    words_out: wp.array[wp.uint32],
    next_out: wp.array[int],
    items_out: wp.array[int],
):
    """Write a level's nodes into zeroed words, and the binary nodes of the next level and the items in leaves.

    `inner` and `triangles` hold how many of each the level's nodes before have.
    """
    i = wp.tid()
    low = lower[roots[i]]
    high = upper[roots[i]]
    base = NODE_WORDS * (first_node + i)
    grid = grid_about(low, high)
    bits = wp.uint32(0)
    words_out[base + 4] = wp.uint32(first_child + inner[i])
    words_out[base + 5] = wp.uint32(first_triangle + triangles[i])
    nodes = int(0)
    listed = int(0)
    s = int(0)
    while s < 8:
        node = slots[8 * i + s]
        if node >= 0:
            if choice[9 * node + 1] == wp.uint8(1):
                ones = (wp.uint32(1) << wp.uint32(count[node])) - wp.uint32(1)
                add_byte(words_out, base + 6, s, (ones << wp.uint32(5)) | wp.uint32(listed))
                list_items(children, node, first_triangle + triangles[i] + listed, items_out)
                listed = listed + count[node]
            else:
                add_byte(words_out, base + 6, s, wp.uint32(0x20 + 24 + s))
                bits = bits | (wp.uint32(1) << wp.uint32(24 + s))
                next_out[inner[i] + nodes] = node
                nodes = nodes + 1
            add_box(words_out, base, s, grid, lower[node], upper[node])
        s = s + 1
    write_grid(words_out, base, grid, bits)


@wp.kernel
def write_triangles(
    # In:
    points: wp.array[wp.vec3],
    indices: wp.array[int],
    items: wp.array[int],
    faces: wp.array[int],
    steps: wp.array[wp.vec2ui],
    # Out:
    words_out: wp.array[wp.uint32],
):
    """Write the triangles of references, `items`, in the order of the leaves, and which part each stands for."""
    i = wp.tid()
    face = faces[items[i]]
    for k in range(3):
        point = points[indices[3 * face + k]]
        words_out[TRIANGLE_WORDS * i + 4 * k] = wp.cast(point[0], wp.uint32)
        words_out[TRIANGLE_WORDS * i + 4 * k + 1] = wp.cast(point[1], wp.uint32)
        words_out[TRIANGLE_WORDS * i + 4 * k + 2] = wp.cast(point[2], wp.uint32)
    words_out[TRIANGLE_WORDS * i + 3] = wp.uint32(face)
    words_out[TRIANGLE_WORDS * i + 7] = steps[items[i]][0]
    words_out[TRIANGLE_WORDS * i + 11] = steps[items[i]][1]
