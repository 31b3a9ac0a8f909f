# SPDX-License-Identifier: GPL-3.0-or-later
"""The a-trous filter of reflections, at the resolution of the samples (Eto et al. 2023, section 2).

Weights are g * d * p: a truncated Gaussian of the distance on the film, twice as wide in each pass; the likeness of
the surfaces; and how well the sample fits the centre's lobe. Samples were already drawn from a lobe, so the first pass
weighs them by density here over density there (a ratio estimator: with the Jacobian of the reconnection, limited), in
linear light. A sample is L w_s / A_s with w = f cos / pdf and albedo A; at the centre it is worth
L f_c cos / (pdf_s A_c). As f cos / A is the density but for Fresnel and shadowing, which change little between
neighbours, that is the sample times the ratio of the densities, and sums of ratios take the place of their expectation:
exact for even light, and without the lobe's narrowing that plain densities bring.

From the second pass on a block's light is no longer that of its own direction, ratios would say nothing and the blur
would be the lobe's widening. So these passes are limited to a share of the lobe's width on the film: how far the
centre's pixel may move until the same point is seen in the lobe's flank.
"""

from __future__ import annotations

import warp as wp

from .filter_weights import unit_normal
from .gbuffer import GBuffer
from .geometry_math import sqr
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba, unpack_normal
from .reflection_blocks import (
    FilterCentre,
    FilterTap,
    ReflectionBlocks,
    ReflectionHistory,
    ReflectionLight,
    block_centre,
    block_depth,
    filter_tap,
    in_grid,
    pack_state,
    row_reach,
    state_lobe,
    unpack_state,
)
from .reflection_lobe import (
    LOBE_SIGMA,
    FilterLobe,
    FilterPass,
    angle_of_pixel,
    drawn_density,
    filter_lobe,
    known_pass,
    pass_sigma,
)
from .reflection_types import LOBE_REFLECTION, SAMPLE_FAR, ReflectionOptions, ReflectionSamples
from .specular_lobes import surface_alpha
from .view import SKY_DEPTH, View, film_position, unproject
from .wide_loads import load_view

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Largest ratio of densities: beyond it one neighbour would stand for all.
RATIO_MAX = wp.constant(4.0)
# Like BLUR_SHARE, of the directions mirrored at different normals, in each pass.
NORMAL_SHARE = wp.constant(1.0)
# Weight of what clean-up has put together from neighbours, and the least of anything in later passes.
REPLACED_SHARE = wp.constant(0.25)
WEIGHT_MINIMUM = wp.constant(0.1)
# Kernels narrower than this share of the taps' spacing hold nothing but the centre.
NARROW = wp.constant(0.25)
# Exponent beyond which a weight is as good as none, but tells near from far.
EXPONENT_MAX = wp.constant(60.0)
# Sum of weights below which there is nothing.
WEIGHT_NONE = wp.constant(1.0e-36)


@wp.func
def lobe_overlap(centre: FilterCentre, lobe: FilterLobe, tap: FilterTap) -> float:
    """Return how much alike two surfaces reflect a point: 1 for the same lobe about the same direction."""
    moved = angle_of_pixel(lobe, lobe.closeness) / (lobe.spread * lobe.reach)
    square = float(tap.dx * tap.dx + tap.dy * tap.dy) * sqr(moved)
    alike = float(1.0)
    # Even surfaces are the most, and all threads of a warp lie on the same.
    if tap.roughness != centre.roughness:
        alpha = surface_alpha(centre.roughness)
        other = surface_alpha(tap.roughness)
        alike = sqr(2.0 * alpha * other / (alpha * alpha + other * other))
    if tap.normal != centre.packed:
        # Mirrored directions turn by twice the angle of the normals.
        turned = 2.0 / (NORMAL_SHARE * LOBE_SIGMA * surface_alpha(centre.roughness) * lobe.reach)
        bend = unit_normal(tap.normal) - centre.normal
        square += wp.dot(bend, bend) * sqr(turned)
    return alike * wp.exp(-wp.min(0.5 * square, EXPONENT_MAX))


@wp.func
def tap_direction(
    view: View, samples: ReflectionSamples, centre: FilterCentre, lobe: FilterLobe, tap: FilterTap, closeness: float,
) -> wp.vec4:
    """Return the direction from a centre to what a block's sample hit; w = Jacobian of the reconnection.

    The Jacobian is that of the solid angles, the block's over the centre's, for a hit that faces both.
    """
    direction = unpack_normal(samples.direction[tap.block])
    if closeness * SAMPLE_FAR < 1.01 or (tap.dx == 0 and tap.dy == 0):
        return rgba(direction, 1.0)
    other = unproject(view.camera, film_position(view, centre.x + tap.dx, centre.y + tap.dy), tap.depth)
    apart = (other - lobe.position) * closeness + direction
    square = wp.max(wp.dot(apart, apart), 1.0e-12)
    return rgba(apart * (1.0 / wp.sqrt(square)), square)


@wp.func
def tap_weight(
    view: View, options: ReflectionOptions, part: FilterPass, samples: ReflectionSamples,
    centre: FilterCentre, lobe: FilterLobe, tap: FilterTap, closeness: float,
) -> wp.vec2:
    """Return d * p of a block, and how much of a sample of its own it is for the centre.

    `closeness` is that of its own sample.
    """
    own = tap.dx == 0 and tap.dy == 0
    confidence = tap.confidence
    if part.ratio == 0:
        if confidence == 0.0 or options.lobe != LOBE_REFLECTION:
            return wp.vec2(tap.near, tap.near)
        to_hit = tap_direction(view, samples, centre, lobe, tap, closeness)
        return wp.vec2(tap.near * drawn_density(lobe, rgb(to_hit)) / lobe.peak, tap.near)
    match = tap.near
    if not own:
        match *= lobe_overlap(centre, lobe, tap)
    if part.first == 0:
        return wp.vec2(match * wp.max(confidence, WEIGHT_MINIMUM), match * confidence)
    if confidence == 0.0:
        return wp.vec2(match * REPLACED_SHARE, 0.0)
    if own or options.lobe != LOBE_REFLECTION:
        return wp.vec2(match, match)
    to_hit = tap_direction(view, samples, centre, lobe, tap, closeness)
    ratio = drawn_density(lobe, rgb(to_hit)) / (samples.pdf[tap.block] * to_hit[3])
    return wp.vec2(tap.near * wp.min(ratio, RATIO_MAX), match)


@wp.func
def load_reflection(part: FilterPass, lights: ReflectionLight, block: int) -> wp.vec4:
    """Return a block's light as it is averaged; w = closeness of the hit."""
    light = unpack_halves(lights.light[block])
    if part.ratio == 0 and part.first == 1:
        one = wp.vec3(1.0, 1.0, 1.0)
        return rgba(wp.cw_div(rgb(light), rgb(light) + one), light[3])
    return light


@wp.func
def load_root(part: FilterPass, root: float) -> float:
    """Return the root mean square of a block's strength as it is averaged."""
    return wp.where(part.ratio == 0 and part.first == 1, root / (1.0 + root), root)


@wp.func
def gaussian(tap: FilterTap, sigma: float) -> float:
    """Return the weight of a tap by its distance on the film."""
    return wp.exp(-wp.min(0.5 * float(tap.dx * tap.dx + tap.dy * tap.dy) / sqr(sigma), EXPONENT_MAX))


@wp.func
def filter_block(
    views: wp.array[View], gbuffer: GBuffer, options: ReflectionOptions, part: FilterPass, samples: ReflectionSamples,
    blocks: ReflectionBlocks, lights: ReflectionLight, history: ReflectionHistory, block: int,
    lights_out: ReflectionLight,
):
    """Filter the light of one block; as kernels below do with a band of them."""
    light = wp.vec4(0.0, 0.0, 0.0, 0.0)
    words = lights.state[block]
    state = unpack_state(words)
    if block_depth(blocks.surface[block]) < SKY_DEPTH:
        view = load_view(views)
        light = load_reflection(part, lights, block)
        state[0] = load_root(part, state[0])
        centre = block_centre(view, gbuffer, options, blocks, state_lobe(words), block)
        lobe = filter_lobe(view, gbuffer, options, part, history, centre, float(blocks.closeness[block]))
        sigma = pass_sigma(options, part, lobe)
        spacing = float(part.spacing * options.stride)
        if state[1] < 0.0:
            sigma = wp.max(sigma, 0.5 * spacing)
        if sigma > NARROW * spacing:
            sum = wp.vec4(0.0, 0.0, 0.0, 0.0)
            square = float(0.0)
            total = float(0.0)
            confidence = float(0.0)
            column = block % options.columns
            row = block // options.columns
            i = -row_reach(part.radius, part.radius)
            j = -part.radius
            while j <= part.radius:
                if in_grid(options, column + i * part.spacing, row + j * part.spacing):
                    tap = filter_tap(
                        options, blocks, lights, centre, column + i * part.spacing, row + j * part.spacing)
                    # Further passes do without a branch, so that all that is read of a tap is waited for together.
                    seen = tap.confidence >= 0.0 and tap.near > 0.0
                    if seen or part.first == 0:
                        found = load_reflection(part, lights, tap.block)
                        w = tap_weight(view, options, part, samples, centre, lobe, tap, found[3])
                        confidence = wp.max(confidence, wp.where(seen, w[1], 0.0))
                        weight = wp.where(seen, w[0] * gaussian(tap, sigma), 0.0)
                        sum += found * weight
                        square += sqr(load_root(part, tap.root)) * weight
                        total += weight
                i += 1
                if i > row_reach(part.radius, j):
                    j += 1
                    i = -row_reach(part.radius, j)
            if total > WEIGHT_NONE:
                scale = 1.0 / total
                light = sum * scale
                state = wp.vec2(wp.sqrt(square * scale), confidence)
    lights_out.light[block] = pack_halves(light)
    lights_out.state[block] = pack_state(state[0], state[1], state_lobe(words))


@wp.kernel(cuda_max_registers=80)
def filter_samples(
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
    # Out:
    lights_out: ReflectionLight,
):
    """Filter the light of blocks among themselves: the first pass; banded over blocks.

    `history` is the frame before's, which at rest tells how far away is what is reflected.
    52 bytes a block: 36 read, 16 written; those of the taps are cached. Mirrors have no taps.
    """
    filter_block(
        views, gbuffer, options, known_pass(part, 1), samples, blocks, lights, history, first + wp.tid(), lights_out)


@wp.kernel(cuda_max_registers=64)
def filter_blocks(
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
    # Out:
    lights_out: ReflectionLight,
):
    """Do the same in a further pass."""
    filter_block(
        views, gbuffer, options, known_pass(part, 0), samples, blocks, lights, history, first + wp.tid(), lights_out)


@wp.kernel(cuda_max_registers=80)
def filter_published(
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
    # Out:
    lights_out: ReflectionLight,
):
    """Do the same in any pass, with weights and means as published (FilterPass.ratio)."""
    filter_block(
        views, gbuffer, options, part, samples, blocks, lights, history, first + wp.tid(), lights_out)
