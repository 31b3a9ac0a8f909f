# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things have moved of late, and which shadow rays go through there: what they bring may have changed.

Cells of the radiance cache average direct light over tens of samples: a thing's shadow would stay behind where it was
long after it has gone, and not come where it goes. A sample tells no change from noise, but the way that it takes tells
where there may be one: cells whose light comes through there remember less.
"""

from __future__ import annotations

import warp as wp

from .paths import Paths

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

WAYS = wp.constant(8)
"""Most boxes"""

# Paths.radiance[3] of hits that have a shadow ray, and of those whose shadow ray goes through one of the boxes.
SHADOWED = wp.constant(1.0)
CROSSING = wp.constant(2.0)

# Samples that a cell's light may weigh if all of them come through a box; if a share of them does, as many more. The
# past weighs least just after samples through a box: if all of those were black and all others bright, means would be
# up to 5 % bright. Boxes of sixteen frames are seldom black.
WAY_SAMPLES = wp.constant(1.5)
# So many may weigh nevertheless: with fewer than CELL_SAMPLES (reflection_resolve.py) mirrors show hits' own light.
WAY_SAMPLES_MIN = wp.constant(4.0)
# Samples over which that share is averaged.
SHARE_SAMPLES = wp.constant(3.0)

LEAST_SLOPE = wp.constant(1.0e-12)


@wp.func
def reaches_box(low: wp.vec3, high: wp.vec3, origin: wp.vec3, direction: wp.vec3, distance: float) -> bool:
    """Return whether a part of a ray, of such a length [m], lies in a box."""
    near = float(0.0)
    far = distance
    for axis in range(3):
        slope = direction[axis]
        if wp.abs(slope) < LEAST_SLOPE:
            slope = LEAST_SLOPE
        a = (low[axis] - origin[axis]) / slope
        b = (high[axis] - origin[axis]) / slope
        near = wp.max(near, wp.min(a, b))
        far = wp.min(far, wp.max(a, b))
    return near <= far


@wp.func
def ways_count(ways: wp.array[wp.vec3]) -> int:
    """Return the number of boxes."""
    if ways.shape[0] == 0:
        return 0
    return int(ways[0][0])


@wp.func
def crosses_way(ways: wp.array[wp.vec3], origin: wp.vec3, direction: wp.vec3, distance: float) -> bool:
    """Return whether a ray goes through where something has moved of late.

    Args:
        ways: Number of boxes, and the lower and upper corner [m] of each (engine/moved_ways.py).
        origin: Of the ray [m].
        direction: Unit.
        distance: How far it goes [m].
    """
    count = ways_count(ways)
    box = int(0)
    while box < count:
        if reaches_box(ways[2 * box + 1], ways[2 * box + 2], origin, direction, distance):
            return True
        box = box + 1
    return False


@wp.func
def shadow_mark(ways: wp.array[wp.vec3], paths: Paths, slot: int) -> float:
    """Return SHADOWED or CROSSING for a shadow ray; those of lights without shadows have a distance below 0."""
    distance = paths.shadow_distance[slot]
    if distance > 0.0:
        if crosses_way(ways, paths.shadow_origin[slot], paths.shadow_direction[slot], distance):
            return CROSSING
    return SHADOWED


@wp.func
def way_cap(share: float) -> float:
    """Return how many samples a cell's light may weigh, by the share of them that comes through a box."""
    return wp.max(WAY_SAMPLES / wp.max(share, 1.0e-6), WAY_SAMPLES_MIN)


@wp.func
def way_share(share: float, crossing: int, samples: int) -> float:
    """Return the mean share after a frame in which so many of a cell's samples came through a box."""
    now = wp.min(float(crossing) / float(samples), 1.0)
    return share + (now - share) * float(samples) / (float(samples) + SHARE_SAMPLES)
