# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel for rays in scenes with media that vary in space: how far they get.

It takes the place of media_march.march_media there. Stretches on which everything is homogeneous are passed as there;
others by walks (volume_walk.py).
"""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS
from .intersect import MISS, closest_layer
from .lamp_hit import FAR
from .light_groups import GroupLight, GroupTables, forget_groups
from .media import Inside, Media, MediaPaths, load_inside
from .media_distance import Passage
from .media_march import MEDIA_STREAM, pass_stretch
from .media_steps import add_lamp, arrive, end_scattered, lamp_between, meet_layer, reach_before, stop_in_medium
from .packing import rgb
from .paths import ENDED, Options, Paths, load_hit
from .sampling import hash_combine
from .types import Scene
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
    for i in range(scene.lights.lamp_count):
        met = lamp_between(scene, i, paths, path, start, end)
        if met.t > 0.0:
            share = share_of_way(
                media, volumes, inside, paths.origin[path], paths.direction[path], start, met.t,
                hash_combine(seed, wp.uint32(LAMP_STREAM + i)))
            add_lamp(options, tables, groups, paths, path, i,
                     wp.cw_mul(wp.cw_mul(throughput, share), met.radiance) * met.weight)


@wp.func
def march_through(
    scene: Scene, options: Options, media: Media, volumes: Volumes, tables: GroupTables, groups: GroupLight,
    kept: MediaPaths, paths: Paths, path: int,
) -> bool:
    """Take a path to its hit; return whether a medium scatters it before; see media_march.march."""
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
        passage = Passage()
        if varies(media, volumes, inside):
            number = hash_combine(hash_combine(media_seed, paths.index[path]), wp.uint32(layer))
            if scene.lights.lamp_count > 0:
                gather_lamps_through(scene, options, media, volumes, inside, tables, groups, paths, path, throughput,
                                     start, start + stretch, number)
            passage = walk_media(options, media, volumes, inside, tables, groups, paths, path, throughput, start,
                                 start + stretch, number)
        else:
            passage = pass_stretch(scene, options, media, inside, tables, groups, paths, path, throughput, start,
                                   stretch, layer, media_seed)
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


@wp.kernel(cuda_max_registers=128)
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
                if end_scattered(kept_out, paths_out, path):
                    queue_out[wp.atomic_add(count_out, 0, 1)] = path
        if groups_out.known.shape[0] > 0:
            groups_out.known[path] = rgb(paths_out.radiance[path])
