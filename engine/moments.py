# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur as a mean over moments: where in the shutter they lie, in which order they come, with how many samples.

The shutter is cut into strata of equal light, one for each moment, which lies at random in its own, so that no regular
ghosts appear. They come in the order of a scrambled van der Corput sequence: however many have come, they are spread
evenly, and where that is a power of two each of as many equal parts of the shutter has had one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

__all__ = ["Moment", "plan_moments", "rounds"]

FEWEST_MOMENTS = 8
"""That a picture with a time limit has, however long they take: with fewer it would look like one without blur"""
LIMIT_SHARE = 0.9
"""Of the time left that a round may be expected to take"""
GROWTH = 8
"""Most times the samples of the round before that one takes: what it costs is known from smaller ones"""


@dataclass(frozen=True)
class Moment:
    """A moment of the shutter and what it is worth."""

    place: float
    """Of the shutter, 0 where it opens to 1 where it closes"""
    samples: int
    """Of a whole picture, taken at this moment"""


def plan_moments(samples: int, most: int, seed: tuple[int, ...], light: np.ndarray) -> list[Moment]:
    """Return the moments of a picture in the order in which they come.

    Args:
        samples: Of the picture; each moment has one at least.
        most: Moments at most.
        seed: The same numbers give the same moments.
        light: float [N], what the shutter lets through at N places from 0 to 1, in any unit; negative counts as 0, and
            nothing anywhere as the same everywhere.
    """
    count = max(1, min(samples, most))
    random = np.random.default_rng(seed)
    # Strata as wide as their moments' samples, which are whole numbers, so that a picture is exact with any number.
    edges = np.round(np.linspace(0, samples, count + 1)).astype(int)
    order = even_order(count, random)
    widths = np.diff(edges)
    parts = (edges[:-1] + random.random(count) * widths) / samples
    places = inverse_integral(light, parts)
    return [Moment(float(places[stratum]), int(widths[stratum])) for stratum in order]


def even_order(count: int, random: np.random.Generator) -> np.ndarray:
    """Return the numbers below `count`, int [count], such that the first few, however many, are spread evenly.

    Owen-scrambled: halves are taken at random, or what comes first would lie early in its part of the shutter.
    """
    parts = np.zeros(1, int)
    while len(parts) < count:
        half = random.integers(0, 2, len(parts))
        # Those that come now take the other half of what the first ones have.
        parts = np.concatenate([2 * parts + half, 2 * parts + 1 - half])
    return np.argsort(np.argsort(parts[:count]))


def inverse_integral(light: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return the places, 0..1, before which a shutter lets through these parts, 0..1, of its light."""
    light = np.nan_to_num(np.maximum(np.asarray(light, np.float64), 0.0))
    total = np.concatenate([[0.0], np.cumsum(0.5 * (light[1:] + light[:-1]))])
    if total[-1] <= 0.0:
        return parts
    return np.interp(parts, total / total[-1], np.linspace(0.0, 1.0, len(light)))


def rounds(moments: list[Moment], limit: float, elapsed: Callable[[], float]) -> Iterator[tuple[Moment, int]]:
    """Yield moments and how many samples to take there, until the picture has all or the time is nearly up.

    Without a limit each moment has all its samples at once. With one there are rounds of as many samples for each
    moment, the first of one, and none begins that would not be over in time: whenever this ends, the picture is a mean
    over the whole shutter. Where even the first round would not be over in time, fewer moments do.

    Args:
        moments: From `plan_moments`.
        limit: Time that the picture may take [s]; 0: any.
        elapsed: Returns how much it has taken [s], once all samples yielded before are there.
    """
    if limit <= 0.0:
        yield from ((moment, moment.samples) for moment in moments)
        return
    used: list[Moment] = []
    for moment in moments:
        met = len(used)
        if met >= FEWEST_MOMENTS and met & (met - 1) == 0 and 2.0 * elapsed() > limit:
            share = sum(each.samples for each in moments) // met
            used = [replace(each, samples=share) for each in used]
            break
        yield moment, 1
        used.append(moment)
    done, most = 1, max(moment.samples for moment in used)
    costs = [(0.0, 0.0), (1.0, elapsed())]
    while done < most:
        count = round_samples(costs, limit - elapsed())
        if count < 1:
            return
        start = elapsed()
        for moment in used:
            if moment.samples > done:
                yield moment, min(count, moment.samples - done)
        costs = [costs[-1], (float(count), elapsed() - start)]
        done += count


def round_samples(costs: list[tuple[float, float]], left: float) -> int:
    """Return how many samples for each moment the next round can have; 0: there is no time for one.

    Args:
        costs: Samples for each moment and time [s] of the two newest rounds. Going to the moments takes its time too,
            whatever the number of samples: the straight line through both tells it.
        left: Time left [s].
    """
    (few, short), (many, long) = costs
    # Later rounds may be the smaller ones, and times vary: no sample comes for less than nothing.
    each = max((long - short) / (many - few), 0.0) if many != few else long / many
    each = min(each, long / many)
    fixed = long - each * many
    time = LIMIT_SHARE * left - fixed
    if time < each or time <= 0.0:
        return 0
    return int(min(GROWTH * many, time / max(each, 1e-9)))
