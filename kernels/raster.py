# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that find what each pixel shows triangle by triangle, instead of ray by ray: a visibility buffer.

Burns and Hunt, "The Visibility Buffer: A Cache-Friendly Approach to Deferred Shading" (JCGT 2013). Small triangles are
drawn by the thread that reads them; others are dealt out in tiles, a warp each, and large ones in blocks that are dealt
out in tiles (Laine and Karras, "High-Performance Software Rasterization on GPUs", HPG 2011). What they are drawn with
is worked out once a triangle: a record of three rows. How a pixel is drawn is in raster_pixels.py.
"""

from __future__ import annotations

import warp as wp

from .raster_outline import Edges, Rectangle, edges_of, intersection, load_outline, may_touch, pixel_bounds
from .raster_pixels import TILE, Drawing, Visibility, draw_four, draw_rectangle, drawing_of, is_hidden, note_cover
from .view import View
from .wide_bvh_edit import GONE
from .wide_loads import load_vec4, load_vec4i, load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Pixels a side of what is dealt out to several warps.
BLOCK = wp.constant(128)
# Threads of a warp.
LANES = wp.constant(32)
# A thread draws a triangle within so many pixels itself, and deals out at most so many tiles.
OWN_PIXELS = wp.constant(64)
OWN_TILES = wp.constant(12)

# Places in `counts`.
RECORD_COUNT = wp.constant(0)
TILE_COUNT = wp.constant(1)
BLOCK_COUNT = wp.constant(2)


@wp.struct
class RasterLists:
    """Triangles that are dealt out, and parts of them that wait for a warp."""

    records: wp.array[wp.vec4]
    """Edges, three rows each"""
    tiles: wp.array[wp.vec4i]
    """(record, x0 | y0 << 16, x1 | y1 << 16, face): within a tile"""
    blocks: wp.array[wp.vec4i]
    """The same within a block"""
    counts: wp.array[int]
    """Of all three; may exceed what has room, the rest was drawn at once"""


@wp.func_native("""
#ifdef __CUDA_ARCH__
    const unsigned int together = __activemask();
    const int leader = __ffs((int)together) - 1;
    const int lane = (int)(threadIdx.x & 31u);
    int first = 0;
    if (lane == leader)
        first = atomicAdd(counts.data + index, __popc(together));
    first = __shfl_sync(together, first, leader);
    return first + __popc(together & ((1u << lane) - 1u));
#else
    return counts.data[index]++;
#endif
""")
def next_place(counts: wp.array[int], index: int) -> int:
    """Return a place that no other thread gets; one atomic for the threads of a warp that ask together."""
    ...


@wp.func
def cell_part(bounds: Rectangle, x: int, y: int, side: int) -> Rectangle:
    """Return what bounds share with a square of so many pixels a side, of such that cover the picture."""
    cell = Rectangle()
    cell.x0 = x * side
    cell.y0 = y * side
    cell.x1 = cell.x0 + side - 1
    cell.y1 = cell.y0 + side - 1
    return intersection(bounds, cell)


@wp.func
def deal(
    drawing: Drawing, edges: Edges, record: int, face: int, part: Rectangle, large: bool, lists: RasterLists,
    seen: Visibility,
):
    """Put a part of a triangle into the list of blocks (`large`) or tiles; draw it where that is full."""
    if not may_touch(edges, part):
        return
    item = wp.vec4i(record, part.x0 | (part.y0 << 16), part.x1 | (part.y1 << 16), face)
    if large:
        place = next_place(lists.counts, BLOCK_COUNT)
        if place < lists.blocks.shape[0]:
            lists.blocks[place] = item
            return
    else:
        if is_hidden(drawing, edges, part, seen):
            return
        if drawing.veils == 0:
            note_cover(drawing, edges, part, seen)
        place = next_place(lists.counts, TILE_COUNT)
        if place < lists.tiles.shape[0]:
            lists.tiles[place] = item
            return
    draw_rectangle(drawing, edges, face, part, seen)


@wp.func
def rectangle_of(item: wp.vec4i) -> Rectangle:
    """Return the pixels of an entry of a list."""
    r = Rectangle()
    r.x0 = item[1] & 65535
    r.y0 = (item[1] >> 16) & 65535
    r.x1 = item[2] & 65535
    r.y1 = (item[2] >> 16) & 65535
    return r


@wp.func
def edges_in(records: wp.array[wp.vec4], record: int) -> Edges:
    """Return the edges of a record; none is written while some are read."""
    edges = Edges()
    edges.p = load_vec4(records, 3 * record)
    edges.q = load_vec4(records, 3 * record + 1)
    edges.r = load_vec4(records, 3 * record + 2)
    return edges


@wp.kernel(cuda_max_registers=64)
def raster_triangles(
    # In:
    views: wp.array[View],
    triangles: wp.array[wp.uint32],
    wholes: wp.array[int],
    width: int,
    height: int,
    veils: int,
    # Out:
    lists_out: RasterLists,
    seen_out: Visibility,
):
    """Draw small triangles and deal out others. One reference, or a triangle in `wholes`, a thread."""
    reference = wp.tid()
    number = int(-1)
    if wholes.shape[0] > 0:
        number = wholes[reference] % 16
        reference = wholes[reference] // 16
    view = load_view(views)
    outline = load_outline(view, triangles, reference, number)
    if outline.face == GONE:
        return
    bounds = pixel_bounds(view, outline, width, height)
    columns = bounds.x1 - bounds.x0 + 1
    rows = bounds.y1 - bounds.y0 + 1
    if columns <= 0 or rows <= 0:
        return
    drawing = drawing_of(view.camera, width, height, veils)
    edges = edges_of(view, outline)
    face = int(outline.face)
    record = int(-1)
    if columns * rows > OWN_PIXELS:
        record = next_place(lists_out.counts, RECORD_COUNT)
    if record < 0 or 3 * record + 2 >= lists_out.records.shape[0]:
        draw_rectangle(drawing, edges, face, bounds, seen_out)
        return
    lists_out.records[3 * record] = edges.p
    lists_out.records[3 * record + 1] = edges.q
    lists_out.records[3 * record + 2] = edges.r
    side = int(TILE)
    large = (bounds.x1 // side - bounds.x0 // side + 1) * (bounds.y1 // side - bounds.y0 // side + 1) > OWN_TILES
    if large:
        side = int(BLOCK)
    y = bounds.y0 // side
    while y <= bounds.y1 // side:
        x = bounds.x0 // side
        while x <= bounds.x1 // side:
            deal(drawing, edges, record, face, cell_part(bounds, x, y, side), large, lists_out, seen_out)
            x = x + 1
        y = y + 1


@wp.kernel(cuda_max_registers=64)
def raster_blocks(
    # In:
    views: wp.array[View],
    width: int,
    height: int,
    veils: int,
    groups: int,
    # Out:
    lists_out: RasterLists,
    seen_out: Visibility,
):
    """Deal out the tiles of blocks: LANES threads a block, in `groups`."""
    item = wp.tid() // LANES
    lane = wp.tid() % LANES
    drawing = drawing_of(views[0].camera, width, height, veils)
    count = wp.min(lists_out.counts[BLOCK_COUNT], lists_out.blocks.shape[0])
    while item < count:
        block = load_vec4i(lists_out.blocks, item)
        edges = edges_in(lists_out.records, block[0])
        bounds = rectangle_of(block)
        first_x = bounds.x0 // TILE
        first_y = bounds.y0 // TILE
        across = bounds.x1 // TILE - first_x + 1
        tiles = across * (bounds.y1 // TILE - first_y + 1)
        k = lane
        while k < tiles:
            part = cell_part(bounds, first_x + k % across, first_y + k // across, TILE)
            deal(drawing, edges, block[0], block[3], part, False, lists_out, seen_out)
            k = k + LANES
        item = item + groups


@wp.kernel(cuda_max_registers=40)
def raster_tiles(
    # In:
    views: wp.array[View],
    width: int,
    height: int,
    veils: int,
    groups: int,
    lists: RasterLists,
    # Out:
    seen_out: Visibility,
):
    """Draw the tiles of the list: LANES threads a tile, in `groups`, each in every eighth column and fourth row."""
    item = wp.tid() // LANES
    lane = wp.tid() % LANES
    drawing = drawing_of(views[0].camera, width, height, veils)
    count = wp.min(lists.counts[TILE_COUNT], lists.tiles.shape[0])
    while item < count:
        tile = load_vec4i(lists.tiles, item)
        edges = edges_in(lists.records, tile[0])
        part = rectangle_of(tile)
        y = part.y0 + lane // 8
        if is_hidden(drawing, edges, part, seen_out):
            y = part.y1 + 1
        while y <= part.y1:
            x = part.x0 + lane % 8
            draw_four(drawing, edges, tile[3], x, y, part, seen_out)
            y = y + 8
        item = item + groups
