# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays against the scene: closest hit, any hit, and the geometry of a hit. Thin: knows no materials.

Static triangles lie flattened in one 8-wide BVH in world space; instances that move or are too many to flatten lie in
another one over those of their meshes (wide_instances.py). Triangles that need a test per hit (transparency, visibility
by ray kind) lie in structures of their own, queried by filter.py layer by layer.

Ray origins are moved off the surface by the float error bound of the hit position (Pharr, Jakob and Humphreys,
"Physically Based Rendering" 4th ed., section 6.8), not by a constant: a scene may be any size.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import UNIT_ROUNDOFF, normalize_or, transform_normal, transform_point
from .types import MATERIAL_EMISSION, FlatTriangles, Geometry, InstanceLevel, Scene, ShadingPoint
from .wide_bvh import any_wide, any_with_tubes, closest_wide, closest_with_tubes
from .wide_instances import (
    InstanceHit,
    any_in_instances,
    any_in_instances_with_tubes,
    closest_in_instances,
    closest_in_instances_with_tubes,
    closest_layer_in_instances,
    shadow_layer_in_instances,
)
from .wide_layers import closest_layer_wide, shadow_layer_wide
from .wide_loads import interpolated_normal, load_corner, load_instance, load_material_flags, load_slot

# Nothing was hit.
MISS = wp.constant(-1)

# A hit's position errs by the rounding of the transform and of the interpolation, each coordinate by so many
# roundoffs of its own magnitude. Rays leaving 20,000 random hits met their own triangle again with 4, not with 8.
ERROR_ROUNDOFFS = wp.constant(8.0)


@wp.struct
class Hit:
    """Closest hit of a ray."""

    t: float
    """Distance along the ray in units of its direction"""
    instance: int
    """MISS where nothing was hit"""
    triangle: int
    """Index into Geometry.triangles"""
    u: float
    v: float
    """Weights of the second and third vertex"""


@wp.struct
class Layer:
    """Closest hit of a ray among the triangles that need a test."""

    hit: Hit
    solid: int
    """1: its opacity map says that it is opaque there, so that nothing is left to test"""


@wp.func
def hit_at(instance: int, triangle: int, t: float, first: float, second: float) -> Hit:
    """Return a hit by the weights of the triangle's first and second vertex, which queries tell."""
    hit = Hit()
    hit.t = t
    hit.instance = instance
    hit.triangle = triangle
    hit.u = second
    hit.v = 1.0 - first - second
    return hit


@wp.func
def closest_static(flat: FlatTriangles, origin: wp.vec3, direction: wp.vec3, hit: Hit) -> Hit:
    """Shorten `hit` by the flattened triangles of one structure."""
    result = hit
    if flat.nodes.shape[0] > 0:
        found = wp.vec4(0.0, 0.0, 0.0, 0.0)
        if flat.tubes == 1:
            found = closest_with_tubes(flat.nodes, flat.triangles, origin, direction, hit.t)
        else:
            found = closest_wide(flat.nodes, flat.triangles, origin, direction, hit.t)
        number = wp.cast(found[3], int)
        if number >= 0:
            face = flat.faces[number]
            result = hit_at(face[0], face[1], found[0], found[1], found[2])
    return result


@wp.func
def found_layer(flat: FlatTriangles, found: wp.vec4) -> Layer:
    """Return what a query for layers has found; see wide_layers.closest_layer_wide."""
    layer = Layer()
    layer.hit.t = found[0]
    layer.hit.instance = MISS
    key = wp.cast(found[3], int)
    if key >= 0:
        face = flat.faces[key >> 1]
        layer.hit = hit_at(face[0], face[1], found[0], found[1], found[2])
        layer.solid = key & 1
    return layer


@wp.func
def static_layer(flat: FlatTriangles, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Layer:
    """Return the closest hit of flattened triangles before t_max, but for those whose opacity maps are clear there."""
    found = wp.vec4(t_max, 0.0, 0.0, wp.cast(MISS, float))
    if flat.nodes.shape[0] > 0:
        found = closest_layer_wide(flat.nodes, flat.triangles, origin, direction, t_max)
    return found_layer(flat, found)


@wp.func
def static_shadow_layer(flat: FlatTriangles, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Layer:
    """Return the same for shadow rays: a solid hit if one is met on the way to the closest."""
    found = wp.vec4(t_max, 0.0, 0.0, wp.cast(MISS, float))
    if flat.nodes.shape[0] > 0:
        found = shadow_layer_wide(flat.nodes, flat.triangles, origin, direction, t_max)
    return found_layer(flat, found)


@wp.func
def any_static(flat: FlatTriangles, origin: wp.vec3, direction: wp.vec3, t_max: float) -> bool:
    """Return whether a flattened triangle of one structure lies before t_max."""
    if flat.nodes.shape[0] == 0:
        return False
    if flat.tubes == 1:
        return any_with_tubes(flat.nodes, flat.triangles, origin, direction, t_max)
    return any_wide(flat.nodes, flat.triangles, origin, direction, t_max)


@wp.func
def closest_instanced(
    level: InstanceLevel, mesh_faces: wp.array[int], origin: wp.vec3, direction: wp.vec3, hit: Hit,
) -> Hit:
    """Shorten `hit` by instances that are not flattened."""
    result = hit
    found = InstanceHit()
    if level.tubes == 1:
        found = closest_in_instances_with_tubes(level.nodes, level.records, origin, direction, hit.t)
    else:
        found = closest_in_instances(level.nodes, level.records, origin, direction, hit.t)
    face = wp.cast(found[3], int)
    if face >= 0:
        result = hit_at(wp.cast(found[4], int), mesh_faces[face], found[0], found[1], found[2])
    return result


@wp.func
def instanced_layer(geometry: Geometry, found: InstanceHit, flat: Layer) -> Layer:
    """Return an instance's triangle that needs a test where one was found before the flattened one."""
    layer = flat
    key = wp.cast(found[3], int)
    if key >= 0:
        layer.hit = hit_at(
            wp.cast(found[4], int), geometry.mesh_faces[key >> 1], found[0], found[1], found[2])
        layer.solid = key & 1
    return layer


@wp.func
def closest_hit(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Hit:
    """Return the closest opaque hit before t_max."""
    hit = Hit()
    hit.t = t_max
    hit.instance = MISS
    hit = closest_static(geometry.flat, origin, direction, hit)
    return closest_instanced(geometry.instanced, geometry.mesh_faces, origin, direction, hit)


@wp.func
def closer_layer(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, flat: Layer) -> Layer:
    """Return an instance's triangle that needs a test where it is closer than the flattened one."""
    level = geometry.instanced_filtered
    return instanced_layer(geometry, closest_layer_in_instances(
        level.nodes, level.records, origin, direction, flat.hit.t), flat)


@wp.func
def closest_layer(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Layer:
    """Return the closest hit before t_max among the triangles that need a test, without what is known to be clear."""
    return closer_layer(
        geometry, origin, direction, static_layer(geometry.flat_filtered, origin, direction, t_max))


@wp.func
def shadow_layer(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Layer:
    """Return the same for shadow rays: a solid hit if one is met on the way to the closest."""
    layer = static_shadow_layer(geometry.flat_filtered, origin, direction, t_max)
    if layer.solid == 1:
        return layer
    level = geometry.instanced_filtered
    return instanced_layer(geometry, shadow_layer_in_instances(
        level.nodes, level.records, origin, direction, layer.hit.t), layer)


@wp.func
def any_hit(geometry: Geometry, origin: wp.vec3, direction: wp.vec3, t_max: float) -> bool:
    """Return whether an opaque triangle lies before t_max."""
    if any_static(geometry.flat, origin, direction, t_max):
        return True
    level = geometry.instanced
    if level.tubes == 1:
        return any_in_instances_with_tubes(level.nodes, level.records, origin, direction, t_max)
    return any_in_instances(level.nodes, level.records, origin, direction, t_max)


@wp.func
def world_vertex(geometry: Geometry, to_world: wp.mat44, vertex: int) -> wp.vec3:
    """Return a vertex in world space; flattening uses the same expression, so both agree."""
    return transform_point(to_world, geometry.positions[vertex])


@wp.func
def absolute(v: wp.vec3) -> wp.vec3:
    """Return the components' magnitudes."""
    return wp.vec3(wp.abs(v[0]), wp.abs(v[1]), wp.abs(v[2]))


@wp.func
def instance_shift(geometry: Geometry, instance: int) -> wp.vec3:
    """Return the magnitudes whose rounding rays keep that were moved to an instance's object space; 0 if flattened.

    A large translation cancelled by large object coordinates leaves its rounding behind. Flattened triangles are
    met where surface_point finds them, however their vertices were rounded.
    """
    row = load_instance(geometry.instances, instance)
    if row.instanced == 0:
        return wp.vec3(0.0, 0.0, 0.0)
    m = row.to_world
    return wp.vec3(wp.abs(m[0, 3]), wp.abs(m[1, 3]), wp.abs(m[2, 3]))


@wp.func
def hit_error(
    p0: wp.vec3, p1: wp.vec3, p2: wp.vec3, u: float, v: float, normal: wp.vec3, shift: wp.vec3,
) -> float:
    """Return how far along its normal a hit on a triangle may lie off it.

    Coordinates count one by one: a floor at z = 0 has no error in z, however large it is, and rays may start in the
    narrowest gap above it. `shift` is from `instance_shift`.
    """
    magnitude = absolute(p0) * (1.0 - u - v) + absolute(p1) * u + absolute(p2) * v
    extent = wp.max(wp.max(wp.length(p0), wp.length(p1)), wp.length(p2))
    along = wp.dot(absolute(normal), magnitude + shift)
    return UNIT_ROUNDOFF * (ERROR_ROUNDOFFS * along + extent)


@wp.func
def surface_point(scene: Scene, hit: Hit, direction: wp.vec3) -> ShadingPoint:
    """Return the geometry of a hit: position, normals towards the ray's origin, material, error bound."""
    geometry = scene.geometry
    instance = load_instance(geometry.instances, hit.instance)
    p0 = transform_point(instance.to_world, load_corner(geometry, hit.triangle, 0))
    p1 = transform_point(instance.to_world, load_corner(geometry, hit.triangle, 1))
    p2 = transform_point(instance.to_world, load_corner(geometry, hit.triangle, 2))
    w = 1.0 - hit.u - hit.v
    local_normal = interpolated_normal(geometry, hit.triangle, hit.u, hit.v)
    flip = wp.where(instance.flipped == 1, -1.0, 1.0)
    ng = normalize_or(wp.cross(p1 - p0, p2 - p0) * flip, -direction)
    n = normalize_or(transform_normal(instance.to_object, local_normal), ng)

    point = ShadingPoint()
    point.position = p0 * w + p1 * hit.u + p2 * hit.v
    point.wo = -direction
    point.backfacing = int(0)
    if wp.dot(ng, direction) > 0.0:
        point.backfacing = 1
        ng = -ng
        n = -n
    point.geometric_normal = ng
    point.normal = n
    point.instance = hit.instance
    point.triangle = hit.triangle
    point.u = hit.u
    point.v = hit.v
    point.error = hit_error(p0, p1, p2, hit.u, hit.v, ng, instance_shift(geometry, hit.instance))
    slot = wp.min(load_slot(geometry, hit.triangle), instance.material_count - 1)
    point.material = scene.materials.instance_materials[instance.material_offset + slot]
    return point


@wp.func
def triangle_material(scene: Scene, instance: int, triangle: int) -> int:
    """Return the material of an instance's triangle."""
    row = load_instance(scene.geometry.instances, instance)
    slot = wp.min(load_slot(scene.geometry, triangle), row.material_count - 1)
    return scene.materials.instance_materials[row.material_offset + slot]


@wp.func
def may_emit(scene: Scene, material: int) -> bool:
    """Return whether a material has a program that emits."""
    return (load_material_flags(scene.materials.materials, material)[3] & MATERIAL_EMISSION) != 0


@wp.func
def offset_origin(position: wp.vec3, normal: wp.vec3, error: float, direction: wp.vec3) -> wp.vec3:
    """Move a ray's origin off the surface by the hit's error, to the side that it leaves for."""
    if wp.dot(normal, direction) < 0.0:
        return position - normal * error
    return position + normal * error
