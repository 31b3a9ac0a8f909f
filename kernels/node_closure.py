# SPDX-License-Identifier: GPL-3.0-or-later
"""How a program's closure instructions become one Closure: arguments read from registers, one BSDF drawn."""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import max_component, normalize_or
from .types import (
    CLOSURE_NONE,
    CLOSURE_PRINCIPLED,
    CLOSURE_SHEEN,
    Closure,
    Materials,
    ShadingPoint,
)
from .wide_loads import load_vec4, load_vec4i


@wp.func
def fetch(registers: wp.array[wp.vec4], constants: wp.array[wp.vec4], operand: int) -> wp.vec4:
    """Return an operand: register k for k >= 0, constant -1 - k for k < 0."""
    if operand < 0:
        return load_vec4(constants, -1 - operand)
    return registers[operand & (codes.REGISTER_COUNT - 1)]


@wp.func
def xyz(v: wp.vec4) -> wp.vec3:
    """Drop w."""
    return wp.vec3(v[0], v[1], v[2])


@wp.func
def argument(materials: Materials, registers: wp.array[wp.vec4], first: int, slot: int) -> wp.vec4:
    """Return argument `slot` of the closure whose argument words start at instruction `first`."""
    word = load_vec4i(materials.code, first + slot // 3)
    return fetch(registers, materials.constants, word[1 + slot % 3])


@wp.func
def empty_closure(point: ShadingPoint) -> Closure:
    """Return the closure of a black, opaque surface."""
    c = Closure()
    c.kind = CLOSURE_NONE
    c.normal = point.normal
    c.coat_normal = point.normal
    c.ior = 1.5
    c.coat_ior = 1.5
    c.specular_level = 0.5
    c.specular_tint = wp.vec3(1.0)
    c.coat_tint = wp.vec3(1.0)
    c.sheen_tint = wp.vec3(1.0)
    return c


@wp.func
def read_principled(closure: Closure, materials: Materials, registers: wp.array[wp.vec4], first: int) -> Closure:
    """Return `closure` with the arguments that only the Principled BSDF has."""
    c = closure
    c.diffuse_roughness = argument(materials, registers, first, codes.ARG_DIFFUSE_ROUGHNESS)[0]
    c.metallic = argument(materials, registers, first, codes.ARG_METALLIC)[0]
    c.specular_level = argument(materials, registers, first, codes.ARG_SPECULAR_LEVEL)[0]
    c.specular_tint = xyz(argument(materials, registers, first, codes.ARG_SPECULAR_TINT))
    c.transmission = argument(materials, registers, first, codes.ARG_TRANSMISSION)[0]
    c.subsurface = argument(materials, registers, first, codes.ARG_SUBSURFACE)[0]
    c.coat = argument(materials, registers, first, codes.ARG_COAT)[0]
    c.coat_roughness = argument(materials, registers, first, codes.ARG_COAT_ROUGHNESS)[0]
    c.coat_ior = argument(materials, registers, first, codes.ARG_COAT_IOR)[0]
    c.coat_tint = xyz(argument(materials, registers, first, codes.ARG_COAT_TINT))
    c.coat_normal = normalize_or(xyz(argument(materials, registers, first, codes.ARG_COAT_NORMAL)), c.normal)
    c.sheen = argument(materials, registers, first, codes.ARG_SHEEN)[0]
    c.sheen_roughness = argument(materials, registers, first, codes.ARG_SHEEN_ROUGHNESS)[0]
    c.sheen_tint = xyz(argument(materials, registers, first, codes.ARG_SHEEN_TINT))
    c.emission_layered = xyz(argument(materials, registers, first, codes.ARG_EMISSION))
    if argument(materials, registers, first, codes.ARG_THIN_WALL)[0] != 0.0:
        c.thin_wall = 1
    return c


@wp.func
def read_subsurface(
    closure: Closure, materials: Materials, registers: wp.array[wp.vec4], method: int, first: int
) -> Closure:
    """Return `closure` with how it scatters light below the surface."""
    c = closure
    c.subsurface_method = method
    c.subsurface_radius = xyz(argument(materials, registers, first, codes.ARG_SUBSURFACE_RADIUS))
    c.subsurface_ior = argument(materials, registers, first, codes.ARG_SUBSURFACE_IOR)[0]
    c.subsurface_anisotropy = argument(materials, registers, first, codes.ARG_SUBSURFACE_ANISOTROPY)[0]
    return c


@wp.func
def read_closure(
    point: ShadingPoint, materials: Materials, registers: wp.array[wp.vec4], sub: int, first: int, sums: Closure
) -> Closure:
    """Return the BSDF of a closure instruction; emission, transparency and holdout are those of `sums`."""
    c = empty_closure(point)
    c.kind = sub & 255
    if (sub & codes.CLOSURE_MULTISCATTER) != 0:
        c.multiscatter = 1
    c.color = xyz(argument(materials, registers, first, codes.ARG_COLOR))
    c.normal = normalize_or(xyz(argument(materials, registers, first, codes.ARG_NORMAL)), point.normal)
    c.coat_normal = c.normal
    c.roughness = argument(materials, registers, first, codes.ARG_ROUGHNESS)[0]
    c.diffuse_roughness = c.roughness
    c.ior = argument(materials, registers, first, codes.ARG_IOR)[0]
    c.tangent = xyz(argument(materials, registers, first, codes.ARG_TANGENT))
    c.anisotropic = argument(materials, registers, first, codes.ARG_ANISOTROPIC)[0]
    c.anisotropic_rotation = argument(materials, registers, first, codes.ARG_ANISOTROPIC_ROTATION)[0]
    if c.kind == CLOSURE_SHEEN:
        c.sheen = 1.0
        c.sheen_tint = c.color
        c.sheen_roughness = c.roughness
    if c.kind == CLOSURE_PRINCIPLED:
        c = read_principled(c, materials, registers, first)
        method = (sub & codes.CLOSURE_SUBSURFACE) >> codes.CLOSURE_SUBSURFACE_SHIFT
        if method != 0:
            c = read_subsurface(c, materials, registers, method, first)
    if (sub & codes.CLOSURE_FILM) != 0:
        c.film_thickness = argument(materials, registers, first, codes.ARG_FILM_THICKNESS)[0]
        c.film_ior = argument(materials, registers, first, codes.ARG_FILM_IOR)[0]
    c.emission = sums.emission
    c.transparency = sums.transparency
    c.holdout = sums.holdout
    return c


@wp.func
def drawing_weight(materials: Materials, registers: wp.array[wp.vec4], sub: int, first: int) -> float:
    """Return the weight by which a closure competes with its neighbours: its share of light where that is known.

    By the brightest channel: divided by such odds, a colour of a mix that makes no light is never above 1, which the
    G-buffer could not hold.
    """
    weight = wp.max(argument(materials, registers, first, codes.ARG_WEIGHT)[0], 0.0)
    if (sub & 255) == CLOSURE_PRINCIPLED:
        return weight
    # The colour of a simple BSDF is its albedo; a black one contributes nothing and may never be drawn.
    return weight * wp.max(max_component(xyz(argument(materials, registers, first, codes.ARG_COLOR))), 0.0)
