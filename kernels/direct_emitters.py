# SPDX-License-Identifier: GPL-3.0-or-later
"""Emissive triangles in world space, in few words that load at once, and points drawn on them.

Baked anew every frame: objects move, and a triangle takes the time of one light sample.
"""

from __future__ import annotations

import warp as wp

from .intersect import hit_error, instance_shift, triangle_material, world_vertex
from .lamp_sample import LightSample
from .lights import aim_at_triangle, mean_emission
from .packing import pack_floats, unpack_floats
from .sampling import sample_triangle
from .solid_angle import angle_of_triangle, sample_seen_triangle, spherical_triangle
from .types import LIGHT_TRIANGLE, MATERIAL_CONSTANT_EMISSION, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

EMITTER_WORDS = wp.constant(7)
"""Of two floats: a corner and two edges (9), radiance (3), error along the normal, ray visibility"""


@wp.func
def is_constant(scene: Scene, instance: int, triangle: int) -> bool:
    """Return whether a triangle's emission is the same everywhere on its material."""
    material = triangle_material(scene, instance, triangle)
    return (scene.materials.materials[material].flags & MATERIAL_CONSTANT_EMISSION) != 0


@wp.func
def emitted_radiance(scene: Scene, emitter: int, area: float, local_power: float) -> wp.vec3:
    """Return an emissive triangle's radiance: exact where constant, else its mean from its share of the power."""
    instance = scene.lights.triangles[emitter][0]
    triangle = scene.lights.triangles[emitter][1]
    if is_constant(scene, instance, triangle):
        return scene.materials.materials[triangle_material(scene, instance, triangle)].emission
    # Where the few points of the power's estimate met darkness there may be light all the same.
    mean = wp.max(mean_emission(scene.lights, emitter, area), 1.0e-6 * local_power)
    return wp.vec3(mean, mean, mean)


@wp.kernel
def bake_emitters(
    # In:
    first: int,
    scene: Scene,
    local_power: float,
    # Out:
    emitters_out: wp.array[wp.uint64],
):
    """Write each emissive triangle's words. `local_power` [W] is that of all local lights, which the tree shares."""
    emitter = first + wp.tid()
    geometry = scene.geometry
    face = scene.lights.triangles[emitter]
    to_world = geometry.instances[face[0]].to_world
    vertices = geometry.triangles[face[1]]
    p0 = world_vertex(geometry, to_world, vertices[0])
    p1 = world_vertex(geometry, to_world, vertices[1])
    p2 = world_vertex(geometry, to_world, vertices[2])
    a = p1 - p0
    b = p2 - p0
    double_area = wp.length(wp.cross(a, b))
    error = float(0.0)
    light = wp.vec3(0.0, 0.0, 0.0)
    if double_area > 0.0:
        normal = wp.cross(a, b) / double_area
        # The bound is linear over the triangle: its largest value is at a corner.
        shift = instance_shift(geometry, face[0])
        error = hit_error(p0, p1, p2, 0.0, 0.0, normal, shift)
        error = wp.max(error, hit_error(p0, p1, p2, 1.0, 0.0, normal, shift))
        error = wp.max(error, hit_error(p0, p1, p2, 0.0, 1.0, normal, shift))
        light = emitted_radiance(scene, emitter, 0.5 * double_area, local_power)
    word = emitter * EMITTER_WORDS
    emitters_out[word] = pack_floats(p0[0], p0[1])
    emitters_out[word + 1] = pack_floats(p0[2], a[0])
    emitters_out[word + 2] = pack_floats(a[1], a[2])
    emitters_out[word + 3] = pack_floats(b[0], b[1])
    emitters_out[word + 4] = pack_floats(b[2], light[0])
    emitters_out[word + 5] = pack_floats(light[1], light[2])
    emitters_out[word + 6] = pack_floats(error, float(geometry.instances[face[0]].visibility))


@wp.func
def sample_baked(emitters: wp.array[wp.uint64], emitter: int, position: wp.vec3, u: wp.vec2) -> LightSample:
    """Draw a direction to an emissive triangle, as sample_emitter does; `instance` and `triangle` are left out.

    Close to a long one points drawn by area are next to always far off: the few that are near would be sparks.
    """
    word = emitter * EMITTER_WORDS
    w0 = unpack_floats(emitters[word])
    w1 = unpack_floats(emitters[word + 1])
    w2 = unpack_floats(emitters[word + 2])
    w3 = unpack_floats(emitters[word + 3])
    w4 = unpack_floats(emitters[word + 4])
    w5 = unpack_floats(emitters[word + 5])
    w6 = unpack_floats(emitters[word + 6])
    s = LightSample()
    s.kind = LIGHT_TRIANGLE
    s.shadow = 1
    s.visibility = int(w6[1])
    s.error = w6[0]
    s.radiance = wp.vec3(w4[1], w5[0], w5[1])
    a = wp.vec3(w1[1], w2[0], w2[1])
    b = wp.vec3(w3[0], w3[1], w4[0])
    to_corner = wp.vec3(w0[0], w0[1], w1[0]) - position
    corner = sample_triangle(u)
    angle = angle_of_triangle(to_corner, a, b)
    if angle > 0.0:
        seen = spherical_triangle(to_corner, to_corner + a, to_corner + b)
        corner = sample_seen_triangle(to_corner, to_corner + a, to_corner + b, seen, angle, u)
    s.u = corner[0]
    s.v = corner[1]
    s = aim_at_triangle(s, to_corner + a * s.u + b * s.v, wp.cross(a, b))
    if angle > 0.0:
        s.pdf = 1.0 / angle
    return s
