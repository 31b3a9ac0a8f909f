# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine of exact programs: the same as nodes.run, and instructions that send rays from the point.

Ambient Occlusion and Bevel as Cycles has them (kernel/svm/ao.h and bevel.h): rays with the cosine's density; and rays
through disks of three directions about the point, weighed against each other, over the normals that they meet.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import (
    TWO_PI,
    normalize_or,
    orthonormal_tangent,
    safe_sqrt,
    sqr,
    to_frame,
    transform_direction,
    transform_normal,
    transform_point,
)
from .intersect import MISS, any_hit, closest_layer, offset_origin, surface_point
from .node_closure import argument, drawing_weight, empty_closure, fetch, read_closure, xyz
from .nodes import broadcast, compute, extend
from .sampling import sample_cosine, sample_pair
from .types import (
    DEPTH_MASK,
    DEPTH_SHIFT,
    MATERIAL_EXACT,
    VISIBLE_SHADOW,
    Closure,
    Instance,
    Scene,
    ShadingPoint,
)
from .wide_loads import interpolated_normal

__all__ = ["Rays", "program_start", "run_exact"]

# Dimensions of the sequences of rays, past those of all bounces: one for each place in a program.
DIMENSION_RAYS = wp.constant(1 << 20)

# Layers that an occlusion ray looks through, and surfaces that a bevel's ray counts.
LAYERS_MAX = wp.constant(32)
CROSSINGS_MAX = wp.constant(16)

# A bevel's ray goes on from a surface by so much of its length.
STEP = wp.constant(1.0e-5)

# Rays that were drawn with less density [1/sr] see sharp edges, as in Cycles.
SHARP_DENSITY = wp.constant(8.0)


@wp.struct
class Rays:
    """Random numbers of a point's rays."""

    seed: wp.uint32
    index: wp.uint32
    blurred: int
    """1: the point is seen by rays of a wide lobe: edges stay sharp"""


@wp.func
def is_blurred(kind: int, density: float) -> int:
    """Return whether a path of a kind (paths.Paths.kind), whose last ray had a density (0: a mirror), sees blurred."""
    if ((kind >> DEPTH_SHIFT) & DEPTH_MASK) > 0 or (density > 0.0 and density < SHARP_DENSITY):
        return 1
    return 0


@wp.func
def is_occluded(scene: Scene, origin: wp.vec3, direction: wp.vec3, distance: float) -> bool:
    """Return whether something stands in the way that casts shadows, transparent things included."""
    if any_hit(scene.geometry, origin, direction, distance):
        return True
    start = float(0.0)
    for _layer in range(LAYERS_MAX):
        found = closest_layer(scene.geometry, origin + direction * start, direction, distance - start)
        hit = found.hit
        if hit.instance == MISS:
            return False
        if (scene.geometry.instances[hit.instance].visibility & VISIBLE_SHADOW) != 0:
            return True
        error = surface_point(scene, hit, direction).error
        start = start + hit.t + wp.max(2.0 * error, hit.t * STEP)
        if start >= distance:
            return False
    return True


@wp.func
def meets_itself(instance: Instance, origin: wp.vec3, direction: wp.vec3, distance: float) -> bool:
    """Return whether the object itself stands in the way."""
    if instance.walk_mesh == wp.uint64(0):
        return False
    # The direction is not normalised, so t means the same in both spaces.
    return wp.mesh_query_ray_anyhit(
        instance.walk_mesh, transform_point(instance.to_object, origin),
        transform_direction(instance.to_object, direction), distance)


@wp.func
def occlusion(
    scene: Scene, point: ShadingPoint, sub: int, distance: float, normal: wp.vec3, count: int, dimension: int,
    rays: Rays,
) -> float:
    """Return the share of `count` rays about the normal that get through."""
    if distance <= 0.0 or point.instance < 0:
        return 1.0
    instance = scene.geometry.instances[point.instance]
    axis = normal
    if (sub & codes.TRACE_INSIDE) != 0:
        axis = -normal
    free = int(0)
    for k in range(count):
        u = sample_pair(rays.seed, rays.index * wp.uint32(count) + wp.uint32(k), dimension)
        direction = to_frame(axis, sample_cosine(u))
        origin = offset_origin(point.position, point.geometric_normal, point.error, direction)
        met = bool(False)
        if (sub & codes.TRACE_LOCAL) != 0:
            met = meets_itself(instance, origin, direction, distance)
        else:
            met = is_occluded(scene, origin, direction, distance)
        if not met:
            free = free + 1
    return float(free) / float(count)


@wp.func
def cubic_density(radius: float, r: float) -> float:
    """Return the density per area at r of the profile (radius - r)^3."""
    if r >= radius:
        return 0.0
    x = 1.0 - r / radius
    return 10.0 * x * x * x / (3.14159265 * radius * radius)


@wp.func
def cubic_radius(xi: float) -> float:
    """Return the share of the radius within which the profile has a share xi of its whole, by Newton's method."""
    x = float(0.25)
    for _step in range(10):
        rest = 1.0 - x
        excess = x * x * (10.0 + x * (-20.0 + x * (15.0 - 4.0 * x))) - xi
        slope = 20.0 * x * rest * rest * rest
        if wp.abs(excess) >= 1.0e-6 and slope != 0.0:
            x = wp.clamp(x - excess / slope, 0.0, 1.0)
    return x


@wp.func
def met_normal(scene: Scene, instance: Instance, triangle: int, u: float, v: float, front: wp.vec3) -> wp.vec3:
    """Return the interpolated normal of the object in world space, on the triangle's front."""
    local = interpolated_normal(scene.geometry, triangle, u, v)
    return normalize_or(transform_normal(instance.to_object, local), front)


@wp.func
def bevel_ray(
    scene: Scene, point: ShadingPoint, instance: Instance, radius: float, u: wp.vec2,
) -> wp.vec3:
    """Return the sum of the normals that one ray meets, weighed by the profile and against the other directions."""
    x = point.geometric_normal
    y = orthonormal_tangent(x)
    z = wp.cross(x, y)
    # The ray's direction: the normal for half of the rays, each of its tangents for a quarter.
    odds = wp.vec3(0.5, 0.25, 0.25)
    number = u[0] * 2.0
    if u[0] >= 0.75:
        number = u[0] * 4.0 - 3.0
        axis = z
        z = x
        x = axis
        odds = wp.vec3(0.25, 0.25, 0.5)
    elif u[0] >= 0.5:
        number = u[0] * 4.0 - 2.0
        axis = y
        y = x
        x = axis
        odds = wp.vec3(0.25, 0.5, 0.25)
    turn = TWO_PI * number
    share = cubic_radius(u[1])
    r = radius * share
    height = radius * safe_sqrt(1.0 - share * share)
    origin = point.position + x * height + (y * wp.cos(turn) + z * wp.sin(turn)) * r
    length = 2.0 * height
    density = cubic_density(radius, r)
    total = wp.vec3(0.0, 0.0, 0.0)
    if length <= 0.0 or density <= 0.0:
        return total
    start = float(0.0)
    last = int(-1)
    for _crossing in range(CROSSINGS_MAX):
        hit = wp.mesh_query_ray(
            instance.walk_mesh, transform_point(instance.to_object, origin - x * start),
            transform_direction(instance.to_object, -x), length - start)
        if not hit.result:
            return total
        start = start + hit.t
        if hit.face != last:
            last = hit.face
            triangle = instance.triangle_offset + hit.face
            front = normalize_or(transform_normal(instance.to_object, hit.normal), x)
            # Warp weighs the first vertex by u and the second by v.
            n = met_normal(scene, instance, triangle, hit.v, 1.0 - hit.u - hit.v, front)
            px = odds[0] * wp.abs(wp.dot(x, front))
            py = odds[1] * wp.abs(wp.dot(y, front))
            pz = odds[2] * wp.abs(wp.dot(z, front))
            distance = wp.length(origin - x * start - point.position)
            weight = px / (sqr(px) + sqr(py) + sqr(pz)) * cubic_density(radius, distance) / density
            total = total + n * weight
        start = start + length * STEP
        if start >= length:
            return total
    return total


@wp.func
def bevel(
    scene: Scene, point: ShadingPoint, radius: float, count: int, dimension: int, rays: Rays,
) -> wp.vec3:
    """Return the mean normal of the object's surface within a radius about the point."""
    if radius <= 0.0 or point.instance < 0 or rays.blurred == 1:
        return point.normal
    instance = scene.geometry.instances[point.instance]
    if instance.walk_mesh == wp.uint64(0):
        return point.normal
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(count):
        u = sample_pair(rays.seed, rays.index * wp.uint32(count) + wp.uint32(k), dimension)
        total = total + bevel_ray(scene, point, instance, radius, u)
    if point.backfacing == 1:
        total = -total
    return normalize_or(total, point.normal)


@wp.func
def trace(scene: Scene, point: ShadingPoint, word: wp.vec4i, a: wp.vec4, b: wp.vec4, pc: int, rays: Rays) -> wp.vec4:
    """Evaluate OP_TRACE; the place in the program has numbers of its own."""
    sub = (word[0] >> 16) & 65535
    given = wp.length_sq(xyz(b)) > 0.0
    if (sub & codes.TRACE_BEVEL) != 0:
        n = bevel(scene, point, a[0], word[3], DIMENSION_RAYS + pc, rays)
        if given:
            n = normalize_or(xyz(b) + n - point.normal, n)
        return extend(n)
    normal = point.normal
    if given:
        normal = wp.normalize(xyz(b))
    return broadcast(occlusion(scene, point, sub, a[0], normal, word[3], DIMENSION_RAYS + pc, rays))


@wp.func
def program_start(scene: Scene, material: int) -> int:
    """Return the first instruction of a material's exact program, of its surface program without one."""
    start = scene.materials.materials[material].surface_start
    if (scene.materials.materials[material].flags & MATERIAL_EXACT) != 0:
        start = scene.materials.code[start - 1][1]
    return start


@wp.func
def run_exact(scene: Scene, point: ShadingPoint, start: int, u: float, rays: Rays) -> Closure:
    """Run a surface program as nodes.run does, which says more of it."""
    registers = wp.zeros(shape=(32,), dtype=wp.vec4)
    closure = empty_closure(point)
    random = float(u)
    total = float(0.0)
    drawn = float(0.0)
    pc = int(start)
    while True:
        word = scene.materials.code[pc]
        op = word[0] & 255
        if op == codes.OP_END:
            break
        a = fetch(registers, scene.materials.constants, word[1])
        b = fetch(registers, scene.materials.constants, word[2])
        c = fetch(registers, scene.materials.constants, word[3])
        if op == codes.OP_TRACE:
            registers[(word[0] >> 8) & 255] = trace(scene, point, word, a, b, pc - start, rays)
        elif op < codes.OP_EMIT:
            registers[(word[0] >> 8) & 255] = compute(scene, point, word, a, b, c)
        elif op == codes.OP_EMIT:
            closure.emission += xyz(a) * (b[0] * c[0])
        elif op == codes.OP_TRANSPARENT:
            closure.transparency += xyz(a) * b[0]
        elif op == codes.OP_HOLDOUT:
            closure.holdout += a[0]
        else:
            sub = (word[0] >> 16) & 65535
            weight = drawing_weight(scene.materials, registers, sub, pc + 1)
            total += weight
            if weight > 0.0:
                share = weight / total
                if random < share:
                    random = random / share
                    drawn = weight
                    closure = read_closure(point, scene.materials, registers, sub, pc + 1, closure)
                    closure.weight = xyz(argument(scene.materials, registers, pc + 1, codes.ARG_WEIGHT))
                else:
                    random = (random - share) / (1.0 - share)
            pc += word[2]
        pc += 1
    if drawn > 0.0:
        closure.weight = closure.weight * (total / drawn)
    return closure
