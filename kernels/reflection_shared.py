# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights that satin surfaces show in mirrors: shared by rays that go on over them and light samples where rays end.

Rays that go on over a weak, satin mirror, as a varnished floor seen in a mirror, are few, and those that meet a lamp
fewer yet: each is a spark. Those that end in the same place sample a light anyway, which the lobe shows too. Both bring
their share by the power heuristic (Veach 1997), of the same densities times how many rays do either. Functions.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import PI, mean_component, sqr
from .reflectance import BsdfAlbedo
from .reflection_highlights import (
    BEHIND_MAX,
    HIGHLIGHT_ALBEDO,
    HIGHLIGHT_ALPHA,
    HIGHLIGHT_DENSITY,
    HitLobe,
    coat_lobe,
    highlight_lobe,
    rounded_roughness,
)

# Roughness from which lobes are shared: light samples of sharper ones would have to be next to points.
SHARED_ROUGHNESS = wp.constant(0.05)
# Least part of all that a lobe must have that is mirrored: rays don't know which one sends them on.
SHARED_PART = wp.constant(0.9)
# Least chance of ending there: of metal hardly any ray does, and to let some do so for its lights alone would make all
# else that it shows noisy.
ENDING_MIN = wp.constant(0.02)


@wp.func
def shared_lobe(albedo: BsdfAlbedo, mirrored: wp.vec3, throughput: wp.vec3, pdf: float, ends: float) -> HitLobe:
    """Return the lobe whose lights are shared; not `mirrored`: rays bring all of them.

    Rays that go on and those that end ask with the same numbers.

    Args:
        albedo: Of the hit.
        mirrored: Part of its reflectance that sends rays on.
        throughput: Of the way to it.
        pdf: Least density of that way [1/sr].
        ends: Chance that a ray ends there.
    """
    none = HitLobe()
    rough = mean_component(albedo.diffuse + albedo.specular - mirrored)
    behind = mean_component(albedo.translucent)
    if ends < ENDING_MIN or pdf <= HIGHLIGHT_DENSITY or behind >= BEHIND_MAX * (behind + rough):
        return none
    lobe = highlight_lobe(albedo, wp.vec3(0.0, 0.0, 0.0), 1.0)
    whole = mean_component(mirrored)
    if mean_component(lobe.albedo) > whole * (2.0 - SHARED_PART):
        # The rough base is stronger, but the coat alone sends rays on.
        lobe = coat_lobe(mirrored, albedo.coat_roughness)
    other = highlight_lobe(albedo, mirrored, 1.0)
    own = mean_component(lobe.albedo)
    if own < SHARED_PART * whole or own < mean_component(other.albedo) or lobe.roughness < SHARED_ROUGHNESS:
        return none
    if mean_component(wp.cw_mul(throughput, lobe.albedo)) <= HIGHLIGHT_ALBEDO:
        return none
    lobe.mirrored = 1
    lobe.roughness = rounded_roughness(lobe.roughness)
    return lobe


@wp.func
def going_on(lobe: wp.vec3, rest: wp.vec3, throughput: wp.vec3) -> float:
    """Return how many rays go on for each that ends, by the albedos of the lobe and of the rest."""
    return mean_component(wp.cw_mul(throughput, lobe)) / wp.max(mean_component(wp.cw_mul(throughput, rest)), 1.0e-20)


@wp.func
def shared_density(roughness: float, normal: wp.vec3, wo: wp.vec3, wi: wp.vec3) -> float:
    """Return about the density [1/sr] with which a ray goes on in a direction: that of drawing half vectors by D cos.

    Args:
        roughness: Of the lobe, as rounded_roughness gives it.
        normal: Shading normal of the surface, valid for the view.
        wo: Towards the view.
        wi: The direction.
    """
    half = wp.normalize(wo + wi)
    up = wp.max(wp.dot(normal, half), 0.0)
    a2 = sqr(wp.max(sqr(roughness), HIGHLIGHT_ALPHA))
    z2 = up * up
    d = a2 / (PI * sqr(a2 * z2 + (1.0 - z2)))
    return d * up / (4.0 * wp.max(wp.dot(wo, half), 1.0e-3))
