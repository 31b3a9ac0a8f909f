# SPDX-License-Identifier: GPL-3.0-or-later
"""Mends the upper levels of a binary BVH, through which all rays go: see kernels/tree_reinsertion.py.

Clustering builds from the leaves up, so that what is left at last is merged as it comes. Boxes on the way down are
never larger, so the nodes with the largest ones are a tree of their own. In the six scenes of docs/speed.md a thousand
of them make rays visit 7 to 14 % fewer nodes, and all nodes hardly more.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import tree_reinsertion as kernels
from ..kernels.cluster_tree import write_areas
from .binary_tree import BinaryTree
from .device import launch

__all__ = ["mend_upper_levels"]

UPPER_NODES = 1024
"""Nodes that are mended: twice as many bring nothing more"""

PASSES = 2
"""How often each is moved: further ones make boxes smaller, but rays do not visit fewer"""


def mend_upper_levels(tree: BinaryTree) -> BinaryTree:
    """Return the tree with its upper nodes where they make boxes smallest; the tree itself where it has few nodes.

    Takes 10 to 20 ms on the host, whatever the device.
    """
    chosen = _largest(_areas(tree.lower, tree.upper), tree.batches[0][1])
    if len(chosen) < 2:
        return tree
    pairs = _taken(tree.children, chosen)
    below = np.setdiff1d(pairs, chosen)
    upper = _Upper(np.concatenate([below, chosen]), pairs, tree)
    upper.mend()
    return upper.put_back(tree)


def _areas(lower: wp.array, upper: wp.array) -> np.ndarray:
    """Return half the surface of boxes, float32 [N]."""
    areas = wp.empty(len(lower), dtype=float, device=lower.device)
    launch(write_areas, len(lower), [lower, upper], [areas], lower.device.alias)
    return areas.numpy()


def _largest(areas: np.ndarray, leaves: int) -> np.ndarray:
    """Return, ascending, the inner nodes with the largest boxes; none where a box is not finite.

    Of equals the later ones, among which parents are. `leaves`: nodes before the first inner one.
    """
    inner = areas[leaves:]
    if not np.isfinite(areas[-1]):
        return np.zeros(0, np.int64)
    count = min(UPPER_NODES, len(inner))
    least = np.partition(inner, len(inner) - count)[len(inner) - count] if count else 0.0
    larger = np.flatnonzero(inner > least)
    equal = np.flatnonzero(inner == least)
    return leaves + np.sort(np.concatenate([larger, equal[len(equal) - (count - len(larger)):]]))


def _taken(array: wp.array, rows: np.ndarray) -> np.ndarray:
    """Return some rows of a device's array."""
    return array[wp.array(rows.astype(np.int32), dtype=int, device=array.device)].contiguous().numpy()


class _Upper:
    """The upper nodes of a tree, those right below them as leaves, on the host."""

    def __init__(self, nodes: np.ndarray, pairs: np.ndarray, tree: BinaryTree):
        """Take them from a tree.

        Args:
            nodes: int [M], their numbers there: leaves first.
            pairs: int [inner, 2], the children of those that are none.
            tree: The tree.
        """
        self.nodes, self.leaves = nodes, len(nodes) - len(pairs)
        place = {node: i for i, node in enumerate(nodes.tolist())}
        self.children = np.full((len(nodes), 2), int(kernels.NO_NODE), np.int32)
        self.children[self.leaves:] = [[place[left], place[right]] for left, right in pairs.tolist()]
        parent = np.full(len(nodes), int(kernels.NO_NODE), np.int32)
        parent[self.children[self.leaves:]] = np.arange(self.leaves, len(nodes))[:, None]
        arrays = [(self.children, wp.vec2i), (parent, int), (_taken(tree.lower, nodes), wp.vec3),
                  (_taken(tree.upper, nodes), wp.vec3)]
        self.tree = kernels.Tree()
        self.tree.children, self.tree.parent, self.tree.lower, self.tree.upper = (
            wp.array(values, dtype=kind, device="cpu") for values, kind in arrays)

    def mend(self) -> None:
        """Move every node, those with the largest boxes first."""
        root, count = len(self.nodes) - 1, len(self.nodes)
        search = kernels.Search()
        search.growth = wp.empty(count, dtype=float, device="cpu")
        search.node = wp.empty(count, dtype=int, device="cpu")
        for _ in range(PASSES):
            areas = _areas(self.tree.lower, self.tree.upper)
            order = np.argsort(-areas[:root], kind="stable").astype(np.int32)
            launch(kernels.reinsert_nodes, 1, [root, wp.array(order, dtype=int, device="cpu")],
                   [self.tree, search], "cpu")
        self.children = self.tree.children.numpy()

    def _heights(self) -> np.ndarray:
        """Return how many levels of upper nodes are below each, 0 for leaves."""
        heights = np.zeros(len(self.nodes), np.int64)
        inner = np.arange(self.leaves, len(self.nodes))
        while True:
            found = heights[self.children[inner]].max(1) + 1
            if np.array_equal(found, heights[inner]):
                return heights
            heights[inner] = found

    def put_back(self, tree: BinaryTree) -> BinaryTree:
        """Return the whole tree, the upper nodes last and level by level, so that children come first again."""
        device, total = tree.children.device.alias, len(tree.children)
        inner = len(self.nodes) - self.leaves
        chosen = np.sort(self.nodes[self.leaves:]).astype(np.int32)
        kept, places = wp.full(total, 1, dtype=int, device=device), wp.empty(total, dtype=int, device=device)
        launch(kernels.leave_out, inner, [wp.array(chosen, dtype=int, device=device)], [kept], device)
        wp.utils.array_scan(kept, places, inclusive=False)
        children = wp.empty(total, dtype=wp.vec2i, device=device)
        lower, upper = (wp.empty(total, dtype=wp.vec3, device=device) for _ in range(2))
        launch(kernels.move_below, total, [kept, places, tree.children, tree.lower, tree.upper],
               [children, lower, upper], device)
        heights = self._heights()
        order = self.leaves + np.argsort(heights[self.leaves:], kind="stable")
        numbers = self.nodes - np.searchsorted(chosen, self.nodes)
        numbers[order] = np.arange(total - inner, total)
        for array, values in ((children, numbers[self.children[order]]), (lower, self.tree.lower.numpy()[order]),
                              (upper, self.tree.upper.numpy()[order])):
            wp.copy(array, wp.array(np.ascontiguousarray(values), dtype=array.dtype, device=device),
                    dest_offset=total - inner)

        def before(node: int) -> int:
            return node - int(np.searchsorted(chosen, node))

        batches = [(before(first), before(first + count) - before(first)) for first, count in tree.batches]
        first = total - inner
        for count in np.bincount(heights[order])[1:].tolist():
            batches.append((first, count))
            first += count
        return BinaryTree(children, lower, upper, [batch for batch in batches if batch[1]])
