# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a homogeneous medium scatters a path: distances, drawn by what is left of light or towards a lamp. No kernels.

Distances are drawn for one of the three channels, or by the angle at a light; the estimator is that of all these
together (balance heuristic of Veach 1997).
"""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component
from .lamp_hit import FAR
from .media import Mixture, passing

ALBEDO_MIN = wp.constant(0.1)
"""Albedo with which a channel counts at least where one is chosen for a distance: light of a channel in which nothing
is scattered must get through too"""


@wp.struct
class Passage:
    """What becomes of a path on a stretch."""

    t: float
    """From the stretch's begin, where it is scattered"""
    scattered: int
    weight: wp.vec3


@wp.func
def channel_odds(mixture: Mixture, throughput: wp.vec3) -> wp.vec3:
    """Return the chances with which each channel's distances are drawn: by what it carries on."""
    weight = wp.vec3(0.0, 0.0, 0.0)
    for c in range(3):
        albedo = float(0.0)
        if mixture.extinction[c] > 0.0:
            albedo = wp.min(mixture.scattering[c] / mixture.extinction[c], 1.0)
        weight[c] = wp.max(albedo, ALBEDO_MIN) * wp.abs(throughput[c])
    total = weight[0] + weight[1] + weight[2]
    if not (total > 1.0e-20 and total < 1.0e30):
        return wp.vec3(1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)
    return weight / total


@wp.struct
class Pull:
    """A light towards which distances are drawn, by the angle at it (Kulla and Fajardo 2012, section 4).

    "Importance Sampling Techniques for Path Tracing in Participating Media", EGSR.
    """

    chance: float
    """With which they are"""
    nearest: float
    """Where the ray is nearest to it, from the stretch's begin [m]"""
    apart: float
    """How far it is from there [m]"""
    angle: float
    """At it, between the stretch's ends [rad]"""
    length: float
    """Of the stretch [m]"""


@wp.func
def pull_of(to_light: wp.vec3, direction: wp.vec3, length: float, chance: float) -> Pull:
    """Return how a light at `to_light` from a stretch's begin draws distances, with a chance."""
    out = Pull()
    out.length = length
    out.nearest = wp.dot(to_light, direction)
    out.apart = wp.max(wp.length(to_light - direction * out.nearest), 1.0e-4 * wp.length(to_light))
    d = out.apart
    # Not as a difference of angles, of which nothing is left where the light is far or straight ahead.
    out.angle = wp.atan2(d * length, d * d - out.nearest * (length - out.nearest))
    if out.angle > 1.0e-12:
        out.chance = chance
    return out


@wp.func
def pulled_distance(pull: Pull, u: float) -> float:
    """Draw a distance towards a light."""
    d = pull.apart
    x = wp.tan(u * pull.angle)
    if wp.abs(x) > 1.0e6:
        # A right angle: the far side's sign is not its own.
        return pull.nearest + d * d / wp.max(pull.nearest, 1.0e-20)
    below = d + pull.nearest * x
    if wp.abs(below) < 1.0e-20:
        return pull.length
    return x * (d * d + pull.nearest * pull.nearest) / below


@wp.func
def pulled_density(pull: Pull, t: float) -> float:
    """Return the density of a distance that is drawn towards a light."""
    if t > pull.length:
        return 0.0
    beside = t - pull.nearest
    return pull.apart / (pull.angle * (pull.apart * pull.apart + beside * beside))


@wp.func
def walk_stretch(mixture: Mixture, throughput: wp.vec3, length: float, pull: Pull, u: wp.vec2) -> Passage:
    """Return whether and where a path is scattered on a stretch, and the weight of that."""
    out = Passage()
    extinction = mixture.extinction
    if max_component(mixture.scattering) <= 0.0:
        out.weight = passing(extinction, length)
        return out
    odds = channel_odds(mixture, throughput)
    t = float(2.0 * FAR)
    choice = u[0]
    if choice < pull.chance:
        t = pulled_distance(pull, u[1])
        # Rounding, of what is nearly at an end.
        t = wp.clamp(t, 0.0, wp.min(pull.length, length * 0.9999999))
    else:
        choice = (choice - pull.chance) / (1.0 - pull.chance)
        chosen = extinction[2]
        if choice < odds[0]:
            chosen = extinction[0]
        elif choice < odds[0] + odds[1]:
            chosen = extinction[1]
        if chosen > 0.0:
            t = -wp.log(1.0 - u[1]) / chosen
    if t < length:
        share = passing(extinction, t)
        density = wp.dot(odds, wp.cw_mul(extinction, share)) * (1.0 - pull.chance)
        if pull.chance > 0.0:
            density = density + pulled_density(pull, t) * pull.chance
        out.scattered = 1
        out.t = t
        out.weight = wp.cw_mul(mixture.scattering, share) / wp.max(density, 1.0e-36)
    else:
        share = passing(extinction, length)
        out.weight = share / wp.max(wp.dot(odds, share) * (1.0 - pull.chance), 1.0e-36)
    return out
