# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's normals: normal maps, bump mapping, transforms between object and world space.

Formulas follow Cycles 5.2: kernel/svm/tex_coord.h (normal map), displace.h (bump), vector_transform.h.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import normalize_or, transform_direction, transform_normal, transform_point
from .node_input import bump_axis, object_normal, uv_tangent
from .types import Instance, Scene, ShadingPoint
from .wide_loads import load_instance


@wp.func
def tangent_space_normal(
    scene: Scene, point: ShadingPoint, instance: Instance, color: wp.vec3, strength: float, uv_map: int, attribute: int
) -> wp.vec3:
    """Return the object-space normal of a tangent-space map, 0 where the mesh has no such UV map."""
    tangent4 = uv_tangent(scene, point, instance, uv_map, attribute)
    if tangent4[3] == 0.0:
        return wp.vec3(0.0)
    normal = object_normal(scene, point)
    tangent = wp.vec3(tangent4[0], tangent4[1], tangent4[2])
    bitangent = wp.cross(normal, tangent) * tangent4[3]
    t = wp.clamp(strength, 0.0, 1.0)
    return tangent * (color[0] * strength) + bitangent * (color[1] * strength) + normal * (1.0 + (color[2] - 1.0) * t)


@wp.func
def normal_map(
    scene: Scene, point: ShadingPoint, sub: int, texel: wp.vec3, strength: float, uv_map: int, attribute: int
) -> wp.vec3:
    """Return the world-space normal that a texel of a normal map stands for, on the viewer's side.

    Args:
        scene: The scene.
        point: The shading point.
        sub: Space in bits 0-1, then codes.NORMAL_* flags.
        texel: Colour of the map, 0..1.
        strength: Strength of the node.
        uv_map: UV map of the tangent space or -1.
        attribute: Tangent attribute or -1.
    """
    if point.instance < 0:
        return point.normal
    instance = load_instance(scene.geometry.instances, point.instance)
    c = texel * 2.0 - wp.vec3(1.0)
    if (sub & codes.NORMAL_INVERT_GREEN) != 0:
        c = wp.vec3(c[0], -c[1], c[2])
    if (sub & codes.NORMAL_BLENDER_AXES) != 0:
        c = wp.vec3(c[0], -c[1], -c[2])
    space = sub & 3
    n = c
    if space == codes.NORMAL_TANGENT:
        n = tangent_space_normal(scene, point, instance, c, strength, uv_map, attribute)
    if space != codes.NORMAL_WORLD:
        n = transform_normal(instance.to_object, n)
    n = normalize_or(n, wp.vec3(0.0))
    if point.backfacing != 0:
        n = -n
    if wp.length_sq(n) == 0.0:
        return point.normal
    if space != codes.NORMAL_TANGENT and strength != 1.0:
        n = normalize_or(point.normal + (n - point.normal) * wp.max(strength, 0.0), point.normal)
    return n


@wp.func
def bump(point: ShadingPoint, heights: wp.vec3, params: wp.vec3, normal_in: wp.vec3) -> wp.vec3:
    """Return the normal of a surface raised by a height known here and at two offset points (Mikkelsen 2010).

    Args:
        point: The shading point.
        heights: Height here, shifted along x and along y by params.z footprints.
        params: Strength, distance (negative: inverted) and filter width.
        normal_in: Normal to perturb; 0 stands for the shading normal.
    """
    normal = normalize_or(normal_in, point.normal)
    # A footprint of 0 (a ray without width) has no derivative; the heights agree, so any scale will do.
    footprint = wp.max(point.footprint, 1.0e-12)
    dx = bump_axis(point.geometric_normal, False) * footprint
    dy = bump_axis(point.geometric_normal, True) * footprint
    rx = wp.cross(dy, normal)
    ry = wp.cross(normal, dx)
    det = wp.dot(dx, rx)
    gradient = rx * (heights[1] - heights[0]) + ry * (heights[2] - heights[0])
    sign = wp.where(det < 0.0, -1.0, 1.0)
    # Scaled by 1 / footprint^2, so that tiny footprints don't underflow.
    scale = 1.0 / (footprint * footprint)
    raised = normal * (params[2] * wp.abs(det) * scale) - gradient * (params[1] * sign * scale)
    bumped = normalize_or(raised, normal)
    strength = wp.max(params[0], 0.0)
    return normalize_or(bumped * strength + normal * (1.0 - strength), normal)


@wp.func
def change_space(scene: Scene, point: ShadingPoint, sub: int, v: wp.vec3) -> wp.vec3:
    """Move a point, direction or normal between object and world space (codes.SPACE_*)."""
    if point.instance < 0:
        return v
    instance = scene.geometry.instances[point.instance]
    origin4 = scene.materials.constants[codes.CONSTANT_ORIGIN]
    origin = wp.vec3(origin4[0], origin4[1], origin4[2])
    if sub == codes.SPACE_POINT_TO_WORLD:
        return transform_point(instance.to_world, v) + origin
    if sub == codes.SPACE_POINT_TO_OBJECT:
        return transform_point(instance.to_object, v - origin)
    if sub == codes.SPACE_DIRECTION_TO_WORLD:
        return transform_direction(instance.to_world, v)
    if sub == codes.SPACE_DIRECTION_TO_OBJECT:
        return transform_direction(instance.to_object, v)
    n = v
    if sub == codes.SPACE_NORMAL_TO_WORLD:
        n = transform_normal(instance.to_object, v)
    else:
        n = transform_normal(instance.to_world, v)
    return normalize_or(n, n)
