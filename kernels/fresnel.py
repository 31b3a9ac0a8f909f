# SPDX-License-Identifier: GPL-3.0-or-later
"""Fresnel reflectance: dielectrics, F82-tint metals and the generalised Schlick model, with their averages.

Pure functions of a cosine; they know no roughness and no table. The formulas are the textbook ones in the choice
that Cycles makes (kernel/closure/bsdf_util.h), so that a material looks alike in both.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import safe_sqrt, sqr

# (6/7)**5 and 7 / (6/7)**6: Schlick's curve and the F82 factor at cos = 1/7, where metals dip (about 82 degrees).
SCHLICK_AT_82 = wp.constant(0.46266436)
F82_SCALE = wp.constant(17.6512889)


# Of grazing_share, for dielectrics: weight of its second term, and F90 with that.
DIELECTRIC_BEND = wp.constant(0.75)
DIELECTRIC_F90 = wp.constant(0.92)
# F0 by F90 up to which a lobe is a dielectric's; from twice as much on it is a metal's.
DIELECTRIC_RATIO = wp.constant(0.15)
# Index whose albedos stand for those of grazing_share.
DIELECTRIC_IOR = wp.constant(1.5)


@wp.func
def mix3(a: wp.vec3, b: wp.vec3, t: float) -> wp.vec3:
    """Return a + (b - a) t."""
    return a * (1.0 - t) + b * t


@wp.func
def saturate3(v: wp.vec3) -> wp.vec3:
    """Clamp every component to [0, 1]."""
    return wp.min(wp.max(v, wp.vec3(0.0)), wp.vec3(1.0))


@wp.func
def pow3(base: wp.vec3, exponent: float) -> wp.vec3:
    """Raise every component to a power."""
    return wp.vec3(wp.pow(base[0], exponent), wp.pow(base[1], exponent), wp.pow(base[2], exponent))


@wp.func
def f0_from_ior(ior: float) -> float:
    """Return the reflectance at normal incidence."""
    return sqr((ior - 1.0) / (ior + 1.0))


@wp.func
def ior_from_f0(f0: float) -> float:
    """Return the index (>= 1) that reflects f0 at normal incidence; f0 is capped at 0.99 as in Cycles."""
    root = wp.sqrt(wp.clamp(f0, 0.0, 0.99))
    return (1.0 + root) / (1.0 - root)


@wp.func
def fresnel_dielectric(cos_i: float, eta: float) -> wp.vec2:
    """Return (unpolarised reflectance, cosine of the refracted ray, >= 0); (1, 0) for total internal reflection.

    Args:
        cos_i: Cosine between normal and incident direction; its sign is ignored.
        eta: Index behind the surface over the index in front of it.
    """
    c = wp.abs(cos_i)
    under_root = sqr(eta) - (1.0 - sqr(c))
    if under_root <= 0.0:
        return wp.vec2(1.0, 0.0)
    eta_cos_t = safe_sqrt(under_root)
    cos_t = eta_cos_t / eta
    s = (c - eta_cos_t) / (c + eta_cos_t)
    p = (eta * c - cos_t) / (eta * c + cos_t)
    return wp.vec2(0.5 * (s * s + p * p), cos_t)


@wp.func
def fresnel_dielectric_average(eta: float) -> float:
    """Return the cosine-weighted mean reflectance (fit of Kulla and Conty, "Revisiting Physically Based Shading")."""
    if eta < 1.0:
        return 0.997118 + eta * (0.1014 - eta * (0.965241 + eta * 0.130607))
    return (eta - 1.0) / (4.08567 + 1.00071 * eta)


@wp.func
def schlick_weight(f: float, f0: float) -> float:
    """Return where f lies between f0 (0) and 1 (1)."""
    # At indices near 0 or infinity f0 rounds to 1 and leaves nothing to interpolate.
    return wp.clamp((f - f0) / wp.max(1.0 - f0, 1.0e-7), 0.0, 1.0)


@wp.func
def metal_part(f0: float, f90: float) -> float:
    """Return how far a lobe of such reflectances along the normal and at grazing angles is a metal's (1)."""
    return wp.clamp((f0 / wp.max(f90, 1.0e-6) - DIELECTRIC_RATIO) / DIELECTRIC_RATIO, 0.0, 1.0)


@wp.func
def grazing_share(cos_i: float, metal: float) -> float:
    """Return how far from F0 to F90 a facet reflects: Schlick's curve (1994) for metals.

    Dielectrics reflect up to a fifth more than that between 30 and 75 degrees. With a second term and an F90 of
    DIELECTRIC_F90 the curve is within 5 % of that of indices of 1.45 to 1.6, up to 80 degrees.
    """
    c = wp.clamp(cos_i, 0.0, 1.0)
    m = 1.0 - c
    return m * m * m * (m * m + DIELECTRIC_BEND * (1.0 - metal) * c * c)


@wp.func
def fresnel_generalized_schlick(cos_i: float, eta: float, f0: wp.vec3) -> wp.vec3:
    """Return the real dielectric curve of `eta`, rescaled to start at f0 (Cycles' exponent < 0)."""
    f = fresnel_dielectric(cos_i, eta)
    return mix3(f0, wp.vec3(1.0), schlick_weight(f[0], f0_from_ior(eta)))


@wp.func
def fresnel_generalized_schlick_average(eta: float, f0: wp.vec3) -> wp.vec3:
    """Return the cosine-weighted mean of fresnel_generalized_schlick."""
    return mix3(f0, wp.vec3(1.0), schlick_weight(fresnel_dielectric_average(eta), f0_from_ior(eta)))


@wp.func
def f82_tint_term(f0: wp.vec3, tint: wp.vec3) -> wp.vec3:
    """Return the b of fresnel_f82 for which the reflectance at 82 degrees is Schlick's times `tint`."""
    at_82 = mix3(f0, wp.vec3(1.0), SCHLICK_AT_82)
    return wp.cw_mul(at_82, wp.vec3(1.0) - tint) * F82_SCALE


@wp.func
def fresnel_f82(cos_i: float, f0: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Return the reflectance of a metal (Kutz et al., "Novel aspects of the Adobe Standard Material", 2021)."""
    m = wp.clamp(1.0 - cos_i, 0.0, 1.0)
    m5 = sqr(sqr(m)) * m
    return saturate3(mix3(f0, wp.vec3(1.0), m5) - b * (cos_i * m5 * m))


@wp.func
def fresnel_f82_average(f0: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Return the cosine-weighted mean of fresnel_f82 before its clamp."""
    return mix3(f0, wp.vec3(1.0), 1.0 / 21.0) - b * (1.0 / 126.0)
