# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel where media that vary in space scatter paths; see media_scatter.py."""

from __future__ import annotations

import warp as wp

from .lamp_sample import no_light
from .light_linking import kinds_lit_inside
from .lights import class_total, sample_light_of
from .media import Inside, Media, MediaPaths, load_inside
from .media_scatter import aim_at_choice, go_on_scattered, scattered_direction, weigh_light
from .path_shading import LIGHT_CANDIDATES, begin_choice, candidate_place
from .paths import Options, Paths, survives
from .sampling import (
    DIMENSION_BSDF,
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LIGHT,
    DIMENSION_LIGHT_CHOICE,
    DIMENSION_LOBE,
    DIMENSION_RESAMPLE,
    DIMENSIONS_PER_BOUNCE,
    sample_number,
    sample_pair,
)
from .types import FrameData, Scene
from .volume_grids import Volumes
from .volume_phases import choose_phase_at, phase_value_at

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def light_in_volume(
    scene: Scene, media: Media, volumes: Volumes, inside: Inside, position: wp.vec3, instance: int, dimension: int,
    paths: Paths, path: int,
):
    """Draw light samples where a path is scattered and store the shadow ray of one; see media_scatter."""
    seed = paths.seed[path]
    index = paths.index[path]
    place = sample_pair(seed, index, dimension + DIMENSION_LIGHT)
    refill = sample_number(seed, index, dimension + DIMENSION_LIGHT_CHOICE)
    no_side = wp.vec3(0.0, 0.0, 0.0)
    choice = begin_choice(place, sample_number(seed, index, dimension + DIMENSION_RESAMPLE))
    kept = no_light()
    classes = class_total(scene.lights, no_side)
    k = int(0)
    while k < LIGHT_CANDIDATES:
        s = sample_light_of(
            scene, classes, position, no_side, candidate_place(place, float(k), LIGHT_CANDIDATES), refill)
        if s.kind >= 0:
            s.visibility = kinds_lit_inside(scene, s.visibility, instance)
            value = phase_value_at(media, volumes, inside, position, wp.dot(paths.direction[path], s.wi))
            choice = weigh_light(scene, choice, s, value, paths, path)
            if choice.keeps_last == 1:
                kept = s
        k = k + 1
    aim_at_choice(scene, choice, kept, position, paths, path)


@wp.kernel
def scatter_in_volumes(
    # In:
    frames: wp.array[FrameData],
    scene: Scene,
    options: Options,
    media: Media,
    volumes: Volumes,
    kept: MediaPaths,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Light listed paths where media scatter them, and list those that go on; see media_scatter.scatter_paths."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        bounce = bounces[0]
        limited = options.max_bounces > 0 and bounce >= options.max_bounces
        if not limited and survives(options, paths_out, path, bounce):
            inside = load_inside(kept, path)
            dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE
            seed = paths_out.seed[path]
            index = paths_out.index[path]
            before = paths_out.direction[path]
            position = paths_out.origin[path] + before * paths_out.t[path]
            choice = choose_phase_at(
                media, volumes, inside, position, sample_number(seed, index, dimension + DIMENSION_LOBE))
            if scene.lights.class_count > 0:
                light_in_volume(
                    scene, media, volumes, inside, position, choice.instance, dimension, paths_out, path)
            direction = scattered_direction(
                before, choice.anisotropy, sample_pair(seed, index, dimension + DIMENSION_BSDF))
            value = phase_value_at(media, volumes, inside, position, wp.dot(before, direction))
            if go_on_scattered(
                scene, media, inside, position, direction, value, choice.instance, bounce, paths_out, path):
                queue_out[wp.atomic_add(count_out, 0, 1)] = path
