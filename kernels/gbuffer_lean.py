# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that fills the G-buffer where the lean node machine is enough: most surfaces, and a plain world."""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .gbuffer_rays import PrimaryHits, light_weight, primary_ray, veil_flag, veiled_light
from .gbuffer_store import LEFT, pixel_point, store_surface, store_world
from .intersect import MISS
from .node_lean import lean_surface, run_lean
from .pixel_order import pixel_in_blocks
from .types import MATERIAL_LEAN, Scene
from .view import View
from .wide_loads import load_material_flags, load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.kernel(cuda_max_registers=96)
def shade_lean(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    height: int,
    layers: int,
    hits: PrimaryHits,
    # Out:
    gbuffer_out: GBuffer,
):
    """Fill the G-buffer but for its motion; where that takes the full machine only note that (LEFT).

    Pixels go by pixel_in_blocks.
    """
    pixel = pixel_in_blocks(first + wp.tid(), width, height)
    if pixel < 0:
        return
    missed = hits.hit[pixel][0] == MISS
    if missed and scene.environment.constant == 0:
        gbuffer_out.hit[pixel] = wp.vec2i(LEFT, LEFT)
        return
    view = load_view(views)
    ray = primary_ray(view, pixel % width, pixel // width)
    if missed:
        store_world(
            view, scene, veiled_light(hits, layers, pixel, scene.environment.radiance),
            veil_flag(hits, layers, pixel), gbuffer_out, pixel)
        return
    point = pixel_point(view, scene, hits, pixel, ray)
    program = load_material_flags(scene.materials.materials, point.material)
    if (program[3] & MATERIAL_LEAN) == 0:
        gbuffer_out.hit[pixel] = wp.vec2i(LEFT, LEFT)
        return
    closure = run_lean(scene, point, program[0])
    surface = lean_surface(scene.tables, closure, point)
    store_surface(
        view, scene, point, surface.albedo, surface.normal, surface.cosine,
        veiled_light(hits, layers, pixel, closure.emission), light_weight(hits, layers, pixel),
        veil_flag(hits, layers, pixel), gbuffer_out, pixel)
