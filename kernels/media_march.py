# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernels for rays in participating media: which media they start in, and how far they get.

In scenes with media one kernel takes each ray from its origin to the opaque hit, through all transparent layers:
boundaries of media without a surface are such layers. It does on the way what misses.py and layers.py do elsewhere:
adds the lamps that the ray meets, and lets layers stop it by chance. What lies on a stretch is seen through the media
before it, whether the path is scattered there or not.
"""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS, step_past
from .geometry_math import max_component, mean_component
from .intersect import MISS, Hit, closest_hit, closest_layer, surface_point
from .lamp_hit import FAR
from .light_groups import GroupLight, GroupTables, forget_groups
from .light_tree import choose_by_tree
from .media import (
    HELD,
    NO_MEDIUM,
    Inside,
    Media,
    MediaPaths,
    Mixture,
    cross,
    emitted,
    held_medium,
    held_object,
    load_inside,
    mixture_of,
    nowhere,
    passing,
    place_in,
    store_inside,
)
from .media_distance import Passage, Pull, pull_of, walk_stretch
from .media_steps import (
    add_lamp,
    add_met,
    arrive,
    end_scattered,
    group_of,
    lamp_between,
    meet_layer,
    reach_before,
    stop_in_medium,
)
from .packing import rgb
from .paths import ENDED, Options, Paths, add_light, limit_at, load_hit
from .sampling import hash_combine, sample_pair
from .types import Scene

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
    for i in range(scene.lights.lamp_count):
        met = lamp_between(scene, i, paths, path, start, end)
        if met.t > 0.0:
            arriving = wp.cw_mul(throughput, passing(mixture.extinction, met.t - start))
            add_lamp(options, tables, groups, paths, path, i, wp.cw_mul(arriving, met.radiance) * met.weight)


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
        k = int(0)
        while k < HELD:
            medium = held_medium(media, inside, k)
            if medium != NO_MEDIUM:
                part.emission = media.media[medium].emission
                add_met(options, groups, group_of(tables, held_object(inside, k)), paths, path,
                        wp.cw_mul(throughput, emitted(part, stretch)))
            k = k + 1


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
def pass_stretch(
    scene: Scene, options: Options, media: Media, inside: Inside, tables: GroupTables, groups: GroupLight,
    paths: Paths, path: int, throughput: wp.vec3, start: float, stretch: float, layer: int, seed: wp.uint32,
) -> Passage:
    """Take a path along a stretch of media that are the same everywhere, with the light that comes from it.

    The distance is from the ray's origin.
    """
    mixture = mixture_of(media, inside)
    out = Passage()
    out.weight = wp.vec3(1.0, 1.0, 1.0)
    if scene.lights.lamp_count > 0:
        gather_lamps_between(
            scene, options, tables, groups, paths, path, mixture, throughput, start, start + stretch)
    if max_component(mixture.emission) > 0.0:
        gather_glow(options, media, inside, tables, groups, paths, path, mixture, throughput, stretch)
    if max_component(mixture.extinction) > 0.0:
        pull = Pull()
        if paths.state[path] <= PULLED_BOUNCES:
            pull = pull_on(
                scene, mixture, paths.origin[path] + paths.direction[path] * start, paths.direction[path], stretch,
                sample_pair(seed, paths.index[path], 2 * layer))
        out = walk_stretch(
            mixture, throughput, stretch, pull, sample_pair(seed, paths.index[path], 2 * layer + 1))
        out.t = out.t + start
    return out


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
    media_seed = hash_combine(paths.seed[path], wp.uint32(paths.state[path] + MEDIA_STREAM))
    opaque = load_hit(paths, path)
    end = wp.where(opaque.instance != MISS, opaque.t, FAR)
    reach = reach_before(scene, opaque, direction)
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
        passage = pass_stretch(
            scene, options, media, inside, tables, groups, paths, path, throughput, start, stretch, layer, media_seed)
        throughput = wp.cw_mul(throughput, passage.weight)
        if passage.scattered == 1:
            stop_in_medium(kept, paths, path, passage.t, inside, throughput)
            return True
        if going:
            met_layer = meet_layer(scene, media, inside, further, hit, layer, throughput, paths, path)
            throughput = met_layer.throughput
            going = met_layer.stops == 0
            if going:
                inside = met_layer.inside
                start = hit.t
                look = met_layer.look
                if look >= reach:
                    hit = opaque
                    going = False
        layer = layer + 1
    arrive(scene, media, kept, paths, path, hit, inside, throughput)
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
                if end_scattered(kept_out, paths_out, path):
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path
        if groups_out.known.shape[0] > 0:
            groups_out.known[path] = rgb(paths_out.radiance[path])
