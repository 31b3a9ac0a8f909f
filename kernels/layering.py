# SPDX-License-Identifier: GPL-3.0-or-later
"""From a closure to a BSDF ready for one view: layers, energy compensation and the odds of sampling each lobe.

The layers are those of Cycles 5.2 (svm/closure.h, CLOSURE_BSDF_PRINCIPLED_ID): sheen over coat over emission over
metal, transmission, dielectric reflection and diffuse. Each takes its share by its estimated albedo and leaves the
rest to what lies below. Light that is scattered below the surface is a part of the diffuse lobe here: real-time frames
draw it so, and the path tracer takes it out again (subsurface.py).
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import dielectric_weight, ggx_albedo, metal_weight
from .fresnel import (
    f0_from_ior,
    f82_tint_term,
    fresnel_dielectric_average,
    fresnel_f82_average,
    fresnel_generalized_schlick_average,
    ior_from_f0,
    mix3,
    pow3,
    saturate3,
)
from .geometry_math import max_component, mean_component, safe_sqrt, sqr
from .lobe_setup import (
    GLASS_REFRACTION,
    add_glass,
    add_thin_glass,
    alpha_roughness,
    below_layer,
    energy_factor,
    rotated_tangent,
    set_oren_nayar,
    unit_normal,
)
from .normals import valid_specular_normal
from .sheen import sheen_albedo, sheen_transform
from .thin_film import FILM_MIN, film_metal, film_schlick
from .toon import toon_lobe
from .types import (
    CLOSURE_DIFFUSE,
    CLOSURE_GLASS,
    CLOSURE_GLOSSY,
    CLOSURE_PRINCIPLED,
    CLOSURE_REFRACTION,
    CLOSURE_SHEEN,
    CLOSURE_TOON_DIFFUSE,
    CLOSURE_TOON_GLOSSY,
    CLOSURE_TRANSLUCENT,
    Bsdf,
    Closure,
    ShadingPoint,
    Tables,
)

WEIGHT_CUTOFF = wp.constant(1.0e-5)
"""Lobes lighter than this are left out (Cycles, CLOSURE_WEIGHT_CUTOFF)."""
IOR_MIN = wp.constant(1.0e-5)


@wp.func
def add_sheen(closure: Closure, bsdf: Bsdf, weight: wp.vec3, coat_normal: wp.vec3, wo: wp.vec3):
    """Put sheen on top; return the BSDF and the weight below."""
    amount = wp.max(closure.sheen, 0.0)
    if amount <= WEIGHT_CUTOFF:
        return bsdf, weight
    bsdf.sheen_normal = unit_normal(mix3(bsdf.normal, coat_normal, wp.clamp(closure.coat, 0.0, 1.0)), bsdf.normal)
    cos_o = wp.dot(bsdf.sheen_normal, wo)
    roughness = wp.clamp(closure.sheen_roughness, 0.0, 1.0)
    transform = sheen_transform(cos_o, roughness)
    if wp.abs(transform[0]) < 1.0e-5:
        return bsdf, weight
    bsdf.sheen_a = transform[0]
    bsdf.sheen_b = transform[1]
    tint = wp.max(closure.sheen_tint, wp.vec3(0.0))
    bsdf.sheen = wp.cw_mul(tint, weight) * (amount * sheen_albedo(cos_o, roughness))
    bsdf.pick_sheen = mean_component(bsdf.sheen)
    return bsdf, below_layer(bsdf.sheen, weight)


@wp.func
def add_coat(tables: Tables, closure: Closure, bsdf: Bsdf, weight: wp.vec3, coat_normal: wp.vec3, wo: wp.vec3):
    """Put a clear dielectric coat on; return the BSDF and the weight below, tinted by the way through the coat."""
    amount = wp.max(closure.coat, 0.0)
    if amount <= WEIGHT_CUTOFF:
        return bsdf, weight
    below = weight
    ior = wp.max(closure.coat_ior, 1.0)
    bsdf.coat_normal = valid_specular_normal(bsdf.geometric_normal, wo, coat_normal)
    bsdf.coat_ior = ior
    roughness = wp.clamp(closure.coat_roughness, 0.0, 1.0)
    bsdf.coat_alpha = sqr(roughness)
    cos_o = wp.dot(bsdf.coat_normal, wo)
    energy = ggx_albedo(tables, cos_o, roughness)
    factor = energy_factor(energy, wp.vec3(fresnel_dielectric_average(ior)))
    bsdf.coat = wp.cw_mul(weight, factor) * amount
    f0 = f0_from_ior(ior)
    if ior > 1.0:
        f0 = wp.lerp(f0, 1.0, dielectric_weight(tables, cos_o, roughness, ior))
    albedo = bsdf.coat * (energy[0] * f0)
    bsdf.pick_coat = mean_component(albedo)
    below = below_layer(albedo, weight)
    tint = wp.max(closure.coat_tint, wp.vec3(0.0))
    # The tint is that of a coat of thickness 1 seen along the normal; seen aslant it is 1 / cos thick (Beer's law).
    depth = 1.0 / safe_sqrt(1.0 - (1.0 - sqr(cos_o)) / sqr(ior))
    if depth < 1.0e6:
        below = wp.cw_mul(below, wp.max(mix3(wp.vec3(1.0), pow3(tint, depth), amount), wp.vec3(0.0)))
    return bsdf, below


@wp.func
def add_metal(tables: Tables, closure: Closure, bsdf: Bsdf, weight: wp.vec3, cos_o: float):
    """Add the metallic share; return the BSDF and the weight of the rest."""
    metallic = wp.clamp(closure.metallic, 0.0, 1.0)
    if metallic <= WEIGHT_CUTOFF:
        return bsdf, weight
    roughness = alpha_roughness(bsdf.alpha_x, bsdf.alpha_y)
    bsdf.metal_f0 = saturate3(closure.color)
    bsdf.metal_b = f82_tint_term(bsdf.metal_f0, saturate3(closure.specular_tint))
    bsdf.metal = weight * metallic
    if closure.multiscatter != 0:
        average = fresnel_f82_average(bsdf.metal_f0, bsdf.metal_b)
        bsdf.metal = wp.cw_mul(bsdf.metal, energy_factor(ggx_albedo(tables, cos_o, roughness), average))
    albedo = mix3(bsdf.metal_f0, wp.vec3(1.0), metal_weight(tables, cos_o, roughness))
    if bsdf.film_thickness > 0.0:
        albedo = film_metal(bsdf.film, bsdf.film_thickness, bsdf.film_ior, bsdf.metal_f0, bsdf.metal_b, cos_o)
    bsdf.pick_specular += mean_component(weight) * metallic * mean_component(albedo)
    return bsdf, weight * (1.0 - metallic)


@wp.func
def add_transmission(
    tables: Tables, closure: Closure, point: ShadingPoint, bsdf: Bsdf, weight: wp.vec3, roughness: float, cos_o: float
):
    """Add the transmissive share; return the BSDF and the weight of the rest."""
    amount = wp.clamp(closure.transmission, 0.0, 1.0)
    if amount <= WEIGHT_CUTOFF:
        return bsdf, weight
    ior = wp.max(closure.ior, IOR_MIN)
    tint = wp.max(closure.specular_tint, wp.vec3(0.0))
    color = saturate3(closure.color)
    if closure.thin_wall != 0:
        bsdf = add_thin_glass(tables, bsdf, weight * amount, ior, roughness, tint, color, cos_o)
    else:
        bsdf = add_glass(
            tables, bsdf, weight * amount, ior, roughness, tint * f0_from_ior(ior), wp.vec3(1.0), pow3(color, 0.5),
            point.backfacing, closure.multiscatter, cos_o,
        )  # fmt: skip
    return bsdf, weight * (1.0 - amount)


@wp.func
def add_dielectric(tables: Tables, closure: Closure, bsdf: Bsdf, weight: wp.vec3, cos_o: float):
    """Add the reflection of the dielectric base; return the BSDF and the weight below it."""
    ior = wp.max(closure.ior, IOR_MIN)
    level = wp.max(closure.specular_level, 0.0)
    f0 = f0_from_ior(ior)
    eta = ior
    if level != 0.5:
        f0 = f0 * 2.0 * level
        eta = ior_from_f0(f0)
        if ior < 1.0:
            eta = 1.0 / eta
    if (eta == 1.0 and bsdf.film_thickness <= 0.0) or mean_component(weight) < WEIGHT_CUTOFF:
        return bsdf, weight
    roughness = alpha_roughness(bsdf.alpha_x, bsdf.alpha_y)
    bsdf.dielectric_ior = eta
    bsdf.dielectric_f0 = saturate3(wp.max(closure.specular_tint, wp.vec3(0.0)) * f0)
    bsdf.dielectric = weight
    reflectance = mix3(bsdf.dielectric_f0, wp.vec3(1.0), dielectric_weight(tables, cos_o, roughness, eta))
    if bsdf.film_thickness > 0.0:
        # Shares of light under a film are those of a smooth one (Cycles, bsdf_microfacet_estimate_albedo).
        reflectance = film_schlick(bsdf.film, bsdf.film_thickness, bsdf.film_ior, eta, bsdf.dielectric_f0, cos_o)
    albedo = wp.cw_mul(weight, reflectance)
    if closure.multiscatter != 0:
        energy = ggx_albedo(tables, cos_o, roughness)
        factor = energy_factor(energy, fresnel_generalized_schlick_average(eta, bsdf.dielectric_f0))
        bsdf.dielectric = wp.cw_mul(weight, factor)
        # Without the scale 1/E: what multiple scattering absorbs, the layer below doesn't get.
        albedo = wp.cw_mul(albedo, factor) * energy[0]
    bsdf.pick_specular += mean_component(albedo)
    return bsdf, below_layer(albedo, weight)


@wp.func
def add_diffuse(closure: Closure, bsdf: Bsdf, weight: wp.vec3, wo: wp.vec3):
    """Return the BSDF with diffuse reflection and subsurface scattering, which thin walls also let through."""
    base = wp.max(closure.color, wp.vec3(0.0))
    subsurface = wp.clamp(closure.subsurface, 0.0, 1.0)
    scattered = wp.cw_mul(saturate3(base), weight) * subsurface
    bsdf.diffuse = wp.cw_mul(base, weight) * (1.0 - subsurface)
    if closure.thin_wall != 0:
        through = 0.5 * (1.0 + wp.clamp(closure.subsurface_anisotropy, -1.0, 1.0))
        bsdf.translucent = scattered * through
        bsdf.diffuse += scattered * (1.0 - through)
    else:
        bsdf.diffuse += scattered
    return set_oren_nayar(bsdf, base, wp.clamp(closure.diffuse_roughness, 0.0, 1.0), wo)


@wp.func
def prepare_principled(tables: Tables, closure: Closure, point: ShadingPoint, bsdf: Bsdf):
    """Return the BSDF with all layers of the Principled BSDF."""
    wo = point.wo
    coat_normal = unit_normal(closure.coat_normal, bsdf.normal)
    bsdf, weight = add_sheen(closure, bsdf, wp.max(closure.weight, wp.vec3(0.0)), coat_normal, wo)
    bsdf, weight = add_coat(tables, closure, bsdf, weight, coat_normal, wo)
    bsdf.emission += wp.cw_mul(closure.emission_layered, weight)
    roughness = wp.clamp(closure.roughness, 0.0, 1.0)
    alpha = sqr(roughness)
    bsdf.alpha_x = alpha
    bsdf.alpha_y = alpha
    anisotropic = wp.clamp(closure.anisotropic, 0.0, 1.0)
    if anisotropic > 0.0 and wp.length_sq(closure.tangent) > 0.0:
        aspect = wp.sqrt(1.0 - anisotropic * 0.9)
        bsdf.alpha_x = wp.min(alpha / aspect, 1.0)
        bsdf.alpha_y = alpha * aspect
        bsdf.tangent = rotated_tangent(closure, bsdf.normal)
    cos_o = wp.dot(bsdf.specular_normal, wo)
    bsdf, weight = add_metal(tables, closure, bsdf, weight, cos_o)
    bsdf, weight = add_transmission(tables, closure, point, bsdf, weight, roughness, cos_o)
    bsdf, weight = add_dielectric(tables, closure, bsdf, weight, cos_o)
    return add_diffuse(closure, bsdf, weight, wo)


@wp.func
def prepare_glossy(tables: Tables, closure: Closure, bsdf: Bsdf, color: wp.vec3, cos_o: float):
    """Return the BSDF with a Glossy BSDF: a constant reflectance."""
    alpha = sqr(wp.clamp(closure.roughness, 0.0, 1.0))
    bsdf.alpha_x = alpha
    bsdf.alpha_y = alpha
    anisotropy = wp.clamp(closure.anisotropic, -0.99, 0.99)
    if wp.abs(anisotropy) > 1.0e-4 and wp.length_sq(closure.tangent) > 0.0:
        stretch = 1.0 - wp.abs(anisotropy)
        bsdf.alpha_x = wp.where(anisotropy < 0.0, wp.min(alpha / stretch, 1.0), alpha * stretch)
        bsdf.alpha_y = wp.where(anisotropy < 0.0, alpha * stretch, wp.min(alpha / stretch, 1.0))
        bsdf.tangent = rotated_tangent(closure, bsdf.specular_normal)
    bsdf.metal_constant = 1
    bsdf.metal = color
    if closure.multiscatter != 0:
        energy = ggx_albedo(tables, cos_o, alpha_roughness(bsdf.alpha_x, bsdf.alpha_y))
        bsdf.metal = wp.cw_mul(color, energy_factor(energy, wp.max(closure.color, wp.vec3(0.0))))
    bsdf.pick_specular = mean_component(color)
    return bsdf


@wp.func
def prepare_simple(tables: Tables, closure: Closure, point: ShadingPoint, bsdf: Bsdf):
    """Return the BSDF of one of the nodes with a single lobe."""
    wo = point.wo
    weight = wp.max(closure.weight, wp.vec3(0.0))
    tint = wp.max(closure.color, wp.vec3(0.0))
    color = wp.cw_mul(weight, tint)
    cos_o = wp.dot(bsdf.specular_normal, wo)
    if closure.kind == CLOSURE_DIFFUSE:
        bsdf.diffuse = color
        bsdf = set_oren_nayar(bsdf, closure.color, closure.roughness, wo)
    elif closure.kind == CLOSURE_TRANSLUCENT:
        bsdf.translucent = color
        bsdf.normal = bsdf.specular_normal
    elif closure.kind == CLOSURE_GLOSSY:
        bsdf = prepare_glossy(tables, closure, bsdf, color, cos_o)
    elif closure.kind == CLOSURE_GLASS:
        ior = wp.max(closure.ior, IOR_MIN)
        bsdf = add_glass(
            tables, bsdf, weight, ior, wp.clamp(closure.roughness, 0.0, 1.0), wp.vec3(f0_from_ior(ior)), tint, tint,
            point.backfacing, closure.multiscatter, cos_o,
        )  # fmt: skip
    elif closure.kind == CLOSURE_REFRACTION:
        ior = wp.max(closure.ior, IOR_MIN)
        bsdf.glass_kind = GLASS_REFRACTION
        bsdf.glass = color
        bsdf.glass_ior = wp.where(point.backfacing != 0, 1.0 / ior, ior)
        bsdf.glass_alpha = wp.min(sqr(closure.roughness), 1.0)
        bsdf.pick_glass = mean_component(color)
    elif closure.kind == CLOSURE_SHEEN:
        bsdf.sheen_normal = bsdf.normal
        roughness = wp.clamp(closure.roughness, 0.0, 1.0)
        n_dot_o = wp.dot(bsdf.normal, wo)
        transform = sheen_transform(n_dot_o, roughness)
        bsdf.sheen_a = transform[0]
        bsdf.sheen_b = transform[1]
        if wp.abs(transform[0]) >= 1.0e-5:
            bsdf.sheen = color * sheen_albedo(n_dot_o, roughness)
        bsdf.pick_sheen = mean_component(bsdf.sheen)
    elif closure.kind == CLOSURE_TOON_DIFFUSE or closure.kind == CLOSURE_TOON_GLOSSY:
        lobe = toon_lobe(closure.roughness, closure.anisotropic, closure.kind == CLOSURE_TOON_GLOSSY)
        bsdf.sheen_normal = bsdf.normal
        bsdf.sheen_a = lobe[0]
        bsdf.sheen_b = lobe[1]
        bsdf.sheen = color
        bsdf.pick_sheen = mean_component(color)
    return bsdf


@wp.func
def normalize_picks(bsdf: Bsdf, wo: wp.vec3):
    """Return the BSDF with odds that sum to 1; lobes that can't be seen from `wo` are not sampled."""
    bsdf.pick_diffuse = mean_component(bsdf.diffuse)
    bsdf.pick_translucent = mean_component(bsdf.translucent)
    if wp.dot(bsdf.specular_normal, wo) <= 0.0:
        bsdf.pick_specular = 0.0
        bsdf.pick_glass = 0.0
    if wp.dot(bsdf.coat_normal, wo) <= 0.0:
        bsdf.pick_coat = 0.0
    total = bsdf.pick_diffuse + bsdf.pick_translucent + bsdf.pick_specular + bsdf.pick_coat
    total += bsdf.pick_glass + bsdf.pick_sheen
    scale = float(0.0)
    if total > 0.0 and wp.isfinite(total):
        scale = 1.0 / total
    bsdf.pick_diffuse = bsdf.pick_diffuse * scale
    bsdf.pick_translucent = bsdf.pick_translucent * scale
    bsdf.pick_specular = bsdf.pick_specular * scale
    bsdf.pick_coat = bsdf.pick_coat * scale
    bsdf.pick_glass = bsdf.pick_glass * scale
    bsdf.pick_sheen = bsdf.pick_sheen * scale
    return bsdf


@wp.func
def largest_gain(closure: Closure) -> float:
    """Return a bound of how much more light a closure may return than it receives, 1 where that is none.

    Only weights and colours above 1 make it gain: those of BSDFs that are added, or of colours that no surface has.
    """
    reflected = max_component(closure.color)
    if closure.kind == CLOSURE_PRINCIPLED:
        reflected = wp.max(reflected, 1.0)
    return wp.max(max_component(closure.weight) * reflected, 1.0)


@wp.func
def prepare_under_film(tables: Tables, closure: Closure, point: ShadingPoint, film_thickness: float) -> Bsdf:
    """Prepare a closure for the view of `point`, with a thin film of another thickness [nm] than its own."""
    bsdf = Bsdf()
    bsdf.geometric_normal = point.geometric_normal
    bsdf.smooth_normal = point.normal
    bsdf.normal = unit_normal(closure.normal, point.normal)
    bsdf.specular_normal = valid_specular_normal(point.geometric_normal, point.wo, bsdf.normal)
    bsdf.emission = closure.emission
    bsdf.gain = largest_gain(closure)
    if film_thickness > FILM_MIN:
        bsdf.film = tables.film
        bsdf.film_thickness = film_thickness
        bsdf.film_ior = wp.max(closure.film_ior, IOR_MIN)
    if closure.kind == CLOSURE_PRINCIPLED:
        bsdf = prepare_principled(tables, closure, point, bsdf)
    else:
        bsdf = prepare_simple(tables, closure, point, bsdf)
    return normalize_picks(bsdf, point.wo)


@wp.func
def prepare_bsdf(tables: Tables, closure: Closure, point: ShadingPoint) -> Bsdf:
    """Prepare a closure for the view of `point`."""
    return prepare_under_film(tables, closure, point, closure.film_thickness)
