# SPDX-License-Identifier: GPL-3.0-or-later
"""The denoiser of reflections on a plane under a ceiling of known light: energy, width of highlights, sharpness."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.reflection_denoise import ReflectionDenoisePass, filter_passes
from burnish.engine.settings import DenoiserSettings
from burnish.kernels.reflection_types import LOBE_TRANSMISSION

from tests.device import DEVICE
from tests.reflection_frames import ReflectionFrames


def even(x, y):
    """Return light of 1 everywhere."""
    return np.ones_like(x)


def test_constant_light_stays_exact() -> None:
    """Bring samples that all hold the same to every pixel, unchanged."""
    for settings in ({}, {"reflection_iterations": 1}, {"reflection_iterations": 6}, {"reflection_temporal": False}):
        frames = ReflectionFrames(size=27, stride=2, roughness=np.linspace(0.0, 0.6, 27), jitter=True, **settings)
        for rest in (0, 0, 1, 100, 200):
            place, pixels, valid = frames.place_all()
            direction, pdf, _, distance = frames.trace(pixels, even)
            frames.give(place, valid, np.full(len(place), 0.75), distance, direction, pdf)
            assert (frames.show(rest=rest) == 0.75).all(), settings


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.6])
def test_white_light_gives_the_albedo(roughness: float) -> None:
    """Keep the mean of f cos / density under even light, which is the albedo."""
    frames = ReflectionFrames(roughness=roughness)
    albedo = frames.truth(even, 200).mean()
    for _ in range(32):
        frames.draw(even)
        picture = frames.show()
    np.testing.assert_allclose(picture.mean(), albedo, rtol=0.008)


@pytest.mark.slow
@pytest.mark.parametrize(("size", "tolerance"), [(24, 0.015), (96, 0.015)])
def test_small_lamps_keep_their_light(size: int, tolerance: float) -> None:
    """Neither lose nor gain light of a lamp of few pixels over 64 frames at rest, against the samples given.

    All roughnesses together: what single ones are off by is the noise of samples that count for differently much.
    """
    ratios = []
    for seed, roughness in enumerate((0.05, 0.1, 0.2, 0.4) * (10 if size < 50 else 1)):
        frames = ReflectionFrames(size=size, window=0.8, depth=2.0, ceiling=1.9, roughness=roughness, seed=seed)
        given = 0.0
        for rest in range(64):
            place, pixels, valid = frames.place_all(rest)
            direction, pdf, values, distance = frames.trace(
                pixels, lambda x, y: np.where((np.abs(x - 0.1) < 0.125) & (np.abs(y) < 0.125), 20.0, 0.0))
            frames.give(place, valid, values, distance, direction, pdf)
            picture = frames.show(rest=rest)
            given += values[valid].mean() / 64
        ratios.append(picture.mean() / given)
    assert np.mean(ratios) == pytest.approx(1.0, abs=tolerance)
    assert np.abs(np.array(ratios) - 1.0).max() < 0.15


def test_mirrors_leave_early_frames_behind() -> None:
    """Forget what a mirror's pixels showed in the first frames as fast as rough surfaces do."""
    frames = ReflectionFrames(roughness=0.0)
    for index in range(64):
        # Late enough for no change to be looked for.
        frames.draw(even if index >= 24 else lambda x, y: 0 * x + 3.0)
        frames.row["frame"] = index
        picture = frames.show(rest=index, light_age=index)
    # The plain mean is 1.75.
    assert picture.mean() < 1.4


def test_filters_shrink_at_rest() -> None:
    """Filter ever less at rest, where the mean is noisy as where it is clean: all pixels alike, so that none loses."""
    def stays(noise, rest):
        frames = ReflectionFrames(roughness=0.4, window=0.05, reflection_cleanup=False)
        for index in range(rest):
            frames.draw(even, lambda rng, count: rng.lognormal(-0.5 * noise**2, noise, count))
            frames.show(rest=index)
        # A lone bright sample: how much of it stays in its pixel.
        place, pixels, valid = frames.place_all()
        direction, pdf, values, distance = frames.trace(pixels, even)
        values[:] = 1.0
        values[8 * 16 + 8] = 100.0
        frames.give(place, valid, values, distance, direction, pdf)
        frames.show(rest=rest)
        light = frames.denoiser.filtered.light.numpy().view(np.float16).reshape(-1, 4)[:, 0]
        return light.max()

    assert stays(0.02, 16) < 5.0
    for noise in (0.02, 2.0):
        assert stays(noise, 200) > 15.0, noise


def rms_width(profile):
    """Return the standard deviation of a profile about its mean [px]."""
    x = np.arange(len(profile))
    middle = (profile * x).sum() / profile.sum()
    return np.sqrt((profile * (x - middle) ** 2).sum() / profile.sum())


@pytest.mark.slow
def test_thin_lamps_keep_light_and_width_at_rest() -> None:
    """Show a thin strip light before a dark, far world as bright and as wide as its samples are, after a while at rest.

    Frames that miss it see far: neither they nor the pixels that have missed it so far may count for more.
    """
    shown = truth = 0.0
    for seed in range(3):
        frames = ReflectionFrames(size=40, window=0.8, depth=2.0, ceiling=1.9, roughness=0.2, seed=seed)

        def strip(x, y):
            return np.where(np.abs(x) < 0.03, 20.0, 0.0)

        truth = truth + frames.truth(strip, 400).mean(0)
        for rest in range(96):
            place, pixels, valid = frames.place_all()
            direction, pdf, values, distance = frames.trace(pixels, strip)
            frames.give(place, valid, values, np.where(values > 0.0, distance, 6e4), direction, pdf)
            frames.row["frame"] = rest
            picture = frames.show(rest=rest, light_age=rest)
        shown = shown + picture.mean(0)
    assert shown.sum() / truth.sum() == pytest.approx(1.0, abs=0.03)
    middle = slice(8, -8)
    assert rms_width(shown[middle]) / rms_width(truth[middle]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("resting", [False, True])
@pytest.mark.parametrize("roughness", [0.1, 0.3])
def test_noise_keeps_its_mean(roughness: float, resting: bool) -> None:
    """Neither darken nor brighten noisy samples, sparks among them, over 64 frames."""
    frames = ReflectionFrames(size=64, roughness=roughness)
    given = []

    def noise(rng, count):
        values = rng.lognormal(-0.5, 1.0, count)
        given.append(values.mean())
        return values

    for index in range(64):
        frames.draw(even, noise)
        picture = frames.show(rest=index if resting else 0)
    np.testing.assert_allclose(picture.mean() / np.mean(given[-32:] if not resting else given), 1.0, atol=0.015)
    # Means of mirrors in motion are short.
    assert picture.std() < (0.25 if resting or roughness > 0.2 else 0.3)


def test_ramp_stays_a_ramp() -> None:
    """Neither flatten nor shift light that rises evenly."""
    frames = ReflectionFrames(size=48, window=0.1, roughness=0.1)
    slope = 1.0 / (frames.pixel * 48)

    def light(x, y):
        # Limited: the mean of an endless ramp over GGX's tails does not settle.
        return np.clip(2.0 + slope * x, 1.0, 3.0)

    truth, mean = frames.truth(light, 300), 0.0
    for _ in range(48):
        frames.draw(light)
        mean = mean + frames.show() / 48
    # Away from the picture's borders, where neighbours are missing on one side.
    inner = slice(12, -12)
    np.testing.assert_allclose(mean[inner].mean(0)[inner], truth[inner].mean(0)[inner], rtol=0.015)


def half_width(profile):
    """Return the width of a peak at half its height."""
    middle, half = int(profile.argmax()), profile.max() / 2
    right = middle + int(np.argmax(profile[middle:] < half))
    left = middle - int(np.argmax(profile[middle::-1] < half))
    right -= (half - profile[right]) / (profile[right - 1] - profile[right])
    left += (half - profile[left]) / (profile[left + 1] - profile[left])
    return right - left


def highlight(roughness, width, **settings):
    """Return the profiles of a strip light's reflection, true and filtered, whose lobe is so many pixels wide."""
    size = 12 * width // 2 * 2 + 8
    frames = ReflectionFrames(
        size=size, window=1.1 * roughness**2 / (2 * width) * size, roughness=roughness, reflection_temporal=False,
        **settings)
    strip = width * frames.pixel / 2

    def light(x, y):
        return np.where(np.abs(x) < strip, 10.0, 0.0)

    truth, mean, count = frames.truth(light, 300).mean(0), 0.0, 40
    for _ in range(count):
        frames.draw(light)
        mean = mean + frames.show().mean(0) / count
    return truth, mean


@pytest.mark.parametrize("roughness", [0.1, 0.2, 0.4])
def test_highlights_keep_their_width(roughness: float) -> None:
    """Show the reflection of a strip light as wide as GGX makes it, with the same energy."""
    truth, mean = highlight(roughness, 6)
    assert half_width(mean) / half_width(truth) == pytest.approx(1.0, abs=0.1)
    assert mean.sum() / truth.sum() == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_published_weights_narrow_and_darken() -> None:
    """Do what the published weights do where they are asked for: too narrow and dark."""
    truth, mean = highlight(0.2, 12, reflection_ratio=False, reflection_cleanup=False)
    assert half_width(mean) / half_width(truth) < 0.9
    assert mean.sum() / truth.sum() < 0.5


@pytest.mark.parametrize("roughness", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("stride", [1, 2, 4])
def test_first_frame_has_no_holes(roughness: float, stride: int) -> None:
    """Fill all pixels in the first frame, mirrors too, from samples of blocks that reach over the picture's edge."""
    frames = ReflectionFrames(size=29, stride=stride, roughness=roughness)
    frames.draw(even)
    # A block at the edge may have its only pixel outside drawn: its pixels live on its neighbours.
    assert (frames.show(restart=1) > 0.5).all()


def test_pixels_without_reflection_are_left_out() -> None:
    """Write 0 where nothing is sampled, and take nothing from there."""
    frames = ReflectionFrames(size=16)
    specular = np.full((16, 16), 0xFFFFFFFF, np.uint32)
    specular[:, 8:] = 0
    frames.gbuffer.specular.assign(specular.reshape(-1))
    frames.draw(lambda x, y: np.where(x > 0, 50.0, 1.0))
    picture = frames.show()
    assert (picture[:, 8:] == 0.0).all() and (picture[:, :8] > 0.0).all()


def test_mirror_is_sharp_at_rest() -> None:
    """Let each pixel of a mirror become what its own samples show: a checker of 3 x 3 pixels."""
    frames = ReflectionFrames(size=48, window=0.1, roughness=0.0)
    cell = 6 * frames.pixel

    def light(x, y):
        return (np.floor(x / cell) + np.floor(y / cell)) % 2

    truth = frames.truth(light, 200)
    for rest in range(64):
        frames.draw(light)
        picture = frames.show(rest=rest)
    # The lobe's tails leave noise in 16 samples each; a pixel that took its neighbours' would be off by 0.3.
    assert np.sqrt(((picture - truth) ** 2).mean()) < 0.1
    assert np.abs((picture - truth).mean()) < 0.01


def test_sparks_are_spread_without_loss() -> None:
    """Turn a single bright sample into a faint glow of the same energy, none at all after a while at rest."""
    def peak(rest, **settings):
        frames = ReflectionFrames(size=32, window=0.05, roughness=0.02, reflection_temporal=False, **settings)
        place, pixels, valid = frames.place_all()
        place[:], values = 0, np.ones(256)
        pixels = np.arange(256) // 16 * 2 * 32 + np.arange(256) % 16 * 2
        values[8 * 16 + 8] = 101.0
        direction, pdf, _, distance = frames.trace(pixels, even)
        frames.give(place, valid, values, distance, direction, pdf)
        picture = frames.show(rest=rest)
        return picture.max(), picture[::2, ::2].sum()

    strongest, energy = peak(0)
    assert strongest < 12.0 and energy == pytest.approx(356.0, rel=0.05)
    assert peak(0, reflection_cleanup=False)[0] > 60.0
    assert peak(100)[0] > 60.0


def test_missing_samples_are_filled() -> None:
    """Fill blocks whose samples are missing from their neighbours."""
    frames = ReflectionFrames(size=32, roughness=0.3, reflection_temporal=False)
    for index in range(2):
        frames.draw(even)
        pdf = frames.samples.pdf.numpy()
        pdf[frames.rng.random(len(pdf)) < 0.3] = 0.0
        radiance = frames.samples.radiance.numpy().view(np.float16).reshape(-1, 4)
        radiance[pdf == 0.0] = np.nan if index else 0.0
        frames.samples.pdf.assign(pdf)
        frames.samples.radiance.assign(radiance.view(np.uint64).reshape(-1))
        # The least are samples that left the lobe below the horizon.
        assert frames.show().min() > 0.5


@pytest.mark.parametrize("roughness", [0.02, 0.3])
def test_light_edits_cut_the_history(roughness: float) -> None:
    """Forget the light from before an edit, in a mirror's unsampled pixels too."""
    frames = ReflectionFrames(roughness=roughness)
    for rest in range(40):
        frames.draw(even)
        frames.show(rest=rest)
    means = []
    for age in range(4):
        frames.draw(lambda x, y: 0 * x)
        means.append(frames.show(light_age=age).mean())
    assert means[0] < 0.3 and means[3] < 0.03


@pytest.mark.parametrize("roughness", [0.02, 0.3])
def test_changes_are_followed(roughness: float) -> None:
    """Leave light behind that has changed without notice."""
    frames = ReflectionFrames(roughness=roughness)
    for _ in range(64):
        frames.draw(even)
        frames.show()
    for _ in range(12):
        frames.draw(lambda x, y: 0 * x + 0.3)
        picture = frames.show()
    assert picture.mean() < 0.4


def test_early_frames_are_left_behind() -> None:
    """Reach back over only half of the frames since light began to spread."""
    frames = ReflectionFrames(roughness=0.3)
    for index in range(24):
        frames.draw(even)
        frames.row["frame"] = index
        frames.show(rest=index, light_age=index)
    assert 8.0 < np.abs(frames.state()[..., 0]).mean() < 14.0


def moving_mirror(steps=16, moved=False, **arguments):
    """Return the error of what a moving camera sees in a mirror.

    The pattern lies five times as far behind the mirror as the camera before it. With `moved` the mirror is said to
    have moved, within its plane.
    """
    frames = ReflectionFrames(size=40, roughness=0.02, window=0.1, ceiling=25.0, seed=3, **arguments)
    period = 8 * frames.pixel * (1.0 if frames.orthographic else 6.0)

    def light(x, y):
        return 1 + 0.8 * np.sin(2 * np.pi * x / period)

    if moved:
        material = frames.gbuffer.material.numpy()
        frames.gbuffer.material.assign(material | np.uint32(1 << 26))
    for step in range(steps):
        frames.draw(light)
        picture = frames.show()
        truth = frames.truth(light, 32)
        if step < steps - 1:
            frames.move(frames.place_x + 2.3 * frames.pixel)
    inner = slice(6, -6)
    return np.sqrt(((picture - truth)[inner, inner] ** 2).mean())


def test_reflections_move_with_their_image() -> None:
    """Follow what a mirror shows, not the mirror: each frame's light alone is that of pixels nearby."""
    alone = moving_mirror(reflection_temporal=False)
    for error in (moving_mirror(), moving_mirror(moved=True), moving_mirror(orthographic=True)):
        assert error < 0.16 and error < 0.7 * alone


def test_glass_keeps_its_own_samples() -> None:
    """Filter what rough glass lets through, nothing of what clear glass does."""
    for roughness, least, most in ((0.0, 0.8, 1.6), (0.5, 0.0, 0.3)):
        frames = ReflectionFrames(
            roughness=roughness, lobe=LOBE_TRANSMISSION, window=0.05, reflection_temporal=False, stride=1)
        frames.draw(even, lambda rng, count: rng.lognormal(-0.125, 0.5, count))
        spread = frames.show().std()
        assert least * 0.5 < spread < most, (roughness, spread)


def test_passes_double_and_only_later_ones_widen() -> None:
    """Have the published steps at half resolution, and count what widens the lobe."""
    passes = filter_passes(DenoiserSettings(), 2, 0, True)
    assert [part.spacing for part in passes] == [1, 1, 2, 4]
    assert [part.radius for part in passes] == [1, 2, 2, 2]
    assert passes[1].before == 0.0 and passes[3].before == pytest.approx(1.065**2 * (4 + 16))
    assert filter_passes(DenoiserSettings(), 2, LOBE_TRANSMISSION, True)[1].before == pytest.approx(1.065**2)


def test_views_belong_to_one_lobe() -> None:
    """Draw every view of the reflections as finite colours; glass has none of its own."""
    assert not ReflectionDenoisePass(DEVICE, lobe=LOBE_TRANSMISSION).debug_views
    frames = ReflectionFrames()
    for _ in range(2):
        frames.draw(even, lambda rng, count: rng.lognormal(0.0, 0.5, count))
        frames.show()
    for name in frames.denoiser.debug_views:
        picture = wp.zeros(frames.size**2, dtype=wp.vec4, device=DEVICE)
        graph = FrameGraph(DEVICE)
        frames.denoiser.record_debug(graph, 1, name, picture)
        graph.replay()
        shown = picture.numpy()
        assert np.isfinite(shown).all() and shown[:, :3].max() > 0.0, name
