# SPDX-License-Identifier: GPL-3.0-or-later
"""Coefficients of media that vary in space, as programs of the node machine, and the builder that makes these.

A coefficient is a sum of terms. Where all of it is one number that varies times a constant colour, as a density mostly
is, one number is tabled for it, and the same for all coefficients that share it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..kernels import node_codes as codes
from .program import Program, ProgramBuilder, Value

__all__ = ["OPTIONAL_PREFIX", "FieldData", "FieldSum", "VaryingData", "VolumeBuilder"]

Color = tuple[float, float, float]

OPTIONAL_PREFIX = ".grid:"
"""Before names of grids that count as 1 where an object has none of that name"""

RAY_INPUTS = {codes.INPUT_RAY_KIND, codes.INPUT_RAY_LENGTH, codes.INPUT_RAY_DEPTH, codes.INPUT_KIND_DEPTH,
              codes.INPUT_INCOMING, codes.INPUT_REFLECTION}
LOCAL_INPUTS = {codes.INPUT_ATTRIBUTE, codes.INPUT_GENERATED, codes.INPUT_OBJECT, codes.INPUT_UV}
"""Inputs that move with an object"""


@dataclass(frozen=True)
class FieldData:
    """A coefficient: a constant colour, or one times what a program emits."""

    color: Color = (0.0, 0.0, 0.0)
    program: Program | None = None
    wide: bool = False
    """Whether the program's channels differ: the colour is white then"""

    def __bool__(self) -> bool:
        return self.program is not None or any(self.color)


@dataclass(frozen=True)
class VaryingData:
    """A medium's coefficients, as of media.MediumData."""

    extinction: FieldData = FieldData()
    emission: FieldData = FieldData()
    phases: tuple[tuple[FieldData, FieldData], ...] = ()
    """Scattering and anisotropy of each phase function"""

    @property
    def fields(self) -> tuple[FieldData, ...]:
        """Return all coefficients, as kernels/volume_grids.py has them."""
        return self.extinction, self.emission, *(part for phase in self.phases for part in phase)

    @property
    def varies(self) -> bool:
        """Return whether anything varies."""
        return any(part.program is not None for part in self.fields)

    def inputs(self) -> set[int]:
        """Return the inputs of all programs (codes.INPUT_*)."""
        words = [word[0] for part in self.fields if part.program is not None for word in part.program.emission]
        found = {head >> 16 & 255 for head in words if head & 255 == codes.OP_INPUT}
        return found | ({codes.INPUT_NORMAL} if any(head & 255 == codes.OP_SPACE for head in words) else set())

    @property
    def of_rays(self) -> bool:
        """Return whether the kind of ray or its direction counts."""
        return bool(self.inputs() & RAY_INPUTS)

    @property
    def of_camera(self) -> bool:
        """Return whether the camera's place counts."""
        return codes.INPUT_WINDOW in self.inputs() or any(
            part.program is not None and part.program.uses_camera for part in self.fields)

    @property
    def placed(self) -> bool:
        """Return whether an object's place and properties count: then no other shares its table."""
        return bool(self.inputs() - LOCAL_INPUTS - RAY_INPUTS)


class VolumeBuilder(ProgramBuilder):
    """Compiles what fills a volume: there are no surfaces' coordinates, and attributes are those of grids."""

    def __init__(self, optional: bool) -> None:
        """Start empty; `optional`: whether grids that are read where there are some exist at all."""
        super().__init__()
        self.optional = optional

    def optional_grid(self, name: str) -> Value:
        """Return a grid's value, 1 where there is none of that name."""
        return self.attribute(OPTIONAL_PREFIX + name) if name and self.optional else self.constant(1.0)

    def _none(self, *_args, **_options) -> Value:
        """Return what surfaces alone have."""
        return self.constant(0.0)

    uv = uv_tangent = wireframe = normal_map = bump = _none

    def compiled(self, value: Value) -> Program:
        """Return the program that emits a value. Raises RegisterOverflow."""
        self.sinks = []
        self.emit(value, 1.0, 1.0)
        made = self.finish()
        camera = any(word[0] & 255 == codes.OP_TRANSFORM and word[2] < 0 for word in made.emission)
        # Surfaces have no part in it: equal coefficients of different trees are equal.
        return replace(made, surface=(), flat=(), transparency=(), uses_camera=camera)


@dataclass(eq=False)
class FieldSum:
    """A coefficient being added up."""

    builder: VolumeBuilder
    constant: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    scaled: dict[int, tuple[Value, list[float]]] = field(default_factory=dict)
    """By number that varies, the sum of the constant colours that it is a factor of"""
    wide: list[Value] = field(default_factory=list)

    def add(self, color: Value, scale: Value) -> None:
        """Add color * scale."""
        build = self.builder
        if color.constant is None:
            product = color if scale.constant == (1.0, 1.0, 1.0, 0.0) else build.vector("MULTIPLY", color, scale)
            self.wide.append(product)
            return
        if scale.constant is not None:
            held, factor = self.constant, scale.constant[0]
        else:
            held, factor = self.scaled.setdefault(scale.index, (scale, [0.0, 0.0, 0.0]))[1], 1.0
        for c in range(3):
            held[c] += color.constant[c] * factor

    def finish(self) -> FieldData:
        """Return the sum. Raises RegisterOverflow."""
        build = self.builder
        scaled = [(scale, color) for scale, color in self.scaled.values() if any(color)]
        if not self.wide and not scaled:
            return FieldData(clamped(self.constant))
        if not self.wide and len(scaled) == 1 and not any(self.constant) and min(scaled[0][1]) >= 0.0:
            return FieldData(clamped(scaled[0][1]), build.compiled(scaled[0][0]))
        total = build.constant(tuple(self.constant))
        for value in [*self.wide, *(build.vector("MULTIPLY", tuple(color), scale) for scale, color in scaled)]:
            total = build.vector("ADD", total, value)
        return FieldData((1.0, 1.0, 1.0), build.compiled(total), wide=True)


def clamped(color: list[float]) -> Color:
    """Return a coefficient, no part of it below 0."""
    return tuple(max(float(x), 0.0) for x in color)
