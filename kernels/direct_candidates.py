# SPDX-License-Identifier: GPL-3.0-or-later
"""Choosing one light sample for each pixel: candidates of this frame, joined with the frame before.

Initial candidates and temporal reuse of ReSTIR (Bitterli et al. 2020). The two are joined by the balance heuristic
over their targets (Talbot et al. 2005; "generalized balance heuristic" in Lin et al. 2022, section 5.7), which is
unbiased where a sample could not have been drawn at the other pixel; visibility is not fed back, so shadows can
neither darken nor lag. Kernels run over slots (direct_reservoir.pixel_of_slot).
"""

from __future__ import annotations

import warp as wp

from .direct_reservoir import (
    LARGE,
    DirectOptions,
    Receiver,
    Reservoir,
    Reservoirs,
    has_sample,
    load_previous_receiver,
    load_receiver,
    load_reservoir,
    pixel_of_slot,
    target,
    target_of,
)
from .direct_temporal import DirectHistory
from .direct_turns import leaves_turn_out
from .environment_split import EnvironmentSplit
from .gbuffer import GBuffer, has_surface, load_surface
from .light_candidate import choose, light_classes, replay
from .light_linking import kinds_lit_at
from .reprojection import Reprojection, has_tap, known_taps, tap_pixel, tap_weight
from .sampling import STEP_REFILL, STEP_X, STEP_Y, fraction, hash_combine, hashed_unit, pixel_seed_of, sample_pair
from .types import Scene
from .view import View
from .wide_loads import load_previous_view, load_view
from .wide_stores import store_vec2

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Dimensions of the pixel's sequences, apart from those of the reference and the G-buffer.
DIMENSION_PICK = wp.constant(64)
DIMENSION_POINT = wp.constant(66)
DIMENSION_RESAMPLE = wp.constant(67)
"""x: which candidate stays"""

# Frames at rest after which every frame draws anew: independent samples converge faster.
REUSE_REST = wp.constant(16.0)

# A borrower may take a sample for this many times what it was chosen for: beyond that it would be a spark.
LENT_MAX = wp.constant(8.0)

# Cosine with the light below which no borrower's normal can face it (direct_shade.NEIGHBOUR_COSINE).
LEAST_COSINE = wp.constant(-0.45)

# Weight of a tap that has samples where the nearest has none (in motion every other pixel has).
LEAST_TAP = wp.constant(0.02)


@wp.func
def seed_of(view: View, options: DirectOptions, pixel: int) -> wp.uint32:
    """Return the seed of a pixel's sequences."""
    return pixel_seed_of(
        view.camera.crop_x + pixel % options.width, view.camera.crop_y + pixel // options.width, view.camera.seed)


@wp.func
def draw_candidates(
    scene: Scene, split: EnvironmentSplit, options: DirectOptions, emitters: wp.array[wp.uint64], gbuffer: GBuffer,
    pixel: int, p: Receiver, seed: wp.uint32, index: wp.uint32,
) -> Reservoir:
    """Draw this frame's candidates and keep one by its target over its chance.

    One point of the pixel's sequence serves all candidates, shifted from one to the next: each is as uniform as the
    first, together they are spread evenly over lights and places, and through all frames they are one stratified set.
    """
    which = sample_pair(seed, index, DIMENSION_PICK)
    place = sample_pair(seed, index, DIMENSION_POINT)
    resample = sample_pair(seed, index, DIMENSION_RESAMPLE)
    classes = light_classes(scene.lights, split)
    r = Reservoir()
    r.count = float(options.candidates)
    total = float(0.0)
    value = float(0.0)
    chance = float(0.0)
    left = float(resample[0])
    k = int(0)
    while k < options.candidates:
        step = float(k)
        choice = choose(
            scene, split, classes, p.position,
            wp.vec2(fraction(which[0] + step / r.count), fraction(which[1] + step * STEP_REFILL)),
            wp.vec2(fraction(place[0] + step * STEP_X), fraction(place[1] + step * STEP_Y)))
        if choice.chance > 0.0:
            s = replay(scene, split, emitters, p.position, choice.candidate)
            s.visibility = kinds_lit_at(scene, gbuffer, pixel, s.visibility)
            here = target(options, p, s, scene.luminance)
            weight = here / choice.chance
            if weight > 0.0:
                total = total + weight
                share = weight / total
                # What is left of a number after each decision is uniform again.
                if left < share:
                    left = left / share
                    r.candidate = choice.candidate
                    value = here
                    chance = choice.chance
                else:
                    left = (left - share) / (1.0 - share)
            elif total == 0.0 and s.kind >= 0 and wp.dot(p.normal, s.wi) > LEAST_COSINE:
                # Nothing for this pixel, but a borrower may lie inside the light's cone or face it a little more.
                r.candidate = choice.candidate
                chance = choice.chance
        k = k + 1
    if value > 0.0:
        r.weight = wp.min(total / (r.count * value), LARGE)
        r.lent = wp.min(r.weight, LENT_MAX / chance)
    elif chance > 0.0:
        r.weight = 1.0 / chance
        r.lent = r.weight
    return r


@wp.func
def store_reservoir(reservoirs: Reservoirs, pixel: int, r: Reservoir):
    """Keep a reservoir for the frame to come."""
    reservoirs.sample[pixel] = wp.vec2ui(r.candidate.light, r.candidate.u)
    store_vec2(reservoirs.weight, pixel, wp.vec2(r.weight, r.count))


@wp.kernel(cuda_max_registers=96)
def resample_lights(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    options: DirectOptions,
    gbuffer: GBuffer,
    reprojection: Reprojection,
    history: DirectHistory,
    # Out:
    reservoirs_out: Reservoirs,
    lent_out: wp.array[float],
):
    """Choose a light sample for each pixel that has one of its own; `history` is of the frame before."""
    slot = first + wp.tid()
    view = load_view(views)
    pixel = pixel_of_slot(view, options, slot)
    if pixel < 0:
        return
    r = Reservoir()
    if has_sample(view, options, slot):
        surface = load_surface(view, gbuffer, options.width, pixel)
        if has_surface(surface) and not leaves_turn_out(view, options, gbuffer, reprojection, history, slot, pixel):
            p = load_receiver(view, gbuffer, options, surface, pixel, scene.luminance)
            r = draw_candidates(
                scene, split, options, emitters, gbuffer, pixel, p, seed_of(view, options, pixel),
                wp.uint32(view.frame))
        lent_out[pixel] = r.lent
    elif options.reuse == 0:
        return
    store_reservoir(reservoirs_out, pixel, r)


@wp.func
def choose_tap(
    view: View, reprojection: Reprojection, previous: Reservoirs, width: int, pixel: int, random: float,
) -> int:
    """Return a pixel of the frame before that shows the same surface and drew samples; -1 for none."""
    taps = known_taps(reprojection, pixel)
    if view.restart == 1 or view.light_age == 0 or taps == wp.uint8(0):
        return -1
    position = reprojection.position[pixel]
    total = float(0.0)
    chosen = int(-1)
    left = float(random)
    tap = int(0)
    while tap < 4:
        if has_tap(taps, tap):
            q = tap_pixel(position, tap, width)
            if previous.weight[q][1] > 0.0:
                weight = wp.max(tap_weight(position, tap), LEAST_TAP)
                total = total + weight
                share = weight / total
                if left < share:
                    left = left / share
                    chosen = q
                else:
                    left = (left - share) / (1.0 - share)
        tap = tap + 1
    return chosen


@wp.func
def join(
    scene: Scene, split: EnvironmentSplit, emitters: wp.array[wp.uint64], options: DirectOptions, gbuffer: GBuffer,
    pixel: int, p: Receiver, previous_gbuffer: GBuffer, previous_pixel: int, q: Receiver, now: Reservoir,
    before: Reservoir, random: float,
) -> Reservoir:
    """Join this frame's reservoir at `p` with one of the frame before at `q`."""
    here = target_of(scene, split, emitters, options, gbuffer, pixel, p, now.candidate)
    now_weight = float(0.0)
    if here > 0.0:
        there = target_of(
            scene, split, emitters, options, previous_gbuffer, previous_pixel, q, now.candidate)
        now_weight = now.count * here / (now.count * here + before.count * there) * here * now.weight
    carried = target_of(scene, split, emitters, options, gbuffer, pixel, p, before.candidate)
    before_weight = float(0.0)
    if carried > 0.0 and before.weight > 0.0:
        there = target_of(
            scene, split, emitters, options, previous_gbuffer, previous_pixel, q, before.candidate)
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
    r.lent = r.weight
    return r


@wp.kernel
def reuse_lights(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    options: DirectOptions,
    gbuffer: GBuffer,
    previous_gbuffer: GBuffer,
    reprojection: Reprojection,
    previous: Reservoirs,
    # Out:
    reservoirs_out: Reservoirs,
    lent_out: wp.array[float],
):
    """Join each pixel's sample with that of its surface in the frame before."""
    slot = first + wp.tid()
    view = load_previous_view(views)
    pixel = pixel_of_slot(view, options, slot)
    if pixel < 0 or not has_sample(view, options, slot):
        return
    cap = float(options.candidates * options.reuse) * wp.max(1.0 - float(view.rest) / REUSE_REST, 0.0)
    surface = load_surface(view, gbuffer, options.width, pixel)
    now = load_reservoir(reservoirs_out, pixel)
    if cap <= 0.0 or not has_surface(surface) or now.count == 0.0:
        return
    # Independent of all before: numbers of the sequence that has decided earlier which sample stays would favour
    # samples that have already been favoured (1.6 % too much red from a textured lamp).
    noise = hash_combine(seed_of(view, options, pixel), wp.uint32(view.frame))
    q = choose_tap(view, reprojection, previous, options.width, pixel, hashed_unit(noise, wp.uint32(0)))
    if q < 0:
        return
    before = load_reservoir(previous, q)
    before.count = wp.min(before.count, cap)
    p = load_receiver(view, gbuffer, options, surface, pixel, scene.luminance)
    other = load_previous_receiver(view, previous_gbuffer, options, q, scene.luminance)
    r = join(
        scene, split, emitters, options, gbuffer, pixel, p, previous_gbuffer, q, other,
        now, before, hashed_unit(noise, wp.uint32(1)))
    store_reservoir(reservoirs_out, pixel, r)
    lent_out[pixel] = r.lent
