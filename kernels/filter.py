# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles that need a test per hit: transparency and visibility by kind of ray, layer by layer.

Queries for rays have neither a lower limit nor a filter, so these triangles lie in structures of their own and
are queried again from each hit, moved on by its error bound. At most MAX_LAYERS layers are looked through. Of
triangles with opacity maps (opacity_maps.py) queries pass over what is clear and say what is solid.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component
from .intersect import MISS, Hit, closest_layer, may_emit, shadow_layer, surface_point
from .light_linking import is_in
from .nodes import evaluate_transparency
from .sampling import sample_number
from .types import MATERIAL_TRANSPARENCY, VISIBLE_SHADOW, Scene, ShadingPoint

MAX_LAYERS = wp.constant(32)

# Emitting surfaces are never skipped for certain, or an Add Shader of Transparent and Emission would stay dark.
EMITTER_PASS_LIMIT = wp.constant(0.75)


@wp.struct
class FilteredHit:
    """The first hit that stops a ray, and the weight that the layers in front of it leave."""

    hit: Hit
    weight: wp.vec3
    overrun: int
    """1: MAX_LAYERS were not enough"""


@wp.func
def layer_point(scene: Scene, hit: Hit, direction: wp.vec3, kind: int, depth: int, cone: wp.vec2) -> ShadingPoint:
    """Return a layer's shading point."""
    point = surface_point(scene, hit, direction)
    point.footprint = cone[0] + cone[1] * hit.t
    point.ray_visibility = kind
    point.ray_length = hit.t
    point.ray_depth = depth
    return point


@wp.func
def layer_transparency(scene: Scene, point: ShadingPoint, kind: int, blocking: int) -> wp.vec3:
    """Return how much of the light a layer lets through: 1 where this kind of ray does not see the object.

    `blocking`: set of what stops a shadow ray, see light_linking.shadow_set.
    """
    if (scene.geometry.instances[point.instance].visibility & kind) == 0:
        return wp.vec3(1.0, 1.0, 1.0)
    if blocking != 0 and not is_in(scene, point.instance, blocking):
        return wp.vec3(1.0, 1.0, 1.0)
    if (scene.materials.materials[point.material].flags & MATERIAL_TRANSPARENCY) == 0:
        return wp.vec3(0.0, 0.0, 0.0)
    return evaluate_transparency(scene, point)


@wp.func
def step_past(point: ShadingPoint, direction: wp.vec3, t: float) -> float:
    """Return the distance from which to look for the next layer: past this one's error bound."""
    cosine = wp.max(wp.abs(wp.dot(point.geometric_normal, direction)), 1.0e-3)
    return t + wp.max(2.0 * point.error / cosine, t * 2.4e-7)


@wp.func
def pass_chance(scene: Scene, point: ShadingPoint, transparency: wp.vec3, kind: int) -> float:
    """Return the probability with which a ray passes a layer."""
    chance = wp.clamp(max_component(transparency), 0.0, 1.0)
    if may_emit(scene, point.material):
        if (scene.geometry.instances[point.instance].visibility & kind) != 0:
            chance = wp.min(chance, EMITTER_PASS_LIMIT)
    return chance


@wp.func
def accept_hit(
    scene: Scene, origin: wp.vec3, direction: wp.vec3, opaque: Hit, first: Hit, kind: int, depth: int, cone: wp.vec2,
    seed: wp.uint32, index: wp.uint32,
) -> FilteredHit:
    """Return the first layer that stops the ray, else the opaque hit; `first` is the first layer.

    A layer of transparency T is passed with probability max(T) and the weight T / max(T); when it stops the ray the
    rest of its closures count by 1 / (1 - probability), so the expectation is exact. Sample `index` of the sequence
    `seed` decides, layer by layer.
    """
    result = FilteredHit()
    result.hit = opaque
    result.weight = wp.vec3(1.0, 1.0, 1.0)
    result.overrun = 0
    hit = first
    for layer in range(MAX_LAYERS):
        point = layer_point(scene, hit, direction, kind, depth, cone)
        transparency = layer_transparency(scene, point, kind, 0)
        chance = pass_chance(scene, point, transparency, kind)
        if sample_number(seed, index, layer) >= chance:
            result.hit = hit
            result.weight = result.weight / (1.0 - chance)
            return result
        result.weight = wp.cw_mul(result.weight, transparency / chance)
        start = step_past(point, direction, hit.t)
        if start >= opaque.t:
            return result
        further = closest_layer(scene.geometry, origin + direction * start, direction, opaque.t - start)
        if further.hit.instance == MISS:
            return result
        hit = further.hit
        hit.t = hit.t + start
        if further.solid == 1:
            result.hit = hit
            return result
    result.overrun = 1
    return result


@wp.func
def transmittance(
    scene: Scene, origin: wp.vec3, direction: wp.vec3, distance: float, first: Hit, depth: int, blocking: int,
) -> FilteredHit:
    """Return as `weight` the product of all layers' transparency along a shadow ray that nothing opaque blocks."""
    result = FilteredHit()
    result.overrun = 0
    product = wp.vec3(1.0, 1.0, 1.0)
    hit = first
    for _layer in range(MAX_LAYERS):
        point = layer_point(scene, hit, direction, VISIBLE_SHADOW, depth, wp.vec2(0.0, 0.0))
        product = wp.cw_mul(product, layer_transparency(scene, point, VISIBLE_SHADOW, blocking))
        if max_component(product) <= 0.0:
            result.weight = product
            return result
        start = step_past(point, direction, hit.t)
        if start >= distance:
            result.weight = product
            return result
        further = shadow_layer(scene.geometry, origin + direction * start, direction, distance - start)
        if further.solid == 1:
            result.weight = wp.vec3(0.0, 0.0, 0.0)
            return result
        if further.hit.instance == MISS:
            result.weight = product
            return result
        hit = further.hit
        hit.t = hit.t + start
    result.weight = wp.vec3(0.0, 0.0, 0.0)
    result.overrun = 1
    return result
