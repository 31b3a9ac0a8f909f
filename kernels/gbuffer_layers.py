# SPDX-License-Identifier: GPL-3.0-or-later
"""The real-time frame's kernel that looks through transparent layers in front of what a pixel shows."""

from __future__ import annotations

import warp as wp

from .filter import accept_hit
from .gbuffer_rays import PrimaryHits, primary_ray
from .intersect import MISS, Hit
from .layers import LAYER_STREAM
from .paths import make_hit
from .sampling import hash_combine, pixel_seed_of
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_CAMERA, Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def layer_seed(view: View, pixel: int, width: int) -> wp.uint32:
    """Return the seed of a pixel's layers; the frame is the index."""
    seed = pixel_seed_of(
        view.camera.crop_x + pixel % width, view.camera.crop_y + pixel // width, view.camera.seed)
    return hash_combine(seed, wp.uint32(LAYER_STREAM))


@wp.func
def store_found(hits: PrimaryHits, pixel: int, found: Hit):
    """Put the hit that stops a ray in the place of the opaque one."""
    hits.t[pixel] = found.t
    hits.hit[pixel] = wp.vec2i(found.instance, found.triangle)
    hits.barycentrics[pixel] = wp.vec2(found.u, found.v)


@wp.func
def store_stop(hits: PrimaryHits, pixel: int, found: Hit, lit: int):
    """Store the layer that stops a ray; with `lit` 1 what shines behind it is known (gbuffer_behind.py)."""
    store_found(hits, pixel, found)
    if lit == 1:
        behind = hits.behind[pixel]
        hits.behind[pixel] = wp.vec4(behind[0], behind[1], behind[2], 0.0)


@wp.kernel
def filter_primary(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Pass or stop at each layer by chance, with other numbers in every frame: frames average to transparency."""
    pixel = first + wp.tid()
    if hits_out.layer[pixel][0] == MISS:
        return
    view = views[0]
    ray = primary_ray(view, pixel % width, pixel // width)
    opaque = make_hit(hits_out.t[pixel], hits_out.hit[pixel], hits_out.barycentrics[pixel])
    layer = make_hit(hits_out.layer_t[pixel], hits_out.layer[pixel], hits_out.layer_barycentrics[pixel])
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    found = accept_hit(
        scene, ray.origin, ray.direction, opaque, layer, VISIBLE_CAMERA, 0, cone, layer_seed(view, pixel, width),
        wp.uint32(view.frame))
    store_found(hits_out, pixel, found.hit)
    hits_out.weight[pixel] = found.weight
