# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing one light sample for each pixel: candidates of this frame, joined with the frame before.

Initial candidates and temporal reuse of ReSTIR (Bitterli et al. 2020). The two are joined by the balance heuristic
over their targets (Talbot et al. 2005; "generalized balance heuristic" in Lin et al. 2022, section 5.7), which is
unbiased where a sample could not have been drawn at the other pixel; visibility is not fed back, so shadows can
neither darken nor lag.
"""

from __future__ import annotations

import warp as wp

from .direct_reservoir import (
    LARGE,
    UNTRACED,
    DirectOptions,
    LitSurface,
    Reservoir,
    Reservoirs,
    Shadows,
    load_lit,
    load_previous_lit,
    load_reservoir,
    target_of,
    traces_itself,
)
from .environment_split import EnvironmentSplit
from .gbuffer import GBuffer, barycentrics_of, has_surface, load_surface
from .intersect import offset_origin, surface_point
from .light_candidate import CANDIDATE_WORLD, candidate_kind, choose, replay
from .lights import FAR
from .paths import PENDING_NONE, PENDING_TRIANGLE, PENDING_WORLD, Paths, make_hit
from .reprojection import Reprojection, has_tap, tap_pixel, tap_weight
from .sampling import hash_combine, hashed_unit, pixel_seed_of, sample_pair
from .terminator import smooth_surface_offset
from .types import LIGHT_TRIANGLE, MATERIAL_CONSTANT_EMISSION, Scene, ShadingPoint
from .view import View, direction_to_eye

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Dimensions of the pixel's sequences, apart from those of the reference and the G-buffer.
DIMENSION_PICK = wp.constant(64)
DIMENSION_PLACE = wp.constant(65)
DIMENSION_POINT = wp.constant(66)
DIMENSION_RESAMPLE = wp.constant(67)
"""x: which candidate stays"""

# Frames at rest after which every frame draws anew: independent samples converge faster.
REUSE_REST = wp.constant(16.0)


@wp.func
def seed_of(view: View, options: DirectOptions, pixel: int) -> wp.uint32:
    """Return the seed of a pixel's sequences."""
    return pixel_seed_of(
        view.camera.crop_x + pixel % options.width, view.camera.crop_y + pixel // options.width, view.camera.seed)


@wp.func
def draw_candidates(
    scene: Scene, split: EnvironmentSplit, options: DirectOptions, p: LitSurface, seed: wp.uint32, frame: int,
    random: float,
) -> Reservoir:
    """Draw this frame's candidates and keep one by its target over its chance."""
    r = Reservoir()
    r.count = float(options.candidates)
    total = float(0.0)
    left = float(random)
    k = int(0)
    while k < options.candidates:
        # One sequence through all frames: at rest they are one stratified set.
        index = wp.uint32(frame) * wp.uint32(options.candidates) + wp.uint32(k)
        choice = choose(
            scene, split, p.surface.position, sample_pair(seed, index, DIMENSION_PICK),
            sample_pair(seed, index, DIMENSION_PLACE), sample_pair(seed, index, DIMENSION_POINT))
        if choice.chance > 0.0:
            value = target_of(scene, split, options, p, choice.candidate)
            weight = value / choice.chance
            if weight > 0.0:
                total = total + weight
                share = weight / total
                # What is left of a number after each decision is uniform again.
                if left < share:
                    left = left / share
                    r.candidate = choice.candidate
                    r.value = value
                else:
                    left = (left - share) / (1.0 - share)
        k = k + 1
    if r.value > 0.0:
        r.weight = wp.min(total / (float(options.candidates) * r.value), LARGE)
    return r


@wp.func
def choose_tap(view: View, reprojection: Reprojection, width: int, pixel: int, random: float) -> int:
    """Return a pixel of the frame before that shows the same surface, drawn by bilinear weights; -1 for none."""
    taps = reprojection.taps[pixel]
    if view.restart == 1 or view.light_age == 0 or taps == wp.uint8(0):
        return -1
    position = reprojection.position[pixel]
    total = float(0.0)
    chosen = int(-1)
    left = float(random)
    tap = int(0)
    while tap < 4:
        if has_tap(taps, tap):
            weight = tap_weight(position, tap)
            if weight > 0.0:
                total = total + weight
                share = weight / total
                if left < share:
                    left = left / share
                    chosen = tap
                else:
                    left = (left - share) / (1.0 - share)
        tap = tap + 1
    if chosen < 0:
        return -1
    return tap_pixel(position, chosen, width)


@wp.func
def join(
    scene: Scene, split: EnvironmentSplit, options: DirectOptions, p: LitSurface, q: LitSurface, now: Reservoir,
    before: Reservoir, random: float,
) -> Reservoir:
    """Join this frame's reservoir at `p` with one of the frame before at `q`."""
    here = now.value
    now_weight = float(0.0)
    if here > 0.0:
        there = target_of(scene, split, options, q, now.candidate)
        now_weight = now.count * here / (now.count * here + before.count * there) * here * now.weight
    carried = target_of(scene, split, options, p, before.candidate)
    before_weight = float(0.0)
    if carried > 0.0 and before.weight > 0.0:
        there = target_of(scene, split, options, q, before.candidate)
        before_weight = before.count * there / (now.count * carried + before.count * there) * carried * before.weight
    total = now_weight + before_weight
    r = Reservoir()
    r.count = now.count + before.count
    if total > 0.0 and total < LARGE:
        if random * total < now_weight:
            r.candidate = now.candidate
            r.weight = wp.min(total / here, LARGE)
        else:
            r.candidate = before.candidate
            r.weight = wp.min(total / carried, LARGE)
    return r


@wp.kernel
def resample_lights(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    options: DirectOptions,
    gbuffer: GBuffer,
    previous_gbuffer: GBuffer,
    reprojection: Reprojection,
    previous: Reservoirs,
    # Out:
    reservoirs_out: Reservoirs,
):
    """Choose each pixel's light sample: initial candidates, then temporal reuse."""
    pixel = first + wp.tid()
    view = views[0]
    r = Reservoir()
    p = load_lit(view, gbuffer, options.width, pixel)
    if has_surface(p.surface):
        seed = seed_of(view, options, pixel)
        index = wp.uint32(view.frame)
        u = sample_pair(seed, index, DIMENSION_RESAMPLE)
        r = draw_candidates(scene, split, options, p, seed, view.frame, u[0])
        cap = float(options.candidates * options.reuse) * wp.max(1.0 - float(view.rest) / REUSE_REST, 0.0)
        if cap > 0.0:
            # Independent of all before: numbers of the sequence that has decided earlier which sample stays would
            # favour samples that have already been favoured (1.6 % too much red from a textured lamp).
            noise = hash_combine(seed, index)
            q = choose_tap(view, reprojection, options.width, pixel, hashed_unit(noise, wp.uint32(0)))
            if q >= 0:
                before = load_reservoir(previous, q)
                before.count = wp.min(before.count, cap)
                other = load_previous_lit(view, previous_gbuffer, options.width, q)
                r = join(scene, split, options, p, other, r, before, hashed_unit(noise, wp.uint32(1)))
    reservoirs_out.sample[pixel] = wp.vec2ui(r.candidate.light, r.candidate.u)
    reservoirs_out.weight[pixel] = wp.vec2(r.weight, r.count)


@wp.func
def pixel_point(view: View, scene: Scene, gbuffer: GBuffer, width: int, pixel: int) -> ShadingPoint:
    """Return the exact point of a pixel's surface, from its triangle."""
    ids = gbuffer.hit[pixel]
    surface = load_surface(view, gbuffer, width, pixel)
    direction = -direction_to_eye(view.camera, surface.position)
    return surface_point(scene, make_hit(surface.depth, ids, barycentrics_of(gbuffer, pixel)), direction)


@wp.func
def pending_of(scene: Scene, kind: int, instance: int, triangle: int, world: int) -> int:
    """Return which program must be run for a light's radiance (PENDING_*)."""
    if world == 1:
        return PENDING_WORLD
    if kind != LIGHT_TRIANGLE:
        return PENDING_NONE
    material = scene.materials.instance_materials[
        scene.geometry.instances[instance].material_offset
        + wp.min(scene.geometry.slots[triangle], scene.geometry.instances[instance].material_count - 1)]
    if (scene.materials.materials[material].flags & MATERIAL_CONSTANT_EMISSION) != 0:
        return PENDING_NONE
    return PENDING_TRIANGLE


@wp.kernel
def aim_shadow_rays(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    options: DirectOptions,
    gbuffer: GBuffer,
    reservoirs: Reservoirs,
    # Out:
    rays_out: Paths,
    shadows_out: Shadows,
):
    """Set up each pixel's shadow ray, as the reference does (set_shadow_ray)."""
    pixel = first + wp.tid()
    view = views[0]
    rays_out.shadow_distance[pixel] = 0.0
    if options.full == 1:
        # Until the layers have been looked through all rays wait.
        rays_out.shadow_light[pixel] = wp.vec3(1.0, 1.0, 1.0)
        rays_out.shadow_pending[pixel] = PENDING_WORLD
        shadows_out.program[pixel] = wp.uint8(PENDING_NONE)
    r = load_reservoir(reservoirs, pixel)
    surface = load_surface(view, gbuffer, options.width, pixel)
    if not (r.weight > 0.0) or not has_surface(surface):
        return
    traces = traces_itself(view, options, gbuffer, reservoirs, surface, pixel)
    if not traces and options.full == 0:
        return
    point = pixel_point(view, scene, gbuffer, options.width, pixel)
    s = replay(scene, split, options.local_power, point.position, r.candidate)
    if s.kind < 0:
        return
    start = point.position + smooth_surface_offset(scene.geometry, point, s.wi)
    origin = offset_origin(start, point.geometric_normal, point.error, s.wi)
    direction = s.wi
    distance = s.distance
    if distance < FAR:
        # Aim at the sampled point again: the origin has moved.
        to_light = offset_origin(point.position + s.wi * s.distance, s.normal, s.error, -s.wi) - origin
        distance = wp.length(to_light)
        if not (distance > 0.0):
            return
        direction = to_light / distance
    rays_out.shadow_origin[pixel] = origin
    rays_out.shadow_direction[pixel] = direction
    if traces:
        rays_out.shadow_distance[pixel] = wp.where(s.shadow == 0, -distance, distance)
    if options.full == 1:
        world = wp.where(candidate_kind(r.candidate) == CANDIDATE_WORLD, 1, 0)
        program = pending_of(scene, s.kind, s.instance, s.triangle, world)
        if not traces:
            program = program | UNTRACED
        shadows_out.program[pixel] = wp.uint8(program)
        rays_out.shadow_emitter[pixel] = wp.vec2i(s.instance, s.triangle)
        rays_out.shadow_barycentrics[pixel] = wp.vec2(s.u, s.v)
