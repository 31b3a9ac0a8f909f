# SPDX-License-Identifier: GPL-3.0-or-later
"""Small bright things in mirrors: as wide in the first frames as they are, and no sparks to the clean-up of samples."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.session import Session
from burnish.engine.settings import DenoiserSettings, Integrator, SamplingSettings
from burnish.kernels.reflection_types import PLACE_STEADY

from tests import scenes
from tests.glossy_scenes import metal, panel
from tests.light_scenes import look_at, slab
from tests.reflection_frames import ReflectionFrames

SIZE = (64, 40)


def lone_spark(roughness: float, steady: bool) -> float:
    """Return how bright the brightest pixel is in the first frame with one sample of 100 among those of 1."""
    frames = ReflectionFrames(roughness=roughness, window=0.05)
    place, pixels, valid = frames.place_all()
    direction, pdf, values, distance = frames.trace(pixels, lambda x, y: np.ones_like(x))
    values[:] = 1.0
    block = 8 * 16 + 8
    values[block] = 100.0
    frames.give(place, valid, values, distance, direction, pdf)
    if steady:
        places = frames.samples.place.numpy()
        places[block] |= int(PLACE_STEADY)
        frames.samples.place.assign(places)
    return frames.show(rest=0).max()


def test_what_mirrors_show_by_no_chance_is_no_spark() -> None:
    """Keep a bright sample of a mirror that is marked as emitted, spread others and those of rougher surfaces."""
    assert lone_spark(0.0, steady=True) == pytest.approx(100.0, rel=0.01)
    assert lone_spark(0.0, steady=False) < 50.0
    assert lone_spark(0.2, steady=True) == lone_spark(0.2, steady=False)


def test_bulbs_in_a_mirror_are_as_wide_as_they_are() -> None:
    """Show shining cubes behind the camera in a mirror wall after eight frames as wide as the path tracer."""
    meshes = {"wall": slab((-3, 2, 0), (3, 2.1, 3))}
    for i in range(3):
        x, z = -0.9 + 0.9 * i, 1.2 + 0.3 * i
        meshes[f"bulb {i}"] = slab((x, -3.2, z), (x + 0.16, -3.04, z + 0.16))
    materials = {"wall": "mirror"}
    delta = scenes.delta(meshes, [(name, np.eye(4), materials.get(name, "bulb")) for name in meshes],
                         {"mirror": metal(0.0), "bulb": panel((1.0, 1.0, 1.0), 20.0)}, background=0.02)
    camera = look_at((0.0, -2.8, 1.5), (0.0, 2.0, 1.5), SIZE, 0.5)
    truth = scenes.render(delta, camera, SIZE, 256)[..., :3].mean(-1)
    settings = dataclasses.replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME),
        denoiser=DenoiserSettings(path_traced_rest=False))
    session = Session(settings)
    session.update(delta)
    session.configure(settings, camera, *SIZE)
    session.step(8)
    shown = session.read()[..., :3].mean(-1)
    session.close()
    bright = [int((picture > 0.5).sum()) for picture in (truth, shown)]
    assert bright[0] > 8
    assert bright[1] < 1.6 * bright[0]
    assert shown.sum() == pytest.approx(truth.sum(), rel=0.1)
