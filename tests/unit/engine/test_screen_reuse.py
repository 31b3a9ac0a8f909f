# SPDX-License-Identifier: GPL-3.0-or-later
"""What reflections take over from the frame before: light that is the same from everywhere, no highlights."""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes
from tests.light_checks import Setup, luminance
from tests.light_scenes import LitScene, look_at

SIZE = (64, 40)


def sun_over_a_floor():
    """Make a mirror ball on a satin floor that shows the camera the highlight of a low sun ahead, but not the ball."""
    shared = {"ior": 1.5, "specular_level": 0.5, "specular_tint": 1.0, "multiscatter": True}
    materials = {
        "floor": scenes.material("PRINCIPLED", color=0.8, roughness=0.6, **shared),
        "mirror": scenes.material("PRINCIPLED", color=1.0, metallic=1.0, roughness=0.0, **shared)}
    # It shines towards the camera and to the left, past the floor before the ball.
    matrix = np.array(look_at((0.3, 1.0, 0.25), (0.0, 0.0, 0.0), SIZE).transform).reshape(4, 4)
    delta = scenes.delta(
        {"floor": scenes.quad(30.0), "ball": scenes.sphere(1.0, 48)},
        [("floor", np.eye(4), "floor"), ("ball", scenes.place(0.0, 0.0, 1.0), "mirror")], materials,
        lights=[scenes.lamp("SUN", 3.0, matrix, angle=0.02)], background=0.1)
    return LitScene(delta, look_at((0.0, -5.0, 1.6), (0.0, 0.0, 0.8), SIZE, 1.2))


@pytest.mark.slow
def test_a_mirror_shows_no_highlight_of_the_camera():
    """Find Reference's light in a ball whose floor is in view: brighter than it looks from the ball."""
    setup = Setup(SIZE, truth_samples=256)
    scene = sun_over_a_floor()
    positions = setup.positions(scene)
    on_ball = positions.any(-1) & (np.abs(np.linalg.norm(positions - (0.0, 0.0, 1.0), axis=-1) - 1.0) < 0.02)
    # What shows the floor between ball and camera.
    before = on_ball & (positions[..., 2] < 0.9) & (np.abs(positions[..., 0]) < 0.6)
    picture, truth = luminance(setup.picture(scene, 24)), luminance(setup.truth(scene))
    # 1.00; 1.17 with what the camera sees of the floor.
    assert abs(picture[before].mean() / truth[before].mean() - 1.0) < 0.06
