# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: what is known about the light at a probe's new place before its rays are traced (GI-1.0, 3.2, 3.5).

A probe that is updated in place keeps its cells: its history is the mean over its tile. Aiming it anew after each
small move would blur the map a little every time; beside a wall that took 15 % of the light. A new probe asks those of
the tiles around for the radiance along its cells' directions. Each knows it in the cell in which it sees the same
point: found by two steps of a fixed-point iteration with the distances that it stores, so a gather replaces the
published scatter.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import luminance, orthonormal_tangent, sqr, to_frame
from .lane_groups import group_sum
from .packing import from_half, rgb, rgba, to_half, unpack_normal
from .probe_map import cell_center, cell_of, to_local
from .probe_rays import MISS_DISTANCE, distance_of, inverse_distance
from .probe_spawn import LAYER_SHARE, is_flight, probe_cell, separated, surface_distance
from .probe_types import BANDS, CELLS, FAR, ProbeGrid, ProbePool, ProbeTiles, ProbeUpdates
from .view import View, project, settled_length
from .wide_loads import load_vec4h, load_view
from .wide_stores import store_vec4h

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Cosine between the direction asked for and that of the point found: a cell is 18 degrees wide.
REAIM_COSINE = wp.constant(0.95)

# Cosine between the normals of probes that may tell each other something.
RELATED_NORMAL = wp.constant(0.5)

# A probe that moves farther than so many tiles' widths (seen at a grazing angle) aims its cells anew.
KEPT_CELLS = wp.constant(4.0)

# Frames after an edit of the light in which nothing known from before counts: bounces need that long to follow.
LIGHT_FRAMES = wp.constant(12)

# Frames after an edit of the light during which probes that still hold the light from before tell nothing.
OUTDATED_FRAMES = wp.constant(32)

# Most updates that what the probes around a new one know counts for: they see it from elsewhere, and where the camera
# turns to new surfaces each column of probes asks the one before, so that light would run along a wall. With less than
# one, cells that are thought bright would be put right more surely than those thought dark, and light would be lost.
FRESH_UPDATES = wp.constant(1.0)
# The same while light spreads, less one for each frame at rest: time removes noise.
FIRST_UPDATES = wp.constant(4.0)

# That many times as far off as they are from the new one must be what they see, or their light counts for less, by the
# square: cells are wide, and who comes away from a window still finds it in the same cell, as bright. Where the camera
# turns, each column of new probes asks the one before, so that such light would run along a whole wall.
FAR_WAYS = wp.constant(40.0)

# Cosine between normals, and between the axes about them, from which on two probes' coefficients are of one frame.
SAME_FRAME = wp.constant(0.98)

# Distance [px] that a moving probe may lie from the mean of the places that its history is of: dense probes, updated in
# each frame, go along with their tile, and the light of tens of pixels back would go with them.
MOST_LAG = wp.constant(4.0)

UNKNOWN = wp.constant(-1.0)


@wp.func
def aimed_radiance(pool: ProbePool, slot: int, position: wp.vec3, direction: wp.vec3) -> wp.vec4:
    """Return exposed radiance and distance that arrive at `position` from `direction` as a probe saw it; w < 0: no.

    Where the probe doesn't know what is seen from there, it tells what it sees in that direction itself: were such
    cells left out, those that see the sky, which never are, would make new probes too bright.
    """
    n = unpack_normal(pool.normal[slot])
    origin = pool.position[slot]
    aim = direction
    if wp.dot(n, aim) <= 0.0:
        return wp.vec4(0.0, 0.0, 0.0, UNKNOWN)
    value = from_half(load_vec4h(pool.radiance, slot * CELLS + cell_of(to_local(n, aim))))
    if value[3] >= FAR:
        return value
    found = value
    far = value[3]
    step = int(0)
    while step < 2:
        aim = wp.normalize(position + direction * far - origin)
        if wp.dot(n, aim) <= 0.0:
            return found
        value = from_half(load_vec4h(pool.radiance, slot * CELLS + cell_of(to_local(n, aim))))
        if value[3] >= FAR:
            # What lies behind everything near is seen in the same direction from everywhere, but it was aimed away.
            if wp.dot(aim, direction) > REAIM_COSINE:
                return value
            return found
        far = wp.length(origin + aim * value[3] - position)
        step = step + 1
    seen = origin + aim * value[3] - position
    if wp.dot(seen, direction) < REAIM_COSINE * wp.length(seen):
        return found
    return wp.vec4(value[0], value[1], value[2], wp.min(wp.length(seen), MISS_DISTANCE))


@wp.func
def kept_radiance(pool: ProbePool, slot: int, direction: wp.vec3) -> wp.vec4:
    """Return exposed radiance and distance that a probe holds for a direction; w < 0: it lies below its surface."""
    local = to_local(unpack_normal(pool.normal[slot]), direction)
    if local[2] <= 0.0:
        return wp.vec4(0.0, 0.0, 0.0, UNKNOWN)
    return from_half(load_vec4h(pool.radiance, slot * CELLS + cell_of(local)))


@wp.func
def related(pool: ProbePool, slot: int, position: wp.vec3, normal: wp.vec3, cell: float) -> bool:
    """Return whether a probe lies near the tangent plane of a place, facing the same way, with nothing between."""
    n = unpack_normal(pool.normal[slot])
    offset = pool.position[slot] - position
    if wp.abs(wp.dot(normal, offset)) > cell or wp.abs(wp.dot(n, offset)) > cell or wp.dot(n, normal) < RELATED_NORMAL:
        return False
    if surface_distance(normal, n, offset) > LAYER_SHARE * cell:
        return False
    return not separated(pool, slot, position)


@wp.func
def in_tiles(grid: ProbeGrid, column: int, row: int) -> bool:
    """Return whether there is a tile at a place in the grid."""
    return column >= 0 and row >= 0 and column < grid.tile_columns and row < grid.tile_rows


@wp.func
def neighbour_tile(grid: ProbeGrid, tile: int, x: int, y: int) -> int:
    """Return the tile at an offset, -1 off the picture."""
    i = tile % grid.tile_columns + x
    j = tile // grid.tile_columns + y
    if not in_tiles(grid, i, j):
        return -1
    return j * grid.tile_columns + i


@wp.func
def related_probe(
    pool: ProbePool, tiles: ProbeTiles, tile: int, position: wp.vec3, normal: wp.vec3, cell: float,
) -> int:
    """Return the probe of a tile that is related to a place, -1 for none."""
    if tile < 0:
        return -1
    slot = tiles.probe[tile]
    if slot < 0:
        return -1
    if related(pool, slot, position, normal, cell):
        return slot
    slot = tiles.other[tile]
    if slot >= 0:
        if related(pool, slot, position, normal, cell):
            return slot
    return -1


@wp.func
def valid_count(view: View, pool: ProbePool, slot: int) -> float:
    """Return how many updates a probe's mean is worth: none if they were before the last edit of the light."""
    if view.light_age < LIGHT_FRAMES or pool.updated[slot] <= view.frame - view.light_age:
        return 0.0
    return pool.count[slot]


@wp.func
def outdated(view: View, pool: ProbePool, slot: int) -> bool:
    """Return whether the light was edited a short while ago and a probe has not been updated since."""
    return view.light_age < OUTDATED_FRAMES and pool.updated[slot] <= view.frame - view.light_age


@wp.func
def gather_around(
    view: View, grid: ProbeGrid, pool: ProbePool, tiles: ProbeTiles, tile: int, position: wp.vec3, normal: wp.vec3,
    direction: wp.vec3, cell: float, band: int,
) -> tuple[wp.vec4, wp.vec4]:
    """Return the mean of what the probes of 3 x 3 tiles know, nearer ones weighing more; w < 0: nothing.

    And of what their cells miss of a coefficient, if `band` is one; w = updates in it, 0: nothing is known.
    """
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    weight = float(0.0)
    missed = wp.vec4(0.0, 0.0, 0.0, 0.0)
    found = float(0.0)
    i = int(0)
    while i < 9:
        slot = related_probe(
            pool, tiles, neighbour_tile(grid, tile, i % 3 - 1, i // 3 - 1), position, normal, cell)
        if slot >= 0:
            value = aimed_radiance(pool, slot, position, direction)
            if value[3] > 0.0 and not outdated(view, pool, slot):
                w = 1.0 / (1.0 + wp.length_sq(pool.position[slot] - position) / (cell * cell))
                total = total + rgba(rgb(value), inverse_distance(value[3])) * w
                weight = weight + w
            if band < BANDS:
                n = unpack_normal(pool.normal[slot])
                axes = wp.dot(orthonormal_tangent(n), orthonormal_tangent(normal))
                if wp.min(axes, wp.dot(n, normal)) > SAME_FRAME:
                    residual = pool.residual[slot * BANDS + band]
                    missed = missed + rgba(rgb(residual), 1.0) * residual[3]
                    found = found + 1.0
        i = i + 1
    if missed[3] > 0.0:
        missed = rgba(rgb(missed) / missed[3], missed[3] / found)
    if weight == 0.0:
        return wp.vec4(0.0, 0.0, 0.0, UNKNOWN), missed
    return rgba(rgb(total) / weight, distance_of(total[3] / weight)), missed


@wp.kernel(cuda_max_registers=80)
def gather_history(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    tiles: ProbeTiles,
    pool: ProbePool,
    cosines: wp.array[float],
    # Out:
    updates_out: ProbeUpdates,
):
    """Find for each cell of each update the radiance known before, and how much light it brings.

    For new probes also what the cells of those around miss, by the threads of the first cells.
    """
    index = first + wp.tid()
    update = index // CELLS
    cell = index % CELLS
    slot = updates_out.slot[update]
    if slot < 0:
        return
    position = updates_out.position[update]
    normal = unpack_normal(updates_out.normal[update])
    direction = to_frame(normal, cell_center(cell))
    view = load_view(views)
    width = probe_cell(view, project(view.camera, position)[2])
    value = wp.vec4(0.0, 0.0, 0.0, UNKNOWN)
    if updates_out.fresh[update] == 0:
        if wp.length(pool.position[slot] - position) < KEPT_CELLS * width:
            value = kept_radiance(pool, slot, direction)
        else:
            value = aimed_radiance(pool, slot, position, direction)
    if value[3] <= 0.0:
        found, missed = gather_around(
            view, grid, pool, tiles, updates_out.tile[update], position, normal, direction, width, cell)
        value = found
        if cell < BANDS:
            updates_out.residual[update * BANDS + cell] = missed
    store_vec4h(updates_out.previous, index, to_half(value))
    updates_out.guide[index] = wp.where(
        value[3] > 0.0, luminance(rgb(value), grid.luminance) * cosines[cell], UNKNOWN)


@wp.func
def share_from_afar(updates: ProbeUpdates, update: int, way: float, lane: int, lanes: int) -> float:
    """Return the share of an update's history that looks the same from some way off [m]: what comes from afar.

    By all `lanes` threads of an update (lane_groups.py).
    """
    alike = float(0.0)
    total = float(0.0)
    limit = wp.max(FAR_WAYS * way, 1.0e-9)
    k = lane
    while k < 8:
        # Without branches, so that eight cells wait for memory together.
        for i in range(8):
            index = update * CELLS + 8 * k + i
            light = wp.max(updates.guide[index], 0.0)
            inverse = inverse_distance(from_half(load_vec4h(updates.previous, index))[3])
            far = 1.0 / wp.max(limit * inverse, 1.0)
            alike = alike + light * far * far
            total = total + light
        k = k + lanes
    return group_sum(alike, lanes) / wp.max(group_sum(total, lanes), 1.0e-9)


@wp.func
def kept_count(view: View, count: float, center: wp.vec3, position: wp.vec3) -> float:
    """Return how many updates of a history count where a probe has come from the mean of its places.

    Never fewer than one: less would lose light (FRESH_UPDATES).
    """
    before = project(view.camera, center)
    now = project(view.camera, position)
    share = float(0.0)
    if before[2] > 0.0:
        lag = wp.sqrt(sqr(now[0] - before[0]) + sqr(now[1] - before[1]))
        share = MOST_LAG / wp.max(lag, MOST_LAG)
    return wp.max(count * share, wp.min(count, 1.0))


@wp.kernel
def count_history(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    tiles: ProbeTiles,
    pool: ProbePool,
    lanes: int,
    # Out:
    updates_out: ProbeUpdates,
):
    """Find how much each update's history is worth, and give cells without one the mean of the others as guide.

    `lanes` threads share an update (lane_groups.py).
    """
    update = (first + wp.tid()) // lanes
    lane = (first + wp.tid()) % lanes
    slot = updates_out.slot[update]
    if slot < 0:
        return
    view = load_view(views)
    known = float(0.0)
    total = float(0.0)
    k = lane
    while k < 8:
        # Without branches, so that eight cells wait for memory together.
        for i in range(8):
            guide = updates_out.guide[update * CELLS + 8 * k + i]
            known = known + wp.where(guide >= 0.0, 1.0, 0.0)
            total = total + wp.where(guide >= 0.0, guide, 0.0)
        k = k + lanes
    known = group_sum(known, lanes)
    total = group_sum(total, lanes)
    covered = int(known)
    if covered < CELLS:
        k = lane
        while k < 8:
            for i in range(8):
                cell = update * CELLS + 8 * k + i
                if updates_out.guide[cell] < 0.0:
                    updates_out.guide[cell] = total / wp.max(known, 1.0)
            k = k + lanes
    count = float(0.0)
    if updates_out.fresh[update] == 0:
        count = valid_count(view, pool, slot)
        if is_flight(view):
            count = kept_count(view, count, pool.center[slot], updates_out.position[update])
    else:
        position = updates_out.position[update]
        normal = unpack_normal(updates_out.normal[update])
        width = probe_cell(view, project(view.camera, position)[2])
        found = float(0.0)
        apart = float(0.0)
        i = lane
        while i < 9:
            tile = neighbour_tile(grid, updates_out.tile[update], i % 3 - 1, i // 3 - 1)
            other = related_probe(pool, tiles, tile, position, normal, width)
            if other >= 0:
                if not outdated(view, pool, other):
                    count = count + valid_count(view, pool, other)
                    found = found + 1.0
                    apart = apart + wp.length(pool.position[other] - position)
            i = i + lanes
        count = group_sum(count, lanes)
        found = group_sum(found, lanes)
        apart = group_sum(apart, lanes)
        most = wp.where(is_flight(view), FRESH_UPDATES, wp.max(FIRST_UPDATES - float(view.rest), 0.0))
        count = wp.min(count / wp.max(found, 1.0), most)
        if count > 0.0:
            count = count * share_from_afar(updates_out, update, apart / found, lane, lanes)
    if lane > 0:
        return
    # Longer at rest, by the updates since.
    turns = float(grid.side * grid.side)
    limit = wp.min((grid.history + float(view.rest)) / turns, 1024.0)
    limit = wp.min(limit, settled_length(view) / turns)
    # With less, cells that get a ray in every other update would have to step by more than all.
    updates_out.count[update] = wp.min(count, wp.max(limit, 1.0))
    updates_out.covered[update] = covered
