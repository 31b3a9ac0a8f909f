# SPDX-License-Identifier: GPL-3.0-or-later
"""Primary rays of the real-time frame: closest hits, and the lamps that the camera sees. They know no materials.

The camera is a pinhole here: depth of field would need several samples a pixel, and comes with the path-traced ones.
"""

from __future__ import annotations

import warp as wp

from .camera import CameraRay, camera_ray
from .gbuffer import SURFACE_EMITS, SURFACE_VEILED
from .geometry_math import is_finite3
from .intersect import MISS, Hit, Layer, closest_hit, closest_layer
from .lamp_hit import FAR
from .packing import from_half, rgba, to_half
from .reflection_lights import lamps_along
from .types import VISIBLE_CAMERA, Scene
from .view import View, film_position
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


# How kernels are told of layers: there are none, there are some, and something may shine behind them.
LAYERS_NONE = wp.constant(0)
LAYERS_DARK = wp.constant(1)
LAYERS_LIT = wp.constant(2)


@wp.struct
class PrimaryHits:
    """What the primary rays have met, one entry a pixel; exact, unlike the G-buffer's packed form."""

    t: wp.array[float]
    """Distance along the ray [m]"""
    hit: wp.array[wp.vec2i]
    """(instance, triangle); instance MISS for none"""
    barycentrics: wp.array[wp.vec2]
    layer_t: wp.array[float]
    """First triangle that needs a test (transparency, visibility), before the opaque hit; as above"""
    layer: wp.array[wp.vec2i]
    layer_barycentrics: wp.array[wp.vec2]
    weight: wp.array[wp.vec3]
    """What the layers in front of the hit leave of its light"""
    behind: wp.array[wp.vec4]
    """Where there is a layer: radiance of what shines behind all of them, as far as they let it through; w = 1 where
    the hit is just that. Valid with LAYERS_LIT alone"""


@wp.func
def primary_ray(view: View, x: int, y: int) -> CameraRay:
    """Return this frame's camera ray of a pixel, through the centre of the lens."""
    frame = view.camera
    frame.aperture_radius = 0.0
    return camera_ray(frame, film_position(view, x, y), wp.vec2(0.0, 0.0))


@wp.func
def store_primary_hit(hits: PrimaryHits, pixel: int, hit: Hit):
    """Store what a pixel shows."""
    hits.t[pixel] = hit.t
    hits.hit[pixel] = wp.vec2i(hit.instance, hit.triangle)
    hits.barycentrics[pixel] = wp.vec2(hit.u, hit.v)


@wp.func
def store_primary_layer(hits: PrimaryHits, pixel: int, layer: Layer):
    """Store the first triangle that needs a test; one that is known to be solid is what the pixel shows."""
    ids = wp.vec2i(layer.hit.instance, layer.hit.triangle)
    weights = wp.vec2(layer.hit.u, layer.hit.v)
    if layer.solid == 1:
        store_primary_hit(hits, pixel, layer.hit)
        ids = wp.vec2i(MISS, 0)
    hits.layer_t[pixel] = layer.hit.t
    hits.layer[pixel] = ids
    hits.layer_barycentrics[pixel] = weights
    hits.weight[pixel] = wp.vec3(1.0, 1.0, 1.0)


@wp.func
def light_weight(hits: PrimaryHits, layers: int, pixel: int) -> wp.vec3:
    """Return what the layers in front of a pixel's hit leave of its light; `layers`: LAYERS_*."""
    if layers == LAYERS_NONE:
        return wp.vec3(1.0, 1.0, 1.0)
    return hits.weight[pixel]


@wp.func
def veil_flag(hits: PrimaryHits, layers: int, pixel: int) -> wp.uint32:
    """Return SURFACE_VEILED for a pixel with a layer, else 0; `layers`: LAYERS_*."""
    if layers != LAYERS_NONE:
        if hits.layer[pixel][0] != MISS:
            return SURFACE_VEILED
    return wp.uint32(0)


@wp.func
def veiled_light(hits: PrimaryHits, layers: int, pixel: int, emitted: wp.vec3) -> wp.vec3:
    """Return what arrives of the light that a pixel's hit emits, and of what shines behind it; `layers`: LAYERS_*."""
    light = wp.cw_mul(emitted, light_weight(hits, layers, pixel))
    if layers == LAYERS_LIT and veil_flag(hits, layers, pixel) != wp.uint32(0):
        behind = hits.behind[pixel]
        light = light * (1.0 - behind[3]) + wp.vec3(behind[0], behind[1], behind[2])
    return light


@wp.kernel(cuda_max_registers=64)
def trace_primary(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Find what each pixel shows: the closest opaque hit."""
    pixel = first + wp.tid()
    ray = primary_ray(views[0], pixel % width, pixel // width)
    store_primary_hit(hits_out, pixel, closest_hit(scene.geometry, ray.origin, ray.direction, ray.t_max))


@wp.kernel(cuda_max_registers=64)
def trace_primary_layers(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    # Out:
    hits_out: PrimaryHits,
):
    """Find the first triangle in front of each opaque hit that needs a test."""
    pixel = first + wp.tid()
    ray = primary_ray(views[0], pixel % width, pixel // width)
    store_primary_layer(hits_out, pixel, closest_layer(
        scene.geometry, ray.origin, ray.direction, hits_out.t[pixel]))


@wp.kernel
def add_lamps(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    width: int,
    layers: int,
    hits: PrimaryHits,
    # Out:
    emission_out: wp.array[wp.vec4h],
    material_out: wp.array[wp.uint32],
):
    """Add the lamps that the camera sees in front of its hits; they hide nothing. One pixel a thread.

    Of GBuffer.emission and GBuffer.material, of which SURFACE_EMITS alone changes: others may read the rest meanwhile.
    """
    pixel = first + wp.tid()
    view = load_view(views)
    ray = primary_ray(view, pixel % width, pixel // width)
    t_max = hits.t[pixel]
    if hits.hit[pixel][0] == MISS:
        t_max = FAR
    total = lamps_along(scene.lights, VISIBLE_CAMERA, -1, 0.0, 0.0, ray.origin, ray.direction, t_max)
    total = wp.cw_mul(total, light_weight(hits, layers, pixel))
    total = total * view.exposure
    if is_finite3(total) and wp.length_sq(total) > 0.0:
        emission_out[pixel] = to_half(from_half(emission_out[pixel]) + rgba(total, 0.0))
        # Whoever takes this picture for the light of the surface would find the lamp on it.
        material_out[pixel] = material_out[pixel] | SURFACE_EMITS
