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
from .long_mean import (
    ALL_TAPS,
    EDIT_FRAMES,
    SMOOTH,
    TAP_MINIMUM,
    gather_mean,
    history_cap,
    nearest_tap,
    off_centre,
    pack_mean,
    place_between,
    surrounded,
    tap_weights,
    unpack_mean,
    valid_tap,
)
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba
from .reprojection import Reprojection, has_tap, known_taps, tap_pixel
from .view import SKY_DEPTH, View, settled_length
from .wide_loads import load_view, load_word

# Fast: means and weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Frames in the short mean.
FAST_FRAMES = wp.constant(4.0)
# Relative difference of short and long mean that is always taken for noise.
MARGIN = wp.constant(0.05)
# The same while light may be changing slowly, which the two means only differ little by.
DRIFT_MARGIN = wp.constant(0.02)
# Standard errors by which means must differ for a change to be seen, and for one that was seen to go on.
CHANGE_DEVIATIONS = wp.constant(2.0)
CHANGING_DEVIATIONS = wp.constant(0.5)
# Frames that the deviation is averaged over at most: more would be lost in a half-float's rounding.
DEVIATION_FRAMES = wp.constant(256.0)
# Confidence below which light does not replace the light from before an edit all the faster.
CONFIDENCE_MINIMUM = wp.constant(0.1)

# Frames since something but the camera moved for which light may have been changing slowly.
DRIFT_FRAMES = wp.constant(32)

# Frames at rest between which trust moves from the change detector to the mean.
REST_START = wp.constant(16.0)
REST_END = wp.constant(64.0)


@wp.struct
class DiffuseHistory:
    """What a frame leaves of diffuse indirect light for the next: 16 bytes a pixel."""

    irradiance: wp.array[wp.uint64]
    """pack_mean of irradiance / pi"""
    state: wp.array[wp.uint64]
    """pack_halves: frames in the mean (-1: nothing known, 0: only a guess); short mean and standard deviation of the
    luminance; how much it is changing (0..1)"""


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
def with_state(m: DiffuseMean, state: wp.vec4) -> DiffuseMean:
    """Return the mean with everything but its light set from DiffuseHistory.state."""
    out = m
    out.length = state[0]
    out.fast = state[1]
    out.deviation = state[2]
    out.change = state[3]
    return out


@wp.func
def gather_diffuse(
    history: DiffuseHistory, gbuffer: GBuffer, position: wp.vec2, taps: wp.uint8, own: int, width: int, height: int,
) -> DiffuseMean:
    """Return the mean of the frame before at a surface (pixel `own`); its length is -1 where there is none."""
    m = unknown_light()
    if not off_centre(position):
        nearest = nearest_tap(position)
        if has_tap(taps, nearest):
            pixel = tap_pixel(position, nearest, width)
            found = unpack_halves(history.state[pixel])
            if found[0] > 0.0:
                m = with_state(m, found)
                m.irradiance = unpack_mean(history.irradiance[pixel])
        return m
    place = place_between(position, width)
    weights = tap_weights(place)
    state = wp.vec4(0.0, 0.0, 0.0, 0.0)
    total = float(0.0)
    complete = int(taps) == ALL_TAPS
    for tap in range(4):
        # All are read before any is judged: they wait for memory together.
        around = unpack_halves(load_word(history.state, valid_tap(place, taps, tap, width, own)))
        if not has_tap(taps, tap):
            weights[tap] = 0.0
        elif not around[0] > 0.0:
            complete = complete and weights[tap] == 0.0
            weights[tap] = 0.0
        total += weights[tap]
        state += around * weights[tap]
    if total > TAP_MINIMUM:
        scale = 1.0 / total
        m = with_state(m, state * scale)
        # The shorter the less of the place is known (long_mean.py).
        m.length *= total
        wide = complete and surrounded(gbuffer, place, width, height)
        m.irradiance = gather_mean(history.irradiance, place, weights * scale, complete, wide, SMOOTH, width, height)
    return m


@wp.func
def light_change(m: DiffuseMean, light: float, rest: int, drifting: bool) -> float:
    """Return 0..1: whether the light has changed; 0 after a while at rest.

    The short mean must differ from the long one by more than its error, and the new light must not contradict it:
    a single bright frame is no change. `drifting`: light may have been changing for some frames.
    """
    slow = brightness(m.irradiance)
    difference = m.fast - slow
    if difference * (light - slow) < 0.25 * difference * difference:
        return 0.0
    margin = wp.where(drifting, DRIFT_MARGIN, MARGIN) * wp.max(m.fast, slow)
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
    m: DiffuseMean, irradiance: wp.vec3, confidence: float, rest: int, cap: float, drifting: bool,
) -> DiffuseMean:
    """Return the mean after a sample that counts for `confidence` frames; without any history it is taken as it is.

    `drifting`: light may have been changing for some frames, which must not count as noise.
    """
    out = m
    light = brightness(irradiance)
    if m.length < 0.0:
        out.irradiance = irradiance
        out.length = confidence
        out.fast = light
        return out
    if confidence > 0.0:
        change = light_change(m, light, rest, drifting)
        out.change = change
        length = m.length * (1.0 - change) + confidence
        out.length = wp.min(length, cap)
        blend = wp.min(confidence / out.length, 1.0)
        # A change is not noise: it must not widen what counts as noise.
        narrow = wp.max(blend, 1.0 / DEVIATION_FRAMES) * (1.0 - change)
        apart = light - wp.where(drifting, m.fast, brightness(m.irradiance))
        out.deviation = wp.sqrt((1.0 - narrow) * (m.deviation * m.deviation + narrow * apart * apart))
        out.fast = wp.lerp(m.fast, light, wp.max(blend, confidence / FAST_FRAMES))
        out.irradiance = wp.lerp(m.irradiance, irradiance, blend)
    return out


@wp.kernel(cuda_max_registers=64)
def accumulate_diffuse(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    previous_gbuffer: GBuffer,
    reprojection: Reprojection,
    width: int,
    height: int,
    irradiance: wp.array[wp.uint64],
    history: DiffuseHistory,
    frames: float,
    # Out:
    history_out: DiffuseHistory,
    irradiance_out: wp.array[wp.uint64],
):
    """Average diffuse indirect light over frames (method 7.5); banded over pixels.

    In detail:
        first: Of the band.
        irradiance: pack_halves of this frame's irradiance / pi, exposed; w = confidence, 0..1.
        history: Of the frame before.
        frames: Cap of the mean's length in motion.
        irradiance_out: pack_halves of the mean, for diffuse_blur.py; w = 1 where light is known, else 0.

    61 bytes a pixel: 37 read (depth 4, reprojection 9, light 8, history 16 from one pixel, or while the
    camera moves the means and depths of 12, cached), 24 written.
    """
    pixel = first + wp.tid()
    view = load_view(views)
    m = unknown_light()
    # Read before it is known whether there is a surface: they wait for memory together.
    position = reprojection.position[pixel]
    taps = known_taps(reprojection, pixel)
    new = unpack_halves(irradiance[pixel])
    if gbuffer.depth[pixel] < SKY_DEPTH:
        if view.restart == 0:
            m = gather_diffuse(history, previous_gbuffer, position, taps, pixel, width, height)
        if is_finite3(rgb(new)) and wp.isfinite(new[3]):
            light = wp.max(rgb(new), wp.vec3(0.0, 0.0, 0.0))
            cap = wp.min(
                history_cap(view.rest, view.light_age, frames), 1.0 + settled_length(view))
            confidence = wp.clamp(new[3], 0.0, 1.0)
            cap = wp.max(cap, 1.0)
            if view.light_age < EDIT_FRAMES:
                # As sure as new light is, so long lasts the old: else it would stay where confidence is low.
                cap *= wp.max(confidence, CONFIDENCE_MINIMUM)
            m = add_irradiance(m, light, confidence, view.rest, cap, view.moved_age < DRIFT_FRAMES)
    history_out.irradiance[pixel] = pack_mean(m.irradiance)
    history_out.state[pixel] = pack_halves(wp.vec4(m.length, m.fast, m.deviation, m.change))
    irradiance_out[pixel] = pack_halves(rgba(m.irradiance, wp.where(m.length >= 0.0, 1.0, 0.0)))
