# SPDX-License-Identifier: GPL-3.0-or-later
"""Sharp coats on rough bases, as car paint: rays are the coat's, the probes know what the base reflects."""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes
from tests.light_checks import Setup, luminance
from tests.light_scenes import LitScene, look_at

SIZE = (64, 40)


def paint(metallic):
    """Make a ball of car paint on a pale floor under two soft boxes."""
    shared = {"ior": 1.5, "specular_level": 0.5, "specular_tint": 1.0, "multiscatter": True}
    materials = {
        "floor": scenes.material("PRINCIPLED", color=0.7, roughness=0.9, **shared),
        "paint": scenes.material(
            "PRINCIPLED", color=(0.6, 0.1, 0.1), metallic=metallic, roughness=0.4, coat=1.0, coat_roughness=0.03,
            coat_ior=1.5, coat_tint=1.0, **shared)}
    boxes = [scenes.lamp("AREA", power, np.array(look_at(place, (0.0, 0.0, 0.5), SIZE).transform).reshape(4, 4),
                         shape="SQUARE", size_x=1.5, size_y=1.5)
             for power, place in ((300.0, (3.0, -2.0, 4.0)), (150.0, (-4.0, -1.0, 3.0)))]
    delta = scenes.delta(
        {"floor": scenes.quad(20.0), "ball": scenes.sphere(1.0, 48)},
        [("floor", np.eye(4), "floor"), ("ball", scenes.place(0.0, 0.0, 1.0), "paint")], materials, lights=boxes,
        background=0.05)
    return LitScene(delta, look_at((0.0, -5.0, 1.6), (0.0, 0.0, 0.9), SIZE, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(("metallic", "most"), [(0.6, 0.2), (0.0, 0.165)])
def test_car_paint_is_clean_in_first_frames(metallic, most):
    """Find Reference's light on the ball, and show it without grain after eight frames.

    It was 0.25 and 0.19 with rays of both lobes; some of it is the truth's own.
    """
    setup = Setup(SIZE, truth_samples=512)
    scene = paint(metallic)
    positions = setup.positions(scene)
    on_ball = positions.any(-1) & (np.abs(np.linalg.norm(positions - (0.0, 0.0, 1.0), axis=-1) - 1.0) < 0.02)
    # What shows the floor, and no soft box.
    lower = on_ball & (positions[..., 2] < 0.9) & (positions[..., 2] > 0.15)
    truth = luminance(setup.truth(scene))
    early, late = (np.clip(luminance(setup.picture(scene, frames)), 0.0, 2.0) for frames in (8, 48))
    assert lower.sum() > 150
    grain = np.sqrt(np.mean((early[lower] / truth[lower] - 1.0) ** 2))
    assert grain < most
    assert abs(late[lower].mean() / truth[lower].mean() - 1.0) < 0.04
    assert abs(late[on_ball].mean() / np.clip(truth[on_ball], 0.0, 2.0).mean() - 1.0) < 0.04
