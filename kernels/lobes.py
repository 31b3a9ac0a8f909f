# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation of the lobes of a prepared BSDF: base reflection, glass, coat, diffuse, translucent and sheen.

Values are f * |cos|. Perfectly smooth lobes have no density and are left out: sampling alone meets them.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import SMOOTH_ETA
from .diffuse import oren_nayar
from .fresnel import fresnel_dielectric, fresnel_f82, fresnel_generalized_schlick
from .geometry_math import INV_PI, mean_component, orthonormal_tangent
from .ggx import SPECULAR_ALPHA2, ggx_glass_reflection, ggx_reflection, ggx_refraction
from .lobe_setup import GLASS_REFRACTION, GLASS_THIN
from .normals import bump_shadowing
from .sheen import evaluate_sheen
from .thin_film import film_metal, film_schlick
from .toon import evaluate_toon, is_glossy_toon, is_toon
from .types import Bsdf, BsdfValue

LOBE_NONE = wp.constant(0)
LOBE_DIFFUSE = wp.constant(1)
LOBE_SPECULAR = wp.constant(2)
LOBE_COAT = wp.constant(3)
LOBE_GLASS = wp.constant(4)
LOBE_TRANSLUCENT = wp.constant(5)
LOBE_SHEEN = wp.constant(6)


@wp.func
def is_smooth(alpha_x: float, alpha_y: float) -> bool:
    """Return whether a GGX lobe is a perfect mirror."""
    return alpha_x * alpha_y <= SPECULAR_ALPHA2


@wp.func
def tangent_about(n: wp.vec3, tangent: wp.vec3) -> wp.vec3:
    """Return the unit vector perpendicular to n that is nearest to `tangent`, any if that is zero or along n."""
    b = wp.cross(n, tangent)
    length = wp.length(b)
    if length < 1.0e-6:
        return orthonormal_tangent(n)
    return wp.cross(b / length, n)


@wp.func
def to_local(t: wp.vec3, n: wp.vec3, v: wp.vec3) -> wp.vec3:
    """Return v in the frame (t, n x t, n)."""
    return wp.vec3(wp.dot(t, v), wp.dot(wp.cross(n, t), v), wp.dot(n, v))


@wp.func
def mirrored_below(v: wp.vec3) -> wp.vec3:
    """Return v with its height negated."""
    return wp.vec3(v[0], v[1], -v[2])


@wp.func
def dielectric_reflectance(bsdf: Bsdf, cos_h: float) -> wp.vec3:
    """Return the Fresnel of the dielectric base."""
    if bsdf.film_thickness > 0.0:
        return film_schlick(
            bsdf.film, bsdf.film_thickness, bsdf.film_ior, bsdf.dielectric_ior, bsdf.dielectric_f0, cos_h)
    return fresnel_generalized_schlick(cos_h, bsdf.dielectric_ior, bsdf.dielectric_f0)


@wp.func
def base_reflectance(bsdf: Bsdf, cos_h: float) -> wp.vec3:
    """Return the weighted Fresnel of metal and dielectric, which share one GGX lobe."""
    f = wp.vec3(0.0)
    if wp.length_sq(bsdf.metal) > 0.0:
        if bsdf.metal_constant != 0:
            f = bsdf.metal
        elif bsdf.film_thickness > 0.0:
            f = wp.cw_mul(bsdf.metal, film_metal(
                bsdf.film, bsdf.film_thickness, bsdf.film_ior, bsdf.metal_f0, bsdf.metal_b, cos_h))
        else:
            f = wp.cw_mul(bsdf.metal, fresnel_f82(cos_h, bsdf.metal_f0, bsdf.metal_b))
    if wp.length_sq(bsdf.dielectric) > 0.0:
        f += wp.cw_mul(bsdf.dielectric, dielectric_reflectance(bsdf, cos_h))
    return f


@wp.func
def glass_reflectance(bsdf: Bsdf, cos_h: float) -> wp.vec3:
    """Return the Fresnel of an interface of glass."""
    if bsdf.film_thickness > 0.0:
        return film_schlick(
            bsdf.film, bsdf.film_thickness, bsdf.glass_film_ior, bsdf.glass_ior, bsdf.glass_f0, cos_h)
    return fresnel_generalized_schlick(cos_h, bsdf.glass_ior, bsdf.glass_f0)


@wp.func
def glass_fresnel(bsdf: Bsdf, cos_h: float):
    """Return (reflectance, transmittance, probability of reflecting); that is -1 where both are zero."""
    r = bsdf.glass_reflection_tint
    t = bsdf.glass_transmission_tint
    if bsdf.glass_kind == GLASS_REFRACTION:
        r = wp.vec3(0.0)
        t = wp.vec3(wp.where(fresnel_dielectric(cos_h, bsdf.glass_ior)[0] >= 1.0, 0.0, 1.0))
    elif bsdf.glass_kind != GLASS_THIN:
        f = glass_reflectance(bsdf, cos_h)
        r = wp.cw_mul(r, f)
        t = wp.cw_mul(t, wp.vec3(1.0) - f)
    total = mean_component(r) + mean_component(t)
    probability = float(-1.0)
    if total > 0.0:
        probability = mean_component(r) / total
    return r, t, probability


@wp.func
def evaluate_glass(bsdf: Bsdf, wo: wp.vec3, wi: wp.vec3) -> BsdfValue:
    """Evaluate the glass lobe alone, without its pick probability; directions in the frame of specular_normal."""
    value = BsdfValue()
    if wo[2] <= 0.0:
        return value
    reflecting = wi[2] > 0.0
    smooth = is_smooth(bsdf.glass_alpha, bsdf.glass_alpha)
    lobe = wp.vec3(0.0)
    if bsdf.glass_kind == GLASS_THIN:
        if reflecting and not smooth:
            lobe = ggx_reflection(wo, wi, bsdf.glass_alpha, bsdf.glass_alpha)
        if not reflecting and not is_smooth(bsdf.thin_alpha, bsdf.thin_alpha):
            lobe = ggx_reflection(wo, mirrored_below(wi), bsdf.thin_alpha, bsdf.thin_alpha)
    elif not smooth:
        if reflecting and bsdf.glass_kind != GLASS_REFRACTION:
            lobe = ggx_glass_reflection(wo, wi, bsdf.glass_alpha)
        if not reflecting and wp.abs(bsdf.glass_ior - 1.0) >= SMOOTH_ETA:
            lobe = ggx_refraction(wo, wi, bsdf.glass_alpha, bsdf.glass_ior)
    if lobe[1] <= 0.0:
        return value
    r, t, probability = glass_fresnel(bsdf, lobe[2])
    if probability < 0.0:
        return value
    if reflecting:
        value.f = wp.cw_mul(bsdf.glass, r) * lobe[0]
        value.pdf = probability * lobe[1]
    else:
        value.f = wp.cw_mul(bsdf.glass, t) * lobe[0]
        value.pdf = (1.0 - probability) * lobe[1]
    return value


@wp.func
def evaluate_specular_lobes(bsdf: Bsdf, wo: wp.vec3, wi: wp.vec3, sampled: int) -> BsdfValue:
    """Evaluate base reflection, glass and coat."""
    value = BsdfValue()
    if bsdf.pick_specular + bsdf.pick_glass > 0.0:
        n = bsdf.specular_normal
        t = tangent_about(n, bsdf.tangent)
        local_o = to_local(t, n, wo)
        local_i = to_local(t, n, wi)
        reject = sampled != LOBE_SPECULAR and sampled != LOBE_GLASS
        shadow = bump_shadowing(n, bsdf.smooth_normal, wi, False, reject)
        if bsdf.pick_specular > 0.0 and local_i[2] > 0.0 and not is_smooth(bsdf.alpha_x, bsdf.alpha_y):
            lobe = ggx_reflection(local_o, local_i, bsdf.alpha_x, bsdf.alpha_y)
            value.f = base_reflectance(bsdf, lobe[2]) * (lobe[0] * shadow)
            value.pdf = bsdf.pick_specular * lobe[1]
        if bsdf.pick_glass > 0.0:
            glass = evaluate_glass(bsdf, local_o, local_i)
            value.f += glass.f * shadow
            value.pdf += bsdf.pick_glass * glass.pdf
    if bsdf.pick_coat > 0.0 and not is_smooth(bsdf.coat_alpha, bsdf.coat_alpha):
        n = bsdf.coat_normal
        t = orthonormal_tangent(n)
        lobe = ggx_reflection(to_local(t, n, wo), to_local(t, n, wi), bsdf.coat_alpha, bsdf.coat_alpha)
        if lobe[1] > 0.0:
            shadow = bump_shadowing(n, bsdf.smooth_normal, wi, False, sampled != LOBE_COAT)
            value.f += bsdf.coat * (fresnel_dielectric(lobe[2], bsdf.coat_ior)[0] * lobe[0] * shadow)
            value.pdf += bsdf.pick_coat * lobe[1]
    return value


@wp.func
def evaluate_diffuse_lobes(bsdf: Bsdf, wo: wp.vec3, wi: wp.vec3, sampled: int) -> BsdfValue:
    """Evaluate diffuse, translucent, sheen and toon; `diffuse` is all but glossy toon, as in Cycles."""
    value = BsdfValue()
    n = bsdf.normal
    cos_i = wp.dot(n, wi)
    if (bsdf.pick_diffuse > 0.0 and cos_i > 0.0) or (bsdf.pick_translucent > 0.0 and cos_i < 0.0):
        shadow = bump_shadowing(n, bsdf.smooth_normal, wi, True, True)
        weight = bsdf.diffuse
        pick = bsdf.pick_diffuse
        view = wo
        if cos_i < 0.0:
            # Light that comes through scatters as if view and light were on the same side.
            weight = bsdf.translucent
            pick = bsdf.pick_translucent
            n = -n
            view = wo - n * (2.0 * wp.dot(n, wo))
            if sampled == LOBE_TRANSLUCENT:
                # Cycles shades the terminator of sampled reflections, but not of sampled transmissions.
                shadow = 1.0
        f = oren_nayar(n, view, wi, bsdf.diffuse_a, bsdf.diffuse_b, bsdf.diffuse_multiscatter)
        value.f = wp.cw_mul(weight, f) * shadow
        value.pdf = pick * wp.abs(cos_i) * INV_PI
    value.diffuse = value.f
    if bsdf.pick_sheen > 0.0:
        glossy = is_glossy_toon(bsdf.sheen_a, bsdf.sheen_b)
        lobe = wp.vec2(0.0, 0.0)
        if is_toon(bsdf.sheen_a):
            lobe = evaluate_toon(bsdf.sheen_normal, wo, wi, bsdf.sheen_a, bsdf.sheen_b)
        else:
            density = evaluate_sheen(bsdf.sheen_normal, wo, wi, bsdf.sheen_a, bsdf.sheen_b)
            lobe = wp.vec2(density, density)
        if lobe[1] > 0.0:
            reject = not glossy or sampled != LOBE_SHEEN
            shadow = bump_shadowing(bsdf.sheen_normal, bsdf.smooth_normal, wi, not glossy, reject)
            value.f += bsdf.sheen * (lobe[0] * shadow)
            value.pdf += bsdf.pick_sheen * lobe[1]
        if not glossy:
            value.diffuse = value.f
    return value


@wp.func
def evaluate_lobes(bsdf: Bsdf, wo: wp.vec3, wi: wp.vec3, sampled: int) -> BsdfValue:
    """Evaluate all lobes.

    Args:
        bsdf: Prepared for `wo`.
        wo: Unit direction to the viewer.
        wi: Unit direction to the light.
        sampled: Lobe that `wi` was drawn from, LOBE_NONE for a light's direction. The smooth normal's side is not
            asked of it unless it is diffuse (Cycles, bump_shadowing_term and bsdf_sample).
    """
    specular = evaluate_specular_lobes(bsdf, wo, wi, sampled)
    diffuse = evaluate_diffuse_lobes(bsdf, wo, wi, sampled)
    value = BsdfValue()
    value.f = specular.f + diffuse.f
    value.diffuse = diffuse.diffuse
    value.pdf = specular.pdf + diffuse.pdf
    return value
