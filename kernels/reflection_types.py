# SPDX-License-Identifier: GPL-3.0-or-later
"""What the passes of glossy reflections share: options, one sample for each block of pixels, zones of roughness.

Eto et al. 2023, section 2. A block is `stride` x `stride` pixels (half resolution: 2 x 2) and has one sample a frame,
at one of its pixels that reflects. Transmission, specular (glass) and diffuse (translucent surfaces), is sampled,
filtered and averaged by the same kernels in images of its own.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import SurfaceMaterial
from .geometry_math import max_component, mean_component

LOBE_REFLECTION = wp.constant(0)
LOBE_TRANSMISSION = wp.constant(1)
"""Light from behind a surface: through glass, or scattered by a translucent lobe; and from below it"""
LOBE_DIFFUSE = wp.constant(2)
"""Diffuse reflection, at rest alone (final gather)"""

# ReflectionSamples.place of blocks without a sample: nothing reflects, or the means of what does are to do for it.
NO_SAMPLE = wp.constant(wp.uint8(255))
WAITS = wp.constant(wp.uint8(254))
# Bits of ReflectionSamples.place that hold the pixel, and one that is set beside them where the light is emitted by
# what the ray has met first: a lamp, a shining surface, the world. In a mirror that is no noise, however bright it is.
PLACE_MASK = wp.constant(wp.uint8(15))
PLACE_STEADY = wp.constant(wp.uint8(64))

# Where a block's sample comes from in a frame: nowhere, a traced ray, a look-up in the screen probes.
SOURCE_NONE = wp.constant(wp.uint8(0))
SOURCE_RAY = wp.constant(wp.uint8(1))
SOURCE_PROBE = wp.constant(wp.uint8(2))
SOURCE_COAT = wp.constant(wp.uint8(3))
"""A ray for the coat, look-ups for its base"""

# Distance [m] that stands for the world in samples; the largest round number that fits a half-float.
SAMPLE_FAR = wp.constant(6.0e4)

# Directional albedo below which no reflection is drawn: 8-bit pictures can't show it.
REFLECTANCE_MIN = wp.constant(1.0e-3)

# Albedo up to which a reflection is weak, as of wood and plastic seen from above, and from which on it is strong, as of
# metals, and of all at grazing angles. What probes blur of weak ones hardly shows beside the surface's own light.
WEAK_ALBEDO = wp.constant(0.05)
STRONG_ALBEDO = wp.constant(0.15)

# The range over which diffuse light takes over from samples is so many times as wide as that over which look-ups take
# over from rays: below it lobes are sharper than the probes' harmonics.
DIFFUSE_BLEND = wp.constant(0.5)

# Roughness from which a probe's cells, some 20 degrees wide, are fine enough for what a base under a coat reflects, and
# the share of it below which the coat's roughness counts as sharp.
COATED_ROUGHNESS = wp.constant(0.3)
COAT_SHARP = wp.constant(0.6)


@wp.struct
class ReflectionOptions:
    """Settings and sizes of the reflection passes."""

    width: int
    """Of the picture [px]"""
    height: int
    stride: int
    """Pixels of a block's side: 1, 2 or 4"""
    columns: int
    """Blocks in a row: ceil(width / stride)"""
    rows: int
    lobe: int
    """LOBE_*"""
    traced: float
    """Roughness up to which rays are traced (the paper's r_rt)"""
    weak: float
    """The same for weak reflections (WEAK_ALBEDO)"""
    diffuse: float
    """Roughness from which the diffuse result stands in (the paper's r_diffuse)"""
    blend: float
    """Width of the zone of roughness above `traced` in which two methods blend; that below `diffuse` is DIFFUSE_BLEND
    times as wide"""
    half_rate: int
    """1: while only the camera moves, half of the blocks may do without a sample (reflection_turns.py)"""


@wp.struct
class ReflectionSamples:
    """One entry a block, row by row."""

    place: wp.array[wp.uint8]
    """Pixel within the block, y * stride + x; NO_SAMPLE: nothing in the block reflects; WAITS. After a sample was found
    missing the place stays and `pdf` is 0. Once there is light with PLACE_STEADY, or without"""
    radiance: wp.array[wp.uint64]
    """pack_halves: incoming radiance * f cos / pdf / albedo, exposed (its mean times GBuffer.specular, or
    through_albedo, is what the pixel shows); w = distance to the hit, unfolded over mirrors [m],
    SAMPLE_FAR for the world"""
    direction: wp.array[wp.uint32]
    """pack_normal: unit direction in which the ray left the pixel's surface"""
    pdf: wp.array[float]
    """Density [1/sr] with which it was drawn; 0: no sample, the radiance means nothing"""
    shift: wp.array[wp.uint32]
    """pack_pair: how far from where it was of what stands still the image of what is reflected was in the frame before
    [px]; of reflections alone, in frames in which something has moved (View.moved_age 0)"""


@wp.func
def block_of(options: ReflectionOptions, pixel: int) -> int:
    """Return the block of a pixel."""
    return (pixel // options.width // options.stride) * options.columns + pixel % options.width // options.stride


@wp.func
def place_pixel(options: ReflectionOptions, block: int, place: int) -> int:
    """Return the pixel at a place of a block; -1 outside of the picture."""
    x = block % options.columns * options.stride + place % options.stride
    y = block // options.columns * options.stride + place // options.stride
    if x >= options.width or y >= options.height:
        return -1
    return y * options.width + x


@wp.func
def sample_pixel(options: ReflectionOptions, samples: ReflectionSamples, block: int) -> int:
    """Return the pixel at which a block was sampled; -1 for none."""
    place = samples.place[block]
    if place >= WAITS:
        return -1
    return place_pixel(options, block, int(place & PLACE_MASK))


@wp.func
def fading(x: float, start: float, width: float) -> float:
    """Return 1 up to `start`, falling smoothly to 0 at `start + width`."""
    t = wp.clamp((x - start) / wp.max(width, 1.0e-6), 0.0, 1.0)
    return 1.0 - t * t * (3.0 - 2.0 * t)


@wp.func
def ray_share(options: ReflectionOptions, roughness: float, albedo: float) -> float:
    """Return the share of a reflection of such an albedo that rays bring; the rest is looked up in the probes."""
    if options.lobe != LOBE_REFLECTION:
        return 1.0
    strong = 1.0 - fading(albedo, WEAK_ALBEDO, STRONG_ALBEDO - WEAK_ALBEDO)
    return fading(roughness, wp.lerp(options.weak, options.traced, strong), options.blend)


@wp.func
def coat_alone(options: ReflectionOptions, m: SurfaceMaterial) -> bool:
    """Return whether samples are of a surface's coat alone: a sharp one on a base so rough that the probes know it.

    Drawn from both lobes few rays would meet what the coat shows, and a filter as narrow as the coat would leave the
    base's noise. Look-ups in the probes add the base's light to each sample (look_up_probes).
    """
    if options.lobe != LOBE_REFLECTION or m.coat <= REFLECTANCE_MIN or m.roughness < COATED_ROUGHNESS:
        return False
    return m.coat_roughness < COAT_SHARP * m.roughness and ray_share(options, m.coat_roughness, m.coat) > 0.0


@wp.func
def sampled_material(options: ReflectionOptions, m: SurfaceMaterial) -> SurfaceMaterial:
    """Return what samples are drawn by: the material, or its coat alone; `specular` is the albedo of both lobes."""
    out = m
    if coat_alone(options, m):
        out.f0 = wp.vec3(0.0, 0.0, 0.0)
        out.f90 = 0.0
    return out


@wp.func
def sampled_share(options: ReflectionOptions, roughness: float) -> float:
    """Return the share of a reflection that samples bring (rays or probes); the rest is diffuse light."""
    if options.lobe != LOBE_REFLECTION:
        return 1.0
    width = DIFFUSE_BLEND * options.blend
    return fading(roughness, options.diffuse - width, width)


@wp.func
def through_albedo(m: SurfaceMaterial) -> wp.vec3:
    """Return the albedo of light from behind a surface, or from below it: what LOBE_TRANSMISSION samples."""
    return m.transmitted + m.translucent + m.scattered


@wp.func
def translucent_share(m: SurfaceMaterial) -> float:
    """Return how much of that light is diffuse: of the translucent lobe, or scattered below; glass lets the rest."""
    scattered = mean_component(m.translucent + m.scattered)
    return scattered / wp.max(scattered + mean_component(m.transmitted), 1.0e-20)


@wp.func
def is_sampled(options: ReflectionOptions, m: SurfaceMaterial) -> bool:
    """Return whether a surface needs samples of this lobe."""
    if options.lobe == LOBE_TRANSMISSION:
        return max_component(through_albedo(m)) > REFLECTANCE_MIN
    if options.lobe == LOBE_DIFFUSE:
        return max_component(m.diffuse) > REFLECTANCE_MIN
    sharpest = m.roughness
    if m.coat > REFLECTANCE_MIN:
        sharpest = wp.min(sharpest, m.coat_roughness)
    return max_component(m.specular) > REFLECTANCE_MIN and sampled_share(options, sharpest) > 0.0
