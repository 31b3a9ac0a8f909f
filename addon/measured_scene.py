# SPDX-License-Identifier: GPL-3.0-or-later
"""A .blend file's scene in a session that stays open, for measurements that change settings and camera themselves."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ..engine.errors import BurnishError
from ..engine.measure_moving import fly_over
from ..engine.scene import CameraData
from ..engine.session import Session
from ..engine.settings import Integrator, RenderSettings

__all__ = ["MeasuredScene", "open_measured"]

PLAN_SHRINK = 4
"""The flight is planned on a picture smaller by this factor"""


@dataclasses.dataclass
class MeasuredScene:
    """A scene in a session."""

    name: str
    session: Session
    settings: RenderSettings
    """As the file has them, with the real-time integrator"""
    camera: CameraData
    extraction: float
    """Seconds that reading Blender's scene took"""

    def flight(self, size: tuple[int, int], count: int) -> list[CameraData]:
        """Return the cameras of a flight that begins in the scene's camera; its steps are right for what is seen."""
        small = max(size[0] // PLAN_SHRINK, 1), max(size[1] // PLAN_SHRINK, 1)
        self.session.configure(self.settings, self.camera, *small, passes=("Combined", "Position"))
        positions = self.session.read("Position").astype(np.float64)
        return fly_over(self.camera, positions, count)

    def truth(self, camera: CameraData, size: tuple[int, int], samples: int, seconds: float) -> np.ndarray:
        """Return the path tracer's picture [h, w, 3], bottom row first, of so many samples or after so many seconds."""
        import time

        sampling = dataclasses.replace(self.settings.sampling, integrator=Integrator.REFERENCE, seed=12345)
        self.session.configure(dataclasses.replace(self.settings, sampling=sampling), camera, *size)
        end = time.perf_counter() + seconds
        while self.session.samples_done < samples and time.perf_counter() < end:
            self.session.step(min(32, samples - self.session.samples_done))
            self.session.read("Combined")
        return self.session.read("Combined")[..., :3]

    def close(self) -> None:
        """Give the device's memory back."""
        self.session.keep = False
        self.session.close()


def open_measured(path: Path, size: tuple[int, int], device: str) -> MeasuredScene:
    """Open a .blend file and put its scene into a session by a final render of one frame.

    Args:
        path: The file.
        size: Of pictures to come [px]; their shape matters.
        device: `cpu` or `cuda:N`.

    Raises:
        BurnishError: It can't be opened or rendered.
    """
    if not path.is_file():
        raise BurnishError(f"The file '{path}' does not exist")
    from .bench_engines import kept_sessions, open_scene
    from .bench_store import Job

    scene = open_scene(path, size, device)
    scene.configure(Job(engine="realtime", samples=1))
    with kept_sessions(keep=True) as opened:
        scene.shoot()
    if not opened or opened[-1].view is None:
        raise BurnishError(f"Burnish's final render of '{path}' opened no session")
    session = opened[-1]
    if session.view.camera.panoramic:
        raise BurnishError(f"The camera of '{path}' is panoramic and has no real-time frames; choose another")
    sampling = dataclasses.replace(session.settings.sampling, integrator=Integrator.REALTIME)
    return MeasuredScene(path.stem, session, dataclasses.replace(session.settings, sampling=sampling),
                         session.view.camera, session.extraction)
