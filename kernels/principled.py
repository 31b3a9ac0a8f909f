# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation and sampling of a prepared BSDF: coat, base reflection, glass, diffuse, translucent and sheen lobes.

`prepare_bsdf` (layering.py) comes first. The pdf is that of the whole mixture, so a sample's weight is f cos / pdf;
perfectly smooth lobes have no density and are met by sampling alone (`delta`). As in Cycles, a sampled direction
must lie on its lobe's side of the triangle too, while evaluation asks the shading normals only: smooth shading of
coarse meshes would show the triangles at the terminator otherwise.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import SMOOTH_ETA
from .fresnel import fresnel_dielectric
from .geometry_math import orthonormal_tangent, to_frame
from .ggx import reflect_about, refract_about, sample_ggx_normal, sample_ggx_reflection
from .layering import prepare_bsdf
from .lobe_setup import GLASS_THIN
from .lobes import (
    LOBE_COAT,
    LOBE_DIFFUSE,
    LOBE_GLASS,
    LOBE_NONE,
    LOBE_SHEEN,
    LOBE_SPECULAR,
    LOBE_TRANSLUCENT,
    base_reflectance,
    evaluate_lobes,
    glass_fresnel,
    is_smooth,
    mirrored_below,
    tangent_about,
    to_local,
)
from .sampling import BELOW_ONE, sample_cosine
from .sheen import sample_sheen
from .toon import is_glossy_toon, is_toon, sample_toon
from .types import VISIBLE_DIFFUSE, VISIBLE_GLOSSY, VISIBLE_TRANSMISSION, Bsdf, BsdfSample, BsdfValue

__all__ = ["evaluate_bsdf", "prepare_bsdf", "sample_bsdf"]

@wp.func
def to_world(t: wp.vec3, n: wp.vec3, v: wp.vec3) -> wp.vec3:
    """Return v, given in the frame (t, n x t, n), in world space."""
    return wp.normalize(t * v[0] + wp.cross(n, t) * v[1] + n * v[2])


@wp.func
def evaluate_bsdf(bsdf: Bsdf, wo: wp.vec3, wi: wp.vec3) -> BsdfValue:
    """Return f * |cos| and the pdf of sample_bsdf.

    Args:
        bsdf: Prepared for `wo`.
        wo: Unit direction to the viewer.
        wi: Unit direction to the light, on either side.
    """
    return evaluate_lobes(bsdf, wo, wi, LOBE_NONE)


@wp.func
def sample_reflection(
    n: wp.vec3, tangent: wp.vec3, alpha_x: float, alpha_y: float, wo: wp.vec3, u: wp.vec2
) -> wp.vec3:
    """Return a direction reflected by a GGX lobe, the mirror direction for a smooth one."""
    if is_smooth(alpha_x, alpha_y):
        return reflect_about(wo, n)
    t = tangent_about(n, tangent)
    return to_world(t, n, sample_ggx_reflection(to_local(t, n, wo), alpha_x, alpha_y, u))


@wp.func
def sample_glass(bsdf: Bsdf, wo: wp.vec3, u: wp.vec2, choice: float) -> BsdfSample:
    """Draw a direction of the glass lobe; the weight and pdf are set for smooth ones alone."""
    s = BsdfSample()
    n = bsdf.specular_normal
    t = orthonormal_tangent(n)
    local_o = to_local(t, n, wo)
    thin = bsdf.glass_kind == GLASS_THIN
    smooth = is_smooth(bsdf.glass_alpha, bsdf.glass_alpha)
    m = wp.vec3(0.0, 0.0, 1.0)
    if not (smooth or thin):
        m = sample_ggx_normal(local_o, bsdf.glass_alpha, bsdf.glass_alpha, u)
    r, transmittance, probability = glass_fresnel(bsdf, wp.dot(local_o, m))
    if probability < 0.0:
        return s
    weight = r
    odds = probability
    wi = reflect_about(local_o, m)
    s.kind = VISIBLE_GLOSSY
    alpha = bsdf.glass_alpha
    if choice < probability:
        if thin and not smooth:
            wi = sample_ggx_reflection(local_o, alpha, alpha, u)
    else:
        weight = transmittance
        odds = 1.0 - probability
        s.kind = VISIBLE_TRANSMISSION
        if thin:
            alpha = bsdf.thin_alpha
            smooth = is_smooth(alpha, alpha)
            if not smooth:
                wi = sample_ggx_reflection(local_o, alpha, alpha, u)
            wi = mirrored_below(wi)
        else:
            wi = refract_about(local_o, m, bsdf.glass_ior)
            smooth = smooth or wp.abs(bsdf.glass_ior - 1.0) < SMOOTH_ETA
    # Below the surface after reflecting, or above it after refracting: absorbed.
    if (s.kind == VISIBLE_GLOSSY) != (wi[2] > 0.0) or wi[2] == 0.0:
        return s
    s.wi = to_world(t, n, wi)
    s.roughness = wp.sqrt(alpha)
    if smooth:
        s.delta = 1
        s.pdf = odds
        s.weight = wp.cw_mul(bsdf.glass, weight) / wp.max(odds, 1.0e-20)
    return s


@wp.func
def choose_lobe(bsdf: Bsdf, u: float) -> wp.vec2:
    """Return (lobe, its number rescaled to [0, 1)) by the pick probabilities."""
    rest = u
    # Odds of 0 are asked for, so that compilers leave out lobes whose odds they know to be 0.
    if rest < bsdf.pick_diffuse:
        return wp.vec2(float(LOBE_DIFFUSE), rest / bsdf.pick_diffuse)
    rest -= bsdf.pick_diffuse
    if rest < bsdf.pick_specular:
        return wp.vec2(float(LOBE_SPECULAR), rest / bsdf.pick_specular)
    rest -= bsdf.pick_specular
    if bsdf.pick_glass > 0.0 and rest < bsdf.pick_glass:
        return wp.vec2(float(LOBE_GLASS), rest / bsdf.pick_glass)
    rest -= bsdf.pick_glass
    if bsdf.pick_coat > 0.0 and rest < bsdf.pick_coat:
        return wp.vec2(float(LOBE_COAT), rest / bsdf.pick_coat)
    rest -= bsdf.pick_coat
    if bsdf.pick_translucent > 0.0 and rest < bsdf.pick_translucent:
        return wp.vec2(float(LOBE_TRANSLUCENT), rest / bsdf.pick_translucent)
    rest -= bsdf.pick_translucent
    if bsdf.pick_sheen > 0.0 and rest < bsdf.pick_sheen:
        return wp.vec2(float(LOBE_SHEEN), rest / bsdf.pick_sheen)
    return wp.vec2(float(LOBE_NONE), 0.0)


@wp.func
def sample_lobe(bsdf: Bsdf, wo: wp.vec3, lobe: int, u: wp.vec2, choice: float) -> BsdfSample:
    """Draw a direction of one lobe; weight and pdf are set for smooth lobes alone (per pick of the lobe)."""
    s = BsdfSample()
    s.kind = VISIBLE_DIFFUSE
    s.roughness = 1.0
    # Odds are asked for as in choose_lobe.
    if bsdf.pick_glass > 0.0 and lobe == LOBE_GLASS:
        s = sample_glass(bsdf, wo, u, choice)
    elif lobe == LOBE_DIFFUSE:
        s.wi = to_frame(bsdf.normal, sample_cosine(u))
    elif bsdf.pick_sheen > 0.0 and lobe == LOBE_SHEEN:
        if is_toon(bsdf.sheen_a):
            s.wi = sample_toon(bsdf.sheen_normal, wo, bsdf.sheen_a, bsdf.sheen_b, u)
            if is_glossy_toon(bsdf.sheen_a, bsdf.sheen_b):
                s.kind = VISIBLE_GLOSSY
        else:
            s.wi = sample_sheen(bsdf.sheen_normal, wo, bsdf.sheen_a, bsdf.sheen_b, u)
    elif bsdf.pick_translucent > 0.0 and lobe == LOBE_TRANSLUCENT:
        s.wi = to_frame(-bsdf.normal, sample_cosine(u))
        s.kind = VISIBLE_TRANSMISSION
    else:
        s.kind = VISIBLE_GLOSSY
        n = bsdf.specular_normal
        tangent = bsdf.tangent
        alpha_x = bsdf.alpha_x
        alpha_y = bsdf.alpha_y
        if bsdf.pick_coat > 0.0 and lobe == LOBE_COAT:
            n = bsdf.coat_normal
            tangent = wp.vec3(0.0)
            alpha_x = bsdf.coat_alpha
            alpha_y = bsdf.coat_alpha
        s.wi = sample_reflection(n, tangent, alpha_x, alpha_y, wo, u)
        s.roughness = wp.sqrt(wp.sqrt(alpha_x * alpha_y))
        if is_smooth(alpha_x, alpha_y):
            s.delta = 1
            s.pdf = 1.0
            if bsdf.pick_coat > 0.0 and lobe == LOBE_COAT:
                s.weight = bsdf.coat * fresnel_dielectric(wp.dot(wo, n), bsdf.coat_ior)[0]
            else:
                s.weight = base_reflectance(bsdf, wp.dot(wo, n))
    return s


@wp.func
def pick_of(bsdf: Bsdf, lobe: int) -> float:
    """Return the pick probability of a lobe that can be smooth."""
    if lobe == LOBE_COAT:
        return bsdf.pick_coat
    if lobe == LOBE_GLASS:
        return bsdf.pick_glass
    return bsdf.pick_specular


@wp.func
def sample_bsdf(bsdf: Bsdf, wo: wp.vec3, u: wp.vec3) -> BsdfSample:
    """Draw a direction; pdf 0 means absorbed.

    Args:
        bsdf: Prepared for `wo`.
        wo: Unit direction to the viewer.
        u: In [0, 1)^3. The first number picks the lobe; what is left of it and the second place the direction, so that
            pairs stay stratified in every lobe. The third decides whether glass reflects.
    """
    absorbed = BsdfSample()
    choice = choose_lobe(bsdf, u[0])
    lobe = int(choice[0])
    if lobe == LOBE_NONE:
        return absorbed
    s = sample_lobe(bsdf, wo, lobe, wp.vec2(wp.min(choice[1], BELOW_ONE), u[1]), u[2])
    height = wp.dot(bsdf.geometric_normal, s.wi)
    if s.kind == VISIBLE_TRANSMISSION:
        height = -height
    if not height > 0.0:
        return absorbed
    if s.delta != 0:
        pick = pick_of(bsdf, lobe)
        s.weight = s.weight / pick
        s.pdf = s.pdf * pick
        return s
    value = evaluate_lobes(bsdf, wo, s.wi, lobe)
    if not value.pdf > 0.0:
        return absorbed
    s.pdf = value.pdf
    s.weight = value.f / value.pdf
    return s
