# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernels for rays in participating media: which media they start in, and how far they get.

In scenes with media one kernel takes each ray from its origin to the opaque hit, through all transparent layers:
boundaries of media without a surface are such layers. It does on the way what misses.py and layers.py do elsewhere:
adds the lamps that the ray meets, and lets layers stop it by chance. What lies on a stretch is seen through the media
before it, whether the path is scattered there or not.
"""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS, layer_point, layer_transparency, pass_chance, step_past
from .geometry_math import is_finite3, max_component, mean_component, power_heuristic
from .intersect import MISS, Hit, closest_hit, closest_layer, surface_point
from .lamp_hit import FAR
from .lamp_tables import meet_lamp
from .layers import LAYER_STREAM
from .light_groups import GroupLight, GroupTables, add_to_group, forget_groups
from .light_linking import lamp_counts, met_by_rays
from .light_tree import choose_by_tree
from .lights import lamp_chance
from .media import (
    NO_MEDIUM,
    STACK_SIZE,
    Inside,
    Media,
    MediaPaths,
    Mixture,
    cross,
    emitted,
    load_inside,
    medium_at,
    mixture_of,
    nowhere,
    passing,
    place_in,
    store_inside,
)
from .media_distance import Pull, pull_of, walk_stretch
from .packing import rgb
from .paths import ENDED, Options, Paths, add_light, clamp_light, limit_at, load_hit, store_hit
from .sampling import hash_combine, sample_number, sample_pair
from .types import LIGHT_HITTABLE, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

MEDIA_STREAM = wp.constant(0x56000000)
"""Sets the numbers that scatter light apart from all other streams"""
PULLED_BOUNCES = wp.constant(1)
"""Up to which distances are drawn towards lights: each time what is drawn otherwise weighs up to twice as much, and
paths of a hundred bounces in a cloud would come to weigh anything"""
SEARCH_STEPS = wp.constant(64)
"""Boundaries at most that a search for what is about the camera meets"""


@wp.func
def nearest_of_both(scene: Scene, origin: wp.vec3, direction: wp.vec3, start: float) -> Hit:
    """Return the closest triangle from a distance on, whether it is opaque or not; its t counts from the origin."""
    place = origin + direction * start
    hit = closest_hit(scene.geometry, place, direction, FAR)
    layer = closest_layer(scene.geometry, place, direction, hit.t)
    if layer.hit.instance != MISS:
        hit = layer.hit
    hit.t = hit.t + start
    return hit


@wp.kernel
def start_media(
    # In:
    scene: Scene,
    media: Media,
    paths: Paths,
    # Out:
    kept_out: MediaPaths,
):
    """Find which objects with media the camera's rays begin in, by what a ray upwards leaves without entering it.

    As in Cycles (kernel/integrator/intersect_volume_stack.h).
    """
    path = wp.tid()
    inside = nowhere()
    entered = nowhere()
    kept_out.first[path] = 0
    origin = paths.origin[path]
    searching = bool(paths.state[path] != ENDED)
    for c in range(3):
        searching = searching and origin[c] >= media.low[c] and origin[c] <= media.high[c]
    up = wp.vec3(0.0, 0.0, 1.0)
    start = float(0.0)
    step = int(0)
    while searching and step < SEARCH_STEPS:
        hit = nearest_of_both(scene, origin, up, start)
        searching = bool(hit.instance != MISS)
        if searching:
            point = surface_point(scene, hit, up)
            medium = media.of_material[point.material]
            if medium != NO_MEDIUM and point.backfacing == 0:
                entered = cross(entered, hit.instance, medium, False)
            elif medium != NO_MEDIUM and place_in(entered, hit.instance, medium) < 0:
                inside = cross(inside, hit.instance, medium, False)
            start = step_past(point, up, hit.t)
        step = step + 1
    store_inside(kept_out, path, inside)


@wp.func
def gather_lamps_between(
    scene: Scene, options: Options, tables: GroupTables, groups: GroupLight, paths: Paths, path: int, mixture: Mixture,
    throughput: wp.vec3, start: float, end: float,
):
    """Add the lamps that the ray meets on a stretch; `throughput` is that at its begin."""
    origin = paths.origin[path]
    direction = paths.direction[path]
    bounce = paths.state[path]
    pdf = paths.pdf[path]
    for i in range(scene.lights.lamp_count):
        flags = scene.lights.lamps[i].flags
        visibility = scene.lights.lamps[i].visibility
        if (flags & LIGHT_HITTABLE) != 0 and (visibility & paths.kind[path]) != 0:
            hit = meet_lamp(scene.lights, i, origin, direction, end)
            counts = lamp_counts(scene, visibility, bounce, paths, path) and met_by_rays(scene, visibility, pdf)
            if hit.t > 0.0 and hit.t >= start and counts:
                weight = float(1.0)
                if pdf > 0.0:
                    weight = power_heuristic(pdf, hit.pdf * lamp_chance(scene, i, origin, paths.side[path]))
                arriving = wp.cw_mul(throughput, passing(mixture.extinction, hit.t - start))
                light = wp.cw_mul(arriving, hit.radiance) * weight
                add_light(paths, path, light, limit_at(options, bounce))
                if groups.known.shape[0] > 0:
                    add_met(options, groups, tables.lamps[i], paths, path, light)


@wp.func
def add_met(options: Options, groups: GroupLight, group: int, paths: Paths, path: int, light: wp.vec3):
    """Add to a path's light of a group what it has met and add_light has added."""
    if is_finite3(light):
        add_to_group(groups, group, path, clamp_light(light, limit_at(options, paths.state[path])))


@wp.func
def gather_glow(
    options: Options, media: Media, inside: Inside, tables: GroupTables, groups: GroupLight, paths: Paths, path: int,
    mixture: Mixture, throughput: wp.vec3, stretch: float,
):
    """Add what the media on a stretch emit."""
    add_light(paths, path, wp.cw_mul(throughput, emitted(mixture, stretch)), limit_at(options, paths.state[path]))
    if groups.known.shape[0] > 0:
        part = Mixture()
        part.extinction = mixture.extinction
        if media.world != NO_MEDIUM:
            part.emission = media.media[media.world].emission
            add_met(options, groups, tables.world, paths, path, wp.cw_mul(throughput, emitted(part, stretch)))
        for i in range(STACK_SIZE):
            if inside.media[i] != NO_MEDIUM:
                part.emission = media.media[inside.media[i]].emission
                add_met(options, groups, tables.instances[inside.objects[i]], paths, path,
                        wp.cw_mul(throughput, emitted(part, stretch)))


@wp.func
def pull_on(
    scene: Scene, mixture: Mixture, origin: wp.vec3, direction: wp.vec3, length: float, u: wp.vec2,
) -> Pull:
    """Return the pull of one of the lights that have a place, by half of the chance that the stretch scatters light."""
    none = Pull()
    extinction = mean_component(mixture.extinction)
    if max_component(mixture.scattering) <= 0.0 or scene.lights.class_count == 0:
        return none
    if scene.lights.weight[0] <= 0.0:
        return none
    depth = extinction * length
    tree = scene.lights.tree
    amid = origin + direction * wp.min(0.5 * length, 1.0 / extinction)
    light = choose_by_tree(tree, amid, wp.vec3(0.0, 0.0, 0.0), u)
    if light.entry < 0:
        return none
    leaf = (1 << tree.levels) + tree.places[light.entry]
    low = tree.low[leaf]
    high = tree.high[leaf]
    center = wp.vec3(low[0] + high[0], low[1] + high[1], low[2] + high[2]) * 0.5
    # Little comes from deeper in.
    return pull_of(center - origin, direction, wp.min(length, 4.0 / extinction), 0.5 * (1.0 - wp.exp(-depth)))


@wp.func
def march(
    scene: Scene, options: Options, media: Media, tables: GroupTables, groups: GroupLight, kept: MediaPaths,
    paths: Paths, path: int,
) -> bool:
    """Take a path to its hit; return whether a medium scatters it before.

    Then it has ended there, at the distance t; else its hit, throughput and media are those of where the ray ends.
    """
    origin = paths.origin[path]
    direction = paths.direction[path]
    bounce = paths.state[path]
    kind = paths.kind[path]
    seed = hash_combine(paths.seed[path], wp.uint32(bounce + LAYER_STREAM))
    media_seed = hash_combine(paths.seed[path], wp.uint32(bounce + MEDIA_STREAM))
    index = paths.index[path]
    opaque = load_hit(paths, path)
    end = float(FAR)
    # A boundary in the very place of an opaque surface, as of a fog that stands on a floor, lies behind that.
    reach = opaque.t
    if opaque.instance != MISS:
        end = opaque.t
        reach = 3.0 * opaque.t - 2.0 * step_past(surface_point(scene, opaque, direction), direction, opaque.t)
    inside = load_inside(kept, path)
    throughput = paths.throughput[path]
    hit = opaque
    start = float(0.0)
    look = float(0.0)
    layer = int(0)
    going = bool(True)
    while going:
        further = closest_layer(scene.geometry, origin + direction * look, direction, reach - look)
        met = bool(further.hit.instance != MISS)
        hit = further.hit
        hit.t = hit.t + look
        if not met or layer == MAX_LAYERS:
            hit = opaque
            going = False
            if met:
                paths.overruns[path] = paths.overruns[path] + 1
        stretch = wp.max(wp.where(met, hit.t, end) - start, 0.0)
        mixture = mixture_of(media, inside)
        if scene.lights.lamp_count > 0:
            gather_lamps_between(
                scene, options, tables, groups, paths, path, mixture, throughput, start, start + stretch)
        if max_component(mixture.emission) > 0.0:
            gather_glow(options, media, inside, tables, groups, paths, path, mixture, throughput, stretch)
        if max_component(mixture.extinction) > 0.0:
            pull = Pull()
            if bounce <= PULLED_BOUNCES:
                pull = pull_on(
                    scene, mixture, origin + direction * start, direction, stretch,
                    sample_pair(media_seed, index, 2 * layer))
            passage = walk_stretch(mixture, throughput, stretch, pull, sample_pair(media_seed, index, 2 * layer + 1))
            throughput = wp.cw_mul(throughput, passage.weight)
            if passage.scattered == 1:
                paths.t[path] = start + passage.t
                paths.hit[path] = wp.vec2i(MISS, 0)
                paths.throughput[path] = throughput
                store_inside(kept, path, inside)
                return True
        if going:
            point = layer_point(scene, hit, direction, kind, bounce, paths.cone[path])
            transparency = layer_transparency(scene, point, kind, 0)
            chance = pass_chance(scene, point, transparency, kind)
            if further.solid == 1:
                chance = 0.0
            if sample_number(seed, index, layer) >= chance:
                throughput = throughput / (1.0 - chance)
                going = False
            else:
                throughput = wp.cw_mul(throughput, transparency / chance)
                medium = media.of_material[point.material]
                if medium != NO_MEDIUM and (scene.geometry.instances[hit.instance].visibility & kind) != 0:
                    inside = cross(inside, hit.instance, medium, point.backfacing == 1)
                start = hit.t
                look = step_past(point, direction, hit.t)
                if look >= reach:
                    hit = opaque
                    going = False
        layer = layer + 1
    store_hit(paths, path, hit)
    paths.throughput[path] = throughput
    store_inside(kept, path, inside)
    if hit.instance != MISS:
        if medium_at(scene, media, hit.instance, hit.triangle) != NO_MEDIUM:
            kept.backfacing[path] = wp.where(surface_point(scene, hit, direction).backfacing == 1, 1, 0)
    return False


@wp.kernel
def march_media(
    # In:
    scene: Scene,
    options: Options,
    media: Media,
    tables: GroupTables,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    kept_out: MediaPaths,
    groups_out: GroupLight,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Take listed paths, whose opaque hits are known, to where they end or are scattered; list the scattered ones.

    Those have ended until media_scatter.py takes them on. `groups_out`: takes the place of light_groups.add_lamps_met;
    empty where no light groups are asked for.
    """
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        bounce = paths_out.state[path]
        if groups_out.known.shape[0] > 0 and (bounce == 0 or bounce == ENDED):
            forget_groups(groups_out, path)
        if bounce != ENDED:
            if march(scene, options, media, tables, groups_out, kept_out, paths_out, path):
                paths_out.state[path] = ENDED
                if bounce == 0:
                    kept_out.first[path] = 1
                if is_finite3(paths_out.throughput[path]) and max_component(paths_out.throughput[path]) > 0.0:
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path
        if groups_out.known.shape[0] > 0:
            groups_out.known[path] = rgb(paths_out.radiance[path])
