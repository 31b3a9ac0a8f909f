# SPDX-License-Identifier: GPL-3.0-or-later
"""Edge-stopping weights of the screen-space filters: how far a pixel lies off another's plane, and how normals differ.

The distance from a pixel's plane needs no positions: along the film a plane's points are linear in pixels, so a tap
costs its depth and a few multiplications.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .packing import BITS_OF_2_23
from .view import SKY_DEPTH, View, film_position, pixel_footprint

# Luminance (Rec. 709) for statistics and weights only, never for colours; the working space need not be known here.
WEIGHTS = wp.constant(wp.vec3(0.2126, 0.7152, 0.0722))

# Difference of roughness at which specular light is no longer shared: a share of the greater one, and in units of
# GBuffer.material (a twentieth).
ROUGHNESS_SHARE = wp.constant(0.5)
ROUGHNESS_SLACK = wp.constant(3277.0)


@wp.struct
class PixelPlane:
    """The tangent plane of a pixel's surface, in terms of pixels and depths; distances in widths of the pixel."""

    depth: float
    """Of the pixel [m]"""
    slope: float
    """Distance for each metre of depth"""
    step_x: float
    """Perspective: change of `slope` for one pixel to the right; orthographic: of the distance"""
    step_y: float
    start: float
    """Distance where `slope` and steps would give none"""
    perspective: float
    """1; 0: orthographic"""


@wp.func
def brightness(color: wp.vec3) -> float:
    """Return the luminance that weights and statistics go by."""
    return wp.dot(color, WEIGHTS)


@wp.func_native("""
#ifdef __CUDA_ARCH__
    return rsqrtf(x);
#else
    return 1.0f / sqrtf(x);
#endif
""")
def inverse_root(x: float) -> float:
    """Return 1 / sqrt(x): one instruction on a GPU."""
    ...


@wp.func
def normal_direction(packed: wp.uint32) -> wp.vec3:
    """Return a packed normal without making it a unit vector, in a few steps and without a branch."""
    # As packing.whole_float, less 2^15.
    x = wp.cast((packed & wp.uint32(65535)) | BITS_OF_2_23, float) - 8421376.0
    y = wp.cast((packed >> wp.uint32(16)) | BITS_OF_2_23, float) - 8421376.0
    z = 32767.0 - wp.abs(x) - wp.abs(y)
    fold = wp.max(-z, 0.0)
    return wp.vec3(x - wp.where(x < 0.0, -fold, fold), y - wp.where(y < 0.0, -fold, fold), z)


@wp.func
def unit_normal(packed: wp.uint32) -> wp.vec3:
    """Return the same as unpack_normal."""
    n = normal_direction(packed)
    return n * inverse_root(wp.dot(n, n))


@wp.func
def pixel_plane(view: View, gbuffer: GBuffer, width: int, pixel: int) -> PixelPlane:
    """Return the tangent plane of a pixel that shows a surface (of the world only `depth` is valid)."""
    frame = view.camera
    p = PixelPlane()
    p.depth = gbuffer.depth[pixel]
    tolerance = 1.0 / wp.max(pixel_footprint(frame, p.depth), 1.0e-20)
    n = unit_normal(gbuffer.geometric_normal[pixel]) * tolerance
    m = frame.camera_to_world
    # The plane in camera space: the transpose, not the inverse, as planes are covectors.
    a = wp.vec3(
        n[0] * m[0, 0] + n[1] * m[1, 0] + n[2] * m[2, 0], n[0] * m[0, 1] + n[1] * m[1, 1] + n[2] * m[2, 1],
        n[0] * m[0, 2] + n[1] * m[1, 2] + n[2] * m[2, 2])
    film = film_position(view, pixel % width, pixel // width)
    step_x = (frame.window[1] - frame.window[0]) / float(frame.width)
    step_y = (frame.window[3] - frame.window[2]) / float(frame.height)
    p.step_x = a[0] * step_x
    p.step_y = a[1] * step_y
    p.slope = -a[2]
    p.perspective = 0.0
    if frame.orthographic == 0:
        p.slope = (
            a[0] * (frame.window[0] + film[0] * step_x) + a[1] * (frame.window[2] + film[1] * step_y) - a[2])
        p.perspective = 1.0
    p.start = -p.depth * p.slope
    return p


@wp.func
def plane_offset(plane: PixelPlane, dx: int, dy: int, depth: float) -> float:
    """Return how far the surface of the pixel (dx, dy) away lies off the plane, in widths of a pixel."""
    step = float(dx) * plane.step_x + float(dy) * plane.step_y
    # Along the film a step counts the more the deeper; without perspective as it is.
    return wp.abs(depth * (plane.slope + plane.perspective * step) + (step - plane.perspective * step) + plane.start)


@wp.func
def surface_weight(plane: PixelPlane, dx: int, dy: int, depth: float) -> float:
    """Return 1 for a pixel in a surface's plane, falling to 0 for one a pixel's width off it or without a surface.

    No wider for taps further away: curved surfaces are flat enough, and a step of a few pixels is an edge.
    """
    near = wp.max(1.0 - plane_offset(plane, dx, dy, depth), 0.0)
    return wp.where(depth < SKY_DEPTH, near * near, 0.0)


@wp.func
def squared_cosine(normal: wp.vec3, packed: wp.uint32) -> float:
    """Return the squared cosine between a unit vector and a packed normal, 0 where they are 90 degrees apart or more.

    Needs no square root: the length of the second is divided out.
    """
    other = normal_direction(packed)
    cosine = wp.max(wp.dot(normal, other), 0.0)
    return wp.min(cosine * cosine / wp.dot(other, other), 1.0)


@wp.func
def sharp_normal_weight(square: float) -> float:
    """Return the weight of a normal for direct light: cosine^32, of the squared cosine."""
    a = square * square
    a = a * a
    a = a * a
    return a * a


@wp.func
def smooth_normal_weight(square: float) -> float:
    """Return the weight of a normal for smooth light by the squared cosine: 1 for the same, 0 from 60 degrees on."""
    a = wp.max(square * (4.0 / 3.0) - 1.0 / 3.0, 0.0)
    a = a * a
    return a * a * a


@wp.func
def roughness_weight(a: wp.uint32, b: wp.uint32) -> float:
    """Return the weight of a neighbour for specular light by both pixels' GBuffer.material: 1 for the same roughness.

    0 from a difference of half of the greater one on: a lamp's highlight on a board says nothing of the mirror in it.
    """
    x = float(a & wp.uint32(65535))
    y = float(b & wp.uint32(65535))
    return wp.max(1.0 - wp.abs(x - y) / (ROUGHNESS_SHARE * wp.max(x, y) + ROUGHNESS_SLACK), 0.0)


@wp.func
def inside(x: int, y: int, width: int, height: int) -> bool:
    """Return whether a pixel is in the picture."""
    return x >= 0 and y >= 0 and x < width and y < height
