# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporal half of the reflections' denoiser (Eto et al. 2023, section 2; method 7.4).

A reflection moves with the surface or with the virtual image of what it shows: the mean is taken from both places in
the frame before, by how well each agrees with this frame. It is kept near this frame's neighbourhood and cut short
where a short mean leaves it. What counts is how much of a sample of its own a frame brought a pixel, so that mirrors
become as sharp as their own samples.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, SurfaceMaterial, load_material
from .geometry_math import is_finite3, max_component
from .long_mean import EDIT_FRAMES, history_cap, only_camera_moved, pack_mean
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba
from .reflection_blocks import ReflectionHistory, ReflectionLight, filter_roughness, light_strength
from .reflection_sources import (
    DISTANCE_BLEND,
    DISTANCE_FRAMES,
    DISTANCE_ROUGHNESS,
    MARGIN,
    ReflectionMean,
    gather_sources,
    no_reflection,
)
from .reflection_types import NO_SAMPLE, ReflectionOptions, ReflectionSamples, block_of, fading, is_sampled
from .reprojection import Reprojection
from .view import SKY_DEPTH, View, settling_frames
from .wide_loads import load_view

# Fast: means and weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Frames in the short mean.
FAST_FRAMES = wp.constant(6.0)
# Frames that the deviation is averaged over at most.
DEVIATION_FRAMES = wp.constant(64.0)
# Of the frames since light began to spread, those that a mean may reach back: the first lack most of its bounces. After
# so many frames it has spread.
SETTLING_SHARE = wp.constant(0.5)
SETTLED_FRAMES = wp.constant(64.0)
# Standard errors by which means must differ for a change to be seen, and for one that was seen to go on.
CHANGE_DEVIATIONS = wp.constant(2.5)
CHANGING_DEVIATIONS = wp.constant(1.0)
# Relative difference of distances from which on a mirror shows something else than before, and from twice which it does
# so for sure; the difference of the light, in deviations, that must come with it.
REPLACED_DISTANCE = wp.constant(0.04)
REPLACED_DEVIATIONS = wp.constant(0.5)
# Length and deviation, as a share of the difference, that a mean is left with then: where the edge of what is reflected
# runs through a pixel, the next such difference is one of noise.
RENEWED_LENGTH = wp.constant(0.5)
RENEWED_DEVIATION = wp.constant(0.7)
# Frames at rest in which that goes on, so that each pixel of a block has its turn; only means longer than the second
# have what was before.
RENEWED_FRAMES = wp.constant(4)
RENEWED_MINIMUM = wp.constant(2.0)
# Of the frames that a mean may hold in motion, those of a mirror's: its samples have little noise, and what comes into
# it from aside, or from behind something, would shine through what it showed before.
MIRROR_SHARE = wp.constant(0.25)
# Frames at rest after which changes are not looked for: what looks like one is chance.
REST_FRAMES = wp.constant(16.0)
# Frames at rest after which means are not kept near a frame's light any more: what came along from motion has gone.
CLAMP_FRAMES = wp.constant(4.0)
KNOWN_FRAMES = wp.constant(8.0)
# Confidence of a frame that brought nothing of this pixel's own, while the mean is shorter than so many frames.
START_CONFIDENCE = wp.constant(0.05)
START_FRAMES = wp.constant(2.0)
# Confidence below which a frame says nothing about changes.
TELLING = wp.constant(0.25)
# What a mean counts for in the frame in which light is edited: less than a frame without a sample of its own.
EDIT_LENGTH = wp.constant(0.01)


@wp.func
def clamped(m: ReflectionMean, color: wp.vec3, mean: float, deviation: float, limit: float) -> ReflectionMean:
    """Return the mean kept within `limit` deviations of the light around in this frame, its hue of this frame's.

    By the mean around, not by this pixel's light: where light comes in rare bright samples, that would throw out what
    the mean has of them, and lose some of it. The deviation is the larger of the one around and the one over frames.
    """
    out = m
    allowed = limit * wp.max(deviation, m.deviation) + MARGIN * mean
    slow = light_strength(m.light)
    strength = light_strength(color)
    if slow > mean + allowed:
        out.light = m.light * ((mean + allowed) / slow)
    elif slow < mean - allowed and strength > 0.0:
        out.light = m.light + color * ((mean - allowed - slow) / strength)
    slow = light_strength(out.light)
    if strength > 0.0:
        alike = color * (slow / strength)
        apart = max_component(wp.abs(out.light - alike))
        if apart > allowed:
            out.light = wp.lerp(alike, out.light, allowed / apart)
    return out


@wp.func
def change_of(m: ReflectionMean, strength: float, moving: float) -> float:
    """Return 0..1: whether the light has changed: the short mean has left the long one, and the new light agrees."""
    slow = light_strength(m.light)
    difference = m.fast - slow
    if difference * (strength - slow) < 0.25 * difference * difference:
        return 0.0
    margin = MARGIN * wp.max(m.fast, slow)
    error = wp.sqrt(m.deviation * m.deviation / (2.0 * FAST_FRAMES - 1.0) + margin * margin) + 1.0e-7
    threshold = wp.where(m.changed == 1, CHANGING_DEVIATIONS, CHANGE_DEVIATIONS)
    known = wp.clamp((m.length - 2.0) * 0.2, 0.0, 1.0)
    return moving * known * wp.clamp((wp.abs(difference) / error - threshold) * 0.5, 0.0, 1.0)


@wp.func
def renewed(m: ReflectionMean, light: wp.vec4, roughness: float) -> ReflectionMean:
    """Return the mean, made anew where a mirror shows something else: nearer or farther, and of other light.

    What moves in a mirror is gone before means of its light have told that it has changed.
    """
    out = m
    if m.length <= 0.0:
        return out
    far = wp.abs(light[3] - m.closeness) / (REPLACED_DISTANCE * wp.max(wp.max(light[3], m.closeness), 1.0e-9))
    apart = max_component(wp.abs(rgb(light) - m.light))
    strength = light_strength(rgb(light))
    unit = REPLACED_DEVIATIONS * m.deviation + MARGIN * wp.max(strength, light_strength(m.light)) + 1.0e-7
    share = wp.clamp(far - 1.0, 0.0, 1.0) * wp.clamp(apart / unit - 1.0, 0.0, 1.0)
    share = share * fading(roughness, DISTANCE_ROUGHNESS, DISTANCE_BLEND)
    if share > 0.0:
        out.light = wp.lerp(m.light, rgb(light), share)
        out.fast = wp.lerp(m.fast, strength, share)
        out.closeness = wp.lerp(m.closeness, light[3], share)
        out.deviation = wp.lerp(m.deviation, wp.max(m.deviation, RENEWED_DEVIATION * apart), share)
        out.length = wp.lerp(m.length, wp.min(m.length, RENEWED_LENGTH), share)
    return out


@wp.func
def add_reflection(
    m: ReflectionMean, light: wp.vec4, confidence: float, moving: float, cap: float, rest: float,
) -> ReflectionMean:
    """Return the mean after a frame, the `rest`th at rest, that counts for `confidence` samples."""
    out = m
    strength = light_strength(rgb(light))
    change = float(0.0)
    if confidence > TELLING:
        change = change_of(m, strength, moving)
        out.changed = wp.where(change > 0.0, 1, 0)
    out.length = wp.min(m.length * (1.0 - change) + confidence, cap)
    if out.length <= 0.0:
        return out
    blend = wp.min(confidence / out.length, 1.0)
    if change == 0.0:
        # A change is not noise: it must not widen what counts as noise.
        narrow = wp.max(blend, confidence / DEVIATION_FRAMES)
        apart = max_component(wp.abs(rgb(light) - m.light))
        out.deviation = wp.sqrt((1.0 - narrow) * (m.deviation * m.deviation + narrow * apart * apart))
    out.fast = wp.lerp(m.fast, strength, wp.max(blend, confidence / FAST_FRAMES))
    out.closeness = wp.lerp(m.closeness, light[3], wp.max(blend, confidence / (DISTANCE_FRAMES + rest)))
    out.light = wp.lerp(m.light, rgb(light), blend)
    return out


@wp.kernel(cuda_max_registers=72)
def accumulate_reflections(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    previous_gbuffer: GBuffer,
    reprojection: Reprojection,
    options: ReflectionOptions,
    samples: ReflectionSamples,
    lights: ReflectionLight,
    history: ReflectionHistory,
    temporal: int,
    frames: float,
    limit: float,
    # Out:
    history_out: ReflectionHistory,
):
    """Average reflections over frames (method 7.4); banded over pixels.

    In detail:
        first: Of the band.
        samples: Of this frame: where nothing in a block reflects there is no light.
        lights: Of this frame, from the filter.
        history: Of the frame before.
        temporal: 0: this frame's light alone.
        frames: Cap of the mean's length in motion.
        limit: Deviations around this frame's light that the mean is kept within; 0: any.

    73 bytes a pixel that reflects: 57 read (material 16, reprojection 9, light 16, history 16 from one pixel, or while
    the camera moves from two places of up to 12), 16 written. While something else moves history comes from two places
    where its image is, and 4 bytes of each block tell where.
    """
    pixel = first + wp.tid()
    m = no_reflection()
    sampled = samples.place[block_of(options, pixel)] != NO_SAMPLE
    material = SurfaceMaterial()
    if sampled:
        material = load_material(gbuffer, pixel)
        sampled = gbuffer.depth[pixel] < SKY_DEPTH and is_sampled(options, material)
    if sampled:
        view = load_view(views)
        roughness = filter_roughness(options, material)
        light = unpack_halves(lights.light[pixel])
        state = unpack_halves(lights.state[pixel])
        known = state[1] >= 0.0 and is_finite3(rgb(light))
        if view.restart == 0 and temporal == 1:
            m = gather_sources(
                views, gbuffer, previous_gbuffer, reprojection, options, samples, history, pixel, roughness,
                rgba(rgb(light), wp.where(known, light[3], -1.0)), wp.where(known, state[0], 1.0e4))
        if view.light_age == 0:
            m.length = wp.min(m.length, EDIT_LENGTH)
        if known:
            confidence = wp.max(state[1], START_CONFIDENCE * wp.clamp(1.0 - m.length / START_FRAMES, 0.0, 1.0))
            moving = wp.clamp(1.0 - float(view.rest) / REST_FRAMES, 0.0, 1.0)
            if not only_camera_moved(reprojection.position[pixel], reprojection.taps[pixel]):
                # A camera that moves takes what is reflected along with its image; past a mirror that turns near things
                # and those behind them go at their own pace.
                if view.rest == 0 or (view.rest <= RENEWED_FRAMES and m.length > RENEWED_MINIMUM):
                    m = renewed(m, light, roughness)
            near = wp.clamp(1.0 - float(view.rest) / CLAMP_FRAMES, 0.0, 1.0)
            # Means of a few frames know no deviation to go by.
            near *= wp.clamp(m.length / KNOWN_FRAMES, 0.0, 1.0)
            if limit > 0.0 and near > 0.0 and state[1] > TELLING:
                m = clamped(m, rgb(light), state[2], state[0], limit / near)
            settling = settling_frames(view)
            settled = wp.max(SETTLING_SHARE * settling, settling - SETTLED_FRAMES)
            # Mirrors get a sample of their own only in their turn: as many frames are fewer samples there.
            most = frames * wp.lerp(1.0, MIRROR_SHARE, fading(roughness, DISTANCE_ROUGHNESS, DISTANCE_BLEND))
            cap = wp.min(
                history_cap(view.rest, view.light_age, wp.max(most * state[3], 1.0)), 1.0 + state[3] * settled)
            if view.light_age < EDIT_FRAMES:
                # As sure as new light is, so long lasts the old: else it would stay where confidence is low.
                cap *= wp.max(confidence, START_CONFIDENCE)
            m = add_reflection(m, light, confidence, moving, cap, float(view.rest))
    history_out.light[pixel] = pack_mean(m.light)
    history_out.state[pixel] = pack_halves(
        wp.vec4(wp.where(m.changed == 1, -m.length, m.length), m.fast, m.deviation, m.closeness))
