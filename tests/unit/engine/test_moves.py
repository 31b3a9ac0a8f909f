# SPDX-License-Identifier: GPL-3.0-or-later
"""Session.move: a picture, its passes of light and its guides as means over moments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.scene import LightKind, SceneDelta
from burnish.engine.session import DENOISED, Session

from tests import scenes

SIZE = (16, 16)
PASSES = ("Combined", "Emission", "Diffuse Color", "Diffuse Direct", "Combined_glow", DENOISED)
CAMERA = scenes.camera_above(3.0, 1.0)
GLOW = scenes.material(color=0.0, emission=2.0)
RED = scenes.material(color=(0.8, 0.2, 0.2))


def scene(x, lamp=5.0, shape=0.3):
    """Return a floor, a lamp, and a square that glows at `x`."""
    meshes = {"floor": scenes.quad(4.0), "square": scenes.quad(shape)}
    objects = [("floor", np.eye(4), "red"), ("square", scenes.place(x, 0.0, 0.2), "glow")]
    lamps = [scenes.lamp(LightKind.POINT, lamp, scenes.place(0.0, 0.0, 2.5), radius=0.1)]
    made = scenes.delta(meshes, objects, {"red": RED, "glow": GLOW}, lamps)
    return replace(made, instances=replace(
        made.instances, light_groups=["glow"], light_group_index=np.array([-1, 0], np.int32)))


def opened(delta):
    """Open a session on a scene."""
    made = Session(scenes.SETTINGS)
    made.update(delta)
    made.configure(scenes.SETTINGS, CAMERA, *SIZE, passes=PASSES)
    return made


def read(made):
    """Return all passes by name; direct diffuse light with its colour, by which it has been divided."""
    pictures = {name: made.read(name) for name in PASSES[:-1]}
    pictures["Diffuse Direct"] = pictures["Diffuse Direct"] * pictures["Diffuse Color"]
    return pictures


@pytest.mark.parametrize("change", ["place", "mesh", "lamp", "camera", "nothing"])
def test_a_picture_is_the_mean_over_its_moments(change):
    """Add up what is seen before and after a move, whatever moves: a thing, its shape, a lamp or the camera."""
    camera = CAMERA
    first, second = scene(-0.4), scene(0.4 if change == "place" else -0.4, 1.0 if change == "lamp" else 5.0,
                                       0.5 if change == "mesh" else 0.3)
    delta = {"place": SceneDelta(instances=second.instances), "lamp": SceneDelta(lights=second.lights),
             "mesh": SceneDelta(meshes={"square": second.meshes["square"]})}.get(change, SceneDelta())
    if change == "camera":
        camera = replace(CAMERA, transform=tuple(scenes.place(0.5, 0.0, 3.0).ravel().tolist()))
    moved, other = opened(first), opened(second)
    other.configure(scenes.SETTINGS, camera, *SIZE, passes=PASSES)
    moved.step(32)
    before = read(moved)
    moved.move(delta, camera)
    assert moved.step(32) == 64
    other.step(32)
    after, both = read(other), read(moved)
    for name, picture in both.items():
        mean = 0.5 * (before[name] + after[name])
        # Other samples of the same pixel: the noise of 32 of them.
        np.testing.assert_allclose(picture.mean((0, 1)), mean.mean((0, 1)), rtol=0.02, err_msg=name)
        assert np.abs(picture - mean).mean() <= 0.05 * np.abs(mean).mean() + 1e-6, name
    if change in ("place", "mesh", "camera"):
        assert np.abs(after["Emission"] - before["Emission"]).max() > 1.0


@pytest.mark.slow
def test_guides_are_means_over_moments():
    """Show the denoiser a thing at both of its places, at half its weight; call that noisy whatever the number."""
    moved = opened(scene(-0.4))
    moved.step(128)
    moved.move(SceneDelta(instances=scene(0.4).instances), CAMERA)
    moved.step(128)
    both = moved.guides()[0].numpy()
    singles = []
    for x in (-0.4, 0.4):
        single = opened(scene(x))
        single.step(256)
        singles.append(single.guides()[0].numpy())
        assert single.denoiser._noiseless
    np.testing.assert_allclose(both, 0.5 * (singles[0] + singles[1]), atol=0.15)
    assert np.abs(both - singles[0]).max() > 0.05
    assert moved.denoiser._guide_samples == 256 and not moved.denoiser._noiseless
    moved.reset()
    moved.step(256)
    assert moved.guides()[0].numpy().shape == both.shape and moved.denoiser._noiseless


def test_what_is_odd_at_each_moment_is_told_once():
    """Count an entry of the report once, however many moments find it."""
    spread = scenes.lamp(LightKind.AREA, 5.0, scenes.place(0.0, 0.0, 2.5), shape="SQUARE", size_x=0.5, spread=1e-3)
    made = opened(replace(scene(0.0), lights=[spread]))
    counts = dict(made.report.counts)
    for step in range(3):
        made.move(SceneDelta(lights=[replace(spread, transform=scenes.place(0.1 * step, 0.0, 2.5))]), CAMERA)
    assert counts and made.report.counts == counts
