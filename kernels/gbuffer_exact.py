# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that packs what exact programs say into the G-buffer; gbuffer_materials.py's twin for scenes with them."""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .gbuffer_materials import store_closure, store_sky
from .gbuffer_rays import PrimaryHits, primary_ray
from .gbuffer_store import closure_number, needs_full, pixel_point
from .intersect import MISS
from .node_rays import Rays, program_start, run_exact
from .sampling import pixel_seed_of
from .types import Closure, Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def shade_exact(view: View, scene: Scene, width: int, layers: int, hits: PrimaryHits, gbuffer: GBuffer, pixel: int):
    """Fill one pixel's entry."""
    ray = primary_ray(view, pixel % width, pixel // width)
    point = pixel_point(view, scene, hits, pixel, ray)
    closure = Closure()
    start = scene.materials.world_start
    if point.instance != MISS:
        start = program_start(scene, point.material)
    if point.instance != MISS or scene.environment.constant == 0:
        rays = Rays()
        rays.seed = pixel_seed_of(
            view.camera.crop_x + pixel % width, view.camera.crop_y + pixel // width, view.camera.seed)
        rays.index = wp.uint32(view.frame)
        closure = run_exact(scene, point, start, closure_number(view, width, pixel), rays)
    if point.instance == MISS:
        store_sky(view, scene, closure.emission, layers, hits, gbuffer, pixel)
    else:
        store_closure(view, scene, point, closure, layers, hits, gbuffer, pixel)


@wp.kernel
def shade_exact_primary(
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
            shade_exact(views[0], scene, width, layers, hits, gbuffer_out, pixel)
        i = i + stride
