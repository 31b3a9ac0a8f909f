# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's textures without noise: projections of images, ramps, checker, gradients, Fresnel weights.

Formulas follow Cycles 5.2: kernel/camera/projection.h, svm/image.h, ramp.h, checker.h, gradient.h, fresnel.h.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .fresnel import fresnel_dielectric
from .geometry_math import INV_PI, PI, TWO_PI
from .types import Materials, ShadingPoint


@wp.func
def project_sphere(co: wp.vec3) -> wp.vec2:
    """Return the UV of sphere projection about the centre of the unit cube."""
    p = (co - wp.vec3(0.5)) * 2.0
    length = wp.length(p)
    if length == 0.0:
        return wp.vec2(0.0, 0.0)
    u = wp.where(p[0] == 0.0 and p[1] == 0.0, 0.0, 0.5 - wp.atan2(p[0], p[1]) / TWO_PI)
    return wp.vec2(u, 1.0 - wp.acos(wp.clamp(p[2] / length, -1.0, 1.0)) * INV_PI)


@wp.func
def project_tube(co: wp.vec3) -> wp.vec2:
    """Return the UV of tube projection about the unit cube's vertical axis."""
    p = (co - wp.vec3(0.5)) * 2.0
    if p[0] == 0.0 and p[1] == 0.0:
        return wp.vec2(0.0, 0.0)
    return wp.vec2((1.0 - wp.atan2(p[0], p[1]) * INV_PI) * 0.5, (p[2] + 1.0) * 0.5)


@wp.func
def project_equirectangular(direction: wp.vec3) -> wp.vec2:
    """Return the UV of a direction on a latitude-longitude panorama; u falls with the azimuth."""
    length = wp.length(direction)
    if length == 0.0:
        return wp.vec2(0.0, 0.0)
    u = 0.5 - wp.atan2(direction[1], direction[0]) / TWO_PI
    return wp.vec2(u, 1.0 - wp.acos(wp.clamp(direction[2] / length, -1.0, 1.0)) * INV_PI)


@wp.func
def project_sky(direction: wp.vec3) -> wp.vec2:
    """Return the UV of a direction on the picture of a sky, whose rows crowd at the horizon (engine/sky)."""
    u = 0.5 - wp.atan2(direction[1], direction[0]) / TWO_PI
    share = wp.asin(wp.clamp(direction[2], -1.0, 1.0)) * (2.0 * INV_PI)
    return wp.vec2(u, 0.5 + 0.5 * wp.sign(share) * wp.sqrt(wp.abs(share)))


@wp.func
def project_mirror_ball(direction: wp.vec3) -> wp.vec2:
    """Return the UV of a direction on the photograph of a mirror ball taken along +y."""
    d = wp.normalize(direction)
    y = d[1] - 1.0
    divisor = 2.0 * wp.sqrt(wp.max(-0.5 * y, 0.0))
    if divisor > 0.0:
        d = d / divisor
    return wp.vec2(0.5 * (d[0] + 1.0), 0.5 * (d[2] + 1.0))


@wp.func
def project_image(projection: int, co: wp.vec4) -> wp.vec3:
    """Return UV and filter width in UV units of a coordinate (w: its width) under a projection."""
    p = wp.vec3(co[0], co[1], co[2])
    uv = wp.vec2(co[0], co[1])
    width = co[3]
    if projection == codes.PROJECTION_EQUIRECTANGULAR:
        uv = project_equirectangular(p)
        width = width / TWO_PI
    elif projection == codes.PROJECTION_SKY:
        uv = project_sky(p)
        width = width / TWO_PI
    elif projection == codes.PROJECTION_MIRROR_BALL:
        uv = project_mirror_ball(p)
        width = width * 0.25
    elif projection == codes.PROJECTION_SPHERE:
        uv = project_sphere(p)
        width = width * INV_PI
    elif projection == codes.PROJECTION_TUBE:
        uv = project_tube(p)
        width = width * INV_PI
    return wp.vec3(uv[0], uv[1], width)


@wp.func
def table_value(materials: Materials, offset: int, position: float, mode: int) -> wp.vec4:
    """Look up a table of RAMP_SIZE entries at 0..1, linearly unless constant; curves may extrapolate."""
    last = codes.RAMP_SIZE - 1
    if mode == codes.RAMP_CURVES_EXTRAPOLATED and position < 0.0:
        first = materials.ramps[offset]
        return first + (materials.ramps[offset + 1] - first) * (position * float(last))
    if mode == codes.RAMP_CURVES_EXTRAPOLATED and position > 1.0:
        end = materials.ramps[offset + last]
        return end + (end - materials.ramps[offset + last - 1]) * ((position - 1.0) * float(last))
    x = wp.clamp(position, 0.0, 1.0) * float(last)
    # The second clamp is for NaN, which passes the first.
    i = wp.clamp(int(x), 0, last)
    value = materials.ramps[offset + i]
    t = x - float(i)
    if mode != codes.RAMP_CONSTANT and t > 0.0 and i < last:
        value = value * (1.0 - t) + materials.ramps[offset + i + 1] * t
    return value


@wp.func
def ramp(materials: Materials, sub: int, offset: int, a: wp.vec4) -> wp.vec4:
    """Evaluate a colour ramp at a.x, or curves channel by channel (codes.RAMP_*)."""
    x = table_value(materials, offset, a[0], sub)
    if sub < codes.RAMP_CURVES:
        return x
    y = table_value(materials, offset, a[1], sub)
    z = table_value(materials, offset, a[2], sub)
    return wp.vec4(x[0], y[1], z[2], 0.0)


@wp.func
def checker(p: wp.vec3) -> float:
    """Return 1 in unit cells of odd parity, else 0; nudged so that whole coordinates don't flicker."""
    x = int(wp.abs(wp.floor((p[0] + 0.000001) * 0.999999)))
    y = int(wp.abs(wp.floor((p[1] + 0.000001) * 0.999999)))
    z = int(wp.abs(wp.floor((p[2] + 0.000001) * 0.999999)))
    return wp.where((x + y + z) % 2 == 0, 0.0, 1.0)


@wp.func
def gradient(sub: int, p: wp.vec3) -> float:
    """Return the gradient texture, 0..1."""
    x = p[0]
    f = x
    if sub == codes.PROCEDURAL_GRADIENT_QUADRATIC:
        r = wp.max(x, 0.0)
        f = r * r
    elif sub == codes.PROCEDURAL_GRADIENT_EASING:
        r = wp.clamp(x, 0.0, 1.0)
        f = r * r * (3.0 - 2.0 * r)
    elif sub == codes.PROCEDURAL_GRADIENT_DIAGONAL:
        f = (x + p[1]) * 0.5
    elif sub == codes.PROCEDURAL_GRADIENT_RADIAL:
        f = wp.atan2(p[1], x) / (2.0 * PI) + 0.5
    elif sub >= codes.PROCEDURAL_GRADIENT_QUADRATIC_SPHERE:
        # Unit vectors shall give exactly 0.
        f = wp.max(0.999999 - wp.length(p), 0.0)
        if sub == codes.PROCEDURAL_GRADIENT_QUADRATIC_SPHERE:
            f = f * f
    return wp.clamp(f, 0.0, 1.0)


@wp.func
def fresnel_weight(point: ShadingPoint, sub: int, value: float, normal_in: wp.vec3) -> float:
    """Evaluate Fresnel and Layer Weight: `value` is an IOR or a blend, `normal_in` 0 is the shading normal."""
    normal = wp.where(wp.length_sq(normal_in) > 0.0, normal_in, point.normal)
    cosine = wp.abs(wp.dot(point.wo, normal))
    if sub == codes.FRESNEL_FACING:
        blend = wp.clamp(value, 0.0, 1.0 - 1.0e-5)
        exponent = wp.where(blend < 0.5, 2.0 * blend, 0.5 / (1.0 - blend))
        return 1.0 - wp.pow(cosine, exponent)
    eta = wp.max(value, 1.0e-5)
    if sub == codes.FRESNEL_BLEND:
        eta = 1.0 / wp.max(1.0 - value, 1.0e-5)
    if point.backfacing != 0:
        eta = 1.0 / eta
    return fresnel_dielectric(wp.min(cosine, 1.0), eta)[0]
