# SPDX-License-Identifier: GPL-3.0-or-later
"""Which programs the lean node machine (kernels/node_lean.py) can run, and which need other kernels than most.

The lean one knows common instructions and one plain closure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..kernels import node_codes as codes
from ..kernels.node_lean import LEAN_REGISTERS
from ..kernels.types import CLOSURE_DIFFUSE, CLOSURE_HAIR, CLOSURE_PRINCIPLED
from .program import Program
from .program_layout import OPERANDS, Instruction

__all__ = ["LeanPrograms", "has_film", "is_lean", "is_lean_strand", "is_lean_transparency", "looks_within"]

LEAN_MATH = {
    codes.MATH_ADD, codes.MATH_SUBTRACT, codes.MATH_MULTIPLY, codes.MATH_DIVIDE, codes.MATH_MULTIPLY_ADD,
    codes.MATH_MINIMUM, codes.MATH_MAXIMUM, codes.MATH_LESS_THAN, codes.MATH_GREATER_THAN, codes.MATH_CLAMP,
}
LEAN_VECTOR = {
    codes.VECTOR_COMBINE, codes.VECTOR_X, codes.VECTOR_Y, codes.VECTOR_Z, codes.VECTOR_W, codes.VECTOR_XYZ,
    codes.VECTOR_ADD, codes.VECTOR_SUBTRACT, codes.VECTOR_MULTIPLY, codes.VECTOR_SCALE,
}
LEAN_MIX = {codes.MIX_MIX, codes.MIX_MULTIPLY, codes.MIX_ADD, codes.MIX_SUBTRACT}
LEAN_INPUT = {codes.INPUT_UV, codes.INPUT_ATTRIBUTE}

LEAN_OPERATIONS: dict[int, Callable[[int], bool]] = {
    codes.OP_MATH: LEAN_MATH.__contains__,
    codes.OP_VECTOR: LEAN_VECTOR.__contains__,
    codes.OP_MIX: LEAN_MIX.__contains__,
    codes.OP_INPUT: LEAN_INPUT.__contains__,
    codes.OP_IMAGE: lambda sub: sub & 15 == codes.PROJECTION_FLAT,
    codes.OP_TRANSFORM: lambda sub: True,
    codes.OP_TRANSPARENT: lambda sub: True,
}
"""By opcode: whether a sub-operation is known"""

SURFACE_OPERATIONS = LEAN_OPERATIONS | {
    codes.OP_NORMAL_MAP: lambda sub: True,
    codes.OP_EMIT: lambda sub: True,
    codes.OP_CLOSURE: lambda sub: sub & 255 in (CLOSURE_PRINCIPLED, CLOSURE_DIFFUSE) and not sub & codes.CLOSURE_FILM,
}
"""The same in surface programs"""

STRAND_OPERATIONS = {op: known for op, known in LEAN_OPERATIONS.items() if op != codes.OP_TRANSPARENT} | {
    codes.OP_VECTOR: (LEAN_VECTOR | {codes.VECTOR_NORMALIZE}).__contains__,
    codes.OP_SPACE: lambda sub: True,
    codes.OP_CLOSURE: lambda sub: sub & 255 == CLOSURE_HAIR,
}
"""The same in programs of hair"""

ZERO_ARGUMENTS = (
    codes.ARG_DIFFUSE_ROUGHNESS, codes.ARG_TRANSMISSION, codes.ARG_COAT, codes.ARG_SHEEN, codes.ARG_THIN_WALL,
)
"""Arguments of a Principled BSDF that add what the lean closure lacks"""


@dataclass(frozen=True)
class LeanPrograms:
    """Which kinds of program the lean machine can run, of all materials of a scene."""

    surface: bool = True
    flat: bool = True
    transparency: bool = True
    plain: bool = True
    """Surface programs where glass may be a part of the closure"""
    films: bool = False
    """Whether any surface has a thin film"""
    exact: bool = False
    """Whether any material has an exact program (MaterialData.exact)"""
    hair: bool = False
    """Whether any has one for hair that scatters light (MaterialData.hair)"""
    strands: bool = False
    """Whether that is all that any of these does (is_hair_alone)"""
    lean_strands: bool = True
    """Whether kernels/node_strands.py can run all programs for hair"""


def is_lean(code: Sequence[Instruction], program: Program, *, glass: bool = False) -> bool:
    """Return whether the lean machine can run a surface or flat program: one of `program`'s lists.

    Args:
        code: The list.
        program: Whose constants it reads.
        glass: Whether the closure may let light through (node_lean.plain_bsdf).
    """
    at = _first_closure(code)
    if at < 0:
        return _known(code, SURFACE_OPERATIONS)
    return _is_last(code, at) and _known(code, SURFACE_OPERATIONS) and _is_plain(code, program, at, glass)


def is_lean_strand(program: Program) -> bool:
    """Return whether the lean machine of hair (kernels/node_strands.py) can run a program for hair."""
    at = _first_closure(program.surface)
    return at >= 0 and _is_last(program.surface, at) and _known(program.surface, STRAND_OPERATIONS)


def has_film(program: Program) -> bool:
    """Return whether a surface program has a closure with a thin film."""
    return any(word[0] & 255 == codes.OP_CLOSURE and word[0] >> 16 & codes.CLOSURE_FILM for word in program.surface)


def looks_within(program: Program) -> bool:
    """Return whether an exact program sends rays within the object."""
    traced = [head >> 16 for head, *_ in program.surface if head & 255 == codes.OP_TRACE]
    return any(sub & (codes.TRACE_BEVEL | codes.TRACE_LOCAL) for sub in traced)


def is_lean_transparency(program: Program) -> bool:
    """Return whether the lean machine can run the transparency program."""
    return _known(program.transparency, LEAN_OPERATIONS)


def _first_closure(code: Sequence[Instruction]) -> int:
    """Return where the first closure is, -1 without one."""
    return next((at for at, word in enumerate(code) if word[0] & 255 == codes.OP_CLOSURE), -1)


def _is_last(code: Sequence[Instruction], at: int) -> bool:
    """Return whether nothing but its arguments follows a closure: lean machines stop there."""
    return at + code[at][2] + 1 == len(code)


def _known(code: Sequence[Instruction], known: dict[int, Callable[[int], bool]]) -> bool:
    """Return whether all instructions are known and no register is beyond the lean machine's."""
    for head, *words in code:
        op = head & 255
        if op != codes.OP_ARGS and not (op in known and known[op](head >> 16 & 65535)):
            return False
        if max([head >> 8 & 255, *words[:OPERANDS[op]]]) >= LEAN_REGISTERS:
            return False
    return True


def _is_plain(code: Sequence[Instruction], program: Program, at: int, glass: bool) -> bool:
    """Return whether a closure has no lobe besides metal, dielectric, Lambert's and perhaps glass."""
    def is_zero(slot: int) -> bool:
        operand = code[at + 1 + slot // 3][1 + slot % 3]
        return operand < 0 and program.constants[-1 - operand][:3] == (0.0, 0.0, 0.0)

    if code[at][0] >> 16 & 255 == CLOSURE_DIFFUSE:
        return is_zero(codes.ARG_ROUGHNESS)
    isotropic = is_zero(codes.ARG_ANISOTROPIC) or is_zero(codes.ARG_TANGENT)
    return isotropic and all(is_zero(slot) for slot in ZERO_ARGUMENTS if not (glass and slot == codes.ARG_TRANSMISSION))
