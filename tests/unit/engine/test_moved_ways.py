# SPDX-License-Identifier: GPL-3.0-or-later
"""Test what is told of where things have moved: boxes around their ways, for some frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.device_scene import DeviceScene
from burnish.engine.motion import MotionTracker
from burnish.engine.moved_ways import FRAMES
from burnish.engine.scene import SceneDelta
from burnish.engine.settings import PerformanceSettings
from burnish.kernels.moved_ways import WAYS

from tests import scenes
from tests.device import DEVICE

SIZE = 0.25
"""Half of a box's side"""


class Moving:
    """A row of boxes and the tracker of what moves."""

    def __init__(self, count=30):
        self.places = {f"box {i}": scenes.place(x=3.0 * i) for i in range(count)}
        self.scene, self.tracker = DeviceScene(DEVICE), MotionTracker(DEVICE)
        self.scene.apply(SceneDelta(
            full=True, meshes={"box": scenes.box(SIZE), "ball": scenes.sphere(0.1)},
            materials={"grey": scenes.material(color=0.5)}, instances=self.table()), PerformanceSettings())
        self.tracker.advance(self.scene)

    def table(self):
        """Return the instances as they are."""
        keys = list(self.places)
        return replace(scenes.instances([("box", self.places[key], "grey") for key in keys]), object_keys=keys)

    def frame(self, **edit):
        """Apply an edit and go on to the next frame; return the boxes' corners."""
        if edit:
            self.scene.apply(SceneDelta(**edit), PerformanceSettings())
        self.tracker.advance(self.scene)
        values = self.tracker.ways.array.numpy()
        count = int(values[0, 0])
        return values[1 : 1 + 2 * count : 2] + self.scene.origin, values[2 : 2 + 2 * count : 2] + self.scene.origin

    def move(self, steps):
        """Shift boxes, {number: (x, y, z)}, and go on."""
        for number, step in steps.items():
            self.places[f"box {number}"][:3, 3] += step
        return self.frame(instances=self.table())


def holds(low, high, center, size=SIZE):
    """Return whether a box around a point lies in one of those."""
    near = 1e-4
    return ((low <= np.asarray(center) - size + near) & (high >= np.asarray(center) + size - near)).all(1).any()


def test_ways_are_told_and_forgotten():
    """Hold where a thing was and where it is, for FRAMES frames; nothing before, and nothing after."""
    moving = Moving()
    assert len(moving.frame()[0]) == 0
    low, high = moving.move({4: (0.0, 1.0, 0.0)})
    assert len(low) == 1 and holds(low, high, (12.0, 0.0, 0.0)) and holds(low, high, (12.0, 1.0, 0.0))
    assert not holds(low, high, (15.0, 0.0, 0.0))
    low, high = moving.move({4: (0.0, 1.0, 0.0), 9: (0.0, 0.0, 0.5)})
    assert len(low) == 2 and holds(low, high, (12.0, 0.0, 0.0)) and holds(low, high, (27.0, 0.0, 0.5))
    for _ in range(FRAMES - 2):
        low, high = moving.frame()
        assert holds(low, high, (12.0, 0.0, 0.0))
    assert not holds(*moving.frame(), (12.0, 0.0, 0.0))
    assert len(moving.frame()[0]) == 0


def test_jumps_begin_anew():
    """Hold both places of a thing that is suddenly far away, and nothing in between, also when it goes on there."""
    moving = Moving()
    moving.move({4: (0.0, 0.5, 0.0)})
    moving.move({4: (0.0, 100.0, 0.0)})
    low, high = moving.move({4: (0.0, 0.5, 0.0)})
    assert len(low) == 2 and (high - low).max() < 4.0
    assert holds(low, high, (12.0, 0.5, 0.0)) and holds(low, high, (12.0, 101.0, 0.0))


def test_many_things_share_boxes():
    """Hold the ways of any number of things in at most WAYS boxes, neighbours together."""
    moving = Moving()
    low, high = moving.move({i: (0.0, 0.5, 0.0) for i in range(30)})
    assert len(low) == int(WAYS)
    assert all(holds(low, high, (3.0 * i, y, 0.0)) for i in range(30) for y in (0.0, 0.5))
    assert (high - low).max() < 15.0


def test_things_come_and_go():
    """Hold what appears and what vanishes, and no other."""
    moving = Moving(10)
    del moving.places["box 3"]
    moving.places["new"] = scenes.place(x=50.0)
    low, high = moving.frame(instances=moving.table())
    assert len(low) == 2 and holds(low, high, (9.0, 0.0, 0.0)) and holds(low, high, (50.0, 0.0, 0.0))


def test_meshes_of_another_shape():
    """Hold what a mesh was and what it is, wherever it is used."""
    moving = Moving(3)
    low, high = moving.frame(meshes={"box": scenes.box(0.4)})
    assert len(low) == 3 and all(holds(low, high, (3.0 * i, 0.0, 0.0), 0.4) for i in range(3))
    low, high = moving.frame(meshes={"box": scenes.box(0.1)})
    assert all(holds(low, high, (3.0 * i, 0.0, 0.0), 0.4) for i in range(3))


@pytest.mark.parametrize("what", ["empty", "hidden"])
def test_nothing_to_draw(what):
    """Stay without boxes where there is nothing, or nothing that is drawn."""
    moving = Moving(2)
    if what == "empty":
        moving.places = {}
        assert len(moving.frame(instances=moving.table())[0]) == 2
        for _ in range(FRAMES):
            low, _ = moving.frame()
        assert len(low) == 0
    else:
        moving.places["box 1"][:3, :3] = np.nan
        low, high = moving.frame(instances=moving.table())
        assert len(low) <= 1 and np.isfinite(low).all() and np.isfinite(high).all()
