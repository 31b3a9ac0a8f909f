# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of directional albedos of GGX: the kernels that compute them and the functions that look them up.

Axes, all linear between nodes and clamped: `roughness` (sqrt(alpha)) last, then the cosine of the view, then
`z = sqrt(|ior - 1| / (ior + 1))`, which spans all indices and is finest from 1 to 2. Node counts and definitions are
those of Cycles' precomputed tables (intern/cycles/app/cycles_precompute.cpp), because its materials include the
error of interpolating between these very nodes: finer tables would differ from it.

Every node is a mean over visible normals weighted G2/G1, which has little variance; half the azimuths suffice since
the view lies in the xz plane.

Cycles shares light among layers by weights between F0 and F90 that leave shadowed microfacets in; what a lobe reflects
in the end is less by up to an eighth. The real-time integrator needs that exactly: as the cosine at which a smooth
surface reflects as much, which is smoother than the albedo and so loses little between nodes.
"""

from __future__ import annotations

import warp as wp

from .fresnel import f0_from_ior, fresnel_dielectric, ior_from_f0, schlick_weight
from .geometry_math import safe_sqrt, sqr
from .ggx import ggx_lambda, reflect_about, refract_about, sample_ggx_normal
from .types import Tables
from .wide_loads import load_slab_square, load_square

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

GGX_NODES = wp.constant(32)
"""Per axis of ggx_e"""
GLASS_NODES = wp.constant(16)
"""Per axis of the other tables"""
SMOOTH_ETA = wp.constant(1.0e-4)
"""An index this close to 1 bends nothing: the transmission is a straight line (Cycles, bsdf_microfacet_sample)."""

LEAST_INDEX = wp.constant(1.002)
"""From which on dielectric_c is exact"""

# Steps of the additive recurrence R2: the first two powers of the inverse plastic number, times 2**32.
R2_X = wp.constant(wp.uint32(3242174889))
R2_Y = wp.constant(wp.uint32(2447445414))
HALF = wp.constant(wp.uint32(2147483648))


@wp.func
def node_roughness(i: int, count: int) -> float:
    """Return the roughness of node i; never 0."""
    return wp.clamp(float(i) / float(count - 1), 1.0e-4, 1.0)


@wp.func
def node_ior(i: int) -> float:
    """Return the index (>= 1) of node i of the z axis."""
    z = wp.clamp(float(i) / float(GLASS_NODES - 1), 1.0e-4, 0.99)
    return ior_from_f0(sqr(sqr(z)))


@wp.func
def view_at(cos_o: float) -> wp.vec3:
    """Return the view with that cosine, in the xz plane."""
    return wp.vec3(safe_sqrt(1.0 - cos_o * cos_o), 0.0, cos_o)


@wp.func
def plane_point(i: int) -> wp.vec2:
    """Return point i of the additive recurrence R2 (Roberts 2018) in [0, 1)^2, in exact fixed point."""
    n = wp.uint32(i)
    x = n * R2_X + HALF
    y = n * R2_Y + HALF
    return wp.vec2(float(x >> wp.uint32(8)), float(y >> wp.uint32(8))) * 5.9604645e-8


@wp.func
def stratified_cosine(i: int, samples: int) -> float:
    """Return cosine i of `samples` with the density 2 cos: the square is uniform."""
    return wp.sqrt((float(i) + 0.5) / float(samples))


@wp.func
def visible_normal(wo: wp.vec3, alpha: float, u: wp.vec2) -> wp.vec3:
    """Return a visible normal of the half space y >= 0."""
    return sample_ggx_normal(wo, alpha, alpha, wp.vec2(u[0], 0.5 * u[1]))


@wp.func
def kept(lambda_o: float, wi: wp.vec3, alpha: float) -> float:
    """Return G2/G1: the share of a visible microfacet's light that is not shadowed."""
    return (1.0 + lambda_o) / (1.0 + lambda_o + ggx_lambda(wi, alpha, alpha))


@wp.func
def reflection_sample(wo: wp.vec3, alpha: float, u: wp.vec2) -> float:
    """Return one sample of the albedo of a mirror of microfacets."""
    wi = reflect_about(wo, visible_normal(wo, alpha, u))
    if wi[2] <= 0.0:
        return 0.0
    return kept(ggx_lambda(wo, alpha, alpha), wi, alpha)


@wp.func
def glass_sample(wo: wp.vec3, alpha: float, eta: float, u: wp.vec2) -> float:
    """Return one sample of the albedo of a dielectric interface, reflected plus refracted."""
    m = visible_normal(wo, alpha, u)
    f = fresnel_dielectric(wp.dot(wo, m), eta)
    lambda_o = ggx_lambda(wo, alpha, alpha)
    total = float(0.0)
    reflected = reflect_about(wo, m)
    if reflected[2] > 0.0:
        total += f[0] * kept(lambda_o, reflected, alpha)
    refracted = refract_about(wo, m, eta)
    # Cycles' tables count light that a tilted facet refracts to above the surface as kept, though its lobe drops it:
    # rough glass seen from inside at grazing angles therefore stays darker than white. Theirs is the picture to match.
    if f[0] < 1.0:
        total += (1.0 - f[0]) * wp.where(wp.abs(eta - 1.0) < SMOOTH_ETA, 1.0, kept(lambda_o, refracted, alpha))
    return total


@wp.func
def dielectric_cosine(weight: float, eta: float, f0: float) -> float:
    """Return the cosine at which a smooth dielectric has a weight between F0 and F90, which falls with it."""
    low = float(0.0)
    high = float(1.0)
    step = int(0)
    while step < 24:
        middle = 0.5 * (low + high)
        if schlick_weight(fresnel_dielectric(middle, eta)[0], f0) > weight:
            low = middle
        else:
            high = middle
        step = step + 1
    return 0.5 * (low + high)


@wp.kernel
def integrate_ggx(
    # In:
    first: int, samples: int,
    # Out:
    e_out: wp.array2d[float],
):
    """Fill row first + i of ggx_e, [cosine, roughness]."""
    i, j = wp.tid()
    alpha = sqr(node_roughness(j, GGX_NODES))
    wo = view_at(node_roughness(first + i, GGX_NODES))
    total = float(0.0)
    for k in range(samples):
        total += reflection_sample(wo, alpha, plane_point(k))
    e_out[first + i, j] = wp.clamp(total / float(samples), 0.0, 1.0)


@wp.kernel
def integrate_ggx_average(
    # In:
    samples: int,
    # Out:
    average_out: wp.array[float],
):
    """Fill ggx_e_avg, [roughness]: the cosine-weighted mean over all views."""
    j = wp.tid()
    alpha = sqr(node_roughness(j, GGX_NODES))
    total = float(0.0)
    for k in range(samples):
        total += reflection_sample(view_at(stratified_cosine(k, samples)), alpha, plane_point(k))
    average_out[j] = wp.clamp(total / float(samples), 0.0, 1.0)


@wp.kernel
def integrate_glass(
    # In:
    first: int, samples: int,
    # Out:
    glass_out: wp.array3d[float], glass_inv_out: wp.array3d[float], schlick_ior_out: wp.array3d[float],
    cosine_out: wp.array3d[float],
):
    """Fill slab first + i of the four tables [ior, cosine, roughness]."""
    i, j, k = wp.tid()
    eta = node_ior(first + i)
    wo = view_at(node_roughness(j, GLASS_NODES))
    alpha = sqr(node_roughness(k, GLASS_NODES))
    f0 = f0_from_ior(eta)
    entering = float(0.0)
    leaving = float(0.0)
    weight = float(0.0)
    lambda_o = ggx_lambda(wo, alpha, alpha)
    # An index of 1 reflects nothing; the table holds the limit of what little those next to it do.
    least = wp.max(eta, LEAST_INDEX)
    least_f0 = f0_from_ior(least)
    facing = float(0.0)
    grazing = float(0.0)
    for s in range(samples):
        u = plane_point(s)
        entering += glass_sample(wo, alpha, eta, u)
        leaving += glass_sample(wo, alpha, 1.0 / eta, u)
        m = visible_normal(wo, alpha, u)
        reflected = reflect_about(wo, m)
        if reflected[2] > 0.0:
            weight += schlick_weight(fresnel_dielectric(wp.dot(wo, m), eta)[0], f0)
            share = kept(lambda_o, reflected, alpha)
            facing += share
            grazing += share * schlick_weight(fresnel_dielectric(wp.dot(wo, m), least)[0], least_f0)
    glass_out[first + i, j, k] = wp.clamp(entering / float(samples), 0.0, 1.0)
    glass_inv_out[first + i, j, k] = wp.clamp(leaving / float(samples), 0.0, 1.0)
    schlick_ior_out[first + i, j, k] = wp.clamp(weight / float(samples), 0.0, 1.0)
    cosine_out[first + i, j, k] = dielectric_cosine(grazing / wp.max(facing, 1.0e-20), least, least_f0)


@wp.kernel
def integrate_glass_average(
    # In:
    samples: int,
    # Out:
    glass_out: wp.array2d[float], glass_inv_out: wp.array2d[float],
):
    """Fill glass_e_avg and glass_inv_e_avg, [ior, roughness]."""
    i, k = wp.tid()
    eta = node_ior(i)
    alpha = sqr(node_roughness(k, GLASS_NODES))
    entering = float(0.0)
    leaving = float(0.0)
    for s in range(samples):
        u = plane_point(s)
        wo = view_at(stratified_cosine(s, samples))
        entering += glass_sample(wo, alpha, eta, u)
        leaving += glass_sample(wo, alpha, 1.0 / eta, u)
    glass_out[i, k] = wp.clamp(entering / float(samples), 0.0, 1.0)
    glass_inv_out[i, k] = wp.clamp(leaving / float(samples), 0.0, 1.0)


@wp.kernel
def integrate_schlick(
    # In:
    samples: int,
    # Out:
    schlick_out: wp.array2d[float], cosine_out: wp.array2d[float],
):
    """Fill schlick_s, [cosine, roughness]: the weight of F90 under Schlick's curve; and schlick_c.

    Cycles looks half way between the exponents 40/7 and 35/8 (nodes 7 and 8 of 15), so theirs is the mean taken for the
    first; the second is exact.
    """
    j, k = wp.tid()
    wo = view_at(node_roughness(j, GLASS_NODES))
    alpha = sqr(node_roughness(k, GLASS_NODES))
    total = float(0.0)
    lambda_o = ggx_lambda(wo, alpha, alpha)
    facing = float(0.0)
    fifth = float(0.0)
    for s in range(samples):
        m = visible_normal(wo, alpha, plane_point(s))
        reflected = reflect_about(wo, m)
        if reflected[2] > 0.0:
            grazing = wp.max(1.0 - wp.dot(wo, m), 0.0)
            total += 0.5 * (wp.pow(grazing, 40.0 / 7.0) + wp.pow(grazing, 35.0 / 8.0))
            share = kept(lambda_o, reflected, alpha)
            facing += share
            fifth += share * wp.pow(grazing, 5.0)
    schlick_out[j, k] = wp.clamp(total / float(samples), 0.0, 1.0)
    cosine_out[j, k] = wp.clamp(1.0 - wp.pow(fifth / wp.max(facing, 1.0e-20), 0.2), 0.0, 1.0)


@wp.func
def cell_of(x: float, count: int) -> wp.vec2:
    """Return (lower node, fraction to the next) for x in [0, 1]."""
    scaled = wp.clamp(x, 0.0, 1.0) * float(count - 1)
    low = wp.min(wp.floor(scaled), float(count - 2))
    return wp.vec2(low, scaled - low)


@wp.func
def mix_square(square: wp.vec4, y: float, x: float) -> float:
    """Interpolate between the entries of a square, in load_square's order."""
    return wp.lerp(wp.lerp(square[0], square[1], x), wp.lerp(square[2], square[3], x), y)


@wp.func
def look_up_1d(table: wp.array[float], x: float, count: int) -> float:
    """Interpolate table[x]."""
    cx = cell_of(x, count)
    i = int(cx[0])
    return wp.lerp(table[i], table[i + 1], cx[1])


@wp.func
def look_up_2d(table: wp.array2d[float], y: float, x: float, count: int) -> float:
    """Interpolate table[y, x]."""
    cx = cell_of(x, count)
    cy = cell_of(y, count)
    return mix_square(load_square(table, int(cy[0]), int(cx[0]), count), cy[1], cx[1])


@wp.func
def look_up_3d(table: wp.array3d[float], z: float, y: float, x: float) -> float:
    """Interpolate table[z, y, x]."""
    cx = cell_of(x, GLASS_NODES)
    cy = cell_of(y, GLASS_NODES)
    cz = cell_of(z, GLASS_NODES)
    slab = int(cz[0])
    low = load_slab_square(table, slab, int(cy[0]), int(cx[0]), GLASS_NODES)
    high = load_slab_square(table, slab + 1, int(cy[0]), int(cx[0]), GLASS_NODES)
    return wp.lerp(mix_square(low, cy[1], cx[1]), mix_square(high, cy[1], cx[1]), cz[1])


@wp.func
def ior_coordinate(ior: float) -> float:
    """Return the z coordinate of an index and of its inverse."""
    return wp.sqrt(wp.abs(ior - 1.0) / (ior + 1.0))


@wp.func
def ggx_albedo(tables: Tables, cos_o: float, roughness: float) -> wp.vec2:
    """Return (albedo, its mean over all views) of a mirror of microfacets."""
    return wp.vec2(
        look_up_2d(tables.ggx_e, cos_o, roughness, GGX_NODES), look_up_1d(tables.ggx_e_avg, roughness, GGX_NODES)
    )


@wp.func
def glass_albedo(tables: Tables, cos_o: float, roughness: float, eta: float) -> wp.vec2:
    """Return (albedo, its mean over all views) of a dielectric interface."""
    z = ior_coordinate(eta)
    if eta < 1.0:
        return wp.vec2(
            look_up_3d(tables.glass_inv_e, z, cos_o, roughness),
            look_up_2d(tables.glass_inv_e_avg, z, roughness, GLASS_NODES),
        )
    return wp.vec2(
        look_up_3d(tables.glass_e, z, cos_o, roughness),
        look_up_2d(tables.glass_e_avg, z, roughness, GLASS_NODES),
    )


@wp.func
def dielectric_weight(tables: Tables, cos_o: float, roughness: float, eta: float) -> float:
    """Return how far from F0 to F90 a rough dielectric reflects towards this view."""
    return look_up_3d(tables.schlick_ior_s, ior_coordinate(eta), cos_o, roughness)


@wp.func
def metal_weight(tables: Tables, cos_o: float, roughness: float) -> float:
    """Return how far from F0 to F90 a rough metal reflects towards this view."""
    return look_up_2d(tables.schlick_s, cos_o, roughness, GLASS_NODES)


@wp.func
def reflected_dielectric_cosine(tables: Tables, cos_o: float, roughness: float, eta: float) -> float:
    """Return the cosine at which a smooth dielectric of an index above 1 reflects what a rough one does."""
    return look_up_3d(tables.dielectric_c, ior_coordinate(eta), cos_o, roughness)


@wp.func
def reflected_dielectric_weight(tables: Tables, cos_o: float, roughness: float, eta: float) -> float:
    """Return how far from F0 to F90 the albedo of a rough dielectric lies, towards this view."""
    if eta < 1.0:
        # From inside the curve ends at total reflection, which no cosine outside stands for: exact for mirrors alone.
        smooth = schlick_weight(fresnel_dielectric(cos_o, eta)[0], f0_from_ior(eta))
        return wp.lerp(smooth, dielectric_weight(tables, cos_o, roughness, eta), roughness)
    c = reflected_dielectric_cosine(tables, cos_o, roughness, eta)
    return schlick_weight(fresnel_dielectric(c, eta)[0], f0_from_ior(eta))


@wp.func
def reflected_cosine(tables: Tables, cos_o: float, roughness: float) -> float:
    """Return the cosine at which Schlick's curve gives what a rough metal reflects towards this view."""
    return look_up_2d(tables.schlick_c, cos_o, roughness, GLASS_NODES)
