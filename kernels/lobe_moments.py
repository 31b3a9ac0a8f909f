# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a rough surface's reflection comes from, for light known as spherical harmonics.

The GGX lobe f cos / albedo for a view is described by its mean direction, whose length is its moment of l = 1, and by
the mean of P2 of the angle to that direction, its moment of l = 2. A lobe about an axis reflects of harmonics their
value along the axis, each l times its moment (Ramamoorthi and Hanrahan 2002). Facets reflect between f0 and f90
(fresnel.grazing_share, as of dielectrics), so two lobes are tabulated: that which f0 multiplies, and that which f90
does and which lies nearer to the horizon.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import plane_point, view_at
from .fresnel import grazing_share
from .gbuffer import SurfaceMaterial
from .geometry_math import sqr
from .ggx import ggx_reflection, sample_ggx_reflection
from .packing import pack_unorm16, unpack_unorm16, whole_float
from .specular_lobes import surface_alpha
from .wide_loads import load_piece

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

LOBE_NODES = wp.constant(16)
"""Of the table, along roughness and along the square root of the cosine: it varies most at grazing angles"""

LOBE_SAMPLES = wp.constant(2048)
"""Per node: errors below 0.002"""

# Harmonics end at l = 2, and irradiance holds little of that: of sharper lobes one would see ringing and noise.
SHARPEST_1 = wp.constant(0.95)
SHARPEST_2 = wp.constant(0.65)

COSINE_MIN = wp.constant(1.0e-3)


@wp.struct
class Lobe:
    """Where the reflection of a surface comes from."""

    axis: wp.vec3
    """Unit vector along the mean direction"""
    first: float
    """Moment of l = 1: the mean direction's length"""
    second: float
    """Moment of l = 2: the mean of P2 of the angle to `axis`"""


@wp.func
def pack_moments(albedo: float, x: float, z: float, second: float) -> wp.uint64:
    """Pack numbers in -1..1 with 16 bits each."""
    low = pack_unorm16(0.5 + 0.5 * albedo, 0.5 + 0.5 * x)
    high = pack_unorm16(0.5 + 0.5 * z, 0.5 + 0.5 * second)
    return wp.uint64(low) | (wp.uint64(high) << wp.uint64(32))


@wp.func
def unpack_moments(packed: wp.uint64) -> wp.vec4:
    """Return albedo, mean direction's x and z, and second moment of pack_moments."""
    low = unpack_unorm16(wp.uint32(packed & wp.uint64(0xFFFFFFFF)))
    high = unpack_unorm16(wp.uint32(packed >> wp.uint64(32)))
    return wp.vec4(low[0], low[1], high[0], high[1]) * 2.0 - wp.vec4(1.0, 1.0, 1.0, 1.0)


@wp.func
def lobe_sample(wo: wp.vec3, alpha: float, grazing: int, i: int) -> wp.vec4:
    """Return a direction of the lobe and its weight: f cos / density, times the share of f0 or f90."""
    wi = sample_ggx_reflection(wo, alpha, alpha, plane_point(i))
    f = ggx_reflection(wo, wi, alpha, alpha)
    w = float(0.0)
    if f[1] > 0.0:
        share = grazing_share(f[2], 0.0)
        w = f[0] / f[1] * wp.where(grazing == 1, share, 1.0 - share)
    return wp.vec4(wi[0], wi[1], wi[2], w)


@wp.kernel
def integrate_lobes(
    # In:
    samples: int,
    # Out:
    moments_out: wp.array[wp.uint64],
):
    """Tabulate [(cosine * 16 + roughness) * 2 + lobe]; the view is in the xz plane, x of the mean towards the mirror.

    Lobe 0 is what f0 multiplies, lobe 1 what f90 does.
    """
    index = wp.tid()
    grazing = index % 2
    alpha = surface_alpha(float(index // 2 % LOBE_NODES) / float(LOBE_NODES - 1))
    root = float(index // 2 // LOBE_NODES) / float(LOBE_NODES - 1)
    wo = view_at(wp.max(root * root, COSINE_MIN))
    albedo = float(0.0)
    x = float(0.0)
    z = float(0.0)
    i = int(0)
    while i < samples:
        s = lobe_sample(wo, alpha, grazing, i)
        albedo = albedo + s[3]
        x = x - s[0] * s[3]
        z = z + s[2] * s[3]
        i = i + 1
    scale = 1.0 / wp.max(albedo, 1.0e-12)
    x = x * scale
    z = z * scale
    length = wp.max(wp.sqrt(x * x + z * z), 1.0e-6)
    second = float(0.0)
    k = int(0)
    while k < samples:
        s = lobe_sample(wo, alpha, grazing, k)
        cosine = (z * s[2] - x * s[0]) / length
        second = second + (1.5 * cosine * cosine - 0.5) * s[3]
        k = k + 1
    moments_out[index] = pack_moments(albedo / float(samples), x, z, second * scale)


@wp.func
def table_moments(moments: wp.array[wp.uint64], lobe: int, u: float, v: float) -> wp.vec4:
    """Return albedo, mean direction's x and z, and second moment of one of the lobes; u, v count nodes."""
    i = wp.min(int(u), LOBE_NODES - 2)
    j = wp.min(int(v), LOBE_NODES - 2)
    at = (j * LOBE_NODES + i) * 2 + lobe
    fu = u - float(i)
    fv = v - float(j)
    low = wp.lerp(unpack_moments(moments[at]), unpack_moments(moments[at + 2]), fu)
    at = at + 2 * LOBE_NODES
    return wp.lerp(low, wp.lerp(unpack_moments(moments[at]), unpack_moments(moments[at + 2]), fu), fv)


@wp.func
def fourth_root(packed: wp.uint64) -> float:
    """Return the fourth root of the albedo in pack_moments."""
    return wp.sqrt(wp.sqrt(wp.max(unpack_moments(packed)[0], 0.0)))


@wp.func
def fitted_albedo(moments: wp.array[wp.uint64], m: SurfaceMaterial, cosine: float) -> wp.vec3:
    """Return the integral of specular_lobes.lobes_value for a view's cosine with the lobes' normal.

    What the G-buffer's `specular` was fitted to: they differ by up to 4 % (f0 and f90 follow Schlick, materials don't),
    so samples divided by this are white under a white sky, and those divided by that are not.
    """
    u = wp.clamp(m.roughness, 0.0, 1.0) * float(LOBE_NODES - 1)
    v = wp.sqrt(wp.clamp(cosine, COSINE_MIN, 1.0)) * float(LOBE_NODES - 1)
    i = wp.min(int(u), LOBE_NODES - 2)
    j = wp.min(int(v), LOBE_NODES - 2)
    at = (j * LOBE_NODES + i) * 2 + 1
    # It falls with the fifth power of what lies between the nodes: its root is nearly straight there.
    low = wp.lerp(fourth_root(moments[at]), fourth_root(moments[at + 2]), u - float(i))
    at = at + 2 * LOBE_NODES
    high = wp.lerp(fourth_root(moments[at]), fourth_root(moments[at + 2]), u - float(i))
    grazing = m.f90 * sqr(sqr(wp.lerp(low, high, v - float(j)))) + m.coat
    return m.f0 * table_moments(moments, 0, u, v)[0] + wp.vec3(grazing, grazing, grazing)


@wp.func
def second_about(m: wp.vec4, axis: wp.vec2) -> float:
    """Return the second moment of a lobe, symmetric about its own mean, about another axis (x, z)."""
    cosine = (m[1] * axis[0] + m[2] * axis[1]) / wp.max(wp.sqrt(m[1] * m[1] + m[2] * m[2]), 1.0e-6)
    return m[3] * (1.5 * cosine * cosine - 0.5)


@wp.func
def unpack_moments_of(low: wp.uint32, high: wp.uint32) -> wp.vec4:
    """Return the same as unpack_moments, of the lower and the upper bits."""
    v = wp.vec4(
        whole_float(low & wp.uint32(65535)), whole_float(low >> wp.uint32(16)),
        whole_float(high & wp.uint32(65535)), whole_float(high >> wp.uint32(16))) * 1.5259022e-5
    return v * 2.0 - wp.vec4(1.0, 1.0, 1.0, 1.0)


@wp.struct
class BothMoments:
    """What table_moments returns, for each of the two lobes."""

    a: wp.vec4
    b: wp.vec4


@wp.func
def both_moments(moments: wp.array[wp.uint64], u: float, v: float) -> BothMoments:
    """Return table_moments of both lobes, which lie side by side."""
    i = wp.min(int(u), LOBE_NODES - 2)
    j = wp.min(int(v), LOBE_NODES - 2)
    at = j * LOBE_NODES + i
    fu = u - float(i)
    fv = v - float(j)
    p = load_piece(moments, at)
    q = load_piece(moments, at + 1)
    r = load_piece(moments, at + LOBE_NODES)
    s = load_piece(moments, at + LOBE_NODES + 1)
    out = BothMoments()
    out.a = wp.lerp(
        wp.lerp(unpack_moments_of(p[0], p[1]), unpack_moments_of(q[0], q[1]), fu),
        wp.lerp(unpack_moments_of(r[0], r[1]), unpack_moments_of(s[0], s[1]), fu), fv)
    out.b = wp.lerp(
        wp.lerp(unpack_moments_of(p[2], p[3]), unpack_moments_of(q[2], q[3]), fu),
        wp.lerp(unpack_moments_of(r[2], r[3]), unpack_moments_of(s[2], s[3]), fu), fv)
    return out


@wp.func
def reflection_lobe(
    moments: wp.array[wp.uint64], n: wp.vec3, wo: wp.vec3, roughness: float, f0: float, f90: float,
) -> Lobe:
    """Return where the reflection of a surface comes from, no sharper than harmonics up to l = 2 can show.

    Args:
        moments: From integrate_lobes.
        n: Shading normal.
        wo: Unit direction to the viewer.
        roughness: Perceptual.
        f0: Reflectance along the normal.
        f90: Reflectance at grazing angles.
    """
    cosine = wp.clamp(wp.dot(n, wo), COSINE_MIN, 1.0)
    u = wp.clamp(roughness, 0.0, 1.0) * float(LOBE_NODES - 1)
    v = wp.sqrt(cosine) * float(LOBE_NODES - 1)
    both = both_moments(moments, u, v)
    a = both.a
    b = both.b
    # What reflects nothing at all has the shape of its first lobe.
    share = wp.max(b[0] * f90, 0.0)
    share = share / (share + wp.max(a[0] * wp.max(f0, 1.0e-4), 1.0e-6))
    x = wp.lerp(a[1], b[1], share)
    z = wp.lerp(a[2], b[2], share)
    length = wp.max(wp.sqrt(x * x + z * z), 1.0e-6)
    axis = wp.vec2(x / length, z / length)
    mirror = n * cosine - wo
    # The view along the normal has no side.
    mirror = mirror / wp.max(wp.length(mirror), 1.0e-6)
    lobe = Lobe()
    lobe.axis = wp.normalize(mirror * axis[0] + n * axis[1])
    lobe.first = wp.min(length, SHARPEST_1)
    lobe.second = wp.min(wp.lerp(second_about(a, axis), second_about(b, axis), share), SHARPEST_2)
    return lobe
