# SPDX-License-Identifier: GPL-3.0-or-later
"""Where light has gone into an object that comes out of it at a point, for one channel: two ways of real-time frames.

The walks of subsurface_walk.py with the numbers of one channel, that are ended by diffusion after some steps: in bright
bodies a tenth of them take over fifty, and all others of a warp would wait. And where the surface is about flat and the
body thick, the profile of such walks below a plane: that of Christensen and Burley, "Approximate Reflectance Profiles
for Efficient Subsurface Scattering" (Pixar Technical Memo 15-04, 2015). Functions only.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import orthonormal_tangent
from .sampling import hash_combine, hashed_unit, sample_pair
from .subsurface import PROFILE_MEAN
from .subsurface_walk import (
    FAR_SIDE,
    FULL_STEPS,
    THROUGHPUT_MIN,
    Guide,
    Meeting,
    diffusion_length,
    direction_about,
    meet,
    meet_other,
    next_turn,
)
from .types import Instance, ShadingPoint

WALK_STEPS = wp.constant(12)
"""Steps of a walk before it comes out by diffusion"""
DIFFUSED_FAR = wp.constant(12.0)
"""Diffusion lengths beyond which nothing comes out"""
EXTRAPOLATION = wp.constant(0.4)
"""Mean free paths beyond a surface at which diffusing light would be gone. The plane has 0.71; the first steps, which
are walked, leave less of it: with this half-spaces of all albedos keep their light within 1 to 2 %"""


@wp.struct
class WalkEnd:
    """Where a walk has come out."""

    met: Meeting
    """Face -1: it has not"""
    direction: wp.vec3
    weight: float


@wp.func
def ended(weight: float) -> bool:
    """Return whether a walk carries nothing any more, or nothing sane."""
    return not (wp.isfinite(weight) and weight >= THROUGHPUT_MIN)


@wp.func
def diffuse_out(
    instance: Instance, point: ShadingPoint, position: wp.vec3, thickness: float, extinction: float, albedo: float,
    weight: float, number: wp.uint32,
) -> WalkEnd:
    """Let light out at once where diffusion would let it; `thickness` [m] of the body below the point, 0 without end.

    Of a medium that scatters evenly.

    From a point in a half-space light diffuses to a place on the surface by the density z (1 + rho / L) exp(-rho / L) /
    (2 pi rho^3), with rho its distance in mean free paths, z the point's depth and L the diffusion length: the gradient
    of Green's function with its mirror image. Directions that are even over the half-space of the surface have
    z / (2 pi rho^3), and exp(-z / L) comes out in all. Between two planes D apart sinh(z / L) goes to the other one for
    sinh((D - z) / L) to the first, and both have their sum over sinh(D / L).
    """
    end = WalkEnd()
    side = float(1.0)
    length = diffusion_length(albedo)
    scale = extinction / length
    depth = wp.max(wp.dot(point.position - position, point.normal), 0.0) * scale
    all = wp.exp(-depth)
    if thickness > 0.0:
        other = wp.clamp(thickness * scale - depth, 0.0, DIFFUSED_FAR)
        depth = wp.min(depth, DIFFUSED_FAR)
        back = wp.sinh(depth)
        front = wp.sinh(other)
        all = (back + front) / wp.sinh(wp.max(depth + other, 1.0e-6))
        if hashed_unit(number, wp.uint32(3)) * (back + front) < back:
            side = -1.0
            depth = other
    end.direction = direction_about(
        point.normal, side * hashed_unit(number, wp.uint32(4)), hashed_unit(number, wp.uint32(5)))
    end.met = meet(instance, position, end.direction, DIFFUSED_FAR / scale)
    x = end.met.t * scale
    end.weight = weight * all * (1.0 + x) * wp.exp(depth - x) / (1.0 + EXTRAPOLATION / length)
    if ended(end.weight):
        end.met.face = -1
    return end


@wp.func
def density(extinction: float, stretch: float, t: float, out: bool) -> float:
    """Return the density of a scattering at t, or the chance to get there where a surface is met."""
    stretched = extinction * stretch
    return wp.exp(-stretched * t) * wp.where(out, 1.0, stretched)


@wp.func
def walk_channel(
    instance: Instance, point: ShadingPoint, extinction: float, albedo: float, anisotropy: float, depth: float,
    start: wp.vec3, weight: float, seed: wp.uint32, index: wp.uint32,
) -> WalkEnd:
    """Walk from below a point.

    Args:
        instance: The point's; with its mesh, which load_instance leaves out.
        point: Where the walk begins.
        extinction: Of the channel [1 / m].
        albedo: Of single scattering.
        anisotropy: Mean cosine of a scattering.
        depth: Of the other side [m]; 0: it is far.
        start: Direction in which it begins, into the object.
        weight: With which it begins.
        seed: Of its numbers.
        index: In their sequences.
    """
    end = WalkEnd()
    end.direction = start
    end.weight = weight
    position = point.position - point.geometric_normal * point.error
    g = anisotropy
    guide = Guide()
    guide.normal = point.normal
    guide.length = diffusion_length(albedo)
    guide.log_ratio = wp.log((guide.length + 1.0) / (guide.length - 1.0))
    guide.chance = 1.0 - wp.max(0.5, wp.pow(wp.abs(g), 0.125))
    guide.depth = wp.where(depth * extinction < FAR_SIDE, depth, 0.0)
    sigma = extinction
    scattering = extinction * albedo
    place = sample_pair(seed, index, 1)[1]
    t = float(0.0)
    out = bool(False)
    step = int(0)
    while step < WALK_STEPS:
        number = hash_combine(hash_combine(seed, index), wp.uint32(step))
        if step == FULL_STEPS + 1:
            sigma = sigma - scattering * g
            scattering = scattering * (1.0 - g)
            g = 0.0
            guide.chance = 0.75
        drawn = float(1.0)
        usual = float(1.0)
        if step > 0:
            turn = next_turn(guide, end.direction, g, wp.dot(point.position - position, guide.normal), number)
            place = hashed_unit(number, wp.uint32(1))
            t = -wp.log(1.0 - place) / (sigma * turn.stretch)
            end.direction = turn.direction
            end.met = meet(instance, position, end.direction, t)
            out = end.met.face >= 0
            t = wp.where(out, end.met.t, t)
            ahead = density(sigma, 1.0 - turn.cosine / guide.length, t, out) * turn.forward * (1.0 - turn.to_back)
            back = density(sigma, 1.0 + turn.cosine / guide.length, t, out) * turn.backward * turn.to_back
            usual = density(sigma, 1.0, t, out)
            drawn = usual * (1.0 - guide.chance) + (ahead + back) * guide.chance
        else:
            t = -wp.log(1.0 - place) / sigma
            end.met = meet_other(
                instance, position, end.direction, t, point.triangle - instance.triangle_offset, point.error)
            out = end.met.face >= 0
            t = wp.where(out, end.met.t, t)
        position = position + end.direction * t
        end.weight = end.weight * (usual / wp.max(drawn, 1.0e-30))
        if not out:
            end.weight = end.weight * (scattering / sigma)
        if ended(end.weight):
            end.met.face = -1
            return end
        if out:
            return end
        step = step + 1
    return diffuse_out(
        instance, point, position, depth, sigma, scattering / sigma, end.weight,
        hash_combine(hash_combine(seed, index), wp.uint32(WALK_STEPS)))


@wp.func
def profile_radius(spread: float, u: wp.vec2) -> float:
    """Draw a distance by the profile, whose mean is `spread`: by 2 pi r R(r).

    That is the sum of two exponentials: a quarter of one of width d and three of one of 3 d.
    """
    width = spread / PROFILE_MEAN
    return -wp.log(1.0 - u[1]) * wp.where(u[0] < 0.25, width, 3.0 * width)


@wp.func
def place_about(point: ShadingPoint, radius: float, angle: float) -> wp.vec3:
    """Return a place in a point's plane."""
    tangent = orthonormal_tangent(point.geometric_normal)
    aside = wp.cross(point.geometric_normal, tangent)
    return point.position + (tangent * wp.cos(angle) + aside * wp.sin(angle)) * radius
