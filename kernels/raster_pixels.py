# SPDX-License-Identifier: GPL-3.0-or-later
"""How the pixels of a visibility buffer are drawn, and what hides what is behind it. Functions only.

An atomic maximum over 64 bits of depth and face keeps what is nearest (Schütz, Kerbl and Wimmer, "Rendering Point
Clouds with Compute Shaders and Vertex Order Optimization", EGSR 2021). A triangle over a whole tile hides what lies
behind it there, which is not drawn (Greene, Kass and Miller, "Hierarchical Z-Buffer Visibility", SIGGRAPH 1993, of
which this is the one level above pixels).

Triangles that need a test per hit are not found but noted (`veils`): the pixels in which one lies before what is found
trace a ray through their structure, and the others need not.
"""

from __future__ import annotations

import warp as wp

from .raster_outline import Edges, Rectangle, covers_all, depth_at
from .types import FrameData

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Pixels a side of what a warp draws.
TILE = wp.constant(16)
# Share of its distance by which a veil may lie behind what a pixel shows and is noted all the same: rays decide.
VEIL_SLACK = wp.constant(1.0e-5)
# The same by which a triangle may lie behind what covers a tile and is drawn there all the same: more than rounding.
COVER_SLACK = wp.constant(3.0e-5)
# Bits of depths are below.
LARGEST_BITS = wp.constant(2147483647)


@wp.struct
class Visibility:
    """What pixels show, row by row."""

    nearest: wp.array[wp.uint64]
    """Complement of: depth along the view axis (float bits) << 32 | face; 0 where nothing was met"""
    veiled: wp.array[wp.uint8]
    """1 where a triangle that needs a test may lie before it"""
    covers: wp.array[int]
    """Of each tile: LARGEST_BITS less the bits of the depth before which all of its pixels show something; 0 where that
    is not known"""


@wp.struct
class Drawing:
    """What all of a launch's triangles are drawn with."""

    width: int
    height: int
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
def drawing_of(frame: FrameData, width: int, height: int, veils: int) -> Drawing:
    """Return what the camera sees triangles with."""
    drawing = Drawing()
    drawing.width = width
    drawing.height = height
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
def tile_of(drawing: Drawing, part: Rectangle) -> int:
    """Return the index of the tile that a rectangle lies in."""
    return (part.y0 // TILE) * ((drawing.width + TILE - 1) // TILE) + part.x0 // TILE


@wp.func
def is_hidden(drawing: Drawing, edges: Edges, part: Rectangle, seen: Visibility) -> bool:
    """Return whether what covers a tile hides a triangle in a part of it."""
    cover = seen.covers[tile_of(drawing, part)]
    nearest = wp.min(edges.p[3], wp.min(edges.q[3], edges.r[3]))
    return cover > 0 and nearest * (1.0 - COVER_SLACK) > wp.cast(LARGEST_BITS - cover, float)


@wp.func
def note_cover(drawing: Drawing, edges: Edges, part: Rectangle, seen: Visibility):
    """Note the depth of a triangle that is seen in all pixels of a tile."""
    right = wp.min(part.x0 + TILE, drawing.width) - 1
    top = wp.min(part.y0 + TILE, drawing.height) - 1
    whole = part.x0 % TILE == 0 and part.y0 % TILE == 0 and part.x1 == right and part.y1 == top
    if whole and covers_all(edges, part):
        # Depth is the inverse of a linear function: least and largest are at corners.
        a = depth_at(edges, part.x0, part.y0)
        b = depth_at(edges, right, part.y0)
        c = depth_at(edges, part.x0, top)
        d = depth_at(edges, right, top)
        farthest = wp.max(wp.max(a, b), wp.max(c, d))
        if wp.min(wp.min(a, b), wp.min(c, d)) >= drawing.near and farthest < drawing.far:
            wp.atomic_max(seen.covers, tile_of(drawing, part), LARGEST_BITS - wp.cast(farthest, int))


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
