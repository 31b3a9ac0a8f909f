# SPDX-License-Identifier: GPL-3.0-or-later
"""Test how soon the radiance cache knows the light of all bounces, and what bounce rays bring to it."""

from __future__ import annotations

import numpy as np
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData

from tests import scenes
from tests.unit.engine.test_radiance_cache import Rig, lit_room


def test_light_is_whole_from_the_first_frames(device):
    """See the light of all bounces, within 10 % in the very first frame and 5 % in the third, in a bright room."""
    rig = Rig(lit_room(albedo=0.85), device, count=3072)
    early = [rig.mean_of(1) for _ in range(3)]
    rig.mean_of(60)
    steady = rig.mean_of(20)
    assert 0.9 <= early[0] / steady <= 1.1
    assert 0.95 <= early[2] / steady <= 1.05


def test_light_comes_from_a_far_end_at_once(device):
    """See the light in the first four frames where rays look at the dark end of a hall that is lit at the other.

    What bounce rays meet there, no other ray meets: without rays that go on from there it was 0.5 of the light. The
    mean of three runs is noisy by 5 %.
    """
    lamp = scenes.lamp("AREA", 100.0, scenes.place(x=1.5, z=0.95), shape="SQUARE", size_x=0.5, size_y=0.5)
    hall = scenes.delta({"box": scenes.box(1.0, inward=True)}, [("box", np.diag([2.0, 1.0, 1.0, 1.0]), "wall")],
                        {"wall": scenes.material(color=0.85)}, [lamp])

    def look(rig):
        origin, direction = rig.room_rays()
        origin[:, 0] = rig.rng.uniform(-1.9, -1.1, rig.count)
        direction[:, 0] = -np.abs(direction[:, 0])
        return rig.frame(origin, direction)[:, :3].mean()

    rigs = [Rig(hall, device, count=1024, seed=seed, minimum=0.08, cell_pixels=4.0) for seed in range(3)]
    early = np.mean([look(rig) for rig in rigs for _ in range(4)])
    for _ in range(120):
        look(rigs[0])
    steady = np.mean([look(rigs[0]) for _ in range(40)])
    assert 0.85 <= early / steady <= 1.2


def leaf_over_floor(leaf):
    """Make a sheet of a material over a floor, lit by a sun from above."""
    return scenes.delta(
        {"leaf": scenes.quad(2.0), "floor": scenes.quad(6.0)},
        [("leaf", scenes.place(z=1.0), "leaf"), ("floor", scenes.place(), "floor")],
        {"leaf": leaf, "floor": scenes.material(color=0.8)}, [scenes.lamp("SUN", 2.0, angle=0.0)])


def test_leaf_gives_more_than_it_gets(device):
    """Light a floor below a leaf that reflects and lets through 1.48 of the light, as one that lets as much through.

    The mean of eight frames is noisy by 1 %; with all of it held below an albedo of 1 it was 0.68 of the light.
    """
    builder = ProgramBuilder()
    for kind in ("DIFFUSE", "TRANSLUCENT"):
        builder.closure(kind, 1.0, color=(0.74, 0.74, 0.74))
    answers = []
    for leaf in (MaterialData(name="leaf", program=builder.finish()), scenes.material("TRANSLUCENT", color=0.74)):
        rig = Rig(leaf_over_floor(leaf), device, count=1024, bounces=2)
        origin = rig.rng.uniform(-0.5, 0.5, (1024, 3)) * [1, 1, 0] + [0, 0, 0.5]
        down = np.tile([0.0, 0.0, -1.0], (1024, 1))
        answers.append(np.mean([rig.frame(origin, down)[:, :3].mean() for _ in range(8)]))
    assert answers[1] > 0.1
    np.testing.assert_allclose(answers[0], answers[1], rtol=0.04)
