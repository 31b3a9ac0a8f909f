# SPDX-License-Identifier: GPL-3.0-or-later
"""From a graph of values to instructions: order, registers, operand words. Used by engine/program.py alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..kernels import node_codes as codes

__all__ = ["OPERANDS", "Instruction", "RegisterOverflow", "Sink", "Value", "ancestors", "flat_sinks", "lay_out"]

Instruction = tuple[int, int, int, int]

OPERANDS = {
    codes.OP_ARGS: 3, codes.OP_MATH: 3, codes.OP_VECTOR: 3, codes.OP_MIX: 3, codes.OP_COLOR: 3, codes.OP_INPUT: 1,
    codes.OP_IMAGE: 1, codes.OP_TRANSFORM: 1, codes.OP_RAMP: 1, codes.OP_PROCEDURAL: 3, codes.OP_FRESNEL: 2,
    codes.OP_NORMAL_MAP: 2, codes.OP_BUMP: 3, codes.OP_SPACE: 1, codes.OP_EMIT: 3, codes.OP_TRANSPARENT: 2,
    codes.OP_HOLDOUT: 1, codes.OP_TRACE: 2, codes.OP_CLOSURE: 0, codes.OP_END: 0,
}
"""How many of an instruction's words after the first are operands; immediates follow them"""


class RegisterOverflow(Exception):
    """The graph keeps more values alive at once than the node machine has registers."""


@dataclass(frozen=True)
class Value:
    """One operation's result, or a constant."""

    index: int
    op: int
    """Opcode, -1 for constants"""
    sub: int
    args: tuple[int, ...]
    """Indices of the operands' values"""
    immediates: tuple[int, ...]
    constant: tuple[float, float, float, float] | None


@dataclass(frozen=True)
class Sink:
    """What a program ends in: a contribution to the closure."""

    op: int
    sub: int
    operands: tuple[int, ...]
    programs: str
    """Programs it is part of: s surface, t transparency, e emission"""


def flat_sinks(sinks: list[Sink], zero: Value) -> list[Sink]:
    """Return the sinks with `zero`, which stands for the shading normal, as every closure's normal."""
    normals = {codes.ARG_NORMAL, codes.ARG_COAT_NORMAL}
    return [
        replace(sink, operands=tuple(zero.index if slot in normals else x for slot, x in enumerate(sink.operands)))
        if sink.op == codes.OP_CLOSURE else sink for sink in sinks]


def ancestors(values: list[Value], value: Value) -> list[int]:
    """Return the indices of everything `value` depends on, itself included, operands first."""
    needed = {value.index}
    stack = [value.index]
    while stack:
        for arg in values[stack.pop()].args:
            if arg not in needed:
                needed.add(arg)
                stack.append(arg)
    # Operands are always older than what uses them.
    return sorted(needed)


def register_needs(values: list[Value]) -> list[int]:
    """Return roughly how many registers each value needs for its evaluation (Sethi and Ullman 1970)."""
    needs: list[int] = []
    for value in values:
        below = sorted((needs[arg] for arg in value.args), reverse=True)
        own = 0 if value.constant is not None else 1
        needs.append(max([own] + [need + rank for rank, need in enumerate(below)]))
    return needs


def evaluation_order(values: list[Value], roots: tuple[int, ...], done: set[int], needs: list[int]) -> list[int]:
    """Return the values to compute for `roots`, operands first, those that need most registers earliest."""
    order: list[int] = []
    stack = [(root, False) for root in sorted(roots, key=lambda i: needs[i])]
    while stack:
        index, ready = stack.pop()
        if index in done or values[index].constant is not None:
            continue
        if ready:
            done.add(index)
            order.append(index)
            continue
        stack.append((index, True))
        stack.extend((arg, False) for arg in sorted(values[index].args, key=lambda i: needs[i]))
    return order


def schedule(values: list[Value], sinks: list[Sink], share: bool) -> list[Value | Sink]:
    """Return values and sinks in order; without `share` every sink computes its own copies."""
    needs = register_needs(values)
    steps: list[Value | Sink] = []
    done: set[int] = set()
    for sink in sinks:
        if not share:
            done = set()
        steps += [values[index] for index in evaluation_order(values, sink.operands, done, needs)]
        steps.append(sink)
    return steps


def reads(step: Value | Sink) -> tuple[int, ...]:
    """Return the values a step reads."""
    return step.args if isinstance(step, Value) else step.operands


def lay_out(
    values: list[Value], sinks: list[Sink], program: str, constants: dict[tuple, int]
) -> tuple[Instruction, ...]:
    """Return the instructions of one program (`s`, `t` or `e`), adding to `constants` what they use.

    Raises:
        RegisterOverflow: More values are alive at once than there are registers, even without sharing any
            between the sinks.
    """
    # Closures last: then the lean machine need not keep one while it computes what other sinks need.
    chosen = sorted((sink for sink in sinks if program in sink.programs), key=lambda sink: sink.op == codes.OP_CLOSURE)
    try:
        return allocate(values, schedule(values, chosen, True), constants)
    except RegisterOverflow:
        return allocate(values, schedule(values, chosen, False), constants)


def allocate(values: list[Value], steps: list[Value | Sink], constants: dict[tuple, int]) -> tuple[Instruction, ...]:
    """Assign registers along `steps`, each freed after its last reader, and return the instructions."""
    # A value computed twice lives from each computation to the last reader before the next one.
    last_reader: dict[tuple[int, int], int] = {}
    computed_at: dict[int, int] = {}
    for position, step in enumerate(steps):
        for index in reads(step):
            if index in computed_at:
                last_reader[index, computed_at[index]] = position
        if isinstance(step, Value):
            computed_at[step.index] = position
    free = list(range(codes.REGISTER_COUNT - 1, -1, -1))
    registers: dict[int, tuple[int, int]] = {}
    code: list[Instruction] = []

    def operand(index: int) -> int:
        value = values[index]
        if value.constant is not None:
            return -1 - constants.setdefault(value.constant, len(constants))
        return registers[index][0]

    for position, step in enumerate(steps):
        operands = [operand(index) for index in reads(step)]
        for index in set(reads(step)):
            if index in registers and last_reader[index, registers[index][1]] == position:
                free.append(registers.pop(index)[0])
        out = 0
        if isinstance(step, Value):
            if not free:
                raise RegisterOverflow(f"more than {codes.REGISTER_COUNT} values are needed at once")
            out = free.pop()
            registers[step.index] = out, position
        code += encode(step, out, operands)
    return tuple(code)


def encode(step: Value | Sink, out: int, operands: list[int]) -> list[Instruction]:
    """Return the instruction of a step, and a closure's argument words."""
    head = step.op | out << 8 | step.sub << 16
    if step.op == codes.OP_CLOSURE:
        words = [tuple(operands[i:i + 3]) for i in range(0, len(operands), 3)]
        return [(head, 0, len(words), 0)] + [(codes.OP_ARGS, *word) for word in words]
    immediates = step.immediates if isinstance(step, Value) else ()
    words = [*operands, *immediates, 0, 0, 0]
    return [(head, words[0], words[1], words[2])]
