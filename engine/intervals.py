# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs' registers as intervals of numbers (Moore, "Interval Analysis", 1966), and the operations on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..kernels import node_codes as codes

__all__ = ["ANY", "MATH", "VECTOR", "VECTOR_BOUNDS", "Form", "Register", "product", "scalar"]

ANY = 1e30
"""Larger than any number that a program computes; its square is finite too"""

Form = tuple[float, float, float]
"""A number that is linear in the coordinate of a UV map: times (u, v, 1)"""


@dataclass
class Register:
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


Bounds = tuple[np.ndarray, np.ndarray]


def scalar(low: np.ndarray, high: np.ndarray) -> Register:
    """Return a number in all of xyz."""
    rest = np.zeros_like(low)
    return Register(np.stack([low] * 3 + [rest], 1), np.stack([high] * 3 + [rest], 1))


def product(a: Register, b: Register, of_a: slice, of_b: slice) -> Bounds:
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


def _bounds(a: Register) -> Bounds:
    return a.low, a.high


VECTOR_BOUNDS: dict[int, Callable[[Register, Register, Register], Bounds]] = {
    codes.VECTOR_COMBINE: lambda a, b, c: tuple(
        np.stack([x[:, 0] for x in (*parts, parts[0])], 1) for parts in zip(*map(_bounds, (a, b, c)), strict=True)),
    codes.VECTOR_ADD: lambda a, b, c: _plus(_bounds(a), _bounds(b)),
    codes.VECTOR_SUBTRACT: lambda a, b, c: _minus(_bounds(a), _bounds(b)),
    codes.VECTOR_MULTIPLY: lambda a, b, c: _times(_bounds(a), _bounds(b)),
    codes.VECTOR_SCALE: lambda a, b, c: product(a, c, slice(0, 4), slice(0, 1)),
}
