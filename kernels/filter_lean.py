# SPDX-License-Identifier: GPL-3.0-or-later
"""The same as filter.py for scenes in which the lean node machine runs all transparency programs. Functions.

A ray goes layer by layer, so that a thread that is done with one can take the next while others of its warp are on
their way: some rays meet one layer, some thirty.
"""

from __future__ import annotations

import warp as wp

from .filter import MAX_LAYERS, layer_point, pass_chance, step_past
from .geometry_math import max_component
from .intersect import MISS, Hit, Layer, closest_layer, shadow_layer
from .light_linking import is_in
from .node_lean import run_lean_transparency
from .sampling import sample_number
from .types import MATERIAL_TRANSPARENCY, VISIBLE_SHADOW, Scene, ShadingPoint
from .wide_loads import load_instance, load_material_flags

WALK_ON = wp.constant(0)
WALK_STOPPED = wp.constant(1)
"""By the layer"""
WALK_PASSED = wp.constant(2)
"""There are no more layers"""
WALK_OVERRUN = wp.constant(3)
"""The same, and MAX_LAYERS were not enough"""


@wp.func
def lean_transparency(scene: Scene, point: ShadingPoint, kind: int, blocking: int) -> wp.vec3:
    """Return how much of the light a layer lets through: see filter.layer_transparency."""
    if (load_instance(scene.geometry.instances, point.instance).visibility & kind) == 0:
        return wp.vec3(1.0, 1.0, 1.0)
    if blocking != 0 and not is_in(scene, point.instance, blocking):
        return wp.vec3(1.0, 1.0, 1.0)
    program = load_material_flags(scene.materials.materials, point.material)
    if (program[3] & MATERIAL_TRANSPARENCY) == 0:
        return wp.vec3(0.0, 0.0, 0.0)
    return run_lean_transparency(scene, point, program[1])


@wp.struct
class LayerWalk:
    """A ray on its way through layers."""

    hit: Hit
    """The layer that it has come to"""
    weight: wp.vec3
    """What the layers before leave of its light"""
    layers: int
    """How many those are"""
    state: int
    """WALK_*"""


@wp.func
def start_walk(first: Hit) -> LayerWalk:
    """Return a ray before its first layer."""
    walk = LayerWalk()
    walk.hit = first
    walk.weight = wp.vec3(1.0, 1.0, 1.0)
    return walk


@wp.func
def come_to(walk: LayerWalk, layer: Layer, start: float) -> LayerWalk:
    """Return a ray that a layer has let through at its next layer, found from `start` on, if there is one."""
    out = walk
    out.state = WALK_PASSED
    out.layers = walk.layers + 1
    if layer.hit.instance != MISS:
        hit = layer.hit
        hit.t = hit.t + start
        out.hit = hit
        out.state = wp.where(out.layers < MAX_LAYERS, WALK_ON, WALK_OVERRUN)
        if layer.solid == 1:
            out.state = WALK_STOPPED
    return out


@wp.func
def accept_layer(
    scene: Scene, walk: LayerWalk, origin: wp.vec3, direction: wp.vec3, t_max: float, kind: int, depth: int,
    cone: wp.vec2, seed: wp.uint32, index: wp.uint32,
) -> LayerWalk:
    """Stop at a layer or go on to the next by chance: a step of filter.accept_hit; opaque hits lie at t_max."""
    out = walk
    point = layer_point(scene, walk.hit, direction, kind, depth, cone)
    transparency = lean_transparency(scene, point, kind, 0)
    chance = pass_chance(scene, point, transparency, kind)
    if sample_number(seed, index, walk.layers) >= chance:
        out.weight = walk.weight / (1.0 - chance)
        out.state = WALK_STOPPED
        return out
    out.weight = wp.cw_mul(walk.weight, transparency / chance)
    start = step_past(point, direction, walk.hit.t)
    if start >= t_max:
        out.state = WALK_PASSED
        return out
    return come_to(
        out, closest_layer(scene.geometry, origin + direction * start, direction, t_max - start), start)


@wp.func
def pass_layer(
    scene: Scene, walk: LayerWalk, origin: wp.vec3, direction: wp.vec3, distance: float, depth: int,
    blocking: int,
) -> LayerWalk:
    """Take a layer's transparency in and go on to the next one: a step of filter.transmittance."""
    out = walk
    point = layer_point(scene, walk.hit, direction, VISIBLE_SHADOW, depth, wp.vec2(0.0, 0.0))
    # A constant for compilers, which leave out what only widths need.
    point.footprint = 0.0
    out.weight = wp.cw_mul(walk.weight, lean_transparency(scene, point, VISIBLE_SHADOW, blocking))
    if max_component(out.weight) <= 0.0:
        out.state = WALK_STOPPED
        return out
    start = step_past(point, direction, walk.hit.t)
    if start >= distance:
        out.state = WALK_PASSED
        return out
    out = come_to(
        out, shadow_layer(scene.geometry, origin + direction * start, direction, distance - start), start)
    if out.state == WALK_OVERRUN or out.state == WALK_STOPPED:
        out.weight = wp.vec3(0.0, 0.0, 0.0)
    return out
