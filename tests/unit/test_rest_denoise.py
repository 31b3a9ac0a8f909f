# SPDX-License-Identifier: GPL-3.0-or-later
"""Test when viewports at rest are denoised, with a session that only counts."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from burnish.addon import rest_denoise
from burnish.addon.rest_denoise import FIRST_SAMPLES, SHARE, RestDenoiser
from burnish.addon.view_request import ViewRequest
from burnish.engine.errors import BurnishError
from burnish.engine.scene import CameraData
from burnish.engine.settings import DebugSettings, Integrator, RenderSettings, SamplingSettings

COST = 0.5
"""Seconds that a picture takes"""


class Counting:
    """A session with some path-traced samples, whose pictures are numbered."""

    def __init__(self, clock):
        self.traced_samples, self.pictures, self.clock, self.stops = FIRST_SAMPLES, 0, clock, False

    def resolve_denoised(self, library, should_stop):
        self.clock.now += COST
        if self.stops:
            assert should_stop()
            return None
        self.pictures += 1
        return self.pictures


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that goes when told to."""
    made = SimpleNamespace(now=100.0)
    monkeypatch.setattr(rest_denoise.time, "perf_counter", lambda: made.now)
    return made


def request(sampling=None, **settings):
    """Return a request for real-time frames."""
    settings = RenderSettings(sampling=SamplingSettings(**sampling or {}), **settings)
    return ViewRequest(settings=settings, camera=CameraData(), width=64, height=36)


def test_who_is_denoised(clock):
    """Take over from the first samples on, where it is wanted and there is a library."""
    session, denoiser = Counting(clock), RestDenoiser("library")
    assert denoiser.takes_over(request(), session)
    assert not RestDenoiser().takes_over(request(), session)
    assert not denoiser.takes_over(request({"viewport_denoise": False}), session)
    assert not denoiser.takes_over(request({"integrator": Integrator.REFERENCE}), session)
    assert not denoiser.takes_over(request(debug=DebugSettings(view="rest.weight")), session)
    session.traced_samples -= 1
    assert not denoiser.takes_over(request(), session)


def test_share_of_the_time(clock):
    """Denoise at once, then for a share of the time, and last; not twice the same."""
    session, denoiser = Counting(clock), RestDenoiser("library")

    def picture(last=False):
        assert denoiser.takes_over(request(), session)
        return denoiser.picture(session, lambda: False, last=last)

    assert picture() == 1
    clock.now += COST / SHARE + 0.1
    assert picture() is None
    session.traced_samples += 1
    assert picture() == 2
    session.traced_samples += 1
    clock.now += COST / SHARE - 0.1
    assert picture() is None and picture(last=True) == 3 and picture(last=True) is None
    # Switched off and on again, with no more samples.
    assert not denoiser.takes_over(request({"viewport_denoise": False}), session)
    assert picture() == 4
    # Another view begins.
    session.traced_samples = 0
    assert not denoiser.takes_over(request(), session)
    session.traced_samples = FIRST_SAMPLES
    assert picture() == 5


def test_what_stops_is_made_up_for(clock):
    """Give no picture when told to stop, and the same one as soon as there is time."""
    session, denoiser = Counting(clock), RestDenoiser("library")
    session.stops = True
    assert denoiser.picture(session, lambda: True, last=False) is None
    session.stops = False
    assert denoiser.picture(session, lambda: False, last=False) == 1


def test_failure_leaves_the_picture(clock, monkeypatch):
    """Go on without where the library fails, and do not ask it again."""
    session, denoiser = Counting(clock), RestDenoiser("library")

    def fails(*_):
        raise BurnishError("Open Image Denoise failed: no memory.")

    monkeypatch.setattr(session, "resolve_denoised", fails)
    assert denoiser.takes_over(request(), session)
    assert denoiser.picture(session, lambda: False, last=False) is None
    assert not denoiser.takes_over(request(), session)


def test_switching_it_keeps_the_frames():
    """Leave what is rendered as it is when the setting changes."""
    from burnish.engine.setting_changes import Change, change_since

    settings = RenderSettings()
    assert change_since(replace(settings, sampling=replace(settings.sampling, viewport_denoise=False)),
                        settings) == Change.NONE
