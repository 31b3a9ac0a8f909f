# SPDX-License-Identifier: GPL-3.0-or-later
"""Direct light from the chosen samples and what their shadow rays found.

A pixel without a shadow ray of its own takes its neighbours' word for it: their samples are replayed for its own
surface, and what share of that light got through weakens the pixel's own unshadowed sample. So normals, textures and
reflections keep the full resolution, and the share lies in 0..1 however unlike the neighbours are.
"""

from __future__ import annotations

import warp as wp

from .direct_light import DirectLight
from .direct_reservoir import (
    LARGE,
    UNTRACED,
    DirectOptions,
    LitSurface,
    Reservoirs,
    Shadows,
    lends_shadow,
    light_terms,
    load_lit,
    load_reservoir,
    neighbour_of,
    target,
    traces_itself,
)
from .environment_split import EnvironmentSplit, excess_radiance
from .gbuffer import GBuffer, has_surface
from .geometry_math import is_finite3, luminance
from .light_candidate import replay
from .lights import LightSample
from .packing import from_half, rgb, rgba, to_half
from .paths import PENDING_NONE, PENDING_WORLD, Paths
from .types import Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def visibility_of(options: DirectOptions, rays: Paths, shadows: Shadows, pixel: int) -> wp.vec3:
    """Return the transmittance that a pixel's shadow ray found."""
    if options.full == 1:
        return rgb(from_half(shadows.visibility[pixel]))
    reached = wp.where(rays.shadow_distance[pixel] != 0.0, 1.0, 0.0)
    return wp.vec3(reached, reached, reached)


@wp.func
def true_radiance(
    scene: Scene, split: EnvironmentSplit, options: DirectOptions, rays: Paths, shadows: Shadows, s: LightSample,
    pixel: int,
) -> wp.vec3:
    """Return a light's radiance over that for which its sample was taken: 1 but for programs."""
    if options.full == 0:
        return wp.vec3(1.0, 1.0, 1.0)
    program = int(shadows.program[pixel]) & (UNTRACED - 1)
    if program == PENDING_NONE:
        return wp.vec3(1.0, 1.0, 1.0)
    radiance = rgb(rays.radiance[pixel])
    if program == PENDING_WORLD:
        radiance = excess_radiance(radiance, split.threshold, scene.luminance)
    return radiance / wp.max(luminance(s.radiance, scene.luminance), 1.0e-30)


@wp.func
def borrowed_visibility(
    view: View, scene: Scene, split: EnvironmentSplit, options: DirectOptions, gbuffer: GBuffer,
    reservoirs: Reservoirs, rays: Paths, shadows: Shadows, p: LitSurface, pixel: int,
) -> wp.vec3:
    """Return the share of unshadowed light that the neighbours' rays found to arrive."""
    lit = wp.vec3(0.0, 0.0, 0.0)
    total = float(0.0)
    k = int(0)
    while k < 4:
        if lends_shadow(view, options, gbuffer, reservoirs, p.surface, pixel, k):
            q = neighbour_of(options, pixel, k)
            r = load_reservoir(reservoirs, q)
            s = replay(scene, split, options.local_power, p.surface.position, r.candidate)
            weight = target(scene, p, light_terms(p, s)) * r.weight
            # Where no neighbour's light reaches this surface they count alike.
            weight = wp.max(weight, 1.0e-12)
            if weight < LARGE:
                lit = lit + visibility_of(options, rays, shadows, q) * weight
                total = total + weight
        k = k + 1
    return lit / wp.max(total, 1.0e-30)


@wp.kernel
def shade_direct(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    split: EnvironmentSplit,
    options: DirectOptions,
    gbuffer: GBuffer,
    reservoirs: Reservoirs,
    rays: Paths,
    shadows: Shadows,
    # Out:
    light_out: DirectLight,
):
    """Write each pixel's direct light, without colours, exposed."""
    pixel = first + wp.tid()
    view = views[0]
    diffuse = wp.vec3(0.0, 0.0, 0.0)
    specular = wp.vec3(0.0, 0.0, 0.0)
    r = load_reservoir(reservoirs, pixel)
    p = load_lit(view, gbuffer, options.width, pixel)
    if r.weight > 0.0 and has_surface(p.surface):
        s = replay(scene, split, options.local_power, p.surface.position, r.candidate)
        terms = light_terms(p, s)
        seen = wp.vec3(0.0, 0.0, 0.0)
        if traces_itself(view, options, gbuffer, reservoirs, p.surface, pixel):
            seen = visibility_of(options, rays, shadows, pixel)
        else:
            seen = borrowed_visibility(
                view, scene, split, options, gbuffer, reservoirs, rays, shadows, p, pixel)
        share = wp.cw_mul(seen, true_radiance(scene, split, options, rays, shadows, s, pixel))
        share = share * (r.weight * view.exposure)
        diffuse = wp.cw_mul(terms.diffuse, share)
        specular = wp.cw_mul(terms.specular, share)
        if not (is_finite3(diffuse) and is_finite3(specular)):
            diffuse = wp.vec3(0.0, 0.0, 0.0)
            specular = wp.vec3(0.0, 0.0, 0.0)
    light_out.diffuse[pixel] = to_half(rgba(diffuse, 1.0))
    light_out.specular[pixel] = to_half(rgba(specular, 1.0))
