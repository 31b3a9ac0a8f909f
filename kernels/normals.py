# SPDX-License-Identifier: GPL-3.0-or-later
"""What shading normals that differ from the geometry need: valid reflections and the bump terminator.

Both follow Cycles (closure/bsdf_util.h and closure/bsdf.h), because they show in every picture with normal maps.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import normalize_or, safe_sqrt, sqr


@wp.func
def valid_specular_normal(geometric_normal: wp.vec3, wo: wp.vec3, normal: wp.vec3) -> wp.vec3:
    """Return `normal`, turned towards the geometric normal until the mirrored view leaves the surface.

    Solves for the normal in the plane of both whose reflection of `wo` has a set small height over the surface.

    Args:
        geometric_normal: Unit normal of the triangle, on the side of `wo`.
        wo: Unit direction to the viewer.
        normal: Unit shading normal.
    """
    wo_height = wp.dot(wo, geometric_normal)
    # A reflection may always be as shallow as the view itself.
    height = wp.min(0.9 * wo_height, 0.01)
    mirrored = normal * (2.0 * wp.dot(normal, wo)) - wo
    if wp.dot(geometric_normal, mirrored) >= height:
        return normal
    x_axis = normalize_or(normal - geometric_normal * wp.dot(normal, geometric_normal), normal)
    wo_x = wp.dot(wo, x_axis)
    # 4 a z^4 - 2 b z^2 + c = 0 for the height z of the new normal; the sign of wo_x tells the right root.
    a = wp.max(sqr(wo_x) + sqr(wo_height), 1.0e-20)
    b = 2.0 * (a + wo_height * height)
    root = safe_sqrt(sqr(b) - 4.0 * a * sqr(height + wo_height))
    z2 = wp.where(wo_x < 0.0, 0.25 * (b + root) / a, 0.25 * (b - root) / a)
    return normalize_or(x_axis * safe_sqrt(1.0 - z2) + geometric_normal * safe_sqrt(z2), normal)


@wp.func
def bump_shadowing(normal: wp.vec3, smooth_normal: wp.vec3, wi: wp.vec3, diffuse: bool, reject: bool) -> float:
    """Return the factor on a lobe for light that a bumped normal lets through (Conty Estevez et al. 2019).

    Args:
        normal: The lobe's normal.
        smooth_normal: Interpolated normal without normal map or bump.
        wi: Unit direction to the light.
        diffuse: Whether the lobe is diffuse: soften the terminator too.
        reject: Whether to return 0 for light that passes the lobe's side but not the smooth surface's.
    """
    if normal[0] == smooth_normal[0] and normal[1] == smooth_normal[1] and normal[2] == smooth_normal[2]:
        return 1.0
    cos_i = wp.dot(smooth_normal, wi)
    cos_d = wp.dot(smooth_normal, normal)
    if (reject or diffuse) and cos_i * cos_d * wp.dot(normal, wi) < 0.0:
        return 0.0
    if not diffuse:
        return 1.0
    cos_i = wp.abs(cos_i)
    cos_d = wp.abs(cos_d)
    if cos_d >= 1.0 or cos_i >= 1.0:
        return 1.0
    # Below this the tangent overflows; the masking is 0 there anyway.
    if cos_i < 1.0e-6 or cos_d < 1.0e-6:
        return 0.0
    alpha2 = wp.clamp(0.125 * (1.0 / sqr(cos_d) - 1.0), 0.0, 1.0)
    return 2.0 / (1.0 + wp.sqrt(1.0 + alpha2 * (1.0 / sqr(cos_i) - 1.0)))
