# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that draws the first directions through glass: from the real BSDF, which the G-buffer does not hold."""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .gbuffer import GBuffer, barycentrics_of
from .gbuffer_rays import primary_ray
from .geometry_math import is_finite3, max_component, over_albedo
from .intersect import surface_point
from .layering import prepare_bsdf
from .nodes import run
from .paths import Paths, make_hit
from .reflectance import bsdf_albedo
from .reflection_glass import sample_transmission
from .reflection_rays import (
    DIMENSION_DIRECTION,
    ReflectionRays,
    find_start,
    send_ray,
    start_ray,
)
from .reflection_types import ReflectionOptions, ReflectionSamples
from .sampling import DIMENSION_FIRST_BOUNCE, DIMENSION_LOBE, sample_pair
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_CAMERA, VISIBLE_TRANSMISSION, Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel
def start_refractions(
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
    """Draw a direction through the glass for each ray."""
    slot = first + wp.tid()
    view = views[0]
    start = find_start(view, options, samples_out, rays_out, paths_out, vertices_out, slot)
    if start.block < 0:
        return
    pixel = start.pixel
    ray = primary_ray(view, pixel % options.width, pixel // options.width)
    point = surface_point(
        scene, make_hit(0.0, gbuffer.hit[pixel], barycentrics_of(gbuffer, pixel)), ray.direction)
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    point.ray_length = wp.length(point.position - ray.origin)
    point.footprint = cone[0] + cone[1] * point.ray_length
    point.ray_visibility = VISIBLE_CAMERA
    point.ray_depth = 0
    # The closure that the G-buffer has drawn in this frame.
    choice = sample_pair(start.seed, wp.uint32(view.frame), DIMENSION_FIRST_BOUNCE + DIMENSION_LOBE)
    program = scene.materials.materials[point.material].surface_start
    bsdf = prepare_bsdf(scene.tables, run(scene, point, program, choice[1]), point)
    s = sample_transmission(bsdf, point.wo, sample_pair(start.seed, start.index, DIMENSION_DIRECTION))
    # Not that of the G-buffer, which knows of the transparent layers in front.
    weight = over_albedo(s.weight, bsdf_albedo(scene.tables, bsdf, point.wo).transmitted)
    if not (s.pdf > 0.0 and is_finite3(weight)):
        weight = wp.vec3(0.0, 0.0, 0.0)
        s.wi = ray.direction
        s.pdf = 1.0
    start_ray(
        samples_out, rays_out, paths_out, vertices_out, slot, start, s.wi, weight, s.pdf,
        wp.vec2(point.footprint, cone[1]))
    if max_component(weight) > 0.0:
        send_ray(paths_out, slot, point, s.wi, VISIBLE_TRANSMISSION, 1)
