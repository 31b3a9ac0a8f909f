# SPDX-License-Identifier: GPL-3.0-or-later
"""Slots of the hash grid dealt by the keys of new cells, not by which thread comes first.

An option, for frames that are the same in every run on a device with many threads: insertion as it is otherwise
(hash_grid.py) gives a hole to whoever finds it first, so that a cell's slot, when it is looked at for its age and who
is left out where a bucket is full are a matter of chance. Here new cells claim slots before they are inserted, and a
claim gives way to one of a greater key and moves on to the next hole: the outcome is the same in any order (Shun and
Blelloch 2014, "Phase-concurrent hash tables for determinism", whose priorities these are). Claims are keys with
the sign changed, which nobody finds; `settle_cells` makes cells of them, and insertion then finds all that have room.
"""

from __future__ import annotations

import warp as wp

from .cache_cells import needs_cell
from .cache_rays import Vertices, cell_seed, hit_place
from .hash_grid import BUCKET, EMPTY, NO_CELL, HashGrid, cell_key, cell_level, find_key, first_slot, wide_key
from .paths import Paths
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def claim_key(grid: HashGrid, key: wp.int64):
    """Claim a slot for a key that has none; atomic. Without holes left the smallest of the bucket's new keys are lost.

    No key claims two slots: it passes a hole only for good, when a greater one has it.
    """
    if grid.scan_all == 1:
        if find_key(grid, key) != NO_CELL:
            return
    first = first_slot(grid, key)
    claim = -key
    i = int(0)
    while i < BUCKET:
        held = grid.keys[first + i]
        if held == -claim:
            return
        # Less than EMPTY: the claim of a new cell. Holes take the least claim: that of the greatest key.
        if held <= EMPTY and held >= claim:
            held = wp.atomic_min(grid.keys, first + i, claim)
            if held == EMPTY or held == claim:
                return
            claim = wp.max(held, claim)
        i = i + 1


@wp.kernel
def claim_vertices(
    # In:
    views: wp.array[View],
    paths: Paths,
    vertices: Vertices,
    offset: int,
    # Out:
    grid_out: HashGrid,
):
    """Claim slots for the cells of the hits from slot `offset` on (insert_vertices)."""
    slot = offset + wp.tid()
    if not needs_cell(paths, vertices, slot):
        return
    view = views[0]
    place = hit_place(grid_out, paths, vertices, slot)
    level = cell_level(grid_out, view, place.position, cell_seed(slot, view.frame))
    claim_key(grid_out, cell_key(grid_out, level, place, paths.direction[slot]))


@wp.kernel
def claim_coarse(
    # In:
    vertices: Vertices,
    # Out:
    grid_out: HashGrid,
):
    """Claim slots for the coarse cells about the sources of the bounce rays (balance_bounces)."""
    bounce = wp.tid()
    if vertices.source[bounce] != NO_CELL:
        claim_key(grid_out, vertices.coarse[bounce])
        if grid_out.directions == 0:
            claim_key(grid_out, wide_key(grid_out, vertices.coarse[bounce]))


@wp.kernel
def settle_cells(
    # Out:
    grid_out: HashGrid,
):
    """Make cells of the claims."""
    slot = wp.tid()
    key = grid_out.keys[slot]
    if key < EMPTY:
        grid_out.keys[slot] = -key
        wp.atomic_add(grid_out.live, 0, 1)
