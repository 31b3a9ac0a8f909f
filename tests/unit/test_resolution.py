# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the viewport's choice of resolution."""

from __future__ import annotations

import pytest
from burnish.addon.resolution import DIVIDER_MAX, ResolutionControl, divided_size


def test_first_divider_until_measured():
    """Start coarse where nothing is known."""
    control = ResolutionControl(first_divider=8)
    assert control.navigation_divider(10**6, 0.05) == 8
    assert control.samples_within(10**6, 0.1) == 1


@pytest.mark.parametrize(("seconds_per_sample", "expected"), [(1e-9, 1), (4e-7, 4), (1.0, DIVIDER_MAX)])
def test_divider_meets_the_frame_time(seconds_per_sample, expected):
    """Choose the divider whose picture takes about the frame time."""
    control = ResolutionControl()
    control.record(1000, 1, 1000 * seconds_per_sample)
    pixels, frame_time = 1920 * 1080, 0.05
    divider = control.navigation_divider(pixels, frame_time)
    assert divider == pytest.approx(expected, abs=1)
    if divider < DIVIDER_MAX:
        assert seconds_per_sample * pixels / divider**2 <= 1.1 * frame_time


def test_fixed_divider_wins():
    """Obey the user's pixel size."""
    control = ResolutionControl()
    control.record(1000, 1, 1.0)
    assert control.navigation_divider(10**6, 0.05, fixed=2) == 2
    assert control.levels(10**6, 0.05, fixed=2) == (2, 1)


def test_steady_divider_resists_small_changes():
    """Keep a size whose frames take about the time aimed at; leave one that is far too slow or too fast."""
    control = ResolutionControl(first_divider=8)
    assert control.steady_divider(10**6, 0.05, 0, current=0) == 8
    control.record(10**6, 1, 0.8)
    assert control.navigation_divider(10**6, 0.05) == 4
    assert [control.steady_divider(10**6, 0.05, 0, current) for current in (0, 1, 2, 4, 5, 6, 12)] == [
        4, 4, 4, 4, 5, 6, 4]
    assert control.steady_divider(10**6, 0.05, 3, current=4) == 3


def test_levels_end_at_full_resolution():
    """Refine over one level between, and always end at 1."""
    control = ResolutionControl(first_divider=16)
    assert control.levels(10**6, 0.05) == (16, 4, 1)
    control.record(10**6, 1, 1e-4)
    assert control.levels(10**6, 0.05) == (1,)


def test_speed_follows_measurements():
    """Follow a change of speed within a few pictures, without jumping."""
    control = ResolutionControl()
    control.record(1, 1, 1e-6)
    control.record(1, 1, 1e-4)
    assert 1e-6 < control.seconds_per_sample < 1e-4
    for _ in range(20):
        control.record(1, 1, 1e-4)
    assert control.seconds_per_sample == pytest.approx(1e-4, rel=0.01)


def test_unusable_measurements_are_ignored():
    """Ignore steps without samples, time or pixels."""
    control = ResolutionControl()
    for values in ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 0.0)):
        control.record(*values)
    assert control.seconds_per_sample is None


@pytest.mark.parametrize(("size", "divider", "expected"), [(1001, 4, 251), (1, 16, 1), (16, 16, 1), (7, 1, 7)])
def test_divided_size_covers(size, divider, expected):
    """Round up, so that the divided picture covers the region."""
    assert divided_size(size, divider) == expected
