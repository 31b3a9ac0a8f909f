# SPDX-License-Identifier: GPL-3.0-or-later
"""The reflecting lobes of the G-buffer's materials: a GGX lobe and the coat's, their mixture's density and sampling.

What reflection rays are drawn from and filters weigh neighbours by: one density for the mixture, by the lobes'
albedos, so that a sharp coat on a rough base needs no image of its own. Bounded visible normals (Eto and Tokuyoshi
2023).
"""

from __future__ import annotations

import warp as wp

from .fresnel import grazing_share, metal_part
from .gbuffer import Surface, SurfaceMaterial
from .geometry_math import max_component, mean_component, orthonormal_tangent, sqr
from .ggx import ggx_reflection, sample_ggx_reflection
from .normals import valid_specular_normal

# Least GGX alpha (a perceptual roughness of 0.022): below it a lobe is narrower than what float32 and one light
# sample a pixel can meet.
ALPHA_MIN = wp.constant(5.0e-4)

# Reflectance of a coat along its normal by that at grazing angles (index 1.5, Blender's default).
COAT_F0 = wp.constant(0.04)
# How much a rough coat's half vectors turn to the view at grazing angles; see coat_albedo.
COAT_TURN = wp.constant(1.2)


@wp.struct
class SpecularLobes:
    """A surface's reflecting lobes for one view."""

    tangent: wp.vec3
    bitangent: wp.vec3
    normal: wp.vec3
    """Turned so that mirrors reflect above the surface, as in the reference"""
    local_o: wp.vec3
    """View in that frame"""
    alpha: float
    coat_alpha: float
    coat_share: float
    """Of the samples: the coat's albedo by that of both lobes (coat_share)"""


@wp.func
def surface_alpha(roughness: float) -> float:
    """Return the GGX alpha of a perceptual roughness."""
    return wp.max(sqr(roughness), ALPHA_MIN)


@wp.func
def facet_reflectance(f0: wp.vec3, f90: float, cos_h: float) -> wp.vec3:
    """Return the reflectance of a facet between f0 along its normal and f90 at grazing angles."""
    share = grazing_share(cos_h, metal_part(mean_component(f0), f90))
    return f0 * (1.0 - share) + wp.vec3(f90, f90, f90) * share


@wp.func
def coat_reflectance(cos_h: float) -> float:
    """Return Schlick's reflectance from COAT_F0 to 1."""
    m = wp.clamp(1.0 - cos_h, 0.0, 1.0)
    return COAT_F0 + (1.0 - COAT_F0) * (sqr(sqr(m)) * m)


@wp.func
def coat_albedo(cosine: float, roughness: float) -> float:
    """Return the directional albedo of a GGX lobe of Schlick's reflectance from COAT_F0 to 1.

    A fit: Schlick at a cosine that roughness turns to the normal, by what shadowing takes. Exact for mirrors; within
    4 % up to a roughness of 0.5, 8 % up to 1, for views up to 84 degrees aslant.
    """
    c = wp.clamp(cosine, 0.0, 1.0)
    r = roughness
    turned = wp.min(wp.sqrt(sqr(c) + COAT_TURN * wp.pow(r, 2.5) * (1.0 - sqr(c))), 1.0)
    p = -5.932 + c * (4.405 + c * (4.615 - 3.135 * c)) + r * (
        9.288 + c * (-7.951 - 0.951 * c) + r * (-4.087 + 5.466 * c + 0.32 * r))
    return coat_reflectance(turned) / (1.0 + sqr(r) * p)


@wp.func
def coat_share(m: SurfaceMaterial) -> float:
    """Return the share of a material's samples that its coat gets: all where the base reflects nothing."""
    if m.f90 + max_component(m.f0) <= 0.0:
        return 1.0
    return wp.clamp(m.coat / wp.max(mean_component(m.specular), 1.0e-6), 0.0, 1.0)


@wp.func
def specular_lobes(m: SurfaceMaterial, s: Surface, wo: wp.vec3) -> SpecularLobes:
    """Return a surface's lobes for the view `wo`."""
    lobes = SpecularLobes()
    lobes.normal = valid_specular_normal(s.geometric_normal, wo, s.normal)
    lobes.tangent = orthonormal_tangent(lobes.normal)
    lobes.bitangent = wp.cross(lobes.normal, lobes.tangent)
    lobes.local_o = lobe_frame(lobes, wo)
    lobes.alpha = surface_alpha(m.roughness)
    lobes.coat_alpha = lobes.alpha
    lobes.coat_share = 0.0
    if m.coat > 0.0:
        lobes.coat_alpha = surface_alpha(m.coat_roughness)
        lobes.coat_share = coat_share(m)
    return lobes


@wp.func
def lobe_frame(lobes: SpecularLobes, v: wp.vec3) -> wp.vec3:
    """Return a direction in the lobes' frame."""
    return wp.vec3(wp.dot(lobes.tangent, v), wp.dot(lobes.bitangent, v), wp.dot(lobes.normal, v))


@wp.func
def sample_lobes(lobes: SpecularLobes, u: wp.vec2, pick: float) -> wp.vec3:
    """Return a direction drawn from the mixture; it may lie below the surface.

    Args:
        lobes: From specular_lobes.
        u: Random numbers that place it.
        pick: Random number that chooses the lobe.
    """
    alpha = wp.where(pick < lobes.coat_share, lobes.coat_alpha, lobes.alpha)
    d = sample_ggx_reflection(lobes.local_o, alpha, alpha, u)
    return wp.normalize(lobes.tangent * d[0] + lobes.bitangent * d[1] + lobes.normal * d[2])


@wp.func
def lobes_pdf(lobes: SpecularLobes, wi: wp.vec3) -> float:
    """Return the density [1/sr] of sample_lobes; 0 below the surface."""
    local_i = lobe_frame(lobes, wi)
    pdf = ggx_reflection(lobes.local_o, local_i, lobes.alpha, lobes.alpha)[1] * (1.0 - lobes.coat_share)
    if lobes.coat_share > 0.0:
        pdf += ggx_reflection(lobes.local_o, local_i, lobes.coat_alpha, lobes.coat_alpha)[1] * lobes.coat_share
    return pdf


@wp.func
def lobes_value(m: SurfaceMaterial, lobes: SpecularLobes, wi: wp.vec3) -> wp.vec3:
    """Return f * cos [1/sr] of all reflecting lobes; 0 below the surface."""
    local_i = lobe_frame(lobes, wi)
    lobe = ggx_reflection(lobes.local_o, local_i, lobes.alpha, lobes.alpha)
    value = facet_reflectance(m.f0, m.f90, lobe[2]) * lobe[0]
    if lobes.coat_share > 0.0:
        coat = ggx_reflection(lobes.local_o, local_i, lobes.coat_alpha, lobes.coat_alpha)
        k = m.coat / coat_albedo(lobes.local_o[2], m.coat_roughness) * coat_reflectance(coat[2]) * coat[0]
        value += wp.vec3(k, k, k)
    return value
