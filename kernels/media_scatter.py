# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's kernels where rays end in scenes with media: scattered in one, or leaving the scene."""

from __future__ import annotations

import warp as wp

from .geometry_math import TWO_PI, mean_component, power_heuristic, safe_sqrt, to_frame
from .intersect import MISS
from .lamp_hit import FAR
from .lamp_sample import LightSample, no_light
from .light_choice import LightChoice, chosen_light, consider
from .light_linking import blockers, kinds_lit_inside, note_receiver
from .lights import class_total, sample_light_of
from .media import (
    Inside,
    Media,
    MediaPaths,
    choose_phase,
    load_inside,
    phase_value,
    return_chance,
)
from .misses import add_world, list_hit
from .path_guides import light_before, show_light
from .path_shading import LIGHT_CANDIDATES, aim_shadow_ray, begin_choice, candidate_place
from .paths import ENDED, Options, Paths, survives
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

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

RETURN_STREAM = wp.constant(wp.uint32(0x52455455))
"""Sets the numbers apart by which paths come back from far away"""


@wp.kernel
def shade_media_misses(
    # In:
    scene: Scene,
    options: Options,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
    plain_out: wp.array[int],
    plain_count_out: wp.array[int],
    full_out: wp.array[int],
    full_count_out: wp.array[int],
):
    """Add the world to the paths that leave the scene and end them, play roulette; see misses.shade_misses.

    Lamps have been met on the way. Media hide the world behind a transparent film by what they let through.
    """
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        bounce = paths_out.state[path]
        if bounce != ENDED:
            hit = paths_out.hit[path]
            if hit[0] == MISS:
                before = light_before(paths_out, path)
                add_world(scene, options, paths_out, path, bounce)
                paths_out.state[path] = ENDED
                show_light(options.exposure, paths_out, path, bounce, before)
                if bounce == 0 and options.transparent == 1:
                    r = paths_out.radiance[path]
                    left = wp.clamp(mean_component(paths_out.throughput[path]), 0.0, 1.0)
                    paths_out.radiance[path] = wp.vec4(r[0], r[1], r[2], 1.0 - left)
            else:
                list_hit(
                    scene, options, paths_out, path, bounce, plain_out, plain_count_out, full_out, full_count_out)


@wp.func
def weigh_light(
    scene: Scene, choice: LightChoice, s: LightSample, value: float, paths: Paths, path: int,
) -> LightChoice:
    """Return a choice that has considered a light sample for a path, of which `value` is scattered its way.

    `s.visibility`: from kinds_lit_inside.
    """
    weight = float(1.0)
    if s.delta == 0 and blockers(s.visibility) == 0:
        weight = power_heuristic(s.pdf, value)
    here = wp.cw_mul(paths.throughput[path], s.radiance) * (value * weight / s.pdf)
    worth = wp.dot(here, scene.luminance) * s.brightness
    return consider(choice, here, wp.where((s.visibility & VISIBLE_VOLUME) != 0, worth, 0.0))


@wp.func
def aim_at_choice(
    scene: Scene, choice: LightChoice, kept: LightSample, position: wp.vec3, paths: Paths, path: int,
):
    """Store the shadow ray of the light that was chosen for a place in the air, if there is one."""
    if kept.kind >= 0 and wp.isfinite(choice.total):
        light = chosen_light(choice, LIGHT_CANDIDATES)
        aim_shadow_ray(scene, position, position, kept, light, paths, path)


@wp.func
def scattered_direction(before: wp.vec3, anisotropy: float, u: wp.vec2) -> wp.vec3:
    """Return a direction drawn by Henyey and Greenstein's function about the one before."""
    cosine = phase_cosine(anisotropy, u[0])
    sine = safe_sqrt(1.0 - cosine * cosine)
    angle = TWO_PI * u[1]
    return wp.normalize(to_frame(before, wp.vec3(sine * wp.cos(angle), sine * wp.sin(angle), cosine)))


@wp.func
def go_on_scattered(
    scene: Scene, media: Media, inside: Inside, position: wp.vec3, direction: wp.vec3, value: float, instance: int,
    bounce: int, paths: Paths, path: int,
) -> bool:
    """Send a path on from where it is scattered, `value`: by how much that way; return whether it goes on."""
    density = float(value)
    chance = return_chance(media, inside, position)
    if chance < 1.0:
        dimension = DIMENSION_FIRST_BOUNCE + bounce * DIMENSIONS_PER_BOUNCE
        number = sample_number(
            hash_combine(paths.seed[path], RETURN_STREAM), paths.index[path], dimension + DIMENSION_ROULETTE)
        paths.throughput[path] = paths.throughput[path] / chance
        density = wp.where(number < chance, density, 0.0)
    # The share is the density: no weight.
    if not density > 0.0:
        return False
    paths.state[path] = bounce + 1
    paths.cone[path] = wp.vec2(
        paths.cone[path][0] + paths.cone[path][1] * paths.t[path], paths.cone[path][1])
    paths.origin[path] = position
    paths.direction[path] = direction
    paths.t[path] = FAR
    paths.pdf[path] = density
    paths.side[path] = wp.vec3(0.0, 0.0, 0.0)
    paths.kind[path] = VISIBLE_VOLUME
    note_receiver(scene, wp.max(instance, 0), paths, path)
    return True


@wp.func
def light_scattered(
    scene: Scene, media: Media, inside: Inside, position: wp.vec3, instance: int, dimension: int, paths: Paths,
    path: int,
):
    """Draw light samples where a path is scattered and store the shadow ray of one; see sample_direct_light."""
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
            value = phase_value(media, inside, wp.dot(paths.direction[path], s.wi))
            choice = weigh_light(scene, choice, s, value, paths, path)
            if choice.keeps_last == 1:
                kept = s
        k = k + 1
    aim_at_choice(scene, choice, kept, position, paths, path)


@wp.kernel
def scatter_paths(
    # In:
    frames: wp.array[FrameData],
    scene: Scene,
    options: Options,
    media: Media,
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
    """Light listed paths where media scatter them, and list those that go on.

    `bounces`: how many surfaces and scatterings the paths have met before, one element.
    """
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
            choice = choose_phase(media, inside, sample_number(seed, index, dimension + DIMENSION_LOBE))
            if scene.lights.class_count > 0:
                light_scattered(scene, media, inside, position, choice.instance, dimension, paths_out, path)
            direction = scattered_direction(
                before, choice.anisotropy, sample_pair(seed, index, dimension + DIMENSION_BSDF))
            value = phase_value(media, inside, wp.dot(before, direction))
            if go_on_scattered(
                scene, media, inside, position, direction, value, choice.instance, bounce, paths_out, path):
                queue_out[wp.atomic_add(count_out, 0, 1)] = path
