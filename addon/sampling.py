# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of one final picture, in steps short enough that progress, partial pictures and cancelling come in time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import bpy

from ..engine.settings import Integrator, RenderSettings
from .progress import RenderProgress

__all__ = ["Sampling"]

STEP_SECONDS = 0.2
"""Aimed-at length of one Session.step; a step ends within 0.1 s of a cancellation anyway."""
STEP_SAMPLES_MAX = 64
FIRST_STEP = 4
"""Samples of the first step on a GPU: those of a step of one or two have their longest paths ended sooner, for more
noise (FEW_SAMPLES in engine/passes/wavefront.py)"""
TIMED_FRAME = 8
"""Real-time frame whose sections are measured: the first ones record their launches and have no history yet"""
RESULT_SECONDS = 0.5
"""Time between two partial pictures in the window."""


class Sampling:
    """Adds samples to the picture of a session; the clock starts when it is made."""

    def __init__(self, session: Any, settings: RenderSettings, progress: RenderProgress, *, timed: bool,
                 cancelled: Callable[[], bool], show: Callable[[], None]) -> None:
        """Make it for a picture that has no samples yet.

        Args:
            session: Configured for the picture.
            settings: How the picture is made, how many samples and how much time it may have.
            progress: Is told.
            timed: Whether a real-time frame is to be measured.
            cancelled: Whether the user wants no more.
            show: Shows the picture as it is.
        """
        self.session = session
        self.progress = progress
        self.cancelled = cancelled
        self.done = 0
        """Samples that the picture has"""
        self.total, self.limit = settings.sampling.samples, settings.sampling.time_limit
        self._show = show
        self._timed_at = timed_frame(settings) if timed else -1
        self._count = 1 if session.device == "cpu" or self.limit > 0.0 else FIRST_STEP
        self._start = self._shown = time.perf_counter()

    @property
    def elapsed(self) -> float:
        """Return the time since the start [s]."""
        return time.perf_counter() - self._start

    def late(self) -> bool:
        """Tell whether the picture has had its time; one sample it has in any case."""
        return 0.0 < self.limit <= self.elapsed and self.done > 0

    def add(self, goal: int, should_stop: Callable[[], bool]) -> None:
        """Add samples until the picture has `goal` of them, or `should_stop` says so."""
        while self.done < goal and not should_stop():
            step_start, before = time.perf_counter(), self.done
            self.session.timed = before == self._timed_at
            # The timed frame is a step of its own.
            end = goal if before > self._timed_at else self._timed_at + int(self.session.timed)
            self.done = self.session.step(min(self._count, end - before), should_stop)
            self.session.timed = False
            self._count = next_count(self._count, self.done - before, time.perf_counter() - step_start)
            self._tell()

    def _tell(self) -> None:
        elapsed, fraction = self.elapsed, self.done / self.total
        if self.limit > 0.0:
            fraction = max(fraction, min(elapsed / self.limit, 1.0))
        remaining = None if fraction <= 0.0 else elapsed * (1.0 / fraction - 1.0)
        self.progress.samples(self.done, self.total, elapsed, remaining, self.session.stats.device_bytes, fraction)
        now = time.perf_counter()
        if not bpy.app.background and self.done < self.total and now - self._shown >= RESULT_SECONDS:
            self._show()
            self._shown = now


def timed_frame(settings: RenderSettings) -> int:
    """Return how many real-time frames come before the one that is measured; -1 for none."""
    if settings.sampling.integrator != Integrator.REALTIME:
        return -1
    frames = settings.sampling.samples
    if settings.denoiser.path_traced_rest:
        frames = min(frames, max(settings.denoiser.rest_frames, 1))
    return min(frames, TIMED_FRAME) - 1


def next_count(count: int, added: int, seconds: float) -> int:
    """Return how many samples the next step takes, so that it lasts about STEP_SECONDS."""
    if added <= 0 or seconds <= 0.0:
        return count
    return max(1, min(STEP_SAMPLES_MAX, 2 * count, int(STEP_SECONDS * added / seconds)))
