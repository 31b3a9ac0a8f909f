# SPDX-License-Identifier: GPL-3.0-or-later
"""What has moved since the frame before: transforms of instances and positions of deforming meshes from then."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels.motion import Motion
from .device_scene import DeviceScene
from .moved_ways import MovedWays
from .staging import RowWriter

__all__ = ["MotionTracker"]


class MotionTracker:
    """Keeps the transforms and positions of the frame before.

    Nothing is copied while nothing moves, little while few objects do, and until a mesh deforms the positions are the
    scene's own array. `motion` stays the same object as long as its arrays do; a frame recorded with another one must
    be recorded anew.
    """

    def __init__(self, device: str):
        self.device = device
        self.motion = Motion()
        self.motion.moved = wp.zeros(1, dtype=int, device=device)
        self.motion.previous_to_world = wp.zeros(1, dtype=wp.mat44, device=device)
        self.motion.previous_positions = wp.zeros(1, dtype=wp.vec3, device=device)
        self.ways = MovedWays(device)
        self._moved = False
        self._source: wp.array | None = None
        """The scene's positions"""
        self._own_positions = False
        self._used = 0
        self._stale: list[tuple[int, int]] = []
        """(first vertex, count) of what deformed in the frame before: there the copy is a frame too old"""
        self._writer = RowWriter(wp.mat44, device)
        self._rows: np.ndarray | None = None
        self._keys: list = []
        self._origin = np.zeros(3)
        self._now = np.zeros((0, 4, 4), np.float32)
        """Transforms in this frame"""
        self._before = self._now
        """Those in the frame before"""
        self._moving = np.zeros(0, np.int64)
        """Ascending, rows in which the two differ"""
        self._late = np.zeros(0, np.int64)
        """Ascending, rows of `_before` that the device does not have yet"""

    def advance(self, scene: DeviceScene) -> Motion:
        """Go on to the next frame; call it once a frame, after the scene has been brought up to date."""
        moved_rows = scene.take_moved_rows()
        deformed, scene.store.replaced = scene.store.replaced, {}
        scene.store.remember = True
        if scene.rows is self._rows:
            self._follow(scene.rows, moved_rows)
            self.ways.follow(scene, self._moving, deformed)
        else:
            self.ways.take_over(scene, self._take_over(scene), self._moving, deformed)
        self._fit(scene)
        self._update_positions(scene, deformed)
        moved = len(self._moving) > 0 or bool(deformed)
        if moved:
            self._writer.write(self.motion.previous_to_world, self._before, self._late)
            self._late = self._late[:0]
        if moved != self._moved:
            self.motion.moved.fill_(int(moved))
            self._moved = moved
        return self.motion

    def _follow(self, rows: np.ndarray, moved: np.ndarray) -> None:
        """Go on where instances have moved at most: `moved`, ascending, are those that may have."""
        settled = self._moving
        self._before[settled] = self._now[settled]
        if len(settled):
            self._late = np.union1d(self._late, settled)
        if len(moved):
            self._now[moved] = rows["to_world"][moved]
        self._moving = moved[(self._now[moved] != self._before[moved]).any((1, 2))] if len(moved) else moved

    def _take_over(self, scene: DeviceScene) -> np.ndarray | None:
        """Go on with other instances: those known by their keys come from where they were, others stand still.

        Returns int64 [N], their rows in the frame before, -1 for new ones; None where nothing of then counts any more.
        """
        keys = [] if scene.table is None else scene.table.object_keys
        now, before = scene.rows["to_world"].copy(), scene.rows["to_world"].copy()
        there = None
        if self._rows is not None and (scene.origin == self._origin).all():
            there = np.arange(len(keys))
            if keys != self._keys:
                places = {key: i for i, key in enumerate(self._keys)}
                there = np.array([places.get(key, -1) for key in keys], np.int64)
            known = there >= 0
            before[known] = self._now[there[known]]
        self._rows, self._keys, self._origin = scene.rows, keys, scene.origin.copy()
        self._now, self._before, self._late = now, before, np.arange(len(now))
        self._moving = np.flatnonzero((now != before).any((1, 2)))
        return there

    def _fit(self, scene: DeviceScene) -> None:
        """Allocate what the scene has outgrown."""
        positions = scene.store.positions.array
        count = max(len(self._now), 1)
        if len(self.motion.previous_to_world) != count:
            self._replace(self.motion.previous_positions, wp.zeros(count, dtype=wp.mat44, device=self.device))
        if self._source is not positions:
            self._replace(positions, self.motion.previous_to_world)
            self._source, self._own_positions, self._stale = positions, False, []

    def _replace(self, positions: wp.array, transforms: wp.array) -> None:
        moved, self.motion = self.motion.moved, Motion()
        self.motion.moved = moved
        self.motion.previous_positions, self.motion.previous_to_world = positions, transforms

    def _update_positions(self, scene: DeviceScene, deformed: dict) -> None:
        """Make the copy of positions that of the frame before."""
        positions = scene.store.positions.array
        if deformed and not self._own_positions:
            self._replace(wp.clone(positions), self.motion.previous_to_world)
            self._own_positions, self._stale = True, []
        elif self._own_positions and scene.store.positions.used > self._used:
            self._stale.append((self._used, scene.store.positions.used - self._used))
        self._used = scene.store.positions.used
        for start, count in self._stale:
            wp.copy(self.motion.previous_positions, positions, start, start, count)
        self._stale = []
        for start, count, kept in deformed.values():
            if kept is None:
                wp.copy(self.motion.previous_positions, positions, start, start, count)
            else:
                wp.copy(self.motion.previous_positions, kept, start, 0, count)
                self._stale.append((start, count))
