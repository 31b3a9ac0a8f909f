# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffuse reflection: Lambert and the energy-preserving Oren-Nayar model.

Fujii's improved Oren-Nayar (mimosa-pudica.net/improved-oren-nayar.html) plus the multiple-scattering term of the
OpenPBR specification, as Cycles 5.2 has it (closure/bsdf_oren_nayar.h). b = 0 means Lambert.
"""

from __future__ import annotations

import warp as wp

from .fresnel import saturate3
from .geometry_math import INV_PI, PI, safe_sqrt, sqr

# Roughness below this is Lambert.
DIFFUSE_ROUGHNESS_MIN = wp.constant(1.0e-5)
TINY = wp.constant(1.0e-30)


@wp.func
def oren_nayar_g(cos_theta: float) -> float:
    """Return the G of the directional albedo a pi + b G(cos)."""
    if cos_theta < 1.0e-6:
        # tan(theta) overflows near the horizon: first order of the expansion.
        return (0.5 * PI - 2.0 / 3.0) - cos_theta
    c = wp.min(cos_theta, 1.0)
    s = safe_sqrt(1.0 - c * c)
    return s * (wp.acos(c) - 2.0 / 3.0 - s * c) + (2.0 / 3.0) * (s / c) * (1.0 - s * s * s)


@wp.func
def oren_nayar_ab(roughness: float) -> wp.vec2:
    """Return (a, b) for a roughness (sigma)."""
    sigma = wp.clamp(roughness, 0.0, 1.0)
    a = 1.0 / (PI + sigma * (0.5 * PI - 2.0 / 3.0))
    return wp.vec2(a, sigma * a)


@wp.func
def oren_nayar_multiscatter(color: wp.vec3, n_dot_o: float, a: float, b: float) -> wp.vec3:
    """Return the multiple-scattering term but for its factor (1 - E(n.wi))."""
    albedo = saturate3(color)
    average = a * PI + ((2.0 * PI - 5.6) / 3.0) * b
    factor = INV_PI * average / (1.0 - average) * (1.0 - a * PI - b * oren_nayar_g(wp.max(n_dot_o, 0.0)))
    return wp.vec3(
        factor * sqr(albedo[0]) / (1.0 - albedo[0] * (1.0 - average)),
        factor * sqr(albedo[1]) / (1.0 - albedo[1] * (1.0 - average)),
        factor * sqr(albedo[2]) / (1.0 - albedo[2] * (1.0 - average)),
    )


@wp.func
def oren_nayar(n: wp.vec3, wo: wp.vec3, wi: wp.vec3, a: float, b: float, multiscatter: wp.vec3) -> wp.vec3:
    """Return the BRDF for albedo 1 times max(n.wi, 0)."""
    n_dot_i = wp.max(wp.dot(n, wi), 0.0)
    if b <= 0.0:
        return wp.vec3(n_dot_i * INV_PI)
    n_dot_o = wp.max(wp.dot(n, wo), 0.0)
    t = wp.dot(wi, wo) - n_dot_i * n_dot_o
    if t > 0.0:
        t = t / wp.max(wp.max(n_dot_i, n_dot_o), TINY)
    missing = 1.0 - a * PI - b * oren_nayar_g(n_dot_i)
    f = wp.vec3(a + b * t) + multiscatter * missing
    return wp.max(f, wp.vec3(0.0)) * n_dot_i
