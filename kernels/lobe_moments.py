# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a rough surface's reflection comes from, for light known as spherical harmonics.

All light comes from one hemisphere. So the GGX lobe f cos / albedo of a view is approached there, by least squares, by
the harmonics up to l = 2. What it is below the horizon hardly matters, and harmonics that are projections of the lobe
on the whole sphere (Ramamoorthi and Hanrahan 2002) spend themselves on the darkness there: with roughness 0.8 they are
off by 14 to 16 % in the mean of views and skies of one bright cap, the fit by 8 %. Its integral over the hemisphere is
the lobe's own, so that a white sky stays exact.

Facets reflect between f0 and f90 (fresnel.grazing_share, as of dielectrics), so two lobes are tabulated: that which f0
multiplies, and that which f90 does and which lies nearer to the horizon. The latter's albedo is tabulated as of metals
besides: of these look-ups would have up to 2.5 % too little light with that of dielectrics.
"""

from __future__ import annotations

import warp as wp

from .albedo_tables import plane_point, view_at
from .fresnel import grazing_share, metal_part
from .gbuffer import SurfaceMaterial
from .geometry_math import PI, TWO_PI, mean_component, sqr
from .ggx import ggx_reflection, sample_ggx_reflection
from .packed_halves import join_words, pack_halves, pack_pair, unpack_pair, unpack_pairs
from .probe_records import WorldBands
from .specular_lobes import surface_alpha
from .wide_loads import load_piece

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

LOBE_NODES = wp.constant(16)
"""Of the table, along roughness and along the square root of the cosine: it varies most at grazing angles"""

LOBE_SAMPLES = wp.constant(2048)
"""Per node: means of directions are off by less than 0.002"""

# Weight of directions below the horizon, where a fit should be 0: shading normals lean away from the surface's, and
# beyond their own horizon light may come from, too.
BELOW_WEIGHT = wp.constant(0.03)

# Roughness of the sharpest lobe: of sharper ones one would see ringing and noise. Interpolation puts factors off by up
# to 1.4 % there, by 0.5 % above.
SHARPEST = wp.constant(0.5)

COSINE_MIN = wp.constant(1.0e-3)

# From a coefficient of radiance to that of irradiance / pi, which records hold (probe_records.world_basis).
SCALE_0 = wp.constant(4.0 * PI)
SCALE_1 = TWO_PI
SCALE_2 = wp.constant(32.0 / 15.0 * PI)

LobeFit = wp.types.vector(length=7, dtype=wp.float32)
"""Albedo; its product with the factors of 1, x, z, P2(z), 2 x z and x^2 - y^2: x towards the mirror direction, z along
the normal. What is odd in y is 0"""


@wp.func
def fitted(mean: wp.vec2, p2: float, xz: float, across: float) -> LobeFit:
    """Return the fit of a lobe of albedo 1.

    Args:
        mean: Its mean direction's x and z.
        p2: Mean of P2(z) = (3 z^2 - 1) / 2.
        xz: Mean of x z.
        across: Mean of x^2 - y^2.
    """
    even = 1.0 + BELOW_WEIGHT
    odd = 1.0 - BELOW_WEIGHT
    # Scalar products of 1, z and P2(z), by 2 pi.
    products = wp.mat33(
        even, odd / 2.0, 0.0,
        odd / 2.0, even / 3.0, odd / 8.0,
        0.0, odd / 8.0, even / 5.0)
    inverse = wp.inverse(products)
    up = inverse * wp.vec3(1.0, mean[1], p2) / TWO_PI
    # The hemisphere's integrals of the three: what the fit's own lacks goes where it does least harm.
    whole = wp.vec3(TWO_PI, PI, 0.0)
    lean = inverse * whole
    up += lean * ((1.0 - wp.dot(whole, up)) / wp.dot(whole, lean))
    # Those of x and x z, by pi.
    xx = even * 2.0 / 3.0
    cross = odd / 4.0
    zz = even * 2.0 / 15.0
    scale = 1.0 / (PI * (xx * zz - cross * cross))
    x = (mean[0] * zz - xz * cross) * scale
    tilt = (xz * xx - mean[0] * cross) * scale
    side = across / (PI * even * 8.0 / 15.0)
    return LobeFit(
        1.0, up[0] * SCALE_0, x * SCALE_1, up[1] * SCALE_1, up[2] * SCALE_2, 0.5 * tilt * SCALE_2, side * SCALE_2)


@wp.func
def lobe_sample(wo: wp.vec3, alpha: float, i: int) -> wp.vec4:
    """Return a direction's x and z, f cos / density of a facet that reflects all, and the facet's cosine with wo."""
    wi = sample_ggx_reflection(wo, alpha, alpha, plane_point(i))
    f = ggx_reflection(wo, wi, alpha, alpha)
    w = float(0.0)
    if f[1] > 0.0:
        w = f[0] / f[1]
    return wp.vec4(wi[0], wi[2], w, f[2])


@wp.kernel
def integrate_lobes(
    # In:
    samples: int,
    # Out:
    moments_out: wp.array[wp.uint64],
):
    """Tabulate [((cosine * 16 + roughness) * 2 + lobe) * 2]: pieces of 16 bytes, six half-floats and the albedo.

    Lobe 0 is what f0 multiplies, lobe 1 what f90 does. The latter's albedo falls with the fifth power of what lies
    between the nodes and so is stored as its fourth root, which is nearly straight there, as of dielectrics and metals.
    """
    index = wp.tid()
    grazing = index % 2
    alpha = surface_alpha(float(index // 2 % LOBE_NODES) / float(LOBE_NODES - 1))
    root = float(index // 2 // LOBE_NODES) / float(LOBE_NODES - 1)
    wo = view_at(wp.max(root * root, COSINE_MIN))
    albedo = float(0.0)
    of_metals = float(0.0)
    mean = wp.vec2(0.0, 0.0)
    p2 = float(0.0)
    xz = float(0.0)
    across = float(0.0)
    i = int(0)
    while i < samples:
        s = lobe_sample(wo, alpha, i)
        share = grazing_share(s[3], 0.0)
        w = s[2] * wp.where(grazing == 1, share, 1.0 - share)
        albedo = albedo + w
        of_metals = of_metals + s[2] * grazing_share(s[3], 1.0)
        mean += wp.vec2(-s[0], s[1]) * w
        p2 = p2 + (1.5 * s[1] * s[1] - 0.5) * w
        xz = xz - s[0] * s[1] * w
        across = across + (2.0 * s[0] * s[0] + s[1] * s[1] - 1.0) * w
        i = i + 1
    scale = 1.0 / wp.max(albedo, 1.0e-12)
    albedo = albedo / float(samples)
    fit = fitted(mean * scale, p2 * scale, xz * scale, across * scale) * albedo
    bits = wp.cast(albedo, wp.uint32)
    if grazing == 1:
        bits = pack_pair(wp.sqrt(wp.sqrt(albedo)), wp.sqrt(wp.sqrt(of_metals / float(samples))))
    moments_out[2 * index] = pack_halves(wp.vec4(fit[1], fit[2], fit[3], fit[4]))
    moments_out[2 * index + 1] = join_words(pack_pair(fit[5], fit[6]), bits)


@wp.struct
class TablePlace:
    """Where a lobe lies between the table's nodes."""

    node: int
    """The lowest of the four; the others are one and LOBE_NODES on"""
    across: float
    """Way to the next roughness, 0..1"""
    up: float
    """Way to the next cosine"""


@wp.func
def table_place(roughness: float, cosine: float) -> TablePlace:
    """Return where the lobe of a roughness in 0..1 lies, for a view's cosine with the normal."""
    u = roughness * float(LOBE_NODES - 1)
    v = wp.sqrt(wp.clamp(cosine, COSINE_MIN, 1.0)) * float(LOBE_NODES - 1)
    i = wp.min(int(u), LOBE_NODES - 2)
    j = wp.min(int(v), LOBE_NODES - 2)
    place = TablePlace()
    place.node = j * LOBE_NODES + i
    place.across = u - float(i)
    place.up = v - float(j)
    return place


@wp.func
def node_albedos(moments: wp.array[wp.uint64], node: int) -> wp.vec3:
    """Return a node's albedo of the lobe of f0, and fourth roots of that of f90: of dielectrics, of metals."""
    roots = unpack_pair(load_piece(moments, 2 * node + 1)[3])
    return wp.vec3(wp.cast(load_piece(moments, 2 * node)[3], float), roots[0], roots[1])


@wp.func
def fitted_albedo(moments: wp.array[wp.uint64], m: SurfaceMaterial, cosine: float) -> wp.vec3:
    """Return the integral of specular_lobes.lobes_value for a view's cosine with the lobes' normal.

    What the G-buffer's `specular` was fitted to: they differ by up to 4 % (f0 and f90 follow Schlick, materials don't),
    so samples divided by this are white under a white sky, and those divided by that are not.
    """
    place = table_place(wp.clamp(m.roughness, 0.0, 1.0), cosine)
    node = place.node
    above = node + LOBE_NODES
    low = wp.lerp(node_albedos(moments, node), node_albedos(moments, node + 1), place.across)
    high = wp.lerp(node_albedos(moments, above), node_albedos(moments, above + 1), place.across)
    albedos = wp.lerp(low, high, place.up)
    share = sqr(sqr(albedos[1]))
    # What metals lack of the lobe of f90 they reflect by f0.
    metal = wp.lerp(share, sqr(sqr(albedos[2])), metal_part(mean_component(m.f0), m.f90))
    grazing = m.f90 * metal + m.coat
    return m.f0 * (albedos[0] + share - metal) + wp.vec3(grazing, grazing, grazing)


@wp.func
def node_fit(moments: wp.array[wp.uint64], node: int, f0: float, f90: float) -> LobeFit:
    """Return the sum of both lobes of a node."""
    p = load_piece(moments, 2 * node)
    q = load_piece(moments, 2 * node + 1)
    a = unpack_pairs(p[0], p[1]) * f0 + unpack_pairs(q[0], q[1]) * f90
    b = unpack_pair(p[2]) * f0 + unpack_pair(q[2]) * f90
    albedo = wp.cast(p[3], float) * f0 + sqr(sqr(unpack_pair(q[3])[0])) * f90
    return LobeFit(albedo, a[0], a[1], a[2], a[3], b[0], b[1])


@wp.func
def lobe_bands(
    moments: wp.array[wp.uint64], n: wp.vec3, wo: wp.vec3, roughness: float, f0: float, f90: float,
) -> WorldBands:
    """Return by what the coefficients of a probe's record become the light of a reflection lobe.

    In detail:
        moments: From integrate_lobes.
        n: Shading normal.
        wo: Unit direction to the viewer.
        roughness: Perceptual; lobes are no sharper than that of SHARPEST.
        f0: Reflectance along the normal.
        f90: Reflectance at grazing angles.
        returns: Factors of the functions of probe_records.world_basis.
    """
    cosine = wp.clamp(wp.dot(n, wo), COSINE_MIN, 1.0)
    place = table_place(wp.clamp(roughness, SHARPEST, 1.0), cosine)
    # What reflects nothing at all has the shape of its first lobe.
    f0 = wp.max(f0, 1.0e-4)
    node = place.node
    low = wp.lerp(node_fit(moments, node, f0, f90), node_fit(moments, node + 1, f0, f90), place.across)
    node = node + LOBE_NODES
    high = wp.lerp(node_fit(moments, node, f0, f90), node_fit(moments, node + 1, f0, f90), place.across)
    fit = wp.lerp(low, high, place.up)
    fit = fit / wp.max(fit[0], 1.0e-6)
    mirror = n * cosine - wo
    # The view along the normal has no side.
    m = mirror / wp.max(wp.length(mirror), 1.0e-6)
    first = m * fit[2] + n * fit[3]
    # P2(z) is n n^T 3/2 - 1/2, x^2 - y^2 is 2 m m^T + n n^T - 1; what all directions have is left out.
    along = 1.5 * fit[4] + fit[6]
    across = 2.0 * fit[6]
    a = n * along + m * fit[5]
    b = m * across + n * fit[5]
    zz = n[2] * a[2] + m[2] * b[2]
    return WorldBands(
        fit[1], first[0], first[1], first[2], n[0] * a[0] + m[0] * b[0] - zz, n[1] * a[1] + m[1] * b[1] - zz,
        2.0 * (n[0] * a[1] + m[0] * b[1]), 2.0 * (n[1] * a[2] + m[1] * b[2]), 2.0 * (n[0] * a[2] + m[0] * b[2]))
