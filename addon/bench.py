# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `burnish bench`: error and time of Burnish and its peers on .blend files, against a Cycles truth.

Owns the options and the order of events; rendering is in bench_engines.py, files in bench_store.py, tables in
bench_report.py. Options are parsed without bpy.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..engine import image_error
from ..engine.errors import BurnishError
from .bench_report import NoiseRow, SceneResult, format_row, save
from .bench_store import ENGINES, INTEGRATORS, OWN, Job, SceneStore
from .cli_output import Console, diverted_output
from .progress import format_duration

__all__ = ["add_arguments", "plan_jobs", "run"]

PEERS = tuple(name for name in ENGINES if name != "truth" and name not in OWN)
SAMPLES = {"reference": (64,), "realtime": (1, 8, 64, 256)}
"""Sample counts of each integrator, or frames, unless others are asked for; the peers take the reference's"""
TRUTH_SEEDS = (101, 202)
NOISE_SEEDS = (11, 22)
DEFAULT_SIZE = (640, 360)


def comma_list(kind: Callable[[str], Any], what: str, low: float = 0.0) -> Callable[[str], list[Any]]:
    """Return a converter of comma-separated values above `low`."""

    def convert(text: str) -> list[Any]:
        try:
            values = [kind(part) for part in text.split(",") if part.strip()]
        except ValueError:
            values = []
        if not values or min(values) <= low:
            raise argparse.ArgumentTypeError(f"{what} must be positive numbers with commas between them, not '{text}'")
        return values

    return convert


def peer_list(text: str) -> list[str]:
    """Convert comma-separated names of peers; an empty text means none."""
    names = [part.strip() for part in text.split(",") if part.strip()]
    for name in names:
        if name not in PEERS:
            raise argparse.ArgumentTypeError(f"there is no peer '{name}'; the peers are {', '.join(PEERS)}")
    return names


def positive(text: str) -> int:
    """Convert a positive whole number."""
    return comma_list(int, "it")(text)[0]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE.blend", help="files to render")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto", help="device of all engines")
    parser.add_argument("--size", nargs=2, type=positive, metavar=("W", "H"),
                        help=f"size in pixels; default: the reference's, else {DEFAULT_SIZE[0]} {DEFAULT_SIZE[1]}")
    parser.add_argument("--integrator", choices=list(INTEGRATORS), default="reference",
                        help="Burnish's integrator; default: reference")
    parser.add_argument("--samples", type=comma_list(int, "--samples"), metavar="N,...",
                        help="samples per pixel of Burnish and its peers, or Burnish's realtime frames; default: 64 "
                             "samples, frames 1,8,64,256")
    parser.add_argument("--budgets", type=comma_list(float, "--budgets"), default=[], metavar="SECONDS,...",
                        help="also render Burnish and Cycles for these times of sampling")
    parser.add_argument("--peers", type=peer_list, default=["cycles", "cycles+oidn"], metavar="NAME,...",
                        help=f"of {', '.join(PEERS)}; '' for none; default: cycles,cycles+oidn")
    parser.add_argument("--truth", type=positive, default=1024, metavar="N",
                        help="samples per pixel of the truth, rendered in two independent halves; default: 1024")
    parser.add_argument("--reference", type=Path, action="append", default=[], metavar="FILE.exr",
                        help="take this picture as truth; once for each scene, in their order")
    parser.add_argument("--noise", action="store_true",
                        help="also render Burnish at N, 4N and 16N samples with two seeds and show how noise falls")
    parser.add_argument("--output", "-o", type=Path, default=Path("out/bench"), metavar="DIR",
                        help="folder of pictures and results, and of what an interrupted run goes on from; "
                             "default: out/bench")
    parser.add_argument("--show-all", action="store_true", help="show all that Blender and its engines print")


def plan_jobs(arguments: argparse.Namespace) -> tuple[list[Job], list[Job], list[Job]]:
    """Return the jobs of one scene: the truth's halves, the rows of the table, the pictures for --noise."""
    half = max(1, arguments.truth // 2)
    truth = [] if arguments.reference else [Job(engine="truth", samples=half, seed=seed) for seed in TRUTH_SEEDS]
    own = INTEGRATORS[arguments.integrator]
    counts = {engine: arguments.samples or SAMPLES["reference"] for engine in arguments.peers}
    counts = {own: arguments.samples or SAMPLES[arguments.integrator]} | counts
    engines = list(counts)
    rows = [Job(engine=engine, samples=samples) for engine in engines for samples in counts[engine]]
    # EEVEE has no time limit.
    rows += [Job(engine=engine, samples=0, budget=budget) for engine in engines if engine != "eevee"
             for budget in arguments.budgets]
    first = counts[own][0]
    noise = [Job(engine=own, samples=first * factor, seed=seed) for factor in (1, 4, 16)
             for seed in NOISE_SEEDS] if arguments.noise else []
    return truth, rows, noise


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark and return the exit status: 1 if a scene could not be measured at all."""
    if arguments.reference and len(arguments.reference) != len(arguments.scenes):
        raise BurnishError(f"There are {len(arguments.scenes)} scenes but {len(arguments.reference)} references; "
                           "give --reference once for each scene")
    for path in [*arguments.scenes, *arguments.reference]:
        if not path.is_file():
            raise BurnishError(f"The file '{path}' does not exist")
    one = np.zeros((8, 8, 3), np.float32)
    image_error.flip(one, one)  # Missing, it should be missed before hours of rendering.
    with diverted_output(show_all=arguments.show_all) as console:
        if getattr(arguments, "in_blender", False):
            return measure_all(arguments, console)
        from . import register, unregister

        register()
        try:
            return measure_all(arguments, console)
        finally:
            # Blender may hang or crash at exit while a Python RenderEngine that has rendered is registered.
            unregister()


def measure_all(arguments: argparse.Namespace, console: Console) -> int:
    """Measure every scene, writing the results after each."""
    from ..engine.device import choose_device, device_info

    device = choose_device(arguments.device)
    machine = {"Device": f"{device_info(device).name} ({device})", "System": platform.platform(),
               "Python": platform.python_version()}
    results: list[SceneResult] = []
    for index, scene in enumerate(arguments.scenes):
        reference = arguments.reference[index] if arguments.reference else None
        results.append(SceneBench(arguments, scene, reference, device, console).measure())
        save(arguments.output, results, machine)
    console.print(f"Results: {arguments.output / 'results.md'}")
    return int(any(result.failure for result in results))


class SceneBench:
    """One scene: renders what is missing, compares it with the truth, saves the pictures."""

    def __init__(self, arguments: argparse.Namespace, scene: Path, reference: Path | None, device: str,
                 console: Console) -> None:
        self.arguments, self.path, self.reference, self.console = arguments, scene, reference, console
        self.device = device
        self.truth_jobs, self.row_jobs, self.noise_jobs = plan_jobs(arguments)
        self.failures: dict[Job, str] = {}

    def measure(self) -> SceneResult:
        """Return the scene's result; what goes wrong is in it as a sentence."""
        from .bench_engines import open_scene, read_exr, sentence

        self.read = read_exr
        size = tuple(self.arguments.size or DEFAULT_SIZE)
        text = f"'{self.reference.name}'" if self.reference else f"Cycles, {self.arguments.truth} samples"
        result = SceneResult(name=self.path.stem, hash="", size=size, device=self.device, truth=text)
        try:
            given = read_exr(self.reference) if self.reference else None
            if given is not None and not self.arguments.size:
                result.size = size = (given.shape[1], given.shape[0])
            if given is not None and given.shape[:2] != size[::-1]:
                raise BurnishError(f"The reference '{self.reference}' has {given.shape[1]} x {given.shape[0]} pixels, "
                                   f"not {size[0]} x {size[1]}; leave --size out or give the reference's")
            self.store = SceneStore(self.arguments.output, self.path, size, self.device)
            result.hash = self.store.hash
            self.scene = open_scene(self.path, size, self.device)
            self.render_missing()
            self.add_rows(result, given)
        except BurnishError as error:
            result.failure = sentence(error)
            self.console.print(f"{self.path.stem}: failed: {result.failure}")
        return result

    def render_missing(self) -> None:
        """Render all pictures that are not there yet; an engine's failure is kept for its row, a truth's is raised."""
        from .bench_engines import sentence

        jobs = list(self.store.missing([*self.truth_jobs, *self.row_jobs, *self.noise_jobs]))
        total, done, start = sum(job.weight for job in jobs), 0.0, time.perf_counter()
        for index, job in enumerate(jobs):
            elapsed = time.perf_counter() - start
            left = f", about {format_duration(elapsed * (total / done - 1.0))} left" if done > 0.0 else ""
            self.console.print(f"{self.path.stem} [{index + 1}/{len(jobs)}] {job.label}{left}")
            try:
                record = self.scene.render(job, self.store.path(job, ".exr"))
                self.store.save(job, record)
            except Exception as error:
                if job.engine == "truth":
                    raise BurnishError(f"The truth could not be rendered: {sentence(error)}") from error
                self.failures[job] = sentence(error)
            done += job.weight

    def add_rows(self, result: SceneResult, given: np.ndarray | None) -> None:
        """Compare all pictures with the truth, save the side-by-side pictures and print the rows."""
        truth = given
        if truth is None:
            halves = [self.read(self.store.path(job, ".exr")) for job in self.truth_jobs]
            truth = 0.5 * (halves[0] + halves[1])
            # The mean of two halves has half the variance of either.
            result.truth_noise = image_error.noise_rmse(*halves) / np.sqrt(2.0)
            result.rows.append({"label": "Truth's halves against each other",
                                "errors": image_error.compare(*halves).as_dict()})
        for job in self.row_jobs:
            result.rows.append(self.row(job, truth, "truth: " + result.truth))
        for row in result.rows:
            self.console.print(f"{self.path.stem}: {format_row(row)}")
        if self.noise_jobs:
            self.add_noise(result, truth)

    def row(self, job: Job, truth: np.ndarray, truth_label: str) -> dict[str, Any]:
        """Return a table row and save its picture."""
        from .bench_picture import save_comparison

        row: dict[str, Any] = {"label": job.label, "engine": job.engine}
        if job in self.failures:
            return {**row, "failure": self.failures[job]}
        record = self.store.record(job)
        picture = self.read(self.store.path(job, ".exr"))
        labels = (truth_label, f"{job.label}, {record['seconds']:.2f} s")
        save_comparison(self.store.path(job, ".png"), truth, picture, labels, self.scene.exposure)
        return {**row, **record, "errors": image_error.compare(truth, picture).as_dict()}

    def add_noise(self, result: SceneResult, truth: np.ndarray) -> None:
        """Measure the noise at N, 4N and 16N samples and what error remains without it."""
        for first, second in zip(self.noise_jobs[::2], self.noise_jobs[1::2], strict=True):
            if first in self.failures or second in self.failures:
                self.console.print(f"{self.path.stem}: no noise figure: {self.failures.get(first, '')}")
                continue
            pair = [self.read(self.store.path(job, ".exr")) for job in (first, second)]
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
