# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that runs materials (or the world) with the full machine and packs what they say into the G-buffer.

Where a material mixes several BSDFs one is drawn with the pixel's random number of the frame, so that frames average
to the mix.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import SURFACE_SHAPED, GBuffer
from .gbuffer_rays import PrimaryHits, light_weight, primary_ray, veil_flag, veiled_light
from .gbuffer_store import closure_number, needs_full, pixel_point, store_surface, store_world
from .intersect import MISS
from .layering import prepare_bsdf
from .nodes import run
from .reflectance import bsdf_albedo
from .types import Bsdf, Closure, Scene, ShadingPoint
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def shape_flag(bsdf: Bsdf) -> wp.uint32:
    """Return SURFACE_SHAPED where light falls into lobes that the G-buffer's material doesn't have, else 0."""
    rough = bsdf.diffuse_b > 0.0 and bsdf.pick_diffuse + bsdf.pick_translucent > 0.0
    if rough or bsdf.pick_sheen > 0.0 or (bsdf.pick_specular > 0.0 and bsdf.alpha_x != bsdf.alpha_y):
        return SURFACE_SHAPED
    return wp.uint32(0)


@wp.func
def store_sky(
    view: View, scene: Scene, emission: wp.vec3, layers: int, hits: PrimaryHits, gbuffer: GBuffer, pixel: int,
):
    """Fill the entry of a pixel that shows the world; `emission`: what its program says, where it has one."""
    radiance = emission
    if scene.environment.constant == 1:
        radiance = scene.environment.radiance
    store_world(
        view, scene, veiled_light(hits, layers, pixel, radiance), veil_flag(hits, layers, pixel), gbuffer, pixel)


@wp.func
def store_closure(
    view: View, scene: Scene, point: ShadingPoint, closure: Closure, layers: int, hits: PrimaryHits, gbuffer: GBuffer,
    pixel: int,
):
    """Fill the entry of a pixel that shows a surface."""
    bsdf = prepare_bsdf(scene.tables, closure, point)
    store_surface(
        view, scene, point, bsdf_albedo(scene.tables, bsdf, point.wo), bsdf.normal,
        wp.dot(bsdf.specular_normal, point.wo), veiled_light(hits, layers, pixel, bsdf.emission),
        light_weight(hits, layers, pixel), veil_flag(hits, layers, pixel) | shape_flag(bsdf), gbuffer, pixel)


@wp.func
def shade_pixel(view: View, scene: Scene, width: int, layers: int, hits: PrimaryHits, gbuffer: GBuffer, pixel: int):
    """Fill one pixel's entry."""
    ray = primary_ray(view, pixel % width, pixel // width)
    point = pixel_point(view, scene, hits, pixel, ray)
    closure = Closure()
    start = scene.materials.world_start
    if point.instance != MISS:
        start = scene.materials.materials[point.material].surface_start
    if point.instance != MISS or scene.environment.constant == 0:
        # One call of the machine for both, see reference.py.
        closure = run(scene, point, start, closure_number(view, width, pixel))
    if point.instance == MISS:
        store_sky(view, scene, closure.emission, layers, hits, gbuffer, pixel)
    else:
        store_closure(view, scene, point, closure, layers, hits, gbuffer, pixel)


@wp.kernel
def shade_primary(
    # In:
    views: wp.array[View],
    scene: Scene,
    width: int,
    layers: int,
    hits: PrimaryHits,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    gbuffer_out: GBuffer,
):
    """Fill the G-buffer but for its motion at those of the listed pixels that gbuffer_lean.py leaves out."""
    i = wp.tid()
    while i < count[0]:
        pixel = queue[i]
        if needs_full(scene, hits, pixel):
            shade_pixel(views[0], scene, width, layers, hits, gbuffer_out, pixel)
        i = i + stride
