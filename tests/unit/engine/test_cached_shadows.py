# SPDX-License-Identifier: GPL-3.0-or-later
"""Test that shadows in the radiance cache go along with what throws them."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.motion import MotionTracker
from burnish.engine.scene import SceneDelta
from burnish.engine.settings import PerformanceSettings

from tests import scenes
from tests.unit.engine.test_radiance_cache import Rig

COUNT = 64


def hall(x):
    """Make a closed room with a lamp under its ceiling and a plate that hangs above the floor at `x`."""
    lamp = scenes.lamp("AREA", 20.0, scenes.place(z=0.95), shape="SQUARE", size_x=0.3, size_y=0.3)
    objects = [("box", np.eye(4), "wall"), ("plate", scenes.place(x=x, z=-0.5), "wall")]
    return scenes.delta({"box": scenes.box(1.0, inward=True), "plate": scenes.quad(0.22)}, objects,
                        {"wall": scenes.material(color=0.5)}, [lamp])


class Hall(Rig):
    """That room, and rays onto the floor below the plate at 0 and at 0.55."""

    def __init__(self, device, x, follow):
        super().__init__(hall(x), device, count=COUNT, cell_pixels=4.0)
        self.tracker = MotionTracker(device)
        self.tracker.advance(self.scene)
        if follow:
            self.cache.grid.ways = self.tracker.ways.array
            self.record()

    def light(self, frames, moved=True):
        """Return the mean light of so many frames at both places; `moved`: something has, far from there."""
        answers = []
        for _ in range(frames):
            self.tracker.advance(self.scene)
            spots = np.where(np.arange(COUNT)[:, None] % 2 == 0, [0.0, 0.0, -0.55], [0.72, 0.0, -0.55])
            origin = spots + self.rng.uniform(-0.12, 0.12, (COUNT, 3)) * [1, 1, 0]
            down = np.tile([0.0, 0.0, -1.0], (COUNT, 1))
            answers.append(self.frame(origin, down, moved=moved)[:, :3])
        mean = np.mean(answers, 0)
        return np.array([mean[::2].mean(), mean[1::2].mean()])

    def move(self, x):
        """Put the plate elsewhere."""
        self.scene.apply(SceneDelta(instances=hall(x).instances), PerformanceSettings())
        self.record()


@pytest.mark.parametrize("follow", [True, False])
def test_shadows_go_along(device, follow):
    """Have most of a shadow's light back three frames after it has gone, and most of it gone where it falls now.

    Without the boxes of what has moved it is less than half: this is what they are for.
    """
    rig = Hall(device, 0.0, follow)
    rig.light(100)
    before = rig.light(30)
    rig.move(0.55)
    rig.light(3)
    now = rig.light(3)
    settled = Hall(device, 0.55, follow)
    settled.light(100)
    after = settled.light(30)
    assert after[0] > 2.0 * before[0] and after[1] < 0.5 * before[1]
    done = (now - before) / (after - before)
    assert (done > 0.8).all() if follow else (done < 0.5).all(), done


def test_cells_are_as_before_once_nothing_moves(device):
    """Average over fewer samples where light passes what has moved, and over as many as before some time after."""
    rig = Hall(device, 0.0, True)
    most = []
    for x, frames in ((0.0, 100), (0.55, 2), (0.55, 60)):
        rig.move(x)
        rig.light(frames)
        met = rig.cache.rays.vertices.cell.numpy()[:COUNT]
        most.append(rig.cache.grid.direct.numpy()[met[met >= 0], 3].mean())
    assert most[1] < 0.5 * most[0] and most[2] > 0.8 * most[0], most
