# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel for rays in scenes with media that vary in space: how far they get.

It takes the place of media_march.march_media there. Stretches on which everything is homogeneous are passed as there;
others by walks (volume_walk.py).
"""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS, layer_point, layer_transparency, pass_chance, step_past
from .geometry_math import is_finite3, max_component, power_heuristic
from .intersect import MISS, closest_layer, surface_point
from .lamp_hit import FAR
from .lamp_tables import meet_lamp
from .layers import LAYER_STREAM
from .light_groups import GroupLight, GroupTables, forget_groups
from .light_linking import lamp_counts, met_by_rays
from .lights import lamp_chance
from .media import NO_MEDIUM, Inside, Media, MediaPaths, cross, load_inside, medium_at, mixture_of, store_inside
from .media_distance import Passage, Pull, walk_stretch
from .media_march import (
    MEDIA_STREAM,
    PULLED_BOUNCES,
    add_met,
    gather_glow,
    gather_lamps_between,
    pull_on,
)
from .packing import rgb
from .paths import ENDED, Options, Paths, add_light, limit_at, load_hit, store_hit
from .sampling import hash_combine, sample_number, sample_pair
from .types import LIGHT_HITTABLE, Scene
from .volume_grids import Volumes, varies
from .volume_walk import share_of_way, walk_media

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

LAMP_STREAM = wp.constant(0x4C000000)
"""Sets the numbers of walks to lamps that are met apart from all others"""


@wp.func
def gather_lamps_through(
    scene: Scene, options: Options, media: Media, volumes: Volumes, inside: Inside, tables: GroupTables,
    groups: GroupLight, paths: Paths, path: int, throughput: wp.vec3, start: float, end: float, seed: wp.uint32,
):
    """Add the lamps that the ray meets on a stretch of media that vary; see media_march.gather_lamps_between."""
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
                share = share_of_way(
                    media, volumes, inside, origin, direction, start, hit.t,
                    hash_combine(seed, wp.uint32(LAMP_STREAM + i)))
                light = wp.cw_mul(wp.cw_mul(throughput, share), hit.radiance) * weight
                add_light(paths, path, light, limit_at(options, bounce))
                if groups.known.shape[0] > 0:
                    add_met(options, groups, tables.lamps[i], paths, path, light)


@wp.func
def pass_even(
    scene: Scene, options: Options, media: Media, inside: Inside, tables: GroupTables, groups: GroupLight,
    paths: Paths, path: int, throughput: wp.vec3, start: float, stretch: float, layer: int, seed: wp.uint32,
) -> Passage:
    """Take a path along a stretch of media that are the same everywhere, with the light that comes from it."""
    bounce = paths.state[path]
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
        if bounce <= PULLED_BOUNCES:
            pull = pull_on(
                scene, mixture, paths.origin[path] + paths.direction[path] * start, paths.direction[path], stretch,
                sample_pair(seed, paths.index[path], 2 * layer))
        out = walk_stretch(
            mixture, throughput, stretch, pull, sample_pair(seed, paths.index[path], 2 * layer + 1))
        out.t = out.t + start
    return out


@wp.func
def march_through(
    scene: Scene, options: Options, media: Media, volumes: Volumes, tables: GroupTables, groups: GroupLight,
    kept: MediaPaths, paths: Paths, path: int,
) -> bool:
    """Take a path to its hit; return whether a medium scatters it before; see media_march.march."""
    origin = paths.origin[path]
    direction = paths.direction[path]
    bounce = paths.state[path]
    kind = paths.kind[path]
    index = paths.index[path]
    seed = hash_combine(paths.seed[path], wp.uint32(bounce + LAYER_STREAM))
    media_seed = hash_combine(paths.seed[path], wp.uint32(bounce + MEDIA_STREAM))
    opaque = load_hit(paths, path)
    end = float(FAR)
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
        passage = Passage()
        if varies(media, volumes, inside):
            number = hash_combine(hash_combine(media_seed, index), wp.uint32(layer))
            if scene.lights.lamp_count > 0:
                gather_lamps_through(scene, options, media, volumes, inside, tables, groups, paths, path, throughput,
                                     start, start + stretch, number)
            passage = walk_media(options, media, volumes, inside, tables, groups, paths, path, throughput, start,
                                 start + stretch, number)
        else:
            passage = pass_even(scene, options, media, inside, tables, groups, paths, path, throughput, start, stretch,
                                layer, media_seed)
        throughput = wp.cw_mul(throughput, passage.weight)
        if passage.scattered == 1:
            paths.t[path] = passage.t
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
def march_volumes(
    # In:
    scene: Scene,
    options: Options,
    media: Media,
    volumes: Volumes,
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
    """Take listed paths to where they end or are scattered; list the scattered ones; see media_march.march_media."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        bounce = paths_out.state[path]
        if groups_out.known.shape[0] > 0 and (bounce == 0 or bounce == ENDED):
            forget_groups(groups_out, path)
        if bounce != ENDED:
            if march_through(scene, options, media, volumes, tables, groups_out, kept_out, paths_out, path):
                paths_out.state[path] = ENDED
                if bounce == 0:
                    kept_out.first[path] = 1
                if is_finite3(paths_out.throughput[path]) and max_component(paths_out.throughput[path]) > 0.0:
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path
        if groups_out.known.shape[0] > 0:
            groups_out.known[path] = rgb(paths_out.radiance[path])
