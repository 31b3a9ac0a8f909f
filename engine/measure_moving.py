# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that move, and the times of a session's real-time frames seen through them.

Two motions: `fly`, for what a frame costs, and `pan`, which ends in a view whose picture is compared. Times of frames
that are waited for, of frames in a row and by section never mix: a frame that is waited for includes the way to the
device and back; frames in a row hide Python behind the device's work; sections are timed launch by launch, so that
their sum exceeds the frame by the gaps.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from .measure import View, never, restart, wait
from .passes.cache_spreading import SETTLED
from .scene import CameraData
from .session import Session
from .settings import RenderSettings

__all__ = ["FrameTimes", "MovingCamera", "Pan", "depths_seen", "fly", "fly_over", "measure_frames", "measure_pan",
           "pan", "settling_frames", "there_and_back"]

FLIGHT_TURN = math.radians(24.0)
"""Whole turn of a flight [rad], half of it to each side"""
FLIGHT_WAY = 0.15
"""Way of a flight by the median depth, if nothing near is in the way"""
PAN_STEP = math.radians(0.1)
"""Turn between two frames of a pan [rad]: slow, 6 degrees a second at 60 frames a second"""
WARM_UP = 8
"""Frames before anything is timed: kernels loaded, graphs captured, buffers made"""
TIMED = 5
"""Frames whose sections are timed"""


# Motions --------------------------------------------------------------------------------------------------------------


def fly(camera: CameraData, *, near: float, middle: float, count: int) -> list[CameraData]:
    """Return `count` cameras: a dolly forwards and to the right, and a pan to the left and back to the right.

    Args:
        camera: Where the flight begins.
        near: Depth of what is nearest [m].
        middle: Median depth [m].
        count: Frames.
    """
    axes = matrix_of(camera)[:3]
    way = min(FLIGHT_WAY * middle, 0.4 * near) * (0.5 * axes[:, 0] - axes[:, 2])
    return [turned(camera, 0.5 * FLIGHT_TURN * math.sin(2.0 * math.pi * share), share * way)
            for share in np.linspace(0.0, 1.0, count)]


def fly_over(camera: CameraData, positions: np.ndarray, count: int) -> list[CameraData]:
    """Return the cameras of `fly` with steps that are right for what is seen.

    Args:
        camera: Where the flight begins.
        positions: World position of the surface in each pixel [h, w, 3]; 0 without a surface.
        count: Frames.
    """
    near, middle = depths_seen(camera, positions, (2, 50))
    return fly(camera, near=near, middle=middle, count=count)


def depths_seen(camera: CameraData, positions: np.ndarray, percentiles: Sequence[float]) -> list[float]:
    """Return percentiles of the depths [m] of what a camera sees, 1 where it sees nothing; positions as of fly_over."""
    axes = matrix_of(camera)
    depth = -((positions[positions.any(-1)] - axes[:3, 3]) @ axes[:3, 2])
    return np.percentile(depth, percentiles).tolist() if depth.size else [1.0] * len(percentiles)


def pan(camera: CameraData, count: int) -> list[CameraData]:
    """Return `count` cameras of a slow pan to the right that ends in the camera given."""
    return [*(turned(camera, left * PAN_STEP) for left in range(count - 1, 0, -1)), camera]


def there_and_back(cameras: Sequence[CameraData]) -> Callable[[int], CameraData]:
    """Return a function that gives the camera of each frame of an endless way through cameras and back again."""
    last = max(len(cameras) - 1, 1)
    return lambda number: cameras[min(abs((number + last) % (2 * last) - last), len(cameras) - 1)]


def matrix_of(camera: CameraData) -> np.ndarray:
    """Return the camera's transform [4, 4]."""
    return np.array(camera.transform, float).reshape(4, 4)


def turned(camera: CameraData, angle: float, way: np.ndarray | float = 0.0) -> CameraData:
    """Return the camera turned to the left about its own upward axis [rad], and moved [m]."""
    matrix = matrix_of(camera)
    sine, cosine = math.sin(angle), math.cos(angle)
    matrix[:3, :3] = matrix[:3, :3] @ [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
    matrix[:3, 3] += way
    return dataclasses.replace(camera, transform=tuple(matrix.ravel().tolist()))


# Times ----------------------------------------------------------------------------------------------------------------


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


@dataclass(frozen=True, kw_only=True)
class Pan:
    """Frames of a pan."""

    picture: np.ndarray
    """The last frame, [h, w, 3]"""
    frames: int
    frame: float
    """Median of frames that are waited for one by one [ms]"""
    read: float
    """Median of the read-back that follows each [ms]"""
    sections: dict[str, float]
    """Of one frame [ms]"""


class MovingCamera:
    """A session whose camera moves on with every frame."""

    def __init__(self, session: Session, settings: RenderSettings, cameras: Sequence[CameraData],
                 size: tuple[int, int], crop: tuple[int, int, int, int] | None = None,
                 passes: tuple[str, ...] = ("Combined",)):
        """Take a session with its scene in it, the cameras to go through, there and back, and how to see [px]."""
        self.session, self.settings = session, settings
        self.number = 0
        """Of the next frame"""
        self._camera = there_and_back(cameras)
        self._frame = (*size, crop, passes)

    def issue(self) -> None:
        """Issue the next frame."""
        self.session.configure(self.settings, self._camera(self.number), *self._frame)
        self.session.step(1)
        self.number += 1

    def frame(self) -> tuple[float, float]:
        """Render the next frame; return the milliseconds until it was issued and until it was done."""
        start = time.perf_counter()
        self.issue()
        issued = time.perf_counter()
        wait(self.session)
        return (issued - start) * 1e3, (time.perf_counter() - start) * 1e3

    def in_a_row(self, count: int, end: float = math.inf) -> float:
        """Issue `count` frames, or those before a time but one at least; return their mean milliseconds."""
        wait(self.session)
        start, first = time.perf_counter(), self.number
        while self.number == first or (self.number - first < count and time.perf_counter() < end):
            self.issue()
        wait(self.session)
        return (time.perf_counter() - start) * 1e3 / (self.number - first)

    def timed_frames(self, count: int) -> tuple[dict[str, float], dict[str, float]]:
        """Render frames whose sections are timed; return the median milliseconds by section and by kernel."""
        sections, kernels = [], []
        self.session.timed = True
        try:
            for _ in range(count):
                self.issue()
                sections.append(self.session.frame_times)
                kernels.append(self.session.pipeline.kernel_times)
        finally:
            self.session.timed = False
        return medians(sections), medians(kernels)


def settling_frames(device: str) -> int:
    """Return the frames after which a moving frame costs what it does while one looks around.

    Both parities are recorded and their kernels loaded; on a GPU as many as light takes to spread.
    """
    return WARM_UP + (SETTLED if wp.get_device(device).is_cuda else 0)


def measure_frames(
    session: Session, settings: RenderSettings, cameras: Sequence[CameraData], size: tuple[int, int], *,
    frames: int = 40, seconds: float = math.inf,
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
    session.timed = False
    warm_up = settling_frames(session.device)
    moving = MovingCamera(session, settings, cameras, size)
    end = time.perf_counter() + seconds
    for number in range(warm_up):
        # Both parities are recorded and their kernels loaded; the rest only settles the cache.
        if number >= 2 and time.perf_counter() > end - 0.7 * seconds:
            break
        moving.frame()
    singles: list[tuple[float, float]] = []
    while len(singles) < 3 or (len(singles) < frames and time.perf_counter() < end - 0.4 * seconds):
        singles.append(moving.frame())
    issued, done = np.array(singles).T
    in_a_row = moving.in_a_row(len(singles), end)
    room = int((end - time.perf_counter()) * 1e3 / max(float(np.median(done)), 1e-3)) if np.isfinite(end) else TIMED
    sections, kernels = moving.timed_frames(max(1, min(TIMED, frames, room)))
    return FrameTimes(
        frame=float(np.median(done)), slowest=float(np.percentile(done, 95)), in_a_row=in_a_row,
        python=float(np.median(issued)), sections=sections, kernels=kernels, counts=session.counts(),
        frames=len(singles))


def measure_pan(
    session: Session, settings: RenderSettings, view: View, frames: int, seconds: float,
    should_stop: Callable[[], bool] = never,
) -> Pan:
    """Render a pan of `frames` frames (3 at least), fewer where they take longer than `seconds`, that ends in `view`.

    The last but one is measured section by section; the median is over the second half of the others.
    """
    start = restart(session)
    moving = MovingCamera(
        session, settings, pan(view.camera, frames), (view.width, view.height), view.crop, view.passes)
    times: list[tuple[float, float]] = []

    def take() -> None:
        done = moving.frame()[1]
        begin = time.perf_counter()
        session.read("Combined")
        times.append((done, (time.perf_counter() - begin) * 1e3))

    sections: dict[str, float] = {}
    while moving.number < frames - 2 and not should_stop():
        take()
        if time.perf_counter() - start > seconds:
            moving.number = frames - 2
    if not should_stop():
        sections, _ = moving.timed_frames(1)
        take()
    # The first frames record their launches and have no history.
    frame, read = np.median(times[len(times) // 2:] or [(0.0, 0.0)], axis=0)
    return Pan(picture=session.read("Combined")[..., :3], frames=len(times) + bool(sections), frame=float(frame),
               read=float(read), sections=sections)


def medians(runs: Iterable[dict[str, float]]) -> dict[str, float]:
    """Return the median of each value over runs, those missing in a run as 0, in the order of first appearance."""
    runs = list(runs)
    names = dict.fromkeys(name for run in runs for name in run)
    return {name: float(np.median([run.get(name, 0.0) for run in runs])) for name in names}
