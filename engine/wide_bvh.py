# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the 8-wide BVH of kernels/wide_bvh.py: triangles are split, clustered to a binary tree, then collapsed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import cluster_tree, triangle_split
from ..kernels import wide_bvh_build as kernels
from ..kernels.wide_bvh import NODE_WORDS
from ..kernels.wide_bvh_edit import SPLIT_PARTS, TUBE_PARTS, mark_gone, refit_nodes
from ..kernels.wide_query import MAX_DEPTH
from .binary_tree import BinaryTree
from .bvh_references import References, bound_tubes, one_to_each, whole_triangles, with_tubes, write_references
from .device import launch, launch_bands
from .errors import InvalidScene
from .frame_graph import FrameGraph
from .tree_reinsertion import mend_upper_levels
from .tube_items import find_tubes

__all__ = ["WideBvh", "build_forest", "build_over", "build_wide"]

RADIUS = 16
"""Places along the curve to each side among which a cluster looks for its neighbor"""

SLOW = 16
"""A round is slow when less than one in so many clusters finds a partner"""

PATIENCE = 128
"""Slow rounds after which, following each further one, neighbors on the curve are merged as they come. That bounds the
rounds where each cluster holds the one before, but spoils the uppermost levels, through which all rays go: rooms within
rooms have about 110 slow rounds, which take little time, as few clusters are left by then"""

MAX_TRIANGLES = (2**31 - 1) // 18
"""Of a binary tree's nodes, twice as many, each has nine values in an array that is indexed by int32"""

SPLIT_SHARE = 0.3
"""Most references more than triangles, as a share of these: of triangle splitting, 0.1 brings two thirds of what 0.3
does, and 0.5 hardly more"""

SPLIT_AREA = 0.65
"""Share of the boxes' area to which splitting must bring it. Where long slats lie askew rays then meet half as many
boxes and triangles; where few triangles do, more references spoil the tree as much as smaller boxes mend it"""

FACTORS = 20
"""Powers of two that are tried for the factor of splits: no triangle is split for less than 2**-40 of the scene"""


@dataclass
class WideBvh:
    """An 8-wide BVH over N references to triangles, or parts of them, on one device."""

    nodes: wp.array
    """uint32 [20 * nodes], level by level"""
    triangles: wp.array
    """uint32 [12 * N], by reference, then the tubes' vertices or the opacity maps (opacity_maps.py)"""
    levels: list[tuple[int, int]]
    """First node and count of each"""
    references: int
    """N"""
    wholes: wp.array
    """int: for each triangle 16 times a reference to it, plus its number in a tube, ascending; empty where each
    triangle has one reference"""
    split: bool = False
    """Whether some triangles have more than one reference"""
    tubes: bool = False
    """Whether some references are tubes (tube_items.py)"""

    @property
    def parts(self) -> int:
        """Return what references may stand for, as wide_bvh_edit.py has it."""
        return int(self.split) * int(SPLIT_PARTS) + int(self.tubes) * int(TUBE_PARTS)

    @property
    def triangle_count(self) -> int:
        """Return how many triangles there are."""
        return len(self.wholes) or self.references

    def take_out(self, faces: wp.array, leaving: wp.array) -> None:
        """Take out the triangles of instances, in place, and shrink the boxes above them.

        Args:
            faces: vec2i, (instance, triangle) of each face.
            leaving: int, 1 for every instance that leaves.
        """
        device = self.nodes.device.alias
        launch(mark_gone, self.references, [faces, leaving], [self.triangles], device)
        self.refit()

    def refit(self) -> tuple[wp.array, wp.array]:
        """Write all boxes anew, in place, for triangles that are elsewhere; return each node's, vec3."""
        lower, upper = self._corners()
        for count, inputs in self._refits():
            launch(refit_nodes, count, inputs, [self.nodes, lower, upper], self.nodes.device.alias)
        return lower, upper

    def record_refit(self, graph: FrameGraph) -> tuple[wp.array, wp.array]:
        """Record the same."""
        lower, upper = self._corners()
        for count, inputs in self._refits():
            graph.launch(refit_nodes, count, inputs, [self.nodes, lower, upper], banded=False)
        return lower, upper

    def _corners(self) -> tuple[wp.array, wp.array]:
        count, device = len(self.nodes) // NODE_WORDS, self.nodes.device
        return wp.empty(count, dtype=wp.vec3, device=device), wp.empty(count, dtype=wp.vec3, device=device)

    def _refits(self) -> list[tuple[int, list]]:
        """Return threads and inputs of each launch of refit_nodes, children first."""
        return [(count, [first, self.triangles, self.parts]) for first, count in reversed(self.levels)]


def build_wide(points: wp.array, indices: wp.array, *, opaque: bool = True, deforming: bool = False) -> WideBvh:
    """Build the structure over triangles.

    Args:
        points: vec3 [V]; triangles that are not finite are never hit.
        indices: int [3 * N], N > 0.
        opaque: Whether rays ask for hits, not for layers: then large slanted triangles may get several references,
            where that pays, and tubes are one.
        deforming: Whether the vertices will move: no triangle has several references then.

    Raises:
        InvalidScene: There are too many triangles.
    """
    device, count = points.device.alias, len(indices) // 3
    if count > MAX_TRIANGLES:
        raise InvalidScene(
            f"The scene has {count:,} triangles outside of instances, or in one mesh, more than the {MAX_TRIANGLES:,} "
            "that Burnish can keep; let objects share their meshes, or hide some")
    tubes = find_tubes(points, indices) if opaque else None
    whole = one_to_each(points, indices, None if tubes is None else tubes.others)
    split = _split(points, indices, whole) if opaque and not deforming and len(whole.faces) else None
    parts = split or whole
    if tubes is not None:
        parts = with_tubes(points, indices, parts, tubes)
    nodes, items, levels = build_over(parts.lower, parts.upper)
    triangles = write_references(points, indices, items, parts)
    wholes = whole_triangles(items.numpy(), parts) if split or tubes else np.zeros(0, np.int32)
    return WideBvh(nodes, triangles, levels, len(items), wp.array(wholes, dtype=int, device=device),
                   split is not None, tubes is not None)


def build_over(lower: wp.array, upper: wp.array) -> tuple[wp.array, wp.array, list[tuple[int, int]]]:
    """Build nodes over boxes.

    Args:
        lower: vec3 [N], N > 0.
        upper: vec3 [N].

    Returns:
        The nodes; int [N], the boxes in the leaves' order; first node and count of each level.
    """
    # Sizes that grow from box to box may make a chain, shorter without patience. Pairs along the curve make a tree of
    # at most as many levels as the count has bits.
    for radius, patience in ((RADIUS, PATIENCE), (RADIUS, 0), (0, 0)):
        tree = _cluster(lower, upper, radius, patience)
        made = _collapse(mend_upper_levels(tree) if patience else tree, len(lower))
        if patience and len(made[2]) > MAX_DEPTH:
            made = _collapse(tree, len(lower))
        if len(made[2]) <= MAX_DEPTH:
            break
    return made


def build_forest(
    points: wp.array, indices: wp.array, counts: np.ndarray, *, opaque: bool = True,
) -> WideBvh | None:
    """Build a tree for each of M meshes, together, as the launches for a small one take longer than its work.

    Args:
        points: vec3 [V].
        indices: int [3 * N], the meshes one after another.
        counts: int [M], triangles of each, above 0.
        opaque: As for build_wide.

    Returns:
        All trees, the first M nodes their roots; None where one is too deep, which build_wide can help.
    """
    tubes = find_tubes(points, indices) if opaque else None
    if tubes is None:
        parts = one_to_each(points, indices, None)
    else:
        # In the meshes' order, each of which is a tree.
        chosen = np.sort(np.concatenate([tubes.others, tubes.heads]))
        parts = one_to_each(points, indices, chosen)
        parts.sizes = np.ones(len(chosen), np.int32)
        bound_tubes(points, indices, parts, tubes, np.searchsorted(chosen, tubes.heads).astype(np.int32))
        ends = np.searchsorted(chosen, np.cumsum(counts))
        counts = np.diff(ends, prepend=0)
    tree = _cluster(parts.lower, parts.upper, RADIUS, PATIENCE, counts)
    nodes, items, levels = _collapse(tree, len(parts.faces))
    if len(levels) > MAX_DEPTH:
        return None
    triangles = write_references(points, indices, items, parts)
    return WideBvh(nodes, triangles, levels, len(items), wp.zeros(0, dtype=int, device=points.device),
                   tubes=tubes is not None)


def _split(points: wp.array, indices: wp.array, whole: References) -> References | None:
    """Return references to triangles, one to most of them, more to large slanted ones; None where that doesn't pay."""
    device, count, area = points.device.alias, len(whole.faces), whole.area
    priority = wp.empty(count, dtype=float, device=device)
    triangles = [points, indices, whole.faces, whole.lower, whole.upper]
    launch(triangle_split.find_priorities, count, triangles, [priority], device)
    # At least the area that splitting without end would take away.
    if not np.square(priority.numpy(), dtype=np.float64).sum() > (1.0 - SPLIT_AREA) * area:
        return None
    room = min(count + int(SPLIT_SHARE * count), MAX_TRIANGLES)
    parts, ends = (wp.empty(count, dtype=int, device=device) for _ in range(2))

    def total_with(factor: float) -> int:
        launch(triangle_split.count_parts, count, [priority, factor], [parts], device)
        wp.utils.array_scan(parts, ends)
        return int(ends[count - 1:].numpy()[0])

    # The largest factor with which there is room for all parts.
    low, high = 0.0, float(FACTORS)
    size = float(_extent(whole.lower, whole.upper, np.zeros(1, np.int64))[1][0])
    for _ in range(FACTORS // 2):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if total_with(2.0**middle / size) <= room else (low, middle)
    total = total_with(2.0**low / size if low > 0.0 else 0.0)
    made = References(
        wp.empty(total, dtype=int, device=device), wp.empty(total, dtype=wp.vec2ui, device=device),
        *(wp.empty(total, dtype=wp.vec3, device=device) for _ in range(2)))
    launch(triangle_split.split_triangles, count, [*triangles, ends],
           [wp.empty(total, dtype=int, device=device), *made.arrays], device)
    return made if made.area <= SPLIT_AREA * area else None


def _cluster(
    item_lower: wp.array, item_upper: wp.array, radius: int, patience: int, counts: np.ndarray | None = None,
) -> BinaryTree:
    """Return the tree that clustering makes over boxes; for radius and patience see RADIUS and PATIENCE.

    With `counts` as many trees, of so many boxes each.
    """
    device, count = item_lower.device.alias, len(item_lower)
    trees = 1 if counts is None else len(counts)
    total = 2 * count - trees
    lower, upper = (wp.empty(total, dtype=wp.vec3, device=device) for _ in range(2))
    wp.copy(lower, item_lower)
    wp.copy(upper, item_upper)
    children = wp.empty(total, dtype=wp.vec2i, device=device)
    # Sorting needs twice the room.
    codes = wp.empty(2 * count, dtype=wp.int64, device=device)
    clusters = wp.empty(2 * count, dtype=int, device=device)
    tree_of = wp.empty(0 if counts is None else total, dtype=int, device=device)
    starts = np.zeros(1, np.int64)
    if counts is not None:
        starts = np.concatenate([starts, np.cumsum(counts)[:-1]])
        wp.copy(tree_of, wp.array(np.repeat(np.arange(trees, dtype=np.int32), counts), dtype=int, device=device))
    low, size = _extent(item_lower, item_upper, starts)
    launch(cluster_tree.start_clusters, count, [
        tree_of, wp.array(low, dtype=wp.vec3, device=device),
        wp.array(float(cluster_tree.CURVE_CELLS) / size, dtype=float, device=device),
        max(0, int(trees).bit_length() - (62 - int(cluster_tree.CURVE_BITS))), lower, upper],
        [codes, clusters, children], device)
    wp.utils.radix_sort_pairs(codes, clusters, count)
    neighbor, following, kept, merged = (wp.empty(count, dtype=int, device=device) for _ in range(4))
    batches, first, reach, slow = [(0, count)], count, radius, 0
    while count > trees:
        launch_bands(cluster_tree.find_neighbors, 0, count, [clusters, count, reach, tree_of, lower, upper], [neighbor])
        launch(cluster_tree.mark_merged, count, [neighbor], [kept, merged], device)
        wp.utils.array_scan(kept[:count], kept[:count])
        wp.utils.array_scan(merged[:count], merged[:count])
        launch(cluster_tree.merge_clusters, count, [clusters, neighbor, kept, merged, first],
               [following, tree_of, children, lower, upper], device)
        made = int(merged[count - 1:count].numpy()[0])
        batches.append((first, made))
        # Trees that are done are left out of account.
        slowly = made * SLOW < count - trees + 1
        slow += slowly
        # Of several trees twins may be of different ones, so that none is merged: never twice in a row.
        reach = 0 if slowly and slow > patience and reach > 0 else radius
        clusters, following, count, first = following, clusters, count - made, first + made
    return BinaryTree(children, lower, upper, batches, None if counts is None else clusters[:count])


def _extent(lower: wp.array, upper: wp.array, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return float32 [M, 3] and [M]: lowest corners and longest sides of boxes from each start to the next."""
    if len(starts) == 1:
        low, high = (wp.full(3, end, dtype=float, device=lower.device) for end in (np.inf, -np.inf))
        launch(cluster_tree.find_extent, -(-len(lower) // int(cluster_tree.EXTENT_BOXES)), [lower, upper], [low, high],
               lower.device.alias)
        low, high = low.numpy()[None], high.numpy()[None]
    else:
        low, high = np.minimum.reduceat(lower.numpy(), starts), np.maximum.reduceat(upper.numpy(), starts)
    return low, np.maximum((high - low).max(1), np.float32(1e-30))


def _collapse(tree: BinaryTree, count: int) -> tuple[wp.array, wp.array, list[tuple[int, int]]]:
    """Return nodes, items in the order of the leaves, and the levels."""
    children, lower, upper = tree.children, tree.lower, tree.upper
    device, total = children.device.alias, len(children)
    cost = wp.empty(7 * total, dtype=float, device=device)
    choice = wp.zeros(9 * total, dtype=wp.uint8, device=device)
    counts = wp.empty(total, dtype=int, device=device)
    for first, size in tree.batches:
        launch_bands(kernels.plan_nodes, first, size, [children, lower, upper], [cost, choice, counts])

    # Every wide node but the root takes the place of a binary one that isn't a leaf.
    words = wp.zeros(NODE_WORDS * count, dtype=wp.uint32, device=device)
    items = wp.empty(count, dtype=int, device=device)
    roots = tree.roots if tree.roots is not None else wp.array([total - 1], dtype=int, device=device)
    first_triangle, levels = 0, []
    while len(roots):
        size = len(roots)
        first_node = sum(levels[-1]) if levels else 0
        slots = wp.empty(8 * size, dtype=int, device=device)
        inner, triangles, inner_sums, triangle_sums = (wp.empty(size, dtype=int, device=device) for _ in range(4))
        launch(kernels.open_nodes, size, [roots, children, choice, counts, lower, upper],
               [slots, inner, triangles], device)
        inner_total, triangle_total = int(inner.numpy().sum()), int(triangles.numpy().sum())
        wp.utils.array_scan(inner, inner_sums, inclusive=False)
        wp.utils.array_scan(triangles, triangle_sums, inclusive=False)
        following = wp.empty(inner_total, dtype=int, device=device)
        launch(kernels.write_nodes, size, [
            roots, slots, inner_sums, triangle_sums, first_node, first_node + size, first_triangle, children, choice,
            counts, lower, upper], [words, following, items], device)
        levels.append((first_node, size))
        first_triangle += triangle_total
        roots = following
    return wp.clone(words[:NODE_WORDS * sum(levels[-1])]), items, levels
