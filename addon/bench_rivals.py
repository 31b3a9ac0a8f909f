# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles and EEVEE on the warm clock: their time per sample with the scene resident, and their pictures at budgets.

Nobody can time a live Cycles from outside, so its time is taken from the slope between sample counts of a scene that
stays on the device (Persistent Data), where everything but sampling is the same and cancels out. That leaves out
its synchronization, its read-back and Blender's: the rivals' warm times are lower bounds. Denoising is the difference
that it makes to renders of one sample between which nothing is set: whatever is set, Cycles takes the whole scene in
again, which lasts much longer.
"""

from __future__ import annotations

import functools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine.errors import BurnishError
from ..engine.read import read_exr
from .bench_engines import BenchScene, save_picture, sentence
from .bench_plan import LONG, RIVAL_SEED, samples_within
from .bench_slope import measure_slope
from .bench_store import Job

__all__ = ["calibrate", "check_eevee", "render_shared", "render_warm", "shareable"]

SHARED_EXCESS = 0.03
"""Share of a budget by which denoising may exceed it where a render is shared"""
RESIDENT_RENDERS = 12
"""Renders of which the shortest tells what one takes with nothing to take in"""
RESIDENT_SECONDS = 4.0
"""Time for them after which no more are made"""
PROBE_SECONDS = 240.0
PROBE = """
import bpy
render = bpy.context.scene.render
render.engine, render.resolution_x, render.resolution_y, render.filepath = 'BLENDER_EEVEE', 8, 8, {path!r}
bpy.ops.render.render(write_still=True)
import gpu
print("RENDERER", gpu.platform.renderer_get(), flush=True)
"""

Done = Callable[[Job, dict[str, Any]], None]


def check_eevee(folder: Path) -> str:
    """Return the name of what EEVEE rasterizes with; asked for once.

    Raises:
        BurnishError: It makes no picture here.
    """
    renderer, reason = probe_eevee(folder)
    if renderer is None:
        raise BurnishError(reason)
    return renderer


@functools.cache
def probe_eevee(folder: Path) -> tuple[str | None, str]:
    """Return what EEVEE runs on, or None and why, found in a process of its own: without a context it may crash."""
    picture = folder / ".eevee_probe.png"
    folder.mkdir(parents=True, exist_ok=True)
    script = PROBE.format(path=str(picture.resolve()))
    program = bpy.app.binary_path
    start = [program, "--background", "--factory-startup", "--python-expr"] if program else [sys.executable, "-c"]
    try:
        result = subprocess.run([*start, script], capture_output=True, text=True, errors="replace",
                                timeout=PROBE_SECONDS, stdin=subprocess.DEVNULL)
        made = picture.is_file()
    except subprocess.TimeoutExpired:
        return None, (f"EEVEE makes no picture of 8 x 8 pixels within {PROBE_SECONDS:g} s in background on this "
                      "machine: it rasterizes on the processor; measure it where there is a graphics driver")
    except OSError as error:
        return None, f"EEVEE can't be tried: {error.strerror or error}"
    picture.unlink(missing_ok=True)
    if not made:
        return None, ("EEVEE makes no picture in background on this machine: it needs a graphics driver with EGL or a "
                      "display, which a compute-only driver lacks")
    names = [line.partition(" ")[2].strip() for line in result.stdout.splitlines() if line.startswith("RENDERER ")]
    return (names[0] if names and names[0] else "an unnamed OpenGL device"), ""


def calibrate(scene: BenchScene, engine: str, repetitions: int, base: dict[str, Any] | None,
              check: Callable[[], None], folder: Path) -> dict[str, Any]:
    """Return an engine's time per sample and what it adds to each picture.

    Args:
        scene: The open scene.
        engine: Name of a peer.
        repetitions: Renders at each count; the shortest is taken.
        base: For a denoised engine, the result of the one that it denoises.
        check: Called between renders; may raise.
        folder: For the probe of EEVEE.

    Returns:
        per_sample, denoise: seconds; counts, times: of the renders behind the slope; resident: a render of one sample
        with nothing to take in [s]; note: what is to be known about the slope; device: what it ran on.
    """
    found = {"device": check_eevee(folder) if engine == "eevee" else scene.device}
    scene.persistent = True
    try:
        resident = resident_seconds(scene, Job(engine=engine, samples=1, seed=RIVAL_SEED), check)
        if base is not None:
            return {**base, **found, "denoise": max(0.0, resident - base["resident"]), "resident": resident}

        def render(count: int) -> float:
            check()
            scene.configure(Job(engine=engine, samples=count, seed=RIVAL_SEED))
            return scene.shoot()[0]

        slope = measure_slope(render, repetitions)
    finally:
        scene.persistent = False
    if slope.per_sample <= 0.0:
        raise BurnishError(f"No time per sample can be measured: {slope.counts[-1]} samples take "
                           f"{slope.times[-1]:.3f} s, one takes {slope.times[0]:.3f} s; render larger pictures")
    return {**found, "per_sample": slope.per_sample, "denoise": 0.0, "resident": resident, "counts": slope.counts,
            "times": slope.times, "note": slope.note}


def resident_seconds(scene: BenchScene, job: Job, check: Callable[[], None]) -> float:
    """Return the shortest of a few renders in a row, the scene's persistent data kept between them [s]."""
    scene.configure(job)
    scene.shoot()  # Loads kernels and the scene.
    times: list[float] = []
    while len(times) < RESIDENT_RENDERS and sum(times) < RESIDENT_SECONDS:
        check()
        times.append(scene.shoot()[0])
    return min(times)


def no_time(facts: dict[str, Any]) -> str:
    """Return why a budget has no picture."""
    denoising = f" and denoising {1e3 * facts['denoise']:.3g} ms" if facts["denoise"] else ""
    return f"no picture: one sample takes {1e3 * facts['per_sample']:.3g} ms{denoising}"


def warm_record(job: Job, facts: dict[str, Any], samples: int) -> dict[str, Any]:
    """Return the record of a picture of so many samples; with none, why there is no picture."""
    record = {"engine": job.engine, "clock": job.clock, "budget": job.budget, "samples": samples,
              "seed": RIVAL_SEED, "device": facts["device"], "blender": bpy.app.version_string}
    if samples < 1:
        return {**record, "seconds": None, "no_picture": no_time(facts)}
    sampling = samples * facts["per_sample"]
    return {**record, "seconds": sampling + facts["denoise"],
            "parts": {"sampling": sampling, "denoising": facts["denoise"]}}


def shareable(plain: Job, facts: dict[str, Any]) -> bool:
    """Tell whether Cycles with and without denoising may take one render at a budget.

    Both then have the samples that fit without denoising; with it the budget is exceeded by 3 % at most, which is to
    the rival's advantage.
    """
    return plain.budget > LONG and 0.0 < facts["denoise"] <= SHARED_EXCESS * plain.budget


def render_shared(scene: BenchScene, pairs: list[tuple[Job, Job]], facts: dict[str, dict[str, Any]],
                  path_of: Callable[[Job], Path], begin: Callable[[Job], None], done: Done) -> None:
    """Render Cycles once for each pair of a plain and a denoised job; both get the same samples."""
    scene.persistent = True
    try:
        for plain, denoised in sorted(pairs, key=lambda pair: pair[0].budget):
            begin(plain)
            samples = samples_within(plain.budget, facts[plain.engine]["per_sample"], 0.0)
            records = [warm_record(job, facts[job.engine], samples) for job in (plain, denoised)]
            if samples:
                exact = Job(engine=denoised.engine, samples=samples, seed=RIVAL_SEED)
                wall = scene.shoot_both(exact, path_of(plain), path_of(denoised))
                records = [{**record, "wall": wall, "shared": "one render, with denoising"} for record in records]
            done(plain, records[0])
            begin(denoised)
            done(denoised, records[1])
    finally:
        scene.persistent = False


def render_warm(scene: BenchScene, jobs: list[Job], facts: dict[str, Any], path_of: Callable[[Job], Path],
                begin: Callable[[Job], None], done: Done) -> None:
    """Render an engine's pictures at its budgets and hand over their records.

    Budgets of the same number of samples share a picture. Above LONG undenoised pictures of Cycles are grown: each
    adds the samples that the one before lacks. What fails becomes the record's `no_picture`.

    Args:
        scene: The open scene.
        jobs: Of one engine, with budgets.
        facts: From `calibrate`.
        path_of: Gives a job's OpenEXR file.
        begin: Called before each job; may raise.
        done: Called with each job and its record.
    """
    scene.persistent = True
    shared: dict[int, tuple[Path, float]] = {}
    most = max(samples_within(job.budget, facts["per_sample"], facts["denoise"]) for job in jobs)
    grown: np.ndarray | None = None
    grown_samples = 0
    try:
        for job in sorted(jobs, key=lambda each: each.budget):
            begin(job)
            samples = samples_within(job.budget, facts["per_sample"], facts["denoise"])
            record = warm_record(job, facts, samples)
            if samples < 1:
                done(job, record)
                continue
            path, exact = path_of(job), Job(engine=job.engine, samples=samples, seed=RIVAL_SEED)
            try:
                if samples in shared:
                    save_picture(path, read_exr(shared[samples][0]))
                    wall = shared[samples][1]
                elif job.engine == "cycles" and job.budget > LONG:
                    more = Job(engine=job.engine, samples=samples - grown_samples, seed=RIVAL_SEED)
                    part, wall = scene.shoot_part(more, grown_samples, most, path)
                    grown = part if grown is None else (grown * grown_samples + part * more.samples) / samples
                    grown_samples = samples
                    save_picture(path, grown)
                else:
                    scene.configure(exact)
                    wall = scene.shoot(path)[0]
            except BurnishError as error:
                done(job, {**record, "seconds": None, "failure": sentence(error)})
                continue
            shared[samples] = path, wall
            done(job, {**record, "wall": wall})
    finally:
        scene.persistent = False
