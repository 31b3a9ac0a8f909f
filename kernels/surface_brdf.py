# SPDX-License-Identifier: GPL-3.0-or-later
"""The reflection model of the G-buffer's materials: one diffuse, one translucent and one GGX lobe.

What gbuffer_materials.py packs from the material's real BSDF and what direct light is resampled by.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import Surface, SurfaceMaterial
from .geometry_math import INV_PI, orthonormal_tangent, sqr
from .ggx import ggx_reflection
from .normals import bump_shadowing, valid_specular_normal

# Least GGX alpha (a perceptual roughness of 0.022): below it a lobe is narrower than what float32 and one light
# sample a pixel can meet.
ALPHA_MIN = wp.constant(5.0e-4)


@wp.struct
class SurfaceBrdf:
    """Values f * |cos| [1/sr] for one pair of directions."""

    diffuse: wp.vec3
    specular: wp.vec3
    transmitted: wp.vec3
    """Diffuse transmission: of light from below the surface"""


@wp.func
def surface_alpha(roughness: float) -> float:
    """Return the GGX alpha of a perceptual roughness."""
    return wp.max(sqr(roughness), ALPHA_MIN)


@wp.func
def schlick(f0: wp.vec3, f90: float, cos_h: float) -> wp.vec3:
    """Return f0 + (f90 - f0) (1 - cos)^5 (Schlick 1994)."""
    m = wp.clamp(1.0 - cos_h, 0.0, 1.0)
    m5 = sqr(sqr(m)) * m
    return f0 * (1.0 - m5) + wp.vec3(f90, f90, f90) * m5


@wp.func
def evaluate_specular(m: SurfaceMaterial, s: Surface, wo: wp.vec3, wi: wp.vec3) -> wp.vec3:
    """Return the GGX lobe's value; about a normal turned so that mirrors reflect, as in the reference."""
    n = valid_specular_normal(s.geometric_normal, wo, s.normal)
    t = orthonormal_tangent(n)
    b = wp.cross(n, t)
    local_o = wp.vec3(wp.dot(t, wo), wp.dot(b, wo), wp.dot(n, wo))
    local_i = wp.vec3(wp.dot(t, wi), wp.dot(b, wi), wp.dot(n, wi))
    alpha = surface_alpha(m.roughness)
    lobe = ggx_reflection(local_o, local_i, alpha, alpha)
    return schlick(m.f0, m.f90, lobe[2]) * lobe[0]


@wp.func
def evaluate_brdf(m: SurfaceMaterial, s: Surface, wo: wp.vec3, wi: wp.vec3) -> SurfaceBrdf:
    """Return all lobes' values; reflection is 0 where `wi` is below the geometric surface, transmission above it.

    Args:
        m: From load_material.
        s: From load_surface.
        wo: Unit direction to the viewer.
        wi: Unit direction to the light.
    """
    result = SurfaceBrdf()
    result.diffuse = wp.vec3(0.0, 0.0, 0.0)
    result.specular = wp.vec3(0.0, 0.0, 0.0)
    result.transmitted = wp.vec3(0.0, 0.0, 0.0)
    cosine = wp.dot(s.normal, wi)
    if wp.dot(s.geometric_normal, wi) > 0.0:
        # The G-buffer's geometric normal stands for the smooth one: where no bump is, both nearly agree.
        shadow = bump_shadowing(s.normal, s.geometric_normal, wi, True, False)
        result.diffuse = m.diffuse * (wp.max(cosine, 0.0) * INV_PI * shadow)
        result.specular = evaluate_specular(m, s, wo, wi)
    else:
        result.transmitted = m.translucent * (wp.max(-cosine, 0.0) * INV_PI)
    return result
