# SPDX-License-Identifier: GPL-3.0-or-later
"""Where surfaces were in the frame before: transforms of instances and positions of vertices from then."""

from __future__ import annotations

import warp as wp

from .geometry_math import normalize_or, transform_point
from .types import Geometry


@wp.struct
class Motion:
    """What engine/motion.py remembers of the frame before, indexed as this frame's Geometry is."""

    moved: wp.array[int]
    """One element; 0: no object has moved or deformed since the frame before, and the other arrays are not valid"""
    previous_to_world: wp.array[wp.mat44]
    """Per instance; that of now for instances that are new"""
    previous_positions: wp.array[wp.vec3]
    """As Geometry.positions"""


@wp.struct
class PreviousPoint:
    """A surface point in the frame before."""

    displacement: wp.vec3
    """Its position then minus its position now [m]"""
    normal: wp.vec3
    """Geometric then, unit, by the order of the vertices"""
    now_normal: wp.vec3
    """The same now"""
    moved: int
    """1: the triangle is not where it was"""


@wp.func
def same_point(a: wp.vec3, b: wp.vec3) -> bool:
    """Return whether two points are equal, bit for bit."""
    return a[0] == b[0] and a[1] == b[1] and a[2] == b[2]


@wp.func
def previous_point(geometry: Geometry, motion: Motion, instance: int, triangle: int, uv: wp.vec2) -> PreviousPoint:
    """Return where a point of a triangle was.

    Args:
        geometry: Of this frame.
        motion: With `moved` set.
        instance: Of this frame.
        triangle: Index into Geometry.triangles.
        uv: Weights of the second and third vertex.
    """
    v = geometry.triangles[triangle]
    old = motion.previous_to_world[instance]
    now = geometry.instances[instance].to_world
    p0 = transform_point(old, motion.previous_positions[v[0]])
    p1 = transform_point(old, motion.previous_positions[v[1]])
    p2 = transform_point(old, motion.previous_positions[v[2]])
    q0 = transform_point(now, geometry.positions[v[0]])
    q1 = transform_point(now, geometry.positions[v[1]])
    q2 = transform_point(now, geometry.positions[v[2]])
    w = 1.0 - uv[0] - uv[1]
    up = wp.vec3(0.0, 0.0, 1.0)
    result = PreviousPoint()
    # Differences of vertices: the rounding of the weights cancels.
    result.displacement = (p0 - q0) * w + (p1 - q1) * uv[0] + (p2 - q2) * uv[1]
    result.normal = normalize_or(wp.cross(p1 - p0, p2 - p0), up)
    result.now_normal = normalize_or(wp.cross(q1 - q0, q2 - q0), up)
    result.moved = 1
    # The same expression of the same numbers: equal where nothing moved.
    if same_point(p0, q0) and same_point(p1, q1) and same_point(p2, q2):
        result.moved = 0
    return result
