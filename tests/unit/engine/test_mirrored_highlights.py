# SPDX-License-Identifier: GPL-3.0-or-later
"""What mirrors show of glossy surfaces: the highlights of lights, as bright as path traced, and no light twice."""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes
from tests.light_checks import Setup, luminance
from tests.light_scenes import LitScene, look_at

SIZE = (64, 40)
SHARED = {"ior": 1.5, "specular_level": 0.5, "specular_tint": 1.0, "multiscatter": True}
MIRROR = scenes.material("PRINCIPLED", color=1.0, metallic=1.0, roughness=0.0, **SHARED)
WALL = np.array([[1, 0, 0, 0], [0, 0, -1, 2], [0, 1, 0, 2], [0, 0, 0, 1]], float)
"""Places a square upright at y = 2, on the floor, facing -y"""


def towards(position, target):
    """Return the matrix of a lamp that shines from a place to another."""
    return np.array(look_at(position, target, SIZE).transform).reshape(4, 4)


def satin_floor(lights, background=0.1, roughness=0.6):
    """Make a satin floor before a mirror: it shows the highlight of lamps behind the camera, which sees none itself."""
    floor = scenes.material("PRINCIPLED", color=0.6, roughness=roughness, **SHARED)
    delta = scenes.delta(
        {"floor": scenes.quad(8.0), "wall": scenes.quad(2.0)},
        [("floor", np.eye(4), "floor"), ("wall", WALL, "mirror")], {"floor": floor, "mirror": MIRROR}, lights,
        background)
    return LitScene(delta, look_at((0.0, -3.0, 1.2), (0.0, 1.5, 0.2), SIZE, 1.2))


def metal_ball():
    """Make a mirror that shows a ball of rough metal, of which it sees the side with a lamp's highlight."""
    metal = scenes.material("PRINCIPLED", color=0.6, metallic=1.0, roughness=0.4, **SHARED)
    lamp = scenes.lamp("AREA", 150.0, towards((1.5, 1.0, 3.5), (0.0, 1.0, 0.0)), size_x=0.8, size_y=0.8)
    delta = scenes.delta(
        {"floor": scenes.quad(6.0), "wall": scenes.quad(2.0), "ball": scenes.sphere(0.8, 32)},
        [("floor", np.eye(4), "floor"), ("wall", WALL, "mirror"), ("ball", scenes.place(0.0, 0.2, 0.8), "ball")],
        {"floor": scenes.material(color=0.5), "mirror": MIRROR, "ball": metal}, [lamp], 0.2)
    return LitScene(delta, look_at((1.5, -3.0, 1.6), (0.0, 1.5, 0.9), SIZE, 1.4))


def shown(scene, frames, below=4.0):
    """Return the light of frames and of Reference where the mirror shows something, up to a height."""
    setup = Setup(SIZE, truth_samples=256)
    positions = setup.positions(scene)
    mask = positions.any(-1) & (np.abs(positions[..., 1] - 2.0) < 0.01) & (positions[..., 2] < below)
    assert mask.sum() > 100
    return luminance(setup.picture(scene, frames))[mask], luminance(setup.truth(scene))[mask]


LAMPS = {
    # Frames by Reference: 1.13; 0.41 with a matte floor. What the mirror throws onto the floor is sparks to Reference.
    "sun": scenes.lamp("SUN", 3.0, towards((0.0, 0.0, 0.0), (0.15, 1.0, -0.3)), angle=0.02),
    # 1.06; 0.81.
    "area": scenes.lamp("AREA", 150.0, towards((0.0, -4.0, 1.5), (0.0, 1.0, 0.0)), size_x=0.8, size_y=0.8)}


@pytest.mark.parametrize("lamp", LAMPS)
def test_a_mirror_shows_highlights(lamp):
    """Find Reference's light in a mirror before a floor whose highlight the camera does not see."""
    picture, truth = shown(satin_floor([LAMPS[lamp]]), 12, 0.9)
    brightest = 4.0
    assert abs(np.minimum(picture, brightest).mean() / np.minimum(truth, brightest).mean() - 1.0) < 0.17


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.2, 0.28])
def test_a_mirror_shows_the_sun_in_a_polished_floor(roughness):
    """Find the highlight where few rays go on over the floor, and fewer meet the sun: about 0.3 without samples."""
    picture, truth = shown(satin_floor([LAMPS["sun"]], roughness=roughness), 16, 0.9)
    assert np.minimum(picture, 4.0).mean() == pytest.approx(np.minimum(truth, 4.0).mean(), rel=0.2)
    # One ray that meets the sun would be a thousand.
    assert picture.max() < 150.0


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.1, 0.25])
def test_a_polished_floor_shows_the_sky_once(roughness):
    """Find no more and no less light where rays and light samples share a sky."""
    picture, truth = shown(satin_floor([], 1.0, roughness), 16, 0.9)
    assert picture.mean() == pytest.approx(truth.mean(), rel=0.03)


@pytest.mark.slow
def test_a_mirror_shows_the_dark_side_of_metal():
    """Find the highlight of a metal ball where it is, instead of an even light."""
    picture, truth = shown(metal_ball(), 24)
    error = np.sort((picture - truth) ** 2 / (truth**2 + 0.01))
    # 0.07; 0.17 with matte metal.
    assert error[: int(0.99 * len(error))].mean() < 0.11


def test_a_sky_counts_once():
    """Find no more and no less light under a sky without direction, which highlights don't change."""
    picture, truth = shown(satin_floor([], 1.0), 12, 0.9)
    assert abs(picture.mean() / truth.mean() - 1.0) < 0.03
