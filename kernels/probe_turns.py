# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: on which tiles probes are updated in this frame.

Each spawn tile (16 x 16 px by default) has one update a frame; tiles without a probe come first, within the spawn tile
and then all over the screen: updates that can wait are handed to empty tiles one by one (the patching published in
GI-1.0, section 3.3, draws at random and may hit one update twice). While the camera moves the others take turns, and
tiles between probes of others count as served.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, load_surface
from .packing import unpack_normal
from .probe_gather import neighbour_tile
from .probe_spawn import claim_slot, is_flight, on_surface, separated
from .probe_types import ProbeGrid, ProbePool, ProbeTiles, ProbeUpdates
from .view import View, film_centre, project

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Updates that a probe has averaged from which on the next may wait: before, every ray counts.
SETTLED_COUNT = wp.constant(4.0)

# Frames since something else than the camera moved from which on all take turns.
STILL_FRAMES = wp.constant(16.0)

# Intervals up to this many frames are of pictures that are coarser, where what is new has an update in each frame.
SHORT_INTERVAL = wp.constant(2)

# Distance [px], across and down, from a tile's seed within which probes of other tiles do for it.
SERVED_REACH = wp.constant(12.0)


@wp.func
def turn_tile(grid: ProbeGrid, update: int, turn: int) -> int:
    """Return the tile of a spawn tile whose turn it is, -1 off the picture; diagonals first."""
    n = grid.side
    k = turn % (n * n)
    x = (update % grid.update_columns) * n + k % n
    y = (update // grid.update_columns) * n + (k // n + k) % n
    if x >= grid.tile_columns or y >= grid.tile_rows:
        return -1
    return y * grid.tile_columns + x


@wp.func
def turn_interval(grid: ProbeGrid, view: View) -> int:
    """Return of how many frames an update that may wait has one; 1: none waits, as at rest and while light spreads."""
    return wp.where(is_flight(view), grid.interval, 1)


@wp.func
def is_served(
    grid: ProbeGrid, view: View, gbuffer: GBuffer, pool: ProbePool, tiles: ProbeTiles, tile: int,
) -> bool:
    """Return whether probes of the tiles around do for a tile without any: on its surface, on both sides of its seed.

    From one side light would be carried on: along a wall that comes into view it would follow the camera.
    """
    seed = tiles.seed[tile]
    s = load_surface(view, gbuffer, grid.width, seed)
    centre = film_centre(view, grid.width, seed)
    sides = int(0)
    i = int(0)
    while i < 9:
        near = neighbour_tile(grid, tile, i % 3 - 1, i // 3 - 1)
        i = i + 1
        slot = int(-1)
        if near >= 0:
            slot = claim_slot(tiles.claim[near])
        if slot >= 0:
            position = pool.position[slot]
            if on_surface(view, s, position, unpack_normal(pool.normal[slot])):
                film = project(view.camera, position)
                if wp.max(wp.abs(film[0] - centre[0]), wp.abs(film[1] - centre[1])) < SERVED_REACH:
                    if not separated(pool, slot, s.position):
                        side = wp.where(film[0] < centre[0], 1, 0) + wp.where(film[1] < centre[1], 2, 0)
                        sides = sides | (1 << side)
    return (sides & 9) == 9 or (sides & 6) == 6


@wp.kernel
def find_missing(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    pool: ProbePool,
    # Out:
    tiles_out: ProbeTiles,
):
    """Find the tiles that need a probe at once.

    While the camera moves, the pool's probes fall onto the tiles as they come: two on one, none on the next, where
    nothing new has come into view. Such a tile gets its own when its turn comes.
    """
    tile = first + wp.tid()
    missing = tiles_out.seed[tile] >= 0 and tiles_out.claim[tile] < wp.int64(0)
    if missing and turn_interval(grid, views[0]) > 1:
        missing = not is_served(grid, views[0], gbuffer, pool, tiles_out, tile)
    tiles_out.empty[tile] = wp.where(missing, 1, 0)


@wp.func
def all_take_turns(view: View, interval: int) -> bool:
    """Return whether updates wait whatever they know: with long intervals, while only the camera moves."""
    return interval > SHORT_INTERVAL and float(view.moved_age) >= STILL_FRAMES


@wp.func
def is_calm(grid: ProbeGrid, tiles: ProbeTiles, pool: ProbePool, update: int) -> bool:
    """Return whether none of a spawn tile's probes is new or has met a change of light."""
    least = SETTLED_COUNT
    i = int(0)
    while i < grid.side * grid.side:
        tile = turn_tile(grid, update, i)
        if tile >= 0:
            slot = claim_slot(tiles.claim[tile])
            if tiles.seed[tile] >= 0 and slot >= 0:
                least = wp.min(least, pool.count[slot])
        i = i + 1
    return least >= SETTLED_COUNT


@wp.func
def may_wait(grid: ProbeGrid, view: View, tiles: ProbeTiles, pool: ProbePool, update: int) -> bool:
    """Return whether a spawn tile that misses no probe leaves its update to a later frame: in turns all but one may."""
    interval = turn_interval(grid, view)
    row = update // grid.update_columns
    turn = update % grid.update_columns + row * wp.max(interval // 2, 1) + view.frame
    if turn % interval == 0:
        return False
    if all_take_turns(view, interval):
        return True
    return is_calm(grid, tiles, pool, update)


@wp.kernel
def choose_tiles(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    tiles: ProbeTiles,
    pool: ProbePool,
    # Out:
    updates_out: ProbeUpdates,
):
    """Choose the tile of each spawn tile that needs an update most: one that misses a probe, else by turns."""
    update = first + wp.tid()
    view = views[0]
    interval = turn_interval(grid, view)
    turn = view.frame // interval
    if interval > SHORT_INTERVAL and not all_take_turns(view, interval):
        if not is_calm(grid, tiles, pool, update):
            # It waits for no frame, and goes on to the next tile in each.
            turn = view.frame
    missing = int(-1)
    covered = int(-1)
    i = int(0)
    while missing < 0 and i < grid.side * grid.side:
        tile = turn_tile(grid, update, turn % (grid.side * grid.side) + i)
        if tile >= 0:
            if tiles.seed[tile] >= 0:
                if tiles.empty[tile] == 1:
                    missing = tile
                elif covered < 0:
                    covered = tile
        i = i + 1
    updates_out.own[update] = wp.where(missing >= 0, missing, covered)
    updates_out.free[update] = wp.where(missing >= 0, 0, 1)


@wp.kernel
def mark_empty(
    first: int,
    # In:
    grid: ProbeGrid,
    updates: ProbeUpdates,
    # Out:
    tiles_out: ProbeTiles,
):
    """Write down each tile's probes, and whether it is left without one."""
    tile = first + wp.tid()
    update = (tile // grid.tile_columns // grid.side) * grid.update_columns + tile % grid.tile_columns // grid.side
    probe = claim_slot(tiles_out.claim[tile])
    tiles_out.probe[tile] = probe
    tiles_out.other[tile] = claim_slot(tiles_out.claim_other[tile])
    if updates.own[update] == tile:
        tiles_out.empty[tile] = 0


@wp.kernel
def list_empty(
    # Out:
    tiles_out: ProbeTiles,
):
    """List the empty tiles by rank."""
    tile = wp.tid()
    if tiles_out.empty[tile] == 1:
        tiles_out.empty_list[tiles_out.rank[tile] - 1] = tile


@wp.func
def spread(index: int, count: int, of: int) -> int:
    """Return the index-th of `count` numbers spread evenly over 0 .. of - 1."""
    return int(wp.int64(index) * wp.int64(of) / wp.int64(count))


@wp.func
def served_tile(rank: int, free_count: int, empty_count: int, frame: int, empty_list: wp.array[int]) -> int:
    """Return the empty tile that takes over the free update of a rank (from 0), -1 for none; a bijection.

    min(free, empty) pairs: both sides are spread evenly over their lists and rotate with the frames.
    """
    pairs = wp.min(free_count, empty_count)
    if pairs == 0:
        return -1
    at = (rank + frame * 61) % free_count
    pair = int((wp.int64(at) * wp.int64(pairs) + wp.int64(free_count - 1)) / wp.int64(free_count))
    if pair >= pairs:
        return -1
    if spread(pair, pairs, free_count) != at:
        return -1
    return empty_list[(spread(pair, pairs, empty_count) + frame * 89) % empty_count]
