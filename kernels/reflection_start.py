# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that draws the first directions of reflection rays, from the G-buffer's lobes."""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .gbuffer import GBuffer, barycentrics_of, load_material, load_surface, view_direction
from .geometry_math import is_finite3, max_component, over_albedo, sqr
from .ggx import bounded_cap, ggx_d
from .intersect import surface_point
from .paths import Paths, make_hit
from .reflection_rays import (
    DIMENSION_DIRECTION,
    DIMENSION_LOBE,
    ReflectionRays,
    find_start,
    send_ray,
    start_ray,
)
from .reflection_types import ReflectionOptions, ReflectionSamples, sampled_material
from .sampling import sample_number, sample_pair
from .specular_lobes import SpecularLobes, lobe_frame, lobes_pdf, lobes_value, sample_lobes, specular_lobes
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_GLOSSY, Scene
from .view import View, pixel_footprint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def drawing_density(local_o: wp.vec3, local_i: wp.vec3, alpha: float) -> float:
    """Return the density of sample_ggx_reflection, below the surface too."""
    if local_o[2] <= 0.0:
        return 0.0
    d = ggx_d(wp.normalize(local_o + local_i), alpha, alpha)
    length = wp.sqrt(sqr(alpha) * (sqr(local_o[0]) + sqr(local_o[1])) + sqr(local_o[2]))
    return d / (2.0 * (bounded_cap(local_o, alpha, alpha) * local_o[2] + length))


@wp.func
def drawn_pdf(lobes: SpecularLobes, wi: wp.vec3) -> float:
    """Return the density with which sample_lobes has drawn a direction, whether or not it leaves the surface."""
    local_i = lobe_frame(lobes, wi)
    pdf = drawing_density(lobes.local_o, local_i, lobes.alpha) * (1.0 - lobes.coat_share)
    if lobes.coat_share > 0.0:
        pdf += drawing_density(lobes.local_o, local_i, lobes.coat_alpha) * lobes.coat_share
    return pdf


@wp.kernel
def start_reflections(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    # Out:
    samples_out: ReflectionSamples,
    rays_out: ReflectionRays,
    paths_out: Paths,
    vertices_out: Vertices,
):
    """Draw a direction for each ray.

    One that lies below the surface is absorbed, as in the path tracer: a black sample, for which the albedo accounts.
    """
    slot = first + wp.tid()
    view = views[0]
    start = find_start(view, options, samples_out, rays_out, paths_out, vertices_out, slot)
    if start.block < 0:
        return
    pixel = start.pixel
    m = sampled_material(options, load_material(gbuffer, pixel))
    surface = load_surface(view, gbuffer, options.width, pixel)
    wo = view_direction(view, surface)
    lobes = specular_lobes(m, surface, wo)
    pick = sample_number(start.seed, start.index, DIMENSION_LOBE)
    direction = sample_lobes(lobes, sample_pair(start.seed, start.index, DIMENSION_DIRECTION), pick)
    pdf = lobes_pdf(lobes, direction)
    weight = wp.vec3(0.0, 0.0, 0.0)
    if pdf > 0.0:
        weight = over_albedo(lobes_value(m, lobes, direction) / pdf, m.specular)
        if not is_finite3(weight):
            weight = wp.vec3(0.0, 0.0, 0.0)
    drawn = wp.max(drawn_pdf(lobes, direction), 1.0e-6)
    if not wp.isfinite(drawn):
        drawn = 1.0e-6
    footprint = pixel_footprint(view.camera, surface.depth) * FOOTPRINT_SCALE
    cone = wp.vec2(footprint, view.camera.spread * FOOTPRINT_SCALE)
    start_ray(samples_out, rays_out, paths_out, vertices_out, slot, start, direction, weight, drawn, cone)
    if wp.dot(direction, surface.geometric_normal) > 0.0 and max_component(weight) > 0.0:
        point = surface_point(scene, make_hit(0.0, gbuffer.hit[pixel], barycentrics_of(gbuffer, pixel)), -wo)
        send_ray(scene, paths_out, slot, point, direction, VISIBLE_GLOSSY, 1)
