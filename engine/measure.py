# SPDX-License-Identifier: GPL-3.0-or-later
"""Wall times of a session's frames, the device's work and the read-back of the picture included.

For a benchmark: how many frames fit into a time, what a picture then looks like, what a frame costs while the camera
moves. Times start after a synchronized reset with the scene resident; what ends a picture (read-back, a denoiser) is a
function of the caller's and is timed too.
"""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from .scene import CameraData
from .session import Session

__all__ = ["Curve", "MovingFrames", "Shot", "Stop", "View", "frame_curve", "frames_within", "moving_frames",
           "progressive_shots", "shoot"]

Curve = list[tuple[int, float]]
"""Numbers of frames, ascending, and the seconds that so many took"""

Finish = Callable[[], np.ndarray]
"""Reads the picture and does whatever else belongs to it"""

SINGLE_FRAMES = 8
"""Frames of a curve that are measured one by one; later ones in groups of an eighth of those before"""
PAN_STEP = math.radians(0.1)
"""Turn of the camera between two moving frames [rad]: a slow pan of 6 degrees a second at 60 frames a second"""


def never() -> bool:
    """Return False."""
    return False


@dataclass(frozen=True)
class View:
    """What Session.configure takes besides settings."""

    camera: CameraData
    width: int
    height: int
    crop: tuple[int, int, int, int] | None
    passes: tuple[str, ...]

    def configure(self, session: Session, settings: Any, camera: CameraData | None = None) -> None:
        """Set a session to this view, through another camera where one is given."""
        session.configure(settings, camera or self.camera, self.width, self.height, self.crop, self.passes)


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A picture and its times."""

    picture: np.ndarray
    frames: int
    seconds: float
    """Frames and finish"""
    finish: float
    """Reading back and what else belongs to the picture [s]"""


@dataclass(frozen=True, kw_only=True)
class MovingFrames:
    """Frames of a pan that ends in the view it was asked for."""

    picture: np.ndarray
    frames: int
    frame_seconds: float
    """Median from the camera's change to the device's end"""
    read_seconds: float
    """Median of the read-back that follows"""
    sections: dict[str, float]
    """Milliseconds of each section of one moving frame"""


def wait(session: Session) -> None:
    """Wait for the session's device."""
    wp.synchronize_device(session.device)


def restart(session: Session) -> float:
    """Forget all frames and return the time at which the device is ready for the first."""
    session.reset()
    wait(session)
    return time.perf_counter()


def frame_curve(session: Session, seconds: float, should_stop: Callable[[], bool] = never) -> Curve:
    """Return how long so many frames take, up to about `seconds` and at least one frame; without finishing them."""
    start, curve = restart(session), []
    while (not curve or curve[-1][1] < seconds) and not should_stop():
        done = curve[-1][0] if curve else 0
        session.step(1 if done < SINGLE_FRAMES else max(1, done // 8), should_stop)
        wait(session)
        curve.append((session.samples_done, time.perf_counter() - start))
    return curve


def frames_within(curve: Curve, seconds: float) -> int:
    """Return how many frames end within `seconds`, by interpolation and, past the curve's end, its last slope."""
    if not curve or seconds <= 0.0:
        return 0
    counts, times = (np.array(values, float) for values in zip(*curve, strict=True))
    counts, times = np.append(0.0, counts), np.append(0.0, times)
    if seconds > times[-1]:
        first = max(1, len(times) // 2)
        run = max(times[-1] - times[first - 1], 1e-9)
        return int(counts[-1] + (seconds - times[-1]) * (counts[-1] - counts[first - 1]) / run + 1e-9)
    return int(np.interp(seconds, times, counts) + 1e-9)


def shoot(session: Session, frames: int, finish: Finish, should_stop: Callable[[], bool] = never) -> Shot:
    """Render so many frames from nothing and finish the picture."""
    start = restart(session)
    session.step(frames, should_stop)
    wait(session)
    stepped = time.perf_counter()
    picture = finish()
    end = time.perf_counter()
    return Shot(picture=picture, frames=session.samples_done, seconds=end - start, finish=end - stepped)


@dataclass(frozen=True)
class Stop:
    """Where a run is stopped for a picture."""

    budget: float
    """Time that frames and finish may take [s]"""
    finish: Finish
    finish_seconds: float
    """Least time that finishing is taken to need: some of it is spared after the first time"""


def progressive_shots(
    session: Session, stops: Sequence[Stop], curve: Curve, should_stop: Callable[[], bool] = never,
) -> Iterator[Shot | None]:
    """Yield the picture of each stop out of one run; what the pictures before took is left out of the times.

    Args:
        session: Configured; starts from nothing.
        stops: In ascending order of the time that is left for frames; for one without time for a single frame, None is
            yielded.
        curve: Frames by seconds, as frame_curve gives it: the speed to begin with.
        should_stop: Polled often; the run ends without the pictures that are left.
    """
    elapsed, rate = 0.0, curve[-1][1] / curve[-1][0]
    restart(session)
    for stop in stops:
        while not should_stop():
            start, done = time.perf_counter(), session.samples_done
            left = stop.budget - stop.finish_seconds - elapsed
            fits = frames_within(curve, left) if not done else int(left / rate)
            if fits < 1:
                break
            # Half of what is left at a time: the last steps know the speed of the newest frames.
            session.step(max(1, fits // 2), should_stop)
            wait(session)
            spent = time.perf_counter() - start
            elapsed, rate = elapsed + spent, spent / max(1, session.samples_done - done)
        if should_stop():
            return
        if not session.samples_done:
            yield None
            continue
        start = time.perf_counter()
        picture = stop.finish()
        spent = max(time.perf_counter() - start, stop.finish_seconds)
        yield Shot(picture=picture, frames=session.samples_done, seconds=elapsed + spent, finish=spent)


def turned(camera: CameraData, angle: float) -> CameraData:
    """Return the camera turned about its own upward axis by an angle [rad]."""
    matrix = np.array(camera.transform, float).reshape(4, 4)
    sine, cosine = math.sin(angle), math.cos(angle)
    turn = np.array([[cosine, 0, sine, 0], [0, 1, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1]], float)
    return dataclasses.replace(camera, transform=tuple((matrix @ turn).ravel().tolist()))


def moving_frames(
    session: Session, settings: Any, view: View, frames: int, seconds: float,
    should_stop: Callable[[], bool] = never,
) -> MovingFrames:
    """Render a pan of `frames` frames, fewer where they took longer than `seconds`, that ends in `view`.

    One more frame, measured section by section, comes before the last.
    """
    start = restart(session)
    frame_times, read_times = [], []
    count, index = frames, 0
    sections: dict[str, float] = {}
    while index < count and not should_stop():
        if time.perf_counter() - start > seconds:
            count = min(count, max(index + 2, 3))
        left = count - 1 - index
        begin = time.perf_counter()
        view.configure(session, settings, turned(view.camera, left * PAN_STEP) if left else None)
        session.timed = left == 1
        session.step(1)
        wait(session)
        end = time.perf_counter()
        session.read("Combined")
        if session.timed:
            sections = dict(session.frame_times)
        else:
            frame_times.append(end - begin)
            read_times.append(time.perf_counter() - end)
        session.timed = False
        index += 1
    picture = session.read("Combined")[..., :3]
    half = len(frame_times) // 2
    # The first frames record their launches and have no history.
    return MovingFrames(picture=picture, frames=index, frame_seconds=statistics.median(frame_times[half:] or [0.0]),
                        read_seconds=statistics.median(read_times[half:] or [0.0]), sections=sections)
