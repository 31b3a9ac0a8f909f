# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether anything is wrong with a mesh: one look at each triangle. For the processor, which reads the meshes.

What is wrong, and what becomes of it, is engine/sanitize.py's.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def is_near(point: wp.vec3, limit: float) -> bool:
    """Return whether all coordinates are within a limit; False where one is not a number."""
    return wp.abs(point[0]) <= limit and wp.abs(point[1]) <= limit and wp.abs(point[2]) <= limit


@wp.func
def is_normal(normal: wp.vec3, least: float) -> bool:
    """Return whether a vector is finite, and longer than the root of `least`."""
    squared = wp.dot(normal, normal)
    return squared > least and wp.isfinite(squared)


@wp.kernel
def find_defects(
    # In:
    positions: wp.array[wp.vec3],
    triangles: wp.array[wp.vec3i],
    slots: wp.array[int],
    normals: wp.array[wp.vec3],
    limit: float,
    largest_slot: int,
    least_normal: float,
    # Out:
    found_out: wp.array[int],
):
    """Write 1 to `found_out[0]` where any triangle, slot or normal is not fit to be drawn as it is.

    In detail:
        normals: Of corners, three to a triangle.
        limit: Largest coordinate.
        largest_slot: Largest number of a slot.
        least_normal: Square of the length that a normal must exceed.
    """
    i = wp.tid()
    corners = triangles[i]
    count = positions.shape[0]
    good = slots[i] >= 0 and slots[i] <= largest_slot
    for k in range(3):
        if corners[k] < 0 or corners[k] >= count:
            good = False
        if not is_normal(normals[3 * i + k], least_normal):
            good = False
    if good:
        p0 = positions[corners[0]]
        p1 = positions[corners[1]]
        p2 = positions[corners[2]]
        a = p1 - p0
        b = p2 - p0
        # Whether the cross product is zero, without subtractions, as they would round.
        area = a[1] * b[2] != a[2] * b[1] or a[2] * b[0] != a[0] * b[2] or a[0] * b[1] != a[1] * b[0]
        good = area and is_near(p0, limit) and is_near(p1, limit) and is_near(p2, limit)
    if not good:
        found_out[0] = 1
