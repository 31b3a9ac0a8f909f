# SPDX-License-Identifier: GPL-3.0-or-later
"""Test what the tracker of motion tells kernels of the frame before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.device_scene import DeviceScene
from burnish.engine.motion import MotionTracker
from burnish.engine.scene import InstanceTable, SceneDelta
from burnish.engine.settings import PerformanceSettings

from tests import scenes

COUNT = 90


def table(places: dict[int, float]) -> InstanceTable:
    """Return a row of boxes, some of them lifted."""
    return scenes.instances([
        ("box", scenes.place(x=3.0 * index, z=places.get(index, 0.0)), "grey") for index in range(COUNT)])


@pytest.mark.parametrize("shared", [True, False])
def test_transforms_of_the_frame_before_are_told(device, shared):
    """Tell where all instances were in each of a row of frames, moved one by one, many at once, twice or not at all."""
    scene = DeviceScene(device)
    scene.apply(SceneDelta(
        full=True, meshes={"box": scenes.box()}, materials={"grey": scenes.material(color=0.5)}, instances=table({})),
        PerformanceSettings())
    tracker = MotionTracker(device)
    tracker.advance(scene)
    lifted: dict[int, float] = {}
    steps = [{3: 0.1}, {3: 0.2}, {}, {3: 0.3, 80: 1.0}, {80: 2.0}, {}, {}, {3: 0.1}, {0: 5.0, 45: 1.0}, {3: 0.1},
             {index: 0.01 * index for index in range(COUNT)}, {7: 1.0}, {}, {8: 2.0}]
    followed = 0
    for step in steps:
        before = scene.rows["to_world"].copy()
        lifted |= step
        moved = table(lifted)
        if shared:
            moved = replace(scene.table, transforms=moved.transforms)
        if step:
            scene.apply(SceneDelta(instances=moved), PerformanceSettings())
            followed += scene.changes.followed
        motion = tracker.advance(scene)
        changed = (before != scene.rows["to_world"]).any()
        assert motion.moved.numpy()[0] == changed
        if changed:
            np.testing.assert_array_equal(motion.previous_to_world.numpy(), before)
    assert (followed > 5) == shared


def test_moves_between_two_frames_add_up(device):
    """Tell of the frame before, not of the edit before, where several edits come before one frame."""
    scene = DeviceScene(device)
    scene.apply(SceneDelta(
        full=True, meshes={"box": scenes.box()}, materials={"grey": scenes.material(color=0.5)}, instances=table({})),
        PerformanceSettings())
    tracker = MotionTracker(device)
    for lifted in ({3: 0.5}, {3: 0.6}):
        tracker.advance(scene)
        before = scene.rows["to_world"].copy()
        for share in (0.2, 0.7, 1.0):
            places = {index: share * height for index, height in lifted.items()} | {60: share}
            scene.apply(SceneDelta(instances=replace(scene.table, transforms=table(places).transforms)),
                        PerformanceSettings())
        np.testing.assert_array_equal(tracker.advance(scene).previous_to_world.numpy(), before)
