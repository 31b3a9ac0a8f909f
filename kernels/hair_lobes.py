# SPDX-License-Identifier: GPL-3.0-or-later
"""Light scattered by a hair: lobes of what is reflected (R), passes (TT), is reflected within (TRT), and the rest.

The model of d'Eon, Francois, Hill, Letteri and Aubry, "An Energy-Conserving Hair Reflectance Model" (EGSR 2011), in the
near field and with the parameters of Chiang, Bitterli, Tappan and Burley, "A Practical and Controllable Hair and Fur
Model for Production Path Tracing" (EG 2016): a lobe is its attenuation times Mp, along the strand, times Np, around it.
Where the two leave a choice it is that of Cycles' Principled Hair BSDF (model CHIANG), so that hair looks alike in
both. A strand is met once: entering and leaving light is one event at the point where a ray comes to it.
"""

from __future__ import annotations

import warp as wp

from .fresnel import fresnel_dielectric
from .geometry_math import PI, TWO_PI, mean_component, normalize_or, orthonormal_tangent, safe_sqrt, sqr
from .shading_types import BsdfSample, BsdfValue, Closure, ShadingPoint
from .types import VISIBLE_GLOSSY, VISIBLE_TRANSMISSION

INV_TWO_PI = wp.constant(0.15915494309189535)
ROOT_PI_8 = wp.constant(0.6266570686577501)
"""From the standard deviation of a normal distribution to a logistic one's scale of the same height"""

APOTHEM = wp.constant(0.8660254037844387)
"""Of a hexagon, tubes' cross-section, whose corners are at a distance of 1"""

ROUGHNESS_MIN = wp.constant(0.001)
NUMBER_MIN = wp.constant(1.0e-5)
"""Of random numbers whose logarithm is taken"""


@wp.struct
class HairLobes:
    """A hair's lobes for one view."""

    along: wp.vec3
    """Unit, along the strand"""
    across: wp.vec3
    """Unit, perpendicular to that and to the view"""
    towards: wp.vec3
    """Unit, perpendicular to both, on the viewer's side"""
    sin_o: float
    """Of the view's angle to the plane across the strand"""
    cos_o: float
    gamma_o: float
    """Angle [rad] to the strand's normal at which a ray comes in, seen along the strand"""
    gamma_t: float
    """The same of the refracted ray"""
    tilt: float
    """By which scales of the hair lean to its root [rad]"""
    scale: float
    """Of the logistic distribution around the strand"""
    variance: float
    """Along it: a quarter of it for TT, four times as much for TRT and the rest"""
    variance_r: float
    weight: wp.vec3
    reflected: wp.vec3
    """Attenuations"""
    passed: wp.vec3
    returned: wp.vec3
    rest: wp.vec3
    odds: wp.vec4
    """Of sampling R, TT, TRT and the rest; sum 1, or 0 for black hair"""


@wp.func
def power_of(x: float, n: int) -> float:
    """Return x to the power of a whole number."""
    result = float(1.0)
    for _i in range(n):
        result = result * x
    return result


@wp.func
def longitudinal_variance(roughness: float) -> float:
    """Return the variance of Mp (Chiang et al. 2016, eq. 7)."""
    r = wp.clamp(roughness, ROUGHNESS_MIN, 1.0)
    return sqr(0.726 * r + 0.812 * sqr(r) + 3.7 * power_of(r, 20))


@wp.func
def azimuthal_scale(roughness: float) -> float:
    """Return the logistic scale of Np (Chiang et al. 2016, eq. 8)."""
    r = wp.clamp(roughness, ROUGHNESS_MIN, 1.0)
    return (0.265 * r + 1.194 * sqr(r) + 5.372 * power_of(r, 22)) * ROOT_PI_8


@wp.func
def log_bessel(x: float) -> float:
    """Return ln(I0(x) exp(-x)) of the modified Bessel function, x >= 0 (Abramowitz and Stegun, 9.8.1 and 9.8.2)."""
    if x < 3.75:
        t = sqr(x / 3.75)
        high = 0.2659732 + t * (0.0360768 + t * 0.0045813)
        return wp.log(1.0 + t * (3.5156229 + t * (3.0899424 + t * (1.2067492 + t * high)))) - x
    t = 3.75 / x
    high = 0.00916281 + t * (-0.02057706 + t * (0.02635537 + t * (-0.01647633 + t * 0.00392377)))
    low = 0.39894228 + t * (0.01328592 + t * (0.00225319 + t * (-0.00157565 + t * high)))
    return wp.log(low / wp.sqrt(x))


@wp.func
def longitudinal(sin_i: float, cos_i: float, sin_o: float, cos_o: float, v: float) -> float:
    """Return Mp (d'Eon et al. 2011, eq. 7), whose integral over cos(theta) d(theta) is 1.

    The exponents' difference is half the squared distance of two points of the unit circle: no difference of large
    numbers where the variance v is small.
    """
    apart = 0.5 * (sqr(cos_i - cos_o) + sqr(sin_i + sin_o)) / v
    return wp.exp(log_bessel(cos_i * cos_o / v) - apart) / (v * (1.0 - wp.exp(-2.0 / v)))


@wp.func
def wrapped(angle: float) -> float:
    """Return an angle between -pi and pi."""
    return angle - TWO_PI * wp.floor((angle + PI) / TWO_PI)


@wp.func
def azimuthal(phi: float, s: float) -> float:
    """Return the logistic distribution of a scale s, trimmed to -pi..pi (Chiang et al. 2016, eq. 6)."""
    e = wp.exp(-wp.abs(wrapped(phi)) / s)
    return e / (s * sqr(1.0 + e) * wp.tanh(PI / (2.0 * s)))


@wp.func
def sample_azimuthal(u: float, s: float) -> float:
    """Return an angle by that distribution."""
    inside = wp.tanh(PI / (2.0 * s))
    share = u * inside + 0.5 * (1.0 - inside)
    return wp.clamp(s * wp.log(share / wp.max(1.0 - share, 1.0e-20)), -PI, PI)


@wp.func
def turned(lobes: HairLobes, order: int) -> float:
    """Return by how much a lobe that has crossed the hair `order` times turns light around the strand [rad]."""
    p = float(order)
    return 2.0 * p * lobes.gamma_t - 2.0 * lobes.gamma_o + p * PI


@wp.func
def strand_offset(point: ShadingPoint, along: wp.vec3, across: wp.vec3) -> float:
    """Return how far from a strand's axis a ray comes to it, from -1 to 1 over the width that it shows.

    Of tubes of six sides, whose corners' normals lead away from the axis: the interpolated normal, its end put on the
    hexagon again, tells where the point lies. Over the outline's width offsets are as even as over a round strand's.
    """
    face = normalize_or(point.geometric_normal - along * wp.dot(along, point.geometric_normal), point.normal)
    smooth = point.normal - along * wp.dot(along, point.normal)
    cosine = wp.abs(wp.dot(face, across))
    sine = safe_sqrt(1.0 - sqr(cosine))
    half_width = wp.max(sine, APOTHEM * cosine + 0.5 * sine)
    place = wp.dot(smooth, across) * APOTHEM / wp.max(wp.dot(smooth, face), 0.1)
    return wp.clamp(-place / half_width, -1.0, 1.0)


@wp.func
def hair_lobes(closure: Closure, point: ShadingPoint) -> HairLobes:
    """Return the lobes of a hair closure (closure_arguments.HAIR_ARGUMENTS tells what is where) at a point."""
    across = normalize_or(wp.cross(closure.normal, point.wo), orthonormal_tangent(closure.normal))
    return lobes_at(closure, point.wo, across, strand_offset(point, closure.normal, across))


@wp.func
def lobes_at(closure: Closure, wo: wp.vec3, across: wp.vec3, h: float) -> HairLobes:
    """Return the lobes for a ray that comes in at an offset h from the strand's axis."""
    lobes = HairLobes()
    lobes.along = closure.normal
    lobes.across = across
    lobes.towards = wp.cross(across, closure.normal)
    lobes.sin_o = wp.clamp(wp.dot(closure.normal, wo), -1.0, 1.0)
    lobes.cos_o = safe_sqrt(1.0 - sqr(lobes.sin_o))
    lobes.variance = longitudinal_variance(closure.roughness)
    # What the coat makes of it comes first, as of the roughness's own limits.
    lobes.variance_r = longitudinal_variance(
        wp.clamp(closure.roughness, ROUGHNESS_MIN, 1.0) * wp.clamp(closure.film_thickness, 0.0, 1.0))
    lobes.scale = azimuthal_scale(closure.anisotropic)
    lobes.tilt = closure.anisotropic_rotation
    eta = wp.max(closure.ior, 1.0e-3)
    sin_t = wp.clamp(lobes.sin_o / eta, -1.0, 1.0)
    cos_t = wp.max(safe_sqrt(1.0 - sqr(sin_t)), 1.0e-4)
    sin_gamma_t = wp.clamp(h * lobes.cos_o / wp.sqrt(wp.max(sqr(eta) - sqr(lobes.sin_o), 1.0e-8)), -1.0, 1.0)
    lobes.gamma_o = wp.asin(h)
    lobes.gamma_t = wp.asin(sin_gamma_t)
    f = fresnel_dielectric(lobes.cos_o * safe_sqrt(1.0 - sqr(h)), eta)[0]
    factors = wp.max(closure.color, wp.vec3(0.0, 0.0, 0.0))
    depth = 2.0 * safe_sqrt(1.0 - sqr(sin_gamma_t)) / cos_t
    lobes.weight = wp.max(closure.weight, wp.vec3(0.0, 0.0, 0.0))
    lobes.reflected = wp.vec3(f, f, f)
    for c in range(3):
        t = wp.exp(-wp.max(closure.tangent[c], 0.0) * depth)
        lobes.passed[c] = sqr(1.0 - f) * t
        lobes.returned[c] = lobes.passed[c] * t * f
        lobes.rest[c] = lobes.returned[c] * t * f / wp.max(1.0 - t * f, 1.0e-6)
    lobes.reflected = lobes.reflected * factors[0]
    lobes.passed = lobes.passed * factors[1]
    lobes.returned = lobes.returned * factors[2]
    lobes.rest = lobes.rest * factors[2]
    odds = wp.vec4(
        mean_component(lobes.reflected), mean_component(lobes.passed), mean_component(lobes.returned),
        mean_component(lobes.rest))
    lobes.odds = odds / wp.max(odds[0] + odds[1] + odds[2] + odds[3], 1.0e-20)
    return lobes


@wp.func
def hair_albedo(closure: Closure, lobes: HairLobes) -> wp.vec3:
    """Return what Cycles' Glossy Color shows of hair: what is reflected here, and the color of much hair.

    That is the fit of Chiang et al. 2016, section 4.2; measured, it is that of the variance along the strand.
    """
    x = lobes.variance
    scale = 5.969 + x * (-0.215 + x * (2.532 + x * (-10.73 + x * (5.574 + x * 0.245))))
    albedo = lobes.reflected
    for c in range(3):
        albedo[c] = albedo[c] + wp.exp(-wp.sqrt(wp.max(closure.tangent[c], 0.0)) * scale)
    return wp.cw_mul(lobes.weight, albedo)


@wp.func
def tilted(sin_i: float, cos_i: float, angle: float) -> wp.vec2:
    """Return sine and cosine of an angle turned by another, the cosine without its sign."""
    s = wp.sin(angle)
    c = wp.cos(angle)
    return wp.vec2(sin_i * c + cos_i * s, wp.abs(cos_i * c - sin_i * s))


@wp.func
def lobe_density(lobes: HairLobes, sin_i: float, cos_i: float, phi: float, order: int, tilt: float, v: float) -> float:
    """Return Mp Np of R, TT or TRT [1/sr] for an angle to the plane across the strand, and one around it."""
    angle = tilted(sin_i, cos_i, tilt)
    m = longitudinal(angle[0], angle[1], lobes.sin_o, lobes.cos_o, v)
    return m * azimuthal(phi - turned(lobes, order), lobes.scale)


@wp.func
def evaluate_angles(lobes: HairLobes, sin_i: float, cos_i: float, phi: float) -> BsdfValue:
    """Return the value and the density for the angles of a direction."""
    v = lobes.variance
    r = lobe_density(lobes, sin_i, cos_i, phi, 0, 2.0 * lobes.tilt, lobes.variance_r)
    tt = lobe_density(lobes, sin_i, cos_i, phi, 1, -lobes.tilt, 0.25 * v)
    trt = lobe_density(lobes, sin_i, cos_i, phi, 2, -4.0 * lobes.tilt, 4.0 * v)
    rest = longitudinal(sin_i, cos_i, lobes.sin_o, lobes.cos_o, 4.0 * v) * INV_TWO_PI
    value = BsdfValue()
    value.f = wp.cw_mul(
        lobes.weight, lobes.reflected * r + lobes.passed * tt + lobes.returned * trt + lobes.rest * rest)
    value.pdf = wp.dot(lobes.odds, wp.vec4(r, tt, trt, rest))
    return value


@wp.func
def evaluate_hair(lobes: HairLobes, wi: wp.vec3) -> BsdfValue:
    """Return f cos and the density of sample_hair for light from `wi`, which is nowhere diffuse."""
    sin_i = wp.clamp(wp.dot(lobes.along, wi), -1.0, 1.0)
    phi = wp.atan2(wp.dot(lobes.across, wi), wp.dot(lobes.towards, wi))
    return evaluate_angles(lobes, sin_i, safe_sqrt(1.0 - sqr(sin_i)), phi)


@wp.func
def sample_hair(lobes: HairLobes, u: wp.vec2, choice: float) -> BsdfSample:
    """Draw a direction; density 0 means absorbed.

    Args:
        lobes: For the view.
        u: In [0, 1)^2: the angle around the strand, and which way light leaves its cone.
        choice: In [0, 1): picks the lobe; what is left of it places the cone (d'Eon, Marschner and Hanika 2013,
            "Importance Sampling for Physically-Based Hair Fiber Models").
    """
    sample = BsdfSample()
    total = lobes.odds[0] + lobes.odds[1] + lobes.odds[2] + lobes.odds[3]
    if not total > 0.0:
        return sample
    order = int(0)
    number = choice * total
    while order < 3 and number >= lobes.odds[order]:
        number = number - lobes.odds[order]
        order = order + 1
    number = wp.clamp(number / wp.max(lobes.odds[order], 1.0e-20), NUMBER_MIN, 1.0)
    v = lobes.variance_r
    tilt = -2.0 * lobes.tilt
    if order == 1:
        v = 0.25 * lobes.variance
        tilt = lobes.tilt
    elif order > 1:
        v = 4.0 * lobes.variance
        tilt = wp.where(order == 2, 4.0 * lobes.tilt, 0.0)
    cosine = 1.0 + v * wp.log(number + (1.0 - number) * wp.exp(-2.0 / v))
    sin_i = wp.clamp(
        safe_sqrt(1.0 - sqr(cosine)) * wp.cos(TWO_PI * u[1]) * lobes.cos_o - cosine * lobes.sin_o, -1.0, 1.0)
    angle = tilted(sin_i, safe_sqrt(1.0 - sqr(sin_i)), tilt)
    phi = TWO_PI * u[0]
    if order < 3:
        phi = turned(lobes, order) + sample_azimuthal(u[0], lobes.scale)
    value = evaluate_angles(lobes, angle[0], angle[1], phi)
    if not value.pdf > 0.0:
        return sample
    sample.wi = wp.normalize(
        lobes.along * angle[0] + (lobes.across * wp.sin(phi) + lobes.towards * wp.cos(phi)) * angle[1])
    sample.pdf = value.pdf
    sample.weight = value.f / value.pdf
    sample.kind = wp.where(order == 0, VISIBLE_GLOSSY, VISIBLE_TRANSMISSION)
    sample.roughness = 1.0
    return sample
