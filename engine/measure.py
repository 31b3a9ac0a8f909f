# SPDX-License-Identifier: GPL-3.0-or-later
"""Wall times of a session's frames at rest, the device's work and the read-back of the picture included.

For a benchmark: how many frames fit into a time, and what a picture then looks like. Times start after a synchronized
reset with the scene resident; what ends a picture (read-back, a denoiser) is a function of the caller's and is timed
too. measure_moving.py times frames while the camera moves.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from .scene import CameraData
from .session import Session

__all__ = ["Curve", "Shot", "Stop", "View", "frame_curve", "frames_within", "never", "progressive_shots", "restart",
           "shoot", "wait"]

Curve = list[tuple[int, float]]
"""Numbers of frames, ascending, and the seconds that so many took"""

Finish = Callable[[], np.ndarray]
"""Reads the picture and does whatever else belongs to it"""

SINGLE_FRAMES = 8
"""Frames of a curve that are measured one by one; later ones in groups of an eighth of those before"""


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

    def configure(self, session: Session, settings: Any) -> None:
        """Set a session to this view."""
        session.configure(settings, self.camera, self.width, self.height, self.crop, self.passes)


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A picture and its times."""

    picture: np.ndarray
    frames: int
    seconds: float
    """Frames and finish"""
    finish: float
    """Reading back and what else belongs to the picture [s]"""


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
    # The memory that it lies in is free for the next one, which would have to wait for more of it else.
    return Shot(picture=picture.copy(), frames=session.samples_done, seconds=end - start, finish=end - stepped)


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
        yield Shot(picture=picture.copy(), frames=session.samples_done, seconds=elapsed + spent, finish=spent)
