# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene of the benchmark, from the .blend file to its rows: renders what is missing, compares it with the truth.

What one engine can't do becomes its rows' failure; what breaks the scene becomes the scene's.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine import image_error
from ..engine.errors import BurnishError
from ..engine.read import read_exr
from .bench_cold import render_cold
from .bench_engines import BenchScene, open_scene, save_picture, sentence
from .bench_live import LiveScene
from .bench_picture import save_comparison
from .bench_plan import LONG, LONG_DENOISED, Plan, make_plan
from .bench_progress import Interruption, Progress
from .bench_report import NoiseRow, SceneResult, format_row
from .bench_rivals import calibrate, render_shared, render_warm, shareable
from .bench_store import OWN, Job, SceneStore
from .cli_output import Console

__all__ = ["SceneBench", "halves_of"]

TRUTH_PART = 256
"""Samples of the truth rendered at a time: an interruption waits no longer"""

Done = Callable[[Job, dict[str, Any]], None]


def halves_of(reference: Path) -> list[Path]:
    """Return the files that a given truth is the mean of, `NAME_a.exr` and `NAME_b.exr` beside it, if both exist."""
    halves = [reference.with_name(f"{reference.stem}_{letter}{reference.suffix}") for letter in "ab"]
    return halves if all(path.is_file() for path in halves) else []


def by_engine(jobs: list[Job]) -> dict[str, list[Job]]:
    """Return jobs by their engines, in the order of first appearance."""
    groups: dict[str, list[Job]] = {}
    for job in jobs:
        groups.setdefault(job.engine, []).append(job)
    return groups


class SceneBench:
    """Measures one scene."""

    def __init__(self, arguments: argparse.Namespace, scene: Path, reference: Path | None, size: tuple[int, int],
                 device: str, console: Console, progress: Progress, interruption: Interruption) -> None:
        self.arguments, self.path, self.reference = arguments, scene, reference
        self.size, self.device, self.console = size, device, console
        self.progress, self.interruption = progress, interruption
        self.plan: Plan = make_plan(arguments)
        self.store = SceneStore(arguments.output, scene, size, device)
        self.failures: dict[Job, str] = {}
        text = f"'{reference.name}'" if reference else f"Cycles, {arguments.truth} samples"
        self.result = SceneResult(name=scene.stem, hash=self.store.hash, size=size, device=device, truth=text,
                                  folder=self.store.folder.name)
        self.missing = list(self.store.missing(self.plan.all))
        progress.expect([job.weight for job in self.missing])
        self._open: BenchScene | None = None
        self._live: LiveScene | None = None

    def measure(self) -> SceneResult:
        """Return the scene's result; what goes wrong is in it as a sentence.

        Raises:
            KeyboardInterrupt: The user asked for an end; `result` has what is complete.
        """
        try:
            self._check_reference()
            self.render_missing()
            self.add_rows()
        except KeyboardInterrupt:
            self._add_rest()
            raise
        except BurnishError as error:
            self._fail(error)
        except Exception as error:
            # An engine's or Blender's own: the other scenes are worth having.
            self._fail(BurnishError(f"{type(error).__name__}: {sentence(error)}"))
        finally:
            if self._live is not None:
                self._live.close()
        return self.result

    def _fail(self, error: BurnishError) -> None:
        self.result.failure = sentence(error)
        self.console.print(f"{self.path.stem}: failed: {self.result.failure}")

    def _add_rest(self) -> None:
        """Add what is complete after an interruption."""
        try:
            self.add_rows()
        except BurnishError as error:
            self.result.failure = f"Interrupted before anything could be compared: {sentence(error)}"

    def _check_reference(self) -> None:
        if self.reference is None:
            return
        given = read_exr(self.reference)
        if given.shape[:2] != self.size[::-1]:
            raise BurnishError(f"The reference '{self.reference}' has {given.shape[1]} x {given.shape[0]} pixels, "
                               f"not {self.size[0]} x {self.size[1]}; leave --size out or give the reference's")

    @property
    def scene(self) -> BenchScene:
        """Return the scene, opened when it is first needed; raises BurnishError."""
        if self._open is None:
            self._open = open_scene(self.path, self.size, self.device)
        return self._open

    @property
    def live(self) -> LiveScene:
        """Return Burnish's live session."""
        if self._live is None:
            self._live = LiveScene(self.scene, self.arguments.repetitions, self.interruption.check,
                                   self.interruption.stopped)
        return self._live

    # -- rendering ----------------------------------------------------------------------------------------------

    def begin(self, job: Job) -> None:
        """Tell what comes next; raises KeyboardInterrupt where the user wants no more."""
        self.interruption.check()
        self.progress.begin(f"{self.path.stem}: {job.label}")

    def done(self, job: Job, record: dict[str, Any]) -> None:
        """Keep a job's record, or its failure."""
        self.progress.end(job.weight)
        if record.get("failure"):
            self.failures[job] = record["failure"]
        else:
            self.store.save(job, record)

    def pictures_of(self, job: Job) -> Path:
        """Return a job's OpenEXR file."""
        return self.store.path(job, ".exr")

    def render_missing(self) -> None:
        """Render all pictures that are not there yet; an engine's failure is kept for its rows, a truth's is raised."""
        missing = set(self.missing)
        for job in (job for job in self.plan.truth if job in missing):
            try:
                self._render_truth(job)
            except BurnishError as error:
                raise BurnishError(f"The truth could not be rendered: {sentence(error)}") from error
        for job in (job for job in [*self.plan.fixed, *self.plan.noise] if job in missing):
            self._guarded([job], lambda job=job: self._render_fixed(job))
        warm = [job for job in self.plan.warm if job in missing]
        self._own_warm([job for job in warm if job.engine in OWN])
        self._rivals_warm([job for job in warm if job.engine not in OWN])
        for jobs, render in ((self.plan.moving, self._render_moving), (self.plan.cold, self._render_cold)):
            for engine, wanted in by_engine([job for job in jobs if job in missing]).items():
                self._guarded(wanted, lambda e=engine, w=wanted, r=render: r(e, w))

    def _own_warm(self, jobs: list[Job]) -> None:
        """Render Burnish's pictures of the warm clock."""
        short = [job for job in jobs if job.budget <= (LONG_DENOISED if job.engine.endswith("+oidn") else LONG)]
        for engine, wanted in by_engine(short).items():
            self._guarded(wanted, lambda e=engine, w=wanted: self.live.render_short(
                e, w, self.facts(e), self.pictures_of, self.begin, self.done))
        for engines in (("realtime",), ("realtime+oidn",), ("draft",), ("reference", "reference+oidn")):
            long = [job for job in jobs if job not in short and job.engine in engines]
            if long:
                self._guarded(long, lambda w=long: self.live.render_long(
                    w, {engine: self.facts(engine) for engine in by_engine(w)}, self.pictures_of, self.begin,
                    self.done))

    def _rivals_warm(self, jobs: list[Job]) -> None:
        """Render the rivals' pictures of the warm clock; Cycles' long ones serve with and without the denoiser."""
        denoised = {job.budget: job for job in jobs if job.engine == "cycles+oidn"}
        pairs = [(job, denoised[job.budget]) for job in jobs if job.engine == "cycles" and job.budget in denoised]
        if pairs:
            self._guarded([job for pair in pairs for job in pair], lambda: self._render_pairs(pairs))
        left = [job for job in jobs if self.store.record(job) is None and job not in self.failures]
        for engine, wanted in by_engine(left).items():
            self._guarded(wanted, lambda e=engine, w=wanted: render_warm(
                self.scene, w, self.facts(e), self.pictures_of, self.begin, self.done))

    def _render_pairs(self, pairs: list[tuple[Job, Job]]) -> None:
        """Render what Cycles with and without denoising may share."""
        try:
            facts = {engine: self.facts(engine) for engine in ("cycles", "cycles+oidn")}
        except BurnishError:
            return  # Each engine by itself will say what it can't.
        shared = [pair for pair in pairs if shareable(pair[0], facts["cycles+oidn"])]
        render_shared(self.scene, shared, facts, self.pictures_of, self.begin, self.done)

    def _guarded(self, jobs: list[Job], render: Callable[[], None]) -> None:
        """Render jobs of one engine; what goes wrong is the failure of those that are not done."""
        try:
            render()
        except Exception as error:
            for job in jobs:
                if self.store.record(job) is None and job not in self.failures:
                    self.failures[job] = sentence(error)
                    self.progress.end(job.weight)

    def _render_truth(self, job: Job) -> None:
        """Render a half of the truth in parts, so that an interruption need not wait for all of it."""
        self.begin(job)
        path, total, mean, seconds = self.pictures_of(job), job.samples, None, 0.0
        self.scene.persistent = True
        try:
            for offset in range(0, total, TRUTH_PART):
                self.interruption.check()
                part = Job(engine="truth", samples=min(TRUTH_PART, total - offset), seed=job.seed)
                picture, spent = self.scene.shoot_part(part, offset, total, path.with_name(f".{path.stem}.part.exr"))
                picture = picture.astype(np.float64) * (part.samples / total)
                mean, seconds = picture if mean is None else mean + picture, seconds + spent
        finally:
            self.scene.persistent = False
            path.with_name(f".{path.stem}.part.exr").unlink(missing_ok=True)
        save_picture(path, mean.astype(np.float32))
        self.done(job, {"engine": job.engine, "samples": total, "seed": job.seed, "seconds": seconds,
                        "device": self.device, "blender": bpy.app.version_string})

    def _render_fixed(self, job: Job) -> None:
        self.begin(job)
        self.done(job, self.scene.render(job, self.pictures_of(job)))

    def facts(self, engine: str) -> dict[str, Any]:
        """Return an engine's time per sample or curve of frames, measured if that has not been done yet."""
        found = self.store.facts(engine)
        if found is not None:
            return found
        self.interruption.check()
        self.console.progress(f"{self.path.stem}: timing {engine}")
        if engine in OWN:
            longest = max([*self.arguments.budgets, *self.arguments.cold_budgets], default=1.0)
            found = self.live.calibrate(engine, longest)
        else:
            base = self.facts(engine.partition("+")[0]) if "+" in engine else None
            found = calibrate(self.scene, engine, self.arguments.repetitions, base, self.interruption.check,
                              self.arguments.output)
        self.store.save_facts(engine, found)
        return found

    def _render_moving(self, engine: str, jobs: list[Job]) -> None:
        self.facts(engine)
        for job in jobs:
            self.begin(job)
            self.done(job, self.live.render_moving(job, self.pictures_of(job)))

    def _render_cold(self, engine: str, jobs: list[Job]) -> None:
        facts = self.facts(engine)
        if self._live is not None:
            # The second copy of the scene has a device for itself.
            self._live.close()
        render_cold(self.scene, jobs, facts, self.pictures_of, self.begin, self.done)

    # -- comparing ----------------------------------------------------------------------------------------------

    def add_rows(self) -> None:
        """Compare all pictures that are there with the truth, save those side by side and print the rows."""
        result, truth = self.result, self._truth()
        save_picture(self.store.folder / "truth.exr", truth)
        result.truth_file = f"{self.store.folder.name}/truth.exr"
        result.exposure = self._exposure()
        identity = hashlib.sha256(truth.tobytes()).hexdigest()[:12]
        for engine in dict.fromkeys(job.engine for job in self.plan.rows):
            facts = self.store.facts(engine)
            if facts is not None:
                result.engines[engine] = facts
        jobs = [job for job in self.plan.rows if job in self.failures or self.store.record(job) is not None]
        for job in jobs:
            result.rows.append(self.row(job, truth, identity))
            self.console.print(f"{self.path.stem}: {format_row(result.rows[-1])}")
        result.interrupted = len(jobs) < len(self.plan.rows)
        if self.plan.noise:
            self.add_noise(truth)

    def _exposure(self) -> float:
        """Return the exposure of the scene's view [stops], kept for runs that need not open the scene."""
        if self._open is not None:
            self.store.save_facts("view", {"exposure": self._open.exposure})
        return float((self.store.facts("view") or {"exposure": 0.0})["exposure"])

    def _truth(self) -> np.ndarray:
        """Return the truth; note its noise where halves tell it."""
        if self.reference is not None:
            files = halves_of(self.reference)
        else:
            files = [self.pictures_of(job) for job in self.plan.truth]
            if not all(path.is_file() for path in files):
                raise BurnishError("the truth is not complete")
        halves = [read_exr(path) for path in files]
        truth = read_exr(self.reference) if self.reference is not None else 0.5 * (halves[0] + halves[1])
        if halves:
            # The mean of two halves has half the variance of either.
            self.result.truth_noise = image_error.noise_rmse(*halves) / np.sqrt(2.0)
            errors = image_error.compare(*halves).as_dict()
            self.result.truth_errors = errors
            self.console.print(f"{self.path.stem}: "
                               f"{format_row({'label': 'Truth, its halves against each other', 'errors': errors})}")
        return truth

    def row(self, job: Job, truth: np.ndarray, identity: str) -> dict[str, Any]:
        """Return a table row and save its picture; errors against the same truth are kept in the record."""
        row: dict[str, Any] = {"label": job.label, "engine": job.engine, "clock": job.clock, "budget": job.budget}
        if job in self.failures:
            return {**row, "failure": self.failures[job]}
        record = self.store.record(job)
        if record.get("no_picture"):
            return {**row, **record}
        picture = None
        if record.get("truth") != identity:
            picture = read_exr(self.pictures_of(job))
            record |= {"truth": identity, "errors": image_error.compare(truth, picture).as_dict()}
            self.store.save(job, record)
        target = self.store.path(job, ".png")
        if self.arguments.strips and not target.is_file():
            picture = read_exr(self.pictures_of(job)) if picture is None else picture
            labels = ("truth: " + self.result.truth, f"{job.label}, {record['seconds']:.3g} s")
            save_comparison(target, truth, picture, labels, self.result.exposure)
        return {**row, **record, "file": f"{self.store.folder.name}/{self.pictures_of(job).name}"}

    def add_noise(self, truth: np.ndarray) -> None:
        """Measure the noise at N, 4N and 16N samples and what error remains without it."""
        result, jobs = self.result, self.plan.noise
        for first, second in zip(jobs[::2], jobs[1::2], strict=True):
            if any(self.store.record(job) is None for job in (first, second)):
                self.console.print(f"{self.path.stem}: no noise figure: {self.failures.get(first, 'not rendered')}")
                continue
            pair = [read_exr(self.pictures_of(job)) for job in (first, second)]
            noise = image_error.noise_rmse(*pair)
            left = None
            if result.truth_noise is not None:
                # noise_rmse halves the variance of a difference; against the truth the whole of it counts.
                squared = 2.0 * image_error.noise_rmse(0.5 * (pair[0] + pair[1]), truth) ** 2
                left = float(np.sqrt(max(0.0, squared - 0.5 * noise ** 2 - result.truth_noise ** 2)))
            result.noise.append(NoiseRow(samples=first.samples, noise=noise, left=left))
            before = result.noise[-2].noise / noise if len(result.noise) > 1 and noise > 0.0 else None
            fall = f", falls by {before:.2f} (2 expected)" if before else ""
            rest = f"; not explained by noise: {left:.5f}" if left is not None else ""
            self.console.print(f"{self.path.stem}: noise at {first.samples} spp: {noise:.5f} RMSE{fall}{rest}")
