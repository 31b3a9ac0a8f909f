# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that find what each pixel shows triangle by triangle, instead of ray by ray: a visibility buffer.

Burns and Hunt, "The Visibility Buffer: A Cache-Friendly Approach to Deferred Shading" (JCGT 2013), with an atomic
maximum over 64 bits of depth and face, as Schütz, Kerbl and Wimmer, "Rendering Point Clouds with Compute Shaders and
Vertex Order Optimization" (EGSR 2021). Small triangles are drawn by the thread that reads them; others are dealt out in
tiles, a warp each, and large ones in blocks that are dealt out in tiles (Laine and Karras, "High-Performance Software
Rasterization on GPUs", HPG 2011). What they are drawn with is worked out once a triangle: a record of three rows.

Triangles that need a test per hit are not found but noted (`veils`): the pixels in which one lies before what is found
trace a ray through their structure, and the others need not.
"""

from __future__ import annotations

import warp as wp

from .raster_outline import Edges, Rectangle, depth_at, edges_of, intersection, load_outline, may_touch, pixel_bounds
from .types import FrameData
from .view import View
from .wide_bvh_edit import GONE
from .wide_loads import load_vec4, load_vec4i, load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Pixels a side of what a warp draws, and of what is dealt out to several.
TILE = wp.constant(16)
BLOCK = wp.constant(128)
# Threads of a warp.
LANES = wp.constant(32)
# A thread draws a triangle within so many pixels itself, and deals out at most so many tiles.
OWN_PIXELS = wp.constant(64)
OWN_TILES = wp.constant(12)
# Share of its distance by which a veil may lie behind what a pixel shows and is noted all the same: rays decide.
VEIL_SLACK = wp.constant(1.0e-5)

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


@wp.struct
class Visibility:
    """What pixels show, row by row."""

    nearest: wp.array[wp.uint64]
    """Complement of: depth along the view axis (float bits) << 32 | face; 0 where nothing was met"""
    veiled: wp.array[wp.uint8]
    """1 where a triangle that needs a test may lie before it"""


@wp.struct
class Drawing:
    """What all of a launch's triangles are drawn with."""

    width: int
    veils: int
    """1: they are noted in `veiled`"""
    near: float
    """Depths between which something is seen [m]"""
    far: float


@wp.func_native("""
#ifdef __CUDA_ARCH__
    atomicMax(reinterpret_cast<unsigned long long*>(values.data + index), (unsigned long long)value);
#else
    if (value > values.data[index])
        values.data[index] = value;
#endif
""")
def keep_largest(values: wp.array[wp.uint64], index: int, value: wp.uint64):
    """Replace a value by a larger one."""
    ...


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
def visibility_key(depth: float, face: int) -> wp.uint64:
    """Return what is largest for the nearest triangle, of several at the same depth for the lowest face."""
    return ~((wp.uint64(wp.cast(depth, wp.uint32)) << wp.uint64(32)) | wp.uint64(wp.uint32(face)))


@wp.func
def key_depth(key: wp.uint64) -> float:
    """Return the depth in a key."""
    return wp.cast(wp.uint32((~key) >> wp.uint64(32)), float)


@wp.func
def key_face(key: wp.uint64) -> int:
    """Return the face in a key."""
    return int(wp.uint32((~key) & wp.uint64(0xFFFFFFFF)))


@wp.func
def drawing_of(frame: FrameData, width: int, veils: int) -> Drawing:
    """Return what the camera sees triangles with."""
    drawing = Drawing()
    drawing.width = width
    drawing.veils = veils
    drawing.near = frame.clip_start
    drawing.far = frame.clip_end
    return drawing


@wp.func
def pixel_key(drawing: Drawing, edges: Edges, face: int, x: int, y: int) -> wp.uint64:
    """Return the key of a triangle in a pixel, 0 where it is not seen there."""
    depth = depth_at(edges, x, y)
    if depth >= drawing.near and depth < drawing.far:
        return visibility_key(depth, face)
    return wp.uint64(0)


@wp.func
def draw_key(drawing: Drawing, key: wp.uint64, before: wp.uint64, pixel: int, seen: Visibility):
    """Draw what has a key in a pixel, which showed what has the key `before` a moment ago."""
    if key == wp.uint64(0):
        return
    if drawing.veils == 1:
        if before == wp.uint64(0) or key_depth(key) * (1.0 - VEIL_SLACK) <= key_depth(before):
            seen.veiled[pixel] = wp.uint8(1)
    elif key > before:
        keep_largest(seen.nearest, pixel, key)


@wp.func
def draw_pixel(drawing: Drawing, edges: Edges, face: int, x: int, y: int, seen: Visibility):
    """Draw a triangle in a pixel if it is seen there."""
    key = pixel_key(drawing, edges, face, x, y)
    if key != wp.uint64(0):
        pixel = y * drawing.width + x
        draw_key(drawing, key, seen.nearest[pixel], pixel, seen)


@wp.func
def draw_rectangle(drawing: Drawing, edges: Edges, face: int, r: Rectangle, seen: Visibility):
    """Draw a triangle in a rectangle, alone."""
    y = r.y0
    while y <= r.y1:
        x = r.x0
        while x <= r.x1:
            draw_pixel(drawing, edges, face, x, y, seen)
            x = x + 1
        y = y + 1


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
    drawing = drawing_of(view.camera, width, veils)
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
    veils: int,
    groups: int,
    # Out:
    lists_out: RasterLists,
    seen_out: Visibility,
):
    """Deal out the tiles of blocks: LANES threads a block, in `groups`."""
    item = wp.tid() // LANES
    lane = wp.tid() % LANES
    drawing = drawing_of(views[0].camera, width, veils)
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


@wp.func
def key_within(drawing: Drawing, edges: Edges, face: int, x: int, y: int, part: Rectangle) -> wp.uint64:
    """Return pixel_key in a rectangle that has its low corner there or before, else 0."""
    if x > part.x1 or y > part.y1:
        return wp.uint64(0)
    return pixel_key(drawing, edges, face, x, y)


@wp.func
def shown_before(seen: Visibility, key: wp.uint64, pixel: int) -> wp.uint64:
    """Return the key of what a pixel shows, where something is going to be compared with it; may be old."""
    if key == wp.uint64(0):
        return wp.uint64(0)
    return seen.nearest[pixel]


@wp.func
def draw_four(drawing: Drawing, edges: Edges, face: int, x: int, y: int, part: Rectangle, seen: Visibility):
    """Draw a triangle in (x, y), (x + 8, y), (x, y + 4) and (x + 8, y + 4); what these show is read at once."""
    pixel = y * drawing.width + x
    below = pixel + 4 * drawing.width
    key_0 = key_within(drawing, edges, face, x, y, part)
    key_1 = key_within(drawing, edges, face, x + 8, y, part)
    key_2 = key_within(drawing, edges, face, x, y + 4, part)
    key_3 = key_within(drawing, edges, face, x + 8, y + 4, part)
    before_0 = shown_before(seen, key_0, pixel)
    before_1 = shown_before(seen, key_1, pixel + 8)
    before_2 = shown_before(seen, key_2, below)
    before_3 = shown_before(seen, key_3, below + 8)
    draw_key(drawing, key_0, before_0, pixel, seen)
    draw_key(drawing, key_1, before_1, pixel + 8, seen)
    draw_key(drawing, key_2, before_2, below, seen)
    draw_key(drawing, key_3, before_3, below + 8, seen)


@wp.kernel(cuda_max_registers=40)
def raster_tiles(
    # In:
    views: wp.array[View],
    width: int,
    veils: int,
    groups: int,
    lists: RasterLists,
    # Out:
    seen_out: Visibility,
):
    """Draw the tiles of the list: LANES threads a tile, in `groups`, each in every eighth column and fourth row."""
    item = wp.tid() // LANES
    lane = wp.tid() % LANES
    drawing = drawing_of(views[0].camera, width, veils)
    count = wp.min(lists.counts[TILE_COUNT], lists.tiles.shape[0])
    while item < count:
        tile = load_vec4i(lists.tiles, item)
        edges = edges_in(lists.records, tile[0])
        part = rectangle_of(tile)
        y = part.y0 + lane // 8
        while y <= part.y1:
            x = part.x0 + lane % 8
            draw_four(drawing, edges, tile[3], x, y, part, seen_out)
            y = y + 8
        item = item + groups
