# SPDX-License-Identifier: GPL-3.0-or-later
"""The program builder: folding, sharing, dead code, registers, and resolving names on the device."""

from __future__ import annotations

import pickle
import random

import numpy as np
import pytest
from burnish.engine.materials import MaterialTable, attribute_names, default_material
from burnish.engine.program import ProgramBuilder, RegisterOverflow, tangent_attribute
from burnish.engine.program_layout import OPERANDS
from burnish.engine.scene import CameraData, MaterialData
from burnish.kernels import node_codes as codes


def opcodes(instructions: tuple) -> list[int]:
    """Return the opcodes of a listing."""
    return [head & 255 for head, *_ in instructions]


def interpret(program, leaves: dict[int, float]) -> list[float]:
    """Return what each EMIT instruction adds, for programs of inputs, sums and products."""
    registers: dict[int, float] = {}
    emitted = []

    def read(word: int) -> float:
        return program.constants[-1 - word][0] if word < 0 else registers[word]

    for head, *words in program.emission:
        op, out, sub = head & 255, head >> 8 & 255, head >> 16
        if op == codes.OP_INPUT:
            registers[out] = leaves[words[1]]
        elif op == codes.OP_EMIT:
            emitted.append(read(words[0]) * read(words[1]) * read(words[2]))
        else:
            a, b = read(words[0]), read(words[1])
            registers[out] = a + b if sub == codes.MATH_ADD else a * b
    return emitted


def test_fold_constants():
    """Compute constant expressions while building."""
    build = ProgramBuilder()
    assert build.math("POWER", 2.0, 3.0).constant[0] == pytest.approx(8.0)
    assert build.mix("MIX", 0.25, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)).constant[:3] == pytest.approx((0.75, 0.25, 0.0))
    assert build.vector("CROSS_PRODUCT", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)).constant[:3] == (0.0, 0.0, 1.0)
    assert build.color("BLACKBODY", 6500.0).constant[0] == pytest.approx(1.0, abs=0.1)
    assert build.math("MULTIPLY", build.input("RAY_DEPTH"), 0.0).constant[0] == 0.0


def test_share_equal_values():
    """Compute equal expressions once."""
    build = ProgramBuilder()
    first = build.math("SINE", build.math("ADD", build.uv("a"), 0.5))
    second = build.math("SINE", build.math("ADD", build.uv("a"), 0.5))
    assert first is second
    build.emit(first, second, 1.0)
    assert opcodes(build.finish().emission) == [codes.OP_INPUT, codes.OP_MATH, codes.OP_MATH, codes.OP_EMIT]


def test_split_programs():
    """Leave out of each program what it does not need."""
    build = ProgramBuilder()
    build.closure("DIFFUSE", 1.0, color=build.image("wood", build.uv("")))
    build.transparent(1.0, build.component(build.attribute("mask"), 0))
    build.emit(build.math("SINE", build.input("RAY_LENGTH")), 2.0, 1.0)
    program = build.finish()
    assert codes.OP_IMAGE in opcodes(program.surface)
    assert opcodes(program.transparency) == [codes.OP_INPUT, codes.OP_VECTOR, codes.OP_TRANSPARENT]
    assert opcodes(program.emission) == [codes.OP_INPUT, codes.OP_MATH, codes.OP_EMIT]
    assert opcodes(program.surface).count(codes.OP_ARGS) == 3
    assert program.images == ("wood",) and program.uv_maps == ("",) and program.attributes == ("mask",)


def test_drop_empty_sinks():
    """Forget contributions of nothing, so that flags are exact."""
    build = ProgramBuilder()
    build.transparent(1.0, 0.0)
    build.emit((0.0, 0.0, 0.0), build.uv(""), 1.0)
    build.closure("GLASS", 0.0, color=1.0)
    assert not build.has_transparency() and not build.has_emission()
    assert build.finish().surface == ()


def test_constant_emission():
    """Tell constant emission from emission that varies."""
    build = ProgramBuilder()
    build.emit((1.0, 2.0, 3.0), 2.0, 0.5)
    build.emit((1.0, 0.0, 0.0), 1.0, 1.0, layered=True)
    assert build.constant_emission() == (2.0, 2.0, 3.0)
    build.emit(build.input("BACKFACING"), 1.0, 1.0)
    assert build.constant_emission() is None


@pytest.mark.parametrize("seed", range(20))
def test_allocate_registers(seed: int):
    """Keep every value until its last reader, whatever the graph."""
    choose = random.Random(seed)
    build = ProgramBuilder()
    leaves = {mask: choose.uniform(0.5, 1.5) for mask in range(1, 9)}
    pool = [(build.input("RAY_KIND", mask), value) for mask, value in leaves.items()]
    for _ in range(40):
        (a, x), (b, y) = choose.choice(pool[-12:]), choose.choice(pool[-12:])
        if choose.random() < 0.5:
            pool.append((build.math("ADD", a, b), x + y))
        else:
            pool.append((build.math("MULTIPLY", a, build.constant(0.5)), x * 0.5))
    expected = []
    for value, number in choose.sample(pool, 6):
        build.emit(value, 1.0, 1.0)
        expected.append(number)
    program = build.finish()
    assert interpret(program, leaves) == pytest.approx(expected, rel=1e-6)
    assert max((head >> 8 & 255) for head, *_ in program.emission) < codes.REGISTER_COUNT


def test_recompute_before_overflow():
    """Compute shared values again where keeping them all would need too many registers."""
    build = ProgramBuilder()
    shared = [build.input("RAY_KIND", 1 << (i % 20) | i << 20) for i in range(60)]
    for _ in range(2):
        for value in shared:
            build.emit(value, build.math("SINE", value), 1.0)
    program = build.finish()
    assert opcodes(program.emission).count(codes.OP_INPUT) > 60


def test_report_overflow():
    """Refuse a closure that needs more values at once than there are registers."""
    build = ProgramBuilder()
    chain = [build.input("RAY_DEPTH")]
    for _ in range(60):
        chain.append(build.math("SINE", chain[-1]))
    total = chain[-1]
    for value in reversed(chain):
        # Starts from the end of the chain, so that all of it must wait.
        total = build.math("SUBTRACT", total, value)
    build.emit(total, 1.0, 1.0)
    with pytest.raises(RegisterOverflow):
        build.finish()


def test_compare_and_pickle_programs():
    """Compare programs by value and carry them between processes."""
    first, second = default_material().program, default_material().program
    assert first == second and hash(first) == hash(second)
    assert pickle.loads(pickle.dumps(first)) == first


def test_shift_for_bump():
    """Move only what varies over the surface, by the filter width."""
    build = ProgramBuilder()
    height = build.math("ADD", build.component(build.uv(""), 0), build.input("RAY_DEPTH"))
    moved = build.shifted(height, codes.INPUT_SHIFT_X, 0.1)
    assert moved is not height
    assert build.shifted(build.input("RAY_DEPTH"), codes.INPUT_SHIFT_X, 0.1) is build.input("RAY_DEPTH")
    assert build.bump(3.0, 1.0, 1.0, 0.1, 0.0).constant is not None


def test_every_opcode_has_operands():
    """Know of each opcode how many operands it has."""
    assert {value for name, value in vars(codes).items() if name.startswith("OP_")} == set(OPERANDS)


def table_of(program, **resolvers) -> MaterialTable:
    """Return a table with one material `m`."""
    table = MaterialTable("cpu")
    table.build({"m": MaterialData(name="m", program=program)}, None, lambda key: 7,
                resolvers.get("uv", lambda name: -1), resolvers.get("attribute", lambda name: -1))
    return table


def test_resolve_names():
    """Replace names by ids, and what no mesh has by zero."""
    build = ProgramBuilder()
    build.emit(build.image("key", build.uv("map")), build.component(build.attribute("map"), 0),
               build.component(build.attribute("gone"), 0))
    table = table_of(build.finish(), uv=lambda name: 4 if name == "map" else -1)
    code = table.struct().code.numpy()
    start = table.struct().materials.numpy()[table.index("m")]["emission_start"]
    inputs = [row for row in code[start:] if row[0] & 255 == codes.OP_INPUT]
    assert [int(row[2]) for row in inputs] == [4, 4]
    assert all(row[0] >> 16 == codes.INPUT_UV for row in inputs)
    assert {int(row[2]) for row in code if row[0] & 255 == codes.OP_IMAGE} == {7}


def test_name_what_programs_read():
    """List UV maps and attributes, tangents apart: they are optional."""
    build = ProgramBuilder()
    build.emit(build.normal_map("TANGENT", build.attribute("c"), 1.0, uv_map="u",
                                tangent_attribute=tangent_attribute("u")), 1.0, 1.0)
    program = build.finish()
    assert program.uv_maps == ("u",) and attribute_names([program]) == ["c"]
    table = table_of(program, uv=lambda name: 2, attribute=lambda name: 5)
    code = table.struct().code.numpy()
    word = next(row[3] for row in code if row[0] & 255 == codes.OP_NORMAL_MAP)
    assert (word & 65535) - 1 == 2 and (word >> 16) - 1 == 5


def test_relocate_constants():
    """Keep each program's constants apart."""
    build = ProgramBuilder()
    build.emit(build.math("ADD", build.input("RAY_DEPTH"), 0.25), 1.0, 1.0)
    table = table_of(build.finish())
    code, constants = table.struct().code.numpy(), table.struct().constants.numpy()
    word = next(row for row in code if row[0] & 255 == codes.OP_MATH)
    assert constants[-1 - word[2]][0] == 0.25


def test_default_material_is_first():
    """Give unknown keys the default material."""
    table = table_of(default_material().program)
    assert table.index(None) == 0 and table.index("unknown") == 0 and table.index("m") == 1


def test_set_camera():
    """Put the camera's inverse, z forward, among the constants."""
    table = MaterialTable("cpu")
    matrix = np.eye(4)
    matrix[:3, 3] = (1.0, 2.0, 3.0)
    table.set_camera(CameraData(transform=tuple(matrix.ravel()), window=(-1.0, 1.0, -2.0, 2.0)))
    constants = table.struct().constants.numpy()
    seen = constants[codes.CONSTANT_CAMERA:codes.CONSTANT_CAMERA + 3] @ (1.0, 2.0, -7.0, 1.0)
    np.testing.assert_allclose(seen, (0.0, 0.0, 10.0))
    np.testing.assert_allclose(constants[codes.CONSTANT_WINDOW], (-1.0, 1.0, -2.0, 2.0))
