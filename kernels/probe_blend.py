# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: the rays' answers put into the probes' maps (GI-1.0, section 3.7).

Each cell steps from its history towards the mean of this update's rays by (rays / expected rays) / (updates + 1). The
step is linear in what the rays bring and its weight has a known mean, so neither guiding nor cells without a ray change
the result's mean. A probe whose light has changed by more than its noise explains forgets, whether it got darker or
lighter; the published hysteresis slows down lightening only, and fills cells without rays by a guess.
"""

from __future__ import annotations

import warp as wp

from .cache_mirrors import FOLLOWED_MOVED
from .geometry_math import is_finite3, luminance
from .lane_groups import group_sum
from .moved_ways import crosses_way, ways_count
from .packing import HALF_MAX, from_half, rgb, rgba
from .probe_rays import ProbeRays, distance_of, inverse_distance
from .probe_types import CELLS, NO_CELL, ProbeGrid, ProbePool, ProbeUpdates
from .sampling import hash32, hash_combine
from .view import MOVED_FRAMES, View
from .wide_loads import load_eight_bytes, load_vec4, load_vec4h
from .wide_stores import store_vec4h

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Standard deviations from which on, and over which, a departure from the history counts as a change.
CHANGE_START = wp.constant(3.0)
CHANGE_RANGE = wp.constant(2.0)

# Updates that count of a probe that has this share of its rays, or of the light that it knew, over mirrors that move;
# of one with a smaller share as many more. Such a probe waits for no turn (probe_turns.SETTLED_COUNT).
MIRROR_UPDATES = wp.constant(1.0)
MIRROR_SHARE = wp.constant(0.1)

# Updates that count of a probe all of whose rays go through where something has moved of late; of one with a share of
# such rays as many more.
WAY_UPDATES = wp.constant(2.0)
# So many count nevertheless: with fewer it would wait for no turn (probe_turns.SETTLED_COUNT), and frames take longer.
WAY_UPDATES_MIN = wp.constant(4.0)
UPDATES_MAX = wp.constant(1.0e6)

# Relative change below which nothing is forgotten.
CHANGE_LEAST = wp.constant(0.1)

# Bounds the change of light from black.
CHANGE_MOST = wp.constant(64.0)

# Of rays that count in no cell, instead of a distance.
UNCOUNTED = wp.constant(-1.0)

# The bits of a float that a half keeps; typed, because Warp writes literals above 2^31 as signed numbers.
HALF_BITS = wp.constant(wp.uint32(0xFFFFE000))

# Of each of eight bytes: the lowest bit, all but the highest.
LOWEST_BITS = wp.constant(wp.uint64(0x0101010101010101))
LOW_BITS = wp.constant(wp.uint64(0x7F7F7F7F7F7F7F7F))


@wp.func
def counted_radiance(rays: ProbeRays, ray: int) -> wp.vec3:
    """Return what a ray brought, never negative; NaN and infinity as 0."""
    value = rgb(load_vec4(rays.radiance, ray))
    if not is_finite3(value):
        return wp.vec3(0.0, 0.0, 0.0)
    return wp.vec3(
        wp.clamp(value[0], 0.0, HALF_MAX), wp.clamp(value[1], 0.0, HALF_MAX), wp.clamp(value[2], 0.0, HALF_MAX))


@wp.func
def counted_inverse(rays: ProbeRays, ray: int) -> float:
    """Return one over how far a ray went [1/m], 0 where that is not finite."""
    t = load_vec4(rays.radiance, ray)[3]
    if not wp.isfinite(t):
        return 0.0
    return inverse_distance(t)


@wp.func
def cell_at(cells: wp.uint64, i: int) -> int:
    """Return one of eight neighbours of ProbeUpdates.cell, as load_eight_bytes loads them."""
    return int((cells >> wp.uint64(8 * i)) & wp.uint64(255))


@wp.func
def rays_of(cells: wp.uint64, cell: int) -> wp.uint64:
    """Return which of eight rays count in a cell: the highest bits of their bytes."""
    other = cells ^ (wp.uint64(cell) * LOWEST_BITS)
    return ~(((other & LOW_BITS) + LOW_BITS) | other) & ~LOW_BITS


@wp.func_native("""
#ifdef __CUDA_ARCH__
    return (__ffsll((long long)marks) - 1) >> 3;
#else
    return __builtin_ctzll(marks) >> 3;
#endif
""")
def first_ray(marks: wp.uint64) -> int:
    """Return the first of the rays that rays_of tells, of which there must be one."""
    ...


@wp.func
def dithered_half(x: float, bits: wp.uint32) -> wp.float16:
    """Round to one of the two neighbouring half-floats at random, so that small steps add up.

    A long mean in half-floats stops where steps fall below half of its last bit; this rounding has no bias.
    """
    # Below the normal halves' range they are spaced evenly; half a step is 3e-8.
    if x < 6.2e-5:
        return wp.float16(x)
    # A half has 13 bits less of mantissa; the sum may carry into the exponent, rightly so.
    packed = wp.cast(x, wp.uint32) + (bits & wp.uint32(8191))
    return wp.float16(wp.min(wp.cast(packed & HALF_BITS, float), HALF_MAX))


@wp.func
def store(value: wp.vec3, distance: float, seed: wp.uint32) -> wp.vec4h:
    """Pack a cell."""
    a = hash32(seed)
    b = hash32(a)
    return wp.vec4h(
        dithered_half(value[0], a), dithered_half(value[1], a >> wp.uint32(16)), dithered_half(value[2], b),
        wp.float16(distance))


@wp.func
def updates_over_mirrors(over: wp.vec3, known: float) -> float:
    """Return how many updates count of a probe whose rays go over mirrors that move.

    Args:
        over: Weights of all rays, of those over such mirrors, and the light that was known of these.
        known: Of all rays.
    """
    share = wp.max(over[1] / wp.max(over[0], 1.0e-6), over[2] / wp.max(known, 1.0e-6))
    return MIRROR_UPDATES * wp.max(MIRROR_SHARE / wp.max(share, 1.0e-6), 1.0)


@wp.func
def updates_through_ways(
    ways: wp.array[wp.vec3], updates: ProbeUpdates, rays: ProbeRays, update: int, lane: int, lanes: int,
) -> float:
    """Return how many updates count of a probe by its rays through where something has moved, to all lanes alike."""
    if ways_count(ways) == 0:
        return UPDATES_MAX
    through = float(0.0)
    total = float(0.0)
    i = lane
    while i < CELLS:
        ray = update * CELLS + i
        cell = int(updates.cell[ray])
        if cell != NO_CELL:
            weight = 1.0 / updates.expected[update * CELLS + cell]
            total = total + weight
            if crosses_way(ways, rays.origin[ray], rays.direction[ray], rays.radiance[ray][3]):
                through = through + weight
        i = i + lanes
    through = group_sum(through, lanes)
    total = group_sum(total, lanes)
    if not through > 0.0:
        return UPDATES_MAX
    return wp.max(WAY_UPDATES * total / through, WAY_UPDATES_MIN)


@wp.kernel
def detect_changes(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    rays: ProbeRays,
    mirrored: wp.array[int],
    ways: wp.array[wp.vec3],
    lanes: int,
    # Out:
    updates_out: ProbeUpdates,
    pool_out: ProbePool,
):
    """Shorten the history of probes whose light has changed.

    Every ray's departure from its cell's history, weighed by what the ray stands for, has mean 0 while nothing
    changes; their sum is judged by the root of the sum of their squares, or of the sum's own square in updates before
    where that is more: rays that all miss a small light are no change where that happens now and then. One bright ray
    never is. A mirror that moves throws other light from frame to frame, which single rays bring with more noise than
    change: probes with rays over one (`mirrored`: Mirrors.state) or through `ways` (moved_ways.py) remember little.
    `lanes` threads share an update (lane_groups.py).
    """
    update = (first + wp.tid()) // lanes
    lane = (first + wp.tid()) % lanes
    count = updates_out.count[update]
    slot = updates_out.slot[update]
    if slot < 0 or grid.exact == 0 or count <= 0.0:
        if lane == 0:
            updates_out.change[update] = 1.0
            if slot >= 0 and grid.exact != 0:
                pool_out.noise[slot] = 0.0
        return
    change = float(0.0)
    squares = float(0.0)
    known = float(0.0)
    moving = views[0].moved_age < MOVED_FRAMES and mirrored.shape[0] > 0
    over = wp.vec3(0.0, 0.0, 0.0)
    k = lane
    while k < 8:
        cells = load_eight_bytes(updates_out.cell, update * 8 + k)
        # Without branches, so that eight rays wait for memory together.
        for i in range(8):
            cell = cell_at(cells, i)
            at = update * CELLS + wp.min(cell, CELLS - 1)
            before = from_half(load_vec4h(updates_out.previous, at))
            counts = wp.where(cell == NO_CELL, UNCOUNTED, before[3])
            weight = wp.where(counts > 0.0, 1.0 / updates_out.expected[at], 0.0)
            old = luminance(rgb(before), grid.luminance)
            brought = luminance(counted_radiance(rays, update * CELLS + 8 * k + i), grid.luminance)
            departure = weight * (brought - old)
            change = change + departure
            squares = squares + departure * departure
            known = known + weight * old
            if moving:
                moved = wp.where(mirrored[update * CELLS + 8 * k + i] == FOLLOWED_MOVED, weight, 0.0)
                over = over + wp.vec3(weight, moved, moved * old)
        k = k + lanes
    change = group_sum(change, lanes)
    squares = group_sum(squares, lanes)
    known = group_sum(known, lanes)
    if moving:
        over = wp.vec3(group_sum(over[0], lanes), group_sum(over[1], lanes), group_sum(over[2], lanes))
        count = wp.min(count, updates_over_mirrors(over, known))
    count = wp.min(count, updates_through_ways(ways, updates_out, rays, update, lane, lanes))
    if lane > 0:
        return
    updates_out.count[update] = count
    updates_out.change[update] = 1.0
    noise = pool_out.noise[slot]
    if updates_out.fresh[update] == 1:
        noise = 0.0
    # The history errs too, the more the shorter it is.
    sigma = wp.sqrt(wp.max(squares, noise) * (1.0 + 1.0 / count))
    if sigma > 0.0 and wp.abs(change) > CHANGE_LEAST * wp.max(known, known + change):
        z = wp.clamp((wp.abs(change) / sigma - CHANGE_START) / CHANGE_RANGE, 0.0, 1.0)
        updates_out.count[update] = count * (1.0 - z)
        ratio = wp.max(known + change, 0.0) / wp.max(known, 1.0e-6)
        updates_out.change[update] = wp.lerp(1.0, wp.min(ratio, CHANGE_MOST), z)
    usual = wp.min(change * change, sigma * sigma * (CHANGE_START * CHANGE_START))
    pool_out.noise[slot] = wp.lerp(wp.max(noise, squares * 0.25), usual, 1.0 / (wp.min(count, 32.0) + 1.0))


@wp.func
def mean_of_rays(updates: ProbeUpdates, rays: ProbeRays, update: int) -> wp.vec4:
    """Return the mean radiance of a probe's rays, weighed by what it stands for; w = mean inverse distance [1/m]."""
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    weight = float(0.0)
    k = int(0)
    while k < 8:
        cells = load_eight_bytes(updates.cell, update * 8 + k)
        # Without branches, so that eight rays wait for memory together.
        for i in range(8):
            index = update * CELLS + 8 * k + i
            cell = cell_at(cells, i)
            w = wp.where(
                cell == NO_CELL, 0.0, 1.0 / updates.expected[update * CELLS + wp.min(cell, CELLS - 1)])
            total = total + rgba(counted_radiance(rays, index), counted_inverse(rays, index)) * w
            weight = weight + w
        k = k + 1
    if weight == 0.0:
        return total
    return total / weight


@wp.func
def rays_in_cell(updates: ProbeUpdates, update: int, cell: int) -> int:
    """Return how many rays count in a cell."""
    found = int(0)
    for ray in range(CELLS):
        if int(updates.cell[update * CELLS + ray]) == cell:
            found = found + 1
    return found


@wp.func
def published_backup(updates: ProbeUpdates, rays: ProbeRays, update: int) -> wp.vec3:
    """Return what the published method puts into empty cells: the mean of the filled ones, shared by all of them."""
    total = wp.vec3(0.0, 0.0, 0.0)
    empty = float(0.0)
    for cell in range(CELLS):
        found = rays_in_cell(updates, update, cell)
        if found == 0:
            empty = empty + 1.0
        else:
            mean = wp.vec3(0.0, 0.0, 0.0)
            for ray in range(CELLS):
                if int(updates.cell[update * CELLS + ray]) == cell:
                    mean = mean + counted_radiance(rays, update * CELLS + ray)
            total = total + mean / float(found)
    return total / wp.max((float(CELLS) - empty) * empty, 1.0)


@wp.func
def published_step(old: float, new: float) -> float:
    """Return the weight of the history by the published hysteresis: only what has more than doubled is slowed down."""
    rise = wp.max(new - old - wp.min(new, old), 0.0) / wp.max(wp.max(new, old), 1.0e-4)
    rise = wp.min(rise, 0.95)
    return rise * rise


@wp.kernel
def blend_rays(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    updates: ProbeUpdates,
    rays: ProbeRays,
    # Out:
    pool_out: ProbePool,
):
    """Bring one cell of an updated probe up to date."""
    index = first + wp.tid()
    update = index // CELLS
    cell = index % CELLS
    slot = updates.slot[update]
    if slot < 0:
        return
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    found = float(0.0)
    before = from_half(load_vec4h(updates.previous, index))
    k = int(0)
    while k < 8:
        marks = rays_of(load_eight_bytes(updates.cell, update * 8 + k), cell)
        while marks != wp.uint64(0):
            i = update * CELLS + 8 * k + first_ray(marks)
            marks = marks & (marks - wp.uint64(1))
            total = total + rgba(counted_radiance(rays, i), counted_inverse(rays, i))
            found = found + 1.0
        k = k + 1
    known = before[3] > 0.0
    count = updates.count[update]
    value = rgb(before)
    inverse = inverse_distance(before[3])
    if grid.exact == 0:
        if found > 0.0:
            value = rgb(total) / found
            inverse = total[3] / found
        else:
            value = published_backup(updates, rays, update)
            inverse = float(0.0)
        if known:
            old = rgb(before)
            step = published_step(luminance(old, grid.luminance), luminance(value, grid.luminance))
            value = wp.lerp(value, old, step)
    elif found > 0.0:
        step = wp.min(found / updates.expected[index] / (count + 1.0), 1.0)
        # Nothing known, or nothing that counts.
        if not known or count <= 0.0:
            step = 1.0
        value = wp.lerp(value, rgb(total) / found, step)
        inverse = wp.lerp(inverse, total[3] / found, step)
    elif known and updates.change[update] <= 1.0:
        value = value * updates.change[update]
    else:
        mean = mean_of_rays(updates, rays, update)
        # Of a probe that became lighter nobody knows in which cells.
        step = wp.where(known, 1.0 - 1.0 / wp.max(updates.change[update], 1.0), 1.0)
        value = wp.lerp(value, rgb(mean), step)
        inverse = wp.lerp(inverse, mean[3], step)
    noise = hash_combine(wp.uint32(slot * CELLS + cell), wp.uint32(views[0].frame))
    store_vec4h(pool_out.radiance, slot * CELLS + cell, store(value, distance_of(inverse), noise))
    if cell == 0:
        pool_out.count[slot] = count + 1.0
