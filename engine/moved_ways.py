# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things have moved in the last frames, come from or gone, as boxes on the device (kernels/moved_ways.py)."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Hashable

import numpy as np
import warp as wp

from ..kernels.moved_ways import WAYS
from .device_scene import DeviceScene
from .staging import RowWriter

__all__ = ["MovedWays"]

FRAMES = 16
"""Frames for which a way is remembered: most cells that rays meet have got a sample by then"""

JUMP = 2.0
"""By how much of its size something may be elsewhere in the next frame for both places to count as one way"""

Boxes = tuple[np.ndarray, np.ndarray]
"""Lower and upper corners, float [N, 3] each"""


class MovedWays:
    """The ways of the last FRAMES frames; nothing is written while nothing has moved in them."""

    def __init__(self, device: str):
        self.array = wp.zeros(1 + 2 * int(WAYS), dtype=wp.vec3, device=device)
        """Number of boxes, then the lower and the upper corner of each [m, scene space]"""
        self._writer = RowWriter(wp.vec3, device)
        self._recent: deque[tuple[np.ndarray, np.ndarray, np.ndarray]] = deque(maxlen=FRAMES)
        """What was added in each frame, at most 2 * WAYS boxes: number of the way that each belongs to, corners"""
        self._ways: dict[Hashable, int] = {}
        """Number of the way that a thing is on: each jump begins another one"""
        self._rows: np.ndarray | None = None
        self._keys: list = []
        self._origin = np.zeros(3)
        self._low = self._high = np.zeros((0, 3))
        """Bounds of the instances in the frame before, inside out of those that are not drawn"""

    def advance(self, scene: DeviceScene, moving: np.ndarray, deformed: Collection) -> None:
        """Go on to the next frame.

        Args:
            scene: As it is now.
            moving: Ascending, rows of instances that are not where they were in the frame before.
            deformed: Keys of the meshes that have another shape.
        """
        if deformed:
            meshes = np.array([key in deformed for key in scene.table.mesh_keys], bool)
            moving = np.union1d(moving, np.flatnonzero(meshes[scene.table.mesh_index]))
        if scene.rows is not self._rows:
            self._take_over(scene, moving)
            return
        before, now = (self._low[moving], self._high[moving]), _bounds(scene, moving)
        self._low[moving], self._high[moving] = now
        self._add([self._keys[row] for row in moving], before, now)

    def _take_over(self, scene: DeviceScene, moving: np.ndarray) -> None:
        """Go on with other instances, some of which are known by their keys."""
        keys = [] if scene.table is None else scene.table.object_keys
        low, high = _bounds(scene, np.arange(len(keys)))
        if self._rows is None or (scene.origin != self._origin).any():
            self._recent.clear()
            self._write()
        else:
            places = {key: i for i, key in enumerate(self._keys)}
            there = np.array([places.pop(key, -1) for key in keys], np.int64)
            new, gone = np.flatnonzero(there < 0), list(places.values())
            moved = np.setdiff1d(moving, new)
            nothing = np.full((len(new), 3), np.inf), np.full((len(gone), 3), np.inf)
            corners = [np.concatenate(parts) for parts in (
                (self._low[there[moved]], nothing[0], self._low[gone]),
                (self._high[there[moved]], -nothing[0], self._high[gone]),
                (low[moved], low[new], nothing[1]), (high[moved], high[new], -nothing[1]))]
            self._add([*(keys[i] for i in (*moved, *new)), *places], corners[:2], corners[2:])
        self._rows, self._keys, self._origin = scene.rows, keys, scene.origin.copy()
        self._low, self._high = low, high

    def _add(self, keys: list, before: Boxes, now: Boxes) -> None:
        """Take in where things were in the frame before and where they are."""
        if len(keys) == 0 and not self._recent:
            return
        if len(keys) > int(WAYS):
            # Too many to follow one by one.
            low, high = _few(*_drawn(np.concatenate((before[0], now[0])), np.concatenate((before[1], now[1]))))
            added = -1 - np.arange(len(low)), low, high
        else:
            added = self._steps(keys, before, now)
        self._recent.append(added)
        if not any(len(ways) for ways, _, _ in self._recent):
            self._recent.clear()
            self._ways = {}
        self._write()

    def _steps(self, keys: list, before: Boxes, now: Boxes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return things' boxes in the frame before and in this one, and the way that each belongs to."""
        with np.errstate(invalid="ignore"):
            apart = np.maximum(now[0] - before[1], before[0] - now[1])
            near = (apart <= JUMP * (before[1] - before[0])).all(1)
        for key in keys:
            if key not in self._ways:
                self._ways[key] = self._new_way()
        first = [self._ways[key] for key in keys]
        for i in np.flatnonzero(~near):
            self._ways[keys[i]] = self._new_way()
        ways = np.array([*first, *(self._ways[key] for key in keys)], np.int64)
        low, high = np.concatenate((before[0], now[0])), np.concatenate((before[1], now[1]))
        drawn = (low <= high).all(1)
        return ways[drawn], low[drawn], high[drawn]

    def _new_way(self) -> int:
        """Return a number that no way has had since the last time that nothing had moved."""
        return 1 + max(self._ways.values(), default=-1)

    def _write(self) -> None:
        """Tell the device of the ways of all recent frames."""
        values = np.zeros((1 + 2 * int(WAYS), 3), np.float32)
        if self._recent:
            ways, low, high = (np.concatenate(parts) for parts in zip(*self._recent, strict=True))
            order = np.argsort(ways, kind="stable")
            starts = np.flatnonzero(np.diff(ways[order], prepend=ways[order[0]] - 1))
            low, high = _few(np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts))
            values[0, 0] = len(low)
            values[1 : 1 + 2 * len(low) : 2], values[2 : 2 + 2 * len(low) : 2] = low, high
        self._writer.write(self.array, values, np.arange(len(values)))


def _bounds(scene: DeviceScene, rows: np.ndarray) -> Boxes:
    """Return the bounds of instances, inside out of those that are not drawn."""
    drawn = scene.drawn[rows, None]
    return np.where(drawn, scene.low[rows], np.inf), np.where(drawn, scene.high[rows], -np.inf)


def _drawn(low: np.ndarray, high: np.ndarray) -> Boxes:
    """Return the boxes that are not inside out."""
    drawn = (low <= high).all(1)
    return low[drawn], high[drawn]


def _few(low: np.ndarray, high: np.ndarray) -> Boxes:
    """Return at most WAYS boxes around all: of neighbours along the axis on which they are spread most."""
    if len(low) <= int(WAYS):
        return low, high
    center = low + high
    order = np.argsort(center[:, np.ptp(center, axis=0).argmax()], kind="stable")
    starts = np.arange(int(WAYS)) * len(order) // int(WAYS)
    return np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts)
