# SPDX-License-Identifier: GPL-3.0-or-later
"""Where rays meet lamps, and how much a lamp's cone or spread lets through in a direction.

Lamps have Cycles' shapes and units, see lamp_sample.py.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import PI, TWO_PI, safe_sqrt
from .solid_angle import is_close, sampled_angle, spherical_rectangle
from .types import LIGHT_AREA, LIGHT_ELLIPSE, LIGHT_SPHERE, LIGHT_SPOT, LIGHT_SUN, Light

# Distance that stands for infinity; its square still fits a float.
FAR = wp.constant(1.0e18)


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
def area_lamp_pdf(light: Light, to_light: wp.vec3, t: float, cosine: float) -> float:
    """Return the pdf of drawing a direction to an area lamp.

    Args:
        light: The lamp.
        to_light: From the receiver to its centre [m].
        t: To the point that is met [m].
        cosine: Of the direction at the lamp.
    """
    if (light.flags & LIGHT_ELLIPSE) == 0 and is_close(to_light, light.axis_u, light.axis_v):
        angle = sampled_angle(spherical_rectangle(to_light, light.axis_u, light.axis_v).angle)
        if angle > 0.0:
            return 1.0 / angle
    return t * t / (cosine * light.area)


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
            hit.pdf = area_lamp_pdf(light, to_light, t, cosine)
        return hit
    return round_lamp_hit(light, to_light, direction, t_max)
