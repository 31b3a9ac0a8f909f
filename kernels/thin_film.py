# SPDX-License-Identifier: GPL-3.0-or-later
"""Fresnel reflectance of surfaces under a thin film, whose colours are those of interference.

Belcour and Barla 2017, "A Practical Extension to Microfacet Theory for the Modeling of Varying Iridescence": Airy's sum
of all that is reflected between the film's sides (equation 10), by orders up to the third, each for its difference of
paths weighed by the channels' sensitivities (section 4; engine/film_colors.py). The choices are those of Cycles 5.2
(kernel/closure/bsdf_util.h and bsdf_microfacet.h), so that a material looks alike in both.
"""

from __future__ import annotations

import warp as wp

from .fresnel import F82_SCALE, SCHLICK_AT_82, f0_from_ior, fresnel_f82, saturate3
from .geometry_math import safe_sqrt, sqr
from .wide_loads import load_vec4

FILM_MIN = wp.constant(0.1)
"""Films up to this thickness [nm] are none"""
FILM_FADE = wp.constant(1.0)
"""Below this thickness [nm] a film's index fades to that of air"""

FILM_NODES = wp.constant(512)
"""Differences of paths that are tabulated; beyond the last one all colours have evened out"""
FILM_STEP = wp.constant(18.688027)
"""From one to the next [nm]: 60000 / (2 pi 511)"""

FILM_ORDERS = wp.constant(3)
"""What is reflected more often within the film is left out"""


@wp.func
def film_sensitivity(film_table: wp.array[wp.vec4], difference: float):
    """Return the channels' means of the cosine and of the sine of the phase that a difference of paths [nm] makes."""
    place = wp.min(difference / FILM_STEP, float(FILM_NODES - 1))
    node = wp.min(int(place), FILM_NODES - 2)
    share = place - float(node)
    cosine = wp.lerp(load_vec4(film_table, 2 * node), load_vec4(film_table, 2 * node + 2), share)
    sine = wp.lerp(load_vec4(film_table, 2 * node + 1), load_vec4(film_table, 2 * node + 3), share)
    return wp.vec3(cosine[0], cosine[1], cosine[2]), wp.vec3(sine[0], sine[1], sine[2])


@wp.func
def fresnel_amplitudes(cos_i: float, eta: float) -> wp.vec3:
    """Return (amplitude for perpendicular polarisation, for parallel, cosine of the refracted ray).

    The cosine is -1 where all is reflected.
    """
    under_root = sqr(eta) - (1.0 - sqr(cos_i))
    if under_root <= 0.0:
        return wp.vec3(1.0, 1.0, -1.0)
    eta_cos_t = wp.sqrt(under_root)
    cos_t = eta_cos_t / eta
    # An index of 1 reflects nothing, at grazing angles either.
    s = (cos_i - eta_cos_t) / wp.max(cos_i + eta_cos_t, 1.0e-12)
    p = (eta * cos_i - cos_t) / wp.max(eta * cos_i + cos_t, 1.0e-12)
    return wp.vec3(s, p, cos_t)


@wp.func
def film_index(thickness: float, ior: float) -> float:
    """Return a film's index: that of air where it is too thin for interference."""
    if thickness >= FILM_FADE:
        return ior
    t = wp.max(thickness, 0.0)
    return 1.0 + (ior - 1.0) * t * t * (3.0 - 2.0 * t)


@wp.func
def film_dielectric(film_table: wp.array[wp.vec4], thickness: float, ior: float, eta: float, cos_i: float) -> wp.vec3:
    """Return the unpolarised reflectance of a film on a dielectric.

    Args:
        film_table: See engine/film_colors.py.
        thickness: Of the film [nm].
        ior: Of the film, relative to the side that is seen.
        eta: Index behind the film over the index in front of it.
        cos_i: Cosine of the incident direction, >= 0.
    """
    one = wp.vec3(1.0, 1.0, 1.0)
    index = film_index(thickness, ior)
    upper = fresnel_amplitudes(wp.abs(cos_i), index)
    if upper[2] < 0.0:
        return one
    lower = fresnel_amplitudes(upper[2], eta / index)
    if lower[2] < 0.0:
        return one
    difference = 2.0 * index * thickness * upper[2]
    # By polarisation: what is reflected apart from interference, and the factor of the first order and of each next.
    flat = float(0.0)
    order = wp.vec2(0.0, 0.0)
    step = wp.vec2(0.0, 0.0)
    for k in range(2):
        above = sqr(upper[k])
        passed = 1.0 - above
        inner = sqr(passed) * sqr(lower[k]) / wp.max(1.0 - above * sqr(lower[k]), 1.0e-7)
        flat += above + inner
        step[k] = -upper[k] * lower[k]
        order[k] = (inner - passed) * step[k]
    f = wp.vec3(flat, flat, flat)
    m = int(1)
    while m <= FILM_ORDERS:
        cosine, _sine = film_sensitivity(film_table, difference * float(m))
        f = f + cosine * (2.0 * (order[0] + order[1]))
        order = wp.cw_mul(order, step)
        m = m + 1
    return saturate3(f * 0.5)


@wp.func
def film_schlick(
    film_table: wp.array[wp.vec4], thickness: float, ior: float, eta: float, f0: wp.vec3, cos_i: float
) -> wp.vec3:
    """Return the reflectance of a film on a dielectric which reflects f0 along the normal without it.

    The film's colours are scaled where they are as dark as the dielectric itself; see film_dielectric.
    """
    f = film_dielectric(film_table, thickness, ior, eta, cos_i)
    real = f0_from_ior(eta)
    if real <= 1.0e-5:
        return f
    for c in range(3):
        share = wp.clamp((1.0 - f[c]) / (1.0 - real), 0.0, 1.0)
        f[c] = f[c] * wp.lerp(1.0, f0[c] / real, share)
    return f


@wp.func
def metal_index(f0: float, edge: float) -> wp.vec2:
    """Return the complex index (n, k) of a metal by what it reflects along the normal, and by its edge tint.

    Gulbrandsen 2014, "Artist Friendly Metallic Fresnel"; as his edge tint serves the reflectance at 82 degrees.
    """
    r = wp.clamp(f0, 0.0, 0.999)
    root = wp.sqrt(r)
    n = wp.lerp((1.0 + root) / (1.0 - root), (1.0 - r) / (1.0 + r), edge)
    return wp.vec2(n, safe_sqrt((r * sqr(n + 1.0) - sqr(n - 1.0)) / (1.0 - r)))


@wp.func
def unit_phase(phase: wp.vec2) -> wp.vec2:
    """Return a complex number of length 1 in the direction of another; 1 for 0."""
    length = wp.length(phase)
    if length > 0.0:
        return phase / length
    return wp.vec2(1.0, 0.0)


@wp.func
def complex_product(a: wp.vec2, b: wp.vec2) -> wp.vec2:
    """Return the product of two complex numbers."""
    return wp.vec2(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.func
def metal_phases(index: float, metal: wp.vec2, cosine: float) -> wp.vec4:
    """Return how a metal in a medium of an index turns the phase: two complex numbers, perpendicular and parallel.

    Born and Wolf 1999, "Principles of Optics", section 14.4.1.
    """
    n2 = sqr(metal[0])
    k2 = sqr(metal[1])
    twice = 2.0 * metal[0] * metal[1]
    a = n2 - k2 - sqr(index) * (1.0 - sqr(cosine))
    b = wp.sqrt(sqr(a) + sqr(twice))
    u2 = wp.max(0.5 * (b + a), 0.0)
    v2 = wp.max(0.5 * (b - a), 0.0)
    u = wp.sqrt(u2)
    v = wp.sqrt(v2)
    along = index * cosine
    s = unit_phase(wp.vec2(sqr(along) - u2 - v2, -2.0 * along * v))
    p = unit_phase(wp.vec2(
        sqr((n2 + k2) * cosine) - sqr(index) * (u2 + v2), 2.0 * along * (twice * u - (n2 - k2) * v)))
    return wp.vec4(s[0], s[1], p[0], p[1])


@wp.func
def metal_under_film(index: float, metal: wp.vec2, edge: float, cosine: float) -> float:
    """Return the reflectance of an F82 metal of a complex index in a film."""
    n = metal[0] / index
    k2 = sqr(metal[1] / index)
    inside = (sqr(n - 1.0) + k2) / (sqr(n + 1.0) + k2)
    # The edge's reflectance stays what it is in air.
    at_82 = wp.lerp(inside, 1.0, SCHLICK_AT_82)
    dip = (at_82 - edge) * F82_SCALE
    return fresnel_f82(cosine, wp.vec3(inside, inside, inside), wp.vec3(dip, dip, dip))[0]


@wp.func
def film_metal(
    film_table: wp.array[wp.vec4], thickness: float, ior: float, f0: wp.vec3, b: wp.vec3, cos_i: float
) -> wp.vec3:
    """Return the unpolarised reflectance of a film on an F82 metal; see film_dielectric and fresnel_f82."""
    index = film_index(thickness, ior)
    upper = fresnel_amplitudes(wp.abs(cos_i), index)
    f = wp.vec3(1.0, 1.0, 1.0)
    if upper[2] < 0.0:
        return f
    edge = fresnel_f82(1.0 / 7.0, f0, b)
    cosines, sines = film_sensitivity(film_table, 2.0 * index * thickness * upper[2])
    cosines2, sines2 = film_sensitivity(film_table, 4.0 * index * thickness * upper[2])
    cosines3, sines3 = film_sensitivity(film_table, 6.0 * index * thickness * upper[2])
    for c in range(3):
        metal = metal_index(f0[c], edge[c])
        below = metal_under_film(index, metal, edge[c], upper[2])
        phases = metal_phases(index, metal, upper[2])
        total = float(0.0)
        for k in range(2):
            above = sqr(upper[k])
            passed = 1.0 - above
            inner = sqr(passed) * below / wp.max(1.0 - above * below, 1.0e-7)
            step = wp.vec2(phases[2 * k], phases[2 * k + 1]) * (-upper[k] * wp.sqrt(below))
            second = complex_product(step, step)
            third = complex_product(second, step)
            # The real part of each order's phase times that of its way through the film.
            waves = step[0] * cosines[c] - step[1] * sines[c]
            waves += second[0] * cosines2[c] - second[1] * sines2[c]
            waves += third[0] * cosines3[c] - third[1] * sines3[c]
            total += above + inner + 2.0 * (inner - passed) * waves
        f[c] = total * 0.5
    return saturate3(f)
