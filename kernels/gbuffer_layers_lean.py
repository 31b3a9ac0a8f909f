# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as gbuffer_layers.py for scenes in which the lean node machine runs all transparency programs."""

from __future__ import annotations

import warp as wp

from .filter_lean import accept_lean
from .gbuffer_layers import layer_noise, store_found
from .gbuffer_rays import PrimaryHits, primary_ray
from .intersect import MISS
from .paths import make_hit
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_CAMERA, Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def filter_pixel(view: View, scene: Scene, width: int, hits: PrimaryHits, pixel: int):
    """Pass or stop at each layer of one pixel by chance."""
    if hits.layer[pixel][0] == MISS:
        return
    ray = primary_ray(view, pixel % width, pixel // width)
    opaque = make_hit(hits.t[pixel], hits.hit[pixel], hits.barycentrics[pixel])
    layer = make_hit(hits.layer_t[pixel], hits.layer[pixel], hits.layer_barycentrics[pixel])
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    noise = layer_noise(view, pixel, width)
    found = accept_lean(scene, ray.origin, ray.direction, opaque, layer, VISIBLE_CAMERA, 0, cone, noise)
    store_found(hits, pixel, found)


@wp.kernel(cuda_max_registers=128)
def filter_primary_lean(
    # In:
    views: wp.array[View],
    scene: Scene,
    width: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    hits_out: PrimaryHits,
):
    """Pass or stop at each layer of listed pixels by chance, see gbuffer_layers.filter_primary."""
    i = wp.tid()
    while i < count[0]:
        filter_pixel(views[0], scene, width, hits_out, queue[i])
        i = i + stride
