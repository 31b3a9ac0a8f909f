# SPDX-License-Identifier: GPL-3.0-or-later
"""Timing of frames, on a session whose frames cost what its clock is told."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from burnish.engine import measure
from burnish.engine.measure import Stop, View, frame_curve, frames_within, progressive_shots, shoot
from burnish.engine.measure_moving import measure_pan
from burnish.engine.scene import CameraData


class FakeSession:
    """A session with frames of 10 ms, a read-back of 2 ms, and a reset of 1 s that no time may contain."""

    device = "cpu"

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.samples_done, self.timed, self.resets = 0.0, 0, False, 0
        self.frame_times, self.pipeline = {"Rays": 1.0}, SimpleNamespace(kernel_times={"trace": 1.0})
        self.cameras: list[CameraData] = []
        monkeypatch.setattr(measure.time, "perf_counter", lambda: self.now)
        monkeypatch.setattr(measure.wp, "synchronize_device", lambda device: None)

    def reset(self) -> None:
        self.now, self.samples_done, self.resets = self.now + 1.0, 0, self.resets + 1

    def configure(self, settings: object, camera: CameraData, *_: object) -> None:
        self.cameras.append(camera)

    def step(self, samples: int, should_stop: object = None) -> int:
        self.now, self.samples_done = self.now + 0.01 * samples, self.samples_done + samples
        return self.samples_done

    def read(self, name: str) -> np.ndarray:
        self.now += 0.002
        return np.full((2, 2, 4), self.samples_done, np.float32)


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> FakeSession:
    return FakeSession(monkeypatch)


def test_curve_is_frames_by_seconds(session: FakeSession) -> None:
    """Measure frames from the reset's end until the time is reached."""
    curve = frame_curve(session, 0.1)
    assert curve[0] == (1, pytest.approx(0.01)) and curve[-1][1] >= 0.1 > curve[-2][1]
    assert all(seconds == pytest.approx(0.01 * count) for count, seconds in curve)
    assert len(frame_curve(session, 0.0)) == 1


def test_frames_fit_into_a_time() -> None:
    """Interpolate inside a curve that slows down, and go on past its end with its last slope."""
    curve = [(1, 0.1), (2, 0.2), (4, 0.6), (6, 1.0)]
    found = [frames_within(curve, seconds) for seconds in (-1.0, 0.0, 0.09, 0.1, 0.39, 0.41, 1.0, 1.41)]
    assert found == [0, 0, 0, 1, 2, 3, 6, 8]
    assert frames_within([], 1.0) == 0 and frames_within([(1, 0.5)], 2.0) == 4


def test_a_shot_counts_frames_and_read_back(session: FakeSession) -> None:
    """Time so many frames and what ends the picture, and nothing before."""
    shot = shoot(session, 5, lambda: session.read("Combined"))
    assert shot.frames == 5 and shot.seconds == pytest.approx(0.052) and shot.finish == pytest.approx(0.002)
    assert shot.picture[0, 0, 0] == 5


def test_one_run_stops_for_each_budget(session: FakeSession) -> None:
    """Give every stop the frames that fit, not counting the pictures before, out of one run."""
    def stop(budget: float) -> Stop:
        return Stop(budget, lambda: session.read("Combined"), 0.004)

    shots = list(progressive_shots(session, [stop(0.01), stop(0.1), stop(1.0)], [(1, 0.01)]))
    assert shots[0] is None and session.resets == 1
    assert [shot.frames for shot in shots[1:]] == [9, 99]
    assert [shot.seconds for shot in shots[1:]] == pytest.approx([0.094, 0.994])


def test_a_stopped_run_gives_no_more_pictures(session: FakeSession) -> None:
    """End without a picture when asked to."""
    stop = Stop(1.0, lambda: session.read("Combined"), 0.0)
    assert list(progressive_shots(session, [stop], [(1, 0.01)], lambda: True)) == []


def test_a_pan_ends_in_the_view(session: FakeSession) -> None:
    """Move the camera before every frame, end in the asked view, and time frames and read-backs apart."""
    camera = CameraData()
    moving = measure_pan(session, None, View(camera, 2, 2, None, ("Combined",)), 12, 100.0)
    assert session.cameras[-1] == camera and len(set(session.cameras)) == 12 == moving.frames
    assert moving.frame == pytest.approx(10.0) and moving.read == pytest.approx(2.0)
    assert moving.sections == {"Rays": 1.0}
    axis = np.array(session.cameras[0].transform).reshape(4, 4)[:3, :3]
    assert axis @ axis.T == pytest.approx(np.eye(3), abs=1e-12)


def test_a_slow_pan_is_cut_short(session: FakeSession) -> None:
    """Render fewer frames than asked for where they take too long, and still end in the view."""
    camera = dataclasses.replace(CameraData(), clip_end=7.0)
    moving = measure_pan(session, None, View(camera, 2, 2, None, ("Combined",)), 1000, 0.1)
    assert 3 <= moving.frames < 20 and session.cameras[-1] == camera
