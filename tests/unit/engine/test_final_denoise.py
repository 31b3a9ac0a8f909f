# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the denoising of final pictures: its guides, its library's device and filter, its limit, its schedule."""

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from burnish.engine import oidn
from burnish.engine.errors import BurnishError
from burnish.engine.passes import final_denoise
from burnish.engine.session import DENOISED, Session
from burnish.engine.settings import DenoiserSettings, Integrator

from tests import scenes
from tests.denoised_room import BOTH, SIZE, open_session, room, settings_of
from tests.device import DEVICE

NAMES = ("libOpenImageDenoise.so.2", "libOpenImageDenoise.dylib", "OpenImageDenoise.dll")


@pytest.fixture(scope="module")
def library():
    """Return the library of the installed Blender module."""
    spec = importlib.util.find_spec("bpy")
    folders = [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []
    found = [path for folder in folders for name in NAMES for path in folder.rglob(name)]
    if not found:
        pytest.skip("there is no Open Image Denoise")
    yield oidn.load(found[0])
    oidn.release()


def error(picture, truth):
    """Return the RMS error of the colours."""
    return float(np.sqrt(np.mean((picture[..., :3] - truth[..., :3]) ** 2)))


@pytest.fixture(scope="module")
def truth():
    """Return the room without noise."""
    made = open_session(Integrator.REFERENCE)
    made.step(1024)
    return made.read()


@pytest.mark.parametrize("integrator", BOTH)
def test_noise_goes_detail_stays(library, truth, integrator):
    """Leave less than a fifth of four samples' error, the same a second time, and the plain picture as it is."""
    made = open_session(integrator)
    made.step(4)
    plain = made.read()
    denoised = made.read_denoised(library)
    assert error(denoised, truth) < 0.2 * error(plain, truth)
    np.testing.assert_array_equal(made.read(), plain)
    np.testing.assert_allclose(made.read_denoised(library), denoised, rtol=1e-5)
    # The boxes' edges and colours are still there.
    assert error(denoised, truth) < 0.6 * float(np.std(truth[..., :3]))


def test_frames_are_denoised_without_samples(library, truth):
    """Denoise what real-time frames make where path tracing at rest is off."""
    settings = replace(settings_of(Integrator.REALTIME), denoiser=DenoiserSettings(path_traced_rest=False))
    made = Session(settings)
    made.update(room())
    made.configure(settings, scenes.camera_above(3.0, 1.0), *SIZE, passes=("Combined", DENOISED))
    made.step(4)
    assert made._realtime.frames == 4
    assert error(made.read_denoised(library), truth) < 1.2 * error(made.read(), truth)


@pytest.mark.parametrize("integrator", BOTH)
def test_alpha_is_kept(library, integrator):
    """Keep the alpha of a transparent film."""
    made = open_session(integrator, camera=scenes.camera_above(3.0, 5.0), transparent=True)
    made.step(4)
    plain, denoised = made.read(), made.read_denoised(library)
    assert 0.0 == plain[..., 3].min() < plain[..., 3].max() == 1.0
    np.testing.assert_allclose(denoised[..., 3], plain[..., 3], atol=1e-6)
    assert np.isfinite(denoised).all()


def test_guides_of_few_samples_are_denoised_once(monkeypatch):
    """Free the guides of their noise before the picture is denoised with them, unless they are of many samples."""
    asked = []

    def filtered(library, images, processor=False):
        asked.append(images.prefilter)
        wp.copy(images.output, images.color)
        return "cpu"

    monkeypatch.setattr(final_denoise.oidn, "denoise", filtered)
    made = open_session(Integrator.REFERENCE, passes=("Combined",))
    monkeypatch.setattr(final_denoise, "GUIDE_SAMPLES", (1, 4))
    monkeypatch.setattr(final_denoise, "PROCESSOR_GUIDES", 1)
    for more in (3, 1, 4, 8):  # Guides of 1 for up to 7 samples, 2 for 8, 4 for 16.
        made.step(more)
        made.read_denoised(None)
    assert asked == [True, False, True, False]


def test_few_samples_are_denoised_in_haste(monkeypatch):
    """Leave the guides of one or two samples as they are on the processor, and say that they are noisy."""
    if DEVICE != "cpu":
        pytest.skip("a GPU has the time to clean them")
    asked = []

    def filtered(library, images, processor=False):
        asked.append((images.prefilter, images.clean))
        wp.copy(images.output, images.color)
        return "cpu"

    monkeypatch.setattr(final_denoise.oidn, "denoise", filtered)
    made = open_session(Integrator.REFERENCE)
    for _ in range(4):
        made.step(1)
        made.read_denoised(None)
    assert asked == [(False, False), (False, False), (True, True), (True, True)]


def test_guides_are_filtered_in_place(library):
    """Take noise off the guides themselves, and leave them alone unless asked."""
    rng = np.random.default_rng(2)
    noisy = wp.array(rng.random((32 * 32, 3)).astype(np.float32), dtype=wp.vec3, device="cpu")
    made = replace(images((32, 32)), albedo=noisy, normal=wp.zeros(32 * 32, dtype=wp.vec3, device="cpu"))
    before = noisy.numpy().copy()
    oidn.denoise(library, made)
    assert (noisy.numpy() == before).all()
    oidn.denoise(library, replace(made, prefilter=True))
    assert noisy.numpy().std() < 0.6 * before.std()


@pytest.mark.slow
def test_limit_is_the_samples_mean(monkeypatch):
    """Whatever the denoiser makes, converge to the samples; keep a pixel that it has spoilt."""
    def spoil(value):
        def filtered(library, images, processor=False):
            images.output.fill_(wp.vec4(value, value, value, 1.0))
            return "cpu"
        monkeypatch.setattr(final_denoise.oidn, "denoise", filtered)

    made = open_session(Integrator.REFERENCE)
    made.step(8)
    spoil(float("nan"))
    np.testing.assert_allclose(made.read_denoised(None), made.read(), rtol=1e-4, atol=1e-5)
    spoil(3.0)
    few = error(made.read_denoised(None), made.read())
    made.step(792)
    many = error(made.read_denoised(None), made.read())
    assert few > 1.0
    # The mean itself is not far from right now; its own share would leave EVEN / (EVEN + 800) of the error.
    assert many < few * 1.2 * final_denoise.EVEN_SAMPLES / (final_denoise.EVEN_SAMPLES + 800)


def test_every_step_is_a_sample():
    """Trace samples alone for a picture that will be denoised, after the frames of its light passes if it has any."""
    made = open_session(Integrator.REALTIME)
    assert made.step(5) == 5
    assert made._realtime.reference.samples_done == 5 and not made._realtime.shows_frames
    made.configure(made.settings, scenes.camera_above(3.0, 1.0), *SIZE, passes=("Combined", DENOISED, "Diffuse Color"))
    made.step(20)
    assert made._realtime.frames == 16 and made._realtime.reference.samples_done == 4
    assert made.read("Diffuse Color").max() > 0.5
    made.configure(made.settings, scenes.camera_above(3.0, 1.0), *SIZE)
    assert made.samples_done == 0
    made.step(3)
    assert made._realtime.frames == 3


def test_picture_before_the_first_sample(library):
    """Give a black picture, not a failure, where rendering was cancelled at once."""
    for integrator in BOTH:
        made = open_session(integrator)
        made.step(4, lambda: True)
        assert not made.read()[..., :3].any()


def images(size=(16, 16), **fields):
    """Return noise as images of the processor."""
    rng = np.random.default_rng(1)
    pixels = np.concatenate([rng.exponential(1.0, (size[0] * size[1], 3)), np.full((size[0] * size[1], 1), 0.5)], 1)
    color = wp.array(pixels.astype(np.float32), dtype=wp.vec4, device="cpu")
    return oidn.Images(**{"color": color, "output": wp.clone(color), "width": size[0], "height": size[1], **fields})


def test_filter_is_kept(library):
    """Keep the filter for pictures alike, make another for another size, and begin anew after a release."""
    oidn.release()
    first = images()
    assert oidn.denoise(library, first) == "cpu"
    assert np.std(first.output.numpy()[:, 0]) < 0.3 * np.std(first.color.numpy()[:, 0])
    np.testing.assert_array_equal(first.output.numpy()[:, 3], 0.5)
    kept, = oidn._kept.values()
    handle = kept._filters["color"]
    second = images()
    oidn.denoise(library, second)
    assert kept._filters["color"] == handle
    np.testing.assert_allclose(second.output.numpy(), first.output.numpy(), rtol=1e-4)
    oidn.denoise(library, images((24, 8)))
    assert list(oidn._kept.values()) == [kept] and kept._filters["color"][0][:2] == (24, 8)
    oidn.release()
    assert not oidn._kept
    assert oidn.denoise(library, images()) == "cpu"


def test_processor_takes_over_where_cuda_fails(library, monkeypatch, caplog):
    """Filter copies on the processor where the library's CUDA device fails, and say why."""
    real = oidn.keep_denoiser
    tried = []

    def keep(found, ordinal, stream):
        tried.append((ordinal, stream))
        if ordinal >= 0:
            raise BurnishError("Open Image Denoise failed: no driver.")
        return real(found, ordinal, stream)

    monkeypatch.setattr(oidn, "keep_denoiser", keep)
    expected = images()
    oidn.denoise(library, expected)
    made = images()
    device = SimpleNamespace(is_cuda=True, ordinal=0, stream=SimpleNamespace(cuda_stream=5))
    color = SimpleNamespace(device=device, numpy=made.color.numpy, dtype=made.color.dtype)
    assert oidn.denoise(library, replace(made, color=color)) == "cpu"
    assert tried == [(-1, 0), (0, 5), (-1, 0)] and "no driver" in caplog.text
    np.testing.assert_allclose(made.output.numpy(), expected.output.numpy(), rtol=1e-4)


@pytest.mark.skipif("wp.is_cuda_available()")
def test_device_that_is_not_there(library):
    """Say that there is no CUDA device, and leave the processor's usable."""
    with pytest.raises(BurnishError, match="Open Image Denoise failed: .+"):
        oidn.Denoiser(library, 0, 0)
    assert oidn.denoise(library, images()) == "cpu"


def test_wrong_images_are_told(library):
    """Turn the library's complaint into an error, and work again afterwards."""
    with pytest.raises(BurnishError, match="Open Image Denoise failed"):
        oidn.denoise(library, replace(images(), color=wp.empty(0, dtype=wp.vec4, device="cpu")))
    assert oidn.denoise(library, images()) == "cpu"


def test_file_that_is_no_library(tmp_path):
    """Name the file that can't be used."""
    wrong = tmp_path / "libOpenImageDenoise.so.2"
    wrong.write_bytes(b"no library")
    with pytest.raises(BurnishError, match="can't be used"):
        oidn.load(wrong)


@pytest.mark.parametrize("polls", [0, 1, 40])
def test_denoising_stops(library, polls):
    """Give no picture when told to stop, in the guides or in the library, and the right one the next time."""
    if DEVICE != "cpu":
        pytest.skip("a GPU is done before it would be asked")
    made = open_session(Integrator.REFERENCE)
    made.step(8)
    calls = []

    def should_stop():
        calls.append(1)
        return len(calls) > polls

    assert made.resolve_denoised(library, should_stop) is None
    assert len(calls) < polls + 20
    stopped = made.read_denoised(library)
    other = open_session(Integrator.REFERENCE)
    other.step(8)
    np.testing.assert_allclose(stopped, other.read_denoised(library), rtol=1e-4, atol=1e-5)


def test_frames_at_rest_have_a_share(monkeypatch):
    """Mix what is denoised with the picture at rest, more of it where frames are larger than the picture."""
    def filtered(library, images, should_stop):
        images.output.fill_(wp.vec4(3.0, 3.0, 3.0, 1.0))
        return "cpu"

    monkeypatch.setattr(final_denoise.oidn, "denoise", filtered)
    made = open_session(Integrator.REALTIME, passes=("Combined",))
    made.step(16)
    assert made.traced_samples >= 8 and made.denoiser.used == ""
    for factor, share in ((1, final_denoise.FRAMES_SHARE[0]), (2, final_denoise.FRAMES_SHARE[1])):
        monkeypatch.setattr(made._realtime._supersampling, "factor", factor)
        expected = made.read()[..., :3] * share + 3.0 * (1.0 - share)
        np.testing.assert_allclose(made.read_denoised(None)[..., :3], expected, rtol=1e-3)
