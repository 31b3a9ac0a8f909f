# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that split triangles before a BVH is built: large slanted ones enter it as several references.

The box of a slanted triangle is mostly empty, and overlaps others all along. Two or more references to the same
triangle, each with the box of its part, are cheaper to pass (Ernst and Greiner, "Early Split Clipping for Bounding
Volume Hierarchies", RT 2007). Which triangles are split, and how often, follows Karras and Aila, "Fast Parallel
Construction of High-Quality Bounding Volume Hierarchies" (HPG 2013), section 4: by the area that their boxes have
beyond what no splitting takes away, within a budget. Differences: only triangles whose boxes are mostly empty count,
and the middle of the longest side is where they are split; both gave fewer visits over clustering.

A part's box is kept in two words beside the triangle, in steps from the box of the whole one: boxes can be computed
anew from the triangle's vertices alone.
"""

from __future__ import annotations

import warp as wp

from .cluster_tree import half_area

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Of a box's area, how much boxes of tiny parts would have at most for the triangle to be split.
FULLNESS = wp.constant(0.3)

# More splits of one triangle brought nothing.
MOST_SPLITS = wp.constant(7.0)

# Steps that a triangle's box has along an axis for its parts' boxes.
STEPS = wp.constant(1024.0)

# Vertices of a triangle cut by a box.
CORNERS = wp.constant(9)

Polygon = wp.types.matrix((9, 3), float)


@wp.struct
class Box:
    """A box."""

    low: wp.vec3
    high: wp.vec3


@wp.func
def part_box(low: wp.vec3, high: wp.vec3, steps: wp.vec2ui) -> Box:
    """Return the box of a part of a triangle with the box `low` to `high`; `steps` of 0 is the whole.

    Ten bits an axis: how many steps the part's box begins above `low`, and ends below `high`.
    """
    box = Box()
    box.low = low
    box.high = high
    for axis in range(3):
        step = (high[axis] - low[axis]) * (1.0 / STEPS)
        above = (steps[0] >> wp.uint32(10 * axis)) & wp.uint32(1023)
        below = (steps[1] >> wp.uint32(10 * axis)) & wp.uint32(1023)
        box.low[axis] = low[axis] + float(above) * step
        box.high[axis] = high[axis] - float(below) * step
    return box


@wp.func
def whole_steps(distance: float, size: float) -> wp.uint32:
    """Return how many steps fit a distance from a side of a box of that size, less one against rounding."""
    return wp.uint32(wp.clamp(wp.floor(STEPS * distance / wp.max(size, 1.0e-30)) - 1.0, 0.0, STEPS - 1.0))


@wp.func
def part_steps(low: wp.vec3, high: wp.vec3, part: Box) -> wp.vec2ui:
    """Return the least box that part_box can return about `part`."""
    steps = wp.vec2ui(wp.uint32(0), wp.uint32(0))
    for axis in range(3):
        size = high[axis] - low[axis]
        above = whole_steps(part.low[axis] - low[axis], size)
        below = whole_steps(high[axis] - part.high[axis], size)
        steps[0] = steps[0] | (above << wp.uint32(10 * axis))
        steps[1] = steps[1] | (below << wp.uint32(10 * axis))
    return steps


@wp.func
def cut_box(p: wp.vec3, q: wp.vec3, r: wp.vec3, low: wp.vec3, high: wp.vec3) -> Box:
    """Return the box of what a box holds of a triangle, widened by the rounding of its corners."""
    box = Box()
    box.low = low
    box.high = high
    corners = Polygon()
    corners[0] = p
    corners[1] = q
    corners[2] = r
    count = int(3)
    side = int(0)
    # Sutherland and Hodgman: what lies on the inner side of one plane after the other.
    while side < 6:
        axis = side // 2
        sign = wp.where(side % 2 == 0, 1.0, -1.0)
        plane = wp.where(side % 2 == 0, low[axis], high[axis])
        kept = Polygon()
        found = int(0)
        k = int(0)
        while k < count:
            a = wp.vec3(corners[k, 0], corners[k, 1], corners[k, 2])
            following = wp.where(k + 1 < count, k + 1, 0)
            b = wp.vec3(corners[following, 0], corners[following, 1], corners[following, 2])
            at_a = (a[axis] - plane) * sign
            at_b = (b[axis] - plane) * sign
            if at_a >= 0.0:
                if found < CORNERS:
                    kept[found] = a
                found = found + 1
            if (at_a > 0.0 and at_b < 0.0) or (at_a < 0.0 and at_b > 0.0):
                if found < CORNERS:
                    kept[found] = a + (at_a / (at_a - at_b)) * (b - a)
                found = found + 1
            k = k + 1
        # Nothing left, or more than a convex polygon can have: rounding of what is all but a line.
        if found == 0 or found > CORNERS:
            return box
        corners = kept
        count = found
        side = side + 1
    least = wp.vec3(corners[0, 0], corners[0, 1], corners[0, 2])
    most = least
    k = int(1)
    while k < count:
        least = wp.min(least, wp.vec3(corners[k, 0], corners[k, 1], corners[k, 2]))
        most = wp.max(most, wp.vec3(corners[k, 0], corners[k, 1], corners[k, 2]))
        k = k + 1
    reach = 4.0e-7 * wp.max(wp.max(wp.abs(p), wp.abs(q)), wp.abs(r))
    box.low = wp.max(low, least - reach)
    box.high = wp.min(high, most + reach)
    return box


@wp.kernel
def find_priorities(
    # In:
    points: wp.array[wp.vec3],
    indices: wp.array[int],
    faces: wp.array[int],
    lower: wp.array[wp.vec3],
    upper: wp.array[wp.vec3],
    # Out:
    priority_out: wp.array[float],
):
    """Find how often triangles should be split, up to a factor; 0 for those whose boxes aren't mostly empty.

    With n splits about 1 / (n + 1) of a box's needless area is left: the sum is least if n grows as the root of it.
    """
    i = wp.tid()
    first = 3 * faces[i]
    p = points[indices[first]]
    cross = wp.cross(points[indices[first + 1]] - p, points[indices[first + 2]] - p)
    area = half_area(upper[i] - lower[i])
    # Boxes of tiny parts have the area of the triangle's three projections.
    needless = area - 0.5 * (wp.abs(cross[0]) + wp.abs(cross[1]) + wp.abs(cross[2]))
    priority = float(0.0)
    if area > 0.0 and needless > (1.0 - FULLNESS) * area:
        # Of many equal triangles some come first, so that the budget can end among them.
        golden = 0.618034 * float(i % 1024)
        priority = wp.sqrt(needless) * (1.0 + 0.25 * (golden - wp.floor(golden)))
    priority_out[i] = priority


@wp.kernel
def count_parts(
    # In:
    priority: wp.array[float],
    factor: float,
    # Out:
    parts_out: wp.array[int],
):
    """Count the references to each triangle."""
    i = wp.tid()
    parts_out[i] = 1 + int(wp.min(priority[i] * factor, MOST_SPLITS))


@wp.func
def longest_side(size: wp.vec3) -> int:
    """Return the axis along which a box is longest."""
    axis = int(0)
    if size[1] > size[0]:
        axis = 1
    if size[2] > size[axis]:
        axis = 2
    return axis


@wp.kernel
def split_triangles(
    # In:
    points: wp.array[wp.vec3],
    indices: wp.array[int],
    faces: wp.array[int],
    whole_lower: wp.array[wp.vec3],
    whole_upper: wp.array[wp.vec3],
    ends: wp.array[int],
    # Out:
    splits_out: wp.array[int],
    face_out: wp.array[int],
    steps_out: wp.array[wp.vec2ui],
    lower_out: wp.array[wp.vec3],
    upper_out: wp.array[wp.vec3],
):
    """Write triangles' references up to number `ends` each: triangle, part_box's steps, box.

    Meanwhile splits_out holds how often a reference is still to be split, into the ones right after it.
    """
    i = wp.tid()
    k = int(0)
    if i > 0:
        k = ends[i - 1]
    first = 3 * faces[i]
    p = points[indices[first]]
    q = points[indices[first + 1]]
    r = points[indices[first + 2]]
    lower_out[k] = whole_lower[i]
    upper_out[k] = whole_upper[i]
    splits_out[k] = ends[i] - k - 1
    while k < ends[i]:
        splits = splits_out[k]
        if splits > 0:
            low = lower_out[k]
            high = upper_out[k]
            axis = longest_side(high - low)
            middle = 0.5 * (low[axis] + high[axis])
            edge = high
            edge[axis] = middle
            left = cut_box(p, q, r, low, edge)
            edge = low
            edge[axis] = middle
            right = cut_box(p, q, r, edge, high)
            left_size = wp.max(left.high - left.low)
            share = left_size / wp.max(left_size + wp.max(right.high - right.low), 1.0e-30)
            to_left = wp.clamp(int(float(splits - 1) * share + 0.5), 0, splits - 1)
            other = k + 1 + to_left
            lower_out[k] = left.low
            upper_out[k] = left.high
            splits_out[k] = to_left
            lower_out[other] = right.low
            upper_out[other] = right.high
            splits_out[other] = splits - 1 - to_left
        else:
            part = Box()
            part.low = lower_out[k]
            part.high = upper_out[k]
            steps = part_steps(whole_lower[i], whole_upper[i], part)
            # What the steps say, so that boxes computed anew are the same.
            part = part_box(whole_lower[i], whole_upper[i], steps)
            lower_out[k] = part.low
            upper_out[k] = part.high
            steps_out[k] = steps
            face_out[k] = faces[i]
            k = k + 1
