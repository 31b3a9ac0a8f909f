# SPDX-License-Identifier: GPL-3.0-or-later
"""Debug views of the screen probes."""

from __future__ import annotations

import warp as wp

from .debug_colors import hash_color, heat, signed_color
from .geometry_math import mean_component
from .packing import from_half, rgb, rgba
from .probe_types import CELLS, TILE, ProbeGrid, ProbePool, ProbeTiles
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SHOW_RADIANCE = wp.constant(0)
SHOW_TILES = wp.constant(1)
SHOW_AGE = wp.constant(2)
SHOW_COUNT = wp.constant(3)

# Frames since the last update shown as white, and updates (as a power of two).
AGE_RANGE = wp.constant(64.0)
COUNT_RANGE = wp.constant(10.0)


@wp.kernel
def show_probes(
    first: int,
    # In:
    what: int,
    grid: ProbeGrid,
    views: wp.array[View],
    tiles: ProbeTiles,
    pool: ProbePool,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show in each tile its probe: its map, its identity, frames since its update, or updates in its mean."""
    pixel = first + wp.tid()
    x = pixel % grid.width
    y = pixel // grid.width
    slot = tiles.probe[(y // TILE) * grid.tile_columns + x // TILE]
    color = wp.vec3(0.0, 0.0, 0.0)
    if slot >= 0:
        if what == SHOW_RADIANCE:
            cell = (y % TILE) * TILE + x % TILE
            color = rgb(from_half(pool.radiance[slot * CELLS + cell])) / views[0].exposure
        if what == SHOW_TILES:
            color = hash_color(slot)
        if what == SHOW_AGE:
            color = heat(float(views[0].frame + 1 - pool.updated[slot]) / AGE_RANGE)
        if what == SHOW_COUNT:
            color = heat(wp.log2(wp.max(pool.count[slot], 1.0)) / COUNT_RANGE)
    picture_out[pixel] = rgba(color, 1.0)


@wp.kernel
def show_exposed(
    first: int,
    # In:
    difference: int,
    views: wp.array[View],
    values: wp.array[wp.vec4h],
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show exposed colours; signed ones by their mean: red where light is added, blue where it is taken away."""
    pixel = first + wp.tid()
    value = rgb(from_half(values[pixel]))
    color = value / views[0].exposure
    if difference == 1:
        color = signed_color(mean_component(value))
    picture_out[pixel] = rgba(color, 1.0)


@wp.kernel
def show_ratio(
    first: int,
    # In:
    ratio: wp.array[wp.float16],
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Show ratios 0..2 as black to white."""
    pixel = first + wp.tid()
    g = 0.5 * float(ratio[pixel])
    picture_out[pixel] = wp.vec4(g, g, g, 1.0)
