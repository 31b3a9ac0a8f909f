# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs of the node machine and the builder that compiles node graphs into them.

A Program is what kernels/nodes.py interprets, except that images, UV maps and attributes are still named; they are
resolved by engine/materials.py. ProgramBuilder takes a graph one operation at a time, folds constants, shares equal
expressions, leaves out what nothing uses, and allocates registers. Knows nothing of Blender.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

from ..kernels import node_codes as codes
from .closure_arguments import ARGUMENTS, HAIR_ARGUMENTS, closure_code, slot_count
from .program_fold import fold
from .program_layout import Instruction, RegisterOverflow, Sink, Value, ancestors, flat_sinks, lay_out

__all__ = ["Program", "ProgramBuilder", "RegisterOverflow", "Value", "tangent_attribute"]

Vec4 = tuple[float, float, float, float]

SHIFTED_INPUTS = {
    codes.INPUT_UV, codes.INPUT_ATTRIBUTE, codes.INPUT_POSITION, codes.INPUT_GENERATED, codes.INPUT_OBJECT,
    codes.INPUT_OBJECT_NORMAL, codes.INPUT_PARAMETRIC,
}
"""Inputs that change from point to point of a surface, as far as bump mapping is concerned"""

CARRY_ALPHA = {codes.INPUT_ATTRIBUTE, codes.INPUT_OBJECT_COLOR, codes.INPUT_PROPERTY}
"""Inputs whose w is alpha"""

TANGENT_PREFIX = ".tangent:"

NEUTRAL_AT_ZERO = {"MIX", "MULTIPLY", "ADD", "SUBTRACT", "DIFFERENCE", "DARKEN", "LIGHTEN", "LINEAR_LIGHT"}
"""Blend types that return their first colour untouched for a factor of 0; the others may clamp it"""


def operation_code(family: str, name: str) -> int:
    """Return the code of an operation of a family (MATH, VECTOR, MIX, ...); KeyError names what is unknown."""
    return vars(codes)[f"{family}_{name}"]


@dataclass(frozen=True)
class Program:
    """Compiled node graph: four instruction lists over shared tables; equal programs compare equal."""

    surface: tuple[Instruction, ...] = ()
    """Everything; each list ends without OP_END"""
    transparency: tuple[Instruction, ...] = ()
    emission: tuple[Instruction, ...] = ()
    flat: tuple[Instruction, ...] = ()
    """The surface program without normal maps and bump: for rays that see a wide part of a surface at once"""
    constants: tuple[Vec4, ...] = ()
    ramps: tuple[bytes, ...] = ()
    """Tables as float32 [RAMP_SIZE, 4]"""
    images: tuple[Hashable, ...] = ()
    """Image keys by the index that instructions carry"""
    uv_maps: tuple[str, ...] = ()
    """Names of UV maps alike; the empty name is the active render map"""
    attributes: tuple[str, ...] = ()
    """Names of attributes alike; the empty name is the active colour attribute"""
    uses_camera: bool = False
    """Depends on the camera's place (window or camera coordinates)"""


class ProgramBuilder:
    """Compiles one graph. Operations return values to be passed to further operations; sinks end the graph.

    Numbers are accepted wherever values are. Scalars live in all three of xyz, so that they serve as vectors too.
    """

    def __init__(self) -> None:
        """Start an empty program."""
        self.values: list[Value] = []
        self.known: dict[tuple, Value] = {}
        self.numbers: dict[float, Value] = {}
        self.sinks: list[Sink] = []
        self.ramps: list[bytes] = []
        self.images: list[Hashable] = []
        self.uv_maps: list[str] = []
        self.attributes: list[str] = []
        self.rows: list[tuple[Vec4, Vec4, Vec4]] = []
        self.uses_camera = False

    # Values.

    def constant(self, value: float | Sequence[float] | Value) -> Value:
        """Return a constant: a number (in all of xyz), a vector of three, or four components; values pass through."""
        if isinstance(value, Value):
            return value
        if isinstance(value, (int, float)):
            if value not in self.numbers:
                self.numbers[value] = self.constant((value, value, value))
            return self.numbers[value]
        components = tuple(float(x) if math.isfinite(x) else 0.0 for x in value)
        constant = (components + (0.0,))[:4]
        return self._intern(Value(len(self.values), -1, 0, (), (), constant))

    def _intern(self, value: Value) -> Value:
        """Return the value equal to `value` that exists already, else `value`, recorded."""
        key = (value.op, value.sub, value.args, value.immediates, value.constant)
        if key not in self.known:
            self.known[key] = value
            self.values.append(value)
        return self.known[key]

    def _add(self, op: int, sub: int, args: Sequence, immediates: tuple[int, ...] = ()) -> Value:
        """Return the value of an operation, folded where all its operands are constant."""
        operands = [self.constant(arg) for arg in args]
        constants = tuple(operand.constant for operand in operands)
        if None not in constants:
            folded = fold(op, sub, constants)
            if folded is not None:
                return self.constant(folded)
        return self._intern(Value(len(self.values), op, sub, tuple(v.index for v in operands), immediates, None))

    def math(self, name: str, a, b=0.0, c=0.0) -> Value:
        """Return a scalar operation (names of Blender's Math node, CLAMP, MAP_*, UNEQUAL)."""
        a, b, c = self.constant(a), self.constant(b), self.constant(c)
        if name == "MULTIPLY" and 1.0 in (scalar(a), scalar(b)):
            return b if scalar(a) == 1.0 else a
        if name == "MULTIPLY" and 0.0 in (scalar(a), scalar(b)):
            return self.constant(0.0)
        if name == "ADD" and 0.0 in (scalar(a), scalar(b)):
            return b if scalar(a) == 0.0 else a
        return self._add(codes.OP_MATH, operation_code("MATH", name), (a, b, c))

    def vector(self, name: str, a, b=0.0, c=0.0) -> Value:
        """Return a vector operation (names of Blender's Vector Math node and codes.VECTOR_*)."""
        a, b, c = self.constant(a), self.constant(b), self.constant(c)
        if name in ("MULTIPLY", "DIVIDE") and scalar(b) == 1.0:
            return a
        if name == "MULTIPLY" and scalar(a) == 1.0:
            return b
        if name in ("ADD", "SUBTRACT") and scalar(b) == 0.0:
            return a
        if name == "ADD" and scalar(a) == 0.0:
            return b
        return self._add(codes.OP_VECTOR, operation_code("VECTOR", name), (a, b, c))

    def combine(self, x, y, z) -> Value:
        """Return the vector of three numbers."""
        return self.vector("COMBINE", x, y, z)

    def component(self, value, index: int) -> Value:
        """Return component 0..3 (x, y, z, w) as a number."""
        return self.vector("XYZW"[index], value)

    def rgb(self, value) -> Value:
        """Return xyz with w cleared: for colours (whose w is alpha) used as coordinates (whose w is a width)."""
        value = self.constant(value)
        carries_alpha = value.op == codes.OP_IMAGE or value.op == codes.OP_RAMP or (
            value.op == codes.OP_INPUT and value.sub & 255 in CARRY_ALPHA)
        return self.vector("XYZ", value) if carries_alpha else value

    def mix(self, name: str, factor, a, b) -> Value:
        """Return b blended over a (names of Blender's blend types)."""
        factor = self.constant(factor)
        if scalar(factor) == 0.0 and name in NEUTRAL_AT_ZERO:
            return self.rgb(a)
        if scalar(factor) == 1.0 and name == "MIX":
            return self.rgb(b)
        return self._add(codes.OP_MIX, operation_code("MIX", name), (factor, a, b))

    def color(self, name: str, a, b=0.0, c=0.0) -> Value:
        """Return a colour operation (codes.COLOR_*)."""
        return self._add(codes.OP_COLOR, operation_code("COLOR", name), (a, b, c))

    def luminance(self, color) -> Value:
        """Return the luminance of a colour by the working space's weights."""
        color = self.constant(color)
        if color.constant is not None and color.constant[0] == color.constant[1] == color.constant[2]:
            return self.constant(color.constant[0])
        if color.op in (codes.OP_MATH, codes.OP_FRESNEL):
            return color
        return self.color("LUMINANCE", color)

    def input(self, name: str, mask: int = 0) -> Value:
        """Return an input without a name of its own (codes.INPUT_*); `mask` is for RAY_KIND and KIND_DEPTH."""
        self.uses_camera |= name == "WINDOW"
        return self._add(codes.OP_INPUT, operation_code("INPUT", name), (0.0,), (mask, 0))

    def uv(self, name: str) -> Value:
        """Return the coordinate of a UV map; the empty name is the active render map."""
        return self._add(codes.OP_INPUT, codes.INPUT_UV, (0.0,), (index_of(self.uv_maps, name), 0))

    def attribute(self, name: str) -> Value:
        """Return an attribute: colour or vector in xyz, alpha in w."""
        return self._add(codes.OP_INPUT, codes.INPUT_ATTRIBUTE, (0.0,), (index_of(self.attributes, name), 0))

    def object_property(self, name: str) -> Value:
        """Return a property by its name from object_properties.py: as `attribute`."""
        number = index_of(self.attributes, name)
        return self._add(codes.OP_INPUT, codes.INPUT_PROPERTY, (0.0,), (number, 0))

    def wireframe(self, size) -> Value:
        """Return 1 within half of `size` [m] of an edge of the triangle, else 0."""
        return self._add(codes.OP_INPUT, codes.INPUT_WIREFRAME, (size,), (0, 0))

    def uv_tangent(self, uv_map: str, tangent_attribute: str) -> Value:
        """Return the world-space tangent along u of a UV map."""
        immediates = (index_of(self.uv_maps, uv_map), index_of(self.attributes, tangent_attribute))
        return self._add(codes.OP_INPUT, codes.INPUT_TANGENT_UV, (0.0,), immediates)

    def camera_space(self, *, direction: bool = False) -> Value:
        """Return the position, or a world's direction, in camera space with z forward."""
        self.uses_camera = True
        sub = codes.TRANSFORM_DIRECTION if direction else codes.TRANSFORM_POINT
        position = self.input("SCENE_POSITION")
        return self._add(codes.OP_TRANSFORM, sub, (position,), (-1 - codes.CONSTANT_CAMERA,))

    def image(self, key: Hashable, coordinate, *, projection: str = "FLAT", extension: int = 0,
              interpolation: int = 0, associate: bool = False) -> Value:
        """Return an image's colour in xyz and alpha in w.

        Args:
            key: Image key.
            coordinate: UV, or a direction for the panoramic projections; its w is the filter width.
            projection: FLAT, SPHERE, TUBE, EQUIRECTANGULAR, MIRROR_BALL or SKY.
            extension: 0 repeat, 1 extend, 2 clip, 3 mirror.
            interpolation: 0 linear, 1 closest, 2 cubic.
            associate: Multiply the colour by alpha.
        """
        sub = operation_code("PROJECTION", projection) | extension << 4 | interpolation << 6
        sub |= codes.IMAGE_ASSOCIATE if associate else 0
        return self._add(codes.OP_IMAGE, sub, (self.rgb(coordinate),), (index_of(self.images, key),))

    def transform(self, rows: Sequence[Sequence[float]], value, *, direction: bool = False) -> Value:
        """Return `value` transformed by an affine matrix given as three rows of four."""
        block = tuple(tuple(float(x) for x in row) for row in rows[:3])
        sub = codes.TRANSFORM_DIRECTION if direction else codes.TRANSFORM_POINT
        return self._add(codes.OP_TRANSFORM, sub, (self.rgb(value),), (index_of(self.rows, block),))

    def ramp(self, name: str, table: bytes, value) -> Value:
        """Look `value` up in a table of float32 [RAMP_SIZE, 4] (codes.RAMP_*: LINEAR, CONSTANT, CURVES, ...)."""
        assert len(table) == codes.RAMP_SIZE * 16, len(table)
        return self._add(codes.OP_RAMP, operation_code("RAMP", name), (value,), (index_of(self.ramps, table),))

    def procedural(self, name: str, coordinate, b=0.0, c=0.0, *options: str) -> Value:
        """Return a texture without an image (codes.PROCEDURAL_*); options are e.g. codes.VORONOI_* of VORONOI."""
        sub = sum((operation_code(name, option) for option in options), operation_code("PROCEDURAL", name))
        return self._add(codes.OP_PROCEDURAL, sub, (coordinate, b, c))

    def white_noise(self, name: str, dimensions: int, coordinate, w) -> Value:
        """Return a random number (WHITE_NOISE_1) or colour (WHITE_NOISE_COLOR_1) of a coordinate."""
        sub = operation_code("PROCEDURAL", name) + dimensions - 1
        return self._add(codes.OP_PROCEDURAL, sub, (coordinate, w, 0.0))

    def fresnel(self, name: str, value, normal=0.0) -> Value:
        """Return a weight by viewing angle (codes.FRESNEL_*); normal 0 is the shading normal."""
        return self._add(codes.OP_FRESNEL, operation_code("FRESNEL", name), (value, normal))

    def occlusion(self, distance, normal, samples: int, *, inside: bool = False, local: bool = False) -> Value:
        """Return how much is not occluded within a distance [m], by `samples` rays; for exact programs alone."""
        sub = codes.TRACE_OCCLUSION | (codes.TRACE_INSIDE if inside else 0) | (codes.TRACE_LOCAL if local else 0)
        return self._add(codes.OP_TRACE, sub, (distance, normal), (samples,))

    def bevel(self, radius, normal, samples: int) -> Value:
        """Return the normal of edges rounded by a radius [m], by `samples` rays; for exact programs alone."""
        return self._add(codes.OP_TRACE, codes.TRACE_BEVEL, (radius, normal), (samples,))

    def space(self, name: str, value) -> Value:
        """Return a vector moved between object and world space (codes.SPACE_*)."""
        return self._add(codes.OP_SPACE, operation_code("SPACE", name), (value,))

    def normal_map(self, space: str, color, strength, *, uv_map: str = "", tangent_attribute: str = "",
                   invert_green: bool = False, blender_axes: bool = False) -> Value:
        """Return the world-space normal of a normal map's texel; space is TANGENT, OBJECT or WORLD."""
        sub = operation_code("NORMAL", space)
        sub |= codes.NORMAL_INVERT_GREEN if invert_green else 0
        sub |= codes.NORMAL_BLENDER_AXES if blender_axes else 0
        names = 0
        if space == "TANGENT":
            names = index_of(self.uv_maps, uv_map) + 1 | index_of(self.attributes, tangent_attribute) + 1 << 16
        return self._add(codes.OP_NORMAL_MAP, sub, (color, strength), (names,))

    def bump(self, height, strength, distance, filter_width, normal=0.0) -> Value:
        """Return the shading normal bent by the slope of `height` [m]; distance below 0 inverts it."""
        height = self.constant(height)
        if height.constant is not None:
            return self.constant(normal)
        heights = self.combine(
            height, self.shifted(height, codes.INPUT_SHIFT_X, filter_width),
            self.shifted(height, codes.INPUT_SHIFT_Y, filter_width))
        return self._add(codes.OP_BUMP, 0, (heights, self.combine(strength, distance, filter_width), normal))

    def shifted(self, value: Value, axis: int, filter_width) -> Value:
        """Return `value` as it is `filter_width` footprints further along a bump axis (codes.INPUT_SHIFT_*)."""
        moved: dict[int, Value] = {}
        for index in ancestors(self.values, value):
            old = self.values[index]
            if old.constant is not None:
                moved[index] = old
            elif old.op == codes.OP_INPUT and old.sub in SHIFTED_INPUTS:
                moved[index] = self._add(old.op, old.sub | axis, (filter_width,), old.immediates)
            else:
                moved[index] = self._add(old.op, old.sub, [moved[arg] for arg in old.args], old.immediates)
        return moved[value.index]

    # Sinks.

    def _sink(self, op: int, sub: int, operands: Sequence, programs: str) -> None:
        """Record a sink, unless a constant operand makes it contribute nothing."""
        values = [self.constant(operand) for operand in operands]
        if any(v.constant is not None and not any(v.constant[:3]) for v in values):
            return
        self.sinks.append(Sink(op, sub, tuple(v.index for v in values), programs))

    def emit(self, color, strength, weight, *, layered: bool = False) -> None:
        """Add emission of color * strength * weight; `layered` keeps it out of the surface program."""
        self._sink(codes.OP_EMIT, 0, (color, strength, weight), "e" if layered else "se")

    def transparent(self, color, weight) -> None:
        """Let light through unrefracted."""
        self._sink(codes.OP_TRANSPARENT, 0, (color, weight), "st")

    def holdout(self, weight) -> None:
        """Cut a hole into the picture's alpha."""
        self._sink(codes.OP_HOLDOUT, 0, (weight,), "s")

    def closure(self, kind: str, weight, *, multiscatter: bool = False, subsurface_method: str = "",
                **arguments) -> None:
        """Add a BSDF (names of kernels.types.CLOSURE_*) with its arguments by the names in ARGUMENTS (HAIR_ARGUMENTS).

        `subsurface_method` (names of codes.SUBSURFACE_*) goes with the arguments that begin like it.
        """
        weight = self.constant(weight)
        if scalar(weight) == 0.0:
            return
        # Hair's last argument stands where a film's do.
        film = "film_thickness" in arguments or kind == "HAIR"
        slots: list[Value] = [self.constant(0.0)] * slot_count(kind, subsurface_method, film=film)
        places = ARGUMENTS | HAIR_ARGUMENTS
        for name, value in {"weight": weight, **arguments}.items():
            slots[places[name]] = self.constant(value)
        sub = closure_code(kind, multiscatter, subsurface_method, film=film)
        self.sinks.append(Sink(codes.OP_CLOSURE, sub, tuple(v.index for v in slots), "s"))

    # Results.

    def has_transparency(self) -> bool:
        """Return whether any light may pass unrefracted."""
        return any("t" in sink.programs for sink in self.sinks)

    def has_emission(self) -> bool:
        """Return whether any light is emitted."""
        return any("e" in sink.programs for sink in self.sinks)

    def constant_emission(self) -> tuple[float, float, float] | None:
        """Return the sum of all emission where it is the same everywhere, else None."""
        total = [0.0, 0.0, 0.0]
        for sink in self.sinks:
            if "e" not in sink.programs:
                continue
            color, strength, weight = (self.values[index].constant for index in sink.operands)
            if color is None or strength is None or weight is None:
                return None
            total = [t + c * strength[0] * weight[0] for t, c in zip(total, color[:3], strict=True)]
        return tuple(total)

    def finish(self) -> Program:
        """Return the program. Raises RegisterOverflow where the graph needs more registers than there are."""
        constants: dict[Vec4, int] = {}
        listings = [lay_out(self.values, self.sinks, name, constants) for name in "ste"]
        listings.append(lay_out(self.values, flat_sinks(self.sinks, self.constant(0.0)), "s", constants))
        surface, transparency, emission, flat = (
            tuple(move_rows(instruction, len(constants)) for instruction in listing) for listing in listings)
        rows = [row for block in self.rows for row in block]
        return Program(
            surface=surface, transparency=transparency, emission=emission, flat=flat,
            constants=tuple(constants) + tuple(rows), ramps=tuple(self.ramps), images=tuple(self.images),
            uv_maps=tuple(self.uv_maps), attributes=tuple(self.attributes), uses_camera=self.uses_camera,
        )


def scalar(value: Value) -> float | None:
    """Return the number a constant holds in all of xyz, None for anything else."""
    c = value.constant
    return c[0] if c is not None and c[0] == c[1] == c[2] else None


def index_of(items: list, item) -> int:
    """Return the index of `item` in `items`, appended where it is new."""
    if item not in items:
        items.append(item)
    return items.index(item)


def move_rows(instruction: Instruction, first_row: int) -> Instruction:
    """Turn the block index of a transform into an index of the program's constants."""
    head, y, z, w = instruction
    if head & 255 == codes.OP_TRANSFORM and z >= 0:
        return head, y, first_row + 3 * z, w
    return instruction


def tangent_attribute(uv_map: str) -> str:
    """Return the name under which a mesh carries a UV map's tangents, if it does: xyz tangent, w bitangent's sign."""
    return TANGENT_PREFIX + uv_map
