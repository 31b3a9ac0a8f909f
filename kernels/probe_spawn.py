# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: which probes of the pool are on the screen.

GI-1.0 (section 3.1 and 3.3) with the probes anchored in the world: instead of resampling each tile's probe from the
frame before, the pool's probes are projected and compete for the tiles.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, Surface, has_surface, load_surface, plane_distance
from .packing import unpack_normal
from .probe_map import cell_of, to_local
from .probe_types import CELLS, TILE, ProbeGrid, ProbePool, ProbeTiles
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

# Share of a tile's width by which probes and places of one surface may lie apart across it (surface_distance): a
# curtain hangs less than a tile's width before its wall, in other light.
LAYER_SHARE = wp.constant(0.25)

# Frames of light from which on less is asked of an update in motion: before, every ray counts.
SPREAD_FRAMES = wp.constant(16.0)

SLOT_BITS = wp.constant(wp.int64(4294967295))


@wp.func
def is_flight(view: View) -> bool:
    """Return whether something moves, in light that has spread."""
    return view.rest == 0 and settling_frames(view) >= SPREAD_FRAMES


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
