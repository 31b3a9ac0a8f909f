# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that draws the first directions of final gather rays: evenly by the cosine.

Final gather (Ward et al. 1988; Jensen 1996): a ray of its own for each pixel finds contacts and corners, which screen
probes are too far apart for; where it ends the radiance cache answers.
"""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices
from .gbuffer import GBuffer, barycentrics_of, load_surface, view_direction
from .geometry_math import INV_PI, to_frame
from .intersect import surface_point
from .normals import bump_shadowing
from .paths import Paths, make_hit
from .reflection_rays import (
    DIMENSION_DIRECTION,
    ReflectionRays,
    find_start,
    send_ray,
    start_ray,
)
from .reflection_types import ReflectionOptions, ReflectionSamples
from .sampling import sample_cosine, sample_pair
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_DIFFUSE, Scene
from .view import View, pixel_footprint

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Least density [1/sr] of a direction: samples must have one.
PDF_MIN = wp.constant(1.0e-6)


@wp.kernel
def start_gathering(
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

    One that lies on the wrong side of the triangle is absorbed, as in the path tracer: a black sample.
    """
    slot = first + wp.tid()
    view = views[0]
    start = find_start(view, options, samples_out, rays_out, paths_out, vertices_out, slot)
    if start.block < 0:
        return
    pixel = start.pixel
    surface = load_surface(view, gbuffer, options.width, pixel)
    point = surface_point(
        scene, make_hit(0.0, gbuffer.hit[pixel], barycentrics_of(gbuffer, pixel)), -view_direction(view, surface))
    local = sample_cosine(sample_pair(start.seed, start.index, DIMENSION_DIRECTION))
    direction = wp.normalize(to_frame(surface.normal, local))
    pdf = wp.max(local[2] * INV_PI, PDF_MIN)
    shadow = float(0.0)
    if wp.dot(direction, point.geometric_normal) > 0.0:
        shadow = bump_shadowing(surface.normal, point.normal, direction, True, True)
    weight = wp.vec3(shadow, shadow, shadow)
    footprint = pixel_footprint(view.camera, surface.depth) * FOOTPRINT_SCALE
    start_ray(
        samples_out, rays_out, paths_out, vertices_out, slot, start, direction, weight, pdf,
        wp.vec2(footprint, view.camera.spread * FOOTPRINT_SCALE))
    if shadow > 0.0:
        send_ray(scene, paths_out, slot, point, direction, VISIBLE_DIFFUSE, 1)
