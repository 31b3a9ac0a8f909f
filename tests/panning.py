# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera that moves over a floor, for tests of what frames leave out while only the camera moves."""

from __future__ import annotations

import dataclasses

import numpy as np
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

    def __init__(self, delta, size=SIZE, **denoiser):
        self.size = size
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
            self.settings, look_at((self.x, -1.8, 1.0), (self.x, 0.0, 0.0), self.size, 0.8), *self.size)
        self.session.step(1)

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


def objects(height=30.0):
    """Return the floor and the panel above it."""
    return [("floor", np.eye(4), "floor"), ("panel", scenes.place(z=height), "panel")]
