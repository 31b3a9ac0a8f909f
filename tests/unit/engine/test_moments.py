# SPDX-License-Identifier: GPL-3.0-or-later
"""Moments of motion blur: even over the shutter, by its curve, and in rounds that end in time."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.moments import FEWEST_MOMENTS, Moment, plan_moments, rounds

OPEN = np.ones(257)


@pytest.mark.parametrize(("samples", "most", "count"), [
    (128, 32, 32), (50, 32, 32), (5, 32, 5), (1000, 24, 24), (7, 1, 1), (1, 1024, 1)])
def test_moments_share_the_samples_and_the_shutter(samples, most, count):
    """Give every moment its samples, all of them together, and a stratum as wide as they are many."""
    moments = sorted(plan_moments(samples, most, (1, 2), OPEN), key=lambda moment: moment.place)
    shares = [moment.samples for moment in moments]
    assert len(moments) == count and sum(shares) == samples and max(shares) - min(shares) <= 1
    edges = np.concatenate([[0], np.cumsum(shares)]) / samples
    places = np.array([moment.place for moment in moments])
    assert (edges[:-1] <= places).all() and (places <= edges[1:]).all()


@pytest.mark.parametrize("count", [32, 24, 50])
def test_the_first_few_are_spread_evenly(count):
    """Put the first 2, 4, 8 and 16 moments into as many parts of the shutter, whatever is the number of all."""
    for seed in range(20):
        places = np.array([moment.place for moment in plan_moments(count, 64, (seed,), OPEN)])
        for first in (2, 4, 8, 16):
            parts = np.sort(places[:first]) * first - np.arange(first)
            slack = 0.0 if count == 32 else first / 16
            assert -slack - 1e-9 <= parts.min() and parts.max() <= 1.0 + slack + 1e-9, (seed, first, parts)


def test_moments_are_known_by_their_seed():
    """Find the same moments for the same seed and others for others, without a side that they prefer."""
    assert plan_moments(64, 32, (3, 4), OPEN) == plan_moments(64, 32, (3, 4), OPEN)
    assert plan_moments(64, 32, (3, 4), OPEN) != plan_moments(64, 32, (3, 5), OPEN)
    for first in (1, 4, 32):
        means = [np.mean([moment.place for moment in plan_moments(32, 32, (seed,), OPEN)[:first]])
                 for seed in range(400)]
        # The mean of `first` strata with one uniform place each deviates by first^-1.5 / sqrt(12).
        assert abs(np.mean(means) - 0.5) < 4.0 * first ** -1.5 / np.sqrt(12.0 * 400.0)


@pytest.mark.parametrize(("light", "expected"), [
    (OPEN, lambda part: part),
    (np.linspace(0.0, 2.0, 257), np.sqrt),
    (np.where(np.linspace(0.0, 1.0, 257) < 0.5, 0.0, 1.0), lambda part: 0.5 + 0.5 * part),
    (-OPEN, lambda part: part),
    (np.zeros(257), lambda part: part),
    (np.full(257, np.nan), lambda part: part),
])
def test_moments_follow_the_curve(light, expected):
    """Let as many samples lie before a place as the shutter lets light through before it."""
    moments = sorted(plan_moments(512, 512, (0,), light), key=lambda moment: moment.place)
    places = np.array([moment.place for moment in moments])
    wanted = expected((np.arange(512) + 0.5) / 512)
    # Half a stratum, and where the curve begins at nothing that much of its first step.
    np.testing.assert_allclose(places[8:], wanted[8:], atol=4e-3)


class Clock:
    """Time by what is done: so long for going to a moment, so long for a sample."""

    def __init__(self, moving: float, sample: float):
        self.moving, self.sample = moving, sample
        self.now = 0.0

    def run(self, moments: list[Moment], limit: float) -> dict[float, int]:
        """Return the samples of each place."""
        taken: dict[float, int] = {}
        for moment, samples in rounds(moments, limit, lambda: self.now):
            assert samples > 0
            taken[moment.place] = taken.get(moment.place, 0) + samples
            self.now += self.moving + samples * self.sample
        return taken


def test_without_a_limit_each_moment_comes_once():
    """Take all samples of a moment at once."""
    moments = plan_moments(100, 32, (0,), OPEN)
    assert list(rounds(moments, 0.0, lambda: 1e9)) == [(moment, moment.samples) for moment in moments]


@pytest.mark.parametrize(("moving", "sample"), [(1e-4, 1e-2), (1e-2, 1e-4), (1e-3, 1e-3)])
def test_with_a_limit_all_moments_count_the_same(moving, sample):
    """Use most of the time for whole rounds, and no more than there is."""
    clock = Clock(moving, sample)
    taken = clock.run(plan_moments(1 << 20, 32, (0,), OPEN), 10.0)
    assert len(taken) == 32 and len(set(taken.values())) == 1
    assert 7.0 < clock.now <= 10.0, clock.now


def test_a_limit_that_is_far_changes_nothing():
    """Take all samples where there is time for them."""
    clock = Clock(1e-3, 1e-3)
    moments = plan_moments(100, 32, (0,), OPEN)
    assert clock.run(moments, 1e6) == {moment.place: moment.samples for moment in moments}


@pytest.mark.parametrize(("limit", "count"), [(10.0, 8), (0.01, FEWEST_MOMENTS), (20.0, 16)])
def test_a_short_limit_leaves_fewer_moments(limit, count):
    """Leave out moments where there is no time for all, each part of the shutter having one of the rest."""
    clock = Clock(0.9, 0.1)
    taken = clock.run(plan_moments(1 << 20, 32, (0,), OPEN), limit)
    assert len(taken) == count and set(taken.values()) == {1}
    assert sorted(int(place * count) for place in taken) == list(range(count))
