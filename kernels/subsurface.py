# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattering below a surface: which part of a closure it is, the medium that gives its albedo, and how light enters.

The medium is that of Chiang, Kutz and Burley, "Practical and Controllable Subsurface Scattering for Production Path
Tracing" (SIGGRAPH 2016 Talks): its single-scattering albedo is found from the colour that the surface is to have, its
extinction from the radius. Which fit, which radius and how rays enter is Cycles' choice for each of its methods
(kernel/closure/bssrdf.h and kernel/integrator/subsurface.h), so that a material looks alike in both. The walk itself
is in subsurface_walk.py.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .fresnel import f0_from_ior, ior_from_f0, saturate3
from .geometry_math import INV_PI, max_component, mean_component, orthonormal_tangent, safe_sqrt, sqr, to_frame
from .ggx import refract_about, sample_ggx_normal
from .layering import IOR_MIN
from .sampling import sample_cosine
from .types import CLOSURE_PRINCIPLED, Bsdf, Closure

RADIUS_MIN = wp.constant(1.0e-8)
"""A channel of a smaller radius [m] is reflected diffusely (Cycles, BSSRDF_MIN_RADIUS)"""

ALBEDO_MAX = wp.constant(0.999999)
"""Of single scattering: walks would never end"""

ALBEDO_MIN = wp.constant(0.2)
"""Walks of a lower one have this, and carry less: guided directions lose their sense below"""

PROFILE_MEAN = wp.constant(2.5)
"""Mean distance of the profile of diffusion, in its d"""

ENTRIES = wp.constant(4)
"""Directions of entry that plane_albedo averages over"""


@wp.struct
class Medium:
    """What is below a surface."""

    extinction: wp.vec3
    """[1 / m]"""
    albedo: wp.vec3
    """Of single scattering"""
    anisotropy: float
    """Mean cosine of a scattering"""
    factor: wp.vec3
    """On the throughput with which a path comes, which has the surface's albedo in it: the walk brings that itself"""


@wp.struct
class WithoutSubsurface:
    """A BSDF without the light that is scattered below the surface, and that light."""

    bsdf: Bsdf
    """Its odds sum to what `odds` leaves of 1"""
    weight: wp.vec3
    """Albedo weight of what is scattered"""
    odds: float
    """Chance with which a path goes below the surface"""


@wp.func
def scattered_share(closure: Closure) -> wp.vec3:
    """Return which share of the weight of a closure's diffuse lobe is scattered below the surface, per channel."""
    share = wp.vec3(0.0, 0.0, 0.0)
    if closure.subsurface_method == codes.SUBSURFACE_NONE or closure.kind != CLOSURE_PRINCIPLED:
        return share
    if closure.thin_wall != 0:
        return share
    amount = wp.clamp(closure.subsurface, 0.0, 1.0)
    for c in range(3):
        base = wp.max(closure.color[c], 0.0)
        below = wp.min(base, 1.0) * amount
        whole = below + base * (1.0 - amount)
        if closure.subsurface_radius[c] >= RADIUS_MIN and whole > 0.0:
            share[c] = below / whole
    return share


@wp.func
def without_subsurface(bsdf: Bsdf, closure: Closure) -> WithoutSubsurface:
    """Take what is scattered below the surface out of a BSDF's diffuse lobe (see layering.add_diffuse)."""
    result = WithoutSubsurface()
    result.bsdf = bsdf
    share = scattered_share(closure)
    whole = mean_component(bsdf.diffuse)
    if max_component(share) > 0.0 and whole > 0.0:
        result.weight = wp.cw_mul(bsdf.diffuse, share)
        result.odds = bsdf.pick_diffuse * wp.min(mean_component(result.weight) / whole, 1.0)
        result.bsdf.diffuse = bsdf.diffuse - result.weight
        result.bsdf.pick_diffuse = bsdf.pick_diffuse - result.odds
        if max_component(result.bsdf.diffuse) <= 0.0:
            result.odds = bsdf.pick_diffuse
            result.bsdf.pick_diffuse = 0.0
    return result


@wp.func
def entry_index(closure: Closure) -> float:
    """Return the index with which light enters: the closure's own, else that of its reflection (see add_dielectric)."""
    eta = closure.subsurface_ior
    if eta <= 0.0:
        ior = wp.max(closure.ior, IOR_MIN)
        eta = ior
        level = wp.max(closure.specular_level, 0.0)
        if level != 0.5:
            eta = ior_from_f0(f0_from_ior(ior) * 2.0 * level)
            if ior < 1.0:
                eta = 1.0 / eta
    return wp.clamp(eta, 1.01, 3.8)


@wp.func
def dipole_albedo(scattering: float, boundary: float) -> float:
    """Return the diffuse albedo of a half space by the dipole (Jensen et al. 2001, eq. 15, in reduced albedos).

    Args:
        scattering: Reduced albedo of single scattering.
        boundary: 4 / 3 of their A, for the reflection at the boundary.
    """
    s = wp.sqrt(3.0 * (1.0 - scattering))
    return 0.5 * scattering * (1.0 + wp.exp(-boundary * s)) * wp.exp(-s)


@wp.func
def dipole_scattering(albedo: float, boundary: float) -> float:
    """Return the reduced albedo of single scattering that has a diffuse albedo, by bisection."""
    if albedo < 1.0e-4:
        return 0.0
    if albedo >= 0.995:
        return ALBEDO_MAX
    low = float(0.0)
    high = float(1.0)
    i = int(0)
    while i < 12:
        middle = 0.5 * (low + high)
        if dipole_albedo(middle, boundary) < albedo:
            low = middle
        else:
            high = middle
        i = i + 1
    return 0.5 * (low + high)


@wp.func
def mean_free_path(closure: Closure, color: wp.vec3) -> wp.vec3:
    """Return the radius as the fits of the closure's method take it [m]."""
    radius = wp.max(closure.subsurface_radius, wp.vec3(0.0, 0.0, 0.0))
    if closure.subsurface_method == codes.SUBSURFACE_LEGACY:
        radius = radius * (0.25 * INV_PI)
    if closure.subsurface_method == codes.SUBSURFACE_SKIN:
        # Diffuse reflection of the boundary (Egan and Hilgeman 1973), as in Jensen et al. 2001, section 2.
        eta = entry_index(closure)
        reflected = (0.710 - 1.440 / eta) / eta + 0.668 + 0.0636 * eta
        boundary = (4.0 / 3.0) * (1.0 + reflected) / (1.0 - reflected)
        for c in range(3):
            radius[c] = radius[c] * wp.sqrt(3.0 * (1.0 - dipole_scattering(color[c], boundary)))
    return wp.max(radius, wp.vec3(1.0e-16, 1.0e-16, 1.0e-16))


@wp.func
def polynomial(x: float, c0: float, low: wp.vec3, high: wp.vec4) -> float:
    """Return c0 + low.x x + low.y x^2 + low.z x^3 + high.x x^4 + ... + high.w x^7."""
    upper = high[0] + x * (high[1] + x * (high[2] + x * high[3]))
    return c0 + x * (low[0] + x * (low[1] + x * (low[2] + x * upper)))


@wp.func
def fitted_scattering(color: float, g: float) -> float:
    """Return the albedo of single scattering that gives a diffuse one.

    The fit of Wrenninge, Villemin and Hery, "Path Traced Subsurface Scattering using Anisotropic Phase Functions and
    Non-Exponential Free Flights" (Pixar Technical Memo 17-07), for mean cosines from 0 to 0.9.
    """
    a = polynomial(g, 1.8260523782, wp.vec3(-1.28451056436, -1.79904629312, 9.19393289202),
                   wp.vec4(-22.8215585862, 32.0234874259, -23.6264803333, 7.21067002658))
    b = 4.98511194385 + 0.127355959438 * wp.exp(
        polynomial(g, 0.0, wp.vec3(31.1491581433, -201.847017512, 841.576016723),
                   wp.vec4(-2018.09288505, 2731.71560286, -1935.41424244, 559.009054474)))
    c = polynomial(g, 1.09686102424, wp.vec3(-0.394704063468, 1.05258115941, -8.83963712726),
                   wp.vec4(28.8643230661, -46.8802913581, 38.5402837518, -12.7181042538))
    d = polynomial(g, 0.496310210422, wp.vec3(0.360146581622, -2.15139309747, 17.8896899217),
                   wp.vec4(-55.2984010333, 82.065982243, -58.5106008578, 15.8478295021))
    e = 4.23190299701 + 0.00310603949088 * wp.exp(
        polynomial(g, 0.0, wp.vec3(76.7316253952, -594.356773233, 2448.8834203),
                   wp.vec4(-5576.68528998, 7116.60171912, -4763.54467887, 1303.5318055)))
    f = polynomial(g, 2.40602999408, wp.vec3(-2.51814844609, 9.18494908356, -79.2191708682),
                   wp.vec4(259.082868209, -403.613804597, 302.85712436, -87.4370473567))
    blend = wp.sqrt(wp.sqrt(color))
    return ((1.0 - blend) * a * wp.pow(wp.atan(b * color), c)
            + blend * d * wp.pow(wp.atan(e * color), f))


@wp.func
def hulst_scattering(color: float, g: float) -> float:
    """Return the albedo of single scattering that gives a diffuse one, by van de Hulst's approximation.

    Solved for it by d'Eon, "A Hitchhiker's Guide to Multiple Scattering" (v0.3.2), eq. 53.7.
    """
    root = wp.sqrt(9.59217 + 41.6808 * color + 17.7126 * sqr(color))
    s = sqr(4.20863 * color - root + 4.09712)
    rest = 1.0 - g * s
    if rest == 0.0:
        return 0.0
    return (1.0 - s) / rest


@wp.func
def medium_of(closure: Closure) -> Medium:
    """Return what is below the surface that a closure describes."""
    medium = Medium()
    color = saturate3(closure.color)
    radius = mean_free_path(closure, color)
    fitted = closure.subsurface_method != codes.SUBSURFACE_WALK
    g = wp.clamp(closure.subsurface_anisotropy, -0.99, wp.where(fitted, 0.9, 0.99))
    # The fit knows no backward scattering.
    fitted = fitted and g >= 0.0
    medium.anisotropy = g
    for c in range(3):
        albedo = hulst_scattering(color[c], g)
        extinction = 1.0 / radius[c]
        if fitted:
            albedo = fitted_scattering(color[c], g)
            extinction = extinction / (1.0 - g)
        albedo = wp.clamp(albedo, 0.0, ALBEDO_MAX)
        factor = float(0.0)
        if color[c] > 0.0:
            factor = wp.min(albedo / ALBEDO_MIN, 1.0) / color[c]
        medium.extinction[c] = extinction
        medium.albedo[c] = wp.max(albedo, ALBEDO_MIN)
        medium.factor[c] = factor
    return medium


@wp.func
def spread_distance(closure: Closure, medium: Medium) -> wp.vec3:
    """Return how far from where it has gone in light comes out in the mean, from below a plane, per channel [m].

    `medium`: from medium_of.

    By the profile of Christensen and Burley, "Approximate Reflectance Profiles for Efficient Subsurface Scattering"
    (Pixar Technical Memo 15-04, 2015), whose mean is PROFILE_MEAN times d, with their fit of d for light from all sides
    (eq. 6).
    """
    color = saturate3(closure.color)
    distance = wp.vec3(0.0, 0.0, 0.0)
    for c in range(3):
        # What is scattered forward has not been scattered (similarity relation, Wyman, Patterson and Wilson 1989).
        reduced = medium.extinction[c] * (1.0 - medium.anisotropy * medium.albedo[c])
        scale = 1.9 - color[c] + 3.5 * sqr(color[c] - 0.8)
        distance[c] = PROFILE_MEAN / (wp.max(reduced, 1.0e-20) * scale)
    return distance


@wp.func
def entry_direction(closure: Closure, normal: wp.vec3, wo: wp.vec3, u: wp.vec2) -> wp.vec3:
    """Return the direction in which a path goes below the surface, zero for none.

    It is refracted at a facet that `wo` sees; every second one of SUBSURFACE_SKIN, whose facets are as rough as can be,
    goes by the cosine instead. What facets hide is left out: the directions alone matter.
    """
    number = u
    alpha = wp.clamp(sqr(closure.roughness), 0.0, 1.0)
    if closure.subsurface_method == codes.SUBSURFACE_SKIN:
        alpha = 1.0
        if u[0] < 0.5:
            return to_frame(-normal, sample_cosine(wp.vec2(2.0 * u[0], u[1])))
        number = wp.vec2(2.0 * u[0] - 1.0, u[1])
    nothing = wp.vec3(0.0, 0.0, 0.0)
    cosine = wp.dot(normal, wo)
    if cosine <= 0.0:
        return nothing
    t = orthonormal_tangent(normal)
    b = wp.cross(normal, t)
    local = wp.vec3(wp.dot(t, wo), wp.dot(b, wo), cosine)
    m = wp.vec3(0.0, 0.0, 1.0)
    if alpha > 0.0:
        m = sample_ggx_normal(local, alpha, alpha, number)
    d = refract_about(local, m, entry_index(closure))
    return t * d[0] + b * d[1] + normal * d[2]


@wp.func
def plane_albedo(closure: Closure, normal: wp.vec3, wo: wp.vec3) -> wp.vec3:
    """Return which share of its colour's light a thick body with a plane surface returns to a view, per channel.

    Not all of it, as the media are fitted to light that enters otherwise; more where paths enter aslant. Cycles' bodies
    return as much. A fit to what path tracing finds under an even sky, within 1 to 3 % for colours from 0.1 to 0.9 and
    cosines of the view from 0.25 on.
    """
    aslant = float(0.0)
    for i in range(ENTRIES):
        # Hammersley's points.
        second = 0.125 + 0.5 * float(i % 2) + 0.25 * float(i // 2)
        direction = entry_direction(closure, normal, wo, wp.vec2((float(i) + 0.5) / float(ENTRIES), second))
        y = wp.clamp(1.0 + wp.dot(direction, normal), 0.0, 1.0)
        aslant += (2.45 * y + 1.2 * y * y + 0.7 * sqr(y * y)) / float(ENTRIES)
    start = float(0.771)
    slope = float(0.216)
    if closure.subsurface_method == codes.SUBSURFACE_LEGACY:
        start = 0.761
        slope = 0.247
    if closure.subsurface_method == codes.SUBSURFACE_SKIN:
        start = 0.796
    color = saturate3(closure.color)
    share = wp.vec3(0.0, 0.0, 0.0)
    for c in range(3):
        share[c] = start + slope * color[c] + (0.229 - 0.216 * color[c]) * aslant
    return share


@wp.func
def phase(cosine: float, g: float) -> float:
    """Return the density of Henyey and Greenstein's phase function over directions."""
    rest = 1.0 + g * g - 2.0 * g * cosine
    return 0.25 * INV_PI * (1.0 - g * g) / wp.max(rest * safe_sqrt(rest), 1.0e-12)


@wp.func
def phase_cosine(g: float, u: float) -> float:
    """Return a cosine by that density (Henyey and Greenstein 1941)."""
    if wp.abs(g) < 1.0e-3:
        return 1.0 - 2.0 * u
    part = (1.0 - g * g) / (1.0 + g - 2.0 * g * u)
    return wp.clamp((1.0 + g * g - part * part) / (2.0 * g), -1.0, 1.0)
