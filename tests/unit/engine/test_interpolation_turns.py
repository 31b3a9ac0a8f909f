# SPDX-License-Identifier: GPL-3.0-or-later
"""Test which tiles take no light from the probes while the camera moves, and that the light stays."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.passes import screen_probes
from burnish.kernels.interpolation_turns import KEPT
from burnish.kernels.probe_types import TILE

from tests.glossy_scenes import glossy
from tests.panning import SIZE, WARM_UP, Pan, change_of, floor, with_and_without

TILES = (SIZE[1] // int(TILE), SIZE[0] // int(TILE))
FLOOR = glossy(color=0.5, roughness=0.8)


def step(pan, delta=None):
    """Render a frame; return the share of each tile's pixels that kept what they knew, [rows, columns]."""
    pan.frame(delta)
    confidence = pan.realtime.pipeline.probes.irradiance.numpy().reshape(SIZE[1], SIZE[0], 4)[..., 3]
    kept = confidence == float(KEPT)
    return kept.reshape(TILES[0], int(TILE), TILES[1], int(TILE)).mean((1, 3))


@pytest.fixture
def large(monkeypatch):
    """Let small pictures count as large ones."""
    monkeypatch.setattr(screen_probes, "HALF_RATE_PIXELS", 0)


def test_known_tiles_take_turns(large):
    """Leave every other tile out, as on a chessboard, and each in every other frame."""
    pan = Pan(floor(FLOOR)).frames()
    first, second = step(pan), step(pan)
    # At the picture's edges pixels come into view.
    inner = (slice(0, -1), slice(1, -1))
    np.testing.assert_allclose((first + second)[inner], 1.0, atol=0.05)
    chess = np.indices(TILES).sum(0) % 2
    assert abs(np.where(chess == 1, first, 1.0 - first)[inner].mean() - 0.5) > 0.45


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["new", "moving object", "edited light", "small", "switched off", "at rest"])
def test_all_tiles_have_light_otherwise(kind, monkeypatch):
    """Take light from the probes everywhere before means are long, in small pictures, while things change, at rest."""
    if kind != "small":
        monkeypatch.setattr(screen_probes, "HALF_RATE_PIXELS", 0)
    pan = Pan(floor(FLOOR))
    if kind == "switched off":
        pan.switch("probes", half_rate=False)
    pan.frames(3 if kind == "new" else WARM_UP)
    for index in range(2):
        if kind == "at rest":
            pan.x -= 0.002
        assert (step(pan, change_of(kind, index)) == 0.0).all(), index


def test_light_stays(large):
    """Have the same picture as with light from the probes in each frame, rough reflections too."""
    pictures = with_and_without(floor(FLOOR, background=0.8), "probes")
    np.testing.assert_allclose(pictures[0].mean(), pictures[1].mean(), rtol=0.002)
    assert np.abs(pictures[0] - pictures[1]).max() < 0.02 * pictures[1].mean()
