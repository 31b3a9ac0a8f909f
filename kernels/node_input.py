# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's inputs: what a shading point, its triangle, its object and its ray tell a program.

Coordinates return their value in xyz and their filter width in w: the footprint of the ray cone in units of the
coordinate. A point without an instance is a direction of the world: its position is the direction itself.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import normalize_or, orthonormal_tangent, transform_direction, transform_normal, transform_point
from .types import (
    DEPTH_BITS,
    DEPTH_MASK,
    DEPTH_SHIFT,
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    VISIBLE_TRANSMISSION,
    Instance,
    Scene,
    ShadingPoint,
)
from .wide_loads import interpolated_normal, load_corner, load_vec2, load_vec4


@wp.func
def bump_axis(normal: wp.vec3, second: bool) -> wp.vec3:
    """Return one of two unit vectors that span the plane of `normal`: those along which Cycles differentiates."""
    x = wp.cross(wp.vec3(1.0, 1.0, 1.0), normal)
    if normal[0] == normal[1] and normal[0] == normal[2]:
        x = wp.cross(wp.vec3(-1.0, 1.0, 1.0), normal)
    x = wp.normalize(x)
    if second:
        return wp.cross(normal, x)
    return x


@wp.func
def world_edge(scene: Scene, instance: Instance, triangle: int, corner: int) -> wp.vec3:
    """Return the edge from the first vertex to vertex `corner` in world space."""
    edge = load_corner(scene.geometry, triangle, corner) - load_corner(scene.geometry, triangle, 0)
    return transform_direction(instance.to_world, edge)


@wp.func
def shift_point(scene: Scene, point: ShadingPoint, instance: Instance, offset: wp.vec3) -> ShadingPoint:
    """Return the point moved by `offset` in the plane of its triangle, barycentric coordinates included."""
    a = world_edge(scene, instance, point.triangle, 1)
    b = world_edge(scene, instance, point.triangle, 2)
    aa = wp.dot(a, a)
    ab = wp.dot(a, b)
    bb = wp.dot(b, b)
    det = aa * bb - ab * ab
    moved = point
    moved.position = point.position + offset
    if det > 0.0:
        moved.u = point.u + (bb * wp.dot(offset, a) - ab * wp.dot(offset, b)) / det
        moved.v = point.v + (aa * wp.dot(offset, b) - ab * wp.dot(offset, a)) / det
    return moved


@wp.func
def uv_coordinate(scene: Scene, point: ShadingPoint, instance: Instance, uv_map: int) -> wp.vec4:
    """Return the interpolated UV; its filter width is the footprint times the root of UV area over world area."""
    base = scene.geometry.uv_offsets[instance.mesh, uv_map]
    if base < 0:
        return wp.vec4(0.0)
    base += 3 * (point.triangle - instance.triangle_offset)
    uv = load_vec2(scene.geometry.uvs, base)
    a = load_vec2(scene.geometry.uvs, base + 1) - uv
    b = load_vec2(scene.geometry.uvs, base + 2) - uv
    width = float(0.0)
    if point.footprint > 0.0:
        normal = wp.cross(
            world_edge(scene, instance, point.triangle, 1), world_edge(scene, instance, point.triangle, 2))
        uv_area = wp.abs(a[0] * b[1] - a[1] * b[0])
        width = point.footprint * wp.sqrt(uv_area / wp.max(wp.length(normal), 1.0e-30))
    uv = uv + a * point.u + b * point.v
    return wp.vec4(uv[0], uv[1], 0.0, width)


@wp.func
def attribute_value(scene: Scene, point: ShadingPoint, instance: Instance, attribute: int) -> wp.vec4:
    """Return an interpolated attribute, 0 where the mesh lacks it."""
    base = scene.geometry.attribute_offsets[instance.mesh, attribute]
    if base < 0:
        return wp.vec4(0.0)
    base += 3 * (point.triangle - instance.triangle_offset)
    return (
        load_vec4(scene.geometry.attributes, base) * (1.0 - point.u - point.v)
        + load_vec4(scene.geometry.attributes, base + 1) * point.u
        + load_vec4(scene.geometry.attributes, base + 2) * point.v
    )


@wp.func
def object_normal(scene: Scene, point: ShadingPoint) -> wp.vec3:
    """Return the interpolated normal in object space, not normalised, on the triangle's front."""
    return interpolated_normal(scene.geometry, point.triangle, point.u, point.v)


@wp.func
def generated_coordinate(instance: Instance, object_position: wp.vec3) -> wp.vec3:
    """Return the position within the mesh's texture space, 0..1 over its extent."""
    p = wp.cw_div(object_position - instance.generated_location, instance.generated_size)
    return p * 0.5 + wp.vec3(0.5)


@wp.func
def uv_tangent(scene: Scene, point: ShadingPoint, instance: Instance, uv_map: int, attribute: int) -> wp.vec4:
    """Return the object-space tangent along u (xyz, unit) and the bitangent's sign (w; 0: there is none).

    Taken from the mesh's tangent attribute where it has one, else from the triangle's own UV gradient.
    """
    if attribute >= 0:
        if scene.geometry.attribute_offsets[instance.mesh, attribute] >= 0:
            return attribute_value(scene, point, instance, attribute)
    if uv_map < 0:
        return wp.vec4(0.0)
    base = scene.geometry.uv_offsets[instance.mesh, uv_map]
    if base < 0:
        return wp.vec4(0.0)
    base += 3 * (point.triangle - instance.triangle_offset)
    a = load_vec2(scene.geometry.uvs, base + 1) - load_vec2(scene.geometry.uvs, base)
    b = load_vec2(scene.geometry.uvs, base + 2) - load_vec2(scene.geometry.uvs, base)
    det = a[0] * b[1] - a[1] * b[0]
    origin = load_corner(scene.geometry, point.triangle, 0)
    gradient = ((load_corner(scene.geometry, point.triangle, 1) - origin) * b[1]
                - (load_corner(scene.geometry, point.triangle, 2) - origin) * a[1])
    sign = wp.where(det < 0.0, -1.0, 1.0)
    normal = normalize_or(object_normal(scene, point), wp.vec3(0.0))
    tangent = gradient * sign
    tangent = normalize_or(tangent - normal * wp.dot(tangent, normal), wp.vec3(0.0))
    if det == 0.0 or wp.length_sq(tangent) == 0.0:
        return wp.vec4(0.0)
    return wp.vec4(tangent[0], tangent[1], tangent[2], sign)


@wp.func
def tangent_input(
    scene: Scene, point: ShadingPoint, instance: Instance, kind: int, uv_map: int, attribute: int
) -> wp.vec3:
    """Return the Tangent node's vector: around an axis of the texture space, or along u of a UV map."""
    t = wp.vec3(0.0)
    if kind == codes.INPUT_TANGENT_UV:
        t4 = uv_tangent(scene, point, instance, uv_map, attribute)
        t = wp.vec3(t4[0], t4[1], t4[2])
    else:
        g = generated_coordinate(instance, transform_point(instance.to_object, point.position)) - wp.vec3(0.5)
        if kind == codes.INPUT_TANGENT_X:
            t = wp.vec3(0.0, -g[2], g[1])
        elif kind == codes.INPUT_TANGENT_Y:
            t = wp.vec3(-g[2], 0.0, g[0])
        else:
            t = wp.vec3(-g[1], g[0], 0.0)
    t = transform_normal(instance.to_object, t)
    t = t - point.normal * wp.dot(t, point.normal)
    return normalize_or(t, orthonormal_tangent(point.normal))


@wp.func
def window_coordinate(scene: Scene, point: ShadingPoint) -> wp.vec4:
    """Return the place on the film, 0..1 in both directions."""
    p = wp.vec4(point.position[0], point.position[1], point.position[2], wp.where(point.instance < 0, 0.0, 1.0))
    x = wp.dot(scene.materials.constants[codes.CONSTANT_CAMERA], p)
    y = wp.dot(scene.materials.constants[codes.CONSTANT_CAMERA + 1], p)
    z = wp.dot(scene.materials.constants[codes.CONSTANT_CAMERA + 2], p)
    window = scene.materials.constants[codes.CONSTANT_WINDOW]
    if scene.materials.constants[codes.CONSTANT_PROJECTION][0] == 0.0:
        x = x / wp.max(z, 1.0e-20)
        y = y / wp.max(z, 1.0e-20)
    return wp.vec4((x - window[0]) / (window[1] - window[0]), (y - window[2]) / (window[3] - window[2]), 0.0, 0.0)


@wp.func
def world_input(scene: Scene, point: ShadingPoint, kind: int) -> wp.vec4:
    """Return an input for a direction of the world."""
    d = point.position
    if kind == codes.INPUT_POSITION or kind == codes.INPUT_GENERATED or kind == codes.INPUT_OBJECT:
        return wp.vec4(d[0], d[1], d[2], point.footprint)
    if kind == codes.INPUT_WINDOW:
        return window_coordinate(scene, point)
    if kind >= codes.INPUT_NORMAL and kind <= codes.INPUT_REFLECTION:
        return wp.vec4(-d[0], -d[1], -d[2], point.footprint)
    return wp.vec4(0.0)


@wp.func
def coordinate_input(scene: Scene, point: ShadingPoint, instance: Instance, kind: int, shifted: bool) -> wp.vec4:
    """Return a coordinate or direction of the surface."""
    p = point.position
    if kind == codes.INPUT_POSITION:
        return wp.vec4(p[0], p[1], p[2], point.footprint) + scene.materials.constants[codes.CONSTANT_ORIGIN]
    n = point.normal
    if kind <= codes.INPUT_OBJECT:
        across = transform_direction(instance.to_object, orthonormal_tangent(n))
        p = transform_point(instance.to_object, p)
        if kind == codes.INPUT_GENERATED:
            p = generated_coordinate(instance, p)
            across = wp.cw_div(across, instance.generated_size) * 0.5
        return wp.vec4(p[0], p[1], p[2], point.footprint * wp.length(across))
    if kind == codes.INPUT_TRUE_NORMAL:
        n = point.geometric_normal
    elif kind == codes.INPUT_OBJECT_NORMAL:
        if shifted:
            n = object_normal(scene, point) * wp.where(point.backfacing != 0, -1.0, 1.0)
        else:
            n = transform_normal(instance.to_world, n)
        n = normalize_or(n, n)
    elif kind == codes.INPUT_INCOMING:
        n = point.wo
    elif kind == codes.INPUT_REFLECTION:
        n = n * (2.0 * wp.dot(n, point.wo)) - point.wo
    return wp.vec4(n[0], n[1], n[2], 0.0)


@wp.func
def object_input(scene: Scene, point: ShadingPoint, instance: Instance, kind: int) -> wp.vec4:
    """Return a property of the object or the material."""
    if kind == codes.INPUT_OBJECT_COLOR:
        return instance.color
    if kind == codes.INPUT_OBJECT_LOCATION:
        m = instance.to_world
        return wp.vec4(m[0, 3], m[1, 3], m[2, 3], 0.0) + scene.materials.constants[codes.CONSTANT_ORIGIN]
    x = instance.random
    if kind == codes.INPUT_OBJECT_INDEX:
        x = float(instance.pass_index)
    elif kind == codes.INPUT_MATERIAL_INDEX:
        x = float(scene.materials.materials[point.material].pass_index)
    return wp.vec4(x, x, x, 0.0)


@wp.func
def property_value(scene: Scene, instance: int, number: int) -> wp.vec4:
    """Return a property of an instance's object, 0 without an instance."""
    if instance < 0:
        return wp.vec4(0.0)
    return scene.materials.properties[number * scene.geometry.instances.shape[0] + instance]


@wp.func
def depth_place(kind: int) -> int:
    """Return the lowest bit of a path's kind that counts its rays of a kind."""
    place = int(DEPTH_SHIFT)
    if (kind & VISIBLE_GLOSSY) != 0:
        place = DEPTH_SHIFT + DEPTH_BITS
    elif (kind & VISIBLE_TRANSMISSION) != 0:
        place = DEPTH_SHIFT + 2 * DEPTH_BITS
    return place


@wp.func
def deeper(before: int, kind: int) -> int:
    """Return the kind of a path's next ray, with the numbers of rays by kind."""
    numbers = (before >> DEPTH_SHIFT) << DEPTH_SHIFT
    place = depth_place(kind)
    if ((numbers >> place) & DEPTH_MASK) < DEPTH_MASK:
        numbers = numbers + (1 << place)
    return numbers | (kind & (VISIBLE_DIFFUSE | VISIBLE_GLOSSY | VISIBLE_TRANSMISSION))


@wp.func
def kind_depth(point: ShadingPoint, kind: int) -> float:
    """Return how many rays of a kind led to a point: in real-time frames the ray's depth while it is of that kind."""
    number = float((point.ray_visibility >> depth_place(kind)) & DEPTH_MASK)
    if number == 0.0 and (point.ray_visibility & kind) != 0:
        number = float(point.ray_depth)
    return number


@wp.func
def wireframe(scene: Scene, point: ShadingPoint, size: float) -> float:
    """Return whether a point is within half of `size` of an edge of its triangle, as Cycles has it."""
    instance = scene.geometry.instances[point.instance]
    near = float(0.0)
    limit = 0.25 * size * size
    for corner in range(3):
        a = transform_point(instance.to_world, load_corner(scene.geometry, point.triangle, corner))
        b = transform_point(instance.to_world, load_corner(scene.geometry, point.triangle, (corner + 1) % 3))
        edge = b - a
        if wp.length_sq(wp.cross(edge, point.position - a)) < limit * wp.length_sq(edge):
            near = 1.0
    return near


@wp.func
def ray_input(point: ShadingPoint, kind: int, mask: int) -> wp.vec4:
    """Return what the Light Path node tells about the ray that arrived."""
    x = float(0.0)
    if kind == codes.INPUT_RAY_KIND:
        x = wp.where((point.ray_visibility & mask) != 0, 1.0, 0.0)
    elif kind == codes.INPUT_RAY_LENGTH:
        x = point.ray_length
    elif kind == codes.INPUT_KIND_DEPTH:
        x = kind_depth(point, mask)
    else:
        x = float(point.ray_depth)
    return wp.vec4(x, x, x, 0.0)


@wp.func
def input_value(scene: Scene, hit: ShadingPoint, sub: int, bump_width: float, first: int, second: int) -> wp.vec4:
    """Evaluate an input (codes.INPUT_*), shifted for bump mapping where `sub` says so.

    Args:
        scene: The scene.
        hit: The shading point.
        sub: Kind in the low byte, bump offset in bits 8-9.
        bump_width: Length of the bump offset in footprints; width of lines.
        first: UV map, attribute, property or mask of ray kinds.
        second: Tangent attribute or -1.
    """
    kind = sub & 255
    if kind == codes.INPUT_SCENE_POSITION:
        return wp.vec4(hit.position[0], hit.position[1], hit.position[2], 0.0)
    if kind == codes.INPUT_PROPERTY:
        return property_value(scene, hit.instance, first)
    if kind == codes.INPUT_WIREFRAME:
        edge = float(0.0)
        if hit.instance >= 0:
            edge = wireframe(scene, hit, bump_width)
        return wp.vec4(edge, edge, edge, 0.0)
    if kind >= codes.INPUT_RAY_KIND:
        return ray_input(hit, kind, first)
    if hit.instance < 0:
        return world_input(scene, hit, kind)
    instance = scene.geometry.instances[hit.instance]
    point = hit
    shifted = sub >= codes.INPUT_SHIFT_X
    if shifted:
        axis = bump_axis(hit.geometric_normal, sub >= codes.INPUT_SHIFT_Y)
        point = shift_point(scene, hit, instance, axis * (hit.footprint * bump_width))
    if kind == codes.INPUT_UV:
        return uv_coordinate(scene, point, instance, first)
    if kind == codes.INPUT_ATTRIBUTE:
        return attribute_value(scene, point, instance, first)
    if kind <= codes.INPUT_REFLECTION:
        return coordinate_input(scene, point, instance, kind, shifted)
    if kind == codes.INPUT_PARAMETRIC:
        return wp.vec4(1.0 - point.u - point.v, point.u, 0.0, 0.0)
    if kind == codes.INPUT_BACKFACING:
        return wp.vec4(float(hit.backfacing), float(hit.backfacing), float(hit.backfacing), 0.0)
    if kind <= codes.INPUT_TANGENT_UV:
        t = tangent_input(scene, point, instance, kind, first, second)
        return wp.vec4(t[0], t[1], t[2], 0.0)
    if kind == codes.INPUT_WINDOW:
        return window_coordinate(scene, point)
    return object_input(scene, point, instance, kind)
