# SPDX-License-Identifier: GPL-3.0-or-later
"""Reservoirs of light samples and what they are weighed by: the light that a sample sends to the camera, unshadowed.

Resampled importance sampling (Talbot et al. 2005; Bitterli et al. 2020). Light is kept without the surface's colours
(demodulated), and the target takes dark colours for a little brighter: a black texel must hold light that its
neighbours' filters can use. The target is a number made for speed; what is shaded in the end is the exact light.
"""

from __future__ import annotations

import warp as wp

from .environment_split import EnvironmentSplit
from .gbuffer import GBuffer, Surface, SurfaceMaterial, load_material, load_previous_surface
from .geometry_math import INV_PI, luminance, max_component, mean_component, sqr
from .lamp_sample import LightSample
from .light_candidate import Candidate, replay
from .light_linking import kinds_lit_at
from .reflection_lights import light_part, sample_roughness, shown_zone
from .reflection_types import ReflectionOptions, coat_alone
from .specular_lobes import surface_alpha
from .types import VISIBLE_DIFFUSE, VISIBLE_GLOSSY, Scene
from .view import View, direction_to_eye

# Diffuse albedo that the target takes at least.
ALBEDO_FLOOR = wp.constant(0.02)

# Specular albedo below which the specular lobe is not drawn: 8-bit pictures can't show it.
SPECULAR_MIN = wp.constant(1.0e-4)

# Largest target and weight that are kept: products of two still fit a float.
LARGE = wp.constant(1.0e18)

# Side of the tiles [px] that slots go by, and how many slots one has of a colour of the checkerboard: a warp.
SIDE = wp.constant(8)
TILE_SLOTS = wp.constant(32)

# Cosine that the target's specular lobe takes at least, for the view and the light.
COSINE_FLOOR = wp.constant(0.02)

# Sine of the angle between a coarse mesh's triangle and the smooth surface that is looked for: light from so far below
# the triangle may arrive.
COARSE_SINE = wp.constant(0.35)


@wp.struct
class DirectOptions:
    """Settings of the direct light pass."""

    width: int
    height: int
    candidates: int
    """Light samples drawn for each pixel"""
    reuse: int
    """Most candidates taken over from the frame before, in multiples of `candidates`"""
    half_rate: int
    """1: every other pixel borrows a neighbour's sample while something moves"""
    quarter_rate: int
    """1: while only the camera moves, half of the others do without a sample too (direct_turns.py)"""
    full: int
    """1: triangles that need a test may be in the way, or radiance of lights may be a program"""
    rays: int
    """1: traced reflections bring their share of lights (reflection_lights.py)"""
    reflection: ReflectionOptions
    """Which are traced"""


@wp.struct
class Reservoirs:
    """One reservoir a pixel, 16 bytes."""

    sample: wp.array[wp.vec2ui]
    """Candidate: light, u"""
    weight: wp.array[wp.vec2]
    """W, the estimate of 1 / density of the sample; how many candidates it stands for (0: none were drawn here)"""


@wp.struct
class Reservoir:
    """One of them."""

    candidate: Candidate
    weight: float
    count: float
    lent: float
    """`weight`, limited for receivers at which the sample may be worth far more; not kept from frame to frame"""


@wp.struct
class Receiver:
    """What the target needs of a pixel: colours are luminances here."""

    position: wp.vec3
    normal: wp.vec3
    geometric_normal: wp.vec3
    wo: wp.vec3
    diffuse: float
    transmitted: float
    f0: float
    f90: float
    roughness: float
    coat: float
    coat_roughness: float
    coat_share: float
    """Of the coat in the density of reflection rays; `coat_alone`: those rays bring light to it alone"""
    coat_alone: int
    zone: float
    """reflection_lights.shown_zone; 0 without reflection rays"""


@wp.func
def tile_columns(options: DirectOptions) -> int:
    """Return how many tiles of SIDE x SIDE pixels lie in a row."""
    return (options.width + SIDE - 1) // SIDE


@wp.func
def slots_of_color(options: DirectOptions) -> int:
    """Return how many slots a colour of the checkerboard has."""
    return tile_columns(options) * ((options.height + SIDE - 1) // SIDE) * TILE_SLOTS


@wp.func
def pixel_of_slot(view: View, options: DirectOptions, slot: int) -> int:
    """Return the pixel of a slot, -1 for none.

    Slots go through one colour of the checkerboard, then through the other; the colours swap every frame. In motion
    only the first has samples of its own: the warps of the second have nothing to do but to end. A warp has a tile's
    slots: pixels that lie close together have much in common.
    """
    count = slots_of_color(options)
    color = slot // count
    tile = (slot - color * count) // TILE_SLOTS
    lane = slot % TILE_SLOTS
    row = lane // (SIDE // 2)
    columns = tile_columns(options)
    y = tile // columns * SIDE + row
    x = tile % columns * SIDE + 2 * (lane % (SIDE // 2)) + ((row + color + view.frame) & 1)
    if x >= options.width or y >= options.height:
        return -1
    return y * options.width + x


@wp.func
def slot_of_pixel(view: View, options: DirectOptions, pixel: int) -> int:
    """Return the slot of a pixel."""
    y = pixel // options.width
    x = pixel - y * options.width
    tile = y // SIDE * tile_columns(options) + x // SIDE
    lane = y % SIDE * (SIDE // 2) + x % SIDE // 2
    return ((x + y + view.frame) & 1) * slots_of_color(options) + tile * TILE_SLOTS + lane


@wp.func
def has_sample(view: View, options: DirectOptions, slot: int) -> bool:
    """Return whether a slot may have a sample and a shadow ray of its own: at rest all, in motion every other pixel.

    Where it leaves its turn out (direct_turns.py), its reservoir stands for no candidates.
    """
    return options.half_rate == 0 or view.rest > 0 or slot < slots_of_color(options)


@wp.func
def load_reservoir(reservoirs: Reservoirs, pixel: int) -> Reservoir:
    """Return a pixel's reservoir."""
    sample = reservoirs.sample[pixel]
    weight = reservoirs.weight[pixel]
    r = Reservoir()
    r.candidate.light = sample[0]
    r.candidate.u = sample[1]
    r.weight = weight[0]
    r.count = weight[1]
    return r


@wp.func
def make_receiver(
    options: DirectOptions, surface: Surface, material: SurfaceMaterial, wo: wp.vec3, weights: wp.vec3,
) -> Receiver:
    """Return what the target needs."""
    floor = wp.vec3(ALBEDO_FLOOR, ALBEDO_FLOOR, ALBEDO_FLOOR)
    p = Receiver()
    p.position = surface.position
    p.normal = surface.normal
    p.geometric_normal = surface.geometric_normal
    p.wo = wo
    p.diffuse = luminance(wp.max(material.diffuse, floor), weights)
    p.transmitted = 0.0
    if max_component(material.translucent) > 0.0:
        p.transmitted = luminance(wp.max(material.translucent, floor), weights)
    p.f0 = 0.0
    p.f90 = 0.0
    p.roughness = material.roughness
    p.coat = 0.0
    p.coat_roughness = material.coat_roughness
    p.coat_share = 0.0
    p.coat_alone = 0
    p.zone = 0.0
    if max_component(material.specular) > SPECULAR_MIN:
        p.f0 = luminance(material.f0, weights)
        p.f90 = material.f90
        if material.coat > SPECULAR_MIN:
            p.coat = material.coat
            p.coat_share = wp.clamp(material.coat / wp.max(mean_component(material.specular), 1.0e-6), 0.0, 1.0)
        if options.rays == 1:
            p.zone = shown_zone(options.reflection, material)
            if coat_alone(options.reflection, material):
                p.coat_share = 1.0
                p.coat_alone = 1
    return p


@wp.func
def load_receiver(
    view: View, gbuffer: GBuffer, options: DirectOptions, surface: Surface, pixel: int, weights: wp.vec3,
) -> Receiver:
    """Return a pixel of this frame."""
    return make_receiver(
        options, surface, load_material(gbuffer, pixel), direction_to_eye(view.camera, surface.position), weights)


@wp.func
def load_previous_receiver(
    view: View, gbuffer: GBuffer, options: DirectOptions, pixel: int, weights: wp.vec3,
) -> Receiver:
    """Return a pixel of the frame before."""
    surface = load_previous_surface(view, gbuffer, options.width, pixel)
    return make_receiver(
        options, surface, load_material(gbuffer, pixel), direction_to_eye(view.previous, surface.position), weights)


@wp.func
def lobe_estimate(alpha: float, h: float, across: float, i: float, o: float) -> float:
    """Return about a GGX lobe's value times the cosine, for Fresnel 1; above 0 wherever the lobe may be.

    The masking is Hammon's fit to Smith's ("PBR Diffuse Lighting for GGX+Smith Microsurfaces", 2017).

    Args:
        alpha: Roughness.
        h: Cosine of the half vector.
        across: Its sine, squared.
        i: Cosine of the light.
        o: That of the view.
    """
    a2 = sqr(alpha)
    spread = across + a2 * sqr(h)
    masking = 0.5 / wp.lerp(2.0 * i * o, i + o, alpha)
    return masking * i * a2 * INV_PI / wp.max(sqr(spread), 1.0e-20)


@wp.func
def specular_estimate(options: DirectOptions, p: Receiver, s: LightSample, cos_i: float) -> float:
    """Return about the luminance of all lobes' value times the cosine, of which a light sample has its share."""
    half = wp.normalize(p.wo + s.wi)
    normal = wp.cross(p.normal, half)
    across = wp.dot(normal, normal)
    h = wp.dot(p.normal, half)
    i = wp.max(cos_i, COSINE_FLOOR)
    o = wp.max(wp.dot(p.normal, p.wo), COSINE_FLOOR)
    m = wp.clamp(1.0 - wp.dot(p.wo, half), 0.0, 1.0)
    m5 = sqr(sqr(m)) * m
    roughness = p.roughness
    coat_roughness = p.coat_roughness
    if options.rays == 1:
        roughness = sample_roughness(roughness, s)
        coat_roughness = sample_roughness(coat_roughness, s)
    density = lobe_estimate(surface_alpha(roughness), h, across, i, o)
    value = (p.f0 * (1.0 - m5) + p.f90 * m5) * density
    # What rays bring no part of.
    rest = float(0.0)
    if p.coat > 0.0:
        if p.coat_alone == 1:
            rest = value
            value = 0.0
        coat = lobe_estimate(surface_alpha(coat_roughness), h, across, i, o)
        value += p.coat * coat
        density = wp.lerp(density, coat, p.coat_share)
    if p.zone > 0.0 and s.delta == 0:
        value *= light_part(density, s.pdf, p.zone)
    return value + rest


@wp.func
def target(options: DirectOptions, p: Receiver, s: LightSample, weights: wp.vec3) -> float:
    """Return what samples are resampled by: about the luminance of the light that they send to the camera."""
    if s.kind < 0:
        return 0.0
    cos_i = wp.dot(p.normal, s.wi)
    shines = (s.visibility & VISIBLE_DIFFUSE) != 0
    value = float(0.0)
    height = wp.dot(p.geometric_normal, s.wi)
    if height > 0.0 or (height > -COARSE_SINE and cos_i > 0.0):
        if shines:
            value = p.diffuse * INV_PI * wp.max(cos_i, 0.0)
        if (s.visibility & VISIBLE_GLOSSY) != 0 and p.f0 + p.f90 + p.coat > 0.0:
            value = value + specular_estimate(options, p, s, cos_i)
    elif shines:
        value = p.transmitted * INV_PI * wp.max(-cos_i, 0.0)
    value = value * luminance(s.radiance, weights) / s.pdf
    # A comparison with NaN is false.
    if value > 0.0:
        return wp.min(value, LARGE)
    return 0.0


@wp.func
def target_of(
    scene: Scene, split: EnvironmentSplit, emitters: wp.array[wp.uint64], options: DirectOptions, gbuffer: GBuffer,
    pixel: int, p: Receiver, candidate: Candidate,
) -> float:
    """Return the target of a candidate at a pixel's surface."""
    s = replay(scene, split, emitters, p.position, candidate)
    s.visibility = kinds_lit_at(scene, gbuffer, pixel, s.visibility)
    return target(options, p, s, scene.luminance)
