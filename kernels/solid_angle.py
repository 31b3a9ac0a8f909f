# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles and rectangles as a receiver sees them, and directions drawn uniformly over their solid angle.

Points drawn uniformly over the area of a light that is near or seen edge-on bring anything between nothing and far too
much: the density of their directions varies with the squared distance and the cosine. Uniform directions (Arvo,
"Stratified Sampling of Spherical Triangles", 1995) bring what the receiver makes of them alone. The solid angle is that
of Van Oosterom and Strackee ("The Solid Angle of a Plane Triangle", 1983); a part of it is cut off by half vectors, as
Peters does ("BRDF Importance Sampling for Polygonal Lights", 2021, supplement), for which no angle between planes has
to be known.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import safe_sqrt

# A light is sampled by solid angle where its longest edge is over so many times the distance to its plane: further away
# its area does as well, for less time.
CLOSE = wp.constant(4.0)

# Solid angles [sr] out of this range are left to area: of small ones rounding leaves too little, and of a receiver
# about in the plane of the light nothing.
SOLID_ANGLE_MIN = wp.constant(2.0e-3)
SOLID_ANGLE_MAX = wp.constant(6.0)


@wp.struct
class SphericalTriangle:
    """A triangle on the unit sphere about the receiver."""

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    """Unit vectors to the corners"""
    volume: float
    """|det(a, b, c)|"""
    opposite: float
    """1 + a.b"""
    beside: float
    """(a + b).c; tan(solid angle / 2) = volume / (opposite + beside)"""


@wp.func
def spherical_triangle(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> SphericalTriangle:
    """Return what a receiver sees of a triangle whose corners are given relative to it."""
    t = SphericalTriangle()
    t.a = wp.normalize(a)
    t.b = wp.normalize(b)
    t.c = wp.normalize(c)
    t.volume = wp.abs(wp.dot(t.a, wp.cross(t.b, t.c)))
    t.opposite = 1.0 + wp.dot(t.a, t.b)
    t.beside = wp.dot(t.a + t.b, t.c)
    return t


@wp.func
def solid_angle(t: SphericalTriangle) -> float:
    """Return the solid angle of a triangle [sr]."""
    return 2.0 * wp.atan2(t.volume, t.opposite + t.beside)


@wp.func
def is_close(to_light: wp.vec3, first: wp.vec3, second: wp.vec3) -> bool:
    """Return whether a light is large for its distance: a point of it relative to the receiver, two of its edges."""
    normal = wp.cross(first, second)
    height = wp.dot(normal, to_light)
    longest = wp.max(wp.max(wp.length_sq(first), wp.length_sq(second)), wp.length_sq(second - first))
    return longest * wp.length_sq(normal) > CLOSE * CLOSE * height * height


@wp.func
def sampled_angle(angle: float) -> float:
    """Return the solid angle that a light is sampled by, 0 where its area is better."""
    return wp.where(angle >= SOLID_ANGLE_MIN and angle <= SOLID_ANGLE_MAX, angle, 0.0)


@wp.func
def angle_of_triangle(to_light: wp.vec3, first: wp.vec3, second: wp.vec3) -> float:
    """Return the solid angle that a triangle is sampled by, 0: by its area; arguments are those of is_close."""
    if not is_close(to_light, first, second):
        return 0.0
    return sampled_angle(solid_angle(spherical_triangle(to_light, to_light + first, to_light + second)))


@wp.func
def sample_spherical_triangle(t: SphericalTriangle, angle: float, u: wp.vec2) -> wp.vec3:
    """Return a direction uniform over a triangle's solid angle.

    The first number cuts off a part (a, b, d) of the solid angle by a point d between a and c. With d = 2 h (a.h) / h.h
    - a for a half vector h = x a + y c, tan(part / 2) = y volume / (x opposite + y beside). The second places the
    direction between b and d, uniform in the cosine from b.
    """
    half = 0.5 * u[0] * angle
    sine = wp.sin(half)
    h = t.a * (t.volume * wp.cos(half) - t.beside * sine) + t.c * (t.opposite * sine)
    d = h * (2.0 * wp.dot(t.a, h) / wp.max(wp.dot(h, h), 1.0e-30)) - t.a
    # One minus the cosine of the whole way from b to d and of the part of it, without cancellation.
    whole = 0.5 * wp.length_sq(d - t.b)
    part = u[1] * whole
    share = safe_sqrt(u[1] * (2.0 - part) / wp.max(2.0 - whole, 1.0e-6))
    return t.b * (1.0 - part - share * (1.0 - whole)) + d * share


@wp.func
def weights_along(a: wp.vec3, b: wp.vec3, c: wp.vec3, direction: wp.vec3) -> wp.vec2:
    """Return where a direction meets a triangle: weights of b and c; corners are relative to the receiver."""
    x = wp.dot(direction, wp.cross(b, c))
    y = wp.dot(direction, wp.cross(c, a))
    z = wp.dot(direction, wp.cross(a, b))
    total = x + y + z
    if total == 0.0:
        return wp.vec2(0.0, 0.0)
    v = wp.clamp(y / total, 0.0, 1.0)
    return wp.vec2(v, wp.clamp(z / total, 0.0, 1.0 - v))


@wp.func
def sample_seen_triangle(a: wp.vec3, b: wp.vec3, c: wp.vec3, t: SphericalTriangle, angle: float, u: wp.vec2) -> wp.vec2:
    """Return the weights of b and c of a point of a triangle whose direction is uniform over its solid angle."""
    return weights_along(a, b, c, sample_spherical_triangle(t, angle, u))


@wp.struct
class SphericalRectangle:
    """A rectangle on the unit sphere about the receiver: two triangles that share the diagonal from a to c."""

    first: SphericalTriangle
    """a, b, c"""
    second: SphericalTriangle
    """c, d, a"""
    first_angle: float
    angle: float
    """Of both [sr]"""


@wp.func
def spherical_rectangle(centre: wp.vec3, across: wp.vec3, along: wp.vec3) -> SphericalRectangle:
    """Return what a receiver sees of a rectangle: its centre relative to the receiver, its edges."""
    r = SphericalRectangle()
    a = centre - (across + along) * 0.5
    c = centre + (across + along) * 0.5
    r.first = spherical_triangle(a, a + across, c)
    r.second = spherical_triangle(c, a + along, a)
    r.first_angle = solid_angle(r.first)
    r.angle = r.first_angle + solid_angle(r.second)
    return r


@wp.func
def sample_spherical_rectangle(r: SphericalRectangle, u: wp.vec2) -> wp.vec3:
    """Return a direction uniform over a rectangle's solid angle; not of unit length to the last bit."""
    cut = u[0] * r.angle
    if cut < r.first_angle:
        return sample_spherical_triangle(r.first, r.first_angle, wp.vec2(cut / r.first_angle, u[1]))
    rest = r.angle - r.first_angle
    return sample_spherical_triangle(
        r.second, rest, wp.vec2(wp.min((cut - r.first_angle) / wp.max(rest, 1.0e-20), 1.0), u[1]))
