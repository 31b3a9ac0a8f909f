# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that finds which pixels show hair, how its strands run over the film, and which of them get a ray."""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, load_surface
from .geometry_math import PI, transform_direction
from .hair_exit import piece_of
from .intersect import MISS, triangle_material
from .reflection_rays import ReflectionRays, place_of_frame
from .reflection_types import (
    NO_SAMPLE,
    SOURCE_NONE,
    SOURCE_RAY,
    ReflectionOptions,
    ReflectionSamples,
    place_pixel,
)
from .types import HOLDOUT, MATERIAL_STRANDS, Scene
from .view import View, pixel_footprint, project
from .wide_loads import load_instance, load_material_flags

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def scatters_as_hair(scene: Scene, instance: int, triangle: int) -> bool:
    """Return whether a triangle's material scatters light as hair does, and not otherwise."""
    if instance == MISS:
        return False
    material = triangle_material(scene, instance, triangle)
    return (load_material_flags(scene.materials.materials, material)[3] & MATERIAL_STRANDS) != 0


@wp.func
def strand_mark(view: View, scene: Scene, gbuffer: GBuffer, width: int, pixel: int) -> wp.uint8:
    """Return in which direction the strand that a pixel shows runs over the film: 1 to 255 for half a turn."""
    hit = gbuffer.hit[pixel]
    instance = load_instance(scene.geometry.instances, hit[0])
    way = wp.normalize(transform_direction(instance.to_world, piece_of(scene.geometry, hit[1]).way))
    surface = load_surface(view, gbuffer, width, pixel)
    here = project(view.camera, surface.position)
    there = project(view.camera, surface.position + way * pixel_footprint(view.camera, surface.depth))
    turn = wp.atan2(there[1] - here[1], there[0] - here[0]) / PI
    if not wp.isfinite(turn):
        turn = 0.0
    return wp.uint8(1.0 + 254.0 * wp.clamp(turn - wp.floor(turn), 0.0, 1.0))


@wp.kernel
def find_hair(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    options: ReflectionOptions,
    gbuffer: GBuffer,
    # Out:
    shown_out: wp.array[wp.uint8],
    samples_out: ReflectionSamples,
    rays_out: ReflectionRays,
):
    """Note which pixels show hair, and choose one in each block that gets a ray; see place_samples."""
    block = first + wp.tid()
    view = views[0]
    places = options.stride * options.stride
    found = int(-1)
    k = int(0)
    while k < places:
        place = place_of_frame(options.stride, view.frame + k)
        pixel = place_pixel(options, block, place)
        if pixel >= 0:
            hit = gbuffer.hit[pixel]
            shows = scatters_as_hair(scene, hit[0], hit[1])
            if shows:
                shows = (load_instance(scene.geometry.instances, hit[0]).visibility & HOLDOUT) == 0
            mark = wp.uint8(0)
            if shows:
                mark = strand_mark(view, scene, gbuffer, options.width, pixel)
            shown_out[pixel] = mark
            if shows and found < 0:
                found = place
        k = k + 1
    samples_out.place[block] = wp.where(found < 0, NO_SAMPLE, wp.uint8(found))
    samples_out.pdf[block] = 0.0
    rays_out.source[block] = wp.where(found < 0, SOURCE_NONE, SOURCE_RAY)
    rays_out.flag[block] = wp.where(found < 0, 0, 1)
