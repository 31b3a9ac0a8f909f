# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of surfaces whose shaders add up to more than they receive, as leaves of diffuse and translucent often do."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData

from tests import scenes
from tests.light_checks import Setup, eroded
from tests.light_scenes import LitScene, look_at

SIZE = (48, 32)


def leaf(diffuse, translucent):
    """Make a leaf that reflects and lets through so much of red and green, and a quarter of blue."""
    builder = ProgramBuilder()
    for kind, share in (("DIFFUSE", diffuse), ("TRANSLUCENT", translucent)):
        builder.closure(kind, 1.0, color=(share, share, share / 4.0))
    return MaterialData(name="leaf", program=builder.finish())


def leaves(material, lamp_power=100.0, others=None):
    """Make three leaves at right angles, open to a lamp and a grey sky; `others`: material of the upright ones."""
    upright = np.array([[1, 0, 0, 0], [0, 0, -1, 1], [0, 1, 0, 1], [0, 0, 0, 1]], float)
    aside = np.array([[0, 0, 1, -1], [0, 1, 0, 0], [-1, 0, 0, 1], [0, 0, 0, 1]], float)
    delta = scenes.delta(
        {"leaf": scenes.quad(1.0)},
        [("leaf", np.eye(4), "leaf"), ("leaf", upright, "others"), ("leaf", aside, "others")],
        {"leaf": material, "others": others or material},
        lights=[scenes.lamp("POINT", lamp_power, scenes.place(0.0, 0.0, 1.5), radius=0.2)],
        background=0.2)
    return LitScene(delta, look_at((1.8, -2.5, 1.6), (-0.2, 0.1, 0.3), SIZE, 0.8))


def closed_box(material):
    """Make a closed cube with a lamp inside."""
    delta = scenes.delta({"box": scenes.box(1.0, inward=True)}, [("box", np.eye(4), "leaf")], {"leaf": material},
                         lights=[scenes.lamp("POINT", 10.0, scenes.place(0.0, 0.0, 0.5), radius=0.1)])
    return LitScene(delta, look_at((0.3, -0.8, 0.2), (-0.2, 1.0, -0.3), SIZE, 1.4))


@pytest.mark.slow
@pytest.mark.parametrize("frames", [1, 24])
def test_leaves_give_more_than_they_get(frames):
    """Match Reference where leaves that give 1.4 of what they get shine on each other, from the first frame on."""
    scene = leaves(leaf(0.7, 0.7))
    setup = Setup(SIZE, truth_samples=256)
    inside = eroded(setup.positions(scene).any(-1), 1)
    ratio = setup.picture(scene, frames)[inside].mean(0) / setup.truth(scene)[inside].mean(0)
    # With colours up to 1 in the G-buffer and up to 0.999 from cell to cell 0.73 and 0.71.
    np.testing.assert_allclose(ratio, 1.0, atol=0.06 if frames == 1 else 0.02)


def test_sums_of_diffuse_and_glossy():
    """Show a card of diffuse and glossy, 0.8 each, beside grey ones under a grey sky, with all of its 1.6.

    Two such cards would gain light from each other without end.
    """
    builder = ProgramBuilder()
    builder.closure("DIFFUSE", 1.0, color=0.8)
    builder.closure("GLOSSY", 1.0, color=0.8, roughness=0.6, multiscatter=True)
    scene = leaves(MaterialData(name="sum", program=builder.finish()), 0.0, scenes.material(color=0.5))
    setup = Setup(SIZE, truth_samples=256)
    positions = setup.positions(scene)
    inside = eroded(positions.any(-1) & (np.abs(positions[..., 2]) < 0.01), 1)
    assert inside.sum() > 50
    ratio = setup.picture(scene, 24)[inside].mean() / setup.truth(scene)[inside].mean()
    assert abs(ratio - 1.0) < 0.03


def test_translucent_walls_do_not_overshoot():
    """Keep a closed room of such walls, which lets half of its light out, near Reference in its first frames."""
    scene = closed_box(leaf(0.7, 0.7))
    setup = Setup(SIZE, truth_samples=64)
    ratio = setup.picture(scene, 8).mean() / setup.truth(scene).mean()
    # 1.9 where light gains in each of a frame's sweeps, 0.64 where it never does.
    assert 0.85 < ratio < 1.15


@pytest.mark.slow
def test_light_without_end_stays_finite():
    """Bound the light of a closed room that gives 1.6 of what it gets."""
    builder = ProgramBuilder()
    for _ in range(2):
        builder.closure("DIFFUSE", 1.0, color=0.8)
    scene = closed_box(MaterialData(name="bright", program=builder.finish()))
    setup = Setup(SIZE)
    session = setup.session(scene)
    session.step(64)
    picture = session.read()[..., :3]
    assert np.isfinite(picture).all()
    assert 10.0 < picture.mean() < 6.5e4
