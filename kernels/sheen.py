# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheen of fibres: a linearly transformed cosine per view and roughness.

The model is Zeltner, Burley and Chiang, "Practical Multiple-Scattering Sheen Using Linearly Transformed Cosines"
(2022). Its three parameters come from the closed-form fits to the authors' tables that MaterialX publishes
(mx_microfacet_sheen.glsl): x = cosine of the view, y = roughness.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import INV_PI, TWO_PI, orthonormal_tangent, safe_sqrt, sqr
from .sampling import sample_cosine

SHEEN_ROUGHNESS_MIN = wp.constant(0.01)
"""The fits hold from here on."""


@wp.func
def sheen_albedo(cos_o: float, roughness: float) -> float:
    """Return the directional albedo, a Gaussian in the cosine plus an offset."""
    x = wp.clamp(cos_o, 0.0, 1.0)
    y = wp.clamp(roughness, SHEEN_ROUGHNESS_MIN, 1.0)
    width = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y))
    mean = y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y * y))) / (0.046391 + y)
    offset = y * (0.000654023 + (-0.0207818 + 0.119681 * y) * y) / (1.26264 + y * (-1.92021 + y))
    gaussian = wp.exp(-0.5 * sqr((x - mean) / width)) / (width * wp.sqrt(TWO_PI))
    return wp.clamp(gaussian + offset, 0.0, 1.0)


@wp.func
def sheen_transform(cos_o: float, roughness: float) -> wp.vec2:
    """Return (a, b) of the inverse transform: (x, y, z) -> (a x + b z, a y, z)."""
    x = wp.clamp(cos_o, 0.0, 1.0)
    y = wp.clamp(roughness, SHEEN_ROUGHNESS_MIN, 1.0)
    a = (2.58126 * x + 0.813703 * y) * y / (1.0 + 0.310327 * x * x + 2.60994 * x * y)
    b = safe_sqrt(1.0 - x) * (y - 1.0) * y * y * y / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y)
    return wp.vec2(a, b)


@wp.func
def sheen_tangent(n: wp.vec3, wo: wp.vec3) -> wp.vec3:
    """Return the unit tangent in the plane of normal and view."""
    t = wo - n * wp.dot(n, wo)
    length = wp.length(t)
    # The lobe is symmetric about the normal when the view is along it, so any tangent will do.
    if length < 1.0e-5:
        return orthonormal_tangent(n)
    return t / length


@wp.func
def evaluate_sheen(n: wp.vec3, wo: wp.vec3, wi: wp.vec3, a: float, b: float) -> float:
    """Return the lobe for albedo 1, cosine included; it is its own pdf."""
    z = wp.dot(n, wi)
    if z <= 0.0:
        return 0.0
    t = sheen_tangent(n, wo)
    x = wp.dot(t, wi)
    y = wp.dot(wp.cross(n, t), wi)
    return INV_PI * z * sqr(a / (sqr(a * x + b * z) + sqr(a * y) + z * z))


@wp.func
def sample_sheen(n: wp.vec3, wo: wp.vec3, a: float, b: float, u: wp.vec2) -> wp.vec3:
    """Return a direction with the pdf of evaluate_sheen."""
    c = sample_cosine(u)
    t = sheen_tangent(n, wo)
    local = wp.normalize(wp.vec3(c[0] - c[2] * b, c[1], c[2] * a))
    return wp.normalize(t * local[0] + wp.cross(n, t) * local[1] + n * local[2])
