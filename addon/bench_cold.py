# SPDX-License-Identifier: GPL-3.0-or-later
"""The cold clock: a second F12 with everything in, from Blender's scene to the picture, kernels already there.

What fits into a budget is foreseen from a render of one sample and the time per sample of the warm clock; what counts
is the wall time of the render itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..engine.errors import BurnishError
from ..engine.measure import frames_within
from .bench_engines import BenchScene, sentence
from .bench_plan import RIVAL_SEED, samples_within
from .bench_store import OWN, Job

__all__ = ["render_cold"]

TOLERANCE = 1.05
"""Share of a budget that a render may take before a shorter one is tried"""
SHORT = 0.85
"""Share of a budget below which a longer render is tried"""
ATTEMPTS = 2
PARTS = ("extraction", "textures", "upload", "structures", "lights", "sampling", "read")
"""Burnish's stages, in their order"""


def frames_in(engine: str, facts: dict[str, Any], seconds: float) -> int:
    """Return how many samples or frames fit beside all else, the first included, which takes no extra time."""
    if engine in OWN:
        curve = [tuple(point) for point in facts["curve"]]
        return max(1, frames_within(curve, seconds + curve[0][1]))
    return 1 + samples_within(seconds, facts["per_sample"], 0.0)


def parts_of(record: dict[str, Any]) -> dict[str, float]:
    """Return the seconds of each part of a render, as far as its engine tells them."""
    times = record.get("times")
    if not times:
        return {"everything": record["seconds"]}
    parts = {name: times[name] for name in PARTS if name in times}
    return {**parts, "rest": max(0.0, record["seconds"] - sum(parts.values()))}


def fill(scene: BenchScene, job: Job, exact: Job, facts: dict[str, Any], single: float, path: Path) -> dict[str, Any]:
    """Render as many samples as fit into a job's budget; where that misses, once more. Return the better record.

    Args:
        scene: The open scene.
        job: With the budget.
        exact: The same engine with one sample.
        facts: Of the engine.
        single: Seconds of that one sample.
        path: For the picture.
    """
    best: tuple[tuple[float, float], dict[str, Any]] | None = None
    samples, attempt = frames_in(job.engine, facts, job.budget - single), path.with_name(f".{path.stem}.attempt.exr")
    for _ in range(ATTEMPTS):
        record = scene.render(dataclasses.replace(exact, samples=samples), attempt)
        seconds = record["seconds"]
        # Too long is worse than too short, and of two of a kind the one nearer to the budget is better.
        miss = (max(seconds / job.budget - TOLERANCE, 0.0), abs(seconds - job.budget))
        if best is None or miss < best[0]:
            best = miss, record
            attempt.replace(path)
        if SHORT * job.budget <= seconds <= TOLERANCE * job.budget or seconds <= single:
            break
        more = int(samples * (job.budget - single) / (seconds - single))
        if max(1, more) == samples:
            break
        samples = max(1, more)
    attempt.unlink(missing_ok=True)
    return best[1]


def render_cold(scene: BenchScene, jobs: list[Job], facts: dict[str, Any], path_of: Callable[[Job], Path],
                begin: Callable[[Job], None], done: Callable[[Job, dict[str, Any]], None]) -> None:
    """Render an engine's pictures at its budgets by F12 and hand over their records.

    Args:
        scene: The open scene.
        jobs: Of one engine, with budgets.
        facts: Its time per sample or its curve of frames, as the warm clock measured them.
        path_of: Gives a job's OpenEXR file.
        begin: Called before each job; may raise.
        done: Called with each job and its record; a failure is in it.
    """
    single: float | None = None
    for job in sorted(jobs, key=lambda each: each.budget):
        begin(job)
        seed = 0 if job.engine in OWN else RIVAL_SEED
        exact = Job(engine=job.engine, samples=1, seed=seed)
        try:
            if single is None:
                single = scene.render(exact, path_of(job))["seconds"]
            if single > job.budget:
                path_of(job).unlink(missing_ok=True)
                done(job, {"engine": job.engine, "clock": job.clock, "budget": job.budget, "samples": 0,
                           "seconds": None, "no_picture": f"no picture: an F12 of one sample takes {single:.3g} s"})
                continue
            record = fill(scene, job, exact, facts, single, path_of(job))
        except BurnishError as error:
            done(job, {"engine": job.engine, "clock": job.clock, "budget": job.budget, "seconds": None,
                       "failure": sentence(error)})
            continue
        done(job, {**record, "clock": job.clock, "budget": job.budget, "parts": parts_of(record)})
