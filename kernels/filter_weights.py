# SPDX-License-Identifier: GPL-3.0-or-later
"""Edge-stopping weights of the screen-space filters: how far a pixel lies off another's plane, and how normals differ.

The distance from a pixel's plane needs no positions: along the film a plane's points are linear in pixels, so a tap
costs its depth and a few multiplications.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .packing import unpack_normal
from .view import SKY_DEPTH, View, film_position, pixel_footprint

# Luminance (Rec. 709) for statistics and weights only, never for colours; the working space need not be known here.
WEIGHTS = wp.constant(wp.vec3(0.2126, 0.7152, 0.0722))


@wp.struct
class PixelPlane:
    """The tangent plane of a pixel's surface, in terms of pixels and depths."""

    depth: float
    slope: float
    """Perspective: n . (ray to the pixel, one unit deep)"""
    step_x: float
    """Change of n . (ray or point on the film) for one pixel to the right"""
    step_y: float
    along: float
    """Orthographic: n . (view axis), away from the camera"""
    orthographic: int
    tolerance: float
    """1 / width of the pixel [1/m]"""


@wp.func
def brightness(color: wp.vec3) -> float:
    """Return the luminance that weights and statistics go by."""
    return wp.dot(color, WEIGHTS)


@wp.func
def pixel_plane(view: View, gbuffer: GBuffer, width: int, pixel: int) -> PixelPlane:
    """Return the tangent plane of a pixel that shows a surface (of the world only `depth` is valid)."""
    frame = view.camera
    p = PixelPlane()
    p.depth = gbuffer.depth[pixel]
    n = unpack_normal(gbuffer.geometric_normal[pixel])
    m = frame.camera_to_world
    # The plane in camera space: the transpose, not the inverse, as planes are covectors.
    a = wp.vec3(
        n[0] * m[0, 0] + n[1] * m[1, 0] + n[2] * m[2, 0], n[0] * m[0, 1] + n[1] * m[1, 1] + n[2] * m[2, 1],
        n[0] * m[0, 2] + n[1] * m[1, 2] + n[2] * m[2, 2])
    film = film_position(view, pixel % width, pixel // width)
    x = wp.lerp(frame.window[0], frame.window[1], film[0] / float(frame.width))
    y = wp.lerp(frame.window[2], frame.window[3], film[1] / float(frame.height))
    p.slope = a[0] * x + a[1] * y - a[2]
    p.step_x = a[0] * (frame.window[1] - frame.window[0]) / float(frame.width)
    p.step_y = a[1] * (frame.window[3] - frame.window[2]) / float(frame.height)
    p.along = -a[2]
    p.orthographic = frame.orthographic
    p.tolerance = 1.0 / wp.max(pixel_footprint(frame, p.depth), 1.0e-20)
    return p


@wp.func
def plane_offset(plane: PixelPlane, dx: int, dy: int, depth: float) -> float:
    """Return how far the surface of the pixel (dx, dy) away lies off the plane, in widths of a pixel."""
    step = float(dx) * plane.step_x + float(dy) * plane.step_y
    offset = depth * (plane.slope + step) - plane.depth * plane.slope
    if plane.orthographic == 1:
        offset = step + plane.along * (depth - plane.depth)
    return wp.abs(offset) * plane.tolerance


@wp.func
def plane_weight(plane: PixelPlane, dx: int, dy: int, depth: float) -> float:
    """Return 1 for a pixel in the plane, falling to 0 for one that lies a pixel's width off it.

    No wider for taps further away: curved surfaces are flat enough, and a step of a few pixels is an edge. The world
    only goes with the world.
    """
    if depth >= SKY_DEPTH:
        return wp.where(plane.depth >= SKY_DEPTH, 1.0, 0.0)
    if plane.depth >= SKY_DEPTH:
        return 0.0
    near = wp.max(1.0 - plane_offset(plane, dx, dy, depth), 0.0)
    return near * near


@wp.func
def power_32(x: float) -> float:
    """Return x^32, 0 for negative x."""
    a = wp.max(x, 0.0)
    a = a * a
    a = a * a
    a = a * a
    a = a * a
    return a * a


@wp.func
def smooth_normal_weight(cosine: float) -> float:
    """Return the weight of a normal for smooth light: 1 for the same, exactly 0 from 60 degrees on."""
    a = wp.max(cosine * 2.0 - 1.0, 0.0)
    a = a * a
    a = a * a
    return a * a
