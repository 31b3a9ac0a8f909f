# SPDX-License-Identifier: GPL-3.0-or-later
"""Where instances were before they first moved: the radiance cache's cells keep to them there (kernels/homes.py)."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels.homes import NOWHERE, Home, Homes
from .staging import overwrite

__all__ = ["HomeTable"]

ROOM = 16
"""Homes that there is room for at first, once there are any"""


class HomeTable:
    """Homes of a scene's instances. Takes no memory until something moves, and no time once all that moves has one."""

    def __init__(self, device: str):
        self._of = np.zeros(0, np.int32)
        self._rows = np.zeros(0, Home.numpy_dtype())
        self._homes = Homes()
        self._homes.of = wp.zeros(0, dtype=int, device=device)
        self._homes.rows = wp.zeros(0, dtype=Home, device=device)
        self._serial = 0

    def forget(self) -> None:
        """Forget all of them: the scene has other instances."""
        if len(self._of):
            self._rows = self._rows[:0]
            self._hold(np.zeros(0, np.int32))

    def note(self, rows: np.ndarray, moved: np.ndarray) -> None:
        """Give a home to what has none yet.

        Args:
            rows: kernels.types.Instance [N], all instances where they still are.
            moved: int [M], ascending: those that are about to move.
        """
        if len(self._of):
            moved = moved[self._of[moved] < 0]
        if not len(moved):
            return
        made = np.zeros(len(moved), self._rows.dtype)
        made["to_world"], made["to_object"] = rows["to_world"][moved], rows["to_object"][moved]
        made["serial"] = self._serial + 1 + np.arange(len(moved))
        self._serial += len(moved)
        of = self._of if len(self._of) else np.full(len(rows), int(NOWHERE), np.int32)
        of[moved] = len(self._rows) + np.arange(len(moved))
        self._rows = np.concatenate([self._rows, made])
        self._hold(of)

    def _hold(self, of: np.ndarray) -> None:
        """Bring the device up to date."""
        self._of = of
        room = 0
        if len(self._rows):
            # Recorded frames go on using arrays that grow seldom.
            room = max(ROOM, 1 << (len(self._rows) - 1).bit_length())
        values = np.zeros(room, self._rows.dtype)
        values[: len(self._rows)] = self._rows
        self._homes.of = overwrite(self._homes.of, of)
        self._homes.rows = overwrite(self._homes.rows, values)

    def struct(self, instances: wp.array) -> Homes:
        """Return them as kernels take them, of instances that are on the device (wp.array[Instance])."""
        self._homes.instances = instances
        return self._homes
