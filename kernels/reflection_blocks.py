# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflection samples in the few words that their filter reads, their means, and the surface that takes light."""

from __future__ import annotations

import warp as wp

from .filter_weights import PixelPlane, pixel_plane, surface_weight, unit_normal
from .gbuffer import GBuffer, SurfaceMaterial, load_material
from .geometry_math import is_finite3, max_component, mean_component
from .packed_halves import join_words, pack_halves, pack_pair, unpack_halves, unpack_pair
from .packing import rgb, rgba
from .reflection_types import (
    LOBE_TRANSMISSION,
    PLACE_MASK,
    PLACE_STEADY,
    REFLECTANCE_MIN,
    SAMPLE_FAR,
    ReflectionOptions,
    ReflectionSamples,
    coat_alone,
    is_sampled,
    sample_pixel,
    translucent_share,
)
from .view import SKY_DEPTH, View

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# ReflectionBlocks.mark
MARK_SPARK = wp.constant(1)
MARK_MISSING = wp.constant(2)
# In their place until mark_samples has run: the sample is no spark.
MARK_STEADY = wp.constant(4)
# Roughness of mirrors whose rays all meet nearly the same.
STEADY_ROUGHNESS = wp.constant(0.03)
# Bits above hold the jitter of the last filter, 0..JITTER_MAX.
JITTER_SHIFT = wp.constant(2)
JITTER_MAX = wp.constant(63.0)

# Confidence of a block whose light means nothing.
UNKNOWN = wp.constant(-1.0)
# Bits of state_lobe that hold the roughness.
ROUGHNESS_MASK = wp.constant(wp.uint32(65535))


@wp.struct
class ReflectionBlocks:
    """Where and on what each block was sampled: 11 bytes a block."""

    surface: wp.array[wp.uint64]
    """Bits of the depth [m] (SKY_DEPTH: no sample) | pack_normal of the shading normal << 32"""
    mark: wp.array[wp.uint8]
    """MARK_* | jitter of the last filter << JITTER_SHIFT"""
    closeness: wp.array[wp.float16]
    """Mean of 1 / distance to the hits around [1/m]. Widths and weights go by this, not by each sample's own: what is
    far is brighter than what is near, or darker, and would count for more"""


@wp.struct
class ReflectionLight:
    """Reflected light on its way through the filter, a block or a pixel: 16 bytes in two words."""

    light: wp.array[wp.uint64]
    """pack_halves: demodulated radiance, exposed; w = mean of 1 / distance to the hit [1/m], 0 where there is none"""
    state: wp.array[wp.uint64]
    """Of blocks: two half-floats, root mean square of the light's strength and how much of a sample of its own this
    is, 0..1 (UNKNOWN: nothing is known) | what was sampled << 32: roughness that filters go by (unorm16) | column
    << 16 | row << 24 of the pixel in the block. Of pixels, after the last pass, pack_halves: standard deviation of the
    strength around, the same confidence, mean of the strength around, the confidence of an average frame"""


@wp.struct
class ReflectionHistory:
    """What a frame leaves of reflections for the next: 16 bytes a pixel."""

    light: wp.array[wp.uint64]
    """pack_mean of demodulated radiance, exposed; 0 where nothing is sampled"""
    state: wp.array[wp.uint64]
    """pack_halves: frames in the mean (negative: the light is changing); short mean and standard deviation of the
    strength; closeness (1 / distance) of what is seen"""


@wp.func
def light_strength(color: wp.vec3) -> float:
    """Return the number that statistics of reflections go by: blue lamps count like white ones."""
    return max_component(color)


@wp.func
def pack_state(root: float, confidence: float, lobe: wp.uint32) -> wp.uint64:
    """Pack a block's ReflectionLight.state."""
    return join_words(pack_pair(root, confidence), lobe)


@wp.func
def unpack_state(packed: wp.uint64) -> wp.vec2:
    """Return root mean square and confidence in a block's ReflectionLight.state."""
    return unpack_pair(wp.uint32(packed & wp.uint64(0xFFFFFFFF)))


@wp.func
def state_lobe(packed: wp.uint64) -> wp.uint32:
    """Return roughness and place of the pixel in a block's ReflectionLight.state."""
    return wp.uint32(packed >> wp.uint64(32))


@wp.func
def block_depth(packed: wp.uint64) -> float:
    """Return the depth in ReflectionBlocks.surface."""
    return wp.cast(wp.uint32(packed & wp.uint64(0xFFFFFFFF)), float)


@wp.func
def block_normal(packed: wp.uint64) -> wp.uint32:
    """Return the packed normal in ReflectionBlocks.surface."""
    return wp.uint32(packed >> wp.uint64(32))


@wp.func
def block_roughness(lobe: wp.uint32) -> float:
    """Return the roughness in state_lobe."""
    return float(lobe & ROUGHNESS_MASK) * 1.5259022e-5


@wp.func
def block_column(lobe: wp.uint32) -> int:
    """Return the column of the sampled pixel within its block."""
    return int((lobe >> wp.uint32(16)) & wp.uint32(255))


@wp.func
def block_row(lobe: wp.uint32) -> int:
    """Return the row of the sampled pixel within its block."""
    return int(lobe >> wp.uint32(24))


@wp.func
def block_pixel(options: ReflectionOptions, lobe: wp.uint32, block: int) -> int:
    """Return the pixel at which a block was sampled."""
    x = block % options.columns * options.stride + block_column(lobe)
    return (block // options.columns * options.stride + block_row(lobe)) * options.width + x


@wp.func
def filter_roughness(options: ReflectionOptions, m: SurfaceMaterial) -> float:
    """Return the roughness that filters go by: near the coat's where a good part of the light is the coat's."""
    if options.lobe == LOBE_TRANSMISSION:
        return wp.lerp(m.roughness, 1.0, translucent_share(m))
    if m.coat <= REFLECTANCE_MIN or m.coat_roughness >= m.roughness:
        return m.roughness
    if coat_alone(options, m):
        return m.coat_roughness
    share = wp.min(4.0 * m.coat / wp.max(mean_component(m.specular), 1.0e-6), 1.0)
    return wp.pow(wp.max(m.roughness, 0.02), 1.0 - share) * wp.pow(wp.max(m.coat_roughness, 0.02), share)


@wp.struct
class FilterCentre:
    """The surface that a filter's result is for."""

    x: int
    """Pixel [px]"""
    y: int
    plane: PixelPlane
    normal: wp.vec3
    """Shading normal"""
    packed: wp.uint32
    """pack_normal of it"""
    roughness: float
    """As filters go by"""


@wp.func
def filter_centre(
    view: View, gbuffer: GBuffer, width: int, pixel: int, normal: wp.uint32, roughness: float,
) -> FilterCentre:
    """Return the centre at a pixel that shows a surface; its packed normal and roughness are known already."""
    c = FilterCentre()
    c.x = pixel % width
    c.y = pixel // width
    c.plane = pixel_plane(view, gbuffer, width, pixel)
    c.normal = unit_normal(normal)
    c.packed = normal
    c.roughness = roughness
    return c


@wp.func
def block_centre(
    view: View, gbuffer: GBuffer, options: ReflectionOptions, blocks: ReflectionBlocks, lobe: wp.uint32, block: int,
) -> FilterCentre:
    """Return the centre at a block's sample, which there must be; `lobe` is its state_lobe."""
    return filter_centre(
        view, gbuffer, options.width, block_pixel(options, lobe, block), block_normal(blocks.surface[block]),
        block_roughness(lobe))


@wp.func
def row_reach(radius: int, row: int) -> int:
    """Return how many taps to each side a row of a kernel has: 3x3 taps, or from radius 2 on the 13 of a diamond."""
    return wp.where(radius < 2, radius, radius - wp.abs(row))


@wp.func
def in_grid(options: ReflectionOptions, column: int, row: int) -> bool:
    """Return whether there is a block at a place in the grid."""
    return column >= 0 and row >= 0 and column < options.columns and row < options.rows


@wp.struct
class FilterTap:
    """What a centre sees in another block."""

    block: int
    dx: int
    """From the centre's pixel to the sample's [px]"""
    dy: int
    depth: float
    """Along the view axis [m]"""
    near: float
    """1 in the centre's plane, falling to 0 a pixel's width off it or where there is no surface"""
    normal: wp.uint32
    """pack_normal"""
    roughness: float
    root: float
    """Root mean square of its light's strength"""
    confidence: float
    """As in ReflectionLight.state"""


@wp.func
def filter_tap(
    options: ReflectionOptions, blocks: ReflectionBlocks, lights: ReflectionLight, centre: FilterCentre, column: int,
    row: int,
) -> FilterTap:
    """Return where the block at a place in the grid was sampled, as seen from a centre."""
    tap = FilterTap()
    # Read millions of times: no divisions, two words.
    tap.block = row * options.columns + column
    packed = blocks.surface[tap.block]
    words = lights.state[tap.block]
    lobe = state_lobe(words)
    state = unpack_state(words)
    tap.root = state[0]
    tap.confidence = state[1]
    tap.dx = column * options.stride + block_column(lobe) - centre.x
    tap.dy = row * options.stride + block_row(lobe) - centre.y
    tap.depth = block_depth(packed)
    tap.near = surface_weight(centre.plane, tap.dx, tap.dy, tap.depth)
    tap.normal = block_normal(packed)
    tap.roughness = block_roughness(lobe)
    return tap


@wp.kernel
def gather_samples(
    first: int,
    # In:
    gbuffer: GBuffer,
    options: ReflectionOptions,
    samples: ReflectionSamples,
    # Out:
    blocks_out: ReflectionBlocks,
    lights_out: ReflectionLight,
):
    """Put surfaces and light of the samples into the words that the filter reads; banded over blocks."""
    block = first + wp.tid()
    pixel = sample_pixel(options, samples, block)
    depth = float(SKY_DEPTH)
    normal = wp.uint32(0)
    lobe = wp.uint32(0)
    light = wp.vec4(0.0, 0.0, 0.0, 0.0)
    confidence = float(UNKNOWN)
    mark = int(0)
    if pixel >= 0:
        m = load_material(gbuffer, pixel)
        if is_sampled(options, m):
            depth = gbuffer.depth[pixel]
            normal = gbuffer.normal[pixel]
            roughness = wp.uint32(wp.clamp(filter_roughness(options, m), 0.0, 1.0) * 65535.0 + 0.5)
            place = int(samples.place[block] & PLACE_MASK)
            if (samples.place[block] & PLACE_STEADY) != wp.uint8(0) and filter_roughness(options, m) < STEADY_ROUGHNESS:
                mark = MARK_STEADY
            lobe = roughness | (wp.uint32(place % options.stride) << wp.uint32(16))
            lobe = lobe | (wp.uint32(place // options.stride) << wp.uint32(24))
            found = unpack_halves(samples.radiance[block])
            if samples.pdf[block] > 0.0 and is_finite3(rgb(found)):
                color = wp.max(rgb(found), wp.vec3(0.0, 0.0, 0.0))
                # A direction that the surface itself absorbs has no distance.
                near = wp.where(found[3] > 0.0, 1.0 / wp.clamp(found[3], 1.0 / SAMPLE_FAR, SAMPLE_FAR), 0.0)
                light = rgba(color, near)
                confidence = float(1.0)
    blocks_out.mark[block] = wp.uint8(mark)
    blocks_out.surface[block] = join_words(wp.cast(depth, wp.uint32), normal)
    lights_out.light[block] = pack_halves(light)
    lights_out.state[block] = pack_state(light_strength(rgb(light)), confidence, lobe)
