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
from .reflection_atrous import (
    WEIGHT_NONE,
    FilterPass,
    filter_lobe,
    gaussian,
    load_reflection,
    load_root,
    pass_sigma,
    tap_weight,
)
from .reflection_blocks import (
    JITTER_MAX,
    JITTER_SHIFT,
    UNKNOWN,
    FilterTap,
    ReflectionBlocks,
    ReflectionLight,
    filter_centre,
    filter_roughness,
    filter_tap,
    in_grid,
    light_strength,
    pack_state,
    unpack_state,
)
from .reflection_types import ReflectionOptions, ReflectionSamples, block_of, is_sampled
from .sampling import hash32, hash_combine, to_unit
from .view import SKY_DEPTH, View

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Least width of the kernel in sides of a block: so that it always meets samples.
SIGMA_MINIMUM = wp.constant(0.55)
# Widths of the kernel in spacings of the taps that are meant, and above which two taps to each side are needed.
SIGMA_SPACING = wp.constant(1.065)
SIGMA_WIDE = wp.constant(0.8)
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
def tap_jitter(options: ReflectionOptions, frame: int, pixel: int, mark: int, spacing: int) -> wp.vec2i:
    """Return by how many blocks the taps of a pixel are moved: up to half their spacing where roughness varies."""
    share = float(mark >> JITTER_SHIFT) / JITTER_MAX
    bits = hash_combine(hash32(wp.uint32(pixel)), wp.uint32(frame))
    u = to_unit(bits) - 0.5
    v = to_unit(hash32(bits)) - 0.5
    width = share * float(spacing)
    return wp.vec2i(int(wp.round(u * width)), int(wp.round(v * width)))


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
    sums: Upscaled, tap: FilterTap, value: wp.vec4, root: float, w: wp.vec2, distance: float,
) -> Upscaled:
    """Return the sums after one block.

    In detail:
        value: Its light.
        root: Root mean square of its strength.
        w: As tap_weight gives it.
        distance: Weight by the distance on the film.
    """
    out = sums
    apart = float(tap.dx * tap.dx + tap.dy * tap.dy) + wp.where(tap.near > 0.0, 0.0, OTHER_SURFACE)
    if apart < sums.nearest_square:
        out.nearest_square = apart
        out.nearest = tap.block
    weight = w[0] * distance
    out.sum = sums.sum + value * weight
    out.total = sums.total + weight
    out.confidence = wp.max(sums.confidence, w[1])
    out.moments = sums.moments + wp.vec3(light_strength(rgb(value)), root * root, 1.0) * (distance * tap.near)
    return out


@wp.func
def deviation_of(part: FilterPass, moments: wp.vec3, light: wp.vec4) -> float:
    """Return the standard deviation of the strength around: of the surface, not of the lobe alone."""
    if moments[2] <= 0.0:
        return 0.0
    mean = moments[0] / moments[2]
    deviation = wp.sqrt(wp.max(moments[1] / moments[2] - mean * mean, 0.0))
    if part.ratio == 1:
        return deviation
    return deviation / sqr(wp.max(1.0 - light_strength(rgb(light)), COMPRESSED_MINIMUM))


@wp.kernel
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
    # Out:
    lights_out: ReflectionLight,
):
    """Filter the light of blocks into pixels; banded over pixels.

    54 bytes a pixel that reflects: 42 read (surface and material 36, its share of the blocks 6; the taps are cached),
    12 written.

    In detail:
        lights_out: `state` holds the standard deviation of the light around instead of its root mean square.
    """
    pixel = first + wp.tid()
    light = wp.vec4(0.0, 0.0, 0.0, 0.0)
    state = wp.vec2(0.0, UNKNOWN)
    m = load_material(gbuffer, pixel)
    if gbuffer.depth[pixel] < SKY_DEPTH and is_sampled(options, m):
        view = views[0]
        home = block_of(options, pixel)
        centre = filter_centre(view, gbuffer, options.width, pixel, gbuffer.normal[pixel], filter_roughness(m))
        lobe = filter_lobe(view, gbuffer, options, part, centre)
        stride = float(options.stride)
        closeness = load_reflection(part, lights, home)[3]
        sigma = wp.max(pass_sigma(options, part, lobe, closeness), SIGMA_MINIMUM * stride)
        spacing = wp.clamp(int(sigma / (SIGMA_SPACING * stride) + 0.5), 1, part.spacing)
        radius = wp.where(sigma > SIGMA_WIDE * stride * float(spacing), 2, 1)
        column = home % options.columns
        row = home // options.columns
        if part.jitter == 1 and spacing > 1:
            moved = tap_jitter(options, view.frame, pixel, int(blocks.mark[home]), spacing)
            column += moved[0]
            row += moved[1]
        found = Upscaled()
        found.nearest = -1
        found.nearest_square = 1.0e9
        reach = radius * spacing
        i = -reach
        j = -reach
        while j <= reach:
            tap_column = column + i
            tap_row = row + j
            if i == 0 and j == 0:
                # The pixel's own block is always among the taps.
                tap_column = home % options.columns
                tap_row = home // options.columns
            if in_grid(options, tap_column, tap_row):
                tap = filter_tap(options, blocks, centre, tap_column, tap_row)
                other = unpack_state(lights.state[tap.block])
                if other[1] >= 0.0:
                    value = load_reflection(part, lights, tap.block)
                    w = wp.vec2(0.0, 0.0)
                    if tap.near > 0.0:
                        w = tap_weight(
                            view, gbuffer, options, part, samples, centre, lobe, tap, value[3], other[1])
                    found = add_block(found, tap, value, load_root(part, other[0]), w, gaussian(tap, sigma))
            i += spacing
            if i > reach:
                i = -reach
                j += spacing
        if found.total > WEIGHT_NONE:
            light = found.sum / found.total
            state[1] = found.confidence
        elif found.nearest >= 0:
            light = load_reflection(part, lights, found.nearest)
            state[1] = 0.0
        state[0] = deviation_of(part, found.moments, light)
        light = expanded(part, light)
    lights_out.light[pixel] = pack_halves(light)
    lights_out.state[pixel] = pack_state(state[0], state[1])
