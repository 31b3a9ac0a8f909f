# SPDX-License-Identifier: GPL-3.0-or-later
"""The directional albedo of a prepared BSDF, lobe by lobe, and the GGX lobe that stands for all reflection but a coat.

Albedos come from the tables of albedo_tables.py, so they cost look-ups instead of an integral.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import (
    ggx_albedo,
    glass_albedo,
    plane_point,
    reflected_cosine,
    reflected_dielectric_cosine,
    reflected_dielectric_weight,
)
from .diffuse import oren_nayar_g
from .fresnel import (
    DIELECTRIC_F90,
    DIELECTRIC_IOR,
    f0_from_ior,
    fresnel_dielectric,
    grazing_share,
    metal_part,
    mix3,
)
from .gbuffer import GRAZING_MAX, SurfaceMaterial
from .geometry_math import PI, max_component, mean_component, safe_sqrt, sqr
from .ggx import ggx_lambda, reflect_about, sample_ggx_normal
from .lobe_setup import GLASS_REFRACTION, GLASS_THIN, alpha_roughness
from .lobes import base_reflectance, glass_reflectance
from .reflection_types import REFLECTANCE_MIN
from .toon import is_toon, toon_albedo
from .types import Bsdf, Tables

# Least share of a lobe's albedo that its reflectance along the normal decides (1 - Schlick's weight); see fit_lobe.
NORMAL_SHARE_MIN = wp.constant(0.05)

# Facets whose mean is the reflectance under a thin film, and the roughness up to which one is enough.
FILM_FACETS = wp.constant(24)
FILM_SMOOTH = wp.constant(0.02)

# Difference of roughness below which a coat and the base below it look like one lobe.
COAT_BLEND = wp.constant(0.05)
# Albedo of the base, as a share of the coat's, below which the coat stands for both.
BASE_SHARE_MIN = wp.constant(0.02)


@wp.struct
class BsdfAlbedo:
    """Shares of light from a white surrounding that go to one view."""

    diffuse: wp.vec3
    """Sheen included"""
    translucent: wp.vec3
    specular: wp.vec3
    """All other reflection: metal, dielectric, glass and coat"""
    transmitted: wp.vec3
    """Specular transmission: of glass, refraction and thin glass"""
    reflected: wp.vec3
    """Part of `specular` that one lobe stands for: without the coat, where that is a lobe of its own"""
    f0: wp.vec3
    """Sum of that lobe's parts: their reflectance along their normals, energy compensation for this view included"""
    f90: float
    """The same at grazing angles, mean of the channels"""
    roughness: float
    """Perceptual, mean of that lobe's parts weighted by albedo; 1 where there are none"""
    coat: float
    """Part of `specular` that the coat reflects, mean of the channels; 0 where there is none or it looks like the
    base"""
    coat_roughness: float


@wp.func
def whole_albedo(parts: BsdfAlbedo) -> wp.vec3:
    """Return the sum of all lobes' albedos."""
    return parts.diffuse + parts.translucent + parts.specular + parts.transmitted


@wp.func
def diffuse_factor(bsdf: Bsdf, n_dot_o: float) -> wp.vec3:
    """Return the albedo of a diffuse lobe of weight 1: 1 for Lambert, see oren_nayar in diffuse.py."""
    if bsdf.diffuse_b <= 0.0:
        return wp.vec3(1.0, 1.0, 1.0)
    average = bsdf.diffuse_a * PI + ((2.0 * PI - 5.6) / 3.0) * bsdf.diffuse_b
    single = bsdf.diffuse_a * PI + bsdf.diffuse_b * oren_nayar_g(wp.clamp(n_dot_o, 0.0, 1.0))
    return wp.vec3(single, single, single) + bsdf.diffuse_multiscatter * (PI * (1.0 - average))


@wp.func
def fifth_power(x: float) -> float:
    """Return x^5."""
    return sqr(sqr(x)) * x


@wp.func
def f82_dip(b: wp.vec3, c: float, roughness: float) -> wp.vec3:
    """Return what a metal's edge tint takes from the reflectance, at the cosine that stands for a rough surface.

    Rough surfaces spread over cosines on both sides of the dip's deepest place; measured by integration.
    """
    spread = 1.0 - 0.45 * wp.min(roughness, 0.6)
    m = 1.0 - c
    return b * (spread * c * sqr(sqr(m)) * sqr(m))


@wp.func
def add_lobe(
    result: BsdfAlbedo, albedo: wp.vec3, f0: wp.vec3, f90: wp.vec3, roughness: float,
) -> BsdfAlbedo:
    """Return the sums with a reflecting lobe; `roughness` and its weight are divided later."""
    sums = result
    share = mean_component(albedo)
    before = mean_component(sums.reflected)
    if share > 0.0:
        sums.roughness = (sums.roughness * before + roughness * share) / (before + share)
    sums.reflected = sums.reflected + albedo
    sums.specular = sums.specular + albedo
    sums.f0 = sums.f0 + f0
    sums.f90 = sums.f90 + mean_component(f90)
    return sums


@wp.func
def mean_film(bsdf: Bsdf, cos_o: float, roughness: float, share: float) -> wp.vec3:
    """Return the weighted reflectance of metal and dielectric under a thin film, mean of the facets that reflect.

    Each counts by how little it is shadowed. Interference changes too much with the angle for one facet to stand for
    all; few do, as they are spread evenly, and as they stand for the difference from Schlick's curve alone, whose mean
    weight of F90 is known: `share`.
    """
    grazing = bsdf.metal + bsdf.dielectric
    alpha = sqr(roughness)
    wo = wp.vec3(safe_sqrt(1.0 - sqr(cos_o)), 0.0, cos_o)
    total = wp.vec3(0.0, 0.0, 0.0)
    weight = float(0.0)
    lambda_o = ggx_lambda(wo, alpha, alpha)
    facets = wp.where(roughness > FILM_SMOOTH, FILM_FACETS, 1)
    k = int(0)
    while k < facets:
        m = wp.vec3(0.0, 0.0, 1.0)
        if facets > 1:
            # Half the azimuths are enough: the view lies in the plane between the halves.
            u = plane_point(k)
            m = sample_ggx_normal(wo, alpha, alpha, wp.vec2(u[0], 0.5 * u[1]))
        wi = reflect_about(wo, m)
        if wi[2] > 0.0:
            kept = (1.0 + lambda_o) / (1.0 + lambda_o + ggx_lambda(wi, alpha, alpha))
            c = wp.clamp(wp.dot(wo, m), 0.0, 1.0)
            total = total + (base_reflectance(bsdf, c) - grazing * fifth_power(1.0 - c)) * kept
            weight = weight + kept
        k = k + 1
    return wp.max(total / wp.max(weight, 1.0e-6) + grazing * share, wp.vec3(0.0, 0.0, 0.0))


@wp.func
def add_film(tables: Tables, bsdf: Bsdf, cos_o: float, result: BsdfAlbedo) -> BsdfAlbedo:
    """Return the sums with metal and dielectric under a thin film; `f0` makes the lobe as bright as they are."""
    roughness = alpha_roughness(bsdf.alpha_x, bsdf.alpha_y)
    share = fifth_power(1.0 - reflected_cosine(tables, cos_o, roughness))
    reflected = mean_film(bsdf, cos_o, roughness, share)
    # A film may be darker than any lobe that reflects all at grazing angles.
    darkest = wp.min(reflected[0], wp.min(reflected[1], reflected[2])) / wp.max(share, 1.0e-6)
    f90 = wp.min(bsdf.metal + bsdf.dielectric, wp.vec3(darkest, darkest, darkest))
    f0 = wp.max(reflected - f90 * share, wp.vec3(0.0, 0.0, 0.0)) / wp.max(1.0 - share, NORMAL_SHARE_MIN)
    return add_lobe(result, reflected * ggx_albedo(tables, cos_o, roughness)[0], f0, f90, roughness)


@wp.func
def add_base(tables: Tables, bsdf: Bsdf, cos_o: float, result: BsdfAlbedo) -> BsdfAlbedo:
    """Return the sums with metal and dielectric, which share one GGX lobe."""
    sums = result
    roughness = alpha_roughness(bsdf.alpha_x, bsdf.alpha_y)
    energy = ggx_albedo(tables, cos_o, roughness)[0]
    one = wp.vec3(1.0, 1.0, 1.0)
    if wp.length_sq(bsdf.metal) > 0.0:
        reflectance = one
        f0 = one
        if bsdf.metal_constant == 0:
            c = reflected_cosine(tables, cos_o, roughness)
            f0 = bsdf.metal_f0
            dip = f82_dip(bsdf.metal_b, c, roughness)
            reflectance = wp.max(mix3(f0, one, fifth_power(1.0 - c)) - dip, wp.vec3(0.0, 0.0, 0.0))
        sums = add_lobe(
            sums, wp.cw_mul(bsdf.metal, reflectance) * energy, wp.cw_mul(bsdf.metal, f0), bsdf.metal, roughness)
    if wp.length_sq(bsdf.dielectric) > 0.0:
        reflectance = mix3(
            bsdf.dielectric_f0, one,
            reflected_dielectric_weight(tables, cos_o, roughness, bsdf.dielectric_ior))
        sums = add_lobe(
            sums, wp.cw_mul(bsdf.dielectric, reflectance) * energy, wp.cw_mul(bsdf.dielectric, bsdf.dielectric_f0),
            bsdf.dielectric, roughness)
    return sums


@wp.func
def add_glass_lobe(tables: Tables, bsdf: Bsdf, cos_o: float, result: BsdfAlbedo) -> BsdfAlbedo:
    """Return the sums with glass: what it reflects and what passes it."""
    sums = result
    roughness = wp.sqrt(bsdf.glass_alpha)
    one = wp.vec3(1.0, 1.0, 1.0)
    if bsdf.glass_kind == GLASS_THIN:
        tint = wp.cw_mul(bsdf.glass, bsdf.glass_reflection_tint)
        sums = add_lobe(sums, tint * ggx_albedo(tables, cos_o, roughness)[0], tint, tint, roughness)
        passed = wp.cw_mul(bsdf.glass, bsdf.glass_transmission_tint)
        sums.transmitted = sums.transmitted + passed * ggx_albedo(tables, cos_o, wp.sqrt(bsdf.thin_alpha))[0]
        return sums
    energy = glass_albedo(tables, cos_o, roughness, bsdf.glass_ior)[0]
    # The table of weights is that of entering; from inside the reflectance at the mean facet has to do.
    reflectance = fresnel_dielectric(cos_o, bsdf.glass_ior)[0] * one
    if bsdf.glass_ior > 1.0:
        reflectance = mix3(
            bsdf.glass_f0, one, reflected_dielectric_weight(tables, cos_o, roughness, bsdf.glass_ior))
        if bsdf.film_thickness > 0.0:
            reflectance = glass_reflectance(bsdf, reflected_dielectric_cosine(tables, cos_o, roughness, bsdf.glass_ior))
        # Of both halves together; what refraction keeps of its own is more.
        reflectance = reflectance * (
            ggx_albedo(tables, cos_o, roughness)[0] / wp.max(energy, 1.0e-4))
    if bsdf.glass_kind == GLASS_REFRACTION:
        if mean_component(sums.reflected) <= 0.0:
            sums.roughness = roughness
        sums.transmitted = sums.transmitted + wp.cw_mul(bsdf.glass, one - reflectance) * energy
        if bsdf.glass_ior > 1.0:
            # It refracts everything: there is no Fresnel term that could reflect.
            sums.transmitted = sums.transmitted + wp.cw_mul(bsdf.glass, reflectance) * energy
        return sums
    tint = wp.cw_mul(bsdf.glass, bsdf.glass_reflection_tint)
    sums = add_lobe(
        sums, wp.cw_mul(tint, reflectance) * energy, wp.cw_mul(tint, bsdf.glass_f0), tint, roughness)
    passed = wp.cw_mul(wp.cw_mul(bsdf.glass, bsdf.glass_transmission_tint), one - reflectance)
    sums.transmitted = sums.transmitted + passed * energy
    return sums


@wp.func
def add_coat_lobe(tables: Tables, bsdf: Bsdf, cos_o: float, result: BsdfAlbedo) -> BsdfAlbedo:
    """Return the sums with the coat, which comes last: a lobe of its own unless one lobe can stand for it and the base.

    It may be tinted only by layers above it, so its lobe has no colour; `specular` has.
    """
    sums = result
    roughness = wp.sqrt(bsdf.coat_alpha)
    f0 = f0_from_ior(bsdf.coat_ior)
    reflectance = wp.lerp(f0, 1.0, reflected_dielectric_weight(tables, cos_o, roughness, bsdf.coat_ior))
    albedo = bsdf.coat * (ggx_albedo(tables, cos_o, roughness)[0] * reflectance)
    share = mean_component(albedo)
    alone = mean_component(sums.reflected) < BASE_SHARE_MIN * share
    if alone or share < REFLECTANCE_MIN or wp.abs(roughness - sums.roughness) < COAT_BLEND:
        sums = add_lobe(sums, albedo, bsdf.coat * f0, bsdf.coat, roughness)
        sums.roughness = wp.where(alone, roughness, sums.roughness)
    else:
        sums.specular = sums.specular + albedo
        sums.coat = share
        sums.coat_roughness = roughness
    return sums


@wp.func
def bsdf_albedo(tables: Tables, bsdf: Bsdf, wo: wp.vec3) -> BsdfAlbedo:
    """Return the albedos of a BSDF for the view that it is prepared for.

    The energy compensation that prepare_bsdf has put into the weights is in them. Shadowing by bumped normals is not.
    """
    result = BsdfAlbedo()
    factor = diffuse_factor(bsdf, wp.abs(wp.dot(bsdf.normal, wo)))
    result.diffuse = wp.cw_mul(bsdf.diffuse, factor)
    result.translucent = wp.cw_mul(bsdf.translucent, factor)
    result.specular = wp.vec3(0.0, 0.0, 0.0)
    result.transmitted = wp.vec3(0.0, 0.0, 0.0)
    result.reflected = wp.vec3(0.0, 0.0, 0.0)
    result.f0 = wp.vec3(0.0, 0.0, 0.0)
    result.f90 = 0.0
    result.roughness = 1.0
    result.coat = 0.0
    result.coat_roughness = 1.0
    cos_o = wp.dot(bsdf.specular_normal, wo)
    if bsdf.pick_specular > 0.0:
        if bsdf.film_thickness > 0.0:
            result = add_film(tables, bsdf, cos_o, result)
        else:
            result = add_base(tables, bsdf, cos_o, result)
    if bsdf.pick_glass > 0.0:
        result = add_glass_lobe(tables, bsdf, cos_o, result)
    if bsdf.pick_sheen > 0.0:
        # Its lobe integrates to 1, and Cycles counts it as diffuse. Frames count glossy toon lobes so too.
        share = float(1.0)
        if is_toon(bsdf.sheen_a):
            share = toon_albedo(bsdf.sheen_a, bsdf.sheen_b)
        result.diffuse = result.diffuse + bsdf.sheen * share
    if bsdf.pick_coat > 0.0:
        result = add_coat_lobe(tables, bsdf, wp.dot(bsdf.coat_normal, wo), result)
    return result


@wp.func
def mean_grazing_share(tables: Tables, cos_o: float, roughness: float, metal: float) -> float:
    """Return the mean of grazing_share over the facets of a rough surface that reflect towards a view."""
    share = float(0.0)
    if metal < 1.0:
        share = grazing_share(reflected_dielectric_cosine(tables, cos_o, roughness, DIELECTRIC_IOR), 0.0)
    if metal > 0.0:
        share = wp.lerp(share, fifth_power(1.0 - reflected_cosine(tables, cos_o, roughness)), metal)
    return share


@wp.func
def fit_lobe(tables: Tables, albedo: BsdfAlbedo, cos_o: float, material: SurfaceMaterial) -> SurfaceMaterial:
    """Return the material with the `f0` and `f90` whose GGX lobe of `material.roughness` has the albedo `reflected`.

    A lobe's albedo is E (f0 (1 - s) + f90 s), with the tables' E and the mean s of grazing_share. f90 is scaled by what
    the sums of all lobes miss; as stored it has 8 bits, so the channels' f0 takes up what is left, where it has an
    influence at all.

    Args:
        tables: Albedos.
        albedo: Of the BSDF.
        cos_o: Of the view with the specular normal.
        material: With its roughness (widened by filters) set.
    """
    result = material
    energy = ggx_albedo(tables, cos_o, material.roughness)[0]
    metal = metal_part(mean_component(albedo.f0), albedo.f90)
    share = mean_grazing_share(tables, wp.max(cos_o, 0.0), material.roughness, metal)
    grazing = albedo.f90 * wp.lerp(DIELECTRIC_F90, 1.0, metal)
    guess = energy * (mean_component(albedo.f0) * (1.0 - share) + grazing * share)
    scale = wp.where(guess > 0.0, mean_component(albedo.reflected) / wp.max(guess, 1.0e-20), 0.0)
    f90 = wp.clamp(grazing * wp.min(scale, 16.0), 0.0, 2.0 * GRAZING_MAX)
    step = wp.where(f90 > GRAZING_MAX or max_component(albedo.f0) > 1.0, 2.0, 1.0) * (GRAZING_MAX / 255.0)
    f90 = wp.floor(f90 / step + 0.5) * step
    along = wp.max(energy * (1.0 - share), NORMAL_SHARE_MIN)
    f0 = (albedo.reflected - wp.vec3(1.0, 1.0, 1.0) * (energy * f90 * share)) / along
    result.f0 = wp.min(wp.max(f0, wp.vec3(0.0, 0.0, 0.0)), wp.vec3(4.0, 4.0, 4.0))
    result.f90 = f90
    return result
