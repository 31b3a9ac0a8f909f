# SPDX-License-Identifier: GPL-3.0-or-later
"""Spatial half of the direct light's denoiser: the a-trous filter (SVGF, Schied et al. 2017, section 4.3).

3x3 taps (1, 2, 1) at strides 1, 2, 4. A tap counts as far as its light differs from the centre's by no more than the
errors of both explain; the errors of the means shrink with their length, so at rest the blur vanishes with the noise.
Unlike the published filter, this one exchanges light instead of averaging it: what weights leave over stays with the
centre, and the weights are the same seen from either pixel. So rare bright samples lose only what others gain.
"""

from __future__ import annotations

import warp as wp

from .direct_temporal import FAST_FRAMES, DirectHistory
from .filter_weights import PixelPlane, brightness, pixel_plane, plane_weight, power_32
from .gbuffer import GBuffer
from .long_mean import pack_mean
from .packing import from_half, rgb, rgba, to_half, unpack_normal
from .view import SKY_DEPTH, View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Standard deviations of a difference that still counts as noise (SVGF's sigma_l).
DEVIATIONS = wp.constant(4.0)
# Relative difference of short and long mean that is always taken for noise.
MARGIN = wp.constant(0.04)
# Standard errors by which means must differ for a change to be seen, and for one that was seen to go on.
CHANGE_DEVIATIONS = wp.constant(2.5)
CHANGING_DEVIATIONS = wp.constant(1.0)
# Frames from which on the history takes nothing from the filter any more, so that its limit has no bias.
FEEDBACK_FRAMES = wp.constant(5.0)
# Frames at rest after which changes are no longer looked for: what looks like one is chance.
REST_FRAMES = wp.constant(16.0)


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


@wp.func
def noise_weight(p: wp.vec4, q: wp.vec4) -> float:
    """Return how well two pixels' lights agree within their errors."""
    if p[3] < 0.0:
        return 1.0
    a = brightness(rgb(p))
    b = brightness(rgb(q))
    # The smallest width: a half-float's rounding.
    width = DEVIATIONS * wp.sqrt(p[3] * p[3] + q[3] * q[3]) + 1.0e-3 * wp.min(a, b) + 1.0e-7
    return wp.exp(-wp.abs(a - b) / width)


@wp.func
def add_tap(sums: FilterSums, value: wp.vec4, weight: float) -> FilterSums:
    """Return the sums after one tap."""
    out = sums
    out.color = sums.color + rgb(value) * weight
    out.weight = sums.weight + weight
    out.variance = sums.variance + value[3] * value[3] * weight * weight
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
def tap_geometry(
    gbuffer: GBuffer, plane: PixelPlane, normal: wp.vec3, pixel: int, width: int, height: int, dx: int, dy: int,
) -> float:
    """Return the weight of a tap by its surface alone, 0 outside the picture."""
    x = pixel % width + dx
    y = pixel // width + dy
    if x < 0 or x >= width or y < 0 or y >= height:
        return 0.0
    q = y * width + x
    w = plane_weight(plane, dx, dy, gbuffer.depth[q])
    if w > 0.0:
        w *= power_32(wp.dot(normal, unpack_normal(gbuffer.normal[q])))
    return w


@wp.func
def filter_pair(
    view: View, gbuffer: GBuffer, width: int, height: int, stride: int, pixel: int, diffuse: wp.array[wp.vec4h],
    specular: wp.array[wp.vec4h],
) -> LightPair:
    """Return both lights after one pass of the filter."""
    centre = LightPair()
    centre.diffuse = from_half(diffuse[pixel])
    centre.specular = from_half(specular[pixel])
    plane = pixel_plane(view, gbuffer, width, pixel)
    normal = unpack_normal(gbuffer.normal[pixel])
    d = FilterSums()
    s = FilterSums()
    index = int(0)
    while index < 9:
        i = index % 3 - 1
        j = index // 3 - 1
        index += 1
        w = tap_geometry(gbuffer, plane, normal, pixel, width, height, i * stride, j * stride)
        if w > 0.0 and (i != 0 or j != 0):
            q = pixel + (j * width + i) * stride
            tap_d = from_half(diffuse[q])
            tap_s = from_half(specular[q])
            # (1, 2, 1) / 4 both ways
            w *= wp.where(i == 0, 0.5, 0.25) * wp.where(j == 0, 0.5, 0.25)
            if tap_d[3] >= 0.0:
                d = add_tap(d, tap_d, w * noise_weight(centre.diffuse, tap_d))
                s = add_tap(s, tap_s, w * noise_weight(centre.specular, tap_s))
    out = LightPair()
    out.diffuse = filtered(d, centre.diffuse)
    out.specular = filtered(s, centre.specular)
    return out


@wp.func
def change_score(sums: wp.vec4, scale: float, threshold: float) -> float:
    """Return 0..1: by how many standard errors more than the threshold short and long mean differ, halved.

    Args:
        sums: Weighted sums of the difference, its square, the short mean's variance, and the light.
        scale: 1 / sum of the weights.
        threshold: In standard errors.
    """
    difference = sums[0] * scale
    spread = wp.max(sums[1] * scale - difference * difference, sums[2] * scale)
    light = sums[3] * scale
    error = wp.sqrt(spread / 9.0 + MARGIN * MARGIN * light * light) + 1.0e-7
    return wp.clamp((wp.abs(difference) / error - threshold) * 0.5, 0.0, 1.0)


@wp.func
def light_change(
    view: View, gbuffer: GBuffer, width: int, height: int, pixel: int, diffuse: wp.array[wp.vec4h],
    specular: wp.array[wp.vec4h], moments: wp.array[wp.vec4h], threshold: float,
) -> float:
    """Return 0..1: whether the light at a pixel has changed, by short against long means over 3x3 pixels.

    Over one pixel alone the first hit of a rarely seen lamp would look like a change, and so would its absence.
    """
    plane = pixel_plane(view, gbuffer, width, pixel)
    normal = unpack_normal(gbuffer.normal[pixel])
    d = wp.vec4(0.0, 0.0, 0.0, 0.0)
    s = wp.vec4(0.0, 0.0, 0.0, 0.0)
    total = float(0.0)
    # Variance of the short mean for that of a sample.
    fast = 1.0 / (2.0 * FAST_FRAMES - 1.0)
    index = int(0)
    while index < 9:
        i = index % 3 - 1
        j = index // 3 - 1
        index += 1
        w = tap_geometry(gbuffer, plane, normal, pixel, width, height, i, j)
        if w > 0.0:
            q = pixel + j * width + i
            tap_d = from_half(diffuse[q])
            if tap_d[3] >= 0.0:
                long_d = brightness(rgb(tap_d))
                long_s = brightness(rgb(from_half(specular[q])))
                m = from_half(moments[q])
                change_d = m[2] - long_d
                change_s = m[3] - long_s
                total += w
                d += wp.vec4(change_d, change_d * change_d, m[0] * m[0] * fast, wp.max(m[2], long_d)) * w
                s += wp.vec4(change_s, change_s * change_s, m[1] * m[1] * fast, wp.max(m[3], long_s)) * w
    if total < 1.0e-6:
        return 0.0
    return wp.max(change_score(d, 1.0 / total, threshold), change_score(s, 1.0 / total, threshold))


@wp.kernel
def filter_direct_first(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    width: int,
    height: int,
    filtering: int,
    last: int,
    diffuse: wp.array[wp.vec4h],
    specular: wp.array[wp.vec4h],
    # Out:
    diffuse_out: wp.array[wp.vec4h],
    specular_out: wp.array[wp.vec4h],
    history_out: DirectHistory,
):
    """First pass of the a-trous filter, which also finds changes and feeds short histories (SVGF, section 4.1).

    Banded over pixels; of `history_out` only the own pixel's means and length are changed, and neighbours' moments
    read. 64 bytes a pixel: 46 read (surface 12, light 16, moments 8, length 2; nine pixels, cached), 18 written; 16
    more where the history is short.

    In detail:
        first: Of the band.
        filtering: 0: only look for changes.
        last: 1: nothing follows; w becomes 1 where light is known, else 0.
        diffuse: Mean and its standard deviation, as accumulate_direct writes it.
        specular: Like `diffuse`.
    """
    pixel = first + wp.tid()
    view = views[0]
    light = LightPair()
    light.diffuse = from_half(diffuse[pixel])
    light.specular = from_half(specular[pixel])
    if gbuffer.depth[pixel] < SKY_DEPTH:
        signed_length = float(history_out.length[pixel])
        length = wp.abs(signed_length)
        if filtering == 1:
            unfiltered = light
            light = filter_pair(view, gbuffer, width, height, 1, pixel, diffuse, specular)
            share = 1.0 - (length - 1.0) / (FEEDBACK_FRAMES - 1.0)
            if length > 0.0 and share > 0.0:
                history_out.diffuse[pixel] = pack_mean(
                    wp.lerp(rgb(unfiltered.diffuse), rgb(light.diffuse), wp.min(share, 1.0)))
                history_out.specular[pixel] = pack_mean(
                    wp.lerp(rgb(unfiltered.specular), rgb(light.specular), wp.min(share, 1.0)))
        moving = 1.0 - float(view.rest) / REST_FRAMES
        if length > 0.0 and moving > 0.0:
            threshold = wp.where(signed_length < 0.0, CHANGING_DEVIATIONS, CHANGE_DEVIATIONS)
            change = moving * light_change(
                view, gbuffer, width, height, pixel, diffuse, specular, history_out.moments, threshold)
            # Negative also marks that it goes on.
            history_out.length[pixel] = wp.float16(wp.where(change > 0.0, -1.0, 1.0) * length * (1.0 - change))
    if last == 1:
        light.diffuse[3] = wp.where(light.diffuse[3] >= 0.0, 1.0, 0.0)
        light.specular[3] = light.diffuse[3]
    diffuse_out[pixel] = to_half(light.diffuse)
    specular_out[pixel] = to_half(light.specular)


@wp.kernel
def filter_direct(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    width: int,
    height: int,
    stride: int,
    last: int,
    diffuse: wp.array[wp.vec4h],
    specular: wp.array[wp.vec4h],
    # Out:
    diffuse_out: wp.array[wp.vec4h],
    specular_out: wp.array[wp.vec4h],
):
    """Further pass of the a-trous filter (SVGF, section 4.3); banded over pixels.

    44 bytes a pixel: 28 read (surface 12, light 16; nine pixels, cached), 16 written.

    In detail:
        first: Of the band.
        stride: Between taps [px].
        last: 1: nothing follows; w becomes 1 where light is known, else 0.
        diffuse: Filtered so far; w = standard deviation.
        specular: Like `diffuse`.
    """
    pixel = first + wp.tid()
    light = LightPair()
    light.diffuse = wp.vec4(0.0, 0.0, 0.0, -1.0)
    light.specular = wp.vec4(0.0, 0.0, 0.0, -1.0)
    if gbuffer.depth[pixel] < SKY_DEPTH:
        light = filter_pair(views[0], gbuffer, width, height, stride, pixel, diffuse, specular)
    if last == 1:
        light.diffuse[3] = wp.where(light.diffuse[3] >= 0.0, 1.0, 0.0)
        light.specular[3] = light.diffuse[3]
    diffuse_out[pixel] = to_half(light.diffuse)
    specular_out[pixel] = to_half(light.specular)
