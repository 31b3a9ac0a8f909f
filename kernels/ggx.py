# SPDX-License-Identifier: GPL-3.0-or-later
"""The GGX microfacet distribution: density, Smith masking, and sampling of visible normals.

All directions are in the tangent frame (z along the normal), wo.z > 0. Reflection uses the bounded visible-normal
sampling of Eto and Tokuyoshi ("Bounded VNDF Sampling for Smith-GGX Reflections", 2023) in the spherical-cap form
of Dupuy and Benyoub (2023): fewer samples go below the horizon. Glass uses the plain visible normals, because the
bound holds for reflected directions only.
"""

from __future__ import annotations

import warp as wp

from .fresnel import fresnel_dielectric
from .geometry_math import INV_PI, TWO_PI, safe_sqrt, sqr

# alpha_x * alpha_y up to this is a perfect mirror, Cycles' roughness_is_almost_specular: below it float32 can't
# tell the half vectors of neighbouring directions apart.
SPECULAR_ALPHA2 = wp.constant(2.0e-10)


@wp.func
def ggx_d(m: wp.vec3, alpha_x: float, alpha_y: float) -> float:
    """Return the density of microfacet normals [1/sr], 0 for normals below the surface."""
    if m[2] <= 0.0:
        return 0.0
    # Written with m.xy instead of 1 - m.z^2, which cancels for small alpha.
    e = sqr(m[0] / alpha_x) + sqr(m[1] / alpha_y) + sqr(m[2])
    return INV_PI / (alpha_x * alpha_y * e * e)


@wp.func
def ggx_lambda(v: wp.vec3, alpha_x: float, alpha_y: float) -> float:
    """Return Smith's Lambda (Heitz 2014, eq. 72); the masking is 1 / (1 + Lambda)."""
    # A direction in the surface plane is masked fully: 1e-20 keeps its Lambda finite.
    t2 = (sqr(alpha_x * v[0]) + sqr(alpha_y * v[1])) / wp.max(sqr(v[2]), 1.0e-20)
    return 0.5 * (wp.sqrt(1.0 + t2) - 1.0)


@wp.func
def reflect_about(v: wp.vec3, m: wp.vec3) -> wp.vec3:
    """Mirror v, which points away from the surface, about m."""
    return m * (2.0 * wp.dot(v, m)) - v


@wp.func
def cap_normal(wo: wp.vec3, alpha_x: float, alpha_y: float, height: float, u: wp.vec2) -> wp.vec3:
    """Return a normal from the spherical cap z in (-height, 1] around the stretched view, unstretched."""
    stretched = wp.normalize(wp.vec3(alpha_x * wo[0], alpha_y * wo[1], wo[2]))
    b = height * stretched[2]
    z = (1.0 - u[0]) * (1.0 + b) - b
    r = safe_sqrt(1.0 - z * z)
    phi = TWO_PI * u[1]
    h = wp.vec3(stretched[0] + r * wp.cos(phi), stretched[1] + r * wp.sin(phi), stretched[2] + z)
    # The sum vanishes only for the direction opposite to the view, which has probability 0.
    return wp.normalize(wp.vec3(alpha_x * h[0], alpha_y * h[1], wp.max(h[2], 1.0e-12)))


@wp.func
def bounded_cap(wo: wp.vec3, alpha_x: float, alpha_y: float) -> float:
    """Return the factor k by which the cap of reflected directions is shorter than the whole one."""
    a2 = sqr(wp.min(wp.min(alpha_x, alpha_y), 1.0))
    s2 = sqr(1.0 + wp.sqrt(sqr(wo[0]) + sqr(wo[1])))
    return (1.0 - a2) * s2 / (s2 + a2 * sqr(wo[2]))


@wp.func
def sample_ggx_reflection(wo: wp.vec3, alpha_x: float, alpha_y: float, u: wp.vec2) -> wp.vec3:
    """Return the reflected direction; it may lie below the surface (absorbed)."""
    m = cap_normal(wo, alpha_x, alpha_y, bounded_cap(wo, alpha_x, alpha_y), u)
    return reflect_about(wo, m)


@wp.func
def sample_ggx_normal(wo: wp.vec3, alpha_x: float, alpha_y: float, u: wp.vec2) -> wp.vec3:
    """Return a visible normal with pdf D(m) max(wo.m, 0) / (wo.z (1 + Lambda(wo)))."""
    return cap_normal(wo, alpha_x, alpha_y, 1.0, u)


@wp.func
def ggx_reflection(wo: wp.vec3, wi: wp.vec3, alpha_x: float, alpha_y: float) -> wp.vec3:
    """Return (BRDF times wi.z for Fresnel 1, pdf of sample_ggx_reflection, cosine at the half vector)."""
    if wo[2] <= 0.0 or wi[2] <= 0.0:
        return wp.vec3(0.0)
    m = wp.normalize(wo + wi)
    d = ggx_d(m, alpha_x, alpha_y)
    length = wp.sqrt(sqr(alpha_x * wo[0]) + sqr(alpha_y * wo[1]) + sqr(wo[2]))
    lambda_o = 0.5 * (length / wo[2] - 1.0)
    value = d / (4.0 * wo[2] * (1.0 + lambda_o + ggx_lambda(wi, alpha_x, alpha_y)))
    pdf = d / (2.0 * (bounded_cap(wo, alpha_x, alpha_y) * wo[2] + length))
    return wp.vec3(value, pdf, wp.dot(wo, m))


@wp.func
def ggx_glass_reflection(wo: wp.vec3, wi: wp.vec3, alpha: float) -> wp.vec3:
    """Return (BRDF times wi.z for Fresnel 1, pdf of sample_ggx_normal then reflecting, cosine at the half vector)."""
    if wo[2] <= 0.0 or wi[2] <= 0.0:
        return wp.vec3(0.0)
    m = wp.normalize(wo + wi)
    common = ggx_d(m, alpha, alpha) / (4.0 * wo[2])
    lambda_o = ggx_lambda(wo, alpha, alpha)
    value = common / (1.0 + lambda_o + ggx_lambda(wi, alpha, alpha))
    return wp.vec3(value, common / (1.0 + lambda_o), wp.dot(wo, m))


@wp.func
def ggx_refraction(wo: wp.vec3, wi: wp.vec3, alpha: float, eta: float) -> wp.vec3:
    """Return (BTDF times |wi.z| for transmittance 1, pdf of sample_ggx_normal then refracting, cosine at the normal).

    Walter et al. 2007, eq. 21, without the compression of radiance, so that a clear interface conserves its sum.

    Args:
        wo: View, above the surface.
        wi: Direction below the surface.
        alpha: Roughness.
        eta: Index on wi's side over the index on wo's side.
    """
    if wo[2] <= 0.0 or wi[2] >= 0.0:
        return wp.vec3(0.0)
    h = -(wo + wi * eta)
    length = wp.length(h)
    if length < 1.0e-12:
        return wp.vec3(0.0)
    # The half vector points to the optically thinner side.
    m = h / length
    cos_o = wp.dot(wo, m)
    cos_i = wp.dot(wi, m)
    if eta < 1.0:
        m = -m
        cos_o = -cos_o
        cos_i = -cos_i
    if cos_o <= 0.0 or cos_i >= 0.0:
        return wp.vec3(0.0)
    jacobian = sqr(eta / length) * wp.abs(cos_o * cos_i)
    common = ggx_d(m, alpha, alpha) * jacobian / wo[2]
    lambda_o = ggx_lambda(wo, alpha, alpha)
    value = common / (1.0 + lambda_o + ggx_lambda(wi, alpha, alpha))
    return wp.vec3(value, common / (1.0 + lambda_o), cos_o)


@wp.func
def refract_about(wo: wp.vec3, m: wp.vec3, eta: float) -> wp.vec3:
    """Refract wo at the normal m; the zero vector for total internal reflection."""
    cos_o = wp.dot(wo, m)
    f = fresnel_dielectric(cos_o, eta)
    if f[0] >= 1.0:
        return wp.vec3(0.0)
    return m * (cos_o / eta - f[1]) - wo / eta
