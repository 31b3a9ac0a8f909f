# SPDX-License-Identifier: GPL-3.0-or-later
"""A time per sample from whole renders: the slope between sample counts, checked at a third count. Knows no bpy.

Other load only makes a render longer, so that the shortest render of each count stands for it. On a machine that still
warms up two counts may be disturbed alike: only a third, off the line of the first two, tells.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .bench_plan import fit_line

__all__ = ["Slope", "measure_slope"]

SECONDS = 0.4
"""Difference between two renders that is long enough for a slope"""
SHARE = 0.5
"""The same as a share of the shorter render"""
LIMIT = 4.0
"""A render this long ends the search for a second sample count [s]"""
SAMPLES_MAX = 1 << 14
STRAIGHT = 0.15
"""Share of the slope by which the slopes between neighbouring counts may differ from it"""
ROUNDS = 3
"""Most times that all three counts are rendered again"""


@dataclass(frozen=True, kw_only=True)
class Slope:
    """Renders of three sample counts and the line through them."""

    fixed: float
    """What a render takes beside its samples [s]"""
    per_sample: float
    counts: list[int]
    """Ascending, from one sample"""
    times: list[float]
    """Shortest render of each [s]"""
    rounds: int
    """How often all were rendered again because they did not lie on a line"""
    bend: float
    """Largest share of the slope by which those between neighbouring counts differ from it"""

    @property
    def note(self) -> str:
        """Return what is to be known about it; empty where there is nothing."""
        renders = " and ".join(filter(None, [", ".join(map(str, self.counts[:-1])), str(self.counts[-1])]))
        if self.bend > STRAIGHT:
            return (f"not reliable: after {self.rounds} repetitions the renders of {renders} samples are still "
                    f"{100.0 * self.bend:.0f} % off a line; other load disturbs them, or the samples differ in cost")
        if self.rounds:
            return (f"measured {self.rounds + 1} times: the renders of {renders} samples did not lie on a line within "
                    f"{100.0 * STRAIGHT:.0f} % before")
        return ""


def measure_slope(render: Callable[[int], float], repetitions: int) -> Slope:
    """Return the time per sample of an engine.

    Args:
        render: Renders so many samples and returns the seconds; may raise.
        repetitions: Renders of each count, more where they do not lie on a line.
    """
    shortest: dict[int, float] = {}

    def again(count: int, times: int) -> None:
        for _ in range(times):
            shortest[count] = min(render(count), shortest.get(count, float("inf")))

    again(1, repetitions)
    most = second_count(shortest, again, 1, repetitions)
    rounds = 0
    while True:
        # Halfway where there is room; a third that takes longer than needed where there is none.
        third = (most + 1) // 2 if most > 2 else 3
        if third not in shortest or rounds == 0:
            again(third, repetitions)
        counts = sorted({1, third, most})
        times = [shortest[count] for count in counts]
        fixed, per_sample = fit_line(counts, times)
        bend = bend_of(counts, times, per_sample)
        if bend <= STRAIGHT or rounds == ROUNDS:
            return Slope(fixed=fixed, per_sample=per_sample, counts=counts, times=times, rounds=rounds, bend=bend)
        rounds += 1
        for count in counts:
            again(count, repetitions)
        if not long_enough(shortest[1], shortest[most]):
            most = second_count(shortest, again, most, repetitions)


def second_count(
    shortest: dict[int, float], again: Callable[[int, int], None], count: int, repetitions: int,
) -> int:
    """Return a count above `count` whose render takes long enough by more than that of one sample."""
    while count < SAMPLES_MAX:
        # Not below a doubling, not far above what the longest render allows.
        count *= 2 if count < 8 or shortest[count] - shortest[1] > 0.5 * SECONDS else 4
        again(count, 1)
        if long_enough(shortest[1], shortest[count]):
            # A disturbed render looks long enough too: it must be so again.
            again(count, max(1, repetitions - 1))
            again(1, 1)
            if long_enough(shortest[1], shortest[count]):
                break
    return count


def long_enough(low: float, high: float) -> bool:
    """Tell whether two renders' times differ by enough for a slope."""
    return high - low >= max(SECONDS, SHARE * low) or high >= LIMIT


def bend_of(counts: Sequence[int], times: Sequence[float], slope: float) -> float:
    """Return the largest share of the slope by which slopes between neighbouring counts differ from it."""
    if slope <= 0.0:
        return float("inf")
    slopes = [(s - r) / (n - m) for (m, r), (n, s) in itertools.pairwise(zip(counts, times, strict=True))]
    return max(abs(each / slope - 1.0) for each in slopes)
