# SPDX-License-Identifier: GPL-3.0-or-later
"""Means of what hair shows, over frames and neighbours, and how they come into the picture.

Strands are about as wide as pixels or narrower, and which ones a pixel shows is chance in each frame: neither depths
nor normals tell what belongs together. So all pixels that show hair share their history, whatever strand it was, and
pixels that show something else between strands keep it for the strands that come after it.
"""

from __future__ import annotations

import warp as wp

from .composite import light_or_none
from .gbuffer import GBuffer
from .geometry_math import PI, is_finite3
from .long_mean import (
    EDIT_FRAMES,
    SHARP,
    TAP_MINIMUM,
    Between,
    gather_cubic,
    history_cap,
    off_centre,
    pack_mean,
    place_between,
    tap_weights,
    unpack_mean,
)
from .packed_halves import unpack_halves
from .packing import HALF_MAX, from_half, rgb, rgba, to_half
from .paths import Paths
from .reflection_blocks import light_strength
from .reflection_rays import ReflectionRays
from .reflection_types import ReflectionOptions, ReflectionSamples, block_of, sample_pixel
from .reprojection import Reprojection
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Frames that a mean holds in motion, and the fewest samples, of which a pixel of a block has one in its turn.
FRAMES = wp.constant(32.0)
LEAST_SAMPLES = wp.constant(8.0)
# Of a mean that a pixel keeps while it shows something else, in each frame.
KEPT = wp.constant(0.9)
# Samples from which on neighbours count half for sparks.
SPARK_FRAMES = wp.constant(8.0)
# Samples of a neighbour that count at most.
WELL_KNOWN = wp.constant(8.0)
# How much of a sample another pixel's one is.
GUESS = wp.constant(0.25)
# Blocks to each side whose samples tell what a spark is, and how many times their level it is.
REACH = wp.constant(2)
SPARK = wp.constant(12.0)


@wp.struct
class HairHistory:
    """What a frame leaves of the light of hair for the next: 20 bytes a pixel."""

    light: wp.array[wp.uint64]
    """pack_mean, exposed"""
    rest: wp.array[wp.uint64]
    """The same of what sparks have besides"""
    frames: wp.array[float]
    """Samples in the mean; 0: nothing is known"""


@wp.func
def sampled_light(
    view: View, options: ReflectionOptions, samples: ReflectionSamples, rays: ReflectionRays, lit: Paths, block: int,
) -> wp.vec4:
    """Return what this frame's ray has brought a block; w = 0: it had none."""
    if rays.flag[block] == 0 or not samples.pdf[block] > 0.0:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    found = rgb(unpack_halves(samples.radiance[block])) + rgb(lit.radiance[rays.rank[block] - 1]) * view.exposure
    if not is_finite3(found):
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    return rgba(wp.max(found, wp.vec3(0.0, 0.0, 0.0)), 1.0)


@wp.func
def level_around(
    view: View, options: ReflectionOptions, samples: ReflectionSamples, rays: ReflectionRays, lit: Paths, block: int,
) -> float:
    """Return how strong the samples around a block are: the square of the mean root, which few sparks lift."""
    column = block % options.columns
    row = block // options.columns
    sum = float(0.0)
    count = float(0.0)
    j = int(-REACH)
    while j <= REACH:
        i = int(-REACH)
        while i <= REACH:
            u = column + i
            v = row + j
            if u >= 0 and v >= 0 and u < options.columns and v < options.rows:
                q = v * options.columns + u
                sample = sampled_light(view, options, samples, rays, lit, q)
                if sample[3] > 0.0:
                    sum += wp.sqrt(light_strength(rgb(sample)))
                    count += 1.0
            i += 1
        j += 1
    return sum * sum / wp.max(count * count, 1.0)


@wp.struct
class HairMean:
    """The mean of one pixel."""

    light: wp.vec3
    rest: wp.vec3
    frames: float


@wp.func
def all_known(history: HairHistory, place: Between, width: int, height: int) -> bool:
    """Return whether the pixels that gather_cubic reads about its inner four know light of hair."""
    if place.left < 1 or place.low < 1 or place.left + 2 >= width or place.low + 2 >= height:
        return False
    c = place.corner
    least = wp.min(wp.min(history.frames[c - 1], history.frames[c + 2]),
                   wp.min(history.frames[c + width - 1], history.frames[c + width + 2]))
    least = wp.min(least, wp.min(history.frames[c - width], history.frames[c - width + 1]))
    least = wp.min(least, wp.min(history.frames[c + 2 * width], history.frames[c + 2 * width + 1]))
    return least > 0.0


@wp.func
def gather_hair(history: HairHistory, position: wp.vec2, width: int, height: int) -> HairMean:
    """Return what the frame before knew at a place; `frames` is 0 where it knew nothing."""
    m = HairMean()
    m.light = wp.vec3(0.0, 0.0, 0.0)
    m.rest = wp.vec3(0.0, 0.0, 0.0)
    m.frames = 0.0
    place = place_between(position, width)
    weights = tap_weights(place)
    total = float(0.0)
    known = int(0)
    for tap in range(4):
        i = place.left + (tap & 1)
        j = place.low + (tap >> 1)
        if i >= 0 and j >= 0 and i < width and j < height:
            q = j * width + i
            frames = history.frames[q]
            if frames > 0.0:
                known += 1
                m.light += unpack_mean(history.light[q]) * weights[tap]
                m.rest += unpack_mean(history.rest[q]) * weights[tap]
                m.frames += frames * weights[tap]
                total += weights[tap]
    if not total > TAP_MINIMUM:
        m.frames = 0.0
        return m
    m.light = m.light / total
    m.rest = m.rest / total
    m.frames = m.frames / total
    if known == 4 and off_centre(position):
        wide = all_known(history, place, width, height)
        m.light = gather_cubic(history.light, place, width, height, wide, SHARP)
    return m


@wp.kernel
def average_hair(
    # In:
    first: int,
    views: wp.array[View],
    options: ReflectionOptions,
    reprojection: Reprojection,
    shown: wp.array[wp.uint8],
    samples: ReflectionSamples,
    rays: ReflectionRays,
    lit: Paths,
    previous: HairHistory,
    # Out:
    history_out: HairHistory,
):
    """Add this frame's samples to the means; what is far above what is around goes to `rest`."""
    pixel = first + wp.tid()
    view = views[0]
    light = wp.vec3(0.0, 0.0, 0.0)
    rest = wp.vec3(0.0, 0.0, 0.0)
    frames = float(0.0)
    if view.restart == 0:
        known = gather_hair(previous, reprojection.position[pixel], options.width, options.height)
        light = known.light
        rest = known.rest
        frames = known.frames
    if shown[pixel] == wp.uint8(0):
        frames = frames * KEPT
        if frames < 0.1:
            frames = 0.0
    else:
        in_motion = wp.max(FRAMES / float(options.stride * options.stride), LEAST_SAMPLES)
        cap = history_cap(view.rest, view.light_age, in_motion)
        frames = wp.min(frames, cap)
        block = block_of(options, pixel)
        # After an edit of the light each frame's sample serves all of its block, so that what was before goes at once.
        own = sample_pixel(options, samples, block) == pixel or view.light_age < EDIT_FRAMES
        if own or frames < GUESS:
            sample = sampled_light(view, options, samples, rays, lit, block)
            if sample[3] > 0.0:
                level = level_around(view, options, samples, rays, lit, block)
                if frames > 0.0:
                    level = wp.max(level, light_strength(light) * wp.min(frames / 4.0, 1.0))
                share = wp.min(SPARK * level / wp.max(light_strength(rgb(sample)), 1.0e-20), 1.0)
                part = float(1.0)
                if own:
                    frames = wp.min(frames + 1.0, cap)
                    part = 1.0 / wp.max(frames, 1.0)
                else:
                    # Another one of the block stands in until the pixel has its turn.
                    frames = GUESS
                light = wp.lerp(light, rgb(sample) * share, part)
                rest = wp.lerp(rest, rgb(sample) * (1.0 - share), part)
    history_out.light[pixel] = pack_mean(light)
    history_out.rest[pixel] = pack_mean(rest)
    history_out.frames[pixel] = frames


@wp.kernel
def spread_hair(
    # In:
    first: int,
    width: int,
    height: int,
    spacing: int,
    alone: float,
    gbuffer: GBuffer,
    shown: wp.array[wp.uint8],
    frames: wp.array[float],
    light: wp.array[wp.uint64],
    rest: wp.array[wp.uint64],
    # Out:
    light_out: wp.array[wp.uint64],
    rest_out: wp.array[wp.uint64],
):
    """Average over neighbours that show the same hair: the more, the fewer frames a pixel has, of sparks always.

    Taps lie along the strand, `spacing` apart [px], and to both sides of it.
    """
    pixel = first + wp.tid()
    if shown[pixel] == wp.uint8(0):
        return
    own = gbuffer.hit[pixel][0]
    turn = (float(shown[pixel]) - 0.5) * (PI / 255.0)
    c = wp.cos(turn) * float(spacing)
    s = wp.sin(turn) * float(spacing)
    x = float(pixel % width) + 0.5
    y = float(pixel // width) + 0.5
    known = frames[pixel]
    apart = alone / wp.max(alone + known, 1.0e-6)
    part = wp.min(known, WELL_KNOWN) * 0.1875
    sum = unpack_mean(light[pixel]) * part
    total = part
    rest_sum = unpack_mean(rest[pixel]) * part
    rest_total = part
    rest_apart = SPARK_FRAMES / (SPARK_FRAMES + known)
    j = int(-1)
    while j <= 1:
        i = int(-2)
        while i <= 2:
            a = float(i)
            b = float(j)
            u = int(wp.floor(x + a * c - b * s))
            v = int(wp.floor(y + a * s + b * c))
            if (i != 0 or j != 0) and u >= 0 and v >= 0 and u < width and v < height:
                q = v * width + u
                if shown[q] != wp.uint8(0):
                    if gbuffer.hit[q][0] == own:
                        w = wp.where(i == 0, 0.375, wp.where(wp.abs(i) == 1, 0.25, 0.0625))
                        w = w * wp.where(j == 0, 0.5, 0.25) * wp.min(frames[q], WELL_KNOWN)
                        sum += unpack_mean(light[q]) * (w * apart)
                        total += w * apart
                        rest_sum += unpack_mean(rest[q]) * (w * rest_apart)
                        rest_total += w * rest_apart
            i += 1
        j += 1
    if total > 0.0:
        sum = sum / total
    else:
        sum = unpack_mean(light[pixel])
    if rest_total > 0.0:
        rest_sum = rest_sum / rest_total
    light_out[pixel] = pack_mean(sum)
    rest_out[pixel] = pack_mean(rest_sum)


@wp.kernel
def show_hair(
    # In:
    first: int,
    gbuffer: GBuffer,
    shown: wp.array[wp.uint8],
    weight: wp.array[wp.vec3],
    light: wp.array[wp.uint64],
    rest: wp.array[wp.uint64],
    # Out:
    color_out: wp.array[wp.vec4h],
):
    """Put the light of hair in the place of that of the surface; `weight`: of layers before it, or empty."""
    pixel = first + wp.tid()
    if shown[pixel] == wp.uint8(0):
        return
    c = unpack_mean(light[pixel]) + unpack_mean(rest[pixel])
    if weight.shape[0] > 0:
        c = wp.cw_mul(c, weight[pixel])
    c += light_or_none(gbuffer.emission[pixel])
    before = from_half(color_out[pixel])
    c = wp.vec3(wp.min(c[0], HALF_MAX), wp.min(c[1], HALF_MAX), wp.min(c[2], HALF_MAX))
    color_out[pixel] = to_half(rgba(c, before[3]))
