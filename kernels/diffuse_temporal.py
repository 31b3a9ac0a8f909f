# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporal half of the diffuse indirect light's denoiser (GI-1.0; method 7.5, "ReprojectGI").

Light from screen probes is smooth but changes from frame to frame. The mean is kept long while the light is steady
and short while it changes.
"""

from __future__ import annotations

import warp as wp

from .filter_weights import brightness
from .gbuffer import GBuffer
from .geometry_math import is_finite3
from .long_mean import ALL_TAPS, TAP_MINIMUM, gather_mean, gather_sharpness, history_cap, pack_mean, usable_weight
from .packing import from_half, rgb, to_half
from .reprojection import Reprojection, tap_pixel
from .view import SKY_DEPTH, View, settling_frames

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Frames in the short mean.
FAST_FRAMES = wp.constant(4.0)
# Relative difference of short and long mean that is always taken for noise.
MARGIN = wp.constant(0.05)
# Standard errors by which means must differ for a change to be seen, and for one that was seen to go on.
CHANGE_DEVIATIONS = wp.constant(2.0)
CHANGING_DEVIATIONS = wp.constant(0.5)
# Frames that the deviation is averaged over at most: more would be lost in a half-float's rounding.
DEVIATION_FRAMES = wp.constant(256.0)
# Of the frames since light began to spread, those that a mean may reach back: the first lack most of its bounces.
SETTLING_SHARE = wp.constant(0.5)

# Frames at rest between which trust moves from the change detector to the mean.
REST_START = wp.constant(16.0)
REST_END = wp.constant(64.0)


@wp.struct
class DiffuseHistory:
    """What a frame leaves of diffuse indirect light for the next: 16 bytes a pixel."""

    irradiance: wp.array[wp.uint64]
    """pack_mean of irradiance / pi"""
    state: wp.array[wp.vec4h]
    """Frames in the mean (-1: nothing known, 0: only a guess); short mean and standard deviation of the luminance; how
    much it is changing (0..1)"""


@wp.struct
class DiffuseMean:
    """The mean of one pixel."""

    irradiance: wp.vec3
    length: float
    fast: float
    """Short mean of the luminance"""
    deviation: float
    """Standard deviation of one frame's luminance"""
    change: float
    """How surely the light was changing in the frame before, 0..1"""


@wp.func
def unknown_light() -> DiffuseMean:
    """Return the mean of a pixel of which nothing is known."""
    m = DiffuseMean()
    m.irradiance = wp.vec3(0.0, 0.0, 0.0)
    m.length = -1.0
    m.fast = 0.0
    m.deviation = 0.0
    m.change = 0.0
    return m


@wp.func
def gather_diffuse(
    history: DiffuseHistory, gbuffer: GBuffer, position: wp.vec2, taps: wp.uint8, width: int, height: int,
) -> DiffuseMean:
    """Return the mean of the frame before at a pixel's surface; its length is -1 where there is none."""
    m = unknown_light()
    weights = wp.vec4(0.0, 0.0, 0.0, 0.0)
    state = wp.vec4(0.0, 0.0, 0.0, 0.0)
    total = float(0.0)
    complete = int(taps) == ALL_TAPS
    for tap in range(4):
        w = usable_weight(position, taps, tap)
        if w > 0.0:
            found = from_half(history.state[tap_pixel(position, tap, width)])
            if found[0] > 0.0:
                weights[tap] = w
                total += w
                state += found * w
            else:
                complete = False
    if total > TAP_MINIMUM:
        scale = 1.0 / total
        m.length = state[0] * scale
        m.fast = state[1] * scale
        m.deviation = state[2] * scale
        m.change = state[3] * scale
        sharpness = gather_sharpness(gbuffer, position, complete, width, height)
        m.irradiance = gather_mean(history.irradiance, position, weights * scale, sharpness, width, height)
    return m


@wp.func
def light_change(m: DiffuseMean, light: float, rest: int) -> float:
    """Return 0..1: whether the light has changed; 0 after a while at rest.

    The short mean must differ from the long one by more than its error, and the new light must not contradict it:
    a single bright frame is no change.
    """
    slow = brightness(m.irradiance)
    difference = m.fast - slow
    if difference * (light - slow) < 0.25 * difference * difference:
        return 0.0
    margin = MARGIN * wp.max(m.fast, slow)
    error = wp.sqrt(m.deviation * m.deviation / (2.0 * FAST_FRAMES - 1.0) + margin * margin) + 1.0e-7
    moving = wp.clamp((REST_END - float(rest)) / (REST_END - REST_START), 0.0, 1.0)
    threshold = CHANGING_DEVIATIONS
    if m.change < 0.25:
        # A short mean forgets by itself, and its deviation is not known yet.
        threshold = CHANGE_DEVIATIONS
        moving *= wp.clamp((m.length - 2.0) * 0.2, 0.0, 1.0)
    return moving * wp.clamp((wp.abs(difference) / error - threshold) * 0.5, 0.0, 1.0)


@wp.func
def add_irradiance(
    m: DiffuseMean, irradiance: wp.vec3, confidence: float, rest: int, cap: float,
) -> DiffuseMean:
    """Return the mean after a sample that counts for `confidence` frames; without any history it is taken as it is."""
    out = m
    light = brightness(irradiance)
    if m.length < 0.0:
        out.irradiance = irradiance
        out.length = confidence
        out.fast = light
        return out
    if confidence > 0.0:
        change = light_change(m, light, rest)
        out.change = change
        length = m.length * (1.0 - change) + confidence
        out.length = wp.min(length, cap)
        blend = wp.min(confidence / out.length, 1.0)
        # A change is not noise: it must not widen what counts as noise.
        narrow = wp.max(blend, 1.0 / DEVIATION_FRAMES) * (1.0 - change)
        apart = light - brightness(m.irradiance)
        out.deviation = wp.sqrt((1.0 - narrow) * (m.deviation * m.deviation + narrow * apart * apart))
        out.fast = wp.lerp(m.fast, light, wp.max(blend, confidence / FAST_FRAMES))
        out.irradiance = wp.lerp(m.irradiance, irradiance, blend)
    return out


@wp.kernel
def accumulate_diffuse(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    previous_gbuffer: GBuffer,
    reprojection: Reprojection,
    width: int,
    height: int,
    irradiance: wp.array[wp.vec4h],
    history: DiffuseHistory,
    frames: float,
    # Out:
    history_out: DiffuseHistory,
):
    """Average diffuse indirect light over frames (method 7.5); banded over pixels.

    In detail:
        first: Of the band.
        irradiance: This frame's irradiance / pi, exposed; w = confidence, 0..1.
        history: Of the frame before.
        frames: Cap of the mean's length in motion.

    53 bytes a pixel: 37 read (depth 4, reprojection 9, light 8, history 16 from one to four pixels, cached; the
    means, depths and normals of 16 pixels while the camera moves), 16 written.
    """
    pixel = first + wp.tid()
    view = views[0]
    m = unknown_light()
    if gbuffer.depth[pixel] < SKY_DEPTH:
        if view.restart == 0:
            m = gather_diffuse(
                history, previous_gbuffer, reprojection.position[pixel], reprojection.taps[pixel], width, height)
        new = from_half(irradiance[pixel])
        if is_finite3(rgb(new)) and wp.isfinite(new[3]):
            light = wp.max(rgb(new), wp.vec3(0.0, 0.0, 0.0))
            cap = wp.min(
                history_cap(view.rest, view.light_age, frames), 1.0 + SETTLING_SHARE * settling_frames(view))
            m = add_irradiance(m, light, wp.clamp(new[3], 0.0, 1.0), view.rest, wp.max(cap, 1.0))
    history_out.irradiance[pixel] = pack_mean(m.irradiance)
    history_out.state[pixel] = to_half(wp.vec4(m.length, m.fast, m.deviation, m.change))
