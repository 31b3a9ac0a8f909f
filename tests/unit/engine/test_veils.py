# SPDX-License-Identifier: GPL-3.0-or-later
"""Test pixels that show one of several surfaces by chance: the light behind them, and their history."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.scene import SceneDelta
from burnish.kernels.gbuffer import SURFACE_VEILED
from burnish.kernels.reprojection import VEILED

from tests import scenes
from tests.gbuffer_frames import GBufferFrames


def veils(heights, **fields):
    """Return a scene of planes that let 0.7 of the light through, at heights above a plane of radiance 20, or none."""
    shining = fields.pop("shining", True)
    placed = [("plane", scenes.place(0.0, 0.0, height), "veil") for height in heights]
    materials = {"veil": scenes.transparent(0.7, color=0.5), "lamp": scenes.material(color=0.5, emission=20.0)}
    if shining:
        placed.append(("plane", np.eye(4), "lamp"))
    return scenes.delta({"plane": scenes.quad(20.0)}, placed, materials, **fields)


@pytest.mark.parametrize(("heights", "fields", "expected"), [
    ([0.5], {}, 14.0), ([0.3, 0.6], {}, 9.8), ([0.5], {"shining": False, "background": 3.0}, 2.1),
])
def test_light_behind_veils_is_in_every_frame(heights, fields, expected):
    """See what shines behind veils by as much as they let through, whichever of the surfaces a pixel shows."""
    frames = GBufferFrames(veils(heights, **fields), (8, 8))
    hits = set()
    for _ in range(8):
        picture = frames.shot()
        np.testing.assert_allclose(picture["emission"][..., :3], expected, rtol=1e-3)
        hits |= set(picture["hit"][..., 0].ravel().tolist())
    assert len(hits) == len(heights) + 1


def test_light_behind_veils_can_go_out():
    """Show no light of before where the shining surface behind a veil has become another."""
    frames = GBufferFrames(veils([0.5]), (8, 8))
    frames.shot()
    frames.update(SceneDelta(materials={"lamp": scenes.material(color=0.5)}))
    assert not frames.shot()["emission"][..., :3].any()


@pytest.mark.parametrize("heights", [[], [0.5]])
def test_veiled_pixels_have_a_history(heights):
    """Mark pixels with layers, in the G-buffer and as such that may have shown another surface in the picture."""
    frames = GBufferFrames(veils(heights), (8, 8))
    frames.frame()
    veiled = frames.frame().material.numpy() & int(SURFACE_VEILED) != 0
    marked = frames.gbuffer_pass.reprojection.taps.numpy() & int(VEILED) != 0
    assert (veiled == bool(heights)).all() and (marked == bool(heights)).all()
    frames.views.restart()
    frames.frame()
    assert not (frames.gbuffer_pass.reprojection.taps.numpy() & int(VEILED)).any()
