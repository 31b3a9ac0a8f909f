# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials are masked by an image: transparency that is a function of one value read from it, or constant.

The transparency program is run with intervals for numbers (Moore, "Interval Analysis", 1966), for each of the ranges
into which the value is cut at the same time: where even the bounds of its result say that all light passes, or none,
the rest of the program doesn't matter. What is not known here is any number. Where single values have results without
bounds, these are the whole answer.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace

import numpy as np

from ..kernels import node_codes as codes
from ..kernels.opacity_pieces import CHANNEL_LUMINANCE
from ..kernels.texture import INTERPOLATION_CLOSEST
from .intervals import ANY, MATH, VECTOR, VECTOR_BOUNDS, Register, product, scalar
from .program import Program
from .program_layout import OPERANDS, Instruction

__all__ = ["MaskedBy", "find_mask"]

CELLS = 512
"""Ranges into which values from 0 to 1 are cut"""

ALL_PASSES = 1e-6
"""What may be missing to 1 where all light passes: rounding"""

NONE_PASSES = 1.0 / CELLS
"""What may pass where none does: less than a step of 8 bits"""

NOTHING = (1.0, -1.0)
"""A range that holds no value"""

SAME = 1e-5
"""By how much bounds and colours may differ and count as one number"""


@dataclass(frozen=True)
class MaskedBy:
    """What decides how much light passes a material."""

    clear: tuple[float, float] = NOTHING
    """Range of the value in which all does"""
    solid: tuple[float, float] = NOTHING
    """Range in which none does"""
    passing: tuple[float, ...] | None = None
    """What share does for the value k / CELLS, number k; one number for all without an image; None: not known, or
    colours differ"""
    image: Hashable | None = None
    """Image key; None: the same everywhere, as for the value 0"""
    uv_map: str | None = None
    """None: the image is read at one place"""
    extension: int = 0
    """EXTENSION_* in kernels/texture.py"""
    closest: bool = False
    """Whether texels are not blended"""
    associate: bool = False
    """Whether the colour is multiplied by alpha"""
    channel: int = 3
    """0 to 3: component of the look-up; CHANNEL_LUMINANCE"""
    u: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The image is read at this times (u, v, 1)"""
    v: tuple[float, float, float] = (0.0, 0.0, 0.0)


def find_mask(program: Program) -> MaskedBy | None:
    """Return what masks the material of a program, None where nothing is known anywhere."""
    if not program.transparency:
        return None
    nowhere = np.zeros(1)
    plain = _Run(program, None, -1, nowhere, nowhere)
    found = plain.mask(plain.passing())
    if found is None:
        masks = [_image_mask(program, lookup, channel) for lookup in plain.lookups for channel in (3, 0, 1, 2, 4)]
        # The one that leaves the least open.
        found = max(filter(None, masks), key=_certain, default=None)
    return found


def _image_mask(program: Program, lookup: tuple, channel: int) -> MaskedBy | None:
    """Return what a component of a look-up tells about a program's answer."""
    edges = np.arange(CELLS + 1) / CELLS
    low = np.concatenate([[-ANY, 0.0], edges[:-1], [1.0, 1.0]])
    high = np.concatenate([[0.0, 0.0], edges[1:], [1.0, ANY]])
    return _Run(program, lookup, channel, low, high).mask(_Run(program, lookup, channel, edges, edges).passing())


def _certain(mask: MaskedBy) -> float:
    """Return for how many of the values from 0 to 1 a mask says something, more where it knows both answers or all."""
    ranges = sum(max(min(high, 1.0) - max(low, 0.0), 0.0) + (low <= high) for low, high in (mask.clear, mask.solid))
    return ranges + (mask.passing is not None)


class _Run:
    """A run of a transparency program over ranges of one value."""

    def __init__(
        self, program: Program, lookup: tuple | None, channel: int, low: np.ndarray, high: np.ndarray,
    ) -> None:
        """Run it.

        Args:
            program: Whose transparency program.
            lookup: The look-up in which the value is read, None where no value is.
            channel: Which of its components the value is.
            low: The least value of each range.
            high: The largest.
        """
        self.program, self.lookup, self.channel = program, lookup, channel
        self.low, self.high = low, high
        self.lookups: list[tuple] = []
        self.registers: dict[int, Register] = {}
        self.passing_low = np.zeros((len(low), 3))
        self.passing_high = np.zeros((len(low), 3))
        for instruction in program.transparency:
            self.step(instruction)

    def mask(self, passing: tuple[float, ...] | None) -> MaskedBy | None:
        """Return what the run tells, beside what share of light passes where that is known of single values."""
        clear = (self.passing_low >= 1.0 - ALL_PASSES).all(1) & (self.passing_high <= 1.0 + ALL_PASSES).all(1)
        solid = (self.passing_high <= NONE_PASSES).all(1)
        if not clear.any() and not solid.any() and passing is None:
            return None
        found = MaskedBy(self.longest(clear), self.longest(solid), passing)
        if self.lookup is None:
            return found
        image, extension, closest, associate, uv_map, u, v = self.lookup
        return replace(
            found, image=self.program.images[image], extension=extension, closest=closest, associate=associate,
            channel=self.channel, uv_map=None if uv_map is None else self.program.uv_maps[uv_map], u=u, v=v)

    def passing(self) -> tuple[float, ...] | None:
        """Return what share of light passes in each range where that is one number, the same for all colours."""
        share = self.passing_low[:, 0]
        spread = np.maximum(self.passing_high.max(1) - share, share - self.passing_low.min(1))
        if (spread > SAME).any() or (share < -SAME).any() or (share > 1.0 + SAME).any():
            return None
        share = np.where(share >= 1.0 - SAME, 1.0, np.where(share <= NONE_PASSES, 0.0, share))
        return tuple(share.tolist())

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

    def unknown(self) -> Register:
        """Return a register that may hold anything."""
        size = (len(self.low), 4)
        return Register(np.full(size, -ANY), np.full(size, ANY))

    def operand(self, word: int) -> Register:
        """Return an operand: a register or a constant."""
        if word >= 0:
            return self.registers.get(word) or self.unknown()
        value = self.program.constants[-1 - word]
        rows = np.tile(np.array(value, np.float64), (len(self.low), 1))
        return Register(rows, rows, tuple((0.0, 0.0, float(x)) for x in value[:3]))

    def step(self, instruction: Instruction) -> None:
        """Take one instruction in."""
        head, *words = instruction
        op, out, sub = head & 255, head >> 8 & 255, head >> 16 & 65535
        values = [self.operand(word) for word in words[:OPERANDS[op]]]
        if op == codes.OP_TRANSPARENT:
            low, high = product(values[0], values[1], slice(0, 3), slice(0, 1))
            self.passing_low, self.passing_high = self.passing_low + low, self.passing_high + high
            return
        run = STEPS.get(op)
        result = run(self, sub, values, words) if run else None
        self.registers[out] = result or self.unknown()

    def input(self, sub: int, values: list[Register], words: list[int]) -> Register | None:
        """Return the coordinate of a UV map."""
        if sub != codes.INPUT_UV:
            return None
        result = self.unknown()
        result.forms = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
        result.uv_map = words[1]
        return result

    def transform(self, sub: int, values: list[Register], words: list[int]) -> Register | None:
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

    def image(self, sub: int, values: list[Register], words: list[int]) -> Register | None:
        """Return what an image holds: the value where it is the look-up that is asked about."""
        at = values[0]
        if sub & 15 != codes.PROJECTION_FLAT or at.forms[0] is None or at.forms[1] is None:
            return None
        lookup = (words[1], sub >> 4 & 3, sub >> 6 & 3 == INTERPOLATION_CLOSEST, bool(sub & codes.IMAGE_ASSOCIATE),
                  at.uv_map, at.forms[0], at.forms[1])
        if lookup not in self.lookups:
            self.lookups.append(lookup)
        result = self.unknown()
        result.lookup = lookup
        if lookup == self.lookup and self.channel < 4:
            result.low[:, self.channel] = self.low
            result.high[:, self.channel] = self.high
        return result

    def color(self, sub: int, values: list[Register], words: list[int]) -> Register | None:
        """Return a colour's luminance: the value where it is that of the look-up."""
        if sub != codes.COLOR_LUMINANCE or self.channel != CHANNEL_LUMINANCE or values[0].lookup != self.lookup:
            return None
        return scalar(self.low, self.high)

    def math(self, sub: int, values: list[Register], words: list[int]) -> Register | None:
        """Return a scalar operation."""
        a, b, c = ((value.low[:, 0], value.high[:, 0]) for value in values)
        run = MATH.get(sub)
        return scalar(*run(a, b, c)) if run else None

    def mix(self, sub: int, values: list[Register], words: list[int]) -> Register | None:
        """Return one colour blended over another."""
        t, a, b = values
        if sub not in (codes.MIX_MIX, codes.MIX_MULTIPLY) or (t.low[:, 0] < 0.0).any() or (t.high[:, 0] > 1.0).any():
            return None
        if sub == codes.MIX_MULTIPLY:
            b = Register(*product(a, b, slice(0, 4), slice(0, 4)))
        # Linear in each factor, so the bounds lie at those of t.
        ends = [(1.0 - f) * x + f * y for f in (t.low[:, :1], t.high[:, :1])
                for x, y in ((a.low, b.low), (a.high, b.high))]
        return Register(np.minimum.reduce(ends), np.maximum.reduce(ends))

    def vector(self, sub: int, values: list[Register], words: list[int]) -> Register | None:
        """Return a vector operation; linear coordinates stay so."""
        a, b, c = values
        if codes.VECTOR_X <= sub <= codes.VECTOR_W:
            k = sub - codes.VECTOR_X
            result = scalar(a.low[:, k], a.high[:, k])
            result.low[:, 3], result.high[:, 3] = (0.0, 0.0) if k == 3 else (-ANY, ANY)
            result.forms, result.uv_map = ((a.forms[k],) * 3 if k < 3 else (None,) * 3), a.uv_map
            return result
        if sub == codes.VECTOR_XYZ:
            visible = np.array([1.0, 1.0, 1.0, 0.0])
            return Register(a.low * visible, a.high * visible, a.forms, a.uv_map, a.lookup)
        maps = {x.uv_map for x in values} - {None}
        run = VECTOR.get(sub)
        if run is None or len(maps) > 1:
            return None
        result = Register(*VECTOR_BOUNDS[sub](a, b, c))
        # Widths of coordinates follow rules of their own.
        result.low[:, 3], result.high[:, 3] = -ANY, ANY
        result.forms = tuple(run(*(x.forms for x in values), k) for k in range(3))
        result.uv_map = maps.pop() if maps else None
        return result

    def ramp(self, sub: int, values: list[Register], words: list[int]) -> Register | None:
        """Return what a table holds between the entries about the bounds."""
        if sub not in (codes.RAMP_LINEAR, codes.RAMP_CONSTANT):
            return None
        table = np.frombuffer(self.program.ramps[words[1]], np.float32).reshape(-1, 4).astype(np.float64)
        last = len(table) - 1
        if sub == codes.RAMP_LINEAR and np.array_equal(values[0].low[:, 0], values[0].high[:, 0]):
            place = np.clip(values[0].low[:, 0], 0.0, 1.0) * last
            rows = np.stack([np.interp(place, np.arange(last + 1), column) for column in table.T], 1)
            return Register(rows, rows)
        # Kernels round positions: an entry more on each side.
        first = np.clip(np.floor(np.clip(values[0].low[:, 0], 0.0, 1.0) * last - 1e-3), 0, last).astype(int)
        final = np.clip(np.ceil(np.clip(values[0].high[:, 0], 0.0, 1.0) * last + 1e-3), 0, last).astype(int)
        rows = [table[i:j + 1] for i, j in zip(first, final, strict=True)]
        return Register(np.array([row.min(0) for row in rows]), np.array([row.max(0) for row in rows]))


STEPS: dict[int, Callable[[_Run, int, list[Register], list[int]], Register | None]] = {
    codes.OP_INPUT: _Run.input, codes.OP_TRANSFORM: _Run.transform, codes.OP_IMAGE: _Run.image,
    codes.OP_COLOR: _Run.color, codes.OP_MATH: _Run.math, codes.OP_MIX: _Run.mix, codes.OP_VECTOR: _Run.vector,
    codes.OP_RAMP: _Run.ramp,
}
