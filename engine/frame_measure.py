# SPDX-License-Identifier: GPL-3.0-or-later
"""Times of real-time frames of a session while its camera moves: waited for one by one, in a row, and by section.

The three never mix: a frame that is waited for includes the way to the device and back; frames in a row hide Python
behind the device's work; sections are timed launch by launch, so that their sum exceeds the frame by the gaps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from .scene import CameraData
from .session import Session
from .settings import RenderSettings

__all__ = ["FrameTimes", "Measurement", "measure_frames", "there_and_back"]

WARM_UP = 8
"""Frames before anything is timed: kernels loaded, graphs captured, buffers made"""
TIMED = 5
"""Frames whose sections are timed"""


@dataclass
class FrameTimes:
    """Milliseconds, over frames with a moving camera."""

    frame: float = 0.0
    """Median of frames that are waited for one by one"""
    slowest: float = 0.0
    """Their 95th percentile"""
    in_a_row: float = 0.0
    """Mean of frames issued one after the other and waited for once"""
    python: float = 0.0
    """Median time until the frame is issued; on the processor all of it"""
    sections: dict[str, float] = field(default_factory=dict)
    """Median by section"""
    kernels: dict[str, float] = field(default_factory=dict)
    """Median by kernel"""
    counts: dict[str, int] = field(default_factory=dict)
    """Rays by kind, probes, cells of the last frame"""
    frames: int = 0
    """How many were timed"""

    def as_dict(self) -> dict:
        """Return all figures by name."""
        return dict(vars(self))


def there_and_back(cameras: Sequence[CameraData]) -> Callable[[int], CameraData]:
    """Return a function that gives the camera of each frame of an endless flight there and back again."""
    last = max(len(cameras) - 1, 1)
    return lambda number: cameras[min(abs((number + last) % (2 * last) - last), len(cameras) - 1)]


class Measurement:
    """A session whose camera flies on with every frame."""

    def __init__(self, session: Session, settings: RenderSettings, cameras: Sequence[CameraData],
                 size: tuple[int, int]):
        """Take a session with its scene in it; the size is in pixels."""
        self.session, self.settings, self.size = session, settings, size
        self._camera = there_and_back(cameras)
        self._number = 0

    def wait(self) -> None:
        """Wait for the device."""
        wp.synchronize_device(self.session.device)

    def issue(self) -> None:
        """Issue the next frame of the flight."""
        self.session.configure(self.settings, self._camera(self._number), *self.size)
        self.session.step(1)
        self._number += 1

    def frame(self) -> tuple[float, float]:
        """Render the next frame; return the seconds until it was issued and until it was done."""
        start = time.perf_counter()
        self.issue()
        issued = time.perf_counter()
        self.wait()
        return issued - start, time.perf_counter() - start

    def timed_frames(self, count: int) -> tuple[dict[str, float], dict[str, float]]:
        """Render frames whose sections are timed; return the median milliseconds by section and by kernel."""
        sections, kernels = [], []
        self.session.timed = True
        try:
            for _ in range(count):
                self.issue()
                sections.append(self.session.frame_times)
                kernels.append(self.session.kernel_times)
        finally:
            self.session.timed = False
        return medians(sections), medians(kernels)


def measure_frames(
    session: Session, settings: RenderSettings, cameras: Sequence[CameraData], size: tuple[int, int], *,
    frames: int = 40, seconds: float = float("inf"),
) -> FrameTimes:
    """Measure frames with a moving camera.

    Args:
        session: Has the scene.
        settings: With the real-time integrator; the device is the session's.
        cameras: Of the flight.
        size: Of the picture [px].
        frames: Most frames to time, in each of the ways.
        seconds: Time after which fewer must do; three frames are always timed.
    """
    flying = Measurement(session, settings, cameras, size)
    end = time.perf_counter() + seconds
    for number in range(WARM_UP):
        # Both parities are recorded and their kernels loaded; the rest only settles the cache.
        if number >= 2 and time.perf_counter() > end - 0.7 * seconds:
            break
        flying.frame()
    singles: list[tuple[float, float]] = []
    while len(singles) < 3 or (len(singles) < frames and time.perf_counter() < end - 0.4 * seconds):
        singles.append(flying.frame())
    issued, done = np.array(singles).T * 1e3
    flying.wait()
    start, row = time.perf_counter(), 0
    while row < 1 or (row < len(singles) and time.perf_counter() < end):
        flying.issue()
        row += 1
    flying.wait()
    in_a_row = (time.perf_counter() - start) * 1e3 / row
    room = int((end - time.perf_counter()) * 1e3 / max(float(np.median(done)), 1e-3)) if np.isfinite(end) else TIMED
    sections, kernels = flying.timed_frames(max(1, min(TIMED, frames, room)))
    return FrameTimes(
        frame=float(np.median(done)), slowest=float(np.percentile(done, 95)), in_a_row=in_a_row,
        python=float(np.median(issued)), sections=sections, kernels=kernels, counts=session.counts(),
        frames=len(singles))


def medians(runs: Iterable[dict[str, float]]) -> dict[str, float]:
    """Return the median of each value over runs, those missing in a run as 0, in the order of first appearance."""
    runs = list(runs)
    names = dict.fromkeys(name for run in runs for name in run)
    return {name: float(np.median([run.get(name, 0.0) for run in runs])) for name in names}
