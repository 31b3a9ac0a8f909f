# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: where exactly the probes of this frame's updates lie, and in which slots of the pool they go."""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, Surface, barycentrics_of, load_material, load_surface
from .geometry_math import luminance
from .intersect import Hit, surface_point
from .packing import pack_normal, unpack_normal
from .probe_spawn import LAYER_SHARE, WINDOW_STEP, on_surface, probe_cell, separated, surface_distance
from .probe_turns import may_wait, served_tile
from .probe_types import ProbeGrid, ProbePool, ProbeTiles, ProbeUpdates
from .sampling import hashed_unit
from .types import Scene
from .view import View, direction_to_eye

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Reflections of rougher surfaces are read from the probes themselves (GI-1.0), so they need no rays.
SPECULAR_ROUGHNESS = wp.constant(0.6)

# Of the guided half of the rays, at most this share goes into the reflection.
SPECULAR_SHARE = wp.constant(0.25)


@wp.func
def free_slot(grid: ProbeGrid, pool: ProbePool, update: int, frame: int) -> int:
    """Return the slot of the update's window that has not stood for a tile for longest, -1 if all do now."""
    count = grid.update_columns * grid.update_rows
    window = (update + frame * WINDOW_STEP) % count
    best = int(-1)
    oldest = frame + 1
    slot = window
    while slot < grid.slots:
        used = pool.used[slot]
        if used < oldest:
            oldest = used
            best = slot
        slot = slot + count
    return best


@wp.func
def is_same_place(view: View, pool: ProbePool, slot: int, s: Surface) -> bool:
    """Return whether a probe of a tile may be moved to a surface point of the tile."""
    n = unpack_normal(pool.normal[slot])
    if not on_surface(view, s, pool.position[slot], n):
        return False
    apart = surface_distance(s.geometric_normal, n, pool.position[slot] - s.position)
    if apart > LAYER_SHARE * probe_cell(view, s.depth):
        return False
    return not separated(pool, slot, s.position)


@wp.func
def specular_rays(grid: ProbeGrid, gbuffer: GBuffer, pixel: int, u: float) -> int:
    """Return how many of a probe's rays go into the reflection at its pixel."""
    m = load_material(gbuffer, pixel)
    if grid.specular == 0 or m.roughness > SPECULAR_ROUGHNESS:
        return 0
    specular = luminance(m.specular, grid.luminance)
    total = specular + luminance(m.diffuse, grid.luminance)
    if total <= 0.0:
        return 0
    return int(wp.min(specular / total, SPECULAR_SHARE) * 32.0 + u)


@wp.kernel
def place_updates(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    scene: Scene,
    gbuffer: GBuffer,
    tiles: ProbeTiles,
    pool: ProbePool,
    # Out:
    updates_out: ProbeUpdates,
):
    """Find the tile, the exact point and the slot of each update."""
    update = first + wp.tid()
    view = views[0]
    tile = updates_out.own[update]
    if updates_out.free[update] == 1:
        last = grid.update_columns * grid.update_rows - 1
        served = served_tile(
            updates_out.rank[update] - 1, updates_out.rank[last],
            tiles.rank[grid.tile_columns * grid.tile_rows - 1], view.frame, tiles.empty_list)
        if served >= 0:
            tile = served
        elif tile >= 0:
            if may_wait(grid, view, tiles, pool, update):
                tile = -1
    updates_out.tile[update] = tile
    updates_out.slot[update] = -1
    if tile < 0:
        return
    pixel = tiles.seed[tile]
    s = load_surface(view, gbuffer, grid.width, pixel)
    slot = tiles.probe[tile]
    fresh = int(1)
    if slot >= 0:
        if is_same_place(view, pool, slot, s):
            fresh = 0
    if fresh == 1:
        slot = tiles.other[tile]
        if slot >= 0:
            if is_same_place(view, pool, slot, s):
                fresh = 0
    if fresh == 1:
        slot = free_slot(grid, pool, update, view.frame)
    if slot < 0:
        return
    hit = Hit()
    hit.instance = gbuffer.hit[pixel][0]
    hit.triangle = gbuffer.hit[pixel][1]
    weights = barycentrics_of(gbuffer, pixel)
    hit.u = weights[0]
    hit.v = weights[1]
    point = surface_point(scene, hit, -direction_to_eye(view.camera, s.position))
    updates_out.slot[update] = slot
    updates_out.fresh[update] = fresh
    updates_out.pixel[update] = pixel
    updates_out.position[update] = point.position
    updates_out.error[update] = point.error
    updates_out.normal[update] = pack_normal(point.geometric_normal)
    updates_out.specular[update] = specular_rays(
        grid, gbuffer, pixel, hashed_unit(wp.uint32(slot), wp.uint32(view.frame)))


@wp.kernel
def commit_updates(
    # In:
    views: wp.array[View],
    updates: ProbeUpdates,
    # Out:
    pool_out: ProbePool,
    tiles_out: ProbeTiles,
):
    """Move the updated probes to their new places; from here on they stand for their tiles."""
    update = wp.tid()
    slot = updates.slot[update]
    if slot < 0:
        return
    now = views[0].frame + 1
    position = updates.position[update]
    step = 1.0 / (updates.count[update] + 1.0)
    if updates.fresh[update] == 1:
        pool_out.born[slot] = now
        # Nothing is known about the new place yet: who asks before the projection reads the map itself.
        pool_out.clear[slot] = 0.0
        step = 1.0
    pool_out.position[slot] = position
    pool_out.center[slot] = wp.lerp(pool_out.center[slot], position, step)
    pool_out.normal[slot] = updates.normal[update]
    pool_out.used[slot] = now
    pool_out.updated[slot] = now
    pool_out.updates[slot] = pool_out.updates[slot] + 1
    tile = updates.tile[update]
    if tiles_out.probe[tile] != slot:
        if tiles_out.other[tile] != slot:
            # The surface that was seen before keeps its probe beside the new one.
            tiles_out.other[tile] = tiles_out.probe[tile]
            tiles_out.probe[tile] = slot
