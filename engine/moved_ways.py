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
        self._keys: list = []
        self._low = self._high = np.zeros((0, 3))
        """Bounds of the instances in the frame before, inside out of those that are not drawn"""

    def follow(self, scene: DeviceScene, moving: np.ndarray, deformed: Collection) -> None:
        """Go on to the next frame, which has the instances of the one before.

        Args:
            scene: As it is now.
            moving: Ascending, rows of instances that are not where they were in the frame before.
            deformed: Keys of the meshes that have another shape.
        """
        changed = _with_shapes(scene, moving, deformed)
        before, now = (self._low[changed], self._high[changed]), _bounds(scene, changed)
        self._low[changed], self._high[changed] = now
        self._add([self._keys[row] for row in changed], before, now)

    def take_over(
        self, scene: DeviceScene, there: np.ndarray | None, moving: np.ndarray, deformed: Collection,
    ) -> None:
        """Go on to the next frame, which has other instances; arguments as of `follow`.

        `there`: int64 [N], their rows in the frame before, -1 for new ones; None where nothing of then counts any more.
        """
        old_keys, old_low, old_high = self._keys, self._low, self._high
        self._keys = [] if scene.table is None else scene.table.object_keys
        self._low, self._high = _bounds(scene, np.arange(len(self._keys)))
        if there is None:
            self._recent.clear()
            self._write()
            return
        # What was not there before or is no more has no box there: one that is inside out.
        nothing = np.full((1, 3), np.inf)
        low, high = np.concatenate((old_low, nothing)), np.concatenate((old_high, -nothing))
        new_low, new_high = np.concatenate((self._low, nothing)), np.concatenate((self._high, -nothing))
        gone = np.setdiff1d(np.arange(len(old_keys)), there)
        changed = np.union1d(_with_shapes(scene, moving, deformed), np.flatnonzero(there < 0))
        before = np.concatenate((there[changed], gone))
        now = np.concatenate((changed, np.full(len(gone), -1)))
        self._add([*(self._keys[row] for row in changed), *(old_keys[row] for row in gone)],
                  (low[before], high[before]), (new_low[now], new_high[now]))

    def _add(self, keys: list, before: Boxes, now: Boxes) -> None:
        """Take in where things were in the frame before and where they are."""
        if len(keys) == 0 and not self._recent:
            return
        low, high = np.concatenate((before[0], now[0])), np.concatenate((before[1], now[1]))
        drawn = (low <= high).all(1)
        if len(keys) > int(WAYS):
            # Too many to follow one by one.
            low, high = _few(low[drawn], high[drawn])
            self._recent.append((-1 - np.arange(len(low)), low, high))
        else:
            self._recent.append((self._ways_of(keys, before, now)[drawn], low[drawn], high[drawn]))
        if not any(len(ways) for ways, _, _ in self._recent):
            self._recent.clear()
            self._ways = {}
        self._write()

    def _ways_of(self, keys: list, before: Boxes, now: Boxes) -> np.ndarray:
        """Return the ways on which things were in the frame before and, after all these, on which they are."""
        with np.errstate(invalid="ignore"):
            apart = np.maximum(now[0] - before[1], before[0] - now[1])
            near = (apart <= JUMP * (before[1] - before[0])).all(1)
        for key in keys:
            if key not in self._ways:
                self._ways[key] = self._new_way()
        first = [self._ways[key] for key in keys]
        for i in np.flatnonzero(~near):
            self._ways[keys[i]] = self._new_way()
        return np.array([*first, *(self._ways[key] for key in keys)], np.int64)

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


def _with_shapes(scene: DeviceScene, moving: np.ndarray, deformed: Collection) -> np.ndarray:
    """Return, ascending, rows of instances that move or whose mesh has another shape."""
    if not deformed:
        return moving
    meshes = np.array([key in deformed for key in scene.table.mesh_keys], bool)
    return np.union1d(moving, np.flatnonzero(meshes[scene.table.mesh_index]))


def _few(low: np.ndarray, high: np.ndarray) -> Boxes:
    """Return at most WAYS boxes around all: of neighbours along the axis on which they are spread most."""
    if len(low) <= int(WAYS):
        return low, high
    center = low + high
    order = np.argsort(center[:, np.ptp(center, axis=0).argmax()], kind="stable")
    starts = np.arange(int(WAYS)) * len(order) // int(WAYS)
    return np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts)
