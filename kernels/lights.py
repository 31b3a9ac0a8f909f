# SPDX-License-Identifier: GPL-3.0-or-later
"""Light sampling: choose a lamp, an emissive triangle or the world, draw a direction; and the pdf of hits.

Lamps have Cycles' shapes and units (kernel/light/ of Cycles 5.2): spheres or disks that face the receiver, suns as
cones, one-sided rectangles and ellipses with a spread like a soft-box grid. Mesh emitters shine from both sides.
"""

from __future__ import annotations

import warp as wp

from .environment_table import environment_pdf, sample_environment
from .geometry_math import PI, TWO_PI, orthonormal_tangent, safe_sqrt
from .intersect import hit_error, world_vertex
from .light_tree import chance_by_tree, choose_by_tree
from .sampling import sample_alias, sample_cone, sample_disk, sample_sphere, sample_triangle
from .types import (
    LIGHT_AREA,
    LIGHT_ELLIPSE,
    LIGHT_ENVIRONMENT,
    LIGHT_HITTABLE,
    LIGHT_NO_SHADOW,
    LIGHT_SPHERE,
    LIGHT_SPOT,
    LIGHT_SUN,
    LIGHT_TRIANGLE,
    Light,
    Scene,
)

# Distance that stands for infinity; its square still fits a float.
FAR = wp.constant(1.0e18)


@wp.struct
class LightSample:
    """One direction towards a light."""

    kind: int
    """LIGHT_*, or -1 where nothing could be sampled"""
    wi: wp.vec3
    distance: float
    """Up to the light's surface; FAR for suns and the world"""
    radiance: wp.vec3
    """Arriving radiance (delta lights: already divided by distance squared); 1 where a program must be evaluated"""
    pdf: float
    """Solid angle, choice of the light included; for delta lights the choice alone"""
    delta: int
    """1: rays can't meet this light: no multiple importance sampling"""
    shadow: int
    """0: casts no shadow"""
    visibility: int
    error: float
    """Float error of the sampled point along `normal`"""
    normal: wp.vec3
    """Of the light's surface, towards the receiver"""
    instance: int
    triangle: int
    u: float
    v: float


@wp.struct
class LampHit:
    """Where a ray meets a lamp."""

    t: float
    """Below 0: it does not"""
    radiance: wp.vec3
    pdf: float
    """Of sampling this direction by light sampling, without the choice of the lamp"""


@wp.func
def spot_attenuation(light: Light, towards_receiver: wp.vec3) -> float:
    """Return the cone's factor for a direction leaving the lamp (Cycles: smoothstep in the cone's local cosine)."""
    if light.kind != LIGHT_SPOT:
        return 1.0
    local = wp.normalize(wp.vec3(
        wp.dot(towards_receiver, light.axis_u),
        wp.dot(towards_receiver, light.axis_v),
        wp.dot(towards_receiver, light.direction)))
    x = wp.clamp((local[2] - light.spot_cos) * light.spot_smooth, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


@wp.func
def spread_attenuation(light: Light, towards_receiver: wp.vec3) -> float:
    """Return an area lamp's factor for a direction leaving it."""
    cosine = wp.dot(towards_receiver, light.direction)
    if cosine <= 0.0:
        return 0.0
    if light.spread_norm == 0.0:
        return 1.0
    tangent = safe_sqrt(1.0 - cosine * cosine) / cosine
    return wp.max((light.spread_tan - tangent) * light.spread_norm, 0.0)


@wp.func
def one_minus_cos_of_sphere(ratio_squared: float) -> float:
    """Return 1 - cos of the half angle of a sphere of (radius / distance)^2, exact for small ones."""
    cosine = safe_sqrt(1.0 - ratio_squared)
    return ratio_squared / (1.0 + cosine)


@wp.func
def sample_round_lamp(light: Light, position: wp.vec3, u: wp.vec2, sample: LightSample) -> LightSample:
    """Sample a point or spot lamp."""
    s = sample
    to_light = light.position - position
    d2 = wp.dot(to_light, to_light)
    if d2 <= 0.0:
        s.kind = -1
        return s
    d = wp.sqrt(d2)
    axis = to_light / d
    r2 = light.radius * light.radius
    s.normal = -axis
    if r2 == 0.0:
        s.wi = axis
        s.distance = d
        s.radiance = light.radiance * (spot_attenuation(light, -axis) / d2)
        s.pdf = 1.0
        s.delta = 1
        return s
    if (light.flags & LIGHT_SPHERE) != 0:
        if d2 > r2:
            omc = one_minus_cos_of_sphere(r2 / d2)
            s.wi = sample_cone(axis, omc, u)
            s.pdf = 1.0 / (TWO_PI * omc)
            cosine = wp.dot(s.wi, axis)
            s.distance = d * cosine - safe_sqrt(r2 - d2 * (1.0 - cosine * cosine))
            s.radiance = light.radiance * spot_attenuation(light, -s.wi)
        else:
            s.wi = sample_sphere(u)
            s.pdf = 1.0 / (4.0 * PI)
            along = wp.dot(s.wi, to_light)
            s.distance = along + safe_sqrt(r2 - d2 + along * along)
            s.radiance = light.radiance
        return s
    disk = sample_disk(u) * light.radius
    tangent = orthonormal_tangent(axis)
    target = to_light + tangent * disk[0] + wp.cross(axis, tangent) * disk[1]
    s.distance = wp.length(target)
    s.wi = target / s.distance
    cosine = wp.max(wp.dot(s.wi, axis), 1.0e-7)
    s.pdf = s.distance * s.distance / (cosine * PI * r2)
    s.radiance = light.radiance * spot_attenuation(light, -s.wi)
    return s


@wp.func
def sample_area_lamp(light: Light, position: wp.vec3, u: wp.vec2, sample: LightSample) -> LightSample:
    """Sample a rectangle or an ellipse by area."""
    s = sample
    offset = light.axis_u * (u[0] - 0.5) + light.axis_v * (u[1] - 0.5)
    if (light.flags & LIGHT_ELLIPSE) != 0:
        disk = sample_disk(u) * 0.5
        offset = light.axis_u * disk[0] + light.axis_v * disk[1]
    target = light.position + offset - position
    s.distance = wp.length(target)
    if s.distance <= 0.0:
        s.kind = -1
        return s
    s.wi = target / s.distance
    cosine = -wp.dot(s.wi, light.direction)
    if cosine <= 1.0e-7:
        s.kind = -1
        return s
    s.normal = light.direction
    s.pdf = s.distance * s.distance / (cosine * light.area)
    s.radiance = light.radiance * spread_attenuation(light, -s.wi)
    return s


@wp.func
def sample_lamp(light: Light, position: wp.vec3, u: wp.vec2) -> LightSample:
    """Draw a direction from `position` to a lamp."""
    s = LightSample()
    s.kind = light.kind
    s.shadow = wp.where((light.flags & LIGHT_NO_SHADOW) != 0, 0, 1)
    s.visibility = light.visibility
    s.delta = wp.where((light.flags & LIGHT_HITTABLE) != 0, 0, 1)
    s.error = 0.0
    if light.kind == LIGHT_SUN:
        s.distance = FAR
        s.normal = light.direction
        s.radiance = light.radiance
        if light.one_minus_cos > 0.0:
            s.wi = sample_cone(-light.direction, light.one_minus_cos, u)
            s.pdf = 1.0 / (TWO_PI * light.one_minus_cos)
        else:
            s.wi = -light.direction
            s.pdf = 1.0
            s.delta = 1
        return s
    if light.kind == LIGHT_AREA:
        return sample_area_lamp(light, position, u, s)
    return sample_round_lamp(light, position, u, s)


@wp.func
def sample_emitter(scene: Scene, emitter: int, position: wp.vec3, u: wp.vec2) -> LightSample:
    """Draw a direction to an emissive triangle, uniform by area; the radiance is left to its material."""
    geometry = scene.geometry
    s = LightSample()
    s.kind = LIGHT_TRIANGLE
    s.shadow = 1
    s.delta = 0
    face = scene.lights.triangles[emitter]
    s.instance = face[0]
    s.triangle = face[1]
    s.visibility = geometry.instances[s.instance].visibility
    to_world = geometry.instances[s.instance].to_world
    vertices = geometry.triangles[s.triangle]
    p0 = world_vertex(geometry, to_world, vertices[0])
    p1 = world_vertex(geometry, to_world, vertices[1])
    p2 = world_vertex(geometry, to_world, vertices[2])
    b = sample_triangle(u)
    s.u = b[0]
    s.v = b[1]
    target = p0 * (1.0 - b[0] - b[1]) + p1 * b[0] + p2 * b[1] - position
    s.distance = wp.length(target)
    double_area_normal = wp.cross(p1 - p0, p2 - p0)
    double_area = wp.length(double_area_normal)
    if s.distance <= 0.0 or double_area <= 0.0:
        s.kind = -1
        return s
    s.wi = target / s.distance
    s.normal = double_area_normal / double_area
    cosine = -wp.dot(s.wi, s.normal)
    if cosine < 0.0:
        s.normal = -s.normal
        cosine = -cosine
    if cosine <= 1.0e-7:
        s.kind = -1
        return s
    s.pdf = s.distance * s.distance / (cosine * 0.5 * double_area)
    s.radiance = wp.vec3(1.0, 1.0, 1.0)
    s.error = hit_error(p0, p1, p2, b[0], b[1], s.normal, to_world)
    return s


@wp.func
def sample_light(scene: Scene, position: wp.vec3, choice: float, place: wp.vec2, u: wp.vec2) -> LightSample:
    """Choose one light and draw a direction to it; pdf includes the choice.

    Args:
        scene: The scene.
        position: Where light arrives.
        choice: Picks the class.
        place: Picks the local light, or the texel of the world's table.
        u: Place the direction.
    """
    lights = scene.lights
    chosen = sample_alias(lights.probability, lights.alias, lights.class_count, choice)
    chance = lights.weight[chosen]
    s = LightSample()
    if chosen == lights.environment_class:
        s.kind = LIGHT_ENVIRONMENT
        s.wi = sample_environment(scene.environment, place, u)
        s.pdf = environment_pdf(scene.environment, s.wi)
        s.distance = FAR
        s.radiance = wp.vec3(1.0, 1.0, 1.0)
        s.shadow = 1
        s.visibility = scene.environment.visibility
        s.normal = -s.wi
    else:
        lamp = lights.local_lamp_count + chosen - 1
        if chosen == 0:
            local = choose_by_tree(lights.tree, position, place)
            lamp = local.entry
            chance = chance * local.chance
        if lamp < 0:
            s.kind = -1
            return s
        if lamp < lights.lamp_count and (chosen > 0 or lamp < lights.local_lamp_count):
            s = sample_lamp(lights.lamps[lamp], position, u)
        else:
            s = sample_emitter(scene, lamp - lights.local_lamp_count, position, u)
    s.pdf = s.pdf * chance
    if not (s.pdf > 0.0):
        s.kind = -1
    return s


@wp.func
def lamp_chance(scene: Scene, lamp: int, position: wp.vec3) -> float:
    """Return the probability with which sample_light chooses a lamp."""
    lights = scene.lights
    if lamp < lights.local_lamp_count:
        return lights.weight[0] * chance_by_tree(lights.tree, lamp, position)
    return lights.weight[1 + lamp - lights.local_lamp_count]


@wp.func
def round_lamp_hit(light: Light, to_light: wp.vec3, direction: wp.vec3, t_max: float) -> LampHit:
    """Intersect a ray with a point or spot lamp: a sphere, or the disk that faces the ray's origin."""
    hit = LampHit()
    hit.t = -1.0
    d2 = wp.dot(to_light, to_light)
    r2 = light.radius * light.radius
    along = wp.dot(direction, to_light)
    if light.kind == LIGHT_SPOT and along <= 0.0:
        return hit
    if (light.flags & LIGHT_SPHERE) != 0:
        miss2 = d2 - along * along
        if miss2 > r2:
            return hit
        half = safe_sqrt(r2 - miss2)
        t = wp.where(d2 > r2, along - half, along + half)
        if t <= 0.0 or t >= t_max:
            return hit
        hit.t = t
        hit.pdf = 1.0 / (4.0 * PI)
        hit.radiance = light.radiance
        if d2 > r2:
            hit.pdf = 1.0 / (TWO_PI * one_minus_cos_of_sphere(r2 / d2))
            hit.radiance = light.radiance * spot_attenuation(light, -direction)
        return hit
    if along <= 0.0 or d2 <= 0.0:
        return hit
    t = d2 / along
    offset = direction * t - to_light
    if t >= t_max or wp.dot(offset, offset) > r2:
        return hit
    hit.t = t
    hit.radiance = light.radiance * spot_attenuation(light, -direction)
    hit.pdf = t * t / (along / wp.sqrt(d2) * PI * r2)
    return hit


@wp.func
def lamp_hit(light: Light, origin: wp.vec3, direction: wp.vec3, t_max: float) -> LampHit:
    """Intersect a ray with one lamp of finite size."""
    hit = LampHit()
    hit.t = -1.0
    if light.kind == LIGHT_SUN:
        # Compare chords, not cosines: 1 - cos of a narrow sun vanishes in float.
        chord = direction + light.direction
        if t_max >= FAR and 0.5 * wp.dot(chord, chord) <= light.one_minus_cos:
            hit.t = FAR
            hit.radiance = light.radiance
            hit.pdf = 1.0 / (TWO_PI * light.one_minus_cos)
        return hit
    to_light = light.position - origin
    if light.kind == LIGHT_AREA:
        cosine = -wp.dot(direction, light.direction)
        if cosine <= 1.0e-7:
            return hit
        t = -wp.dot(to_light, light.direction) / cosine
        if t <= 0.0 or t >= t_max:
            return hit
        local = direction * t - to_light
        x = wp.dot(local, light.axis_u) / wp.max(wp.dot(light.axis_u, light.axis_u), 1.0e-30)
        y = wp.dot(local, light.axis_v) / wp.max(wp.dot(light.axis_v, light.axis_v), 1.0e-30)
        inside = wp.abs(x) <= 0.5 and wp.abs(y) <= 0.5
        if (light.flags & LIGHT_ELLIPSE) != 0:
            inside = x * x + y * y <= 0.25
        if inside:
            hit.t = t
            hit.radiance = light.radiance * spread_attenuation(light, -direction)
            hit.pdf = t * t / (cosine * light.area)
        return hit
    return round_lamp_hit(light, to_light, direction, t_max)


@wp.func
def emitter_pdf(scene: Scene, instance: int, triangle: int, origin: wp.vec3, direction: wp.vec3, t: float) -> float:
    """Return the pdf of light sampling for a ray that met a triangle at distance t; 0 if it is not sampled."""
    lights = scene.lights
    geometry = scene.geometry
    if lights.class_count == 0:
        return 0.0
    first = lights.emitter_offset[instance]
    if first < 0:
        return 0.0
    emitter = lights.emitter_index[first + triangle - geometry.instances[instance].triangle_offset]
    if emitter < 0:
        return 0.0
    to_world = geometry.instances[instance].to_world
    vertices = geometry.triangles[triangle]
    p0 = world_vertex(geometry, to_world, vertices[0])
    p1 = world_vertex(geometry, to_world, vertices[1])
    p2 = world_vertex(geometry, to_world, vertices[2])
    double_area_normal = wp.cross(p1 - p0, p2 - p0)
    projected = 0.5 * wp.abs(wp.dot(double_area_normal, direction))
    if projected <= 0.0:
        return 0.0
    chance = lights.weight[0] * chance_by_tree(lights.tree, lights.local_lamp_count + emitter, origin)
    return chance * t * t / projected
