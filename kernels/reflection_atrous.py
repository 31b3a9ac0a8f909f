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
from .gbuffer import GBuffer, load_material, load_surface
from .geometry_math import sqr
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba, unpack_normal
from .reflection_blocks import (
    UNKNOWN,
    FilterCentre,
    FilterTap,
    ReflectionBlocks,
    ReflectionLight,
    block_centre,
    block_depth,
    filter_tap,
    in_grid,
    pack_state,
    unpack_state,
)
from .reflection_types import LOBE_REFLECTION, SAMPLE_FAR, ReflectionOptions, ReflectionSamples
from .specular_lobes import SpecularLobes, lobes_pdf, specular_lobes, surface_alpha
from .view import SKY_DEPTH, View, direction_to_eye, eye_position, pixel_footprint

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Largest ratio of densities: beyond it one neighbour would stand for all.
RATIO_MAX = wp.constant(4.0)
# Standard deviation of the angle in GGX lobes by alpha, of a Gaussian as wide at half height; by how much lobes of
# refraction are narrower.
LOBE_SIGMA = wp.constant(1.1)
REFRACTION_SHARE = wp.constant(0.5)
# Cosine of the view up to which lobes become flatter.
GRAZING = wp.constant(0.2)
# Of the lobe's deviation on the film all passes after the ratio's together may blur so much: it widens by 4 %.
BLUR_SHARE = wp.constant(0.3)
# Deviations beyond which the ratio of densities leaves nothing of a sample: mirrors need no taps.
RATIO_SHARE = wp.constant(1.5)
# Like BLUR_SHARE, of the directions mirrored at different normals, in each pass.
NORMAL_SHARE = wp.constant(0.5)
# Weight of what clean-up has put together from neighbours, and the least of anything in later passes.
REPLACED_SHARE = wp.constant(0.25)
WEIGHT_MINIMUM = wp.constant(0.1)
# Kernels narrower than this share of the taps' spacing hold nothing but the centre.
NARROW = wp.constant(0.25)
# Frames at rest between which the filters shrink to nothing.
REST_START = wp.constant(16.0)
REST_END = wp.constant(160.0)
# Exponent beyond which a weight is as good as none, but tells near from far.
EXPONENT_MAX = wp.constant(60.0)
# Sum of weights below which there is nothing.
WEIGHT_NONE = wp.constant(1.0e-36)


@wp.struct
class FilterPass:
    """One pass of the filter; all but its number is the same for all pixels."""

    sigma: float
    """Standard deviation of its Gaussian [px]"""
    before: float
    """Variance of the passes before it that widen the lobe [px^2]"""
    spacing: int
    """Of the taps [blocks]"""
    radius: int
    """Taps to each side"""
    first: int
    """1: taps are samples, of which direction and density are known"""
    ratio: int
    """0: weights and means as published: densities in every pass, of light as x / (1 + x)"""
    jitter: int
    """1: the last pass moves its taps where the roughness varies"""


@wp.struct
class FilterLobe:
    """The lobe into which a centre reflects."""

    lobes: SpecularLobes
    """Only where densities are asked for"""
    position: wp.vec3
    peak: float
    """Density in the mirrored direction [1/sr]; only where weights are as published"""
    spread: float
    """Standard deviation of the lobe [rad]"""
    turn: float
    """Parallax of a pixel against the surface itself [rad]"""
    pixel: float
    """Width of a pixel [m]"""
    reach: float
    """Share of the filter's width that is left at rest"""


@wp.func
def filter_reach(view: View) -> float:
    """Return by how much filters are narrower: 1 in motion, falling to nearly 0 at rest."""
    return wp.clamp((REST_END - float(view.rest)) / (REST_END - REST_START), 1.0e-3, 1.0)


@wp.func
def needs_densities(options: ReflectionOptions, part: FilterPass) -> bool:
    """Return whether a pass weighs by densities; glass has no lobe about the mirrored direction."""
    return options.lobe == LOBE_REFLECTION and (part.first == 1 or part.ratio == 0)


@wp.func
def filter_lobe(
    view: View, gbuffer: GBuffer, options: ReflectionOptions, part: FilterPass, centre: FilterCentre,
) -> FilterLobe:
    """Return the lobe of a centre."""
    out = FilterLobe()
    pixel = centre.y * options.width + centre.x
    surface = load_surface(view, gbuffer, options.width, pixel)
    wo = direction_to_eye(view.camera, surface.position)
    out.position = surface.position
    cosine = wp.clamp(wp.dot(centre.normal, wo), GRAZING, 1.0)
    out.spread = LOBE_SIGMA * surface_alpha(centre.roughness) * cosine
    if options.lobe != LOBE_REFLECTION:
        out.spread = out.spread * REFRACTION_SHARE
    out.pixel = pixel_footprint(view.camera, surface.depth)
    out.turn = 0.0
    if view.camera.orthographic == 0:
        out.turn = out.pixel / wp.max(wp.length(eye_position(view.camera) - surface.position), 1.0e-20)
    out.reach = filter_reach(view)
    out.peak = 1.0
    if needs_densities(options, part):
        out.lobes = specular_lobes(load_material(gbuffer, pixel), surface, wo)
        if part.ratio == 0:
            mirrored = out.lobes.normal * (2.0 * wp.dot(out.lobes.normal, wo)) - wo
            out.peak = wp.max(lobes_pdf(out.lobes, mirrored), 1.0e-20)
    return out


@wp.func
def angle_of_pixel(lobe: FilterLobe, closeness: float) -> float:
    """Return by how much a point seen in the reflection leaves the lobe's middle for one pixel [rad].

    In detail:
        closeness: 1 / its distance from the surface [1/m].
    """
    return lobe.turn + lobe.pixel * closeness


@wp.func
def pass_sigma(options: ReflectionOptions, part: FilterPass, lobe: FilterLobe, closeness: float) -> float:
    """Return the width of a pass for one pixel [px]: as much as is left to blur of its lobe."""
    if part.ratio == 0:
        return part.sigma * lobe.reach
    width = lobe.reach * lobe.spread / angle_of_pixel(lobe, closeness)
    if part.first == 1 and options.lobe == LOBE_REFLECTION:
        return wp.min(part.sigma * lobe.reach, RATIO_SHARE * width)
    width = BLUR_SHARE * width
    return wp.sqrt(wp.clamp(width * width - part.before, 0.0, part.sigma * part.sigma))


@wp.func
def lobe_overlap(centre: FilterCentre, lobe: FilterLobe, tap: FilterTap, closeness: float) -> float:
    """Return how much alike two surfaces reflect a point: 1 for the same lobe about the same direction."""
    alpha = surface_alpha(centre.roughness)
    other = surface_alpha(tap.roughness)
    alike = 2.0 * alpha * other / (alpha * alpha + other * other)
    bend = unit_normal(tap.normal) - centre.normal
    # Mirrored directions turn by twice the angle of the normals.
    turned = 2.0 / (NORMAL_SHARE * LOBE_SIGMA * alpha)
    moved = angle_of_pixel(lobe, closeness) / lobe.spread
    square = wp.dot(bend, bend) * (turned * turned) + float(tap.dx * tap.dx + tap.dy * tap.dy) * (moved * moved)
    return alike * alike * wp.exp(-wp.min(0.5 * square / (lobe.reach * lobe.reach), EXPONENT_MAX))


@wp.func
def tap_direction(
    view: View, gbuffer: GBuffer, options: ReflectionOptions, samples: ReflectionSamples, centre: FilterCentre,
    lobe: FilterLobe, tap: FilterTap, closeness: float,
) -> wp.vec4:
    """Return the direction from a centre to what a block's sample hit; w = Jacobian of the reconnection.

    The Jacobian is that of the solid angles, the block's over the centre's, for a hit that faces both.
    """
    direction = unpack_normal(samples.direction[tap.block])
    if closeness * SAMPLE_FAR < 1.01 or (tap.dx == 0 and tap.dy == 0):
        return rgba(direction, 1.0)
    other = load_surface(view, gbuffer, options.width, (centre.y + tap.dy) * options.width + centre.x + tap.dx)
    apart = (other.position - lobe.position) * closeness + direction
    square = wp.max(wp.dot(apart, apart), 1.0e-12)
    return rgba(apart * (1.0 / wp.sqrt(square)), square)


@wp.func
def tap_weight(
    view: View, gbuffer: GBuffer, options: ReflectionOptions, part: FilterPass, samples: ReflectionSamples,
    centre: FilterCentre, lobe: FilterLobe, tap: FilterTap, closeness: float, confidence: float,
) -> wp.vec2:
    """Return d * p of a block, and how much of a sample of its own it is for the centre."""
    own = tap.dx == 0 and tap.dy == 0
    if part.ratio == 0:
        if confidence == 0.0 or options.lobe != LOBE_REFLECTION:
            return wp.vec2(tap.near, tap.near)
        to_hit = tap_direction(view, gbuffer, options, samples, centre, lobe, tap, closeness)
        return wp.vec2(tap.near * lobes_pdf(lobe.lobes, rgb(to_hit)) / lobe.peak, tap.near)
    match = tap.near
    if not own:
        match *= lobe_overlap(centre, lobe, tap, closeness)
    if part.first == 0:
        return wp.vec2(match * wp.max(confidence, WEIGHT_MINIMUM), match * confidence)
    if confidence == 0.0:
        return wp.vec2(match * REPLACED_SHARE, 0.0)
    if own or options.lobe != LOBE_REFLECTION:
        return wp.vec2(match, match)
    to_hit = tap_direction(view, gbuffer, options, samples, centre, lobe, tap, closeness)
    ratio = lobes_pdf(lobe.lobes, rgb(to_hit)) / (samples.pdf[tap.block] * to_hit[3])
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


@wp.kernel
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
    # Out:
    lights_out: ReflectionLight,
):
    """Filter the light of blocks among themselves (all passes but the last); banded over blocks.

    44 bytes a block: 32 read, 12 written; those of the taps are cached. Mirrors have no taps.
    """
    block = first + wp.tid()
    light = wp.vec4(0.0, 0.0, 0.0, 0.0)
    state = wp.vec2(0.0, UNKNOWN)
    if block_depth(blocks.surface[block]) < SKY_DEPTH:
        view = views[0]
        light = load_reflection(part, lights, block)
        state = unpack_state(lights.state[block])
        state[0] = load_root(part, state[0])
        known = state[1] >= 0.0
        centre = block_centre(view, gbuffer, options, blocks, block)
        lobe = filter_lobe(view, gbuffer, options, part, centre)
        sigma = pass_sigma(options, part, lobe, light[3])
        spacing = float(part.spacing * options.stride)
        if not known:
            sigma = wp.max(sigma, 0.5 * spacing)
        if sigma > NARROW * spacing:
            sum = wp.vec4(0.0, 0.0, 0.0, 0.0)
            square = float(0.0)
            total = float(0.0)
            confidence = float(0.0)
            column = block % options.columns
            row = block // options.columns
            reach = part.radius * part.spacing
            i = -reach
            j = -reach
            while j <= reach:
                if in_grid(options, column + i, row + j):
                    tap = filter_tap(options, blocks, centre, column + i, row + j)
                    q = tap.block
                    other = unpack_state(lights.state[q])
                    if other[1] >= 0.0 and tap.near > 0.0:
                        found = load_reflection(part, lights, q)
                        w = tap_weight(
                            view, gbuffer, options, part, samples, centre, lobe, tap, found[3], other[1])
                        confidence = wp.max(confidence, w[1])
                        weight = w[0] * gaussian(tap, sigma)
                        sum += found * weight
                        square += sqr(load_root(part, other[0])) * weight
                        total += weight
                i += part.spacing
                if i > reach:
                    i = -reach
                    j += part.spacing
            if total > WEIGHT_NONE:
                scale = 1.0 / total
                light = sum * scale
                state = wp.vec2(wp.sqrt(square * scale), confidence)
    lights_out.light[block] = pack_halves(light)
    lights_out.state[block] = pack_state(state[0], state[1])
