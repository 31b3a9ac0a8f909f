# SPDX-License-Identifier: GPL-3.0-or-later
"""IES files (ANSI/IES LM-63): how bright a luminaire is in each direction, as a panorama.

Angles, symmetries, interpolation and units are those of Cycles 5.2 (util/ies.cpp, kernel/util/ies.h): vertical angles
from the lamp's -z, horizontal ones about it from -y; candelas times 4 pi / 177.83, the watts of a lamp as bright in all
directions with the efficacy of daylight (177.83 lm/W).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

__all__ = ["IesProfile", "IesUnreadable", "read_ies"]

WATTS_PER_CANDELA = 4.0 * math.pi / 177.83
TYPE_C, TYPE_B = 1, 2
HEIGHT = 720
"""Rows of a panorama, a quarter of a degree each"""
VALUES_MAX = 1 << 22


class IesUnreadable(ValueError):
    """A text is no IES file, or one of a kind that Cycles doesn't read either."""


@dataclass(frozen=True, eq=False)
class IesProfile:
    """A luminaire."""

    vertical: np.ndarray
    """float64 [V], angles with the axis [rad], ascending"""
    horizontal: np.ndarray
    """float64 [H], 0 to 2 pi"""
    watts: np.ndarray
    """float64 [H, V]"""

    def at(self, horizontal: np.ndarray, vertical: np.ndarray) -> np.ndarray:
        """Return the brightness in directions, by cubic interpolation; 0 where the file says nothing."""
        known = (vertical >= self.vertical[0]) & (vertical < self.vertical[-1])
        rows = np.clip(np.searchsorted(self.horizontal, horizontal, "left") - 1, 0, len(self.horizontal) - 2)
        columns = np.clip(np.searchsorted(self.vertical, vertical, "left") - 1, 0, len(self.vertical) - 2)
        across = _share(self.horizontal, rows, horizontal)
        along = _share(self.vertical, columns, vertical)
        count = len(self.horizontal)
        # The last row is the first once more.
        beside = [np.where(rows > 0, rows - 1, count - 2), rows, rows + 1, np.where(rows + 2 < count, rows + 2, 1)]
        value = _cubic([self._along(row, columns, along) for row in beside], across)
        return np.where(known, np.maximum(value, 0.0), 0.0)

    def _along(self, rows: np.ndarray, columns: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return the brightness on horizontal angles of the file."""
        last = len(self.vertical) - 1
        before = np.where(columns > 0, columns - 1, 1 if self.vertical[0] < 1e-7 else 0)
        beyond = last - 1 if self.vertical[-1] > math.pi - 1e-7 else last
        after = np.where(columns + 2 <= last, columns + 2, beyond)
        return _cubic([self.watts[rows, column] for column in (before, columns, columns + 1, after)], share)

    def panorama(self) -> np.ndarray:
        """Return the brightness by direction, equirectangular as Cycles' textures: float32 [h, w, 3], z up."""
        symmetric = bool((self.watts == self.watts[0]).all())
        width = 1 if symmetric else HEIGHT
        azimuth = (0.5 - (np.arange(width) + 0.5) / width) * 2.0 * math.pi
        above = (0.5 - (np.arange(HEIGHT) + 0.5) / HEIGHT) * math.pi
        azimuth, above = np.meshgrid(azimuth, above)
        turned = np.mod(np.arctan2(np.cos(azimuth), np.sin(azimuth)) + math.pi, 2.0 * math.pi)
        value = self.at(turned, 0.5 * math.pi + above)
        return np.repeat(value.astype(np.float32)[..., None], 3, -1)


def _share(angles: np.ndarray, index: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return how far an angle is from one of a file's towards the next."""
    return (angle - angles[index]) / np.maximum(angles[index + 1] - angles[index], 1e-12)


def _cubic(values: list[np.ndarray], x: np.ndarray) -> np.ndarray:
    """Interpolate between the second and third of four values (Catmull and Rom 1974)."""
    a, b, c, d = values
    return b + 0.5 * x * (c - a + x * (2.0 * a - 5.0 * b + 4.0 * c - d + x * (3.0 * (b - c) + d - a)))


class _Numbers:
    """The numbers of a file's second part, in order."""

    def __init__(self, text: str) -> None:
        self._words = iter(text.replace(",", " ").split())

    def take(self, what: str) -> float:
        """Return the next number."""
        word = next(self._words, None)
        if word is None:
            raise IesUnreadable(f"it ends before {what}")
        try:
            value = float(word)
        except ValueError:
            raise IesUnreadable(f"'{word[:20]}' stands where {what} should") from None
        if not math.isfinite(value):
            raise IesUnreadable(f"{what} is not finite")
        return value

    def row(self, count: int, what: str) -> np.ndarray:
        """Return the next numbers."""
        return np.array([self.take(what) for _ in range(count)])


def read_ies(text: str) -> IesProfile:
    """Read an IES file.

    Raises:
        IesUnreadable: It isn't one, or of a kind that isn't read; the message is the rest of a sentence.
    """
    lines = text.splitlines()
    tilt = next((i for i, line in enumerate(lines) if line.startswith("TILT=")), None)
    if tilt is None:
        raise IesUnreadable("it has no line TILT=")
    numbers = _Numbers(" ".join(lines[tilt + 1:]))
    if lines[tilt].startswith("TILT=INCLUDE"):
        numbers.take("the lamp's position")
        numbers.row(2 * _count(numbers.take("the number of tilts")), "a tilt")
    numbers.row(2, "the number of lamps or their lumens")
    factor = numbers.take("the factor of candelas")
    vertical_count = _count(numbers.take("the number of vertical angles"))
    horizontal_count = _count(numbers.take("the number of horizontal angles"))
    kind = int(numbers.take("the photometric type"))
    numbers.row(4, "a measure of the luminaire")
    factor *= numbers.take("the ballast's factor") * numbers.take("the ballast's second factor")
    numbers.take("the input's watts")
    if vertical_count * horizontal_count > VALUES_MAX or min(vertical_count, horizontal_count) < 1:
        raise IesUnreadable("it has no angles, or too many")
    vertical, horizontal = numbers.row(vertical_count, "an angle"), numbers.row(horizontal_count, "an angle")
    watts = numbers.row(vertical_count * horizontal_count, "a candela value") * factor * WATTS_PER_CANDELA
    watts = watts.reshape(horizontal_count, vertical_count)
    if kind == TYPE_C:
        vertical, horizontal, watts = _from_c(vertical, horizontal, watts)
    elif kind == TYPE_B:
        vertical, horizontal, watts = _from_b(vertical, horizontal, watts)
    else:
        raise IesUnreadable(f"its photometric type {kind} is neither B nor C")
    if len(vertical) < 2 or (np.diff(vertical) <= 0.0).any() or (np.diff(horizontal) <= 0.0).any():
        raise IesUnreadable("its angles don't ascend")
    return IesProfile(np.radians(vertical), np.radians(horizontal), watts)


def _count(value: float) -> int:
    if not 0.0 <= value <= VALUES_MAX:
        raise IesUnreadable(f"{value:g} is no number of values")
    return int(value)


def _mirrored(angles: np.ndarray, watts: np.ndarray, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Continue angles, and rows of brightness, beyond their last."""
    return np.concatenate([angles, 2.0 * at - angles[-2::-1]]), np.concatenate([watts, watts[-2::-1]])


def _from_c(vertical: np.ndarray, horizontal: np.ndarray, watts: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return type C's angles and brightness for all horizontal angles (0 to 360 degrees)."""
    if horizontal[0] == 90.0:
        horizontal = horizontal - 90.0
    if horizontal[0] != 0.0:
        raise IesUnreadable("its horizontal angles don't begin at 0")
    if len(horizontal) == 1:
        return vertical, np.array([0.0, 360.0]), np.repeat(watts, 2, 0)
    for end in (90.0, 180.0):
        if horizontal[-1] == end:
            horizontal, watts = _mirrored(horizontal, watts, end)
    if horizontal[-1] != 360.0:
        gap = 360.0 - horizontal[-1]
        if gap not in (horizontal[-1] - horizontal[-2], horizontal[1] - horizontal[0]):
            raise IesUnreadable("its horizontal angles end before 360")
        horizontal, watts = np.append(horizontal, 360.0), np.concatenate([watts, watts[:1]])
    if vertical[0] != 0.0 and (vertical[0], vertical[-1]) != (90.0, 180.0):
        raise IesUnreadable("its vertical angles begin neither at 0 nor run from 90 to 180")
    return vertical, horizontal, watts


def _from_b(vertical: np.ndarray, horizontal: np.ndarray, watts: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return type B's angles and brightness as Cycles has them: its two angles change places."""
    # Each kind of angle runs from -90 to 90, or from 0 where both halves are alike.
    parts = []
    for angles in (vertical, horizontal):
        if angles[-1] != 90.0 or angles[0] not in (0.0, -90.0):
            raise IesUnreadable("its angles of type B run neither from -90 nor from 0 to 90")
        parts.append(angles + 90.0 if angles[0] == -90.0 else np.concatenate([90.0 - angles[:0:-1], 90.0 + angles]))
    around, along = parts
    watts = watts.T
    if vertical[0] == 0.0:
        watts = np.concatenate([watts[:0:-1], watts])
    if horizontal[0] == 0.0:
        watts = np.concatenate([watts[:, :0:-1], watts], 1)
    return along, np.append(around, 360.0), np.concatenate([watts, watts[:1]])
