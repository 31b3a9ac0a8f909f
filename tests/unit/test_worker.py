# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the viewport's worker thread, with a NumPy session: no bpy, no kernels."""

from __future__ import annotations

import dataclasses
import importlib.util
import threading
import time
from pathlib import Path

import pytest
from burnish.addon.picture import pack_colors
from burnish.addon.view_request import ViewRequest, divided_crop, divided_settings, picture_area, restarts
from burnish.addon.worker import ViewportWorker
from burnish.engine.errors import DeviceUnavailable
from burnish.engine.scene import CameraData, CameraKind, SceneDelta
from burnish.engine.settings import (
    DebugSettings,
    Integrator,
    PerformanceSettings,
    RenderSettings,
    SamplingSettings,
)

spec = importlib.util.spec_from_file_location(
    "host_fakes", Path(__file__).resolve().parent.parent / "blender" / "host_fakes.py")
fakes = importlib.util.module_from_spec(spec)
spec.loader.exec_module(fakes)

WAIT = 5.0
"""Seconds after which a thread counts as stuck."""


def until(condition) -> None:
    """Wait for a condition."""
    end = time.perf_counter() + WAIT
    while not condition():
        assert time.perf_counter() < end, "timed out"
        time.sleep(0.002)


def request(samples: int = 8, **changes) -> ViewRequest:
    """Return a request for path-traced samples of 64 x 36 pixels."""
    sampling = SamplingSettings(viewport_samples=samples, integrator=Integrator.REFERENCE)
    settings = RenderSettings(sampling=sampling)
    values = {"settings": settings, "camera": CameraData(), "width": 64, "height": 36} | changes
    return ViewRequest(**values)


def frames(samples: int = 8, view: str = "", **changes) -> ViewRequest:
    """Return a request for real-time frames of 64 x 36 pixels."""
    sampling = SamplingSettings(viewport_samples=samples, integrator=Integrator.REALTIME)
    return request(**{"settings": RenderSettings(sampling=sampling, debug=DebugSettings(view=view))} | changes)


@pytest.fixture
def make_worker():
    """Return a function that starts a worker over a fresh FakeSession class; all are stopped afterwards."""
    workers = []
    fakes.FakeSession.step_seconds, fakes.FakeSession.fail_in = 0.0, ""
    fakes.FakeSession.opened.clear()

    def make(factory=fakes.FakeSession, library=None):
        worker = ViewportWorker(factory, fakes.no_build, lambda device: None, library)
        workers.append(worker)
        worker.start()
        return worker

    yield make
    fakes.FakeSession.step_seconds = 0.0
    for worker in workers:
        worker.stop()
        assert worker.join(WAIT)


def test_frames_that_are_recorded_tell_no_speed(make_worker):
    """Take the speed from frames that only replay their launches, wherever among them one is recorded anew."""

    class Recording(fakes.FakeSession):
        """Records the third frame and the fourth, which take long."""

        def step(self, samples=1, should_stop=None):
            slow = len(self.steps) in (2, 3)
            fakes.FakeSession.step_seconds = 0.1 if slow else 0.0
            self.pipeline.records += int(slow)
            return super().step(samples, should_stop)

    worker = make_worker(Recording)
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(frames(samples=6))
    until(lambda: fakes.FakeSession.opened and len(fakes.FakeSession.opened[-1].steps) >= 6)
    until(lambda: worker._control.seconds_per_sample is not None)
    assert worker._control.seconds_per_sample * 64 * 36 < 0.05


def test_refines_from_coarse_to_full_and_rests(make_worker):
    """Go from coarse to full resolution, stop at the sample limit, and then do nothing."""
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    assert worker.post_view(request())
    until(lambda: worker.picture is not None and worker.picture.samples == 8)
    until(lambda: not worker.status.busy)
    sizes = [config[2:4] for config in fakes.FakeSession.opened[0].configured]
    assert sizes[0] == (16, 9) and sizes[-1] == (64, 36), sizes
    assert worker.status.text == "Sample 8/8"
    serial, start = worker.status.serial, time.thread_time()
    time.sleep(0.1)
    assert worker.status.serial == serial and time.thread_time() - start < 0.05


def test_one_sample_is_one_at_full_size(make_worker):
    """End at full resolution even where the coarse picture has as many samples as asked for."""
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(request(samples=1))
    until(lambda: worker.picture is not None and not worker.status.busy)
    assert worker.picture.divider == 1 and fakes.FakeSession.opened[0].configured[0][2:4] == (16, 9)


def test_equal_views_change_nothing(make_worker):
    """Tell that an equal request is no news; more samples of the same view go on where they were."""
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    assert worker.post_view(request())
    assert not worker.post_view(request())
    until(lambda: not worker.status.busy)
    configured = len(fakes.FakeSession.opened[0].configured)
    assert worker.post_view(request(samples=12))
    until(lambda: worker.picture.samples == 12)
    added = fakes.FakeSession.opened[0].configured[configured:]
    assert all(config[2:4] == (64, 36) for config in added), added


def test_first_picture_survives_navigation(make_worker):
    """Finish each coarse picture while views arrive faster than pictures."""
    fakes.FakeSession.step_seconds = 0.03
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    serials = set()
    for i in range(60):
        worker.post_view(request(camera=CameraData(focus_distance=1.0 + i)))
        time.sleep(0.005)
        if worker.picture is not None:
            serials.add(worker.picture.serial)
    assert len(serials) >= 4, serials


def test_realtime_keeps_its_size_while_moving(make_worker):
    """Show real-time frames of one coarse size while views arrive, and go to full size only once they stop."""
    class ProcessorSession(fakes.FakeSession):
        device_name = "cpu"

    fakes.FakeSession.step_seconds = 0.03
    worker = make_worker(ProcessorSession)
    worker.post_scene(SceneDelta(full=True))
    serials = set()
    for i in range(100):
        worker.post_view(frames(camera=CameraData(focus_distance=1.0 + i)))
        time.sleep(0.005)
        if worker.picture is not None:
            serials.add(worker.picture.serial)
    sizes = {config[2:4] for config in fakes.FakeSession.opened[0].configured}
    assert len(serials) >= 8, serials
    assert len(sizes) == 1 and sizes != {(64, 36)}, sizes
    until(lambda: worker.status.text == "Frame 8/8" and worker.picture.divider == 1)
    sizes = [config[2:4] for config in fakes.FakeSession.opened[0].configured]
    assert sizes[-1] == (64, 36) and len(set(sizes)) == 2, sizes


def test_realtime_shows_every_early_frame(make_worker):
    """Show each of the first frames at rest, and measure a frame's sections now and then."""
    fakes.FakeSession.step_seconds = 0.01
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(frames(samples=0, settings=dataclasses.replace(
        frames(samples=0).settings, performance=PerformanceSettings(viewport_pixel_size=1))))
    seen = {}
    end = time.perf_counter() + WAIT
    while len(seen) < 20 and time.perf_counter() < end:
        if worker.picture is not None:
            seen[worker.picture.samples] = worker.picture.serial
        time.sleep(0.002)
    assert list(seen) == list(range(min(seen), min(seen) + 20)), seen
    assert worker.status.frame_times == {"Surfaces": 1.0, "Composite": 0.5}
    timed = [flag for _, flag in fakes.FakeSession.opened[0].steps]
    assert 1 <= sum(timed) <= 3, timed


def test_pictures_at_rest_are_denoised(make_worker):
    """Show frames as they are, then none that is not denoised, and the last one whenever it comes."""
    class Traced(fakes.FakeSession):
        """Has a path-traced sample for every frame from the eighth on."""

        denoised: list[int] = []

        @property
        def traced_samples(self):
            return max(self.samples_done - 8, 0)

        def resolve_denoised(self, library, should_stop):
            assert library == "library" and not should_stop()
            self.denoised.append(self.samples_done)
            time.sleep(0.02)
            return self.samples_done

    fakes.FakeSession.step_seconds = 0.005
    worker = make_worker(Traced, "library")
    shown = []
    publish, worker._publish = worker._publish, lambda *arguments: (shown.append(arguments[2]), publish(*arguments))
    worker.post_scene(SceneDelta(full=True))
    settings = frames(samples=60).settings
    worker.post_view(frames(settings=dataclasses.replace(
        settings, performance=PerformanceSettings(viewport_pixel_size=1))))
    until(lambda: worker.status.text == "Frame 60/60" and not worker.status.busy)
    first = next(samples for samples in Traced.denoised)
    assert 16 <= first <= 18 and Traced.denoised[-1] == 60 and len(Traced.denoised) < 12
    assert [samples for samples in shown if samples >= first] == Traced.denoised
    assert len([samples for samples in shown if samples < 16]) >= 8


def test_another_debug_view_is_shown_at_rest(make_worker):
    """Render one more frame when only the debug view changes after the last one."""
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(frames())
    until(lambda: not worker.status.busy and worker.picture is not None)
    serial = worker.picture.serial
    assert worker.post_view(frames(view="cache.cells"))
    until(lambda: worker.picture.serial > serial and not worker.status.busy)
    assert fakes.FakeSession.opened[0].settings.debug.view == "cache.cells"
    assert worker.status.text.endswith("| cache.cells")


def test_stop_is_quick_and_closes_the_session(make_worker):
    """End within 0.2 s in the middle of a slow sample, and free the session."""
    fakes.FakeSession.step_seconds = 30.0
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(request())
    until(lambda: fakes.FakeSession.opened and fakes.FakeSession.opened[0].configured)
    start = time.perf_counter()
    worker.stop()
    assert worker.join(WAIT)
    assert time.perf_counter() - start < 0.2
    assert fakes.FakeSession.opened[0].closed


@pytest.mark.parametrize("failure", ["update", "configure", "step", "read"])
def test_failure_ends_with_a_sentence(make_worker, failure):
    """Keep the error, free the session and end the thread."""
    fakes.FakeSession.fail_in = failure
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(request())
    until(lambda: not worker.alive)
    assert worker.failed and "made to fail" in worker.status.error
    assert not worker.status.busy and fakes.FakeSession.opened[0].closed


def test_unavailable_device_is_its_own_sentence(make_worker):
    """Pass on an engine error's sentence unchanged."""
    def refuse(settings):
        raise DeviceUnavailable("No CUDA device was found")

    worker = make_worker(refuse)
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(request())
    until(lambda: not worker.alive)
    assert worker.status.error == "No CUDA device was found"


def test_scene_changes_are_kept_until_the_first_view(make_worker):
    """Apply all scene changes in order, also those posted before the first view."""
    worker = make_worker()
    deltas = [SceneDelta(full=True), SceneDelta(lights=[])]
    for delta in deltas:
        worker.post_scene(delta)
    time.sleep(0.02)
    assert not fakes.FakeSession.opened
    worker.post_view(request())
    until(lambda: worker.picture is not None)
    assert fakes.FakeSession.opened[0].updates == deltas


def test_posting_never_blocks(make_worker):
    """Return from posts at once while the thread is busy with a long update."""
    gate = threading.Event()

    class SlowSession(fakes.FakeSession):
        def update(self, delta, progress=None):
            gate.wait(WAIT)

    worker = make_worker(SlowSession)
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(request())
    start = time.perf_counter()
    for i in range(100):
        worker.post_view(request(camera=CameraData(focus_distance=1.0 + i)))
        worker.post_scene(SceneDelta(lights=[]))
    assert time.perf_counter() - start < 0.1
    gate.set()


def test_resize_storm(make_worker):
    """Follow a hundred sizes and end with a picture of the last one."""
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    for i in range(100):
        worker.post_view(request(width=1 + 7 * i % 90, height=1 + 5 * i % 60))
    last = request(width=33, height=21)
    worker.post_view(last)
    until(lambda: not worker.status.busy)
    assert worker.picture.pixels.shape == (21, 33) and worker.picture.samples == 8


@pytest.mark.parametrize("changes", [{"camera": CameraData(kind=CameraKind.EQUIRECTANGULAR)}, {"traced": True}])
def test_what_frames_do_not_know_is_samples(make_worker, changes):
    """Refine panoramas and fog from coarse pixels as path-traced ones, and say samples, whatever the integrator is."""
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(frames(view="gbuffer.normal", **changes))
    until(lambda: not worker.status.busy)
    assert worker.status.text == "Sample 8/8" and worker.picture.samples == 8


def test_crop_is_rendered_alone(make_worker):
    """Render only a crop's pixels and say where they belong."""
    worker = make_worker()
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(request(crop=(16, 9, 32, 18)))
    until(lambda: not worker.status.busy)
    assert worker.picture.pixels.shape == (18, 32)
    assert worker.picture.area == (0.25, 0.25, 0.75, 0.75)


def test_divided_crop_covers():
    """Cover the crop at every divider, with at least a pixel."""
    for divider in (1, 2, 3, 16):
        x, y, width, height = divided_crop((5, 7, 31, 1), divider)
        assert x * divider <= 5 and (x + width) * divider >= 36
        assert y * divider <= 7 and (y + height) * divider >= 8
    assert picture_area(request(), 4) == (0.0, 0.0, 1.0, 1.0)


def test_coarse_pictures_are_plain():
    """Spend nothing on more rays and pixels where there are to be fewer, and change nothing at the full size."""
    settings = request().settings
    assert divided_settings(settings, 1) is settings
    coarse = divided_settings(settings, 2)
    assert not coarse.probes.dense_small and not coarse.denoiser.supersample_small
    assert dataclasses.replace(coarse, probes=settings.probes, denoiser=settings.denoiser) == settings


def test_restarts_follow_the_settings():
    """Start anew for another view or seed, go on for another number of samples."""
    old = request()
    assert restarts(old, None)
    assert not restarts(request(samples=99), old)
    assert restarts(request(width=65), old)
    seeded = dataclasses.replace(old.settings, sampling=dataclasses.replace(old.settings.sampling, seed=5))
    assert restarts(dataclasses.replace(old, settings=seeded), old)


def test_session_that_resolves_on_its_device(make_worker):
    """Pack on the device where the session gives its picture there: the same pixels as packing on the host."""
    import numpy as np
    import warp as wp

    class ResolvingSession(fakes.FakeSession):
        device = "cpu"

        def resolve(self):
            return wp.array(self.read().reshape(-1, 4), dtype=wp.vec4, device=self.device)

    worker = make_worker(ResolvingSession)
    worker.share_pictures = True  # Without CUDA it must make no difference.
    worker.post_scene(SceneDelta(full=True))
    worker.post_view(request(crop=(8, 4, 40, 20)))
    until(lambda: not worker.status.busy)
    expected = pack_colors(fakes.FakeSession.opened[0].read())
    assert worker.picture.packed and worker.device == "cpu"
    np.testing.assert_array_equal(worker.picture.pixels.view(np.uint32), expected.view(np.uint32))
