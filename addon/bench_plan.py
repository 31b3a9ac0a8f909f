# SPDX-License-Identifier: GPL-3.0-or-later
"""What the benchmark measures and the arithmetic of budgets: jobs, time per sample, samples that fit. Knows no bpy."""

from __future__ import annotations

import argparse
import itertools
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from .bench_store import MOVING, Job

__all__ = [
    "BUDGETS", "CLOCKS", "LONG", "LONG_DENOISED", "TOLERANCE", "Plan", "fit_line", "make_plan", "most_frames",
    "samples_within"]

BUDGETS = (0.005, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Times [s] at which engines are compared unless others are asked for"""
CLOCKS = ("warm", "cold")
LONG = 0.5
"""Budgets above this are measured once, and pictures of one engine share samples [s]"""
LONG_DENOISED = 3.0
"""The same of denoised pictures: of few samples, which take less time to finish [s]"""
TOLERANCE = 1.02
"""Share of a budget that a picture may take"""
FULL = 0.9
"""Share of a budget below which more frames are tried"""
ATTEMPTS = 6
"""Most numbers of frames that are tried for a budget"""
TRUTH_SEEDS = (101, 202)
NOISE_SEEDS = (11, 22)
RIVAL_SEED = 7
"""Other than 0: a given truth was most likely made with Blender's default, and would share our peers' samples"""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The pictures of one scene."""

    truth: list[Job] = field(default_factory=list)
    """Two independent halves; none where a picture is given"""
    fixed: list[Job] = field(default_factory=list)
    """Fixed numbers of samples, by F12"""
    noise: list[Job] = field(default_factory=list)
    warm: list[Job] = field(default_factory=list)
    moving: list[Job] = field(default_factory=list)
    cold: list[Job] = field(default_factory=list)

    @property
    def rows(self) -> list[Job]:
        """Return what is compared with the truth."""
        return [*self.fixed, *self.warm, *self.moving, *self.cold]

    @property
    def all(self) -> list[Job]:
        """Return every picture."""
        return [*self.truth, *self.rows, *self.noise]


def make_plan(arguments: argparse.Namespace) -> Plan:
    """Return the jobs of one scene for the command's options."""
    half = max(1, arguments.truth // 2)
    engines = [*arguments.engines, *arguments.peers]
    truth = [] if arguments.reference else [Job(engine="truth", samples=half, seed=seed) for seed in TRUTH_SEEDS]
    fixed = [Job(engine=engine, samples=samples) for engine in engines for samples in arguments.samples]
    first = arguments.samples[0] if arguments.samples else 16
    noise = [Job(engine="reference", samples=first * factor, seed=seed)
             for factor in (1, 4, 16) for seed in NOISE_SEEDS] if arguments.noise else []
    timed = {clock: [Job(engine=engine, budget=budget, clock=clock) for engine in engines for budget in budgets]
             for clock, budgets in (("warm", arguments.budgets), ("cold", arguments.cold_budgets))}
    warm = timed["warm"] if "warm" in arguments.clocks else []
    moving = [Job(engine="realtime", clock=MOVING)] if warm and "realtime" in engines else []
    return Plan(truth=truth, fixed=fixed, noise=noise, warm=warm, moving=moving,
                cold=timed["cold"] if "cold" in arguments.clocks else [])


def fit_line(counts: Sequence[float], seconds: Sequence[float]) -> tuple[float, float]:
    """Return fixed seconds and seconds per sample of renders with so many samples.

    The slope is the median of those between all pairs (Theil 1950, Sen 1968): one disturbed render does not move it.

    Raises:
        ValueError: All counts are the same.
    """
    pairs = itertools.combinations(zip(counts, seconds, strict=True), 2)
    slopes = [(s - r) / (n - m) for (m, r), (n, s) in pairs if m != n]
    if not slopes:
        raise ValueError("A slope needs two different numbers of samples")
    slope = statistics.median(slopes)
    return statistics.median(s - slope * n for n, s in zip(counts, seconds, strict=True)), slope


def samples_within(budget: float, per_sample: float, fixed: float) -> int:
    """Return how many samples fit into `budget` [s] beside the `fixed` time; 0 where not even one does."""
    if per_sample <= 0.0:
        return 0
    # A thousandth of a sample is what rounding leaves of times that divide exactly.
    return max(0, int((budget - fixed) / per_sample + 1e-3))


def most_frames(measure: Callable[[int], tuple[float, float]], budget: float, first: int) -> int:
    """Return the most frames found whose picture takes no longer than a budget [s]; 0 where one takes longer.

    Args:
        measure: Returns the seconds of a picture of so many frames, and the part that depends on no number of them.
        budget: Seconds.
        first: The guess to begin with.
    """
    frames, low, high, known = max(1, first), 0, None, {}
    for _ in range(ATTEMPTS):
        known[frames], rest = measure(frames)
        if known[frames] <= TOLERANCE * budget:
            low = max(low, frames)
            if known[frames] >= FULL * budget:
                break
        else:
            high = frames if high is None else min(frames, high)
        slope = (known[frames] - rest) / frames
        if len(known) > 1:
            # Two tell more than one: samples of a batch share the time of the longest paths.
            other = min(known.keys() - {frames}, key=lambda count: abs(count - frames))
            slope = (known[frames] - known[other]) / (frames - other)
        following = frames + int((budget - known[frames]) / max(slope, 1e-9))
        frames = max(low + 1, following if high is None else min(following, high - 1))
        if frames in known:
            break
    if not low and 1 not in known and measure(1)[0] <= TOLERANCE * budget:
        low = 1
    return low
