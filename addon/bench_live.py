# SPDX-License-Identifier: GPL-3.0-or-later
"""Burnish on the warm clock: pictures of a live session at time budgets, its frames while the camera moves.

One final render fills a session with the scene, as F12 reads it; all own engines are then measured in it. Times start
at a synchronized reset and end with the picture in an array of the processor, denoised where that is asked for.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine.errors import BurnishError
from ..engine.measure import (
    Shot,
    Stop,
    View,
    frame_curve,
    frames_within,
    progressive_shots,
    shoot,
)
from ..engine.measure_moving import measure_pan
from ..engine.presets import apply_preset
from ..engine.session import DENOISED
from ..engine.settings import Integrator, Preset, RenderSettings
from . import oidn
from .bench_engines import BenchScene, KeptSession, kept_sessions, save_picture
from .bench_plan import LONG, TOLERANCE, most_frames
from .bench_store import FRAMES, Job

__all__ = ["LiveScene"]

FINISHED_AT = 8
"""Frames after which finishing is timed: pictures of fewer are denoised in haste"""
WARM_UP_SECONDS = 3.0
"""Longest run before anything is timed: records launches, and path-traces where the picture rests soon enough"""
CURVE_SHARE = 1.1
"""The curve of frames reaches beyond the longest budget that it serves"""
MOVING_FRAMES = 48
MOVING_SECONDS = 4.0
TIMED_AT = 8
"""Frame at rest whose sections are measured"""


class LiveScene:
    """A session with the open scene in it."""

    def __init__(self, scene: BenchScene, repetitions: int, check: Callable[[], None],
                 stopped: Callable[[], bool]) -> None:
        self.scene, self.repetitions, self.check, self.stopped = scene, repetitions, check, stopped
        self._session: KeptSession | None = None
        self._settings: RenderSettings | None = None
        self._view: View | None = None
        self.facts: dict[str, dict[str, Any]] = {}

    @property
    def session(self) -> KeptSession:
        """Return the session, filled by a final render when it is first asked for; raises BurnishError."""
        if self._session is None:
            self.scene.configure(Job(engine="realtime", samples=1))
            with kept_sessions(keep=True) as opened:
                self.scene.shoot()
            if not opened or opened[-1].view is None:
                raise BurnishError("Burnish's final render opened no session")
            self._session = opened[-1]
            self._settings, self._view = self._session.settings, self._session.view
        return self._session

    def close(self) -> None:
        """Give the device's memory back."""
        if self._session is not None:
            self._session.keep = False
            self._session.close()
            self._session = None

    def _select(self, *engines: str) -> list[Callable[[], np.ndarray]]:
        """Set the session for engines that share their samples and return what ends each one's pictures."""
        session = self.session
        integrator = Integrator.REFERENCE if engines[0].startswith("reference") else Integrator.REALTIME
        sampling = dataclasses.replace(self._settings.sampling, integrator=integrator)
        self.settings = dataclasses.replace(self._settings, sampling=sampling)
        if "draft" in engines:
            self.settings = apply_preset(self.settings, Preset.DRAFT)
        denoised = any(engine.endswith("+oidn") for engine in engines)
        self.view = dataclasses.replace(self._view, passes=("Combined", *((DENOISED,) if denoised else ())))
        self.view.configure(session, self.settings)

        def read() -> np.ndarray:
            return session.read("Combined")[..., :3]

        def read_denoised() -> np.ndarray:
            return oidn.denoise(session)[..., :3]

        return [read_denoised if engine.endswith("+oidn") else read for engine in engines]

    def calibrate(self, engine: str, longest: float) -> dict[str, Any]:
        """Return and keep an engine's curve of frames by seconds, up to about `longest`, and its time to finish."""
        finish, = self._select(engine)
        session = self.session
        session.step(1)
        finish()
        denoiser = self.settings.denoiser
        at_rest = denoiser.rest_frames + 2 if denoiser.path_traced_rest and engine in FRAMES else 2
        frame_curve(session, min(WARM_UP_SECONDS, CURVE_SHARE * max(longest, 0.1)),
                    lambda: self.stopped() or session.samples_done >= max(at_rest, TIMED_AT))
        self.check()
        curve = frame_curve(session, CURVE_SHARE * min(longest, LONG), self.stopped)
        self.check()
        finishes = [shoot(session, FINISHED_AT, finish).finish for _ in range(max(1, self.repetitions))]
        self.check()
        facts = {"curve": curve, "finish": statistics.median(finishes), "device": session.device_name,
                 "per_frame": curve[-1][1] / curve[-1][0], "scene": self._scene_facts(),
                 "frame_times": self._sections() if engine in FRAMES else {}, "skipped": dict(session.skipped)}
        self.facts[engine] = facts
        return facts

    def _scene_facts(self) -> dict[str, Any]:
        """Return what getting the scene there took [s], and what it is."""
        stats = self.session.stats
        times = {name: float(value) for name, value in stats.times.items() if name not in ("sampling", "read")}
        return {"times": {"extraction": self.session.extraction, **times}, "triangles": stats.triangles,
                "instances": stats.instances, "lights": stats.lights, "structure": stats.structure,
                "device_bytes": stats.device_bytes}

    def _sections(self) -> dict[str, float]:
        """Return the milliseconds of each section of a frame at rest."""
        session = self.session
        session.reset()
        session.step(TIMED_AT - 1)
        session.timed = True
        session.step(1)
        session.timed = False
        return dict(session.frame_times)

    def render_short(self, engine: str, jobs: list[Job], facts: dict[str, Any], path_of: Callable[[Job], Path],
                     begin: Callable[[Job], None], done: Callable[[Job, dict[str, Any]], None]) -> None:
        """Render an engine's pictures at budgets up to LONG: each several times from nothing; the median time counts.

        Args:
            engine: Name of an own engine.
            jobs: Of that engine, with budgets.
            facts: From `calibrate`.
            path_of: Gives a job's OpenEXR file.
            begin: Called before each job; may raise.
            done: Called with each job and its record.
        """
        finish, = self._select(engine)
        for job in sorted(jobs, key=lambda job: job.budget):
            begin(job)
            shot, times = self._fill(job.budget, facts, finish)
            self.check()
            done(job, self._record(job, shot, times, facts, path_of(job)))

    def render_long(self, jobs: list[Job], facts: dict[str, dict[str, Any]], path_of: Callable[[Job], Path],
                    begin: Callable[[Job], None], done: Callable[[Job, dict[str, Any]], None]) -> None:
        """Render pictures at budgets above LONG as stops of one run; arguments as of `render_short`.

        All jobs must be of engines that share their samples: of one, or of the reference with and without denoiser.
        """
        engines = list(dict.fromkeys(job.engine for job in jobs))
        finishes = dict(zip(engines, self._select(*engines), strict=True))
        spent = {job: facts[job.engine]["finish"] for job in jobs}
        for last in (False, True):
            jobs = sorted(jobs, key=lambda job: job.budget - spent[job])
            stops = [Stop(job.budget, finishes[job.engine], spent[job]) for job in jobs]
            curve = [tuple(point) for point in facts[jobs[0].engine]["curve"]]
            shots = progressive_shots(self.session, stops, curve, self.stopped)
            late = []
            for job in jobs:
                if not last:
                    begin(job)
                shot = next(shots, None)
                self.check()
                if shot is not None and shot.seconds > TOLERANCE * job.budget and not last:
                    # Finishing took longer than it was thought to: once more, with what is known now.
                    spent[job] = shot.finish
                    late.append(job)
                    continue
                record = self._record(job, shot, [shot.seconds] if shot else [], facts[job.engine], path_of(job))
                done(job, {**record, "shared": ", ".join(engines)} if len(engines) > 1 else record)
            if not late:
                return
            jobs = late

    def _fill(self, budget: float, facts: dict[str, Any], finish: Callable[[], np.ndarray],
              ) -> tuple[Shot | None, list[float]]:
        """Return a picture of as many frames as fit, and all times; None if one frame is too long."""
        found: dict[int, tuple[Shot, list[float]]] = {}

        def measure(frames: int) -> tuple[float, float]:
            shots = [shoot(self.session, frames, finish, self.stopped) for _ in range(max(1, self.repetitions))]
            self.check()
            times = [shot.seconds for shot in shots]
            median = statistics.median(times)
            found[frames] = min(shots, key=lambda shot: abs(shot.seconds - median)), times
            return median, statistics.median(shot.finish for shot in shots)

        most = most_frames(measure, budget, frames_within(facts["curve"], budget - facts["finish"]))
        return found[most] if most else (None, found[1][1])

    def _record(self, job: Job, shot: Shot | None, times: list[float], facts: dict[str, Any],
                path: Path) -> dict[str, Any]:
        record = {"engine": job.engine, "clock": job.clock, "budget": job.budget, "seed": 0, "device": facts["device"],
                  "blender": bpy.app.version_string, "repetitions": times}
        if shot is None:
            first = statistics.median(times) if times else facts["curve"][0][1] + facts["finish"]
            frame = "frame" if job.engine in FRAMES else "sample"
            return {**record, "samples": 0, "seconds": None,
                    "no_picture": f"no picture: one {frame}, read back, takes {1e3 * first:.3g} ms"}
        save_picture(path, shot.picture)
        seconds = statistics.median(times)
        last = "read-back and denoising" if job.engine.endswith("+oidn") else "read-back"
        return {**record, "samples": shot.frames, "seconds": seconds, "wall": seconds,
                "parts": {"device frames": shot.seconds - shot.finish, last: shot.finish}}

    def render_moving(self, job: Job, path: Path) -> dict[str, Any]:
        """Render the frames of a pan that ends in the scene's view; return the last picture's record."""
        self._select("realtime")
        moving = measure_pan(self.session, self.settings, self.view, MOVING_FRAMES, MOVING_SECONDS, self.stopped)
        self.check()
        save_picture(path, moving.picture)
        return {"engine": job.engine, "clock": job.clock, "budget": 0.0, "samples": moving.frames, "seed": 0,
                "device": self.session.device_name, "blender": bpy.app.version_string,
                "seconds": (moving.frame + moving.read) / 1e3,
                "parts": {"device frames": moving.frame / 1e3, "read-back": moving.read / 1e3},
                "frame_times": moving.sections}
