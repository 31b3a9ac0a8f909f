# SPDX-License-Identifier: GPL-3.0-or-later
"""The life of cells: freeing old ones, making those that rays meet, summing up the frame's samples, new means.

Sums are integers, so that their order doesn't matter. Which of two new cells gets a bucket's last slot depends on the
order of threads, unless cache_claim.py has dealt the slots before. Kernels with atomics are one launch each;
`update_cells` writes only its own cells.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import IDLE, UNWATCHED, Vertices, cell_seed, hit_place
from .geometry_math import is_finite3
from .hash_grid import EMPTY, NO_CELL, HashGrid, insert_cell, is_mover
from .intersect import MISS
from .moved_ways import CROSSING, crosses_way, way_cap, way_share, ways_count
from .paths import Paths
from .view import MOVED_FRAMES, View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

FIXED_ONE = wp.constant(4294967296.0)
"""Sums count in units of 1 / 2^32, so 2^31 fits"""
LIGHT_MAX = wp.constant(1.0e6)
"""Brightest sample that a cell takes: two thousand of them a frame still fit"""

LANES = wp.constant(64)
"""Copies of each counter and sum: fewer threads then wait for the same one"""

# CacheControl.counters, one group a lane
COUNT_RAYS = wp.constant(0)
COUNT_BOUNCES = wp.constant(1)
COUNT_SHADOWS = wp.constant(2)
COUNT_FAILED = wp.constant(3)
COUNT_HITS = wp.constant(4)
COUNT_UNKNOWN = wp.constant(5)
"""Hits of probe rays in cells without indirect light yet"""
COUNTERS = wp.constant(8)

PURGE_SHARE = wp.constant(8)
"""Frames in which all cells' ages are looked at once"""
REBALANCE_FRAMES = wp.constant(128)
SAMPLES_MAX = wp.constant(4096.0)
MOVER_SAMPLES = wp.constant(16.0)
"""Samples that cells of what has moved weigh at most while things move: it comes into other light"""

# Frames after a change for which the mean of indirect light reaches back less far than this many times: what cells
# know of each other's light is a mean of what they knew before, which converges only if the past is left behind. A
# plain mean of t frames would keep an error of t^-(1 - albedo), this one keeps about t^(-(1 - albedo) / AGE_SHARE).
AGE_SHARE = wp.constant(0.06)
# So many samples are kept nevertheless by cells that seldom get one.
AGE_SAMPLES = wp.constant(4.0)
# What indirect light from before an edit of light weighs in cells that have had no bounce ray since: bounce rays start
# from cells that know least. So many frames after the edit it counts for nothing, and wide cells stand in.
STALE_SAMPLES = wp.constant(0.25)
STALE_FRAMES = wp.constant(4.0)


@wp.struct
class CacheControl:
    """What kernels of the cache tell each other from frame to frame."""

    age: wp.array[int]
    """[1] frames since the start or the last edit of light"""
    live: wp.array[int]
    """[1] cells in use at the end of the frame before"""
    balance: wp.array[wp.int64]
    """[2 * LANES * 9] O, S and G of the balance, before and after a frame's sweeps"""
    factors: wp.array[wp.vec3]
    """[2] factor on what cells hold, and on this frame's samples"""
    counters: wp.array[int]
    """[LANES * COUNTERS] of count_rays"""


@wp.func
def to_fixed(x: float) -> wp.int64:
    """Return a number in units of the sums. Single samples may be below 0: highlights take off what goes elsewhere."""
    return wp.int64(wp.float64(wp.clamp(x, -LIGHT_MAX, LIGHT_MAX)) * wp.float64(FIXED_ONE))


@wp.func
def from_fixed(x: wp.int64) -> float:
    """Return the number of to_fixed."""
    return float(wp.float64(x) / wp.float64(FIXED_ONE))


@wp.func
def add_sample(sums: wp.array[wp.int64], first: int, light: wp.vec3):
    """Add three channels to sums; atomic. Much light is none: its shadow ray was blocked."""
    if light[0] == 0.0 and light[1] == 0.0 and light[2] == 0.0:
        return
    wp.atomic_add(sums, first, to_fixed(light[0]))
    wp.atomic_add(sums, first + 1, to_fixed(light[1]))
    wp.atomic_add(sums, first + 2, to_fixed(light[2]))


@wp.func
def add_indirect(grid: HashGrid, cell: int, light: wp.vec3):
    """Add a sample of indirect light to a cell, if there is one; atomic."""
    if cell != NO_CELL:
        add_sample(grid.sums, 6 * cell + 3, light)
        wp.atomic_add(grid.counts, 2 * cell + 1, 1)


@wp.func
def count_crossing(grid: HashGrid, cell: int):
    """Count a sample of a cell's indirect light that came through where something has moved; atomic."""
    if cell != NO_CELL:
        wp.atomic_add(grid.crossing, 2 * cell + 1, 1)


@wp.func
def limit_by_ways(grid: HashGrid, which: int, samples: int, cap: float) -> float:
    """Return how many samples a cell's light may weigh, and take in how many of this frame's came through the ways.

    `which`: twice the cell, one more for indirect light.
    """
    if ways_count(grid.ways) == 0:
        return cap
    share = grid.way_share[which]
    grid.way_share[which] = way_share(share, grid.crossing[which], samples)
    grid.crossing[which] = 0
    return wp.min(cap, way_cap(share))


@wp.func
def count_one(control: CacheControl, slot: int, counter: int):
    """Count for the statistics; atomic."""
    wp.atomic_add(control.counters, (slot % LANES) * COUNTERS + counter, 1)


@wp.kernel
def purge_cells(
    # In:
    views: wp.array[View],
    capacity: int,
    lifetime: int,
    # Out:
    grid_out: HashGrid,
    control_out: CacheControl,
):
    """Free the cells of this frame's part of the table that no ray has met for `lifetime` frames.

    From half load on the time shrinks, down to two frames at nine tenths: full buckets cost light.
    """
    view = views[0]
    i = wp.tid()
    if i == 0:
        control_out.age[0] = wp.min(control_out.age[0] + 1, 1 << 20)
        if view.restart == 1 or view.light_age == 0:
            control_out.age[0] = 0
    slot = i * PURGE_SHARE + view.frame % PURGE_SHARE
    if slot >= capacity or grid_out.keys[slot] == EMPTY:
        return
    # Not of grid_out.live, which other threads change meanwhile.
    load = float(control_out.live[0]) / float(capacity)
    limit = float(lifetime) * wp.clamp((0.9 - load) / 0.4, 0.0, 1.0)
    idle = view.frame - grid_out.touched[slot]
    # Negative: from before the frames were counted anew.
    if idle < 0 or float(idle) > wp.max(limit, 2.0):
        grid_out.keys[slot] = EMPTY
        grid_out.direct[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
        grid_out.indirect[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
        wp.atomic_sub(grid_out.live, 0, 1)


@wp.func
def needs_cell(paths: Paths, vertices: Vertices, slot: int) -> bool:
    """Return whether light is kept at a ray's hit. Black surfaces need none."""
    if vertices.emission[slot][3] == IDLE:
        return False
    r = vertices.reflectance[slot]
    return paths.hit[slot][0] != MISS and wp.max(r[0], wp.max(r[1], r[2])) > 0.0


@wp.kernel
def insert_vertices(
    # In:
    views: wp.array[View],
    paths: Paths,
    offset: int,
    # Out:
    grid_out: HashGrid,
    vertices_out: Vertices,
):
    """Find or make the cells of the hits from slot `offset` on."""
    slot = offset + wp.tid()
    vertices_out.cell[slot] = NO_CELL
    if not needs_cell(paths, vertices_out, slot):
        return
    view = views[0]
    vertices_out.cell[slot] = insert_cell(
        grid_out, view, hit_place(grid_out, paths, vertices_out, slot), paths.direction[slot],
        cell_seed(slot, view.frame))


@wp.kernel
def accumulate_light(
    # In:
    views: wp.array[View],
    paths: Paths,
    vertices: Vertices,
    offset: int,
    count: int,
    # Out:
    grid_out: HashGrid,
):
    """Add the samples of direct light at the hits from slot `offset` on, and of indirect light at bounces' sources.

    Rays from slot `count` on are bounces.
    """
    slot = offset + wp.tid()
    cell = vertices.cell[slot]
    if cell != NO_CELL:
        light = paths.radiance[slot]
        if light[3] != UNWATCHED:
            add_sample(grid_out.sums, 6 * cell, wp.vec3(light[0], light[1], light[2]))
            if light[3] == CROSSING:
                wp.atomic_add(grid_out.crossing, 2 * cell, 1)
            wp.atomic_add(grid_out.counts, 2 * cell, 1)
    if slot < count:
        return
    source = vertices.source[slot - count]
    if source == NO_CELL:
        return
    grid_out.touched[source] = views[0].frame
    sample = vertices.arrived[slot - count] + vertices.carried[slot - count]
    add_indirect(grid_out, source, sample)
    add_indirect(grid_out, vertices.around[slot - count], sample)
    add_indirect(grid_out, vertices.far[slot - count], sample)
    if ways_count(grid_out.ways) > 0:
        if crosses_way(grid_out.ways, paths.origin[slot], paths.direction[slot], paths.t[slot]):
            count_crossing(grid_out, source)
            count_crossing(grid_out, vertices.around[slot - count])
            count_crossing(grid_out, vertices.far[slot - count])


@wp.kernel
def count_rays(
    # In:
    paths: Paths,
    vertices: Vertices,
    grid: HashGrid,
    count: int,
    # Out:
    control_out: CacheControl,
):
    """Count what the last frame has done, for statistics; not a part of frames."""
    slot = wp.tid()
    if paths.radiance[slot][3] > 0.0:
        # A shadow ray was set up, see choose_cache_lights.
        count_one(control_out, slot, COUNT_SHADOWS)
    if slot >= count:
        if vertices.source[slot - count] != NO_CELL:
            count_one(control_out, slot, COUNT_BOUNCES)
    if vertices.emission[slot][3] == IDLE:
        return
    count_one(control_out, slot, COUNT_RAYS)
    cell = vertices.cell[slot]
    if cell != NO_CELL:
        if slot < count:
            count_one(control_out, slot, COUNT_HITS)
            if not grid.indirect[cell][3] > 0.0:
                count_one(control_out, slot, COUNT_UNKNOWN)
        return
    if needs_cell(paths, vertices, slot):
        count_one(control_out, slot, COUNT_FAILED)


@wp.func
def blend(held: wp.vec4, sums: wp.array[wp.int64], first: int, samples: int, cap: float, factor: wp.vec3) -> wp.vec4:
    """Return a cell's light with this frame's samples, of which it weighs `cap` of its own at most."""
    n = float(samples)
    mean = wp.cw_mul(
        wp.vec3(from_fixed(sums[first]), from_fixed(sums[first + 1]), from_fixed(sums[first + 2])), factor) / n
    before = wp.min(held[3], cap)
    share = n / (before + n)
    light = wp.vec3(held[0], held[1], held[2])
    light = light + (mean - light) * share
    if not is_finite3(light):
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    return wp.vec4(light[0], light[1], light[2], wp.min(before + n, SAMPLES_MAX))


@wp.func
def light_cap(view: View, sample_cap: float) -> float:
    """Return how many samples a cell's light may weigh: more at rest."""
    return wp.min(wp.max(sample_cap, 4.0 * float(view.rest)), SAMPLES_MAX)


@wp.func
def cell_cap(view: View, grid: HashGrid, cell: int, sample_cap: float) -> float:
    """Return how many samples a cell's light may weigh: fewer while it moves."""
    cap = light_cap(view, sample_cap)
    if view.moved_age < MOVED_FRAMES and is_mover(grid, grid.keys[cell]):
        cap = wp.min(cap, MOVER_SAMPLES)
    return cap


@wp.func
def history_share(cap: float, age: float, samples: int) -> float:
    """Return how many samples a cell's indirect light may weigh against so many new ones: `cap`, by AGE_SHARE less."""
    return wp.min(cap, float(samples) * AGE_SHARE * age)


@wp.func
def scaled(held: wp.vec4, factor: wp.vec3) -> wp.vec4:
    """Return a cell's light times a factor."""
    return wp.vec4(held[0] * factor[0], held[1] * factor[1], held[2] * factor[2], held[3])


@wp.func
def aged(held: wp.vec4, age: float) -> wp.vec4:
    """Return a cell's light with its samples counting less from frame to frame, as few as they may be.

    With n samples in every frame n * AGE_SHARE * age of them are left, whether a frame has many or one has many frames.
    """
    if held[3] <= AGE_SAMPLES:
        return held
    frames = AGE_SHARE * age
    return wp.vec4(held[0], held[1], held[2], wp.max(held[3] * frames / (frames + 1.0), AGE_SAMPLES))


@wp.func
def after_edit(held: wp.vec4, age: float, bounced: int) -> wp.vec4:
    """Return a cell's indirect light, `age` frames after an edit of light, in a frame with so many bounce rays."""
    known = held[3]
    if age == 0.0:
        known = wp.min(known, STALE_SAMPLES)
    elif age == STALE_FRAMES and bounced == 0 and known <= STALE_SAMPLES:
        known = 0.0
    return wp.vec4(held[0], held[1], held[2], known)


@wp.kernel
def update_cells(
    first: int,
    # In:
    views: wp.array[View],
    sample_cap: float,
    # Out:
    grid_out: HashGrid,
    control_out: CacheControl,
):
    """Take this frame's samples into the cells' means, each sample with the same weight."""
    cell = first + wp.tid()
    if cell == 0:
        control_out.live[0] = grid_out.live[0]
    if grid_out.keys[cell] == EMPTY:
        return
    age = float(control_out.age[0])
    cap = cell_cap(views[0], grid_out, cell, sample_cap)
    direct = grid_out.direct[cell]
    if age == 0.0:
        # What was lit before the edit says nothing of the light now.
        direct[3] = 0.0
    samples = grid_out.counts[2 * cell]
    if samples > 0:
        limit = limit_by_ways(grid_out, 2 * cell, samples, cap)
        direct = blend(direct, grid_out.sums, 6 * cell, samples, limit, wp.vec3(1.0, 1.0, 1.0))
        grid_out.counts[2 * cell] = 0
    if samples > 0 or age == 0.0:
        grid_out.direct[cell] = direct
    bounced = grid_out.counts[2 * cell + 1]
    indirect = grid_out.indirect[cell]
    if bounced > 0 or indirect[3] > AGE_SAMPLES or age < float(REBALANCE_FRAMES):
        if age < float(REBALANCE_FRAMES):
            indirect = scaled(after_edit(indirect, age, bounced), control_out.factors[0])
        else:
            indirect = aged(indirect, age)
        if bounced > 0:
            share = history_share(limit_by_ways(grid_out, 2 * cell + 1, bounced, cap), age, bounced)
            indirect = blend(indirect, grid_out.sums, 6 * cell + 3, bounced, share, control_out.factors[1])
            grid_out.counts[2 * cell + 1] = 0
        grid_out.indirect[cell] = indirect
    if samples > 0 or bounced > 0:
        for i in range(6):
            grid_out.sums[6 * cell + i] = wp.int64(0)
