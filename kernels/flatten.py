# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that build the device scene: corners, world-space vertices, and the power of emissive triangles."""

from __future__ import annotations

import warp as wp

from .geometry_math import is_finite3, transform_point
from .intersect import Hit, surface_point, triangle_material, world_vertex
from .nodes import evaluate_emission
from .types import MATERIAL_CONSTANT_EMISSION, VISIBLE_DIFFUSE, Instance, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def flatten_vertices(
    # In:
    instances: wp.array[Instance],
    positions: wp.array[wp.vec3],
    vertex_instance: wp.array[int],
    vertex_source: wp.array[int],
    first: int,
    # Out:
    points_out: wp.array[wp.vec3],
):
    """Place the vertices of flattened instances in world space."""
    i = first + wp.tid()
    points_out[i] = transform_point(instances[vertex_instance[i]].to_world, positions[vertex_source[i]])


@wp.kernel
def write_corners(
    # In:
    start: int,
    first: int,
    positions: wp.array[wp.vec3],
    triangles: wp.array[wp.vec3i],
    slots: wp.array[int],
    normals: wp.array[wp.vec3],
    # Out:
    corners_out: wp.array[wp.vec4],
):
    """Put what shading reads of a triangle side by side (kernels.types.Geometry.corners).

    In detail:
        start: First triangle of this launch, in the scene's numbering.
        first: Triangle whose corner has the first normal.
    """
    triangle = start + wp.tid()
    vertices = triangles[triangle]
    for i in range(3):
        place = positions[vertices[i]]
        slot = float(0.0)
        if i == 0:
            slot = float(slots[triangle])
        normal = normals[3 * (triangle - first) + i]
        corners_out[6 * triangle + i] = wp.vec4(place[0], place[1], place[2], slot)
        corners_out[6 * triangle + 3 + i] = wp.vec4(normal[0], normal[1], normal[2], 0.0)


@wp.kernel
def measure_emitters(
    # In:
    scene: Scene,
    faces: wp.array[wp.vec2i],
    first: int,
    points: int,
    # Out:
    power_out: wp.array[float],
    low_out: wp.array[wp.vec3],
    high_out: wp.array[wp.vec3],
):
    """Write bounds, and area times mean radiance (over `points`, 3 or 6, where textured), of emissive triangles."""
    i = first + wp.tid()
    face = faces[i]
    geometry = scene.geometry
    to_world = geometry.instances[face[0]].to_world
    vertices = geometry.triangles[face[1]]
    p0 = world_vertex(geometry, to_world, vertices[0])
    p1 = world_vertex(geometry, to_world, vertices[1])
    p2 = world_vertex(geometry, to_world, vertices[2])
    low_out[i] = wp.min(p0, wp.min(p1, p2))
    high_out[i] = wp.max(p0, wp.max(p1, p2))
    normal = wp.cross(p1 - p0, p2 - p0)
    area = 0.5 * wp.length(normal)
    total = wp.vec3(0.0, 0.0, 0.0)
    hit = Hit()
    hit.instance = face[0]
    hit.triangle = face[1]
    material = triangle_material(scene, face[0], face[1])
    if (scene.materials.materials[material].flags & MATERIAL_CONSTANT_EMISSION) != 0:
        total = scene.materials.materials[material].emission
    elif area > 0.0:
        direction = -normal / (2.0 * area)
        # Not a literal: Warp would unroll the loop and build the node machine six times.
        for k in range(points):
            # Three points near the corners, then three near the edges' middles.
            hit.u = wp.where(k % 3 == 0, 0.6, 0.2)
            hit.v = wp.where(k % 3 == 1, 0.6, 0.2)
            if k >= 3:
                hit.u = wp.where(k == 3, 0.1, 0.45)
                hit.v = wp.where(k == 4, 0.1, 0.45)
            point = surface_point(scene, hit, direction)
            point.footprint = 0.5 * wp.sqrt(area)
            point.ray_visibility = VISIBLE_DIFFUSE
            point.ray_depth = 1
            radiance = evaluate_emission(scene, point)
            if is_finite3(radiance):
                total += radiance / float(points)
    mean = (wp.max(total[0], 0.0) + wp.max(total[1], 0.0) + wp.max(total[2], 0.0)) / 3.0
    power_out[i] = area * mean
