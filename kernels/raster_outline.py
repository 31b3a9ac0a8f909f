# SPDX-License-Identifier: GPL-3.0-or-later
"""Where on the film a triangle lies: bounds in pixels, and its vertices' weights as linear functions of the pixel.

Those functions are homogeneous (Olano and Greer, "Triangle Scan Conversion using 2D Homogeneous Coordinates", Graphics
Hardware 1997): nothing is clipped, wherever the vertices lie. Two triangles agree to the last bit about the edge that
they share, as both begin with the same of its two vertices: no pixel falls between them. Functions only.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import UNIT_ROUNDOFF, transform_direction
from .tube_items import tube_corners
from .types import FrameData
from .view import View, eye_position
from .wide_bvh import TRIANGLE_WORDS, TUBE, TUBE_HALF
from .wide_bvh_edit import GONE

# A vertex in camera space errs by so many roundoffs of its distance.
SLACK_ROUNDOFFS = wp.constant(16.0)
# Share of a pixel by which bounds and edges are widened where they decide for many pixels at once.
PIXEL_SLACK = wp.constant(0.02)
# Coordinates [m] of triangles that no ray can meet.
UNBOUNDED = wp.constant(1.0e30)

RowOfWords = wp.types.vector(length=4, dtype=wp.uint32)


@wp.struct
class Outline:
    """A triangle as the camera sees it."""

    p: wp.vec3
    """Vertices in camera space, which looks along -z"""
    q: wp.vec3
    r: wp.vec3
    face: wp.uint32
    """Index into FlatTriangles.faces, or wide_bvh_edit.GONE"""
    slack: float
    """Error of the vertices [m]"""


@wp.struct
class Rectangle:
    """Pixels x0 to x1 and y0 to y1, both included; none where an end lies before its start."""

    x0: int
    y0: int
    x1: int
    y1: int


@wp.struct
class Edges:
    """Weights a x + b y + c of the vertices in pixel (x, y), up to a factor; each is (a, b, c, depth of the vertex)."""

    p: wp.vec4
    q: wp.vec4
    r: wp.vec4


@wp.func_native("""
#ifdef __CUDA_ARCH__
    const uint4 w = __ldg(reinterpret_cast<const uint4*>(words.data) + row);
    return wp::vec_t<4, wp::uint32>(w.x, w.y, w.z, w.w);
#else
    const wp::uint32* w = words.data + 4 * (size_t)row;
    return wp::vec_t<4, wp::uint32>(w[0], w[1], w[2], w[3]);
#endif
""")
def load_words(words: wp.array[wp.uint32], row: int) -> RowOfWords:
    """Return words 4 * row to 4 * row + 3."""
    ...


@wp.func
def vertex_of(row: RowOfWords) -> wp.vec3:
    """Return the vertex in the first three words."""
    return wp.vec3(wp.cast(row[0], float), wp.cast(row[1], float), wp.cast(row[2], float))


@wp.func
def seen_from(frame: FrameData, point: wp.vec3) -> wp.vec3:
    """Return a point in camera space. Its distance from the eye comes first: both may lie far from the origin."""
    return transform_direction(frame.world_to_camera, point - eye_position(frame))


@wp.func
def load_outline(view: View, triangles: wp.array[wp.uint32], reference: int, number: int) -> Outline:
    """Return the triangle of a reference of the wide BVH; of a tube that with a number, -1 where there are none."""
    rows = TRIANGLE_WORDS // 4
    p = load_words(triangles, rows * reference)
    q = load_words(triangles, rows * reference + 1)
    r = load_words(triangles, rows * reference + 2)
    outline = Outline()
    outline.face = p[3]
    if number >= 0 and (q[3] & TUBE) != wp.uint32(0):
        if p[3] != GONE:
            outline.face = p[3] + wp.uint32(number)
        corners = tube_corners(int(r[3]), number, (q[3] & TUBE_HALF) != wp.uint32(0))
        p = load_words(triangles, corners[0])
        q = load_words(triangles, corners[1])
        r = load_words(triangles, corners[2])
    outline.p = seen_from(view.camera, vertex_of(p))
    outline.q = seen_from(view.camera, vertex_of(q))
    outline.r = seen_from(view.camera, vertex_of(r))
    outline.slack = SLACK_ROUNDOFFS * UNIT_ROUNDOFF * wp.max(
        wp.length(outline.p), wp.max(wp.length(outline.q), wp.length(outline.r)))
    return outline


@wp.func
def film_slopes(frame: FrameData) -> wp.vec2:
    """Return how far on the image plane neighbouring pixels lie from each other; metres if orthographic."""
    return wp.vec2(
        (frame.window[1] - frame.window[0]) / float(frame.width),
        (frame.window[3] - frame.window[2]) / float(frame.height))


@wp.func
def first_pixel(view: View) -> wp.vec2:
    """Return the film position [px] through which this frame's ray of pixel (0, 0) goes."""
    return wp.vec2(
        float(view.camera.crop_x) + 0.5 + view.jitter[0], float(view.camera.crop_y) + 0.5 + view.jitter[1])


@wp.func
def image_corner(view: View) -> wp.vec2:
    """Return the point on the image plane through which this frame's ray of pixel (0, 0) goes."""
    return wp.vec2(view.camera.window[0], view.camera.window[2]) + wp.cw_mul(
        film_slopes(view.camera), first_pixel(view))


@wp.func
def beside(side: wp.vec2, a: wp.vec3, b: wp.vec3, c: wp.vec3, slack: float) -> bool:
    """Return whether three points lie outside the plane side[0] x + side[1] depth = 0 through the eye."""
    reach = slack * (wp.abs(side[0]) + wp.abs(side[1]))
    nearest = wp.max(side[0] * a[0] - side[1] * a[2], wp.max(
        side[0] * b[0] - side[1] * b[2], side[0] * c[0] - side[1] * c[2]))
    return nearest < -reach


@wp.func
def turned(a: wp.vec3) -> wp.vec3:
    """Return a point with x and y exchanged."""
    return wp.vec3(a[1], a[0], a[2])


@wp.func
def off_screen(view: View, outline: Outline, width: int, height: int) -> bool:
    """Return whether a perspective camera sees nothing of a triangle between the planes through the picture's sides."""
    slope = film_slopes(view.camera)
    corner = image_corner(view)
    x0 = corner[0] - slope[0]
    x1 = corner[0] + slope[0] * float(width)
    y0 = corner[1] - slope[1]
    y1 = corner[1] + slope[1] * float(height)
    a = outline.p
    b = outline.q
    c = outline.r
    if beside(wp.vec2(1.0, -wp.min(x0, x1)), a, b, c, outline.slack):
        return True
    if beside(wp.vec2(-1.0, wp.max(x0, x1)), a, b, c, outline.slack):
        return True
    if beside(wp.vec2(1.0, -wp.min(y0, y1)), turned(a), turned(b), turned(c), outline.slack):
        return True
    return beside(wp.vec2(-1.0, wp.max(y0, y1)), turned(a), turned(b), turned(c), outline.slack)


@wp.func
def grown(box: wp.vec4, x: float, y: float) -> wp.vec4:
    """Return a box (low x, low y, high x, high y) with a point in it."""
    return wp.vec4(wp.min(box[0], x), wp.min(box[1], y), wp.max(box[2], x), wp.max(box[3], y))


@wp.func
def grown_by_part(box: wp.vec4, a: wp.vec3, b: wp.vec3, limit: float) -> wp.vec4:
    """Return a box with what is seen on the image plane of vertex `a` and of the edge to `b`, from depth `limit` on."""
    result = box
    if -a[2] >= limit:
        result = grown(result, -a[0] / a[2], -a[1] / a[2])
    if (-a[2] >= limit) != (-b[2] >= limit):
        share = (limit + a[2]) / (a[2] - b[2])
        result = grown(
            result, (a[0] + share * (b[0] - a[0])) / limit, (a[1] + share * (b[1] - a[1])) / limit)
    return result


@wp.func
def pixel_bounds(view: View, outline: Outline, width: int, height: int) -> Rectangle:
    """Return pixels of a picture outside of which no ray meets a triangle."""
    none = Rectangle()
    none.x1 = -1
    every = Rectangle()
    every.x1 = width - 1
    every.y1 = height - 1
    frame = view.camera
    a = outline.p
    b = outline.q
    c = outline.r
    nearest = -wp.max(a[2], wp.max(b[2], c[2]))
    farthest = -wp.min(a[2], wp.min(b[2], c[2]))
    # Comparisons are such that NaN and infinity are left out, too.
    if not (outline.slack < UNBOUNDED and farthest >= frame.clip_start - outline.slack):
        return none
    if nearest > frame.clip_end + outline.slack:
        return none
    slope = film_slopes(frame)
    box = wp.vec4(1.0e30, 1.0e30, -1.0e30, -1.0e30)
    error = outline.slack
    if frame.orthographic == 1:
        box = grown(grown(grown(box, a[0], a[1]), b[0], b[1]), c[0], c[1])
    else:
        if off_screen(view, outline, width, height):
            return none
        # What lies nearer than the rays begin does not count, unless that is closer than the vertices are exact.
        limit = frame.clip_start * 0.999
        if limit < 8.0 * outline.slack:
            limit = 8.0 * outline.slack
            if nearest < limit:
                return every
        box = grown_by_part(grown_by_part(grown_by_part(box, a, b, limit), b, c, limit), c, a, limit)
        steepest = wp.max(wp.max(wp.abs(box[0]), wp.abs(box[2])), wp.max(wp.abs(box[1]), wp.abs(box[3])))
        error = 2.0 * outline.slack * (1.0 + steepest) / wp.max(nearest, limit)
    corner = image_corner(view)
    x0 = (box[0] - corner[0]) / slope[0]
    x1 = (box[2] - corner[0]) / slope[0]
    y0 = (box[1] - corner[1]) / slope[1]
    y1 = (box[3] - corner[1]) / slope[1]
    margin_x = PIXEL_SLACK + wp.abs(error / slope[0])
    margin_y = PIXEL_SLACK + wp.abs(error / slope[1])
    bounds = Rectangle()
    # Clamped before they are whole numbers, which have less room.
    bounds.x0 = int(wp.ceil(wp.clamp(wp.min(x0, x1) - margin_x, 0.0, float(width))))
    bounds.y0 = int(wp.ceil(wp.clamp(wp.min(y0, y1) - margin_y, 0.0, float(height))))
    bounds.x1 = int(wp.floor(wp.clamp(wp.max(x0, x1) + margin_x, -1.0, float(width - 1))))
    bounds.y1 = int(wp.floor(wp.clamp(wp.max(y0, y1) + margin_y, -1.0, float(height - 1))))
    return bounds


@wp.func
def is_ahead(j: wp.vec3, k: wp.vec3) -> bool:
    """Return whether a vertex comes first in an order that all triangles share."""
    if j[0] != k[0]:
        return j[0] < k[0]
    if j[1] != k[1]:
        return j[1] < k[1]
    return j[2] < k[2]


@wp.func
def edge_function(view: View, j: wp.vec3, k: wp.vec3, opposite: wp.vec3) -> wp.vec4:
    """Return the weight of the vertex opposite to the edge from `j` to `k`; see Edges."""
    first = j
    second = k
    sign = float(1.0)
    if not is_ahead(j, k):
        first = k
        second = j
        sign = -1.0
    slope = film_slopes(view.camera)
    corner = image_corner(view)
    # A cross product with the other vertex, instead of the way to it, would err by its distance over the edge's length.
    way = second - first
    n = wp.cross(first, way)
    if view.camera.orthographic == 1:
        n = wp.vec3(-way[1], way[0], way[0] * first[1] - way[1] * first[0])
    return wp.vec4(
        sign * n[0] * slope[0], sign * n[1] * slope[1], sign * (n[0] * corner[0] + n[1] * corner[1] - n[2]),
        -opposite[2])


@wp.func
def edges_of(view: View, outline: Outline) -> Edges:
    """Return the weights of a triangle's vertices."""
    edges = Edges()
    edges.p = edge_function(view, outline.q, outline.r, outline.p)
    edges.q = edge_function(view, outline.r, outline.p, outline.q)
    edges.r = edge_function(view, outline.p, outline.q, outline.r)
    return edges


@wp.func
def value_at(edge: wp.vec4, x: float, y: float) -> float:
    """Return the weight in a pixel."""
    return edge[0] * x + (edge[1] * y + edge[2])


@wp.func
def depth_at(edges: Edges, x: int, y: int) -> float:
    """Return at which depth along the view axis [m] the ray of a pixel meets a triangle; -1 if it does not."""
    p = value_at(edges.p, float(x), float(y))
    q = value_at(edges.q, float(x), float(y))
    r = value_at(edges.r, float(x), float(y))
    total = p + q + r
    if wp.min(p, wp.min(q, r)) < 0.0 and wp.max(p, wp.max(q, r)) > 0.0:
        return -1.0
    if total == 0.0:
        return -1.0
    return (p * edges.p[3] + q * edges.q[3] + r * edges.r[3]) / total


@wp.func
def extremes(edge: wp.vec4, r: Rectangle) -> wp.vec2:
    """Return least and largest weight in a rectangle, widened by rounding."""
    ax = wp.vec2(edge[0] * float(r.x0), edge[0] * float(r.x1))
    by = wp.vec2(edge[1] * float(r.y0), edge[1] * float(r.y1))
    slack = PIXEL_SLACK * (wp.abs(edge[0]) + wp.abs(edge[1]))
    return wp.vec2(
        edge[2] + wp.min(ax[0], ax[1]) + wp.min(by[0], by[1]) - slack,
        edge[2] + wp.max(ax[0], ax[1]) + wp.max(by[0], by[1]) + slack)


@wp.func
def may_touch(edges: Edges, r: Rectangle) -> bool:
    """Return whether a triangle may be seen in a rectangle: its weights may all be positive, or all negative, there."""
    p = extremes(edges.p, r)
    q = extremes(edges.q, r)
    s = extremes(edges.r, r)
    if p[1] < 0.0 or q[1] < 0.0 or s[1] < 0.0:
        return not (p[0] > 0.0 or q[0] > 0.0 or s[0] > 0.0)
    return True


@wp.func
def covers_all(edges: Edges, r: Rectangle) -> bool:
    """Return whether a triangle is seen in all of a rectangle: its weights are all positive, or all negative, there."""
    p = extremes(edges.p, r)
    q = extremes(edges.q, r)
    s = extremes(edges.r, r)
    return (wp.min(p[0], wp.min(q[0], s[0])) > 0.0) or (wp.max(p[1], wp.max(q[1], s[1])) < 0.0)


@wp.func
def intersection(a: Rectangle, b: Rectangle) -> Rectangle:
    """Return what two rectangles share."""
    r = Rectangle()
    r.x0 = wp.max(a.x0, b.x0)
    r.y0 = wp.max(a.y0, b.y0)
    r.x1 = wp.min(a.x1, b.x1)
    r.y1 = wp.min(a.y1, b.y1)
    return r
