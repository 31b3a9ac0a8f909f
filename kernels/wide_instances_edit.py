# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that keep the upper level of wide_instances.py: its records, and the boxes of instances that move."""

from __future__ import annotations

import warp as wp

from .types import Instance
from .wide_bvh import TRIANGLE_WORDS
from .wide_instances import RECORD_WORDS

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Words of a mesh's row: those of a record after the transform, but for the instance.
MESH_WORDS = wp.constant(6)


@wp.kernel
def write_records(
    # In:
    items: wp.array[int],
    chosen: wp.array[int],
    mesh_of: wp.array[int],
    meshes: wp.array2d[wp.uint32],
    instances: wp.array[Instance],
    # Out:
    words_out: wp.array[wp.uint32],
):
    """Write the records of instances, in the leaves' order.

    In detail:
        items: [N], number of each leaf's instance among the chosen.
        chosen: [N], the instance.
        mesh_of: [N], row of its mesh.
        meshes: [M, MESH_WORDS].
        instances: All.
        words_out: [RECORD_WORDS * N].
    """
    i = wp.tid()
    item = items[i]
    base = RECORD_WORDS * i
    to_object = instances[chosen[item]].to_object
    for row in range(3):
        for column in range(4):
            words_out[base + 4 * row + column] = wp.cast(to_object[row, column], wp.uint32)
    for k in range(MESH_WORDS):
        words_out[base + 12 + k] = meshes[mesh_of[item], k]
    words_out[base + 18] = wp.uint32(chosen[item])


@wp.kernel
def write_boxes(
    # In:
    items: wp.array[int],
    corners: wp.array[wp.vec3],
    # Out:
    words_out: wp.array[wp.uint32],
):
    """Write boxes, in the leaves' order, as triangles between their corners, which refit_nodes can read.

    In detail:
        items: [N], number of each leaf's box.
        corners: [2 * N], lower and upper one of each box in turn.
        words_out: [TRIANGLE_WORDS * N].
    """
    i = wp.tid()
    item = items[i]
    low = corners[2 * item]
    high = corners[2 * item + 1]
    for axis in range(3):
        words_out[TRIANGLE_WORDS * i + axis] = wp.cast(low[axis], wp.uint32)
        words_out[TRIANGLE_WORDS * i + 4 + axis] = wp.cast(high[axis], wp.uint32)
        words_out[TRIANGLE_WORDS * i + 8 + axis] = wp.cast(low[axis], wp.uint32)
    words_out[TRIANGLE_WORDS * i + 3] = wp.uint32(item)
