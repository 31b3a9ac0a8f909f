# SPDX-License-Identifier: GPL-3.0-or-later
"""The rivals' time per sample, found on a clock that is told what each render takes."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from burnish.addon import bench_report, bench_slope
from burnish.addon.bench_report import SceneResult
from burnish.addon.bench_slope import Slope, measure_slope


class Machine:
    """Renders in 0.8 s and 30 ms a sample, or as `takes` says by samples and number of the render."""

    def __init__(self, takes: Callable[[int, int], float] | None = None) -> None:
        self.takes = takes or (lambda samples, number: 0.0)
        self.renders: list[tuple[int, float]] = []

    def render(self, samples: int) -> float:
        self.renders.append((samples, 0.8 + 0.03 * samples + self.takes(samples, len(self.renders) + 1)))
        return self.renders[-1][1]


def check_line(slope: Slope) -> None:
    """Hold a slope against the machine's."""
    assert slope.per_sample == pytest.approx(0.03, rel=0.02) and slope.fixed == pytest.approx(0.8, rel=0.02)
    assert slope.counts[0] == 1 and len(slope.counts) == 3 == len(slope.times) and sorted(slope.counts) == slope.counts


def test_quiet_machine_is_measured_once() -> None:
    """Find the slope from few renders, check it at a count in the middle, and have nothing to say about it."""
    machine = Machine()
    slope = measure_slope(machine.render, 2)
    check_line(slope)
    low, middle, high = slope.counts
    assert slope.times[2] - slope.times[0] >= bench_slope.SECONDS and low < middle == (high + 1) // 2
    assert slope.rounds == 0 and slope.note == "" and slope.bend < 1e-6 and len(machine.renders) < 14


@pytest.mark.parametrize("repetitions", [1, 2, 3])
def test_machine_that_warms_up_is_measured_again(repetitions: int) -> None:
    """Find the slope although all renders of the second count took far longer: two alone give one 15 times as steep."""
    disturbed = range(repetitions + 1, 2 * repetitions + 2)
    machine = Machine(lambda samples, number: 0.5 if number in disturbed and samples > 1 else 0.0)
    slope = measure_slope(machine.render, repetitions)
    check_line(slope)
    shortest = [min(time for samples, time in machine.renders[:2 * repetitions + 1] if samples == n) for n in (1, 2)]
    assert shortest[1] - shortest[0] > 15 * slope.per_sample
    assert slope.rounds >= 1 and slope.note.startswith(f"measured {slope.rounds + 1} times")


def test_slow_start_of_the_shortest_render_is_measured_again() -> None:
    """Find the slope although the renders of one sample came first and were slow: two counts alone give half of it."""
    machine = Machine(lambda samples, number: 0.5 * (samples == 1 and number < 14))
    slope = measure_slope(machine.render, 2)
    check_line(slope)
    assert slope.rounds >= 1 and "did not lie on a line within 15 % before" in slope.note


def test_a_third_count_goes_beyond_two_samples() -> None:
    """Check a slope between one and two samples at three."""
    slope = measure_slope(lambda samples: 5.0 * samples, 1)
    assert slope.counts == [1, 2, 3] and slope.per_sample == pytest.approx(5.0) and not slope.note


def test_what_is_no_line_is_told() -> None:
    """Stop after some repetitions where the time does not grow in proportion, and say that it is not reliable."""
    machine = Machine(lambda samples, number: 0.02 * samples**2)
    slope = measure_slope(machine.render, 2)
    assert slope.bend > bench_slope.STRAIGHT and slope.rounds == bench_slope.ROUNDS and len(machine.renders) < 40
    assert slope.note.startswith("not reliable: after 3 repetitions the renders of 1, ")
    none = measure_slope(lambda samples: 1.0, 1)
    assert none.per_sample == 0.0 and none.note


def test_results_show_the_note() -> None:
    """Name an engine's renders and what is to be known of them; leave out what is only denoised."""
    facts = {"per_sample": 0.03, "counts": [1, 8, 16], "times": [0.83, 1.04, 1.28]}
    engines = {"cycles": {**facts, "note": "measured 2 times"}, "cycles+oidn": facts, "realtime": {"per_frame": 0.1}}
    scene = SceneResult(name="a", hash="", size=(16, 8), device="cpu", truth="none", engines=engines)
    table = next(table for table in bench_report.scene_tables(scene) if table[0].startswith("Rivals' times"))
    assert table[2] == [["Cycles", "30", "1: 0.830 s, 8: 1.040 s, 16: 1.280 s", "measured 2 times"]]
