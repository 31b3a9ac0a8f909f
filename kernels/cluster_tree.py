# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that build a binary BVH by locally ordered clustering, from the leaves up.

Meister and Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy Construction" (TVCG 2018):
clusters lie along a space-filling curve; each looks for the neighbour, at most `radius` places away, with which it
would have the smallest box, and those that choose each other are merged. Nodes are numbered in the order in which
they arise, so children come before parents, and by prefix sums, so that the tree doesn't depend on threads' order.
"""

from __future__ import annotations

from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Cells of the space-filling curve along the scene's longest side.
CURVE_CELLS = wp.constant(1048576.0)
CURVE_BITS = wp.constant(60)
"""Of a place on it"""

EXTENT_BOXES = wp.constant(64)
"""Boxes that a thread of find_extent looks at"""


@wp.func
def half_area(size: Any):
    """Return half the surface of a box, of single or double precision as its size (vec3, vec3d) is."""
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


@wp.func
def spread_bits(value: float) -> wp.int64:
    """Return the bits of a cell's coordinate, two zeros after each."""
    x = wp.int64(wp.clamp(value, 0.0, CURVE_CELLS - 1.0))
    x = (x | (x << wp.int64(32))) & wp.int64(0x1F00000000FFFF)
    x = (x | (x << wp.int64(16))) & wp.int64(0x1F0000FF0000FF)
    x = (x | (x << wp.int64(8))) & wp.int64(0x100F00F00F00F00F)
    x = (x | (x << wp.int64(4))) & wp.int64(0x10C30C30C30C30C3)
    x = (x | (x << wp.int64(2))) & wp.int64(0x1249249249249249)
    return x


@wp.kernel
def start_clusters(
    # In:
    tree_of: wp.array[int],
    origins: wp.array[wp.vec3],
    scales: wp.array[float],
    dropped: int,
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    codes_out: wp.array[wp.int64],
    clusters_out: wp.array[int],
    children_out: wp.array[wp.vec2i],
):
    """Make a leaf of each item, and find the Morton code of its middle in its tree's box, after the tree's number.

    In detail:
        tree_of: Each item's tree; empty where there is but one.
        origins: Of each tree's box.
        scales: Cells a unit of length, of each tree.
        dropped: Lowest bits of the curve that give way to the numbers.
    """
    i = wp.tid()
    tree = int(0)
    if tree_of.shape[0] > 0:
        tree = tree_of[i]
    middle = (0.5 * (lower[i] + upper[i]) - origins[tree]) * scales[tree]
    code = (spread_bits(middle[2]) << wp.int64(2)) | (spread_bits(middle[1]) << wp.int64(1)) | spread_bits(middle[0])
    codes_out[i] = (wp.int64(tree) << wp.int64(CURVE_BITS - dropped)) | (code >> wp.int64(dropped))
    clusters_out[i] = i
    children_out[i] = wp.vec2i(-1 - i, 1)


@wp.func
def one_tree(tree_of: wp.array[int], first: int, second: int) -> bool:
    """Return whether two nodes are of the same tree; `tree_of` is empty where there is but one."""
    if tree_of.shape[0] == 0:
        return True
    return tree_of[first] == tree_of[second]


@wp.func
def common_area(low: wp.vec3, high: wp.vec3, lower: wp.array[wp.vec3], upper: wp.array[wp.vec3], node: int) -> float:
    """Return half the surface of the box about a box and a node."""
    return half_area(wp.max(high, upper[node]) - wp.min(low, lower[node]))


@wp.kernel
def write_areas(
    # In:
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    areas_out: wp.array[float],
):
    """Write half the surface of each node's box."""
    i = wp.tid()
    areas_out[i] = half_area(upper[i] - lower[i])


@wp.kernel
def measure_areas(
    # In:
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    areas_out: wp.array[wp.float64],
):
    """Write half the surface of each box; 0 of those that are not finite."""
    i = wp.tid()
    area = half_area(wp.vec3d(upper[i]) - wp.vec3d(lower[i]))
    if not wp.isfinite(area):
        area = wp.float64(0.0)
    areas_out[i] = area


@wp.kernel
def find_extent(
    # In:
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    low_out: wp.array[float],
    high_out: wp.array[float],
):
    """Lower `low_out` [3] and raise `high_out` [3] to the box about all boxes; each thread looks at EXTENT_BOXES."""
    first = EXTENT_BOXES * wp.tid()
    last = wp.min(first + EXTENT_BOXES, lower.shape[0])
    low = lower[first]
    high = upper[first]
    for i in range(first + 1, last):
        low = wp.min(low, lower[i])
        high = wp.max(high, upper[i])
    for axis in range(3):
        wp.atomic_min(low_out, axis, low[axis])
        wp.atomic_max(high_out, axis, high[axis])


@wp.kernel
def find_neighbors(
    # In:
    first: int,
    clusters: wp.array[int],
    count: int,
    radius: int,
    tree_of: wp.array[int],
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    neighbor_out: wp.array[int],
):
    """Find for each cluster from place `first` on the one with which it has the smallest box.

    Of equals the one that shares all bits of the place but the lowest counts first, then the one at the lowest place:
    pairs are in a total order, so at least one pair is merged, and of many equal boxes half are. With a radius of 0
    those pairs are merged whatever their boxes. `tree_of`: each node's tree, empty for one: clusters of different ones
    are never merged.
    """
    i = first + wp.tid()
    low = lower[clusters[i]]
    high = upper[clusters[i]]
    best = float(3.0e38)
    neighbor = int(-1)
    twin = i ^ 1
    if twin < count and one_tree(tree_of, clusters[i], clusters[wp.min(twin, count - 1)]):
        best = common_area(low, high, lower, upper, clusters[twin])
        neighbor = twin
    j = wp.max(i - radius, 0)
    last = wp.min(i + radius, count - 1)
    while j <= last:
        if j != i and one_tree(tree_of, clusters[i], clusters[j]):
            area = common_area(low, high, lower, upper, clusters[j])
            if area < best or neighbor < 0:
                best = area
                neighbor = j
        j = j + 1
    # Alone: with itself.
    neighbor_out[i] = wp.where(neighbor < 0, i, neighbor)


@wp.kernel
def mark_merged(
    # In:
    neighbor: wp.array[int],
    # Out:
    kept_out: wp.array[int],
    merged_out: wp.array[int],
):
    """Mark the places that stay, and of those the first places of pairs that are merged."""
    i = wp.tid()
    other = neighbor[i]
    mutual = neighbor[other] == i
    kept_out[i] = wp.where(mutual and other < i, 0, 1)
    merged_out[i] = wp.where(mutual and other > i, 1, 0)


@wp.kernel
def merge_clusters(
    # In:
    clusters: wp.array[int],
    neighbor: wp.array[int],
    kept: wp.array[int],
    merged: wp.array[int],
    first: int,
    # Out:
    clusters_out: wp.array[int],
    tree_of_out: wp.array[int],
    children_out: wp.array[wp.vec2i],
    lower_out: wp.array[wp.vec3],
    upper_out: wp.array[wp.vec3],
):
    """Make nodes from number `first` on of the pairs; `kept` and `merged` are sums of marks up to each place."""
    i = wp.tid()
    other = neighbor[i]
    mutual = neighbor[other] == i
    if mutual and other < i:
        return
    node = clusters[i]
    if mutual and other > i:
        right = clusters[other]
        parent = first + merged[i] - 1
        children_out[parent] = wp.vec2i(node, right)
        lower_out[parent] = wp.min(lower_out[node], lower_out[right])
        upper_out[parent] = wp.max(upper_out[node], upper_out[right])
        if tree_of_out.shape[0] > 0:
            tree_of_out[parent] = tree_of_out[node]
        node = parent
    clusters_out[kept[i] - 1] = node
