# SPDX-License-Identifier: GPL-3.0-or-later
"""Spatial half of the direct light's denoiser: the a-trous filter (SVGF, Schied et al. 2017, section 4.3).

Four taps a pass: the neighbours at first, then at strides 2, 4 ... on a grid turned against the pixels' so that they
fall between those of before: nearly as wide a blur as of 3x3 for half the reads. A tap counts as far as its light
differs from the centre's by no more than the errors of both explain; the errors of the means shrink with their length,
so at rest the blur vanishes with the noise. Unlike the published filter, this one exchanges light instead of averaging
it: what weights leave over stays with the centre, and the weights are the same seen from either pixel. So rare bright
samples lose only what others gain.
"""

from __future__ import annotations

import warp as wp

from .direct_temporal import FAST_FRAMES, DirectHistory, change_terms, standard_errors
from .filter_weights import (
    PixelPlane,
    brightness,
    inside,
    pixel_plane,
    roughness_weight,
    sharp_normal_weight,
    squared_cosine,
    surface_weight,
    unit_normal,
)
from .gbuffer import GBuffer
from .geometry_math import sqr
from .long_mean import pack_mean
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba
from .view import SKY_DEPTH, View
from .wide_loads import load_view

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Standard deviation of the weight's Gaussian, in those of a difference that is noise (SVGF's sigma_l, of a Gaussian:
# the published exponential blurs the edges of shadows more for as little noise).
DEVIATIONS = wp.constant(1.75)
# Over which changes are found: a pixel and its neighbours.
PIXELS = wp.constant(5.0)
# Relative difference of short and long mean that is always taken for noise.
MARGIN = wp.constant(0.04)
# Relative difference that is always taken for noise: a half-float's rounding.
ROUNDING = wp.constant(1.0e-3)
# Standard errors by which means must differ for a change to be seen, and for one that was seen to go on.
CHANGE_DEVIATIONS = wp.constant(2.5)
CHANGING_DEVIATIONS = wp.constant(1.0)
# Frames from which on the history takes nothing from the filter any more, so that its limit has no bias.
FEEDBACK_FRAMES = wp.constant(5.0)
# Frames at rest between which the blur fades: what noise is left by then is the average's to remove.
BLUR_START = wp.constant(32.0)
BLUR_END = wp.constant(96.0)

# Frames at rest after which changes are no longer looked for: what looks like one is chance.
REST_FRAMES = wp.constant(16.0)
# Weight of each of four taps: on the turned grids it gives their blur the variance of (1, 2, 1) both ways.
TAP_WEIGHT = wp.constant(0.2)


@wp.struct
class LightPair:
    """Diffuse and specular light of one pixel; w = standard deviation of the luminance, -1 where nothing is known."""

    diffuse: wp.vec4
    specular: wp.vec4


@wp.struct
class FilterSums:
    """Sums over the taps of one signal, the centre left out."""

    color: wp.vec3
    weight: float
    variance: float


@wp.struct
class PairSums:
    """Sums over the taps of both signals."""

    diffuse: FilterSums
    specular: FilterSums


@wp.struct
class ChangeSums:
    """Weighted sums over the taps by which changes are found."""

    diffuse: wp.vec4
    """change_terms of the short and the long mean"""
    specular: wp.vec4
    weight: float


@wp.func
def noise_weight(a: float, a_variance: float, b: float, b_error: float) -> float:
    """Return how well the luminances of two pixels agree within their errors.

    In detail:
        a_variance: As own_variance gives it.
        b_error: Standard deviation.
    """
    # The smallest width: a half-float's rounding.
    rounding = ROUNDING * wp.min(a, b) + 1.0e-7
    width = (a_variance + b_error * b_error) * (2.0 * DEVIATIONS * DEVIATIONS) + rounding * rounding
    return wp.exp(-sqr(a - b) / width)


@wp.func
def own_variance(light: wp.vec4) -> float:
    """Return the variance of a pixel's luminance, so large that it agrees with any where nothing is known."""
    return wp.where(light[3] < 0.0, 1.0e20, light[3] * light[3])


@wp.func
def add_tap(sums: FilterSums, value: wp.vec4, weight: float) -> FilterSums:
    """Return the sums after one tap."""
    out = sums
    error = value[3] * weight
    out.color = sums.color + rgb(value) * weight
    out.weight = sums.weight + weight
    out.variance = sums.variance + error * error
    return out


@wp.func
def filtered(sums: FilterSums, centre: wp.vec4) -> wp.vec4:
    """Return the light and its error after the exchange; without own light the taps' mean."""
    if centre[3] >= 0.0:
        rest = wp.max(1.0 - sums.weight, 0.0)
        return rgba(
            rgb(centre) * rest + sums.color, wp.sqrt(sums.variance + rest * rest * centre[3] * centre[3]))
    if sums.weight < 1.0e-6:
        return centre
    scale = 1.0 / sums.weight
    return rgba(sums.color * scale, wp.sqrt(sums.variance) * scale)


@wp.func
def add_pair(sums: PairSums, centre: LightPair, tap: LightPair, weight: float, alike: float) -> PairSums:
    """Return the sums after one tap; each signal is weighed by its own noise, specular light by `alike` too."""
    out = sums
    out.diffuse = add_tap(sums.diffuse, tap.diffuse, weight * noise_weight(
        brightness(rgb(centre.diffuse)), own_variance(centre.diffuse), brightness(rgb(tap.diffuse)), tap.diffuse[3]))
    out.specular = add_tap(sums.specular, tap.specular, weight * alike * noise_weight(
        brightness(rgb(centre.specular)), own_variance(centre.specular), brightness(rgb(tap.specular)),
        tap.specular[3]))
    return out


@wp.func
def filtered_pair(sums: PairSums, centre: LightPair) -> LightPair:
    """Return both lights after the exchange."""
    out = LightPair()
    out.diffuse = filtered(sums.diffuse, centre.diffuse)
    out.specular = filtered(sums.specular, centre.specular)
    return out


@wp.func
def finished(light: LightPair, last: int) -> LightPair:
    """Return the light as it is handed on: after the last pass w = 1 where light is known, else 0."""
    out = light
    if last == 1:
        out.diffuse[3] = wp.where(light.diffuse[3] >= 0.0, 1.0, 0.0)
        out.specular[3] = out.diffuse[3]
    return out


@wp.func
def tap_offset(index: int, stride: int, turn: int) -> wp.vec2i:
    """Return where one of the four taps is [px]: (stride, turn), turned by a quarter each time."""
    along = stride if index % 2 == 0 else -turn
    across = turn if index % 2 == 0 else stride
    return wp.vec2i(along if index < 2 else -along, across if index < 2 else -across)


@wp.func
def near_pixel(x: int, y: int, width: int, height: int) -> int:
    """Return the pixel at a place, or the one closest to it in the picture."""
    return wp.clamp(y, 0, height - 1) * width + wp.clamp(x, 0, width - 1)


@wp.func
def geometry_weight(
    gbuffer: GBuffer, plane: PixelPlane, normal: wp.vec3, own: wp.uint32, q: int, dx: int, dy: int,
) -> float:
    """Return the weight of a tap (dx, dy) away by its surface alone.

    In detail:
        normal: Of the centre.
        own: The same, packed.
    """
    w = surface_weight(plane, dx, dy, gbuffer.depth[q])
    packed = gbuffer.normal[q]
    # Most surfaces are flat, and so are all pixels of most warps.
    if packed != own:
        w *= sharp_normal_weight(squared_cosine(normal, packed))
    return w


@wp.func
def load_light(diffuse: wp.array[wp.uint64], specular: wp.array[wp.uint64], pixel: int) -> LightPair:
    """Return both lights of a pixel."""
    light = LightPair()
    light.diffuse = unpack_halves(diffuse[pixel])
    light.specular = unpack_halves(specular[pixel])
    return light


@wp.func
def add_change(sums: ChangeSums, light: LightPair, moments: wp.vec4, weight: float) -> ChangeSums:
    """Return the sums after one pixel."""
    out = sums
    # Variance of the short mean for that of a sample.
    fast = 1.0 / (2.0 * FAST_FRAMES - 1.0)
    out.diffuse = sums.diffuse + change_terms(
        moments[2], brightness(rgb(light.diffuse)), moments[0] * moments[0] * fast) * weight
    out.specular = sums.specular + change_terms(
        moments[3], brightness(rgb(light.specular)), moments[1] * moments[1] * fast) * weight
    out.weight = sums.weight + weight
    return out


@wp.func
def blur_strength(view: View) -> float:
    """Return the share of the blur that is left at rest: none in the end, or shadows would stay a little softer."""
    return wp.clamp((BLUR_END - float(view.rest)) / (BLUR_END - BLUR_START), 0.0, 1.0)


@wp.func
def change_score(sums: wp.vec4, scale: float, threshold: float) -> float:
    """Return 0..1: by how many standard errors more than the threshold short and long mean differ, halved.

    Args:
        sums: As in ChangeSums.
        scale: 1 / sum of the weights.
        threshold: In standard errors.
    """
    return wp.clamp((standard_errors(sums, scale, PIXELS, MARGIN) - threshold) * 0.5, 0.0, 1.0)


@wp.kernel(cuda_max_registers=80)
def filter_direct_first(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    width: int,
    height: int,
    filtering: int,
    last: int,
    diffuse: wp.array[wp.uint64],
    specular: wp.array[wp.uint64],
    # Out:
    diffuse_out: wp.array[wp.uint64],
    specular_out: wp.array[wp.uint64],
    history_out: DirectHistory,
):
    """First pass of the a-trous filter, which also finds changes and feeds short histories (SVGF, section 4.1).

    Changes are found by short against long means over the pixel and its neighbours: over one alone the first hit of a
    rarely seen lamp would look like a change, and so would its absence.
    Banded over pixels; of `history_out` only the own pixel's means and length are changed. 68 bytes a pixel: 50 read
    (surface 16, light 16, moments 8, length 2; five pixels, cached), 18 written; 16 more where the history is short.

    In detail:
        filtering: 0: light is passed on as it is; only look for changes.
        last: 1: nothing follows; w becomes 1 where light is known, else 0.
        diffuse: pack_halves of mean and standard deviation, as accumulate_direct writes it.
        specular: Like `diffuse`.
    """
    pixel = first + wp.tid()
    light = load_light(diffuse, specular, pixel)
    if gbuffer.depth[pixel] < SKY_DEPTH:
        view = load_view(views)
        signed_length = float(history_out.length[pixel])
        length = wp.abs(signed_length)
        moving = 1.0 - float(view.rest) / REST_FRAMES
        blur = blur_strength(view)
        plane = pixel_plane(view, gbuffer, width, pixel)
        own = gbuffer.normal[pixel]
        material = gbuffer.material[pixel]
        normal = unit_normal(own)
        x = pixel % width
        y = pixel // width
        sums = PairSums()
        change = ChangeSums()
        if moving > 0.0 and light.diffuse[3] >= 0.0:
            change = add_change(change, light, unpack_halves(history_out.moments[pixel]), 1.0)
        for index in range(4):
            offset = tap_offset(index, 1, 0)
            q = near_pixel(x + offset[0], y + offset[1], width, height)
            w = geometry_weight(gbuffer, plane, normal, own, q, offset[0], offset[1])
            tap = load_light(diffuse, specular, q)
            if not inside(x + offset[0], y + offset[1], width, height) or tap.diffuse[3] < 0.0:
                w = float(0.0)
            sums = add_pair(
                sums, light, tap, w * blur * TAP_WEIGHT, roughness_weight(material, gbuffer.material[q]))
            if moving > 0.0:
                change = add_change(change, tap, unpack_halves(history_out.moments[q]), w)
        if filtering == 1:
            unfiltered = light
            light = filtered_pair(sums, unfiltered)
            short = 1.0 - (length - 1.0) / (FEEDBACK_FRAMES - 1.0)
            if length > 0.0 and short > 0.0:
                history_out.diffuse[pixel] = pack_mean(
                    wp.lerp(rgb(unfiltered.diffuse), rgb(light.diffuse), wp.min(short, 1.0)))
                history_out.specular[pixel] = pack_mean(
                    wp.lerp(rgb(unfiltered.specular), rgb(light.specular), wp.min(short, 1.0)))
        if length > 0.0 and moving > 0.0 and change.weight > 1.0e-6:
            threshold = wp.where(signed_length < 0.0, CHANGING_DEVIATIONS, CHANGE_DEVIATIONS)
            scale = 1.0 / change.weight
            changed = moving * wp.max(
                change_score(change.diffuse, scale, threshold), change_score(change.specular, scale, threshold))
            # Negative also marks that it goes on.
            history_out.length[pixel] = wp.float16(wp.where(changed > 0.0, -1.0, 1.0) * length * (1.0 - changed))
    light = finished(light, last)
    diffuse_out[pixel] = pack_halves(light.diffuse)
    specular_out[pixel] = pack_halves(light.specular)


@wp.kernel(cuda_max_registers=64)
def filter_direct(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    width: int,
    height: int,
    stride: int,
    turn: int,
    last: int,
    diffuse: wp.array[wp.uint64],
    specular: wp.array[wp.uint64],
    # Out:
    diffuse_out: wp.array[wp.uint64],
    specular_out: wp.array[wp.uint64],
):
    """Further pass of the a-trous filter (SVGF, section 4.3); banded over pixels.

    48 bytes a pixel: 32 read (surface 16, light 16; five pixels, cached), 16 written.

    In detail:
        first: Of the band.
        stride: Between taps along one axis [px]; even.
        turn: Half of it or its negative: along the other axis.
        last: 1: nothing follows; w becomes 1 where light is known, else 0.
        diffuse: pack_halves of what is filtered so far; w = standard deviation.
        specular: Like `diffuse`.
    """
    pixel = first + wp.tid()
    light = LightPair()
    light.diffuse = wp.vec4(0.0, 0.0, 0.0, -1.0)
    light.specular = wp.vec4(0.0, 0.0, 0.0, -1.0)
    if gbuffer.depth[pixel] < SKY_DEPTH:
        centre = load_light(diffuse, specular, pixel)
        view = load_view(views)
        plane = pixel_plane(view, gbuffer, width, pixel)
        own = gbuffer.normal[pixel]
        material = gbuffer.material[pixel]
        normal = unit_normal(own)
        blur = TAP_WEIGHT * blur_strength(view)
        x = pixel % width
        y = pixel // width
        sums = PairSums()
        for index in range(4):
            offset = tap_offset(index, stride, turn)
            q = near_pixel(x + offset[0], y + offset[1], width, height)
            w = geometry_weight(gbuffer, plane, normal, own, q, offset[0], offset[1]) * blur
            tap = load_light(diffuse, specular, q)
            if not inside(x + offset[0], y + offset[1], width, height) or tap.diffuse[3] < 0.0:
                w = float(0.0)
            sums = add_pair(sums, centre, tap, w, roughness_weight(material, gbuffer.material[q]))
        light = filtered_pair(sums, centre)
    light = finished(light, last)
    diffuse_out[pixel] = pack_halves(light.diffuse)
    specular_out[pixel] = pack_halves(light.specular)
