# SPDX-License-Identifier: GPL-3.0-or-later
"""Reservoirs of light samples and what they are weighed by: the light that a sample sends to the camera, unshadowed.

Resampled importance sampling (Talbot et al. 2005; Bitterli et al. 2020). Light is kept without the surface's colours
(demodulated), and the target takes dark colours for a little brighter: a black texel must hold light that its
neighbours' filters can use.
"""

from __future__ import annotations

import warp as wp

from .environment_split import EnvironmentSplit
from .gbuffer import (
    GBuffer,
    Surface,
    SurfaceMaterial,
    has_surface,
    load_material,
    load_previous_surface,
    load_surface,
    plane_distance,
)
from .geometry_math import is_finite3, luminance
from .light_candidate import Candidate, replay
from .lights import LightSample
from .surface_brdf import evaluate_brdf
from .types import VISIBLE_DIFFUSE, VISIBLE_GLOSSY, Scene
from .view import View, direction_to_eye, pixel_footprint

# Diffuse albedo that the target takes at least.
ALBEDO_FLOOR = wp.constant(0.02)

# Specular albedo below which the specular lobe is not drawn: 8-bit pictures can't show it.
SPECULAR_MIN = wp.constant(1.0e-4)

# Largest target and weight that are kept: products of two still fit a float.
LARGE = wp.constant(1.0e18)

# Cosine between the normals of neighbours that may lend each other their shadow rays.
NEIGHBOUR_COSINE = wp.constant(0.9)

# Shadows.program
UNTRACED = wp.constant(4)


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
    """1: every other pixel borrows its neighbours' shadow rays while something moves"""
    full: int
    """1: triangles that need a test may be in the way, or radiance of lights may be a program"""
    local_power: float
    """Power of all lamps with a place and all emissive triangles [W]"""


@wp.struct
class Reservoirs:
    """One reservoir a pixel, 16 bytes."""

    sample: wp.array[wp.vec2ui]
    """Candidate: light, u"""
    weight: wp.array[wp.vec2]
    """W, the estimate of 1 / density of the sample; how many candidates it stands for"""


@wp.struct
class Shadows:
    """What came of the shadow rays where layers or programs are involved; else their distance says it all."""

    visibility: wp.array[wp.vec4h]
    """Transmittance in xyz"""
    program: wp.array[wp.uint8]
    """PENDING_* of the pixel's light, | UNTRACED where the pixel has no shadow ray of its own"""


@wp.struct
class Reservoir:
    """One of them."""

    candidate: Candidate
    weight: float
    count: float
    value: float
    """Target of the candidate where it was drawn; not kept from frame to frame"""


@wp.struct
class LitSurface:
    """A pixel's surface, ready to be lit."""

    surface: Surface
    material: SurfaceMaterial
    """Diffuse and translucent albedo divided by their sum"""
    albedo: wp.vec3
    """Their sum"""
    wo: wp.vec3


@wp.struct
class LightTerms:
    """Unshadowed light of one sample divided by its pdf, without the surface's colours."""

    diffuse: wp.vec3
    specular: wp.vec3


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
def share_of(part: float, whole: float) -> float:
    """Return part / whole; 1 where the whole is nothing."""
    return wp.where(whole > 0.0, part / wp.max(whole, 1.0e-30), 1.0)


@wp.func
def make_lit(surface: Surface, material: SurfaceMaterial, wo: wp.vec3) -> LitSurface:
    """Take the colours out of a material."""
    p = LitSurface()
    p.surface = surface
    p.material = material
    p.albedo = material.diffuse + material.translucent
    p.material.diffuse = wp.vec3(
        share_of(material.diffuse[0], p.albedo[0]), share_of(material.diffuse[1], p.albedo[1]),
        share_of(material.diffuse[2], p.albedo[2]))
    p.material.translucent = wp.vec3(1.0, 1.0, 1.0) - p.material.diffuse
    p.wo = wo
    return p


@wp.func
def load_lit(view: View, gbuffer: GBuffer, width: int, pixel: int) -> LitSurface:
    """Return a pixel of this frame."""
    surface = load_surface(view, gbuffer, width, pixel)
    return make_lit(surface, load_material(gbuffer, pixel), direction_to_eye(view.camera, surface.position))


@wp.func
def load_previous_lit(view: View, gbuffer: GBuffer, width: int, pixel: int) -> LitSurface:
    """Return a pixel of the frame before."""
    surface = load_previous_surface(view, gbuffer, width, pixel)
    return make_lit(surface, load_material(gbuffer, pixel), direction_to_eye(view.previous, surface.position))


@wp.func
def divide_color(value: wp.vec3, albedo: wp.vec3) -> wp.vec3:
    """Take the specular albedo out of a specular value."""
    return wp.vec3(
        wp.where(albedo[0] > SPECULAR_MIN, value[0] / wp.max(albedo[0], SPECULAR_MIN), 0.0),
        wp.where(albedo[1] > SPECULAR_MIN, value[1] / wp.max(albedo[1], SPECULAR_MIN), 0.0),
        wp.where(albedo[2] > SPECULAR_MIN, value[2] / wp.max(albedo[2], SPECULAR_MIN), 0.0))


@wp.func
def light_terms(p: LitSurface, s: LightSample) -> LightTerms:
    """Return what a light sample gives a surface; light switched off for a kind of ray is left out."""
    terms = LightTerms()
    terms.diffuse = wp.vec3(0.0, 0.0, 0.0)
    terms.specular = wp.vec3(0.0, 0.0, 0.0)
    if s.kind < 0:
        return terms
    f = evaluate_brdf(p.material, p.surface, p.wo, s.wi)
    light = s.radiance / s.pdf
    if (s.visibility & VISIBLE_DIFFUSE) != 0:
        terms.diffuse = wp.cw_mul(f.diffuse + f.transmitted, light)
    if (s.visibility & VISIBLE_GLOSSY) != 0:
        terms.specular = divide_color(wp.cw_mul(f.specular, light), p.material.specular)
    if not (is_finite3(terms.diffuse) and is_finite3(terms.specular)):
        terms.diffuse = wp.vec3(0.0, 0.0, 0.0)
        terms.specular = wp.vec3(0.0, 0.0, 0.0)
    return terms


@wp.func
def target(scene: Scene, p: LitSurface, terms: LightTerms) -> float:
    """Return what samples are resampled by: the luminance of the light that they send to the camera."""
    albedo = wp.max(p.albedo, wp.vec3(ALBEDO_FLOOR, ALBEDO_FLOOR, ALBEDO_FLOOR))
    color = wp.cw_mul(terms.diffuse, albedo) + wp.cw_mul(terms.specular, p.material.specular)
    value = luminance(color, scene.luminance)
    # A comparison with NaN is false.
    if value > 0.0:
        return wp.min(value, LARGE)
    return 0.0


@wp.func
def target_of(
    scene: Scene, split: EnvironmentSplit, options: DirectOptions, p: LitSurface, candidate: Candidate,
) -> float:
    """Return the target of a candidate at a surface."""
    s = replay(scene, split, options.local_power, p.surface.position, candidate)
    return target(scene, p, light_terms(p, s))


@wp.func
def neighbour_of(options: DirectOptions, pixel: int, k: int) -> int:
    """Return the pixel to the left, right, below or above (k = 0..3), -1 outside of the picture; k = 4: itself."""
    x = pixel % options.width
    y = pixel // options.width
    if k == 0:
        x = x - 1
    if k == 1:
        x = x + 1
    if k == 2:
        y = y - 1
    if k == 3:
        y = y + 1
    if x < 0 or x >= options.width or y < 0 or y >= options.height:
        return -1
    return y * options.width + x


@wp.func
def lends_shadow(
    view: View, options: DirectOptions, gbuffer: GBuffer, reservoirs: Reservoirs, surface: Surface, pixel: int, k: int,
) -> bool:
    """Return whether neighbour k has a sample on the same surface, so that its shadow ray counts here too."""
    q = neighbour_of(options, pixel, k)
    if q < 0:
        return False
    if not (reservoirs.weight[q][0] > 0.0):
        return False
    other = load_surface(view, gbuffer, options.width, q)
    if not has_surface(other):
        return False
    tolerance = 2.0 * pixel_footprint(view.camera, surface.depth)
    return (wp.dot(other.normal, surface.normal) > NEIGHBOUR_COSINE
            and wp.dot(other.geometric_normal, surface.geometric_normal) > NEIGHBOUR_COSINE
            and plane_distance(surface, other.position) < tolerance)


@wp.func
def traces_itself(
    view: View, options: DirectOptions, gbuffer: GBuffer, reservoirs: Reservoirs, surface: Surface, pixel: int,
) -> bool:
    """Return whether a pixel has a shadow ray of its own: at rest all, in motion every other and those left alone."""
    if options.half_rate == 0 or view.rest > 0:
        return True
    x = pixel % options.width
    y = pixel // options.width
    if ((x + y + view.frame) & 1) == 0:
        return True
    k = int(0)
    while k < 4:
        if lends_shadow(view, options, gbuffer, reservoirs, surface, pixel, k):
            return False
        k = k + 1
    return True
