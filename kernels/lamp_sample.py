# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing a direction to a lamp.

Lamps have Cycles' shapes and units (kernel/light/ of Cycles 5.2): spheres or disks that face the receiver, suns as
cones, one-sided rectangles and ellipses with a spread like a soft-box grid.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import PI, TWO_PI, orthonormal_tangent, safe_sqrt
from .lamp_hit import FAR, one_minus_cos_of_sphere, spot_attenuation, spread_attenuation
from .sampling import sample_cone, sample_disk, sample_sphere
from .solid_angle import is_close, sample_spherical_rectangle, sampled_angle, spherical_rectangle
from .types import (
    LIGHT_AREA,
    LIGHT_ELLIPSE,
    LIGHT_HITTABLE,
    LIGHT_NO_SHADOW,
    LIGHT_SPHERE,
    LIGHT_SUN,
    Light,
)


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
    brightness: float
    """About what a program or the emission of a triangle's material will tell; 1 where `radiance` is all"""
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


@wp.func
def no_light() -> LightSample:
    """Return the sample of no light."""
    s = LightSample()
    s.kind = -1
    return s


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
    """Sample an ellipse by area, a rectangle by solid angle where it is near (see lamp_hit.area_lamp_pdf)."""
    s = sample
    to_light = light.position - position
    target = to_light + light.axis_u * (u[0] - 0.5) + light.axis_v * (u[1] - 0.5)
    angle = float(0.0)
    if (light.flags & LIGHT_ELLIPSE) != 0:
        disk = sample_disk(u) * 0.5
        target = to_light + light.axis_u * disk[0] + light.axis_v * disk[1]
    elif is_close(to_light, light.axis_u, light.axis_v):
        seen = spherical_rectangle(to_light, light.axis_u, light.axis_v)
        angle = sampled_angle(seen.angle)
        if angle > 0.0:
            direction = sample_spherical_rectangle(seen, u)
            # Away from the light it shines nowhere; towards it the plane is met.
            target = direction * wp.max(
                wp.dot(to_light, light.direction) / wp.min(wp.dot(direction, light.direction), -1.0e-7), 0.0)
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
    if angle > 0.0:
        s.pdf = 1.0 / angle
    s.radiance = light.radiance * spread_attenuation(light, -s.wi)
    return s


@wp.func
def sample_lamp(light: Light, position: wp.vec3, u: wp.vec2) -> LightSample:
    """Draw a direction from `position` to a lamp."""
    s = LightSample()
    s.kind = light.kind
    s.brightness = 1.0
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
