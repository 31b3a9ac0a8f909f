# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel that walks below a surface: from where light enters an object to where it comes out.

A random walk in the medium of subsurface.py, in one object and out at whichever of its surfaces is met. Distances are
drawn for one of the three channels, the estimator is that of all three (balance heuristic of Veach 1997). Many
directions are drawn towards the surface: Dwivedi's sampling as Křivánek and d'Eon have it ("A Zero-variance-based
Sampling Scheme for Monte Carlo Subsurface Scattering", SIGGRAPH 2014 Talks; eq. 9 and 10 of Meng, Hanika and
Dachsbacher, "Improving the Dwivedi Sampling Scheme", EGSR 2016), and away from it where the other side is near (d'Eon
and Křivánek, "Zero-Variance Theory for Efficient Subsurface Scattering", SIGGRAPH 2020 course). How many, and how many
steps there are at most, is as in Cycles (kernel/integrator/subsurface_random_walk.h): what is cut off is dark in its
pictures too.

A walk that meets nothing, as below an open mesh, ends without light; light is never made.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import (
    TWO_PI,
    is_finite3,
    max_component,
    safe_sqrt,
    to_frame,
    transform_direction,
    transform_point,
)
from .layering import unit_normal
from .normals import valid_specular_normal
from .paths import Paths, hit_point
from .sampling import hash_combine, hashed_unit, sample_pair
from .subsurface import Medium, entry_direction, medium_of, phase, phase_cosine
from .types import Instance, Scene, ShadingPoint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

STEPS_MAX = wp.constant(256)
"""Cycles' BSSRDF_MAX_BOUNCES"""
THROUGHPUT_MIN = wp.constant(1.0e-6)
"""A walk ends below it"""
FULL_STEPS = wp.constant(9)
"""After so many scatterings anisotropy is replaced by a smaller extinction (similarity relation, Wyman, Patterson and
Wilson 1989)"""
FAR_SIDE = wp.constant(10.0)
"""Mean free paths within which the other side of an object counts as near"""
WALK_SEED = wp.constant(wp.uint32(0x5B5EA7E1))
"""Changes a path's numbers where it goes below a surface: what comes after it uses others"""


@wp.struct
class Meeting:
    """Where a walk's ray meets the object."""

    t: float
    face: int
    """-1 for nowhere"""
    u: float
    v: float
    """Weights of the second and third vertex"""


@wp.struct
class Guide:
    """Dwivedi's sampling: towards a surface of normal `normal`, from it or not."""

    normal: wp.vec3
    length: float
    """Diffusion length, in mean free paths"""
    log_ratio: float
    """ln((length + 1) / (length - 1))"""
    depth: float
    """Of the other side [m], 0 where none is near"""
    chance: float
    """With which a direction is guided"""


@wp.struct
class Turn:
    """A direction of a walk, and how else it might have been drawn."""

    direction: wp.vec3
    cosine: float
    """With the guide's normal"""
    stretch: float
    """Factor on the extinction by which its distance is drawn"""
    forward: float
    """Density as a direction guided towards the surface, over that by the phase function"""
    backward: float
    """The same away from it"""
    to_back: float
    """Chance with which a guided one goes away from it"""


@wp.func
def meet(instance: Instance, origin: wp.vec3, direction: wp.vec3, t_max: float) -> Meeting:
    """Return where a ray first meets the object, all of it: holes of transparent materials count as skin too."""
    found = Meeting()
    found.face = -1
    # The direction is not normalised, so t means the same in both spaces.
    hit = wp.mesh_query_ray(
        instance.walk_mesh, transform_point(instance.to_object, origin),
        transform_direction(instance.to_object, direction), t_max)
    if hit.result:
        found.t = hit.t
        found.face = hit.face
        # Warp weighs the first vertex by u and the second by v.
        found.u = hit.v
        found.v = 1.0 - hit.u - hit.v
    return found


@wp.func
def meet_other(
    instance: Instance, origin: wp.vec3, direction: wp.vec3, t_max: float, own: int, error: float
) -> Meeting:
    """Return the same of a ray that leaves a triangle: that one's number is `own`, and it is not met again."""
    found = meet(instance, origin, direction, t_max)
    if found.face == own:
        start = found.t + error
        found = meet(instance, origin + direction * start, direction, t_max - start)
        found.t = found.t + start
        if found.face == own:
            found.face = -1
    return found


@wp.func
def diffusion_length(albedo: float) -> float:
    """Return how far light diffuses, in mean free paths (d'Eon and Křivánek 2020, eq. 67)."""
    exponent = 2.44294 - 0.0215813 * albedo + 0.578637 / albedo
    return 1.0 / wp.sqrt(1.0 - wp.pow(albedo, exponent))


@wp.func
def channel_odds(albedo: wp.vec3, throughput: wp.vec3) -> wp.vec3:
    """Return the chances with which each channel's distances are drawn: by what it carries on."""
    weight = wp.cw_mul(throughput, albedo)
    total = weight[0] + weight[1] + weight[2]
    if not total > 1.0e-20:
        return wp.vec3(1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)
    return weight / total


@wp.func
def passage(extinction: wp.vec3, t: float) -> wp.vec3:
    """Return the share of light that gets a distance far."""
    return wp.vec3(wp.exp(-extinction[0] * t), wp.exp(-extinction[1] * t), wp.exp(-extinction[2] * t))


@wp.func
def distance_density(extinction: wp.vec3, stretch: float, t: float, out: bool) -> wp.vec3:
    """Return each channel's density of a scattering at t, or its chance to get there where a surface is met."""
    stretched = extinction * stretch
    chance = passage(stretched, t)
    if out:
        return chance
    return wp.cw_mul(stretched, chance)


@wp.func
def guided_density(guide: Guide, cosine: float) -> float:
    """Return the density of a guided direction, over directions."""
    return 1.0 / (TWO_PI * (guide.length - cosine) * guide.log_ratio)


@wp.func
def backward_chance(guide: Guide, depth: float) -> float:
    """Return the chance with which a guided direction goes to the other side, from a depth below the surface."""
    if guide.depth <= 0.0:
        return 0.0
    x = wp.clamp(depth, 0.0, guide.depth)
    return 1.0 / (1.0 + wp.exp((guide.depth - 2.0 * x) / guide.length))


@wp.func
def direction_about(axis: wp.vec3, cosine: float, u: float) -> wp.vec3:
    """Return a direction at an angle with an axis."""
    sine = safe_sqrt(1.0 - cosine * cosine)
    angle = TWO_PI * u
    return wp.normalize(to_frame(axis, wp.vec3(sine * wp.cos(angle), sine * wp.sin(angle), cosine)))


@wp.func
def next_turn(guide: Guide, before: wp.vec3, g: float, depth: float, number: wp.uint32) -> Turn:
    """Draw a direction, guided or by the phase function; see Turn.

    Args:
        guide: How directions are guided, and how many.
        before: Unit direction so far.
        g: Mean cosine of a scattering.
        depth: Below the surface that the walk has come from [m].
        number: Seed of this step.
    """
    turn = Turn()
    turn.to_back = backward_chance(guide, depth)
    turn.stretch = 1.0
    u = hashed_unit(number, wp.uint32(4))
    angle = hashed_unit(number, wp.uint32(5))
    if hashed_unit(number, wp.uint32(2)) < guide.chance:
        side = wp.where(hashed_unit(number, wp.uint32(3)) < turn.to_back, -1.0, 1.0)
        cosine = side * (guide.length - (guide.length + 1.0) * wp.exp(-u * guide.log_ratio))
        turn.cosine = wp.clamp(cosine, -1.0, 1.0)
        turn.direction = direction_about(guide.normal, turn.cosine, angle)
        turn.stretch = 1.0 - side * turn.cosine / guide.length
    else:
        turn.direction = direction_about(before, phase_cosine(g, u), angle)
        turn.cosine = wp.clamp(wp.dot(turn.direction, guide.normal), -1.0, 1.0)
    usual = wp.max(phase(wp.dot(before, turn.direction), g), 1.0e-20)
    turn.forward = guided_density(guide, turn.cosine) / usual
    turn.backward = guided_density(guide, -turn.cosine) / usual
    return turn


@wp.func
def step_density(guide: Guide, turn: Turn, extinction: wp.vec3, t: float, out: bool) -> wp.vec3:
    """Return each channel's density of a step, over that of its direction by the phase function alone."""
    ahead = distance_density(extinction, 1.0 - turn.cosine / guide.length, t, out)
    guided = ahead * (turn.forward * (1.0 - turn.to_back))
    if turn.to_back > 0.0:
        back = distance_density(extinction, 1.0 + turn.cosine / guide.length, t, out)
        guided += back * (turn.backward * turn.to_back)
    return distance_density(extinction, 1.0, t, out) * (1.0 - guide.chance) + guided * guide.chance


@wp.func
def drawn_extinction(extinction: wp.vec3, odds: wp.vec3, choice: float) -> float:
    """Return the extinction of the channel that a number chooses."""
    if choice < odds[0]:
        return extinction[0]
    if choice < odds[0] + odds[1]:
        return extinction[1]
    return extinction[2]


@wp.func
def leave(
    paths: Paths, path: int, bounce: int, point: ShadingPoint, instance: Instance, found: Meeting, direction: wp.vec3,
):
    """Make a path arrive where it comes out, as if from outside and from near."""
    paths.state[path] = bounce
    paths.hit[path] = wp.vec2i(point.instance, instance.triangle_offset + found.face)
    paths.barycentrics[path] = wp.vec2(found.u, found.v)
    paths.direction[path] = -direction
    paths.t[path] = 0.0
    paths.cone[path] = wp.vec2(point.footprint, paths.cone[path][1])


@wp.func
def walk(scene: Scene, point: ShadingPoint, medium: Medium, start: wp.vec3, paths: Paths, path: int) -> bool:
    """Walk from `point` in the direction `start`; return whether the path comes out with light."""
    seed = paths.seed[path]
    index = paths.index[path]
    # load_instance leaves out the mesh.
    instance = scene.geometry.instances[point.instance]
    throughput = wp.cw_mul(paths.throughput[path], medium.factor)
    direction = start
    position = point.position - point.geometric_normal * point.error
    g = medium.anisotropy
    guide = Guide()
    guide.normal = point.normal
    guide.length = diffusion_length(max_component(medium.albedo))
    guide.log_ratio = wp.log((guide.length + 1.0) / (guide.length - 1.0))
    guide.chance = 1.0 - wp.max(0.5, wp.pow(wp.abs(g), 0.125))
    extinction = medium.extinction
    scattering = wp.cw_mul(extinction, medium.albedo)
    first = sample_pair(seed, index, 1)
    step = int(0)
    while step < STEPS_MAX:
        number = hash_combine(hash_combine(seed, index), wp.uint32(step))
        if step == FULL_STEPS + 1:
            extinction = extinction - scattering * g
            scattering = scattering * (1.0 - g)
            g = 0.0
            guide.chance = 0.75
        odds = channel_odds(medium.albedo, throughput)
        choice = first[0]
        place = first[1]
        turn = Turn()
        turn.stretch = 1.0
        if step > 0:
            choice = hashed_unit(number, wp.uint32(0))
            place = hashed_unit(number, wp.uint32(1))
            turn = next_turn(guide, direction, g, wp.dot(point.position - position, guide.normal), number)
            direction = turn.direction
        t = -wp.log(1.0 - place) / (drawn_extinction(extinction, odds, choice) * turn.stretch)
        found = Meeting()
        if step == 0:
            # Looks for the other side too.
            reach = wp.max(t, FAR_SIDE / wp.min(extinction[0], wp.min(extinction[1], extinction[2])))
            found = meet_other(
                instance, position, direction, reach, point.triangle - instance.triangle_offset, point.error)
            if found.face >= 0:
                guide.depth = wp.max(-wp.dot(direction, guide.normal) * found.t, 0.0)
        else:
            found = meet(instance, position, direction, t)
        out = found.face >= 0 and found.t < t
        if out:
            t = found.t
        position = position + direction * t
        value = passage(extinction, t)
        density = distance_density(extinction, 1.0, t, out)
        if step > 0:
            density = step_density(guide, turn, extinction, t, out)
        if not out:
            value = wp.cw_mul(value, scattering)
        throughput = wp.cw_mul(throughput, value) / wp.max(wp.dot(odds, density), 1.0e-30)
        if not is_finite3(throughput) or max_component(throughput) < THROUGHPUT_MIN:
            return False
        if out:
            paths.throughput[path] = throughput
            leave(paths, path, point.ray_depth, point, instance, found, direction)
            return True
        step = step + 1
    return False


@wp.kernel
def walk_below(
    # In:
    scene: Scene,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Walk the listed paths, which have ended at surfaces that they go below, and list those that come out.

    Their numbers are others from here on: the surface has used those of this bounce. `bounces`: how many surfaces the
    paths have met before, one element.
    """
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        point = hit_point(scene, paths_out, path, bounces[0])
        closure = paths_out.closure[path]
        paths_out.seed[path] = hash_combine(paths_out.seed[path], WALK_SEED)
        normal = valid_specular_normal(
            point.geometric_normal, point.wo, unit_normal(closure.normal, point.normal))
        direction = entry_direction(
            closure, normal, point.wo, sample_pair(paths_out.seed[path], paths_out.index[path], 0))
        if wp.dot(direction, point.geometric_normal) < 0.0:
            if walk(scene, point, medium_of(closure), direction, paths_out, path):
                queue_out[wp.atomic_add(count_out, 0, 1)] = path
