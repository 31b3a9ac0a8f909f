# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that fill the G-buffer where the lean node machine is enough: most surfaces, and a plain world.

What they leave out is listed before they have run, so that both kinds of pixels are shaded side by side.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .gbuffer_rays import PrimaryHits, light_weight, primary_ray, veil_flag, veiled_light
from .gbuffer_store import needs_full, pixel_point, store_surface, store_world
from .intersect import MISS
from .node_lean import lean_surface, run_lean
from .pixel_order import pixel_in_blocks
from .types import MATERIAL_LEAN, Scene
from .view import View
from .wide_loads import load_material_flags, load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def shade_pixel(
    views: wp.array[View], scene: Scene, width: int, layers: int, hits: PrimaryHits, gbuffer: GBuffer, pixel: int,
):
    """Fill one pixel's entry, unless it takes the full machine (gbuffer_store.needs_full)."""
    missed = hits.hit[pixel][0] == MISS
    if missed and scene.environment.constant == 0:
        return
    view = load_view(views)
    ray = primary_ray(view, pixel % width, pixel // width)
    if missed:
        store_world(
            view, scene, veiled_light(hits, layers, pixel, scene.environment.radiance),
            veil_flag(hits, layers, pixel), gbuffer, pixel)
        return
    point = pixel_point(view, scene, hits, pixel, ray)
    program = load_material_flags(scene.materials.materials, point.material)
    if (program[3] & MATERIAL_LEAN) == 0:
        return
    closure = run_lean(scene, point, program[0])
    surface = lean_surface(scene.tables, closure, point)
    store_surface(
        view, scene, point, surface.albedo, surface.normal, surface.cosine,
        veiled_light(hits, layers, pixel, closure.emission), light_weight(hits, layers, pixel),
        veil_flag(hits, layers, pixel), gbuffer, pixel)


@wp.kernel(cuda_max_registers=96)
def shade_lean(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    height: int,
    layers: int,
    later: wp.array[wp.uint8],
    hits: PrimaryHits,
    # Out:
    gbuffer_out: GBuffer,
):
    """Fill the G-buffer but for its motion where the lean machine is enough; pixels go by pixel_in_blocks.

    `later`: not 0 at pixels that shade_lean_listed does, whose hits are not known yet; without elements there are none.
    """
    pixel = pixel_in_blocks(first + wp.tid(), width, height)
    if pixel < 0:
        return
    if later.shape[0] > 0:
        if later[pixel] != wp.uint8(0):
            return
    shade_pixel(views, scene, width, layers, hits, gbuffer_out, pixel)


@wp.kernel(cuda_max_registers=96)
def shade_lean_listed(
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
    """Do the same at listed pixels."""
    i = wp.tid()
    while i < count[0]:
        shade_pixel(views, scene, width, layers, hits, gbuffer_out, queue[i])
        i = i + stride


@wp.kernel
def append_full(
    # In:
    scene: Scene,
    width: int,
    height: int,
    hits: PrimaryHits,
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the pixels that the others leave out, in the order of pixel_in_blocks (CUDA only, see compaction.py)."""
    pixel = pixel_in_blocks(wp.tid(), width, height)
    if pixel >= 0:
        if needs_full(scene, hits, pixel):
            queue_out[wp.atomic_add(count_out, 0, 1)] = pixel
