# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a ray leaves a strand that it has been scattered by: the model has light come in and go out as one event.

So a ray into the strand starts past the wall that it would meet from within. Walls of other strands count from both
sides, as in Cycles, whose rays pass over the curve that they leave and no other.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import orthonormal_tangent, transform_direction, transform_point
from .hair_lobes import APOTHEM
from .intersect import any_hit, offset_origin
from .types import Geometry, Scene, ShadingPoint
from .wide_loads import load_corner, load_instance, load_normal

LONGEST = wp.constant(30.0)
"""How many radii far at most"""
MARGIN = wp.constant(0.03)
"""Of the radius, that walls may lie off the straight piece's: rays that graze them are long within"""
BEND = wp.constant(0.3)
"""The same of the next pieces' walls"""


@wp.func
def way_out(q: wp.vec2, d: wp.vec2, face: wp.vec2, radius: float, growth: float) -> float:
    """Return how many times a ray's direction it takes to the walls of a hexagonal pyramid, 0 outside of it.

    Args:
        q: From the axis to where the ray starts, across the axis.
        d: Direction of the ray, across the axis.
        face: Unit normal of a wall, across the axis.
        radius: From the axis to the corners where the ray starts.
        growth: By which that grows along the direction.
    """
    furthest = float(1.0e30)
    for k in range(6):
        angle = float(k) * 1.0471975512
        c = wp.cos(angle)
        s = wp.sin(angle)
        n = wp.vec2(face[0] * c - face[1] * s, face[0] * s + face[1] * c)
        speed = wp.dot(n, d) - APOTHEM * growth
        if speed > 0.0:
            furthest = wp.min(furthest, wp.max(APOTHEM * radius - wp.dot(n, q), 0.0) / speed)
    return furthest


@wp.struct
class Piece:
    """The piece of a strand that a triangle of its tube belongs to, in object space."""

    center: wp.vec3
    """Of the ring on which the triangle has two corners"""
    way: wp.vec3
    """From there to the other ring's"""
    radius: float
    """From a ring's center to its corners"""
    other_radius: float


@wp.func
def piece_of(geometry: Geometry, triangle: int) -> Piece:
    """Return a triangle's piece.

    Tubes have two triangles between neighbouring corners of two rings (hair.make_tubes): the first has two corners on
    its first ring, the second on the next, and a hexagon's side is its radius. Where one lacks the ring is a point.
    """
    p0 = load_corner(geometry, triangle, 0)
    p1 = load_corner(geometry, triangle, 1)
    p2 = load_corner(geometry, triangle, 2)
    n0 = load_normal(geometry, triangle, 0)
    n1 = load_normal(geometry, triangle, 1)
    n2 = load_normal(geometry, triangle, 2)
    # Corners on a line along the strand have the same normal.
    first = wp.dot(n1, n2) > wp.dot(n0, n2)
    twin = wp.where(first, triangle + 1, triangle - 1)
    piece = Piece()
    piece.other_radius = 0.0
    if twin >= 0 and 6 * twin + 5 < geometry.corners.shape[0]:
        q0 = load_corner(geometry, twin, 0)
        q1 = load_corner(geometry, twin, 1)
        q2 = load_corner(geometry, twin, 2)
        if first and wp.length_sq(q0 - p0) + wp.length_sq(q1 - p2) == 0.0:
            piece.other_radius = wp.length(q2 - q1)
        if not first and wp.length_sq(q0 - p0) + wp.length_sq(q2 - p1) == 0.0:
            piece.other_radius = wp.length(q1 - q0)
    if first:
        piece.radius = wp.length(p1 - p0)
        piece.center = p1 - n1 * piece.radius
        piece.way = p2 - n2 * piece.other_radius - piece.center
    else:
        piece.radius = wp.length(p2 - p1)
        piece.center = p2 - n2 * piece.radius
        piece.way = p0 - n0 * piece.other_radius - piece.center
    return piece


@wp.func
def leaving_point(scene: Scene, point: ShadingPoint, wi: wp.vec3) -> wp.vec3:
    """Return where a ray towards `wi` starts that a strand's tube has scattered at a point.

    Past the tube's far wall, if nothing else is met within: else at the point, as what is met comes first.
    """
    start = offset_origin(point.position, point.geometric_normal, point.error, wi)
    # The geometric normal is on the viewer's side.
    inwards = wp.dot(point.geometric_normal, wi) < 0.0
    if point.backfacing == 1:
        inwards = not inwards
    if not inwards:
        return start
    instance = load_instance(scene.geometry.instances, point.instance)
    piece = piece_of(scene.geometry, point.triangle)
    length = wp.length(piece.way)
    axis = piece.way / wp.max(length, 1.0e-30)
    slope = (piece.other_radius - piece.radius) / wp.max(length, 1.0e-30)
    place = transform_point(instance.to_object, start) - piece.center
    direction = transform_direction(instance.to_object, wi)
    radius = wp.max(piece.radius + slope * wp.dot(axis, place), 0.0)
    x = orthonormal_tangent(axis)
    y = wp.cross(axis, x)
    p0 = load_corner(scene.geometry, point.triangle, 0)
    face = wp.cross(load_corner(scene.geometry, point.triangle, 1) - p0, load_corner(
        scene.geometry, point.triangle, 2) - p0)
    q = wp.vec2(wp.dot(x, place), wp.dot(y, place))
    d = wp.vec2(wp.dot(x, direction), wp.dot(y, direction))
    n = wp.normalize(wp.vec2(wp.dot(x, face), wp.dot(y, face)))
    growth = slope * wp.dot(axis, direction)
    speed = wp.length(direction)
    # How far along the ray the piece ends.
    rise = wp.dot(axis, direction)
    within = wp.where(rise > 0.0, length - wp.dot(axis, place), wp.dot(axis, place)) / wp.max(
        wp.abs(rise), 1.0e-6 * speed)
    furthest = LONGEST * radius / wp.max(speed, 1.0e-20)
    before = wp.min(wp.min(way_out(q, d, n, (1.0 - MARGIN) * radius, growth), furthest), within)
    if before > 0.0 and any_hit(scene.geometry, start, wi, before):
        return start
    t = way_out(q, d, n, (1.0 + MARGIN) * radius, growth)
    if t > within:
        t = way_out(q, d, n, (1.0 + BEND) * radius, growth)
    return start + wi * (wp.min(t, furthest) + point.error)
