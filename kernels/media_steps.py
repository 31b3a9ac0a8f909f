# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens to the path tracer's rays on their way through media: lamps, layers, ends. Functions only, no kernels.

Of media_march.py and, where media vary in space, volume_march.py.
"""

from __future__ import annotations

import warp as wp

from .filter import layer_point, layer_transparency, pass_chance, step_past
from .geometry_math import is_finite3, max_component, power_heuristic
from .intersect import MISS, Hit, Layer, surface_point
from .lamp_tables import meet_lamp
from .layers import LAYER_STREAM
from .light_groups import GroupLight, GroupTables, add_to_group
from .light_linking import lamp_counts, met_by_rays
from .lights import lamp_chance
from .media import NO_MEDIUM, Inside, Media, MediaPaths, medium_at, past_layer, store_inside
from .paths import ENDED, Options, Paths, add_light, clamp_light, limit_at, store_hit
from .sampling import hash_combine, sample_number
from .types import LIGHT_HITTABLE, Scene


@wp.struct
class LampMet:
    """A lamp in a ray's way."""

    t: float
    """Distance; 0 where it is not met, or doesn't count"""
    radiance: wp.vec3
    weight: float
    """Of multiple importance sampling"""


@wp.func
def lamp_between(scene: Scene, lamp: int, paths: Paths, path: int, start: float, end: float) -> LampMet:
    """Return a lamp as a path's ray meets it on a stretch."""
    out = LampMet()
    flags = scene.lights.lamps[lamp].flags
    visibility = scene.lights.lamps[lamp].visibility
    if (flags & LIGHT_HITTABLE) != 0 and (visibility & paths.kind[path]) != 0:
        origin = paths.origin[path]
        pdf = paths.pdf[path]
        hit = meet_lamp(scene.lights, lamp, origin, paths.direction[path], end)
        counts = (lamp_counts(scene, visibility, paths.state[path], paths, path)
                  and met_by_rays(scene, visibility, pdf))
        if hit.t > 0.0 and hit.t >= start and counts:
            out.t = hit.t
            out.radiance = hit.radiance
            out.weight = float(1.0)
            if pdf > 0.0:
                out.weight = power_heuristic(pdf, hit.pdf * lamp_chance(scene.lights, lamp, origin, paths.side[path]))
    return out


@wp.func
def add_met(options: Options, groups: GroupLight, group: int, paths: Paths, path: int, light: wp.vec3):
    """Add to a path's light of a group what it has met and add_light has added."""
    if is_finite3(light):
        add_to_group(groups, group, path, clamp_light(light, limit_at(options, paths.state[path])))


@wp.func
def group_of(tables: GroupTables, instance: int) -> int:
    """Return the light group of what an object's medium emits; `instance` -1: the world's."""
    if instance < 0:
        return tables.world
    return tables.instances[instance]


@wp.func
def add_lamp(
    options: Options, tables: GroupTables, groups: GroupLight, paths: Paths, path: int, lamp: int, light: wp.vec3,
):
    """Add a lamp that a path's ray meets to its light and to that of the lamp's group."""
    add_light(paths, path, light, limit_at(options, paths.state[path]))
    if groups.known.shape[0] > 0:
        add_met(options, groups, tables.lamps[lamp], paths, path, light)


@wp.func
def reach_before(scene: Scene, opaque: Hit, direction: wp.vec3) -> float:
    """Return up to where layers count.

    One in the very place of an opaque surface, as the boundary of a fog that stands on a floor, lies behind that.
    """
    if opaque.instance == MISS:
        return opaque.t
    return 3.0 * opaque.t - 2.0 * step_past(surface_point(scene, opaque, direction), direction, opaque.t)


@wp.struct
class LayerMet:
    """What becomes of a path at a layer."""

    stops: int
    throughput: wp.vec3
    inside: Inside
    """Behind it"""
    look: float
    """From where to look for what comes next"""


@wp.func
def meet_layer(
    scene: Scene, media: Media, inside: Inside, further: Layer, hit: Hit, layer: int, throughput: wp.vec3, paths: Paths,
    path: int,
) -> LayerMet:
    """Let a path's layer of a number stop it by chance; `hit`: of `further`, its distance from the ray's origin."""
    direction = paths.direction[path]
    bounce = paths.state[path]
    kind = paths.kind[path]
    out = LayerMet()
    point = layer_point(scene, hit, direction, kind, bounce, paths.cone[path])
    transparency = layer_transparency(scene, point, kind, 0)
    chance = pass_chance(scene, point, transparency, kind)
    if further.solid == 1:
        chance = 0.0
    seed = hash_combine(paths.seed[path], wp.uint32(bounce + LAYER_STREAM))
    if sample_number(seed, paths.index[path], layer) >= chance:
        out.stops = 1
        out.throughput = throughput / (1.0 - chance)
        out.inside = inside
    else:
        out.throughput = wp.cw_mul(throughput, transparency / chance)
        out.inside = past_layer(scene, media, inside, hit.instance, point, kind)
        out.look = step_past(point, direction, hit.t)
    return out


@wp.func
def arrive(
    scene: Scene, media: Media, kept: MediaPaths, paths: Paths, path: int, hit: Hit, inside: Inside,
    throughput: wp.vec3,
):
    """Write down where a path's ray ends, what it carries and what it is in there."""
    store_hit(paths, path, hit)
    paths.throughput[path] = throughput
    store_inside(kept, path, inside)
    if hit.instance != MISS:
        if medium_at(scene, media, hit.instance, hit.triangle) != NO_MEDIUM:
            kept.backfacing[path] = wp.where(
                surface_point(scene, hit, paths.direction[path]).backfacing == 1, 1, 0)


@wp.func
def stop_in_medium(kept: MediaPaths, paths: Paths, path: int, t: float, inside: Inside, throughput: wp.vec3):
    """Write down where a medium scatters a path, what it carries and what it is in there."""
    paths.t[path] = t
    paths.hit[path] = wp.vec2i(MISS, 0)
    paths.throughput[path] = throughput
    store_inside(kept, path, inside)


@wp.func
def end_scattered(kept: MediaPaths, paths: Paths, path: int) -> bool:
    """End a path that a medium has scattered until it is taken on; return whether that pays."""
    if paths.state[path] == 0:
        kept.first[path] = 1
    paths.state[path] = ENDED
    return is_finite3(paths.throughput[path]) and max_component(paths.throughput[path]) > 0.0
