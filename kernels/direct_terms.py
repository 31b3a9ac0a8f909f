# SPDX-License-Identifier: GPL-3.0-or-later
"""What a light sample gives a pixel's surface: the exact light, by the material's own lobes, without its colours."""

from __future__ import annotations

import warp as wp

from .direct_reservoir import SPECULAR_MIN, DirectOptions
from .environment_split import EnvironmentSplit
from .gbuffer import GBuffer, Surface, SurfaceMaterial, barycentrics_of, load_material
from .geometry_math import is_finite3, max_component
from .intersect import surface_point
from .lamp_sample import LightSample
from .light_candidate import Candidate
from .paths import make_hit
from .reflection_lights import is_singular, light_side_share, sample_roughness, shown_zone
from .reflection_types import coat_alone, sampled_material
from .specular_lobes import lobes_pdf, lobes_value, specular_lobes
from .surface_brdf import evaluate_brdf
from .types import VISIBLE_DIFFUSE, VISIBLE_GLOSSY, Scene, ShadingPoint
from .view import View, direction_to_eye

# Where no reflection rays help, samples of a light seldom meet a sharper lobe, which would be sparks; path tracing
# shows it at rest.
LEAST_ROUGHNESS = wp.constant(0.15)


@wp.struct
class LitSurface:
    """A pixel's surface, ready to be lit."""

    surface: Surface
    material: SurfaceMaterial
    """Diffuse and translucent albedo divided by their sum"""
    smooth: wp.vec3
    """Interpolated normal, see evaluate_brdf"""
    wo: wp.vec3


@wp.struct
class LightTerms:
    """Unshadowed light of one sample divided by its pdf, without the surface's colours."""

    diffuse: wp.vec3
    specular: wp.vec3


@wp.func
def share_of(part: float, whole: float) -> float:
    """Return part / whole; 1 where the whole is nothing."""
    return wp.where(whole > 0.0, part / wp.max(whole, 1.0e-30), 1.0)


@wp.func
def lit_point(view: View, scene: Scene, gbuffer: GBuffer, surface: Surface, pixel: int) -> ShadingPoint:
    """Return the point that a pixel shows, from its G-buffer entry."""
    hit = make_hit(surface.depth, gbuffer.hit[pixel], barycentrics_of(gbuffer, pixel))
    return surface_point(scene, hit, -direction_to_eye(view.camera, surface.position))


@wp.func
def load_lit(view: View, gbuffer: GBuffer, surface: Surface, smooth: wp.vec3, pixel: int) -> LitSurface:
    """Return a pixel of this frame without its diffuse colours; `smooth` is its interpolated normal."""
    p = LitSurface()
    p.surface = surface
    p.smooth = smooth
    p.material = load_material(gbuffer, pixel)
    diffuse = p.material.diffuse
    albedo = diffuse + p.material.translucent
    p.material.diffuse = wp.vec3(
        share_of(diffuse[0], albedo[0]), share_of(diffuse[1], albedo[1]), share_of(diffuse[2], albedo[2]))
    p.material.translucent = wp.vec3(1.0, 1.0, 1.0) - p.material.diffuse
    p.wo = direction_to_eye(view.camera, surface.position)
    return p


@wp.func
def divide_color(value: wp.vec3, albedo: wp.vec3) -> wp.vec3:
    """Take the specular albedo out of a specular value."""
    return wp.vec3(
        wp.where(albedo[0] > SPECULAR_MIN, value[0] / wp.max(albedo[0], SPECULAR_MIN), 0.0),
        wp.where(albedo[1] > SPECULAR_MIN, value[1] / wp.max(albedo[1], SPECULAR_MIN), 0.0),
        wp.where(albedo[2] > SPECULAR_MIN, value[2] / wp.max(albedo[2], SPECULAR_MIN), 0.0))


@wp.func
def lit_material(options: DirectOptions, m: SurfaceMaterial, s: LightSample) -> SurfaceMaterial:
    """Return a material as a light sample shows it: no lobe sharper than what such samples can meet."""
    if options.rays == 0:
        m.roughness = wp.max(m.roughness, LEAST_ROUGHNESS)
        m.coat_roughness = wp.max(m.coat_roughness, LEAST_ROUGHNESS)
        return m
    if s.delta == 1:
        # A mirror shows no light without size.
        if is_singular(m.roughness):
            m.f0 = wp.vec3(0.0, 0.0, 0.0)
            m.f90 = 0.0
        if is_singular(m.coat_roughness):
            m.coat = 0.0
    m.roughness = sample_roughness(m.roughness, s)
    m.coat_roughness = sample_roughness(m.coat_roughness, s)
    return m


@wp.func
def light_terms(
    scene: Scene, split: EnvironmentSplit, options: DirectOptions, p: LitSurface, candidate: Candidate, s: LightSample,
) -> LightTerms:
    """Return what a light sample gives a surface; light switched off for a kind of ray is left out."""
    terms = LightTerms()
    terms.diffuse = wp.vec3(0.0, 0.0, 0.0)
    terms.specular = wp.vec3(0.0, 0.0, 0.0)
    if s.kind < 0:
        return terms
    lit = lit_material(options, p.material, s)
    f = evaluate_brdf(lit, p.surface, p.smooth, p.wo, s.wi)
    light = s.radiance / s.pdf
    if (s.visibility & VISIBLE_DIFFUSE) != 0:
        terms.diffuse = wp.cw_mul(f.diffuse + f.transmitted, light)
    if (s.visibility & VISIBLE_GLOSSY) != 0 and max_component(f.specular) > 0.0:
        value = f.specular
        if options.rays == 1:
            zone = shown_zone(options.reflection, p.material)
            if zone > 0.0:
                sampled = sampled_material(options.reflection, p.material)
                density = lobes_pdf(specular_lobes(sampled, p.surface, p.wo), s.wi)
                share = light_side_share(scene, split, candidate, s, p.surface.position, density, zone)
                if coat_alone(options.reflection, p.material):
                    # The base has all of its light from samples.
                    rest = lit
                    rest.coat = 0.0
                    value = lobes_value(rest, specular_lobes(rest, p.surface, p.wo), s.wi)
                    value += wp.max(f.specular - value, wp.vec3(0.0, 0.0, 0.0)) * share
                else:
                    value = value * share
        terms.specular = divide_color(wp.cw_mul(value, light), p.material.specular)
    return terms


@wp.func
def scaled_terms(terms: LightTerms, factor: wp.vec3) -> LightTerms:
    """Return light times a factor; black where that is not finite."""
    out = LightTerms()
    out.diffuse = wp.cw_mul(terms.diffuse, factor)
    out.specular = wp.cw_mul(terms.specular, factor)
    if not (is_finite3(out.diffuse) and is_finite3(out.specular)):
        out.diffuse = wp.vec3(0.0, 0.0, 0.0)
        out.specular = wp.vec3(0.0, 0.0, 0.0)
    return out
