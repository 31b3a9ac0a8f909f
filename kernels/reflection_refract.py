# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that draws the first directions through glass: from the real BSDF, which the G-buffer does not hold."""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .gbuffer import GBuffer, barycentrics_of
from .gbuffer_rays import primary_ray
from .geometry_math import is_finite3, max_component
from .intersect import surface_point
from .layering import prepare_bsdf
from .nodes import run
from .packing import pack_normal
from .paths import Paths, make_hit
from .reflectance import bsdf_albedo
from .reflection_glass import sample_transmission
from .reflection_rays import (
    DIMENSION_DIRECTION,
    ReflectionRays,
    make_idle,
    ray_count,
    send_ray,
    sequence_index,
    sequence_seed,
    start_ray,
)
from .reflection_start import over_albedo
from .reflection_types import ReflectionOptions, ReflectionSamples, place_pixel
from .sampling import DIMENSION_FIRST_BOUNCE, DIMENSION_LOBE, sample_pair
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_CAMERA, VISIBLE_TRANSMISSION, Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


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
    if slot >= ray_count(rays_out, options.columns * options.rows):
        make_idle(paths_out, vertices_out, slot)
        return
    view = views[0]
    block = rays_out.block[slot]
    place = int(samples_out.place[block])
    pixel = place_pixel(options, block, place)
    ray = primary_ray(view, pixel % options.width, pixel // options.width)
    point = surface_point(
        scene, make_hit(0.0, gbuffer.hit[pixel], barycentrics_of(gbuffer, pixel)), ray.direction)
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    point.ray_length = wp.length(point.position - ray.origin)
    point.footprint = cone[0] + cone[1] * point.ray_length
    point.ray_visibility = VISIBLE_CAMERA
    point.ray_depth = 0
    seed = sequence_seed(view, options.width, pixel)
    # The closure that the G-buffer has drawn in this frame.
    choice = sample_pair(seed, wp.uint32(view.frame), DIMENSION_FIRST_BOUNCE + DIMENSION_LOBE)
    start = scene.materials.materials[point.material].surface_start
    bsdf = prepare_bsdf(scene.tables, run(scene, point, start, choice[1]), point)
    index = sequence_index(options.stride, view.frame, place)
    s = sample_transmission(bsdf, point.wo, sample_pair(seed, index, DIMENSION_DIRECTION))
    # Not that of the G-buffer, which knows of the transparent layers in front.
    weight = over_albedo(s.weight, bsdf_albedo(scene.tables, bsdf, point.wo).transmitted)
    if not (s.pdf > 0.0 and is_finite3(weight)):
        weight = wp.vec3(0.0, 0.0, 0.0)
        s.wi = ray.direction
        s.pdf = 1.0
    samples_out.direction[block] = pack_normal(s.wi)
    samples_out.pdf[block] = s.pdf
    start_ray(
        paths_out, vertices_out, rays_out, slot, seed, index, weight, s.pdf, wp.vec2(point.footprint, cone[1]))
    if max_component(weight) > 0.0:
        send_ray(paths_out, slot, point, s.wi, VISIBLE_TRANSMISSION, 1)
