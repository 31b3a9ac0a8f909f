# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials are masked by an image: transparency that is a function of one value read from it.

The transparency program is run with intervals for numbers (Moore, "Interval Analysis", 1966), for each of the ranges
into which the value is cut at the same time: where even the bounds of its result say that all light passes, or none,
the rest of the program doesn't matter. What is not known here is any number.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from ..kernels import node_codes as codes
from ..kernels.opacity_pieces import CHANNEL_LUMINANCE
from .program import Program
from .program_layout import OPERANDS, Instruction

__all__ = ["MaskedBy", "find_mask"]

CELLS = 512
"""Ranges into which values from 0 to 1 are cut"""

ANY = 1e30
"""Larger than any number that a program computes; its square is finite too"""

ALL_PASSES = 1e-6
"""What may be missing to 1 where all light passes: rounding"""

NONE_PASSES = 1.0 / CELLS
"""What may pass where none does: less than a step of 8 bits"""

NOTHING = (1.0, -1.0)
"""A range that holds no value"""


@dataclass(frozen=True)
class MaskedBy:
    """What decides how much light passes a material."""

    clear: tuple[float, float] = NOTHING
    """Range of the value in which all does"""
    solid: tuple[float, float] = NOTHING
    """Range in which none does"""
    image: Hashable | None = None
    """Image key; None: the same everywhere, as for the value 0"""
    uv_map: str | None = None
    """None: the image is read at one place"""
    extension: int = 0
    """EXTENSION_* in kernels/texture.py"""
    associate: bool = False
    """Whether the colour is multiplied by alpha"""
    channel: int = 3
    """0 to 3: component of the look-up; CHANNEL_LUMINANCE"""
    u: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The image is read at this times (u, v, 1)"""
    v: tuple[float, float, float] = (0.0, 0.0, 0.0)


Form = tuple[float, float, float]
"""A number that is linear in the coordinate of a UV map: times (u, v, 1)"""


@dataclass
class _Register:
    """What is known of a register, for each range of the value."""

    low: np.ndarray
    """[ranges, 4]"""
    high: np.ndarray
    forms: tuple[Form | None, ...] = (None, None, None)
    """Of x, y, z where they are linear"""
    uv_map: int | None = None
    """In which UV map, index into Program.uv_maps; None: constant"""
    lookup: tuple | None = None
    """Arguments of the look-up that it is the result of"""


def find_mask(program: Program) -> MaskedBy | None:
    """Return what masks the material of a program, None where nothing is known anywhere."""
    if not program.transparency:
        return None
    plain = _Run(program, None, -1)
    found = plain.mask()
    if found is None:
        lookups = plain.lookups
        masks = [_Run(program, lookup, channel).mask() for lookup in lookups for channel in (3, 0, 1, 2, 4)]
        # The one that leaves the least open.
        found = max(filter(None, masks), key=_certain, default=None)
    return found


def _certain(mask: MaskedBy) -> float:
    """Return for how many of the values from 0 to 1 a mask says something, more where it knows both answers."""
    return sum(max(min(high, 1.0) - max(low, 0.0), 0.0) + (low <= high) for low, high in (mask.clear, mask.solid))


class _Run:
    """A run of a transparency program over ranges of one value."""

    def __init__(self, program: Program, lookup: tuple | None, channel: int) -> None:
        """Run it.

        Args:
            program: Whose transparency program.
            lookup: The look-up in which the value is read, None where no value is.
            channel: Which of its components the value is.
        """
        edges = np.arange(CELLS + 1) / CELLS
        low = np.concatenate([[-ANY, 0.0], edges[:-1], [1.0, 1.0]])
        high = np.concatenate([[0.0, 0.0], edges[1:], [1.0, ANY]])
        if lookup is None:
            low = high = np.zeros(1)
        self.program, self.lookup, self.channel = program, lookup, channel
        self.low, self.high = low, high
        self.lookups: list[tuple] = []
        self.registers: dict[int, _Register] = {}
        self.passing_low = np.zeros((len(low), 3))
        self.passing_high = np.zeros((len(low), 3))
        for instruction in program.transparency:
            self.step(instruction)

    def mask(self) -> MaskedBy | None:
        """Return what the run tells."""
        clear = (self.passing_low >= 1.0 - ALL_PASSES).all(1) & (self.passing_high <= 1.0 + ALL_PASSES).all(1)
        solid = (self.passing_high <= NONE_PASSES).all(1)
        if not clear.any() and not solid.any():
            return None
        ranges = {"clear": self.longest(clear), "solid": self.longest(solid)}
        if self.lookup is None:
            return MaskedBy(**ranges)
        image, extension, associate, uv_map, u, v = self.lookup
        return MaskedBy(
            **ranges, image=self.program.images[image], extension=extension, associate=associate, channel=self.channel,
            uv_map=None if uv_map is None else self.program.uv_maps[uv_map], u=u, v=v)

    def longest(self, holds: np.ndarray) -> tuple[float, float]:
        """Return the longest stretch of values for all of which something holds."""
        best, first = NOTHING, None
        for i, good in enumerate([*holds.tolist(), False]):
            if good and first is None:
                first = i
            if not good and first is not None:
                stretch = float(self.low[first]), float(self.high[i - 1])
                if best == NOTHING or stretch[1] - stretch[0] > best[1] - best[0]:
                    best = stretch
                first = None
        return best

    # -- instructions -------------------------------------------------------------------------------------------

    def unknown(self) -> _Register:
        """Return a register that may hold anything."""
        size = (len(self.low), 4)
        return _Register(np.full(size, -ANY), np.full(size, ANY))

    def operand(self, word: int) -> _Register:
        """Return an operand: a register or a constant."""
        if word >= 0:
            return self.registers.get(word) or self.unknown()
        value = self.program.constants[-1 - word]
        rows = np.tile(np.array(value, np.float64), (len(self.low), 1))
        return _Register(rows, rows, tuple((0.0, 0.0, float(x)) for x in value[:3]))

    def step(self, instruction: Instruction) -> None:
        """Take one instruction in."""
        head, *words = instruction
        op, out, sub = head & 255, head >> 8 & 255, head >> 16 & 65535
        values = [self.operand(word) for word in words[:OPERANDS[op]]]
        if op == codes.OP_TRANSPARENT:
            low, high = _product(values[0], values[1], slice(0, 3), slice(0, 1))
            self.passing_low, self.passing_high = self.passing_low + low, self.passing_high + high
            return
        run = STEPS.get(op)
        result = run(self, sub, values, words) if run else None
        self.registers[out] = result or self.unknown()

    def input(self, sub: int, values: list[_Register], words: list[int]) -> _Register | None:
        """Return the coordinate of a UV map."""
        if sub != codes.INPUT_UV:
            return None
        result = self.unknown()
        result.forms = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
        result.uv_map = words[1]
        return result

    def transform(self, sub: int, values: list[_Register], words: list[int]) -> _Register | None:
        """Return a coordinate under a constant transform."""
        forms = values[0].forms
        if words[1] < 0 or None in forms:
            return None
        rows = self.program.constants[words[1]:words[1] + 3]
        moved = 1.0 if sub == codes.TRANSFORM_POINT else 0.0
        result = self.unknown()
        result.uv_map = values[0].uv_map
        result.forms = tuple(
            tuple(sum(row[i] * forms[i][k] for i in range(3)) + (row[3] * moved if k == 2 else 0.0) for k in range(3))
            for row in rows)
        return result

    def image(self, sub: int, values: list[_Register], words: list[int]) -> _Register | None:
        """Return what an image holds: the value where it is the look-up that is asked about."""
        at = values[0]
        if sub & 15 != codes.PROJECTION_FLAT or at.forms[0] is None or at.forms[1] is None:
            return None
        lookup = (words[1], sub >> 4 & 3, bool(sub & codes.IMAGE_ASSOCIATE), at.uv_map, at.forms[0], at.forms[1])
        if lookup not in self.lookups:
            self.lookups.append(lookup)
        result = self.unknown()
        result.lookup = lookup
        if lookup == self.lookup and self.channel < 4:
            result.low[:, self.channel] = self.low
            result.high[:, self.channel] = self.high
        return result

    def color(self, sub: int, values: list[_Register], words: list[int]) -> _Register | None:
        """Return a colour's luminance: the value where it is that of the look-up."""
        if sub != codes.COLOR_LUMINANCE or self.channel != CHANNEL_LUMINANCE or values[0].lookup != self.lookup:
            return None
        return _scalar(self.low, self.high)

    def math(self, sub: int, values: list[_Register], words: list[int]) -> _Register | None:
        """Return a scalar operation."""
        a, b, c = ((value.low[:, 0], value.high[:, 0]) for value in values)
        run = MATH.get(sub)
        return _scalar(*run(a, b, c)) if run else None

    def mix(self, sub: int, values: list[_Register], words: list[int]) -> _Register | None:
        """Return one colour blended over another."""
        t, a, b = values
        if sub not in (codes.MIX_MIX, codes.MIX_MULTIPLY) or (t.low[:, 0] < 0.0).any() or (t.high[:, 0] > 1.0).any():
            return None
        if sub == codes.MIX_MULTIPLY:
            b = _Register(*_product(a, b, slice(0, 4), slice(0, 4)))
        # Linear in each factor, so the bounds lie at those of t.
        ends = [(1.0 - f) * x + f * y for f in (t.low[:, :1], t.high[:, :1])
                for x, y in ((a.low, b.low), (a.high, b.high))]
        return _Register(np.minimum.reduce(ends), np.maximum.reduce(ends))

    def vector(self, sub: int, values: list[_Register], words: list[int]) -> _Register | None:
        """Return a vector operation; linear coordinates stay so."""
        a, b, c = values
        if codes.VECTOR_X <= sub <= codes.VECTOR_W:
            k = sub - codes.VECTOR_X
            result = _scalar(a.low[:, k], a.high[:, k])
            result.low[:, 3], result.high[:, 3] = (0.0, 0.0) if k == 3 else (-ANY, ANY)
            result.forms, result.uv_map = ((a.forms[k],) * 3 if k < 3 else (None,) * 3), a.uv_map
            return result
        if sub == codes.VECTOR_XYZ:
            visible = np.array([1.0, 1.0, 1.0, 0.0])
            return _Register(a.low * visible, a.high * visible, a.forms, a.uv_map, a.lookup)
        maps = {x.uv_map for x in values} - {None}
        run = VECTOR.get(sub)
        if run is None or len(maps) > 1:
            return None
        result = _Register(*VECTOR_BOUNDS[sub](a, b, c))
        # Widths of coordinates follow rules of their own.
        result.low[:, 3], result.high[:, 3] = -ANY, ANY
        result.forms = tuple(run(*(x.forms for x in values), k) for k in range(3))
        result.uv_map = maps.pop() if maps else None
        return result

    def ramp(self, sub: int, values: list[_Register], words: list[int]) -> _Register | None:
        """Return what a table holds between the entries about the bounds."""
        if sub not in (codes.RAMP_LINEAR, codes.RAMP_CONSTANT):
            return None
        table = np.frombuffer(self.program.ramps[words[1]], np.float32).reshape(-1, 4).astype(np.float64)
        last = len(table) - 1
        # Kernels round positions: an entry more on each side.
        first = np.clip(np.floor(np.clip(values[0].low[:, 0], 0.0, 1.0) * last - 1e-3), 0, last).astype(int)
        final = np.clip(np.ceil(np.clip(values[0].high[:, 0], 0.0, 1.0) * last + 1e-3), 0, last).astype(int)
        rows = [table[i:j + 1] for i, j in zip(first, final, strict=True)]
        return _Register(np.array([row.min(0) for row in rows]), np.array([row.max(0) for row in rows]))


Bounds = tuple[np.ndarray, np.ndarray]


def _scalar(low: np.ndarray, high: np.ndarray) -> _Register:
    """Return a number in all of xyz."""
    rest = np.zeros_like(low)
    return _Register(np.stack([low] * 3 + [rest], 1), np.stack([high] * 3 + [rest], 1))


def _product(a: _Register, b: _Register, of_a: slice, of_b: slice) -> Bounds:
    """Return the bounds of a product of components."""
    return _times((a.low[:, of_a], a.high[:, of_a]), (b.low[:, of_b], b.high[:, of_b]))


def _times(a: Bounds, b: Bounds) -> Bounds:
    ends = [np.clip(x * y, -ANY, ANY) for x in a for y in b]
    return np.minimum.reduce(ends), np.maximum.reduce(ends)


def _plus(a: Bounds, b: Bounds) -> Bounds:
    return np.clip(a[0] + b[0], -ANY, ANY), np.clip(a[1] + b[1], -ANY, ANY)


def _minus(a: Bounds, b: Bounds) -> Bounds:
    return _plus(a, (-b[1], -b[0]))


def _clamped(a: Bounds, low: Bounds, high: Bounds) -> Bounds:
    return tuple(np.minimum(np.maximum(a[k], low[k]), high[k]) for k in range(2))


def _less(a: Bounds, b: Bounds) -> Bounds:
    """Return 1 where a is certainly less than b, 0 where it is certainly not."""
    return (a[1] < b[0]).astype(float), (a[0] < b[1]).astype(float)


def _divided(a: Bounds, b: Bounds) -> Bounds:
    """Return a quotient; where the divisor may be 0, anything."""
    sure = (b[0] > 0.0) | (b[1] < 0.0)
    with np.errstate(divide="ignore"):
        low, high = _times(a, tuple(np.where(sure, 1.0 / np.where(sure, x, 1.0), ANY) for x in (b[1], b[0])))
    return np.where(sure, low, -ANY), np.where(sure, high, ANY)


def _rising(function: Callable[[np.ndarray], np.ndarray]) -> Callable[[Bounds, Bounds, Bounds], Bounds]:
    """Return the bounds of a function that never falls."""
    return lambda a, b, c: (function(a[0]), function(a[1]))


MATH: dict[int, Callable[[Bounds, Bounds, Bounds], Bounds]] = {
    codes.MATH_ADD: lambda a, b, c: _plus(a, b),
    codes.MATH_SUBTRACT: lambda a, b, c: _minus(a, b),
    codes.MATH_MULTIPLY: lambda a, b, c: _times(a, b),
    codes.MATH_DIVIDE: lambda a, b, c: _divided(a, b),
    codes.MATH_MULTIPLY_ADD: lambda a, b, c: _plus(_times(a, b), c),
    codes.MATH_MINIMUM: lambda a, b, c: tuple(map(np.minimum, a, b)),
    codes.MATH_MAXIMUM: lambda a, b, c: tuple(map(np.maximum, a, b)),
    codes.MATH_LESS_THAN: lambda a, b, c: _less(a, b),
    codes.MATH_GREATER_THAN: lambda a, b, c: _less(b, a),
    codes.MATH_CLAMP: _clamped,
    codes.MATH_ROUND: _rising(lambda x: np.floor(x + 0.5)),
    codes.MATH_FLOOR: _rising(np.floor),
    codes.MATH_CEIL: _rising(np.ceil),
}

Forms = tuple[Form | None, ...]


def _linear(a: Form | None, b: Form | None, sign: float) -> Form | None:
    """Return a sum or difference of linear forms."""
    return None if a is None or b is None else tuple(x + sign * y for x, y in zip(a, b, strict=True))


def _scaled(a: Form | None, b: Form | None) -> Form | None:
    """Return a product of linear forms, one of them constant."""
    if a is None or b is None or (any(a[:2]) and any(b[:2])):
        return None
    a, b = (b, a) if any(b[:2]) else (a, b)
    return tuple(x * b[2] for x in a)


VECTOR: dict[int, Callable[[Forms, Forms, Forms, int], Form | None]] = {
    codes.VECTOR_COMBINE: lambda a, b, c, k: (a, b, c)[k][0],
    codes.VECTOR_ADD: lambda a, b, c, k: _linear(a[k], b[k], 1.0),
    codes.VECTOR_SUBTRACT: lambda a, b, c, k: _linear(a[k], b[k], -1.0),
    codes.VECTOR_MULTIPLY: lambda a, b, c, k: _scaled(a[k], b[k]),
    codes.VECTOR_SCALE: lambda a, b, c, k: _scaled(a[k], c[0]),
}
"""Linear forms of component k"""


def _bounds(a: _Register) -> Bounds:
    return a.low, a.high


VECTOR_BOUNDS: dict[int, Callable[[_Register, _Register, _Register], Bounds]] = {
    codes.VECTOR_COMBINE: lambda a, b, c: tuple(
        np.stack([x[:, 0] for x in (*parts, parts[0])], 1) for parts in zip(*map(_bounds, (a, b, c)), strict=True)),
    codes.VECTOR_ADD: lambda a, b, c: _plus(_bounds(a), _bounds(b)),
    codes.VECTOR_SUBTRACT: lambda a, b, c: _minus(_bounds(a), _bounds(b)),
    codes.VECTOR_MULTIPLY: lambda a, b, c: _times(_bounds(a), _bounds(b)),
    codes.VECTOR_SCALE: lambda a, b, c: _product(a, c, slice(0, 4), slice(0, 1)),
}

STEPS: dict[int, Callable[[_Run, int, list[_Register], list[int]], _Register | None]] = {
    codes.OP_INPUT: _Run.input, codes.OP_TRANSFORM: _Run.transform, codes.OP_IMAGE: _Run.image,
    codes.OP_COLOR: _Run.color, codes.OP_MATH: _Run.math, codes.OP_MIX: _Run.mix, codes.OP_VECTOR: _Run.vector,
    codes.OP_RAMP: _Run.ramp,
}
