# SPDX-License-Identifier: GPL-3.0-or-later
"""What has moved since the frame before: transforms of instances and positions of deforming meshes from then."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels.motion import Motion
from .device_scene import DeviceScene

__all__ = ["MotionTracker"]


class MotionTracker:
    """Keeps the transforms and positions of the frame before.

    Nothing is copied while nothing moves, and until a mesh deforms the positions are the scene's own array. `motion`
    stays the same object as long as its arrays do; a frame recorded with another one must be recorded anew.
    """

    def __init__(self, device: str):
        self.device = device
        self.motion = Motion()
        self.motion.moved = wp.zeros(1, dtype=int, device=device)
        self.motion.previous_to_world = wp.zeros(1, dtype=wp.mat44, device=device)
        self.motion.previous_positions = wp.zeros(1, dtype=wp.vec3, device=device)
        self._moved = False
        self._source: wp.array | None = None
        """The scene's positions"""
        self._own_positions = False
        self._used = 0
        self._stale: list[tuple[int, int]] = []
        """(first vertex, count) of what deformed in the frame before: there the copy is a frame too old"""
        self._rows: np.ndarray | None = None
        self._keys: list = []
        self._matrices = np.zeros((0, 4, 4), np.float32)
        self._uploaded: np.ndarray | None = None
        self._origin = np.zeros(3)

    def advance(self, scene: DeviceScene) -> Motion:
        """Go on to the next frame; call it once a frame, after the scene has been brought up to date."""
        before = self._transforms_before(scene)
        deformed, scene.store.replaced = scene.store.replaced, {}
        scene.store.remember = True
        self._fit(scene)
        self._update_positions(scene, deformed)
        moved = before is not None or bool(deformed)
        if moved:
            self._upload(self._matrices if before is None else before)
        if moved != self._moved:
            self.motion.moved.fill_(int(moved))
            self._moved = moved
        return self.motion

    def _transforms_before(self, scene: DeviceScene) -> np.ndarray | None:
        """Return the instances' transforms in the frame before if any has changed, and note those of now."""
        if scene.rows is self._rows:
            return None
        keys = [] if scene.table is None else scene.table.object_keys
        now = scene.rows["to_world"].copy()
        old_keys, old, first = self._keys, self._matrices, self._rows is None
        shifted = (scene.origin != self._origin).any()
        self._rows, self._keys, self._matrices, self._origin = scene.rows, keys, now, scene.origin.copy()
        if first or shifted:
            return None
        if keys != old_keys:
            places = {key: i for i, key in enumerate(old_keys)}
            before = now.copy()
            for i, key in enumerate(keys):
                place = places.get(key)
                if place is not None:
                    before[i] = old[place]
            old = before
        return None if np.array_equal(old, now) else old

    def _fit(self, scene: DeviceScene) -> None:
        """Allocate what the scene has outgrown."""
        positions = scene.store.positions.array
        count = max(len(self._matrices), 1)
        if len(self.motion.previous_to_world) != count:
            self._replace(self.motion.previous_positions, wp.zeros(count, dtype=wp.mat44, device=self.device))
            self._uploaded = None
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

    def _upload(self, matrices: np.ndarray) -> None:
        if len(matrices) and (self._uploaded is None or not np.array_equal(self._uploaded, matrices)):
            self.motion.previous_to_world.assign(matrices.astype(np.float32))
            self._uploaded = matrices.copy()
