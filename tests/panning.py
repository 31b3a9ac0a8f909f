# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera that moves over a floor, for tests of what frames leave out while only the camera moves."""

from __future__ import annotations

import dataclasses

import numpy as np
from burnish.engine.scene import SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import (
    CacheSettings,
    DenoiserSettings,
    Integrator,
    ReflectionSettings,
    SamplingSettings,
)

from tests import scenes
from tests.glossy_scenes import panel
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

    def switch(self, group, **values):
        """Change settings of a group for the frames to come."""
        changed = dataclasses.replace(getattr(self.settings, group), **values)
        self.settings = dataclasses.replace(self.settings, **{group: changed})

    def frame(self, delta=None):
        """Render a frame, a little further along."""
        self.x += 0.002
        if delta is not None:
            self.session.update(delta)
        self.session.configure(
            self.settings, look_at((self.x, -1.8, 1.0), (self.x, 0.0, 0.0), SIZE, 0.8), *SIZE)
        self.session.step(1)

    def frames(self, count=WARM_UP):
        """Render so many frames; return the camera."""
        for _ in range(count):
            self.frame()
        return self

    @property
    def realtime(self):
        """Return the real-time integrator."""
        return self.session._realtime

    def picture(self):
        """Return the picture without alpha."""
        return self.session.read()[..., :3]


def floor(material, background=1.0):
    """Make a floor of one material under a sky, and a panel that can be moved."""
    meshes = {"floor": scenes.quad(50.0), "panel": scenes.quad(0.2)}
    return scenes.delta(meshes, objects(), {"floor": material, "panel": panel((1.0, 0.5, 0.2), 4.0)},
                        background=background)


def change_of(kind, index):
    """Return what changes in a frame of a test, the `index`th: None unless it is called by one of these names."""
    if kind == "moving object":
        return SceneDelta(instances=scenes.instances(objects(30.0 - index)))
    if kind == "edited light" and index == 0:
        return SceneDelta(world=scenes.world(2.0))
    return None


def with_and_without(delta, group):
    """Return the pictures after a long pan with `half_rate` of a group of settings, and without."""
    pictures = []
    for wait in (True, False):
        pan = Pan(delta)
        pan.switch(group, half_rate=wait)
        pictures.append(pan.frames(WARM_UP + 16).picture())
    return pictures


def objects(height=30.0):
    """Return the floor and the panel above it."""
    return [("floor", np.eye(4), "floor"), ("panel", scenes.place(z=height), "panel")]
