# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as filter.py for scenes in which the lean node machine runs all transparency programs. Functions."""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS, FilteredHit, layer_point, pass_chance, step_past
from .geometry_math import max_component
from .intersect import MISS, Hit, closest_filtered_hit
from .node_lean import run_lean_transparency
from .sampling import hashed_unit
from .types import MATERIAL_TRANSPARENCY, VISIBLE_SHADOW, Scene, ShadingPoint


@wp.func
def lean_transparency(scene: Scene, point: ShadingPoint, kind: int) -> wp.vec3:
    """Return how much of the light a layer lets through: 1 where this kind of ray does not see the object."""
    if (scene.geometry.instances[point.instance].visibility & kind) == 0:
        return wp.vec3(1.0, 1.0, 1.0)
    material = scene.materials.materials[point.material]
    if (material.flags & MATERIAL_TRANSPARENCY) == 0:
        return wp.vec3(0.0, 0.0, 0.0)
    return run_lean_transparency(scene, point, material.transparency_start)


@wp.func
def accept_lean(
    scene: Scene, origin: wp.vec3, direction: wp.vec3, opaque: Hit, first: Hit, kind: int, depth: int, cone: wp.vec2,
    noise: wp.uint32,
) -> FilteredHit:
    """Return the first layer that stops a ray, else the opaque hit: filter.accept_hit step by step."""
    result = FilteredHit()
    result.hit = opaque
    result.weight = wp.vec3(1.0, 1.0, 1.0)
    result.overrun = 0
    hit = first
    for layer in range(MAX_LAYERS):
        point = layer_point(scene, hit, direction, kind, depth, cone)
        transparency = lean_transparency(scene, point, kind)
        chance = pass_chance(scene, point, transparency, kind)
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
    result.overrun = 1
    return result


@wp.func
def transmittance_lean(
    scene: Scene, origin: wp.vec3, direction: wp.vec3, distance: float, first: Hit, depth: int,
) -> FilteredHit:
    """Return as `weight` the product of all layers' transparency along a shadow ray: filter.transmittance."""
    result = FilteredHit()
    result.overrun = 0
    product = wp.vec3(1.0, 1.0, 1.0)
    hit = first
    for _layer in range(MAX_LAYERS):
        point = layer_point(scene, hit, direction, VISIBLE_SHADOW, depth, wp.vec2(0.0, 0.0))
        product = wp.cw_mul(product, lean_transparency(scene, point, VISIBLE_SHADOW))
        result.weight = product
        if max_component(product) <= 0.0:
            return result
        start = step_past(point, direction, hit.t)
        if start >= distance:
            return result
        hit = closest_filtered_hit(scene.geometry, origin + direction * start, direction, distance - start)
        if hit.instance == MISS:
            return result
        hit.t = hit.t + start
    result.weight = wp.vec3(0.0, 0.0, 0.0)
    result.overrun = 1
    return result
