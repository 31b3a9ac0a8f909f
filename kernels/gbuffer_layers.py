# SPDX-License-Identifier: GPL-3.0-or-later
"""The real-time frame's kernel that looks through transparent layers in front of what a pixel shows."""

from __future__ import annotations

import warp as wp

from .filter import accept_hit
from .gbuffer_rays import PrimaryHits, primary_ray
from .intersect import MISS
from .layers import LAYER_STREAM
from .paths import make_hit
from .sampling import hash_combine, pixel_seed_of
from .tracing import FOOTPRINT_SCALE
from .types import VISIBLE_CAMERA, Scene
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


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
    x = pixel % width
    y = pixel // width
    seed = pixel_seed_of(view.camera.crop_x + x, view.camera.crop_y + y, view.camera.seed)
    noise = hash_combine(hash_combine(seed, wp.uint32(view.frame)), wp.uint32(LAYER_STREAM))
    ray = primary_ray(view, x, y)
    opaque = make_hit(hits_out.t[pixel], hits_out.hit[pixel], hits_out.barycentrics[pixel])
    layer = make_hit(hits_out.layer_t[pixel], hits_out.layer[pixel], hits_out.layer_barycentrics[pixel])
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    found = accept_hit(scene, ray.origin, ray.direction, opaque, layer, VISIBLE_CAMERA, 0, cone, noise)
    hits_out.t[pixel] = found.hit.t
    hits_out.hit[pixel] = wp.vec2i(found.hit.instance, found.hit.triangle)
    hits_out.barycentrics[pixel] = wp.vec2(found.hit.u, found.hit.v)
    hits_out.weight[pixel] = found.weight
