# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things have moved in the last frames, come from or gone, as boxes on the device (kernels/moved_ways.py)."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

import numpy as np
import warp as wp

from ..kernels.moved_ways import WAYS
from .device_scene import DeviceScene
from .staging import RowWriter

__all__ = ["MovedWays"]

FRAMES = 16
"""Frames for which a way is remembered: most cells that rays meet have got a sample by then"""


class MovedWays:
    """The ways of the last FRAMES frames; nothing is written while nothing has moved in them."""

    def __init__(self, device: str):
        self.array = wp.zeros(1 + 2 * int(WAYS), dtype=wp.vec3, device=device)
        """Number of boxes, then the lower and the upper corner of each [m, scene space]"""
        self._writer = RowWriter(wp.vec3, device)
        self._recent: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=FRAMES)
        """Boxes of each frame, at most WAYS"""
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
        if scene.rows is self._rows:
            boxes = [(self._low[moving], self._high[moving])]
            self._low[moving], self._high[moving] = now = _bounds(scene, moving)
            self._add([np.minimum(boxes[0][0], now[0])], [np.maximum(boxes[0][1], now[1])])
        else:
            self._take_over(scene, moving)

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
            new = np.flatnonzero(there < 0)
            moved, gone = np.setdiff1d(moving, new), np.array([*places.values()], np.int64)
            before = there[moved]
            self._add([np.minimum(low[moved], self._low[before]), low[new], self._low[gone]],
                      [np.maximum(high[moved], self._high[before]), high[new], self._high[gone]])
        self._rows, self._keys, self._origin = scene.rows, keys, scene.origin.copy()
        self._low, self._high = low, high

    def _add(self, lows: list[np.ndarray], highs: list[np.ndarray]) -> None:
        """Take in the boxes of a frame."""
        low, high = np.concatenate(lows), np.concatenate(highs)
        drawn = (low <= high).all(1)
        if not drawn.any() and not self._recent:
            return
        self._recent.append(_few(low[drawn], high[drawn]))
        if not any(len(corners) for corners, _ in self._recent):
            self._recent.clear()
        self._write()

    def _write(self) -> None:
        """Tell the device of the boxes of all recent frames: the n-th ones of each are one."""
        values = np.zeros((1 + 2 * int(WAYS), 3), np.float32)
        count = max((len(low) for low, _ in self._recent), default=0)
        values[0, 0] = count
        lows, highs = values[1::2], values[2::2]
        lows[:count], highs[:count] = np.inf, -np.inf
        for low, high in self._recent:
            np.minimum(lows[: len(low)], low, out=lows[: len(low)])
            np.maximum(highs[: len(high)], high, out=highs[: len(high)])
        self._writer.write(self.array, values, np.arange(len(values)))


def _bounds(scene: DeviceScene, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners [N, 3] of instances' bounds, inside out of those that are not drawn."""
    drawn = scene.drawn[rows, None]
    return np.where(drawn, scene.low[rows], np.inf), np.where(drawn, scene.high[rows], -np.inf)


def _few(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return at most WAYS boxes around all: of neighbours along the axis on which they are spread most."""
    if len(low) <= int(WAYS):
        return low.astype(np.float32), high.astype(np.float32)
    center = low + high
    order = np.argsort(center[:, np.ptp(center, axis=0).argmax()], kind="stable")
    starts = np.arange(int(WAYS)) * len(order) // int(WAYS)
    return (np.minimum.reduceat(low[order], starts).astype(np.float32),
            np.maximum.reduceat(high[order], starts).astype(np.float32))
