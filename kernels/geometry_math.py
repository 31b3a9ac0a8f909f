# SPDX-License-Identifier: GPL-3.0-or-later
"""Vector and colour helpers shared by the kernels: frames, safe normalisation, luminance, error bounds."""

from __future__ import annotations

import warp as wp

PI = wp.constant(3.14159265358979)
TWO_PI = wp.constant(6.28318530717959)
INV_PI = wp.constant(0.31830988618379)

# Half an ulp at 1: every rounded float operation errs by at most this, relatively.
UNIT_ROUNDOFF = wp.constant(5.9604645e-8)


@wp.func
def sqr(x: float) -> float:
    """Return x * x."""
    return x * x


@wp.func
def safe_sqrt(x: float) -> float:
    """Return the root of x, 0 for negative x (rounding)."""
    return wp.sqrt(wp.max(x, 0.0))


@wp.func
def max_component(v: wp.vec3) -> float:
    """Return the largest component."""
    return wp.max(v[0], wp.max(v[1], v[2]))


@wp.func
def mean_component(v: wp.vec3) -> float:
    """Return the mean of the components."""
    return (v[0] + v[1] + v[2]) * 0.33333334


@wp.func
def clamp3(v: wp.vec3) -> wp.vec3:
    """Limit every component to 0..1; what is no number becomes 0."""
    return wp.vec3(wp.clamp(v[0], 0.0, 1.0), wp.clamp(v[1], 0.0, 1.0), wp.clamp(v[2], 0.0, 1.0))


@wp.func
def is_finite3(v: wp.vec3) -> bool:
    """Return whether no component is NaN or infinite."""
    return wp.isfinite(v[0]) and wp.isfinite(v[1]) and wp.isfinite(v[2])


@wp.func
def finite_or_zero(v: wp.vec3) -> wp.vec3:
    """Return v without negative components, 0 where one is not finite."""
    if is_finite3(v):
        return wp.max(v, wp.vec3(0.0, 0.0, 0.0))
    return wp.vec3(0.0, 0.0, 0.0)


@wp.func
def normalize_or(v: wp.vec3, fallback: wp.vec3) -> wp.vec3:
    """Return v / |v|, or `fallback` where v is too short to have a direction."""
    length = wp.length(v)
    if length > 1.0e-30:
        return v / length
    return fallback


@wp.func
def orthonormal_tangent(n: wp.vec3) -> wp.vec3:
    """Return a unit vector perpendicular to the unit vector n (Duff et al. 2017, branchless basis)."""
    s = wp.where(n[2] >= 0.0, 1.0, -1.0)
    a = -1.0 / (s + n[2])
    return wp.vec3(1.0 + s * n[0] * n[0] * a, s * n[0] * n[1] * a, -s * n[0])


@wp.func
def to_frame(n: wp.vec3, local: wp.vec3) -> wp.vec3:
    """Rotate `local` (z along the normal) into the frame about the unit vector n."""
    t = orthonormal_tangent(n)
    b = wp.cross(n, t)
    return t * local[0] + b * local[1] + n * local[2]


@wp.func
def transform_point(m: wp.mat44, p: wp.vec3) -> wp.vec3:
    """Apply an affine matrix to a point."""
    return wp.vec3(
        m[0, 0] * p[0] + m[0, 1] * p[1] + m[0, 2] * p[2] + m[0, 3],
        m[1, 0] * p[0] + m[1, 1] * p[1] + m[1, 2] * p[2] + m[1, 3],
        m[2, 0] * p[0] + m[2, 1] * p[1] + m[2, 2] * p[2] + m[2, 3],
    )


@wp.func
def transform_direction(m: wp.mat44, d: wp.vec3) -> wp.vec3:
    """Apply the linear part of an affine matrix."""
    return wp.vec3(
        m[0, 0] * d[0] + m[0, 1] * d[1] + m[0, 2] * d[2],
        m[1, 0] * d[0] + m[1, 1] * d[1] + m[1, 2] * d[2],
        m[2, 0] * d[0] + m[2, 1] * d[1] + m[2, 2] * d[2],
    )


@wp.func
def transform_normal(inverse: wp.mat44, n: wp.vec3) -> wp.vec3:
    """Apply the transposed linear part of `inverse` (the inverse of the point transform); not normalised."""
    return wp.vec3(
        inverse[0, 0] * n[0] + inverse[1, 0] * n[1] + inverse[2, 0] * n[2],
        inverse[0, 1] * n[0] + inverse[1, 1] * n[1] + inverse[2, 1] * n[2],
        inverse[0, 2] * n[0] + inverse[1, 2] * n[1] + inverse[2, 2] * n[2],
    )


@wp.func
def luminance(color: wp.vec3, weights: wp.vec3) -> float:
    """Return the luminance of a scene-linear colour by the working space's weights."""
    return wp.dot(color, weights)


@wp.func
def power_heuristic(a: float, b: float) -> float:
    """Return the weight of the strategy with pdf a against one with pdf b (Veach 1997, beta = 2)."""
    if a <= 0.0:
        return 0.0
    r = b / a
    return 1.0 / (1.0 + r * r)


@wp.func
def over_albedo(light: wp.vec3, albedo: wp.vec3) -> wp.vec3:
    """Return light / albedo for each channel; 0 where nothing is reflected."""
    r = wp.vec3(0.0, 0.0, 0.0)
    for c in range(3):
        if albedo[c] > 0.0:
            r[c] = light[c] / albedo[c]
    return r
