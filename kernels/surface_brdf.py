# SPDX-License-Identifier: GPL-3.0-or-later
"""The reflection model of the G-buffer's materials: diffuse, translucent and the reflecting lobes.

What gbuffer_materials.py packs from the material's real BSDF and what direct light is resampled by.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import Surface, SurfaceMaterial
from .geometry_math import INV_PI
from .normals import bump_shadowing
from .specular_lobes import lobes_value, specular_lobes


@wp.struct
class SurfaceBrdf:
    """Values f * |cos| [1/sr] for one pair of directions."""

    diffuse: wp.vec3
    specular: wp.vec3
    transmitted: wp.vec3
    """Diffuse transmission: of light from below the surface"""


@wp.func
def evaluate_specular(m: SurfaceMaterial, s: Surface, wo: wp.vec3, wi: wp.vec3) -> wp.vec3:
    """Return the reflecting lobes' value; about a normal turned so that mirrors reflect, as in the reference."""
    return lobes_value(m, specular_lobes(m, s, wo), wi)


@wp.func
def evaluate_brdf(m: SurfaceMaterial, s: Surface, smooth: wp.vec3, wo: wp.vec3, wi: wp.vec3) -> SurfaceBrdf:
    """Return all lobes' values; reflection is 0 where `wi` is below the smooth surface, transmission above it.

    Args:
        m: From load_material.
        s: From load_surface.
        smooth: Interpolated normal without normal map or bump. That of the flat triangle would cut off light that
            grazes coarse meshes.
        wo: Unit direction to the viewer.
        wi: Unit direction to the light.
    """
    result = SurfaceBrdf()
    result.diffuse = wp.vec3(0.0, 0.0, 0.0)
    result.specular = wp.vec3(0.0, 0.0, 0.0)
    result.transmitted = wp.vec3(0.0, 0.0, 0.0)
    cosine = wp.dot(s.normal, wi)
    if wp.dot(smooth, wi) > 0.0:
        shadow = bump_shadowing(s.normal, smooth, wi, True, False)
        result.diffuse = m.diffuse * (wp.max(cosine, 0.0) * INV_PI * shadow)
        result.specular = evaluate_specular(m, s, wo, wi)
    else:
        result.transmitted = m.translucent * (wp.max(-cosine, 0.0) * INV_PI)
    return result
