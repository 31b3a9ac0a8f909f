# SPDX-License-Identifier: GPL-3.0-or-later
"""Test paths that end in the radiance cache: less noise, the same light, fewer of them the more samples there are."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from burnish.engine import realtime
from burnish.engine.errors import OutOfDeviceMemory
from burnish.engine.passes.wavefront import Wavefront
from burnish.engine.scene import SceneDelta
from burnish.engine.session import DENOISED
from burnish.engine.settings import (
    CacheSettings,
    DebugSettings,
    DenoiserSettings,
    Device,
    Integrator,
    LightPathSettings,
    SamplingSettings,
)
from burnish.kernels.known_light import KnownLight, is_ending

from tests import denoised_room, scenes
from tests.device import DEVICE
from tests.scenes import camera_above

wp.set_module_options({"enable_backward": False})
KIND = "cpu" if scenes.SETTINGS.device == Device.CPU else "cuda"
SIZE = {"cpu": (240, 136), "cuda": (480, 272)}[KIND]
"""Smallest picture, or about it, whose paths end"""
CAPACITY = {"cpu": 18, "cuda": 20}[KIND]
FIRST = realtime.FILLING_AT[KIND][0]
"""Samples before the first frames that fill the cache"""
SAMPLES = 24


def open_session(integrator, passes=("Combined", DENOISED), size=SIZE, delta=None):
    """Open a session on the room, with a cache that has room for its cells and does not race for them."""
    made = denoised_room.open_session(integrator, passes, delta)
    settings = replace(
        made.settings, cache=replace(made.settings.cache, capacity=CAPACITY),
        performance=replace(made.settings.performance, deterministic=True))
    made.configure(settings, camera_above(3.0, 1.0), *size, passes=passes)
    return made


@wp.kernel
def tell_endings(known: KnownLight, endings_out: wp.array[int]):
    """Tell of each sample whether it ends in the cache."""
    sample = wp.tid()
    endings_out[sample] = int(is_ending(known, wp.uint32(sample)))


def endings(samples, count):
    """Return whether each of `count` samples ends in the cache."""
    known, found = KnownLight(), wp.zeros(count, dtype=int, device=DEVICE)
    known.samples = samples
    wp.launch(tell_endings, count, [known], [found], device=DEVICE)
    return found.numpy()


def traced(made, ends, seed=1, samples=SAMPLES):
    """Return a session's picture of samples alone [h, w, 3], and rays a pixel and sample."""
    settings = made.settings
    settings = replace(
        settings, cache=replace(settings.cache, ends_paths=ends), sampling=SamplingSettings(
            integrator=Integrator.REALTIME, seed=seed))
    made.configure(settings, camera_above(3.0, 1.0), *SIZE, passes=("Combined", DENOISED))
    made.reset()
    assert made.step(samples) == samples
    tracer = made._realtime.reference
    return made.read()[..., :3], tracer.rays / (SIZE[0] * SIZE[1] * samples)


@pytest.fixture(scope="module")
def truth():
    """Return the room without noise."""
    made = open_session(Integrator.REFERENCE, passes=("Combined",))
    made.step(96)
    return made.read()[..., :3]


@pytest.mark.slow
def test_ends_take_noise_and_rays_off_and_keep_the_light(truth, monkeypatch):
    """Have two thirds of the squared error with fewer rays, and the light within 2 %, in a hall lit by its ceiling."""
    # On all devices as soon as on a processor.
    monkeypatch.setattr(realtime, "FILLING_AT", dict.fromkeys(("cpu", "cuda"), realtime.FILLING_AT["cpu"]))
    made = open_session(Integrator.REALTIME)
    figures = {}
    for ends in (False, True):
        picture, rays = traced(made, ends)
        figures[ends] = (
            float((((picture - truth) / (truth + 0.01)) ** 2).mean()), float(picture.mean() / truth.mean()), rays)
    print(figures)
    assert figures[True][0] < 0.65 * figures[False][0]
    assert abs(figures[True][1] - 1.0) < 0.02
    assert figures[True][2] < 0.8 * figures[False][2]


def test_later_samples_end_ever_less():
    """End all of the first samples, then a share that falls with their number; none where the cache is not known."""
    found = endings(64, 1 << 16)
    assert found[:64].all()
    for first in (128, 1024, 8192):
        share = found[first:2 * first].mean()
        assert abs(share / (64 * np.log(2.0) / first) - 1.0) < 0.2, (first, share)
    assert not endings(0, 256).any()


@pytest.mark.slow
def test_frames_fill_the_cache_unseen():
    """Have frames between samples that are neither counted nor seen; none in small pictures or with whole paths."""
    made = open_session(Integrator.REALTIME)
    assert made.step(FIRST + 1) == FIRST + 1 and not made._realtime.shows_frames
    each, starts = realtime.FILLING_FRAMES[KIND], realtime.FILLING_AT[KIND]
    assert made._realtime.frames == each
    assert made.step(30 - FIRST) == 31
    assert made._realtime.frames == each * sum(start < 31 for start in starts) == {"cpu": 3, "cuda": 1}[KIND] * each
    _, rays = traced(made, ends=False)
    assert made._realtime.frames == 0 and rays > 2.0
    small = open_session(Integrator.REALTIME, size=(48, 32))
    small.step(FIRST + 3)
    assert small._realtime.frames == 0


def test_unseen_frames_have_surfaces_and_the_cache_alone():
    """Launch and allocate nothing that only a picture needs."""
    made, seen = open_session(Integrator.REALTIME), open_session(Integrator.REALTIME, passes=("Combined",))
    made.step(FIRST + 1)
    seen.step(1)
    sections, all_sections = ({name for name, _ in each.pipeline.launches()} for each in (made, seen))
    assert sections < all_sections and {"Materials", "Probe rays", "Cache cells"} < sections
    assert not {"Composite", "Direct light", "Reflection rays", "Probe blending", "Diffuse denoising"} & sections
    pipeline = made.pipeline
    assert set(pipeline._ready) == {pipeline.gbuffer, pipeline.cache, pipeline.probes}


def test_frames_after_unseen_ones_are_the_first():
    """Forget the probes of unseen frames, which no ray has told its light, before a frame is seen."""
    made, fresh = open_session(Integrator.REALTIME), open_session(Integrator.REALTIME, passes=("Combined",))
    made.step(FIRST + 1)
    made.configure(made.settings, camera_above(3.0, 1.0), *SIZE)
    for each in (made, fresh):
        each.step(2)
    np.testing.assert_array_equal(made.read(), fresh.read())


def test_debug_views_after_unseen_frames_begin_anew():
    """Show what the first frames have, although the picture is going to be denoised: nothing of unseen ones."""
    made, fresh = open_session(Integrator.REALTIME), open_session(Integrator.REALTIME)
    made.step(FIRST + 1)
    for each in (made, fresh):
        shown = replace(each.settings, debug=DebugSettings(view="probes.radiance"))
        each.configure(shown, camera_above(3.0, 1.0), *SIZE, passes=("Combined", DENOISED))
        each.step(2)
        assert each._realtime.shows_frames
    np.testing.assert_array_equal(made.read(), fresh.read())


def test_short_paths_are_traced_to_their_ends():
    """Have no frames where paths soon leave the scene: they would take longer than they save."""
    floor = scenes.delta(
        {"floor": scenes.quad(2.0)}, [("floor", scenes.place(), "white")], {"white": scenes.material(color=0.7)},
        background=0.5)
    made = open_session(Integrator.REALTIME, delta=floor)
    made.step(12)
    assert made._realtime.frames == 0 and made._realtime.reference.rays > 0


def test_frames_that_do_not_fit_are_done_without(monkeypatch):
    """Trace paths to their ends where a device has no memory for frames: the picture alone fits."""
    def fail(self, scene, camera, unseen):
        raise OutOfDeviceMemory("no memory")

    made = open_session(Integrator.REALTIME)
    monkeypatch.setattr(realtime.Realtime, "_frame", fail)
    assert made.step(FIRST + 4) == FIRST + 4 and made._realtime.frames == 0
    assert made.read()[..., :3].max() > 0.0


def test_first_samples_do_without_frames():
    """Trace the first samples at once: they tell whether frames would pay, and a picture of no more is done before."""
    made = open_session(Integrator.REALTIME)
    made.step(FIRST)
    assert made._realtime.frames == 0 and made.counts() == {}


@pytest.mark.parametrize(("limits", "ends"), [
    ({"light_paths": LightPathSettings(max_bounces=4)}, False),
    ({"cache": CacheSettings(capacity=CAPACITY, bounces=2)}, False),
    ({"light_paths": LightPathSettings(max_bounces=32)}, True)])
def test_limits_of_bounces_are_kept(limits, ends):
    """End no path where paths or the cache have fewer bounces than all: one would get the other's light.

    Hardly any light is left beyond a far limit, as the benchmark has.
    """
    made = open_session(Integrator.REALTIME)
    made.configure(replace(made.settings, **limits), camera_above(3.0, 1.0), *SIZE, passes=("Combined", DENOISED))
    made.step(FIRST + 2)
    assert (made._realtime.frames > 0) == ends


@pytest.mark.slow
def test_launches_are_recorded_once(monkeypatch):
    """Record the launches of whole paths and of those that end once; again when arrays that they read are others.

    On a GPU their graph is made with them, which takes as long as three samples.
    """
    records, record = [], Wavefront._record

    def count(self, *arguments):
        records.append(1)
        return record(self, *arguments)

    made = open_session(Integrator.REALTIME)
    made.step(FIRST + 4)
    kept, slots = made._realtime._ending_options, len(made._realtime.reference.slots)
    monkeypatch.setattr(Wavefront, "_record", count)
    for _ in range(2):
        made.reset()
        made.step(FIRST + 4)
    # A thread may have traced nothing of one kind so far.
    assert len(records) <= 2 * slots and made._realtime.frames > 0 and made._realtime._ending_options is kept
    fresh = open_session(Integrator.REALTIME)
    for each in (made, fresh):
        each.update(SceneDelta(materials={"white": scenes.material(color=0.4)}))
        each.step(FIRST + 4)
    assert made.read()[..., :3].mean() == pytest.approx(fresh.read()[..., :3].mean(), rel=0.02)
    # Nothing is left that holds what the scene was before.
    for slot in made._realtime.reference.slots:
        assert len({id(made_for[0]) for made_for, _ in slot._records.values()}) == 1
    made.configure(made.settings, camera_above(3.0, 1.0), SIZE[0], SIZE[1] + 8, passes=("Combined", DENOISED))
    made.step(FIRST + 4)
    assert made._realtime._ending_options is not kept


@pytest.mark.slow
def test_pictures_at_rest_end_paths_too(truth):
    """Come as near to the truth at rest, frames and samples together, with fewer rays."""
    errors, rays = {}, {}
    for ends in (False, True):
        made = open_session(Integrator.REALTIME, passes=("Combined",))
        settings = replace(
            made.settings, cache=replace(made.settings.cache, ends_paths=ends),
            denoiser=DenoiserSettings(rest_frames=16))
        made.configure(settings, camera_above(3.0, 1.0), *SIZE)
        made.step(40)
        assert made._realtime.reference.samples_done > 16
        errors[ends] = float((((made.read()[..., :3] - truth) / (truth + 0.01)) ** 2).mean())
        rays[ends] = made._realtime.reference.rays
    print(errors, rays)
    assert errors[True] < 1.05 * errors[False] and rays[True] < 0.75 * rays[False]
