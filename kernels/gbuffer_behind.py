# SPDX-License-Identifier: GPL-3.0-or-later
"""What shines behind the transparent layers that a pixel shows: a window behind a curtain, or the world.

Which of the surfaces one behind the other a pixel shows is left to chance (gbuffer_layers.py), and frames average to
the mix. Where the last of them shines it is so many times brighter than the rest that frames in motion, which average
few, would sparkle: its light is added to whatever the pixel shows, by as much as all that is in front of it lets
through. The lean node machine's programs alone; where a layer needs the full one, chance decides about that light too.
"""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS, layer_point, step_past
from .filter_lean import lean_transparency
from .gbuffer_rays import PrimaryHits, primary_ray
from .geometry_math import max_component
from .intersect import MISS, closest_layer, triangle_material
from .packing import rgba
from .paths import make_hit
from .tracing import FOOTPRINT_SCALE
from .types import HOLDOUT, MATERIAL_CONSTANT_EMISSION, VISIBLE_CAMERA, Scene
from .view import View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})


@wp.func
def shining(view: View, scene: Scene, hits: PrimaryHits, pixel: int) -> wp.vec3:
    """Return the radiance of what lies behind all layers, 0 where that takes a program."""
    dark = wp.vec3(0.0, 0.0, 0.0)
    instance = hits.hit[pixel][0]
    if instance == MISS:
        seen = (scene.environment.visibility & VISIBLE_CAMERA) != 0 and view.transparent == 0
        if seen and scene.environment.constant == 1:
            return scene.environment.radiance
        return dark
    if (scene.geometry.instances[instance].visibility & HOLDOUT) != 0:
        return dark
    material = triangle_material(scene, instance, hits.hit[pixel][1])
    if (scene.materials.materials[material].flags & MATERIAL_CONSTANT_EMISSION) == 0:
        return dark
    return scene.materials.materials[material].emission


@wp.func
def look_through(view: View, scene: Scene, width: int, hits: PrimaryHits, pixel: int) -> wp.vec3:
    """Return what all layers of a pixel together let through."""
    ray = primary_ray(view, pixel % width, pixel // width)
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    hit = make_hit(hits.layer_t[pixel], hits.layer[pixel], hits.layer_barycentrics[pixel])
    through = wp.vec3(1.0, 1.0, 1.0)
    layers = int(0)
    while hit.instance != MISS and layers < MAX_LAYERS:
        layers = layers + 1
        point = layer_point(scene, hit, ray.direction, VISIBLE_CAMERA, 0, cone)
        through = wp.cw_mul(through, lean_transparency(scene, point, VISIBLE_CAMERA, 0))
        start = step_past(point, ray.direction, hit.t)
        hit.instance = MISS
        if max_component(through) > 0.0 and start < hits.t[pixel]:
            further = closest_layer(
                scene.geometry, ray.origin + ray.direction * start, ray.direction, hits.t[pixel] - start)
            if further.hit.instance != MISS:
                hit = further.hit
                hit.t = hit.t + start
                if further.solid == 1:
                    hit.instance = MISS
                    through = wp.vec3(0.0, 0.0, 0.0)
    return through


@wp.kernel(cuda_max_registers=128)
def see_through(
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
    """Find the light behind the layers of listed pixels (PrimaryHits.behind); comes before one of these is chosen."""
    i = wp.tid()
    while i < count[0]:
        pixel = queue[i]
        i = i + stride
        if hits_out.layer[pixel][0] != MISS:
            view = load_view(views)
            light = shining(view, scene, hits_out, pixel)
            own = float(0.0)
            if max_component(light) > 0.0:
                own = 1.0
                light = wp.cw_mul(light, look_through(view, scene, width, hits_out, pixel))
            hits_out.behind[pixel] = rgba(light, own)
