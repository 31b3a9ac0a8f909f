# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as gbuffer_layers.py for scenes in which the lean node machine runs all transparency programs."""

from __future__ import annotations

import warp as wp

from .filter_lean import WALK_ON, WALK_STOPPED, LayerWalk, accept_layer, start_walk
from .gbuffer_layers import layer_seed, store_stop
from .gbuffer_rays import PrimaryHits, primary_ray
from .intersect import MISS
from .paths import make_hit
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_CAMERA, Scene
from .view import View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def meet_pixel_layer(
    view: View, scene: Scene, width: int, hits: PrimaryHits, pixel: int, walk: LayerWalk,
) -> LayerWalk:
    """Pass or stop at one layer of a pixel by chance."""
    ray = primary_ray(view, pixel % width, pixel // width)
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    return accept_layer(
        scene, walk, ray.origin, ray.direction, hits.t[pixel], VISIBLE_CAMERA, 0, cone,
        layer_seed(view, pixel, width), wp.uint32(view.frame))


@wp.kernel(cuda_max_registers=128)
def filter_primary_lean(
    # In:
    views: wp.array[View],
    scene: Scene,
    width: int,
    lit: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    hits_out: PrimaryHits,
):
    """Pass or stop at each layer of listed pixels by chance, see gbuffer_layers.filter_primary.

    `lit` 1: gbuffer_behind.py has found what shines behind them.
    """
    i = wp.tid()
    pixel = int(-1)
    walk = LayerWalk()
    while pixel >= 0 or i < count[0]:
        if pixel < 0:
            pixel = queue[i]
            i = i + stride
            walk = start_walk(make_hit(hits_out.layer_t[pixel], hits_out.layer[pixel],
                                       hits_out.layer_barycentrics[pixel]))
            if walk.hit.instance == MISS:
                pixel = int(-1)
        if pixel >= 0:
            walk = meet_pixel_layer(load_view(views), scene, width, hits_out, pixel, walk)
            if walk.state != WALK_ON:
                if walk.state == WALK_STOPPED:
                    store_stop(hits_out, pixel, walk.hit, lit)
                hits_out.weight[pixel] = walk.weight
                pixel = int(-1)
