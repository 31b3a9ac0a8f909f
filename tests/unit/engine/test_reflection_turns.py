# SPDX-License-Identifier: GPL-3.0-or-later
"""Test which blocks of pixels do without reflection samples while the camera moves, and that the light stays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.passes import reflections
from burnish.engine.scene import SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import (
    CacheSettings,
    DenoiserSettings,
    Integrator,
    ReflectionSettings,
    SamplingSettings,
)
from burnish.kernels.reflection_types import WAITS

from tests import scenes
from tests.glossy_scenes import glossy, metal, panel
from tests.light_scenes import look_at

SIZE = (48, 32)
WARM_UP = 48


class Pan:
    """A camera that moves over a floor, a little further in each frame."""

    def __init__(self, delta, **denoiser):
        self.settings = dataclasses.replace(
            scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME),
            cache=CacheSettings(capacity=16, cell_pixels=8.0, minimum_cell=0.02),
            denoiser=DenoiserSettings(path_traced_rest=False, **denoiser),
            reflections=ReflectionSettings(roughness_weak=0.5))
        self.session, self.x = Session(self.settings), 0.0
        self.session.update(delta)

    def frame(self, delta=None):
        """Render a frame; return which blocks were sampled, [rows, columns]."""
        self.x += 0.002
        if delta is not None:
            self.session.update(delta)
        self.session.configure(
            self.settings, look_at((self.x, -1.8, 1.0), (self.x, 0.0, 0.0), SIZE, 0.8), *SIZE)
        self.session.step(1)
        place = self.session._realtime.pipeline.reflections.samples.place.numpy()
        return (place < int(WAITS)).reshape(SIZE[1] // 2, SIZE[0] // 2)


def floor(material, background=1.0):
    """Make a floor of one material under a sky, and a panel that can be moved."""
    meshes = {"floor": scenes.quad(50.0), "panel": scenes.quad(0.2)}
    return scenes.delta(meshes, objects(), {"floor": material, "panel": panel((1.0, 0.5, 0.2), 4.0)},
                        background=background)


def objects(height=30.0):
    """Return the floor and the panel above it."""
    return [("floor", np.eye(4), "floor"), ("panel", scenes.place(z=height), "panel")]


@pytest.fixture
def large(monkeypatch):
    """Let small pictures count as large ones."""
    monkeypatch.setattr(reflections, "HALF_RATE_PIXELS", 0)


@pytest.mark.parametrize("material", [metal(0.3), glossy(color=0.3, roughness=0.4)])
def test_known_blocks_take_turns(large, material):
    """Sample half of the blocks in a frame, all of them as often, row by row."""
    pan = Pan(floor(material))
    for _ in range(WARM_UP):
        pan.frame()
    sampled = np.stack([pan.frame() for _ in range(8)])
    inner = sampled[:, 2:-2, 2:-2]
    assert (inner.sum(0) == 4).mean() > 0.98
    assert inner[0].mean() == pytest.approx(0.5, abs=0.03)
    assert (inner[0][1:] != inner[0][:-1]).mean() > 0.95
    np.testing.assert_array_equal(inner[0] | inner[4], True)


@pytest.mark.parametrize("kind", ["mirror", "no history", "new", "moving object", "edited light", "small"])
def test_other_blocks_do_not_wait(kind, monkeypatch):
    """Sample every block of a mirror, without means or before they are long, in small pictures, while things change."""
    if kind != "small":
        monkeypatch.setattr(reflections, "HALF_RATE_PIXELS", 0)
    delta = floor(metal(0.0 if kind == "mirror" else 0.3))
    pan = Pan(delta, reflection_temporal=kind != "no history")
    for _ in range(4 if kind == "new" else WARM_UP):
        pan.frame()
    for index in range(4):
        change = None
        if kind == "moving object":
            change = SceneDelta(instances=scenes.instances(objects(30.0 - index)))
        elif kind == "edited light" and index == 0:
            change = SceneDelta(world=scenes.world(2.0))
        sampled = pan.frame(change)
        assert sampled.all(), index


@pytest.mark.parametrize(("frames", "error", "waits"), [
    (16.0, 0.05, True), (16.0, 0.2, False), (5.0, 0.05, True), (3.0, 0.05, False), (-16.0, 0.05, False)])
def test_noisy_blocks_do_not_wait(large, frames, error, waits):
    """Let a block wait if its mean is of four samples at least, unchanged, and surer than a tenth of what is shown."""
    pan = Pan(floor(metal(0.3)))
    for _ in range(WARM_UP):
        pan.frame()
    frame = pan.session._realtime
    state = frame.pipeline.reflection_denoise.history.current(frame.views.parity).state
    words = np.tile(np.array([frames, 1.0, error * abs(frames)**0.5, 0.5], np.float16), (len(state), 1))
    state.assign(words.view(np.uint64).reshape(-1))
    assert pan.frame()[2:-2, 2:-2].mean() == pytest.approx(0.5 if waits else 1.0, abs=0.03)


def test_light_stays(large):
    """Have the same light on average as with all samples."""
    pictures = []
    for wait in (True, False):
        pan = Pan(floor(metal(0.3), background=0.8))
        pan.settings = dataclasses.replace(
            pan.settings, reflections=dataclasses.replace(pan.settings.reflections, half_rate=wait))
        for _ in range(WARM_UP + 16):
            pan.frame()
        pictures.append(pan.session.read()[..., :3])
    np.testing.assert_allclose(pictures[0].mean(), pictures[1].mean(), rtol=0.002)
