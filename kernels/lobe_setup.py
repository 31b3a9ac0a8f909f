# SPDX-License-Identifier: GPL-3.0-or-later
"""What sets up single lobes of a BSDF: energy compensation, glass, thin walls, and shares of layers.

The Principled BSDF (layering.py) and the simple nodes use them alike.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import dielectric_weight, ggx_albedo, glass_albedo
from .diffuse import DIFFUSE_ROUGHNESS_MIN, oren_nayar_ab, oren_nayar_multiscatter
from .fresnel import (
    f0_from_ior,
    fresnel_dielectric,
    fresnel_generalized_schlick,
    fresnel_generalized_schlick_average,
    mix3,
    saturate3,
)
from .geometry_math import TWO_PI, max_component, mean_component, normalize_or, safe_sqrt, sqr
from .thin_film import film_schlick
from .types import Bsdf, Closure, Tables

# Bsdf.glass_kind
GLASS_INTERFACE = wp.constant(0)
"""Reflects and refracts by the generalised Schlick Fresnel"""
GLASS_REFRACTION = wp.constant(1)
"""Refracts alone, without Fresnel (Refraction BSDF)"""
GLASS_THIN = wp.constant(2)
"""A sheet: reflects, and passes light on without bending it"""


@wp.func
def energy_factor(albedo: wp.vec2, fresnel_average: wp.vec3) -> wp.vec3:
    """Return what multiple scattering multiplies a single-scattering lobe with (Kulla and Conty 2017).

    Args:
        albedo: Single-scattering albedo for Fresnel 1 at this view, and its mean over all views.
        fresnel_average: Cosine-weighted mean reflectance.
    """
    # E is far above this floor except for indices near 0, where nothing may become infinite.
    missing = 1.0 / wp.max(albedo[0], 1.0e-4) - 1.0
    rest = wp.max(wp.vec3(1.0) - fresnel_average * (1.0 - albedo[1]), wp.vec3(1.0e-3))
    return wp.vec3(1.0) + wp.cw_div(fresnel_average * albedo[1], rest) * missing


@wp.func
def below_layer(albedo: wp.vec3, weight: wp.vec3) -> wp.vec3:
    """Return the weight left under a layer that reflects `albedo` of `weight`; grey, so that layers don't tint."""
    share = float(0.0)
    for c in range(3):
        if weight[c] != 0.0:
            share = wp.max(share, albedo[c] / weight[c])
    return weight * wp.clamp(1.0 - share, 0.0, 1.0)


@wp.func
def unit_normal(normal: wp.vec3, fallback: wp.vec3) -> wp.vec3:
    """Return `normal` normalised; bit for bit `fallback` where it is that, so that comparing them works."""
    if normal[0] == fallback[0] and normal[1] == fallback[1] and normal[2] == fallback[2]:
        return fallback
    return normalize_or(normal, fallback)


@wp.func
def alpha_roughness(alpha_x: float, alpha_y: float) -> float:
    """Return the perceptual roughness that the tables are indexed by."""
    return wp.sqrt(wp.sqrt(alpha_x * alpha_y))


@wp.func
def rotated_tangent(closure: Closure, axis: wp.vec3) -> wp.vec3:
    """Return the closure's tangent turned about `axis` (Rodrigues)."""
    t = closure.tangent
    if closure.anisotropic_rotation == 0.0:
        return t
    angle = closure.anisotropic_rotation * TWO_PI
    return t * wp.cos(angle) + wp.cross(axis, t) * wp.sin(angle) + axis * (wp.dot(axis, t) * (1.0 - wp.cos(angle)))


@wp.func
def set_oren_nayar(bsdf: Bsdf, color: wp.vec3, roughness: float, wo: wp.vec3):
    """Return the BSDF with the terms of its diffuse lobe for a roughness."""
    if roughness >= DIFFUSE_ROUGHNESS_MIN:
        ab = oren_nayar_ab(roughness)
        bsdf.diffuse_a = ab[0]
        bsdf.diffuse_b = ab[1]
        bsdf.diffuse_multiscatter = oren_nayar_multiscatter(color, wp.dot(bsdf.normal, wo), ab[0], ab[1])
    return bsdf


@wp.func
def add_glass(
    tables: Tables, bsdf: Bsdf, weight: wp.vec3, ior: float, roughness: float, f0: wp.vec3, reflection: wp.vec3,
    transmission: wp.vec3, backfacing: int, multiscatter: int, cos_o: float,
):  # fmt: skip
    """Return the BSDF with a dielectric interface that reflects and refracts.

    Args:
        tables: Albedos.
        bsdf: What to add to.
        weight: Factor on the lobe.
        ior: Index behind a front face.
        roughness: Perceptual roughness.
        f0: Reflectance along the normal.
        reflection: Factor on what is reflected.
        transmission: Factor on what is refracted.
        backfacing: 1 if the view is on the index's side.
        multiscatter: 1 to preserve energy.
        cos_o: Cosine of the view.
    """
    eta = wp.where(backfacing != 0, 1.0 / ior, ior)
    bsdf.glass_kind = GLASS_INTERFACE
    bsdf.glass_ior = eta
    bsdf.glass_alpha = sqr(roughness)
    bsdf.glass_f0 = saturate3(f0)
    bsdf.glass_reflection_tint = reflection
    bsdf.glass_transmission_tint = transmission
    bsdf.glass = weight
    if multiscatter != 0:
        average = transmission
        if max_component(transmission) <= 0.0:
            average = wp.cw_mul(reflection, fresnel_generalized_schlick_average(eta, bsdf.glass_f0))
        bsdf.glass = wp.cw_mul(weight, energy_factor(glass_albedo(tables, cos_o, roughness, eta), average))
    f = mix3(bsdf.glass_f0, wp.vec3(1.0), dielectric_weight(tables, cos_o, roughness, eta))
    if bsdf.film_thickness > 0.0:
        # Seen from within glass of index n, film and air are what a film and a glass of 1 / n times their indices are.
        bsdf.glass_film_ior = wp.where(backfacing != 0, bsdf.film_ior / ior, bsdf.film_ior)
        f = film_schlick(bsdf.film, bsdf.film_thickness, bsdf.glass_film_ior, eta, bsdf.glass_f0, cos_o)
    albedo = wp.cw_mul(f, reflection) + wp.cw_mul(wp.vec3(1.0) - f, transmission)
    bsdf.pick_glass = mean_component(weight) * mean_component(albedo)
    return bsdf


@wp.func
def sheet_passage(r: float, inner: float, tint: float, path: float) -> float:
    """Return the transmittance of a sheet between whose faces light passes tint ** path each way.

    They reflect r from outside and `inner` from inside.
    """
    c = wp.pow(tint, path)
    rest = 1.0 - sqr(inner * c)
    if rest <= 0.0:
        return 0.0
    return c * ((1.0 - r) * (1.0 - inner)) / rest


@wp.func
def add_thin_glass(
    tables: Tables, bsdf: Bsdf, weight: wp.vec3, ior: float, roughness: float, reflection: wp.vec3,
    transmission: wp.vec3, cos_o: float,
):  # fmt: skip
    """Return the BSDF with an infinitesimally thin sheet: all internal reflections summed (OpenPBR, thin walls)."""
    f = fresnel_dielectric(cos_o, ior)
    r = fresnel_generalized_schlick(cos_o, ior, reflection * f0_from_ior(ior))
    inner = r
    if bsdf.film_thickness > 0.0:
        f0 = saturate3(reflection * f0_from_ior(ior))
        r = film_schlick(bsdf.film, bsdf.film_thickness, bsdf.film_ior, ior, f0, cos_o)
        inner = film_schlick(bsdf.film, bsdf.film_thickness, bsdf.film_ior / ior, 1.0 / ior, f0, f[1])
    path = 1.0 / wp.max(f[1], 1.0e-6)
    passed = wp.vec3(0.0)
    internal = wp.vec3(0.0)
    for c in range(3):
        passed[c] = sheet_passage(r[c], inner[c], transmission[c], path)
        internal[c] = passed[c] * inner[c] * wp.pow(transmission[c], path)
    # Light that passes is refracted twice: Kulla and Conty 2017, p. 40, with the factor 3.4 = 2 * 1.7.
    alpha = sqr(roughness)
    widening = safe_sqrt(3.4 * (ior - 1.0) * sqr(ior - 0.5) / (ior * ior * ior))
    bsdf.glass_kind = GLASS_THIN
    bsdf.glass = weight
    bsdf.glass_ior = 1.0
    bsdf.glass_alpha = alpha
    bsdf.thin_alpha = wp.clamp(alpha * widening, 0.0, 1.0)
    bsdf.pick_glass = mean_component(wp.cw_mul(weight, r + internal + passed))
    bsdf.glass_reflection_tint = wp.cw_mul(
        r + internal, energy_factor(ggx_albedo(tables, cos_o, roughness), reflection)
    )
    thin_energy = ggx_albedo(tables, cos_o, wp.sqrt(bsdf.thin_alpha))
    bsdf.glass_transmission_tint = wp.cw_mul(passed, energy_factor(thin_energy, wp.vec3(1.0)))
    return bsdf
