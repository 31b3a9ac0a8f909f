# SPDX-License-Identifier: GPL-3.0-or-later
"""Test which blocks of pixels do without reflection samples while the camera moves, and that the light stays."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.passes import reflections
from burnish.kernels.reflection_types import WAITS

from tests.glossy_scenes import glossy, metal
from tests.panning import SIZE, WARM_UP, Pan, change_of, floor, with_and_without


def step(pan, delta=None):
    """Render a frame; return which blocks were sampled, [rows, columns]."""
    pan.frame(delta)
    place = pan.realtime.pipeline.reflections.samples.place.numpy()
    return (place < int(WAITS)).reshape(SIZE[1] // 2, SIZE[0] // 2)


@pytest.fixture
def large(monkeypatch):
    """Let small pictures count as large ones."""
    monkeypatch.setattr(reflections, "HALF_RATE_PIXELS", 0)


@pytest.mark.parametrize("material", [metal(0.3), glossy(color=0.3, roughness=0.4)])
def test_known_blocks_take_turns(large, material):
    """Sample half of the blocks in a frame, all of them as often, row by row."""
    pan = Pan(floor(material)).frames()
    sampled = np.stack([step(pan) for _ in range(8)])
    inner = sampled[:, 2:-2, 2:-2]
    assert (inner.sum(0) == 4).mean() > 0.98
    assert inner[0].mean() == pytest.approx(0.5, abs=0.03)
    assert (inner[0][1:] != inner[0][:-1]).mean() > 0.95
    np.testing.assert_array_equal(inner[0] | inner[4], True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mirror", "no history", "new", "moving object", "edited light", "small"])
def test_other_blocks_do_not_wait(kind, monkeypatch):
    """Sample every block of a mirror, without means or before they are long, in small pictures, while things change."""
    if kind != "small":
        monkeypatch.setattr(reflections, "HALF_RATE_PIXELS", 0)
    delta = floor(metal(0.0 if kind == "mirror" else 0.3))
    pan = Pan(delta, reflection_temporal=kind != "no history")
    pan.frames(4 if kind == "new" else WARM_UP)
    for index in range(4):
        assert step(pan, change_of(kind, index)).all(), index


@pytest.mark.slow
@pytest.mark.parametrize(("frames", "error", "waits"), [
    (16.0, 0.05, True), (16.0, 0.2, False), (5.0, 0.05, True), (3.0, 0.05, False), (-16.0, 0.05, False)])
def test_noisy_blocks_do_not_wait(large, frames, error, waits):
    """Let a block wait if its mean is of four samples at least, unchanged, and surer than a tenth of what is shown."""
    pan = Pan(floor(metal(0.3))).frames()
    frame = pan.realtime
    state = frame.pipeline.reflection_denoise.history.current(frame.views.parity).state
    words = np.tile(np.array([frames, 1.0, error * abs(frames)**0.5, 0.5], np.float16), (len(state), 1))
    state.assign(words.view(np.uint64).reshape(-1))
    assert step(pan)[2:-2, 2:-2].mean() == pytest.approx(0.5 if waits else 1.0, abs=0.03)


def test_light_stays(large):
    """Have the same light on average as with all samples."""
    pictures = with_and_without(floor(metal(0.3), background=0.8), "reflections")
    np.testing.assert_allclose(pictures[0].mean(), pictures[1].mean(), rtol=0.002)


def test_pixels_that_wait_keep_their_means(large):
    """Leave the means of a block that waits as they are, but filter a pixel whose own mean is too short for that."""
    pan = Pan(floor(metal(0.3))).frames()
    realtime = pan.realtime
    denoise = realtime.pipeline.reflection_denoise
    before = denoise.history.current(realtime.views.parity)
    state = before.state.numpy().view(np.float16).reshape(SIZE[1], SIZE[0], 4).copy()
    # Columns of which next to nothing is known, all in the blocks' left halves.
    state[:, 8:24:4, 0] = 1.0
    before.state.assign(state.view(np.uint64).reshape(-1))
    waits = ~step(pan).repeat(2, 0).repeat(2, 1)
    confidence = denoise.filtered.state.numpy().view(np.float16).reshape(SIZE[1], SIZE[0], 4)[..., 1]
    inside = np.zeros_like(waits)
    inside[4:-4, 26:-4] = True
    assert waits[inside].mean() > 0.4
    assert (confidence[waits & inside] < 0.0).all()
    assert (confidence[~waits & inside] >= 0.0).all()
    inside[:] = False
    inside[4:-4, 8:24:4] = True
    assert (confidence[inside] >= 0.0).all()
    light = denoise.history.current(realtime.views.parity).light.numpy().reshape(SIZE[1], SIZE[0])
    assert (light[4:-4, 4:-4] != 0).all()
