# SPDX-License-Identifier: GPL-3.0-or-later
"""The last pass of the reflections' filter, from blocks to pixels (Eto et al. 2023, section 2 and figures 6, 7 and 9).

Offsets are measured to where each block was sampled in this frame, which is what makes the filter an upscaler. A pixel
with a narrow lobe takes what lies close, a mirror only its own sample; where it has none, what there is nearby stands
in, but counts for next to nothing in the mean over frames.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, load_material
from .geometry_math import sqr
from .packed_halves import pack_halves
from .packing import rgb, rgba
from .reflection_atrous import EXPONENT_MAX, WEIGHT_NONE, gaussian, load_reflection, load_root, tap_weight
from .reflection_blocks import (
    JITTER_MAX,
    JITTER_SHIFT,
    UNKNOWN,
    FilterTap,
    ReflectionBlocks,
    ReflectionHistory,
    ReflectionLight,
    filter_centre,
    filter_roughness,
    filter_tap,
    in_grid,
    light_strength,
)
from .reflection_lobe import FilterLobe, FilterPass, angle_of_pixel, filter_lobe, known_pass, pass_sigma
from .reflection_turns import is_known
from .reflection_types import NO_SAMPLE, WAITS, ReflectionOptions, ReflectionSamples, block_of, is_sampled
from .reprojection import Reprojection
from .sampling import hash32, hash_combine, to_unit
from .view import SKY_DEPTH, View
from .wide_loads import load_view

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Least width of the kernel in sides of a block: so that it always meets samples.
SIGMA_MINIMUM = wp.constant(0.55)
# Spacing of the 3 x 3 taps in widths of the kernel, and by how much it varies from frame to frame.
TAP_SPACING = wp.constant(1.2)
SPACING_RANGE = wp.constant(0.6)
# Spacing [blocks] from which on the taps turn from frame to frame: closer ones would fall together.
TURN_SPACING = wp.constant(1.5)
# Steps of a two-dimensional low-discrepancy sequence (the plastic number's), for turn and spacing.
TURN_STEP = wp.constant(0.7548776662)
SPACING_STEP = wp.constant(0.5698402910)
# Distance [px^2] that a sample of another surface is put further away where none is of the same.
OTHER_SURFACE = wp.constant(1.0e4)
# Largest light that x / (1 + x) is turned back from, as a distance to 1.
COMPRESSED_MINIMUM = wp.constant(1.0e-3)


@wp.struct
class Upscaled:
    """Sums over the taps of a pixel."""

    sum: wp.vec4
    total: float
    moments: wp.vec3
    """Strength, its square, and their weight"""
    confidence: float
    nearest: int
    """Block whose sample is nearest, on the same surface if there is one"""
    nearest_square: float


@wp.func
def tap_jitter(frame: int, pixel: int, mark: int, spacing: float) -> wp.vec2i:
    """Return by how many blocks the taps of a pixel are moved: up to half their spacing where roughness varies."""
    share = float(mark >> JITTER_SHIFT) / JITTER_MAX
    bits = hash_combine(hash32(wp.uint32(pixel)), wp.uint32(frame))
    u = to_unit(bits) - 0.5
    v = to_unit(hash32(bits)) - 0.5
    width = share * spacing
    return wp.vec2i(int(wp.round(u * width)), int(wp.round(v * width)))


@wp.func
def tap_axes(sigma: float, stride: float, frame: int) -> wp.vec2:
    """Return the step to the right of a pixel's taps [blocks]; the step up is it turned by 90 degrees.

    Wide kernels get by on 3 x 3 taps that lie elsewhere in each frame: their mean over frames is a whole kernel.
    """
    spacing = TAP_SPACING * sigma / stride
    if spacing < TURN_SPACING:
        return wp.vec2(wp.max(wp.round(spacing), 1.0), 0.0)
    u = float(frame & 1023) * SPACING_STEP
    spacing = wp.max(spacing * (1.0 + SPACING_RANGE * (u - wp.floor(u) - 0.5)), TURN_SPACING)
    v = float(frame & 1023) * TURN_STEP
    turn = 1.57079633 * (v - wp.floor(v))
    return wp.vec2(spacing * wp.cos(turn), spacing * wp.sin(turn))


@wp.func
def sample_rate(options: ReflectionOptions, lobe: FilterLobe) -> float:
    """Return how much of a sample of its own a frame brings a pixel on average: one in its turn, less from others."""
    places = float(options.stride * options.stride)
    moved = angle_of_pixel(lobe, lobe.closeness) * float(options.stride) / (2.0 * lobe.spread * lobe.reach)
    overlap = wp.exp(-wp.min(moved * moved, EXPONENT_MAX))
    return wp.lerp(1.0 / places, 1.0, overlap)


@wp.func
def expanded(part: FilterPass, light: wp.vec4) -> wp.vec4:
    """Return light as it was before the first pass compressed it."""
    if part.ratio == 1:
        return light
    color = rgb(light)
    rest = wp.max(
        wp.vec3(1.0, 1.0, 1.0) - color, wp.vec3(COMPRESSED_MINIMUM, COMPRESSED_MINIMUM, COMPRESSED_MINIMUM))
    return rgba(wp.cw_div(color, rest), light[3])


@wp.func
def add_block(
    sums: Upscaled, tap: FilterTap, known: bool, value: wp.vec4, root: float, w: wp.vec2, distance: float,
) -> Upscaled:
    """Return the sums after one block.

    In detail:
        known: Whether its light means anything; else nothing is added.
        value: Its light.
        root: Root mean square of its strength.
        w: As tap_weight gives it.
        distance: Weight by the distance on the film.
    """
    out = sums
    share = wp.where(known, distance, 0.0)
    apart = float(tap.dx * tap.dx + tap.dy * tap.dy) + wp.where(tap.near > 0.0, 0.0, OTHER_SURFACE)
    if known and apart < sums.nearest_square:
        out.nearest_square = apart
        out.nearest = tap.block
    weight = wp.where(tap.near > 0.0, w[0] * share, 0.0)
    out.sum = sums.sum + value * weight
    out.total = sums.total + weight
    out.confidence = wp.max(sums.confidence, wp.where(known and tap.near > 0.0, w[1], 0.0))
    out.moments = sums.moments + wp.vec3(light_strength(rgb(value)), root * root, 1.0) * (share * tap.near)
    return out


@wp.func
def around(part: FilterPass, moments: wp.vec3, light: wp.vec4) -> wp.vec2:
    """Return standard deviation and mean of the strength around: of the surface, not of the lobe alone."""
    if moments[2] <= 0.0:
        return wp.vec2(0.0, light_strength(rgb(expanded(part, light))))
    mean = moments[0] / moments[2]
    deviation = wp.sqrt(wp.max(moments[1] / moments[2] - mean * mean, 0.0))
    if part.ratio == 1:
        return wp.vec2(deviation, mean)
    rest = wp.max(1.0 - mean, COMPRESSED_MINIMUM)
    return wp.vec2(deviation / sqr(rest), mean / rest)


@wp.func
def upscale_pixel(
    views: wp.array[View], gbuffer: GBuffer, options: ReflectionOptions, part: FilterPass, samples: ReflectionSamples,
    blocks: ReflectionBlocks, lights: ReflectionLight, history: ReflectionHistory, reprojection: Reprojection,
    pixel: int, lights_out: ReflectionLight,
):
    """Filter the light of blocks into one pixel, where they reflect; as kernels below do with a band of them."""
    home = block_of(options, pixel)
    place = samples.place[home]
    if place == NO_SAMPLE:
        return
    light = wp.vec4(0.0, 0.0, 0.0, 0.0)
    state = wp.vec4(0.0, UNKNOWN, 0.0, 0.0)
    if place == WAITS:
        if is_known(options, history, reprojection, pixel):
            lights_out.light[pixel] = pack_halves(light)
            lights_out.state[pixel] = pack_halves(state)
            return
    m = load_material(gbuffer, pixel)
    if gbuffer.depth[pixel] < SKY_DEPTH and is_sampled(options, m):
        view = load_view(views)
        centre = filter_centre(view, gbuffer, options.width, pixel, gbuffer.normal[pixel], filter_roughness(options, m))
        lobe = filter_lobe(view, gbuffer, options, part, history, centre, float(blocks.closeness[home]))
        stride = float(options.stride)
        sigma = wp.max(pass_sigma(options, part, lobe), SIGMA_MINIMUM * stride)
        right = tap_axes(sigma, stride, view.frame)
        column = home % options.columns
        row = home // options.columns
        moved = wp.vec2i(0, 0)
        mark = int(blocks.mark[home])
        if part.jitter == 1 and (mark >> JITTER_SHIFT) != 0:
            moved = tap_jitter(view.frame, pixel, mark, wp.length(right) - 1.0)
        found = Upscaled()
        found.nearest = -1
        found.nearest_square = 1.0e9
        i = int(-1)
        j = int(-1)
        while j <= 1:
            tap_column = column
            tap_row = row
            if i != 0 or j != 0:
                # The pixel's own block is always among the taps.
                tap_column += moved[0] + int(wp.floor(float(i) * right[0] - float(j) * right[1] + 0.5))
                tap_row += moved[1] + int(wp.floor(float(i) * right[1] + float(j) * right[0] + 0.5))
            if in_grid(options, tap_column, tap_row):
                tap = filter_tap(options, blocks, lights, centre, tap_column, tap_row)
                # After other passes without a branch, so that all that is read of a tap is waited for together.
                known = tap.confidence >= 0.0
                if known or part.first == 0:
                    value = load_reflection(part, lights, tap.block)
                    w = wp.vec2(0.0, 0.0)
                    if tap.near > 0.0 or part.first == 0:
                        w = tap_weight(view, options, part, samples, centre, lobe, tap, value[3])
                    found = add_block(found, tap, known, value, load_root(part, tap.root), w, gaussian(tap, sigma))
            i += 1
            if i > 1:
                i = -1
                j += 1
        if found.total > WEIGHT_NONE:
            light = found.sum / found.total
            state[1] = found.confidence
        elif found.nearest >= 0:
            light = load_reflection(part, lights, found.nearest)
            state[1] = 0.0
        apart = around(part, found.moments, light)
        state[0] = apart[0]
        state[2] = apart[1]
        state[3] = sample_rate(options, lobe)
        light = expanded(part, light)
    lights_out.light[pixel] = pack_halves(light)
    lights_out.state[pixel] = pack_halves(state)


@wp.kernel(cuda_max_registers=80)
def upscale_samples(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    options: ReflectionOptions,
    part: FilterPass,
    samples: ReflectionSamples,
    blocks: ReflectionBlocks,
    lights: ReflectionLight,
    history: ReflectionHistory,
    reprojection: Reprojection,
    # Out:
    lights_out: ReflectionLight,
):
    """Filter the light of blocks into pixels; banded over pixels. Of those that wait nothing is known (UNKNOWN).

    Where nothing in a block reflects nothing is written.

    60 bytes a pixel that reflects: 44 read (surface and material 36, its share of the blocks 8; the taps are cached),
    16 written; 8 more are read at rest. 9 taps.

    In detail:
        history: Of the frame before; at rest it tells how far away is what is reflected.
    """
    upscale_pixel(
        views, gbuffer, options, part, samples, blocks, lights, history, reprojection, first + wp.tid(), lights_out)


@wp.kernel(cuda_max_registers=64)
def upscale_blocks(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    options: ReflectionOptions,
    part: FilterPass,
    samples: ReflectionSamples,
    blocks: ReflectionBlocks,
    lights: ReflectionLight,
    history: ReflectionHistory,
    reprojection: Reprojection,
    # Out:
    lights_out: ReflectionLight,
):
    """Do the same after other passes that weigh by ratios."""
    upscale_pixel(
        views, gbuffer, options, known_pass(part, 0), samples, blocks, lights, history, reprojection,
        first + wp.tid(), lights_out)
