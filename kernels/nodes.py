# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine: runs a material's or the world's program and returns what it says about a point.

A program is a list of instructions over 32 registers of type vec4 (see node_codes.py for their form). xyz holds the
value, numbers are in all three; w carries the filter width of a texture coordinate, or alpha. One interpreter serves
all programs, and image sampling has one place in it, so that its code exists once in every kernel that uses it.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .node_closure import argument, drawing_weight, empty_closure, fetch, read_closure, xyz
from .node_color import adjust_color, mix_color
from .node_gabor import gabor
from .node_input import input_value
from .node_math import math
from .node_noise import noise_texture
from .node_normal import bump, change_space, normal_map
from .node_texture import checker, fresnel_weight, gradient, project_image, ramp
from .node_vector import vector_math
from .node_voronoi import voronoi
from .texture import sample_texture
from .types import MATERIAL_CONSTANT_EMISSION, MATERIAL_EMISSION, MATERIAL_TRANSPARENCY, Closure, Scene, ShadingPoint

__all__ = ["evaluate_emission", "evaluate_surface", "evaluate_transparency", "evaluate_world"]


@wp.func
def broadcast(x: float) -> wp.vec4:
    """Return a number as a register: x in all of xyz."""
    return wp.vec4(x, x, x, 0.0)


@wp.func
def extend(v: wp.vec3) -> wp.vec4:
    """Return a vector as a register."""
    return wp.vec4(v[0], v[1], v[2], 0.0)


@wp.func
def image(scene: Scene, sub: int, texture: int, co: wp.vec4) -> wp.vec4:
    """Sample an image at a coordinate (see OP_IMAGE in node_codes.py for `sub`)."""
    uv = project_image(sub & 15, co)
    # Interpolation and association lie side by side, as sample_texture takes them.
    return sample_texture(
        scene.textures, texture, wp.vec2(uv[0], uv[1]), uv[2], (sub >> 4) & 3, (sub >> 6) & 7)


@wp.func
def transform(scene: Scene, sub: int, row: int, a: wp.vec4) -> wp.vec4:
    """Apply three constant rows of an affine matrix; the filter width grows with the mean length of the rows."""
    x = scene.materials.constants[row]
    y = scene.materials.constants[row + 1]
    z = scene.materials.constants[row + 2]
    w = wp.where(sub == codes.TRANSFORM_POINT, 1.0, 0.0)
    p = wp.vec4(a[0], a[1], a[2], w)
    scale = (wp.length(xyz(x)) + wp.length(xyz(y)) + wp.length(xyz(z))) / 3.0
    return wp.vec4(wp.dot(x, p), wp.dot(y, p), wp.dot(z, p), a[3] * scale)


@wp.func
def procedural(sub: int, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate a texture without an image (codes.PROCEDURAL_*)."""
    if sub == codes.PROCEDURAL_CHECKER:
        return broadcast(checker(xyz(a)))
    if sub <= codes.PROCEDURAL_GRADIENT_SPHERICAL:
        return broadcast(gradient(sub, xyz(a)))
    if sub >= codes.PROCEDURAL_GABOR:
        return gabor(sub, a, b, c)
    if sub >= codes.PROCEDURAL_VORONOI:
        return voronoi(sub, a, b, c)
    return noise_texture(sub, a, b, c)


@wp.func
def compute(scene: Scene, point: ShadingPoint, word: wp.vec4i, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate one instruction that writes a register; a, b, c are its operands, as far as it has any."""
    op = word[0] & 255
    sub = (word[0] >> 16) & 65535
    if op == codes.OP_MATH:
        return broadcast(math(sub, a[0], b[0], c[0]))
    if op == codes.OP_VECTOR:
        return vector_math(sub, a, b, c)
    if op == codes.OP_INPUT:
        return input_value(scene, point, sub, a[0], word[2], word[3])
    if op == codes.OP_IMAGE:
        return image(scene, sub, word[2], a)
    if op == codes.OP_MIX:
        return extend(mix_color(sub, a[0], xyz(b), xyz(c)))
    if op == codes.OP_TRANSFORM:
        return transform(scene, sub, word[2], a)
    if op == codes.OP_RAMP:
        return ramp(scene.materials, sub, word[2], a)
    if op == codes.OP_NORMAL_MAP:
        return extend(normal_map(scene, point, sub, xyz(a), b[0], (word[3] & 65535) - 1, (word[3] >> 16) - 1))
    if op == codes.OP_BUMP:
        return extend(bump(point, xyz(a), xyz(b), xyz(c)))
    if op == codes.OP_COLOR:
        return extend(adjust_color(sub, xyz(a), xyz(b), xyz(c), scene.luminance))
    if op == codes.OP_FRESNEL:
        return broadcast(fresnel_weight(point, sub, a[0], xyz(b)))
    if op == codes.OP_SPACE:
        return extend(change_space(scene, point, sub, xyz(a)))
    return procedural(sub, a, b, c)


@wp.func
def run(scene: Scene, point: ShadingPoint, start: int, u: float) -> Closure:
    """Run a program: sum up emission, transparency and holdout; draw one BSDF by weight with `u` in [0, 1)."""
    registers = wp.zeros(shape=(32,), dtype=wp.vec4)
    closure = empty_closure(point)
    random = float(u)
    total = float(0.0)
    drawn = float(0.0)
    pc = int(start)
    while True:
        word = scene.materials.code[pc]
        op = word[0] & 255
        if op == codes.OP_END:
            break
        a = fetch(registers, scene.materials.constants, word[1])
        b = fetch(registers, scene.materials.constants, word[2])
        c = fetch(registers, scene.materials.constants, word[3])
        if op < codes.OP_EMIT:
            registers[(word[0] >> 8) & 255] = compute(scene, point, word, a, b, c)
        elif op == codes.OP_EMIT:
            closure.emission += xyz(a) * (b[0] * c[0])
        elif op == codes.OP_TRANSPARENT:
            closure.transparency += xyz(a) * b[0]
        elif op == codes.OP_HOLDOUT:
            closure.holdout += a[0]
        else:
            # Reservoir of one: what is left of `random` after each decision is uniform again.
            sub = (word[0] >> 16) & 65535
            weight = drawing_weight(scene.materials, registers, sub, pc + 1)
            total += weight
            if weight > 0.0:
                share = weight / total
                if random < share:
                    random = random / share
                    drawn = weight
                    closure = read_closure(point, scene.materials, registers, sub, pc + 1, closure)
                    closure.weight = xyz(argument(scene.materials, registers, pc + 1, codes.ARG_WEIGHT))
                else:
                    random = (random - share) / (1.0 - share)
            pc += word[2]
        pc += 1
    if drawn > 0.0:
        closure.weight = closure.weight * (total / drawn)
    return closure


@wp.func
def evaluate_surface(scene: Scene, point: ShadingPoint, u: float) -> Closure:
    """Return what the material at `point` does: one BSDF, drawn with `u` in [0, 1), emission and transparency.

    The expectation over u of BSDF times Closure.weight is the material's mix of BSDFs.
    """
    return run(scene, point, scene.materials.materials[point.material].surface_start, u)


@wp.func
def evaluate_transparency(scene: Scene, point: ShadingPoint) -> wp.vec3:
    """Return the share of light that passes `point` unrefracted, per channel."""
    material = scene.materials.materials[point.material]
    if (material.flags & MATERIAL_TRANSPARENCY) == 0:
        return wp.vec3(0.0)
    return run(scene, point, material.transparency_start, 0.0).transparency


@wp.func
def evaluate_emission(scene: Scene, point: ShadingPoint) -> wp.vec3:
    """Return the emitted radiance of the material at `point`; the coat and sheen over it don't count."""
    material = scene.materials.materials[point.material]
    if (material.flags & MATERIAL_EMISSION) == 0:
        return wp.vec3(0.0)
    if (material.flags & MATERIAL_CONSTANT_EMISSION) != 0:
        return material.emission
    return run(scene, point, material.emission_start, 0.0).emission


@wp.func
def world_point(direction: wp.vec3, ray_visibility: int, ray_depth: int, footprint: float) -> ShadingPoint:
    """Return the point at which the world's program is run for a direction (arguments as of evaluate_world)."""
    point = ShadingPoint()
    point.position = direction
    point.normal = -direction
    point.geometric_normal = -direction
    point.wo = -direction
    point.instance = -1
    point.footprint = footprint
    point.ray_visibility = ray_visibility
    # Cycles counts the light that a ray ends in as one bounce further.
    point.ray_depth = ray_depth + 1
    # Cycles' length of a ray that met nothing, as far as sums of squares stay finite.
    point.ray_length = 1.0e18
    return point


@wp.func
def evaluate_world(
    scene: Scene, direction: wp.vec3, ray_visibility: int, ray_depth: int, footprint: float
) -> wp.vec3:
    """Return the world's radiance from `direction` (unit, world space).

    Args:
        scene: The scene.
        direction: Direction in which the world is seen.
        ray_visibility: Kind of the ray, for Light Path nodes.
        ray_depth: Bounces before it.
        footprint: Width of the ray cone at distance 1 [rad], for texture filtering.
    """
    point = world_point(direction, ray_visibility, ray_depth, footprint)
    return run(scene, point, scene.materials.world_start, 0.0).emission
