# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporal half of the direct light's denoiser (SVGF, Schied et al. 2017, sections 4.1 and 4.2).

Diffuse and specular light, both demodulated, are averaged over frames at reprojected pixels; beside the means go
their deviations (Welford's update, which does not cancel as moments do) and short means to find changes by.

Frames are weighed by the albedo that the pixel had in them. Colours and normals finer than a pixel change with the
jitter, and often go together (the threads of a cloth): the mean albedo times a plain mean of the light is not the mean
of their product, a curtain of Sponza came out 30 % too bright. The mean albedo times the mean by albedo is.
"""

from __future__ import annotations

import warp as wp

from .filter_weights import (
    brightness,
    inside,
    pixel_plane,
    sharp_normal_weight,
    squared_cosine,
    surface_weight,
    unit_normal,
)
from .gbuffer import BRIGHT_SCALE, SURFACE_BRIGHT, SURFACE_TRANSLUCENT, GBuffer
from .geometry_math import is_finite3
from .long_mean import (
    ALL_TAPS,
    EDIT_FRAMES,
    SHARP,
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
from .packing import pack_unorm16, rgb, rgba, unpack_color, unpack_unorm16
from .reprojection import Reprojection, has_tap, known_taps, tap_pixel
from .view import MOVED_FRAMES, SKY_DEPTH, View
from .wide_loads import load_view, load_word

# Fast: means and weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Frames in the short mean.
FAST_FRAMES = wp.constant(5.0)
# Frames below which the deviation is estimated from the neighbourhood (SVGF, section 4.2).
SPATIAL_FRAMES = wp.constant(4.0)
# Most frames in the mean of specular light while something moves: highlights are elsewhere for each view.
SPECULAR_FRAMES = wp.constant(6.0)
# What a mean's length keeps of itself in a frame without a sample after an edit: the next sample makes up for it.
SKIPPED_SHARE = wp.constant(0.25)
# Frames that a mean counts for once a sudden change has been added to it (direct_change.py).
CHANGED_FRAMES = wp.constant(2.0)
# Frames that the deviation is averaged over at most: more would be lost in a half-float's rounding.
DEVIATION_FRAMES = wp.constant(256.0)
# Mean albedo below which frames are not weighed by it: 8-bit pictures can't show the light.
ALBEDO_MINIMUM = wp.constant(1.0e-3)


@wp.struct
class DirectHistory:
    """What a frame leaves of direct light for the next: 30 bytes a pixel."""

    diffuse: wp.array[wp.uint64]
    """pack_mean"""
    specular: wp.array[wp.uint64]
    moments: wp.array[wp.uint64]
    """pack_halves: standard deviation of a sample's luminance, diffuse and specular; short mean of both"""
    length: wp.array[wp.float16]
    """Frames in the mean; 0: none. Negative: as many, and the light is changing"""
    albedo: wp.array[wp.uint32]
    """pack_unorm16: mean luminance of the albedos, diffuse and specular"""


@wp.struct
class DirectMean:
    """The means of one pixel."""

    diffuse: wp.vec3
    specular: wp.vec3
    moments: wp.vec4
    albedo: wp.vec2
    """Luminances of the mean albedos, diffuse and specular"""
    length: float
    changed: int
    """1: the light was changing in the frame before"""


@wp.func
def empty_mean() -> DirectMean:
    """Return a mean of no frames."""
    m = DirectMean()
    m.diffuse = wp.vec3(0.0, 0.0, 0.0)
    m.specular = wp.vec3(0.0, 0.0, 0.0)
    m.moments = wp.vec4(0.0, 0.0, 0.0, 0.0)
    m.albedo = wp.vec2(0.0, 0.0)
    m.length = 0.0
    m.changed = 0
    return m


@wp.func
def albedos(gbuffer: GBuffer, pixel: int) -> wp.vec2:
    """Return the luminances of a surface's diffuse and specular albedo."""
    diffuse = brightness(unpack_color(gbuffer.diffuse[pixel]))
    specular = brightness(unpack_color(gbuffer.specular[pixel]))
    if (gbuffer.material[pixel] & SURFACE_TRANSLUCENT) != wp.uint32(0):
        diffuse = diffuse + brightness(unpack_color(gbuffer.translucent[pixel]))
        if (gbuffer.material[pixel] & SURFACE_BRIGHT) != wp.uint32(0):
            diffuse = diffuse * BRIGHT_SCALE
            specular = specular * BRIGHT_SCALE
    return wp.vec2(diffuse, specular)


@wp.func
def relative_albedo(now: float, mean: float) -> float:
    """Return the weight of a frame: its albedo by the mean of all frames'."""
    if mean < ALBEDO_MINIMUM:
        return 1.0
    return now / mean


@wp.func
def gather_direct(
    history: DirectHistory, gbuffer: GBuffer, position: wp.vec2, taps: wp.uint8, own: int, width: int, height: int,
) -> DirectMean:
    """Return the means of the frame before at a surface (pixel `own`); its length is 0 where there are none."""
    m = empty_mean()
    if not off_centre(position):
        nearest = nearest_tap(position)
        if has_tap(taps, nearest):
            pixel = tap_pixel(position, nearest, width)
            frames = float(history.length[pixel])
            m.length = wp.abs(frames)
            m.changed = wp.where(frames < 0.0, 1, 0)
            m.moments = unpack_halves(history.moments[pixel])
            m.albedo = unpack_unorm16(history.albedo[pixel])
            m.diffuse = unpack_mean(history.diffuse[pixel])
            m.specular = unpack_mean(history.specular[pixel])
        return m
    place = place_between(position, width)
    weights = tap_weights(place)
    # All are read before any is judged: they wait for memory together.
    lengths = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for tap in range(4):
        lengths[tap] = float(history.length[valid_tap(place, taps, tap, width, own)])
    moments = wp.vec4(0.0, 0.0, 0.0, 0.0)
    total = float(0.0)
    complete = int(taps) == ALL_TAPS
    for tap in range(4):
        found = unpack_halves(load_word(history.moments, valid_tap(place, taps, tap, width, own)))
        if not has_tap(taps, tap):
            weights[tap] = 0.0
        elif lengths[tap] == 0.0:
            complete = complete and weights[tap] == 0.0
            weights[tap] = 0.0
        elif lengths[tap] < 0.0 and weights[tap] > 0.25:
            m.changed = 1
        total += weights[tap]
        moments += found * weights[tap]
    if total > TAP_MINIMUM:
        scale = 1.0 / total
        m.moments = moments * scale
        # Of any one: as a factor on all of a pixel's weights it matters little.
        m.albedo = unpack_unorm16(history.albedo[valid_tap(place, taps, nearest_tap(position), width, own)])
        # The shorter the less of the place is known (long_mean.py).
        m.length = wp.dot(wp.vec4(
            wp.abs(lengths[0]), wp.abs(lengths[1]), wp.abs(lengths[2]), wp.abs(lengths[3])), weights)
        wide = complete and surrounded(gbuffer, place, width, height)
        m.diffuse = gather_mean(history.diffuse, place, weights * scale, complete, wide, SHARP, width, height)
        m.specular = gather_mean(history.specular, place, weights * scale, complete, wide, SHARP, width, height)
    return m


@wp.func
def spatial_deviation(
    views: wp.array[View], gbuffer: GBuffer, width: int, height: int, pixel: int, diffuse: wp.array[wp.uint64],
    specular: wp.array[wp.uint64],
) -> wp.vec2:
    """Return the standard deviations of the samples' luminances (diffuse, specular) around a pixel on its surface.

    Every other one of 5x5 pixels, as on a chessboard: where every other pixel has a sample, those are the ones.
    """
    plane = pixel_plane(load_view(views), gbuffer, width, pixel)
    normal = unit_normal(gbuffer.normal[pixel])
    x = pixel % width
    y = pixel // width
    mean = wp.vec2(0.0, 0.0)
    square = wp.vec2(0.0, 0.0)
    total = float(0.0)
    index = int(0)
    while index < 25:
        dx = index % 5 - 2
        dy = index // 5 - 2
        index += 2
        q = wp.clamp(y + dy, 0, height - 1) * width + wp.clamp(x + dx, 0, width - 1)
        d = unpack_halves(diffuse[q])
        s = unpack_halves(specular[q])
        values = wp.vec2(brightness(rgb(d)), brightness(rgb(s)))
        w = surface_weight(plane, dx, dy, gbuffer.depth[q])
        w *= sharp_normal_weight(squared_cosine(normal, gbuffer.normal[q]))
        if inside(x + dx, y + dy, width, height) and d[3] > 0.0 and wp.isfinite(values[0]) and wp.isfinite(values[1]):
            mean += values * w
            square += wp.cw_mul(values, values) * w
            total += w
    scale = 1.0 / wp.max(total, 1.0e-6)
    variance = square * scale - wp.cw_mul(mean, mean) * (scale * scale)
    return wp.vec2(wp.sqrt(wp.max(variance[0], 0.0)), wp.sqrt(wp.max(variance[1], 0.0)))


@wp.func
def has_sample(diffuse: wp.vec4, specular: wp.vec4) -> bool:
    """Return whether a frame has a sample of a pixel that can be taken; the first w counts for both."""
    return diffuse[3] > 0.0 and is_finite3(rgb(diffuse)) and is_finite3(rgb(specular))


@wp.func
def terms_of_change(change: float, level: float, variance: float) -> wp.vec4:
    """Return what standard_errors sums up over pixels: of a change of luminance to or from `level`, the larger one."""
    return wp.vec4(change, change * change, variance, level)


@wp.func
def change_terms(now: float, before: float, variance: float) -> wp.vec4:
    """Return the same of two luminances."""
    return terms_of_change(now - before, wp.max(now, before), variance)


@wp.func
def standard_errors(sums: wp.vec4, scale: float, pixels: float, margin: float) -> float:
    """Return by how many standard errors light of now and before differs over so many pixels.

    Args:
        sums: Of weighted change_terms.
        scale: 1 / sum of the weights.
        pixels: How many samples the mean difference is made of.
        margin: Relative difference that is always taken for noise.
    """
    difference = sums[0] * scale
    spread = wp.max(sums[1] * scale - difference * difference, sums[2] * scale)
    light = sums[3] * scale
    return wp.abs(difference) / (wp.sqrt(spread / pixels + margin * margin * light * light) + 1.0e-7)


@wp.func
def updated_deviation(old: float, change: float, blend: float) -> float:
    """Return the standard deviation after a sample that differs from the mean by `change` (Welford, weighted)."""
    return wp.sqrt((1.0 - blend) * (old * old + blend * change * change))


@wp.func
def add_sample(
    m: DirectMean, diffuse: wp.vec3, specular: wp.vec3, albedo: wp.vec2, cap: float, specular_cap: float,
) -> DirectMean:
    """Return the means after one more sample, of such albedos; at most so many frames keep their weight."""
    out = m
    out.length = wp.min(m.length + 1.0, cap)
    blend = 1.0 / out.length
    out.albedo = wp.lerp(m.albedo, albedo, blend)
    # As this frame's albedo is a part of the mean, shares are above 1 by rounding alone, but those of the short means.
    weight_d = relative_albedo(albedo[0], out.albedo[0])
    weight_s = relative_albedo(albedo[1], out.albedo[1])
    d = brightness(diffuse)
    s = brightness(specular)
    if m.changed == 0:
        # A change is not noise: it must not widen what counts as noise.
        narrow = wp.max(blend, 1.0 / DEVIATION_FRAMES)
        out.moments[0] = updated_deviation(m.moments[0], d - brightness(m.diffuse), narrow)
        out.moments[1] = updated_deviation(m.moments[1], s - brightness(m.specular), narrow)
    fast = wp.max(blend, 1.0 / FAST_FRAMES)
    out.moments[2] = wp.lerp(m.moments[2], d, wp.min(fast * weight_d, 1.0))
    out.moments[3] = wp.lerp(m.moments[3], s, wp.min(fast * weight_s, 1.0))
    out.diffuse = wp.lerp(m.diffuse, diffuse, wp.min(blend * weight_d, 1.0))
    out.specular = wp.lerp(m.specular, specular, wp.min(wp.max(blend, 1.0 / specular_cap) * weight_s, 1.0))
    return out


@wp.func
def after_change(m: DirectMean, diffuse: wp.vec4, specular: wp.vec4) -> DirectMean:
    """Return the means after a sudden change of both lights, as find_direct_changes writes them."""
    out = m
    zero = wp.vec3(0.0, 0.0, 0.0)
    share = wp.max(diffuse[3], specular[3])
    if share > 0.0:
        out.diffuse = wp.max(m.diffuse + rgb(diffuse) * diffuse[3], zero)
        out.specular = wp.max(m.specular + rgb(specular) * specular[3], zero)
        out.moments[2] = wp.lerp(m.moments[2], brightness(out.diffuse), diffuse[3])
        out.moments[3] = wp.lerp(m.moments[3], brightness(out.specular), specular[3])
        out.length = wp.lerp(m.length, wp.min(m.length, CHANGED_FRAMES), share)
        out.changed = 1
    return out


@wp.kernel(cuda_max_registers=64)
def accumulate_direct(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    previous_gbuffer: GBuffer,
    reprojection: Reprojection,
    width: int,
    height: int,
    diffuse: wp.array[wp.uint64],
    specular: wp.array[wp.uint64],
    history: DirectHistory,
    diffuse_change: wp.array[wp.uint64],
    specular_change: wp.array[wp.uint64],
    frames: float,
    # Out:
    history_out: DirectHistory,
    diffuse_out: wp.array[wp.uint64],
    specular_out: wp.array[wp.uint64],
):
    """Average direct light over frames (SVGF, section 4.1); banded over pixels.

    In detail:
        first: Of the band.
        diffuse: pack_halves of this frame's samples; w = 0: none.
        specular: Like `diffuse`, whose w counts for both.
        history: Of the frame before.
        diffuse_change: As find_direct_changes writes it, where something has moved.
        specular_change: Like `diffuse_change`.
        frames: Cap of the mean's length in motion.
        diffuse_out: pack_halves of the mean; w = standard deviation of its luminance, -1 where nothing is known.
        specular_out: Like `diffuse_out`.

    113 bytes a pixel: 67 read (depth 4, albedos 8, reprojection 9, samples 16, history 30 from one pixel, or while the
    camera moves the means and depths of 12, cached), 46 written. New surfaces read the samples of 13 pixels more.
    """
    pixel = first + wp.tid()
    view = load_view(views)
    specular_frames = SPECULAR_FRAMES + float(view.rest)
    m = empty_mean()
    # Read before it is known whether there is a surface: they wait for memory together.
    position = reprojection.position[pixel]
    taps = known_taps(reprojection, pixel)
    d = unpack_halves(diffuse[pixel])
    s = unpack_halves(specular[pixel])
    if gbuffer.depth[pixel] < SKY_DEPTH:
        if view.restart == 0:
            m = gather_direct(history, previous_gbuffer, position, taps, pixel, width, height)
        if view.moved_age < MOVED_FRAMES and m.length > 0.0:
            m = after_change(m, unpack_halves(diffuse_change[pixel]), unpack_halves(specular_change[pixel]))
        if (gbuffer.material[pixel] & wp.uint32(65535)) == wp.uint32(0):
            # Where a pixel on the edge of a mirror showed its frame before, the history is the frame's.
            m.specular = wp.vec3(0.0, 0.0, 0.0)
            m.moments[1] = 0.0
            m.moments[3] = 0.0
        if has_sample(d, s):
            zero = wp.vec3(0.0, 0.0, 0.0)
            cap = history_cap(view.rest, view.light_age, frames)
            m = add_sample(
                m, wp.max(rgb(d), zero), wp.max(rgb(s), zero), albedos(gbuffer, pixel), cap,
                wp.min(cap, specular_frames))
            if m.length < SPATIAL_FRAMES:
                around = spatial_deviation(views, gbuffer, width, height, pixel, diffuse, specular)
                if m.changed == 0:
                    around = wp.max(around, wp.vec2(m.moments[0], m.moments[1]))
                m.moments[0] = around[0]
                m.moments[1] = around[1]
        elif view.light_age < EDIT_FRAMES:
            m.length *= SKIPPED_SHARE
    history_out.diffuse[pixel] = pack_mean(m.diffuse)
    history_out.specular[pixel] = pack_mean(m.specular)
    history_out.moments[pixel] = pack_halves(m.moments)
    history_out.albedo[pixel] = pack_unorm16(m.albedo[0], m.albedo[1])
    history_out.length[pixel] = wp.float16(wp.where(m.changed == 1, -m.length, m.length))
    error = wp.vec2(-1.0, -1.0)
    if m.length > 0.0:
        error = wp.vec2(m.moments[0], m.moments[1]) * wp.sqrt(1.0 / m.length)
    diffuse_out[pixel] = pack_halves(rgba(m.diffuse, error[0]))
    specular_out[pixel] = pack_halves(rgba(m.specular, error[1]))
