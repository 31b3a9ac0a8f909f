# SPDX-License-Identifier: GPL-3.0-or-later
"""Toon shading: a cone of light about the normal or the mirrored view, of one brightness with a soft edge.

As Blender's manual describes the Toon BSDF (Render > Shader Nodes > Shader > Toon BSDF): Size and Smooth are angles
between 0 and 90 degrees, inside the first all light is reflected, over the second it falls off. Against Cycles'
pictures it was measured that the fall is linear in the angle and ends at 90 degrees at the latest, and that the light
is spread as evenly over the cone as it would arrive: without a cosine, divided by the cone's solid angle.

Closures have Size in place of a roughness and Smooth in place of anisotropy. A prepared toon lobe is stored in place
of sheen, which no toon closure has: see `toon_lobe`.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import TWO_PI, orthonormal_tangent
from .ggx import reflect_about

HALF_PI = wp.constant(1.5707963267948966)
EDGE_MIN = wp.constant(1.0e-3)
"""Narrower cones [rad] meet no light."""
COSINE_ERROR = wp.constant(1.0e-6)
"""By which a sampled direction may lie outside of its cone"""


@wp.func
def toon_lobe(size: float, smooth: float, glossy: bool) -> wp.vec2:
    """Return (Bsdf.sheen_a, Bsdf.sheen_b) of a toon lobe: both below 0 as no sheen's a is; b of a glossy one below -8.

    Args:
        size: In [0, 1].
        smooth: In [0, 1].
        glossy: Whether the cone is about the mirrored view.
    """
    b = -1.0 - wp.clamp(smooth, 0.0, 1.0) * HALF_PI
    return wp.vec2(-1.0 - wp.clamp(size, 0.0, 1.0) * HALF_PI, wp.where(glossy, b - 8.0, b))


@wp.func
def is_toon(a: float) -> bool:
    """Return whether a lobe in place of sheen is a toon lobe."""
    return a < 0.0


@wp.func
def is_glossy_toon(a: float, b: float) -> bool:
    """Return whether a lobe in place of sheen is a glossy toon lobe."""
    return a < 0.0 and b < -8.0


@wp.func
def smooth_angle(b: float) -> float:
    """Return the angle over which the light falls off [rad]."""
    return -1.0 - wp.where(b < -8.0, b + 8.0, b)


@wp.func
def edge_angle(a: float, b: float) -> float:
    """Return the angle from the axis at which no light is left [rad]."""
    return wp.min(-1.0 - a + smooth_angle(b), HALF_PI)


@wp.func
def toon_axis(n: wp.vec3, wo: wp.vec3, b: float) -> wp.vec3:
    """Return the axis of a toon lobe."""
    if b < -8.0:
        return reflect_about(wo, n)
    return n


@wp.func
def evaluate_toon(n: wp.vec3, wo: wp.vec3, wi: wp.vec3, a: float, b: float) -> wp.vec2:
    """Return (value for colour 1, cosine included, and pdf) of a toon lobe; 0 below the surface, without a pdf there.

    Args:
        n: Normal.
        wo: Unit direction to the viewer.
        wi: Unit direction to the light.
        a: Bsdf.sheen_a.
        b: Bsdf.sheen_b.
    """
    edge = edge_angle(a, b)
    c = wp.dot(toon_axis(n, wo, b), wi)
    if edge < EDGE_MIN or c < wp.cos(edge) - COSINE_ERROR or wp.dot(n, wi) <= 0.0 or wp.dot(n, wo) <= 0.0:
        return wp.vec2(0.0, 0.0)
    pdf = 1.0 / (TWO_PI * (1.0 - wp.cos(edge)))
    beyond = wp.acos(wp.clamp(c, -1.0, 1.0)) + 1.0 + a
    light = float(1.0)
    if beyond > 0.0:
        light = wp.clamp(1.0 - beyond / wp.max(smooth_angle(b), 1.0e-6), 0.0, 1.0)
    return wp.vec2(pdf * light, pdf)


@wp.func
def sample_toon(n: wp.vec3, wo: wp.vec3, a: float, b: float, u: wp.vec2) -> wp.vec3:
    """Return a direction of the cone, any as likely."""
    axis = toon_axis(n, wo, b)
    c = 1.0 - u[0] * (1.0 - wp.cos(edge_angle(a, b)))
    s = wp.sqrt(wp.max(1.0 - c * c, 0.0))
    t = orthonormal_tangent(axis)
    phi = TWO_PI * u[1]
    return wp.normalize(t * (s * wp.cos(phi)) + wp.cross(axis, t) * (s * wp.sin(phi)) + axis * c)


@wp.func
def toon_albedo(a: float, b: float) -> float:
    """Return the share of the light of an even sky that the lobe reflects: mean of its brightness over the cone.

    Of glossy lobes, what lies below the surface counts too.
    """
    size = -1.0 - a
    smooth = smooth_angle(b)
    edge = edge_angle(a, b)
    if edge < EDGE_MIN or smooth < EDGE_MIN:
        return wp.where(edge < EDGE_MIN, 0.0, 1.0)
    # 1 - cos(size), and the integral of (1 - (x - size) / smooth) sin(x) from size to edge.
    left = 1.0 - (edge - size) / smooth
    total = 1.0 - left * wp.cos(edge) - (wp.sin(edge) - wp.sin(size)) / smooth
    return wp.clamp(total / (1.0 - wp.cos(edge)), 0.0, 1.0)
