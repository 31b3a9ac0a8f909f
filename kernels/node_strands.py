# SPDX-License-Identifier: GPL-3.0-or-later
"""The lean node machine for programs of hair: a tenth of the full one, for what rays over strands run at each of them.

engine/lean.py says which programs it can run: those of one closure, hair's, and of the lean machine's instructions, two
more of which tell how strands run.
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import normalize_or
from .node_closure import empty_closure, xyz
from .node_lean import LeanRegisters, argument_operand, fetch_lean, plain_value, register_of
from .node_normal import change_space
from .types import CLOSURE_HAIR, Closure, Scene, ShadingPoint
from .wide_loads import load_vec4i


@wp.func
def strand_value(scene: Scene, point: ShadingPoint, word: wp.vec4i, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate one instruction that writes a register."""
    op = word[0] & 255
    sub = (word[0] >> 16) & 65535
    if op == codes.OP_SPACE:
        v = change_space(scene, point, sub, xyz(a))
        return wp.vec4(v[0], v[1], v[2], 0.0)
    if op == codes.OP_VECTOR and sub == codes.VECTOR_NORMALIZE:
        v = normalize_or(xyz(a), xyz(a))
        return wp.vec4(v[0], v[1], v[2], 0.0)
    return plain_value(scene, point, word, a, b, c)


@wp.func
def strand_argument(scene: Scene, registers: LeanRegisters, first: int, slot: int) -> wp.vec4:
    """Return an argument of the closure whose argument words start at instruction `first`."""
    operand = argument_operand(scene, first, slot)
    return fetch_lean(scene, operand, registers[register_of(operand)])


@wp.func
def run_strand(scene: Scene, point: ShadingPoint, start: int) -> Closure:
    """Run a lean program of hair. The closure, of hair whatever its weight, comes last in it."""
    registers = LeanRegisters()
    pc = int(start)
    word = load_vec4i(scene.materials.code, pc)
    while (word[0] & 255) != codes.OP_CLOSURE:
        registers[register_of(word[0] >> 8)] = strand_value(
            scene, point, word, fetch_lean(scene, word[1], registers[register_of(word[1])]),
            fetch_lean(scene, word[2], registers[register_of(word[2])]),
            fetch_lean(scene, word[3], registers[register_of(word[3])]))
        pc += 1
        word = load_vec4i(scene.materials.code, pc)
    first = pc + 1
    closure = empty_closure(point)
    closure.kind = CLOSURE_HAIR
    closure.weight = xyz(strand_argument(scene, registers, first, codes.ARG_WEIGHT))
    closure.color = xyz(strand_argument(scene, registers, first, codes.ARG_COLOR))
    closure.normal = normalize_or(xyz(strand_argument(scene, registers, first, codes.ARG_NORMAL)), point.normal)
    closure.roughness = strand_argument(scene, registers, first, codes.ARG_ROUGHNESS)[0]
    closure.ior = strand_argument(scene, registers, first, codes.ARG_IOR)[0]
    closure.tangent = xyz(strand_argument(scene, registers, first, codes.ARG_TANGENT))
    closure.anisotropic = strand_argument(scene, registers, first, codes.ARG_ANISOTROPIC)[0]
    closure.anisotropic_rotation = strand_argument(scene, registers, first, codes.ARG_ANISOTROPIC_ROTATION)[0]
    closure.film_thickness = strand_argument(scene, registers, first, codes.ARG_FILM_THICKNESS)[0]
    return closure


@wp.func
def strand_start(scene: Scene, material: int) -> int:
    """Return the first instruction of a material's program of hair."""
    return load_vec4i(scene.materials.code, scene.materials.materials[material].surface_start - 1)[2]
