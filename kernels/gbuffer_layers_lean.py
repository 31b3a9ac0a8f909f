# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as gbuffer_layers.py for scenes in which the lean node machine runs all transparency programs."""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS, FilteredHit, layer_point, pass_chance, step_past
from .gbuffer_layers import layer_noise, store_found
from .gbuffer_rays import PrimaryHits, primary_ray
from .intersect import MISS, Hit, closest_filtered_hit
from .node_lean import run_lean_transparency
from .paths import make_hit
from .sampling import hashed_unit
from .tracing import FOOTPRINT_SCALE
from .types import MATERIAL_TRANSPARENCY, VISIBLE_CAMERA, Scene, ShadingPoint
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def lean_transparency(scene: Scene, point: ShadingPoint) -> wp.vec3:
    """Return how much of the light a layer lets through: 1 where the camera does not see the object."""
    if (scene.geometry.instances[point.instance].visibility & VISIBLE_CAMERA) == 0:
        return wp.vec3(1.0, 1.0, 1.0)
    material = scene.materials.materials[point.material]
    if (material.flags & MATERIAL_TRANSPARENCY) == 0:
        return wp.vec3(0.0, 0.0, 0.0)
    return run_lean_transparency(scene, point, material.transparency_start)


@wp.func
def accept_lean(
    scene: Scene, origin: wp.vec3, direction: wp.vec3, opaque: Hit, first: Hit, cone: wp.vec2, noise: wp.uint32,
) -> FilteredHit:
    """Return the first layer that stops a camera ray, else the opaque hit: filter.accept_hit step by step."""
    result = FilteredHit()
    result.hit = opaque
    result.weight = wp.vec3(1.0, 1.0, 1.0)
    hit = first
    for layer in range(MAX_LAYERS):
        point = layer_point(scene, hit, direction, VISIBLE_CAMERA, 0, cone)
        transparency = lean_transparency(scene, point)
        chance = pass_chance(scene, point, transparency, VISIBLE_CAMERA)
        if hashed_unit(noise, wp.uint32(layer)) >= chance:
            result.hit = hit
            result.weight = result.weight / (1.0 - chance)
            return result
        result.weight = wp.cw_mul(result.weight, transparency / chance)
        start = step_past(point, direction, hit.t)
        if start >= opaque.t:
            return result
        hit = closest_filtered_hit(scene.geometry, origin + direction * start, direction, opaque.t - start)
        if hit.instance == MISS:
            return result
        hit.t = hit.t + start
    return result


@wp.kernel(cuda_max_registers=128)
def filter_primary_lean(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Pass or stop at each layer by chance, see gbuffer_layers.filter_primary."""
    pixel = first + wp.tid()
    if hits_out.layer[pixel][0] == MISS:
        return
    view = views[0]
    ray = primary_ray(view, pixel % width, pixel // width)
    opaque = make_hit(hits_out.t[pixel], hits_out.hit[pixel], hits_out.barycentrics[pixel])
    layer = make_hit(hits_out.layer_t[pixel], hits_out.layer[pixel], hits_out.layer_barycentrics[pixel])
    cone = wp.vec2(view.camera.pixel_size, view.camera.spread) * FOOTPRINT_SCALE
    noise = layer_noise(view, pixel, width)
    store_found(hits_out, pixel, accept_lean(scene, ray.origin, ray.direction, opaque, layer, cone, noise))
