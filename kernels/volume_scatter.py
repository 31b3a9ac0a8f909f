# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernel where media that vary in space scatter paths; see media_scatter.py."""

from __future__ import annotations

import warp as wp

from .geometry_math import TWO_PI, is_finite3, power_heuristic, safe_sqrt, to_frame
from .lamp_hit import FAR
from .light_choice import choice_of_none, chosen_light, consider
from .light_linking import blockers, kinds_lit, note_receiver
from .lights import class_total, sample_light_of
from .media import Inside, Media, MediaPaths, load_inside, return_chance
from .media_scatter import RETURN_STREAM
from .path_shading import LIGHT_CANDIDATES, aim_shadow_ray, candidate_place
from .paths import Options, Paths, survives
from .sampling import (
    DIMENSION_BSDF,
    DIMENSION_FIRST_BOUNCE,
    DIMENSION_LIGHT,
    DIMENSION_LIGHT_CHOICE,
    DIMENSION_LOBE,
    DIMENSION_RESAMPLE,
    DIMENSION_ROULETTE,
    DIMENSIONS_PER_BOUNCE,
    hash_combine,
    sample_number,
    sample_pair,
)
from .subsurface import phase_cosine
from .types import VISIBLE_VOLUME, FrameData, Scene
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
    choice = choice_of_none(sample_number(seed, index, dimension + DIMENSION_RESAMPLE))
    classes = class_total(scene.lights, no_side)
    k = int(0)
    while k < LIGHT_CANDIDATES:
        s = sample_light_of(
            scene, classes, position, no_side, candidate_place(place, float(k), LIGHT_CANDIDATES), refill)
        if s.kind >= 0:
            if instance >= 0:
                s.visibility = kinds_lit(scene, s.visibility, instance)
            value = phase_value_at(media, volumes, inside, position, wp.dot(paths.direction[path], s.wi))
            weight = float(1.0)
            if s.delta == 0 and blockers(s.visibility) == 0:
                weight = power_heuristic(s.pdf, value)
            here = wp.cw_mul(paths.throughput[path], s.radiance) * (value * weight / s.pdf)
            worth = wp.dot(here, scene.luminance) * s.brightness
            if is_finite3(here) and worth > 0.0 and (s.visibility & VISIBLE_VOLUME) != 0:
                choice = consider(choice, s, here, worth)
        k = k + 1
    if choice.kept.kind >= 0 and wp.isfinite(choice.total):
        light = chosen_light(choice, LIGHT_CANDIDATES)
        aim_shadow_ray(scene, position, position, choice.kept, light, paths, path)


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
            u = sample_pair(seed, index, dimension + DIMENSION_BSDF)
            cosine = phase_cosine(choice.anisotropy, u[0])
            sine = safe_sqrt(1.0 - cosine * cosine)
            angle = TWO_PI * u[1]
            direction = wp.normalize(
                to_frame(before, wp.vec3(sine * wp.cos(angle), sine * wp.sin(angle), cosine)))
            value = phase_value_at(media, volumes, inside, position, wp.dot(before, direction))
            chance = return_chance(media, inside, position)
            if chance < 1.0:
                number = sample_number(hash_combine(seed, RETURN_STREAM), index, dimension + DIMENSION_ROULETTE)
                paths_out.throughput[path] = paths_out.throughput[path] / chance
                value = wp.where(number < chance, value, 0.0)
            # The share is the density: no weight.
            if value > 0.0:
                paths_out.state[path] = bounce + 1
                paths_out.cone[path] = wp.vec2(
                    paths_out.cone[path][0] + paths_out.cone[path][1] * paths_out.t[path], paths_out.cone[path][1])
                paths_out.origin[path] = position
                paths_out.direction[path] = direction
                paths_out.t[path] = FAR
                paths_out.pdf[path] = value
                paths_out.side[path] = wp.vec3(0.0, 0.0, 0.0)
                paths_out.kind[path] = VISIBLE_VOLUME
                note_receiver(scene, wp.max(choice.instance, 0), paths_out, path)
                queue_out[wp.atomic_add(count_out, 0, 1)] = path
