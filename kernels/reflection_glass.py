# SPDX-License-Identifier: GPL-3.0-or-later
"""Light through glass: directions of a BSDF's glass lobe. Functions.

At the pixel they are drawn from the transmitting half alone, since reflection has samples of its own; so their weights'
mean is its albedo. Inside of glass they are drawn from both halves: light that is reflected there stays under way, for
any roughness, until it gets out. What rough glass has thrown about for some time gets out evenly.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import SMOOTH_ETA, glass_albedo
from .fresnel import fresnel_dielectric
from .geometry_math import INV_PI, orthonormal_tangent, to_frame
from .ggx import (
    ggx_glass_reflection,
    ggx_reflection,
    ggx_refraction,
    reflect_about,
    refract_about,
    sample_ggx_normal,
    sample_ggx_reflection,
)
from .lobe_setup import GLASS_INTERFACE, GLASS_THIN
from .lobes import glass_fresnel, is_smooth, mirrored_below, to_local
from .principled import to_world
from .reflectance import BsdfAlbedo
from .reflection_rays import PDF_MAX
from .sampling import sample_cosine
from .types import VISIBLE_GLOSSY, VISIBLE_TRANSMISSION, Bsdf, ShadingPoint, Tables

# Surfaces after which a ray leaves rough glass with its next one, and what counts as rough.
INSIDE_SURFACES = wp.constant(3)
INSIDE_ALPHA = wp.constant(0.09)

# Alpha up to which glass is clear: rays that got in get out.
CLEAR_ALPHA = wp.constant(0.005)


@wp.struct
class GlassSample:
    """A direction through glass."""

    wi: wp.vec3
    weight: wp.vec3
    """f * |cos| / pdf; 0: absorbed"""
    pdf: float
    """[1/sr]; PDF_MAX for smooth glass. 0: there is no direction"""
    kind: int
    """VISIBLE_TRANSMISSION, VISIBLE_GLOSSY: to which side it leads"""


@wp.func
def pass_sheet(bsdf: Bsdf, local_o: wp.vec3, u: wp.vec2):
    """Return (direction, its weight without tints, density) of what passes a thin wall."""
    alpha = bsdf.thin_alpha
    if is_smooth(alpha, alpha):
        return -local_o, 1.0, PDF_MAX
    above = sample_ggx_reflection(local_o, alpha, alpha, u)
    lobe = ggx_reflection(local_o, above, alpha, alpha)
    weight = float(0.0)
    if lobe[1] > 0.0:
        weight = lobe[0] / lobe[1]
    return mirrored_below(above), weight, lobe[1]


@wp.func
def pass_interface(bsdf: Bsdf, local_o: wp.vec3, m: wp.vec3, smooth: bool):
    """Return (direction, its weight without tints, density) of what the facet `m` refracts."""
    wi = refract_about(local_o, m, bsdf.glass_ior)
    if smooth or wp.abs(bsdf.glass_ior - 1.0) < SMOOTH_ETA:
        return wi, 1.0, PDF_MAX
    lobe = ggx_refraction(local_o, wi, bsdf.glass_alpha, bsdf.glass_ior)
    weight = float(0.0)
    if lobe[1] > 0.0:
        weight = lobe[0] / lobe[1]
    return wi, weight, lobe[1]


@wp.func
def sample_transmission(bsdf: Bsdf, wo: wp.vec3, u: wp.vec2) -> GlassSample:
    """Draw a direction through the surface; total internal reflection counts as absorbed."""
    s = GlassSample()
    s.kind = VISIBLE_TRANSMISSION
    n = bsdf.specular_normal
    t = orthonormal_tangent(n)
    local_o = to_local(t, n, wo)
    if not (bsdf.pick_glass > 0.0 and local_o[2] > 0.0):
        return s
    smooth = is_smooth(bsdf.glass_alpha, bsdf.glass_alpha)
    m = wp.vec3(0.0, 0.0, 1.0)
    if bsdf.glass_kind != GLASS_THIN and not smooth:
        m = sample_ggx_normal(local_o, bsdf.glass_alpha, bsdf.glass_alpha, u)
    _r, transmitted, probability = glass_fresnel(bsdf, wp.dot(local_o, m))
    if probability < 0.0:
        return s
    local_i, weight, pdf = pass_interface(bsdf, local_o, m, smooth)
    if bsdf.glass_kind == GLASS_THIN:
        local_i, weight, pdf = pass_sheet(bsdf, local_o, u)
    # Above the surface, or the zero vector of total internal reflection.
    if not local_i[2] < 0.0:
        return s
    s.wi = to_world(t, n, local_i)
    s.pdf = wp.min(pdf, PDF_MAX)
    if wp.dot(bsdf.geometric_normal, s.wi) < 0.0:
        s.weight = wp.cw_mul(bsdf.glass, transmitted) * weight
    return s


@wp.func
def is_inside(bsdf: Bsdf, point: ShadingPoint) -> bool:
    """Return whether a surface is glass that is seen from its inside."""
    return point.backfacing != 0 and bsdf.pick_glass > 0.0 and bsdf.glass_kind == GLASS_INTERFACE


@wp.func
def trapped_albedo(tables: Tables, bsdf: Bsdf, wo: wp.vec3) -> wp.vec3:
    """Return what gets out of glass in the end, of light that meets its inside: reflection there loses nothing."""
    cosine = wp.dot(bsdf.specular_normal, wo)
    energy = glass_albedo(tables, cosine, wp.sqrt(bsdf.glass_alpha), bsdf.glass_ior)[0]
    return wp.cw_mul(bsdf.glass, bsdf.glass_transmission_tint) * energy


@wp.func
def as_cached(bsdf: Bsdf, albedo: BsdfAlbedo, wo: wp.vec3) -> BsdfAlbedo:
    """Return the albedos of a surface seen from its inside with `transmitted` from trapped_albedo split as in cells.

    Cells know the light of both sides together, by the shares of all that meets them.
    """
    result = albedo
    reflected = fresnel_dielectric(wp.dot(bsdf.specular_normal, wo), bsdf.glass_ior)[0]
    result.specular = albedo.specular + albedo.transmitted * reflected
    result.transmitted = albedo.transmitted * (1.0 - reflected)
    return result


@wp.func
def let_out(bsdf: Bsdf, trapped: wp.vec3, u: wp.vec2) -> GlassSample:
    """Draw a direction out of the glass, evenly by the cosine."""
    s = GlassSample()
    local = sample_cosine(u)
    s.kind = VISIBLE_TRANSMISSION
    s.wi = wp.normalize(to_frame(-bsdf.geometric_normal, local))
    s.pdf = wp.max(local[2] * INV_PI, 1.0e-6)
    s.weight = trapped
    return s


@wp.func
def sample_inside(
    bsdf: Bsdf, trapped: wp.vec3, wo: wp.vec3, u: wp.vec2, choice: float, surfaces: int,
) -> GlassSample:
    """Draw a direction of both halves of the glass lobe, by the Fresnel term of the facet; see principled.sample_glass.

    Args:
        bsdf: For which is_inside holds.
        trapped: From trapped_albedo.
        wo: Unit direction back along the ray.
        u: Random numbers that place the facet.
        choice: Random number that chooses between reflection and refraction.
        surfaces: Met so far.
    """
    if surfaces >= INSIDE_SURFACES and bsdf.glass_alpha > INSIDE_ALPHA:
        return let_out(bsdf, trapped, u)
    s = GlassSample()
    n = bsdf.specular_normal
    t = orthonormal_tangent(n)
    local_o = to_local(t, n, wo)
    if not local_o[2] > 0.0:
        return s
    smooth = is_smooth(bsdf.glass_alpha, bsdf.glass_alpha)
    m = wp.vec3(0.0, 0.0, 1.0)
    if not smooth:
        m = sample_ggx_normal(local_o, bsdf.glass_alpha, bsdf.glass_alpha, u)
    reflected, transmitted, probability = glass_fresnel(bsdf, wp.dot(local_o, m))
    if probability < 0.0:
        return s
    if choice < probability:
        local_i = reflect_about(local_o, m)
        if not local_i[2] > 0.0:
            return s
        s.kind = VISIBLE_GLOSSY
        s.pdf = PDF_MAX
        weight = float(1.0)
        if not smooth:
            lobe = ggx_glass_reflection(local_o, local_i, bsdf.glass_alpha)
            weight = lobe[0] / wp.max(lobe[1], 1.0e-20)
            s.pdf = wp.min(lobe[1], PDF_MAX)
        s.wi = to_world(t, n, local_i)
        if wp.dot(bsdf.geometric_normal, s.wi) > 0.0:
            s.weight = wp.cw_mul(bsdf.glass, reflected) * (weight / probability)
        return s
    local_i, weight, pdf = pass_interface(bsdf, local_o, m, smooth)
    if not local_i[2] < 0.0:
        return s
    s.kind = VISIBLE_TRANSMISSION
    s.pdf = wp.min(pdf, PDF_MAX)
    s.wi = to_world(t, n, local_i)
    if wp.dot(bsdf.geometric_normal, s.wi) < 0.0:
        s.weight = wp.cw_mul(bsdf.glass, transmitted) * (weight / (1.0 - probability))
    return s
