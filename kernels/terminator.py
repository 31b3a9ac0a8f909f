# SPDX-License-Identifier: GPL-3.0-or-later
"""The shadow terminator of smooth-shaded triangles: shadow rays that graze start on the surface that the normals imply.

Cycles does so by default (Object > Shading > Shadow Terminator Geometry Offset, 0.1); without it coarse meshes
differ from its pictures along the terminator. The implied surface is a quadratic patch over the triangle, bounded
by the envelope of the vertices' tangent planes.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import normalize_or, transform_normal, transform_point
from .types import Geometry, ShadingPoint
from .wide_loads import load_corner, load_instance, load_normal

# Cosine to the light below which a ray starts on the implied surface (Cycles' default of the object's setting).
GRAZING_COSINE = wp.constant(0.1)

# Cosine between smooth and triangle's normal above which they are the same.
FLAT_COSINE = wp.constant(0.999999)


@wp.func
def tangent_height(apex: wp.vec3, first: wp.vec3, second: wp.vec3, normal: wp.vec3, p: wp.vec3) -> float:
    """Return how far below the higher envelope of the tangent plane at `apex` the point p lies."""
    rise = wp.max(wp.max(wp.dot(first - apex, normal), wp.dot(second - apex, normal)), 0.0)
    return wp.max(wp.dot(apex - p, normal) + rise, 0.0)


@wp.func
def patch_height(
    p: wp.vec3, v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, n0: wp.vec3, n1: wp.vec3, n2: wp.vec3, b0: float, b1: float,
) -> float:
    """Return the height of the implied surface over the point p with weights b0, b1 of the first two vertices."""
    a = wp.dot(n2 - n0, v0 - v2)
    b = wp.dot(n2 - n1, v1 - v2)
    c = wp.dot(n1 - n0, v1 - v0)
    parabola = a * b0 * (b0 - 1.0) + (a + b + c) * b0 * b1 + b * b1 * (b1 - 1.0)
    envelope = wp.min(
        wp.min(tangent_height(v0, v1, v2, n0, p), tangent_height(v1, v0, v2, n1, p)),
        tangent_height(v2, v0, v1, n2, p))
    return wp.max(envelope, 0.5 * parabola)


@wp.func
def smooth_surface_offset(geometry: Geometry, point: ShadingPoint, side: wp.vec3, wi: wp.vec3) -> wp.vec3:
    """Return by how much to move the start of a shadow ray towards `wi`; zero for flat triangles and steep light.

    Args:
        geometry: The scene's.
        point: Where the ray starts.
        side: The triangle's unit normal on the side on which the smooth normal has the light.
        wi: Unit direction to the light.
    """
    zero = wp.vec3(0.0, 0.0, 0.0)
    m0 = load_normal(geometry, point.triangle, 0)
    m1 = load_normal(geometry, point.triangle, 1)
    m2 = load_normal(geometry, point.triangle, 2)
    flat = wp.abs(wp.dot(point.normal, point.geometric_normal)) > FLAT_COSINE
    if flat and wp.length_sq(m1 - m0) + wp.length_sq(m2 - m0) < 1.0e-12:
        return zero
    cosine = wp.abs(wp.dot(point.normal, wi))
    geometric_cosine = wp.dot(side, wi)
    amount = 1.0 - geometric_cosine / GRAZING_COSINE
    if cosine < GRAZING_COSINE:
        amount = 2.0 - (geometric_cosine + cosine) / GRAZING_COSINE
    amount = wp.clamp(amount, 0.0, 1.0)
    if amount <= 0.0:
        return zero
    instance = load_instance(geometry.instances, point.instance)
    v0 = transform_point(instance.to_world, load_corner(geometry, point.triangle, 0))
    v1 = transform_point(instance.to_world, load_corner(geometry, point.triangle, 1))
    v2 = transform_point(instance.to_world, load_corner(geometry, point.triangle, 2))
    b0 = 1.0 - point.u - point.v
    n0 = normalize_or(transform_normal(instance.to_object, m0), point.normal)
    n1 = normalize_or(transform_normal(instance.to_object, m1), point.normal)
    n2 = normalize_or(transform_normal(instance.to_object, m2), point.normal)
    # Seen from the other side the surface is the same with all normals turned round; so is one whose normals face
    # away from its triangle.
    outward = wp.where(wp.dot(n0 * b0 + n1 * point.u + n2 * point.v, side) > 0.0, 1.0, -1.0)
    n0 = n0 * outward
    n1 = n1 * outward
    n2 = n2 * outward
    height = patch_height(point.position, v0, v1, v2, n0, n1, n2, b0, point.u)
    return (n0 * b0 + n1 * point.u + n2 * point.v) * (height * amount)


@wp.func
def lit_side(point: ShadingPoint, wi: wp.vec3) -> wp.vec3:
    """Return the triangle's unit normal on the side on which the smooth normal has the light from `wi`."""
    return wp.where(wp.dot(point.normal, wi) < 0.0, -point.geometric_normal, point.geometric_normal)


@wp.func
def shadow_origin(geometry: Geometry, point: ShadingPoint, wi: wp.vec3) -> wp.vec3:
    """Return where a shadow ray towards `wi` starts: off the surface by the hit's error, to the lit side.

    As in Cycles (shadow_ray_offset): light that comes from behind the triangle, though the smooth normal faces it,
    meets the triangle unless the surface that the normals imply lies beyond. Where normals face away from their
    triangles, as in many converted scenes, it would come through walls otherwise.
    """
    side = lit_side(point, wi)
    return point.position + smooth_surface_offset(geometry, point, side, wi) + side * point.error
