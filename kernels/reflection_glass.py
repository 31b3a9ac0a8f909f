# SPDX-License-Identifier: GPL-3.0-or-later
"""Light through glass: directions of the transmitting half of a BSDF's glass lobe. Functions.

Drawn from that half alone, since reflection has samples of its own; so their weights' mean is its albedo.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import SMOOTH_ETA
from .geometry_math import orthonormal_tangent
from .ggx import ggx_reflection, ggx_refraction, refract_about, sample_ggx_normal, sample_ggx_reflection
from .lobe_setup import GLASS_THIN
from .lobes import glass_fresnel, is_smooth, mirrored_below, to_local
from .principled import to_world
from .reflection_rays import PDF_MAX
from .types import Bsdf


@wp.struct
class GlassSample:
    """A direction through glass."""

    wi: wp.vec3
    weight: wp.vec3
    """f * |cos| / pdf; 0: absorbed"""
    pdf: float
    """[1/sr]; PDF_MAX for smooth glass. 0: there is no direction"""


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
