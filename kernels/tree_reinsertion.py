# SPDX-License-Identifier: GPL-3.0-or-later
"""Moves subtrees of a binary BVH to where they make its boxes smallest.

Bittner, Hapala and Havran, "Fast Insertion-Based Optimization of Bounding Volume Hierarchies" (CGF 2013): a node is
taken out with its subtree and put beside the node where the areas of all boxes above grow the least, which a search
from the root finds, best first. One thread moves one node after the other, so that each move counts with the ones
before it: for the few nodes of the upper levels that is faster than moves at once that must not meet (Meister and
Bittner, "Parallel Reinsertion for Bounding Volume Hierarchy Optimization", CGF 2018).
"""

from __future__ import annotations

import warp as wp

from .cluster_tree import common_area, half_area

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

NO_NODE = wp.constant(-1)


@wp.struct
class Tree:
    """A binary tree of M nodes."""

    children: wp.array[wp.vec2i]
    """NO_NODE twice for leaves"""
    parent: wp.array[int]
    """NO_NODE for the root"""
    lower: wp.array[wp.vec3]
    upper: wp.array[wp.vec3]


@wp.struct
class Search:
    """Nodes that a search has still to look at, as a binary heap with the least growth on top; room for M of each."""

    growth: wp.array[float]
    """Of all boxes above the node"""
    node: wp.array[int]


@wp.func
def push(search: Search, count: int, growth: float, node: int):
    """Add a node to a heap of `count`."""
    i = count
    while i > 0 and search.growth[(i - 1) / 2] > growth:
        search.growth[i] = search.growth[(i - 1) / 2]
        search.node[i] = search.node[(i - 1) / 2]
        i = (i - 1) / 2
    search.growth[i] = growth
    search.node[i] = node


@wp.func
def pop(search: Search, count: int):
    """Take the top off a heap of `count`."""
    growth = search.growth[count - 1]
    node = search.node[count - 1]
    i = int(0)
    while 2 * i + 1 < count - 1:
        child = 2 * i + 1
        if child + 1 < count - 1 and search.growth[child + 1] < search.growth[child]:
            child = child + 1
        if search.growth[child] >= growth:
            break
        search.growth[i] = search.growth[child]
        search.node[i] = search.node[child]
        i = child
    search.growth[i] = growth
    search.node[i] = node


@wp.func
def area_of(tree: Tree, node: int) -> float:
    """Return half the surface of a node's box."""
    return half_area(tree.upper[node] - tree.lower[node])


@wp.func
def replace_child(tree: Tree, parent: int, old: int, new: int):
    """Let a node have another child."""
    pair = tree.children[parent]
    tree.children[parent] = wp.where(pair[0] == old, wp.vec2i(new, pair[1]), wp.vec2i(pair[0], new))
    tree.parent[new] = parent


@wp.func
def refit_above(tree: Tree, first: int):
    """Fit the boxes of a node and of all above it to their children's."""
    node = first
    while node != NO_NODE:
        pair = tree.children[node]
        tree.lower[node] = wp.min(tree.lower[pair[0]], tree.lower[pair[1]])
        tree.upper[node] = wp.max(tree.upper[pair[0]], tree.upper[pair[1]])
        node = tree.parent[node]


@wp.func
def best_sibling(tree: Tree, search: Search, root: int, node: int, usual: int) -> int:
    """Return beside which node one that was taken out lets the boxes grow least; `usual` if there is no other."""
    low = tree.lower[node]
    high = tree.upper[node]
    own = area_of(tree, node)
    best = float(1.0e38)
    sibling = usual
    search.growth[0] = 0.0
    search.node[0] = root
    count = int(1)
    # A box about both has at least the node's own area.
    while count > 0 and search.growth[0] + own < best:
        above = search.growth[0]
        other = search.node[0]
        pop(search, count)
        count = count - 1
        total = above + common_area(low, high, tree.lower, tree.upper, other)
        if total < best and other != root:
            best = total
            sibling = other
        growth = total - area_of(tree, other)
        pair = tree.children[other]
        if pair[0] != NO_NODE and growth + own < best:
            push(search, count, growth, pair[0])
            push(search, count + 1, growth, pair[1])
            count = count + 2
    return sibling


@wp.kernel
def reinsert_nodes(
    # In:
    root: int,
    order: wp.array[int],
    # Out:
    tree_out: Tree,
    search_out: Search,
):
    """Move the nodes of `order`, one after the other; launch one thread."""
    for i in range(order.shape[0]):
        node = order[i]
        parent = tree_out.parent[node]
        if parent != NO_NODE and parent != root:
            above = tree_out.parent[parent]
            pair = tree_out.children[parent]
            usual = wp.where(pair[0] == node, pair[1], pair[0])
            replace_child(tree_out, above, parent, usual)
            refit_above(tree_out, above)
            sibling = best_sibling(tree_out, search_out, root, node, usual)
            replace_child(tree_out, tree_out.parent[sibling], sibling, parent)
            tree_out.children[parent] = wp.vec2i(sibling, node)
            tree_out.parent[sibling] = parent
            tree_out.parent[node] = parent
            refit_above(tree_out, parent)


@wp.kernel
def leave_out(
    # In:
    nodes: wp.array[int],
    # Out:
    kept_out: wp.array[int],
):
    """Mark nodes, of which all are marked 1, as left out."""
    kept_out[nodes[wp.tid()]] = 0


@wp.kernel
def move_below(
    # In:
    kept: wp.array[int],
    places: wp.array[int],
    children: wp.array[wp.vec2i],
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    children_out: wp.array[wp.vec2i],
    lower_out: wp.array[wp.vec3],
    upper_out: wp.array[wp.vec3],
):
    """Copy the nodes that are `kept` to their `places`; none of them has children that are left out."""
    i = wp.tid()
    place = places[i]
    if kept[i] == 1:
        pair = children[i]
        if pair[0] >= 0:
            pair = wp.vec2i(places[pair[0]], places[pair[1]])
        children_out[place] = pair
        lower_out[place] = lower[i]
        upper_out[place] = upper[i]
