# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that draws the radiance cache at what the camera sees."""

from __future__ import annotations

import warp as wp

from .debug_colors import hash_color, heat
from .gbuffer import GBuffer, has_surface, load_surface, view_direction
from .hash_grid import LEVEL_LIMIT, NO_CELL, HashGrid, cell_key, cell_level, find_key, first_slot, read_cell
from .homes import CellPlace, cell_place
from .packing import rgb
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

CACHE_CELLS = wp.constant(0)
CACHE_LEVELS = wp.constant(1)
CACHE_LIGHT = wp.constant(2)
CACHE_SAMPLES = wp.constant(3)

# Samples that are drawn white.
SAMPLES_SHOWN = wp.constant(256.0)


@wp.func
def shown_cell(grid: HashGrid, level: int, place: CellPlace, direction: wp.vec3) -> int:
    """Return the cell at a point, of the nearest level that has one, or NO_CELL."""
    cell = find_key(grid, cell_key(grid, level, place, direction))
    if cell == NO_CELL:
        cell = find_key(grid, cell_key(grid, level + 1, place, direction))
    if cell == NO_CELL:
        cell = find_key(grid, cell_key(grid, level - 1, place, direction))
    return cell


@wp.kernel
def draw_cache(
    first: int,
    # In:
    views: wp.array[View],
    grid: HashGrid,
    gbuffer: GBuffer,
    width: int,
    what: int,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw the cells, their levels, light or samples; `grid` is given without the blend of levels."""
    pixel = first + wp.tid()
    view = views[0]
    s = load_surface(view, gbuffer, width, pixel)
    color = wp.vec3(0.0, 0.0, 0.0)
    if has_surface(s):
        direction = -view_direction(view, s)
        place = cell_place(grid.homes, gbuffer.hit[pixel][0], s.position, s.geometric_normal)
        level = cell_level(grid, view, s.position, wp.uint32(0))
        if what == CACHE_LEVELS:
            color = hash_color(level + LEVEL_LIMIT)
        if what == CACHE_CELLS:
            key = cell_key(grid, level, place, direction)
            # The bucket is a hash of the key; the rest tells cells of one bucket apart.
            color = hash_color(first_slot(grid, key) + int(wp.uint32(wp.uint64(key) & wp.uint64(7))))
        cell = shown_cell(grid, level, place, direction)
        if cell != NO_CELL:
            if what == CACHE_LIGHT:
                color = rgb(read_cell(grid, cell)) * view.exposure
            if what == CACHE_SAMPLES:
                color = heat(wp.log2(1.0 + grid.direct[cell][3]) / wp.log2(1.0 + SAMPLES_SHOWN))
    picture_out[pixel] = wp.vec4(color[0], color[1], color[2], 1.0)
