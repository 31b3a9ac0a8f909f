# SPDX-License-Identifier: GPL-3.0-or-later
"""Connected parts of a mesh: a disjoint-set forest with union by rank (Tarjan 1975), edge by edge in their order.

One thread, on the processor: which vertex stands for a part depends on the order, and Cycles' random numbers on that.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def find_root(parents: wp.array[int], vertex: int) -> int:
    """Return the vertex that stands for a part, and make the way to it shorter."""
    root = vertex
    while parents[root] != root:
        root = parents[root]
    at = vertex
    while parents[at] != root:
        above = parents[at]
        parents[at] = root
        at = above
    return root


@wp.kernel
def join_edges(
    # In:
    edges: wp.array[wp.vec2i],
    # Out:
    parents_out: wp.array[int],
    ranks_out: wp.array[int],
):
    """Join what edges connect, then write its part's root for each vertex."""
    for i in range(edges.shape[0]):
        x = find_root(parents_out, edges[i][0])
        y = find_root(parents_out, edges[i][1])
        if x != y:
            if ranks_out[x] < ranks_out[y]:
                z = x
                x = y
                y = z
            parents_out[y] = x
            if ranks_out[x] == ranks_out[y]:
                ranks_out[x] = ranks_out[x] + 1
    for vertex in range(parents_out.shape[0]):
        parents_out[vertex] = find_root(parents_out, vertex)
