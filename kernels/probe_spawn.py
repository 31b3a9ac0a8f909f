# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: which probes of the pool are on the screen, and where probes are updated in this frame.

GI-1.0 (section 3.1 and 3.3) with the probes anchored in the world: instead of resampling each tile's probe from the
frame before, the pool's probes are projected and compete for the tiles. Each spawn tile (16 x 16 px by default) has one
update a frame; tiles without a probe come first, within the spawn tile and then all over the screen: updates that can
wait are handed to empty tiles one by one (the published patching draws at random and may hit one update twice).
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, Surface, has_surface, load_surface, plane_distance
from .packing import unpack_normal
from .probe_map import cell_of, to_local
from .probe_types import CELLS, TILE, ProbeGrid, ProbePool, ProbeTiles, ProbeUpdates
from .sampling import to_unit
from .view import View, pixel_footprint, project, settling_frames

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Additive recurrence of the plastic number (Roberts 2018, "R2"), as fractions of 2^32.
R2_X = wp.constant(wp.uint32(3242174889))
R2_Y = wp.constant(wp.uint32(2447445414))

# Cosine between normals from which on probes and surfaces count as one surface (GI-1.0).
SAME_NORMAL = wp.constant(0.95)

# Frames between which the windows of slots step on, so that idle spawn tiles' slots serve the others.
WINDOW_STEP = wp.constant(97)

# Share of the way to a point at which a probe's rays may end without anything standing between them: the mean of
# inverse distances lies a fifth below the distance from the mean place where a tile meets a wall.
SEPARATION = wp.constant(0.8)

# Frames of light, and those that a probe has averaged, from which on updates may wait: before, every ray counts.
SETTLED_FRAMES = wp.constant(16.0)
SETTLED_COUNT = wp.constant(4.0)

# Share of a tile's width by which probes and places of one surface may lie apart across it (surface_distance): a
# curtain hangs less than a tile's width before its wall, in other light.
LAYER_SHARE = wp.constant(0.25)

SLOT_BITS = wp.constant(wp.int64(4294967295))


@wp.func
def probe_cell(view: View, depth: float) -> float:
    """Return the width [m] of a tile at a depth: the tolerance of all tests between probes and surfaces."""
    return float(TILE) * pixel_footprint(view.camera, depth)


@wp.func
def on_surface(view: View, s: Surface, position: wp.vec3, normal: wp.vec3) -> bool:
    """Return whether a probe lies on the surface of a pixel."""
    if not has_surface(s):
        return False
    return plane_distance(s, position) < probe_cell(view, s.depth) and wp.dot(s.geometric_normal, normal) > SAME_NORMAL


@wp.func
def surface_distance(n: wp.vec3, m: wp.vec3, offset: wp.vec3) -> float:
    """Return how far two points lie apart across the surface that their normals n and m suggest [m].

    Along the mean of the normals: 0 on planes and on all arcs, whose chords lean from both tangent planes alike.
    """
    return wp.abs(wp.dot(n + m, offset)) / wp.max(wp.length(n + m), 1.0e-3)


@wp.func
def separated(pool: ProbePool, slot: int, point: wp.vec3) -> bool:
    """Return whether something stands between a probe and a point of its surface, as its own rays tell.

    Both sides of a thin wall's foot are one plane; only what the probe sees along the ground tells them apart.
    """
    offset = point - pool.center[slot]
    distance = wp.length(offset)
    if SEPARATION * distance <= pool.clear[slot] or distance < 1.0e-9:
        return False
    local = to_local(unpack_normal(pool.normal[slot]), offset / distance)
    seen = float(pool.radiance[slot * CELLS + cell_of(local)][3])
    return seen < SEPARATION * distance


@wp.func
def claim_slot(claim: wp.int64) -> int:
    """Return the slot in a claim, -1 for none."""
    if claim < wp.int64(0):
        return -1
    return int(claim & SLOT_BITS)


@wp.func
def tile_pixel(grid: ProbeGrid, tile: int, x: int, y: int) -> int:
    """Return the pixel at (x, y) of a tile, -1 off the picture."""
    px = (tile % grid.tile_columns) * TILE + x
    py = (tile // grid.tile_columns) * TILE + y
    if px >= grid.width or py >= grid.height:
        return -1
    return py * grid.width + px


@wp.kernel
def seed_tiles(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    # Out:
    tiles_out: ProbeTiles,
):
    """Choose the pixel of each tile where a probe would be put, and open the tile to claims.

    The place is the same for all tiles and moves on each time that all tiles of a spawn tile have had their turn. It
    keeps one pixel off the tile's border, so that the film jitter doesn't carry probes into the next tile.
    """
    tile = first + wp.tid()
    turn = wp.uint32(views[0].frame // (grid.side * grid.side))
    x = 1 + int(to_unit(turn * R2_X + wp.uint32(0x40000000)) * 6.0)
    y = 1 + int(to_unit(turn * R2_Y + wp.uint32(0x20000000)) * 6.0)
    pixel = tile_pixel(grid, tile, x, y)
    seed = int(-1)
    i = int(0)
    # A tile whose chosen pixel shows the sky may hold a surface elsewhere.
    while seed < 0 and i < TILE * TILE:
        if pixel >= 0:
            if gbuffer.hit[pixel][0] >= 0:
                seed = pixel
        i = i + 1
        step = (y * TILE + x + i * 37) % (TILE * TILE)
        pixel = tile_pixel(grid, tile, step % TILE, step // TILE)
    tiles_out.seed[tile] = seed
    tiles_out.claim[tile] = wp.int64(-1)
    tiles_out.claim_other[tile] = wp.int64(-1)


@wp.func
def visible_tile(view: View, gbuffer: GBuffer, grid: ProbeGrid, position: wp.vec3, normal: wp.vec3) -> int:
    """Return the tile on which a probe is seen, -1 where it is off screen, hidden or no longer on a surface."""
    film = project(view.camera, position)
    x = int(wp.floor(film[0])) - view.camera.crop_x
    y = int(wp.floor(film[1])) - view.camera.crop_y
    if film[2] <= 0.0 or x < 0 or y < 0 or x >= grid.width or y >= grid.height:
        return -1
    s = load_surface(view, gbuffer, grid.width, y * grid.width + x)
    if not on_surface(view, s, position, normal):
        return -1
    return (y // TILE) * grid.tile_columns + x // TILE


@wp.kernel
def claim_tiles(
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    # Out:
    pool_out: ProbePool,
    tiles_out: ProbeTiles,
):
    """Project the pool's probes; on each tile the one updated last wins."""
    slot = wp.tid()
    view = views[0]
    if view.restart == 1:
        pool_out.used[slot] = 0
    used = pool_out.used[slot]
    tile = int(-1)
    # Without persistence, a probe that stood for no tile in the frame before (number view.frame) is lost.
    if used > 0 and (grid.persistent == 1 or used == view.frame):
        tile = visible_tile(view, gbuffer, grid, pool_out.position[slot], unpack_normal(pool_out.normal[slot]))
    pool_out.tile[slot] = tile
    if tile >= 0:
        key = (wp.int64(pool_out.updated[slot]) << wp.int64(32)) | wp.int64(slot)
        wp.atomic_max(tiles_out.claim, tile, key)


@wp.kernel
def claim_other_surfaces(
    # In:
    views: wp.array[View],
    pool: ProbePool,
    # Out:
    tiles_out: ProbeTiles,
):
    """Find a second probe for tiles that show two surfaces: the last updated off the winner's surface."""
    slot = wp.tid()
    tile = pool.tile[slot]
    if tile < 0:
        return
    winner = claim_slot(tiles_out.claim[tile])
    if winner == slot:
        return
    view = views[0]
    n = unpack_normal(pool.normal[winner])
    other = unpack_normal(pool.normal[slot])
    offset = surface_distance(n, other, pool.position[slot] - pool.position[winner])
    cell = LAYER_SHARE * probe_cell(view, project(view.camera, pool.position[winner])[2])
    apart = separated(pool, winner, pool.position[slot]) or separated(pool, slot, pool.position[winner])
    if apart or offset > cell or wp.dot(n, other) < SAME_NORMAL:
        key = (wp.int64(pool.updated[slot]) << wp.int64(32)) | wp.int64(slot)
        wp.atomic_max(tiles_out.claim_other, tile, key)


@wp.kernel
def mark_used(
    first: int,
    # In:
    views: wp.array[View],
    tiles: ProbeTiles,
    # Out:
    pool_out: ProbePool,
):
    """Note which probes stand for a tile."""
    slot = first + wp.tid()
    tile = pool_out.tile[slot]
    if tile < 0:
        return
    if claim_slot(tiles.claim[tile]) == slot or claim_slot(tiles.claim_other[tile]) == slot:
        pool_out.used[slot] = views[0].frame + 1


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
def take_turns(grid: ProbeGrid, view: View) -> bool:
    """Return whether in each frame every other spawn tile may leave its update to the next frame."""
    return grid.half_rate == 1 and view.rest == 0 and settling_frames(view) >= SETTLED_FRAMES


@wp.func
def may_wait(grid: ProbeGrid, view: View, tiles: ProbeTiles, pool: ProbePool, update: int) -> bool:
    """Return whether a spawn tile whose tiles all have a probe leaves its update to the next frame.

    On one colour of a checkerboard, and not where one of the probes is new or has met a change of light.
    """
    color = update % grid.update_columns + update // grid.update_columns + view.frame
    if not take_turns(grid, view) or (color & 1) == 0:
        return False
    least = SETTLED_COUNT
    i = int(0)
    while i < grid.side * grid.side:
        tile = turn_tile(grid, update, i)
        if tile >= 0:
            if tiles.seed[tile] >= 0 and tiles.probe[tile] >= 0:
                least = wp.min(least, pool.count[tiles.probe[tile]])
        i = i + 1
    return least >= SETTLED_COUNT


@wp.kernel
def choose_tiles(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    tiles: ProbeTiles,
    # Out:
    updates_out: ProbeUpdates,
):
    """Choose the tile of each spawn tile that needs an update most: an empty one, else the one whose turn it is."""
    update = first + wp.tid()
    turn = views[0].frame
    if take_turns(grid, views[0]):
        turn = turn // 2
    missing = int(-1)
    covered = int(-1)
    i = int(0)
    while missing < 0 and i < grid.side * grid.side:
        tile = turn_tile(grid, update, turn % (grid.side * grid.side) + i)
        if tile >= 0:
            if tiles.seed[tile] >= 0:
                if tiles.claim[tile] < wp.int64(0):
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
    tiles_out.empty[tile] = wp.where(probe < 0 and tiles_out.seed[tile] >= 0 and updates.own[update] != tile, 1, 0)


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
