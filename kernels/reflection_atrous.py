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
from .gbuffer import GBuffer, load_material
from .geometry_math import PI, mean_component, sqr
from .ggx import bounded_cap
from .normals import valid_specular_normal
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
from .reflection_types import LOBE_REFLECTION, SAMPLE_FAR, ReflectionOptions, ReflectionSamples
from .reflection_width import error_reach, filter_reach
from .specular_lobes import surface_alpha
from .view import SKY_DEPTH, View, direction_to_eye, eye_position, film_position, pixel_footprint, unproject

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
# Of their width, what is left in the end for differences of the normals where they stay wide.
TURN_SHARE = wp.constant(0.3)
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

    position: wp.vec3
    normal: wp.vec3
    """From here to `coat_alpha` only where densities are asked for: the lobes' normal, view, and for both lobes GGX's
    alpha and the density by D, share of the lobe included"""
    view: wp.vec3
    scale: float
    alpha: float
    coat_scale: float
    coat_alpha: float
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
    turn_reach: float
    """The same of what normals may differ by"""
    closeness: float
    """1 / distance from the surface of what is reflected around here [1/m]"""


@wp.func
def needs_densities(options: ReflectionOptions, part: FilterPass) -> bool:
    """Return whether a pass weighs by densities; glass has no lobe about the mirrored direction."""
    return options.lobe == LOBE_REFLECTION and (part.first == 1 or part.ratio == 0)


@wp.func
def density_scale(cosine: float, alpha: float) -> float:
    """Return the density of sample_ggx_reflection by GGX's D, for a cosine of the view; below the surface too."""
    if cosine <= 0.0:
        return 0.0
    sine = wp.sqrt(wp.max(1.0 - sqr(cosine), 0.0))
    cap = bounded_cap(wp.vec3(sine, 0.0, cosine), alpha, alpha)
    return 0.5 / (cap * cosine + wp.sqrt(sqr(alpha * sine) + sqr(cosine)))


@wp.func
def half_density(normal: wp.vec3, half: wp.vec3, alpha: float) -> float:
    """Return GGX's D of a half vector of any length; no difference of near numbers, so that mirrors are exact."""
    up = wp.dot(normal, half)
    aside = half - normal * up
    a2 = sqr(alpha)
    spread = wp.dot(aside, aside) + a2 * sqr(up)
    return a2 * sqr(wp.dot(half, half) / wp.max(spread, 1.0e-20)) * (1.0 / PI)


@wp.func
def drawn_density(lobe: FilterLobe, direction: wp.vec3) -> float:
    """Return the density of a direction in the lobe's samples, absorbed ones below the surface included (drawn_pdf)."""
    half = lobe.view + direction
    density = lobe.scale * half_density(lobe.normal, half, lobe.alpha)
    if lobe.coat_scale > 0.0:
        density += lobe.coat_scale * half_density(lobe.normal, half, lobe.coat_alpha)
    return density


@wp.func
def filter_lobe(
    view: View, gbuffer: GBuffer, options: ReflectionOptions, part: FilterPass, history: ReflectionHistory,
    centre: FilterCentre, closeness: float,
) -> FilterLobe:
    """Return the lobe of a centre; `closeness` is ReflectionBlocks.closeness there."""
    out = FilterLobe()
    out.closeness = closeness
    pixel = centre.y * options.width + centre.x
    depth = centre.plane.depth
    out.position = unproject(view.camera, film_position(view, centre.x, centre.y), depth)
    wo = direction_to_eye(view.camera, out.position)
    cosine = wp.clamp(wp.dot(centre.normal, wo), GRAZING, 1.0)
    out.spread = LOBE_SIGMA * surface_alpha(centre.roughness) * cosine
    if options.lobe != LOBE_REFLECTION:
        out.spread = out.spread * REFRACTION_SHARE
    out.pixel = pixel_footprint(view.camera, depth)
    out.turn = 0.0
    if view.camera.orthographic == 0:
        out.turn = out.pixel / wp.max(wp.length(eye_position(view.camera) - out.position), 1.0e-20)
    out.reach = filter_reach(view)
    out.turn_reach = out.reach
    if out.reach < 1.0:
        wanted = error_reach(history, pixel)
        out.turn_reach = wp.max(out.reach, TURN_SHARE * wanted)
        out.reach = wp.max(out.reach, wanted)
    out.peak = 1.0
    if needs_densities(options, part):
        m = load_material(gbuffer, pixel)
        out.view = wo
        out.normal = valid_specular_normal(unpack_normal(gbuffer.geometric_normal[pixel]), wo, centre.normal)
        out.alpha = surface_alpha(m.roughness)
        up = wp.dot(out.normal, wo)
        share = float(0.0)
        if m.coat > 0.0:
            share = wp.clamp(m.coat / wp.max(mean_component(m.specular), 1.0e-6), 0.0, 1.0)
            out.coat_alpha = surface_alpha(m.coat_roughness)
            out.coat_scale = share * density_scale(up, out.coat_alpha)
        out.scale = (1.0 - share) * density_scale(up, out.alpha)
        if part.ratio == 0:
            out.peak = wp.max(drawn_density(out, out.normal * (2.0 * up) - wo), 1.0e-20)
    return out


@wp.func
def angle_of_pixel(lobe: FilterLobe, closeness: float) -> float:
    """Return by how much a point seen in the reflection leaves the lobe's middle for one pixel [rad].

    In detail:
        closeness: 1 / its distance from the surface [1/m].
    """
    return lobe.turn + lobe.pixel * closeness


@wp.func
def pass_sigma(options: ReflectionOptions, part: FilterPass, lobe: FilterLobe) -> float:
    """Return the width of a pass for one pixel [px]: as much as is left to blur of its lobe."""
    if part.ratio == 0:
        return part.sigma * lobe.reach
    width = lobe.reach * lobe.spread / angle_of_pixel(lobe, lobe.closeness)
    if part.first == 1 and options.lobe == LOBE_REFLECTION:
        return wp.min(part.sigma * lobe.reach, RATIO_SHARE * width)
    width = BLUR_SHARE * width
    return wp.sqrt(wp.clamp(width * width - part.before, 0.0, part.sigma * part.sigma))


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
        turned = 2.0 / (NORMAL_SHARE * LOBE_SIGMA * surface_alpha(centre.roughness) * lobe.turn_reach)
        bend = unit_normal(tap.normal) - centre.normal
        square += wp.dot(bend, bend) * sqr(turned)
    return alike * wp.exp(-wp.min(0.5 * square, EXPONENT_MAX))


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
    other = unproject(view.camera, film_position(view, centre.x + tap.dx, centre.y + tap.dy), tap.depth)
    apart = (other - lobe.position) * closeness + direction
    square = wp.max(wp.dot(apart, apart), 1.0e-12)
    return rgba(apart * (1.0 / wp.sqrt(square)), square)


@wp.func
def tap_weight(
    view: View, gbuffer: GBuffer, options: ReflectionOptions, part: FilterPass, samples: ReflectionSamples,
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
        to_hit = tap_direction(view, gbuffer, options, samples, centre, lobe, tap, closeness)
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
    to_hit = tap_direction(view, gbuffer, options, samples, centre, lobe, tap, closeness)
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


@wp.kernel(cuda_max_registers=80)
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
    """Filter the light of blocks among themselves (all passes but the last); banded over blocks.

    `history` is the frame before's, which at rest tells how much blur is worth its error.
    52 bytes a block: 36 read, 16 written; those of the taps are cached. Mirrors have no taps.
    """
    block = first + wp.tid()
    light = wp.vec4(0.0, 0.0, 0.0, 0.0)
    words = lights.state[block]
    state = unpack_state(words)
    if block_depth(blocks.surface[block]) < SKY_DEPTH:
        view = views[0]
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
                    if tap.confidence >= 0.0 and tap.near > 0.0:
                        found = load_reflection(part, lights, tap.block)
                        w = tap_weight(view, gbuffer, options, part, samples, centre, lobe, tap, found[3])
                        confidence = wp.max(confidence, w[1])
                        weight = w[0] * gaussian(tap, sigma)
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
