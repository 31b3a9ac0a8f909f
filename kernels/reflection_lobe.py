# SPDX-License-Identifier: GPL-3.0-or-later
"""The lobe into which a pixel reflects, as the filter of reflections sees it: its width and density. Functions."""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, load_material
from .geometry_math import PI, sqr
from .ggx import bounded_cap
from .normals import valid_specular_normal
from .packed_halves import unpack_halves
from .packing import unpack_normal
from .reflection_blocks import FilterCentre, ReflectionHistory
from .reflection_types import LOBE_REFLECTION, ReflectionOptions, sampled_material
from .reflection_width import filter_reach
from .specular_lobes import coat_share, surface_alpha
from .view import View, direction_to_eye, eye_position, film_position, pixel_footprint, unproject

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
    if out.reach < 1.0:
        # Where now one thing is met and now another, widths and weights by what a frame has met would go along with
        # its light: frames that missed a lamp before a far world would count for more.
        known = unpack_halves(history.state[pixel])
        if known[0] != 0.0:
            out.closeness = known[3]
    out.peak = 1.0
    if needs_densities(options, part):
        m = sampled_material(options, load_material(gbuffer, pixel))
        out.view = wo
        out.normal = valid_specular_normal(unpack_normal(gbuffer.geometric_normal[pixel]), wo, centre.normal)
        out.alpha = surface_alpha(m.roughness)
        up = wp.dot(out.normal, wo)
        share = float(0.0)
        if m.coat > 0.0:
            share = coat_share(m)
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
def known_pass(part: FilterPass, first: int) -> FilterPass:
    """Return a pass that weighs by ratios, with that and whether it is the `first` as constants.

    What other passes need is then left out of the kernel, so that more of it fit on a multiprocessor.
    """
    out = part
    out.first = first
    out.ratio = 1
    return out
