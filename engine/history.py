# SPDX-License-Identifier: GPL-3.0-or-later
"""Buffers that a frame leaves for the next: two of each, read and written in turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import warp as wp

__all__ = ["History", "arrays_of", "copy_struct"]

T = TypeVar("T")


def arrays_of(buffers: object) -> list[wp.array]:
    """Return the arrays in a Warp struct, or the array itself."""
    if isinstance(buffers, wp.array):
        return [buffers]
    values = (getattr(buffers, name) for name in buffers._cls.vars)
    return [value for value in values if isinstance(value, wp.array)]


def copy_struct(values: T) -> T:
    """Return a Warp struct of the same values; arrays are shared."""
    copy = values._cls()
    for name in values._cls.vars:
        setattr(copy, name, getattr(values, name))
    return copy


class History(Generic[T]):
    """A pair of buffers; even frames write the first, odd ones the second."""

    def __init__(self, name: str, make: Callable[[], T]):
        self.name = name
        self.buffers = (make(), make())

    def current(self, parity: int) -> T:
        """Return what a frame of this parity (0 or 1) writes."""
        return self.buffers[parity]

    def previous(self, parity: int) -> T:
        """Return what the frame before one of this parity wrote."""
        return self.buffers[1 - parity]

    def reset(self) -> None:
        """Set everything to zero."""
        for buffers in self.buffers:
            for array in arrays_of(buffers):
                array.zero_()
