# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the denoisers where light changes, moves or is bad, and of their plumbing."""

import numpy as np
import pytest
import warp as wp
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.diffuse_denoise import DiffuseDenoisePass
from burnish.engine.passes.direct_denoise import DirectDenoisePass

from tests.denoise_frames import BOTH, LONG_AGO, SIZE, Frames, halves, noise
from tests.device import DEVICE


@BOTH
@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("deviation", [0.0, 0.5])
@pytest.mark.parametrize("dim", [0.0, 0.05])
def test_light_goes_off(make, told, deviation, dim):
    """Forget light that went off, all or but a dim rest: 1 % left after 12 frames when told, 5 % after 16 when not."""
    rng = np.random.default_rng(9)
    frames = Frames(make)
    for _ in range(64):
        frames.show(rng.lognormal(-0.5 * deviation**2, deviation, (SIZE, SIZE)))
    for frame in range(12 if told else 16):
        sample = dim * rng.lognormal(-0.5 * deviation**2, deviation, (SIZE, SIZE))
        result = frames.show(sample, light_age=frame if told else LONG_AGO)
    assert result.mean() == pytest.approx(dim, abs=0.01 if told else 0.05)


@BOTH
def test_light_goes_off_with_few_samples(make):
    """Forget light that went off where only every other frame has a sample, or where new light is not sure."""
    frames = Frames(make)
    checker = np.indices((SIZE, SIZE)).sum(0) % 2
    for _ in range(64):
        frames.show(1.0)
    for frame in range(12):
        weight = (checker + frame) % 2 if make is DirectDenoisePass else 0.3
        result = frames.show(0.0, weight=weight, light_age=frame)
    assert result.max() <= 0.01


def test_light_that_spreads_is_not_kept_long():
    """Average indirect light over three tenths of the frames since an edit: the first lack most of its bounces."""
    frames = Frames(DiffuseDenoisePass, diffuse_radius=0)
    for frame in range(60):
        result = frames.show(1.0 - 0.9**frame, rest=frame, light_age=frame)
    assert frames.lengths() == pytest.approx(1.0 + 0.3 * 59, abs=0.02)
    assert result.min() > 1.0 - 0.9**24


@BOTH
def test_light_comes_on_unannounced(make):
    """Show light that came on within 16 frames up to 5 %, without being told."""
    rng = np.random.default_rng(10)
    frames = Frames(make)
    for _ in range(64):
        frames.show(0.0)
    for _ in range(16):
        result = frames.show(rng.lognormal(-0.125, 0.5, (SIZE, SIZE)))
    assert result.mean() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("before", "now"), [(1.0, 0.0), (0.0, 1.0), (1.0, 0.4)])
@pytest.mark.parametrize("deviation", [0.0, 0.3])
def test_shadow_of_a_mover_comes_and_goes_at_once(before, now, deviation):
    """Show a shadow that moves over half of the picture in its first frame, in which every other pixel has a ray."""
    rng = np.random.default_rng(11)
    checker = np.indices((SIZE, SIZE)).sum(0) % 2

    def sample(left):
        return halves(left, 1.0) * rng.lognormal(-0.5 * deviation**2, deviation, (SIZE, SIZE))

    left = {}
    for moved_age in (0, LONG_AGO):
        frames = Frames(DirectDenoisePass)
        for _ in range(64):
            frames.show(sample(before))
        result = frames.show(sample(now), weight=checker, moved_age=moved_age)
        left[moved_age] = (result[:, 2 : SIZE // 2 - 2].mean() - now) / (before - now)
        assert result[:, SIZE // 2 + 2 :].mean() == pytest.approx(1.0, abs=0.05)
    assert left[0] == pytest.approx(0.0, abs=0.12)
    assert left[LONG_AGO] > 0.7


@pytest.mark.parametrize("deviation", [0.3, 1.0])
def test_noise_is_no_shadow_of_a_mover(deviation):
    """Keep averaging where things move elsewhere: noise alone cuts few means short."""
    rng = np.random.default_rng(12)
    frames = Frames(DirectDenoisePass, direct_history=32)
    for frame in range(64):
        weight = (np.indices((SIZE, SIZE)).sum(0) + frame) % 2
        frames.show(rng.lognormal(-0.5 * deviation**2, deviation, (SIZE, SIZE)), weight=weight, moved_age=0)
    assert np.median(frames.lengths()) > 24 and frames.lengths().mean() > 20


@BOTH
def test_one_bright_frame_is_no_change(make):
    """Keep the mean's length through a single outlier, and most of the outlier out of the picture."""
    frames = Frames(make, direct_history=32)
    for _ in range(40):
        frames.show(0.5)
    spike = np.full((SIZE, SIZE), 0.5)
    spike[10, 10] = 8.0
    frames.show(spike)
    result = [frames.show(0.5) for _ in range(4)][-1]
    assert frames.lengths()[10, 10] > 30
    assert result[10, 10, 0] < 0.5 + 7.5 / 30


@BOTH
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_bad_numbers_stay_out(make, bad):
    """Take no NaN or infinity into picture or history, neither with nor without one."""
    frames = Frames(make)
    for frame in range(6):
        light = np.full((SIZE, SIZE), 0.25)
        if frame in (0, 4):
            light[5:9, 5:9] = bad
        result = frames.show(light)
    assert (result == 0.25).all()
    history = frames.denoiser.history.current(1)
    assert np.isfinite(frames.lengths()).all()
    assert np.isfinite((history.moments if frames.direct else history.state).numpy().view(np.float16)).all()


@BOTH
@pytest.mark.parametrize("shift", [(1.0, 0.0), (0.5, 0.0), (0.37, -0.61)])
def test_pan_keeps_light(make, shift):
    """Carry light along with the camera, by whole and by broken pixels, without blurring it away."""
    frames = Frames(make, size=64, direct_iterations=0, diffuse_radius=0)
    y, x = np.mgrid[:64, :64]

    def wave(frame):
        return 1.0 + 0.5 * np.sin(2 * np.pi * ((x - frame * shift[0]) / 13.0 + (y - frame * shift[1]) / 23.0))

    frames.move(shift)
    for frame in range(40):
        result = frames.show(wave(frame))[..., 0]
    inside = slice(20, 44)
    expected, found = wave(39)[inside, inside] - 1.0, result[inside, inside] - 1.0
    # Direct light is resampled more sharply and averaged over fewer frames.
    assert frames.lengths()[inside, inside].mean() > (10 if make is DirectDenoisePass else 20)
    gain = 0.07 if make is DirectDenoisePass else 0.04
    assert (expected * found).sum() / (expected**2).sum() == pytest.approx(1.0, abs=gain)
    assert np.abs(expected - found).max() < 0.05


def test_half_rate_samples_are_enough():
    """Fill pixels without a sample from their neighbours, count only real samples, and keep the mean."""
    rng = np.random.default_rng(11)
    frames = Frames()
    checker = np.indices((SIZE, SIZE)).sum(0) % 2
    light = np.where(checker, 1.0, np.nan)
    assert (frames.show(light, weight=checker) == 1.0).all()
    frames.denoiser.reset()
    for frame in range(64):
        traced = (checker + frame) % 2
        result = frames.show(np.where(traced, rng.lognormal(-0.125, 0.5, checker.shape), 100.0), weight=traced)
    assert result.mean() == pytest.approx(1.0, abs=0.01)
    assert frames.lengths().max() <= 32


def test_specular_is_filtered_like_diffuse():
    """Give the same for the same samples in both, and keep them apart where they differ."""
    rng = np.random.default_rng(12)
    frames = Frames()
    for _ in range(6):
        sample = rng.lognormal(-0.125, 0.5, (SIZE, SIZE))
        frames.show(sample, 0.5 * sample)
    assert frames.picture(specular=True) == pytest.approx(0.5 * frames.picture(), rel=2e-3)


@BOTH
def test_no_confidence_counts_only_without_history(make):
    """Use light without confidence where nothing else is known, and drop it for the first that has some."""
    frames = Frames(make)
    if make is DirectDenoisePass:
        assert (frames.show(3.0, weight=0.0) == 0.0).all()
    else:
        assert (frames.show(3.0, weight=0.0) == 3.0).all()
    assert (frames.show(1.0) == 1.0).all()
    assert (frames.show(7.0, weight=0.0) == 1.0).all()


@BOTH
def test_same_every_time(make):
    """Give the same bits for the same frames."""
    pictures = []
    for _ in range(2):
        rng = np.random.default_rng(13)
        frames = Frames(make)
        frames.move((0.3, 0.1))
        for _ in range(5):
            result = frames.show(noise(rng))
        pictures.append(result)
    assert (pictures[0] == pictures[1]).all()


@BOTH
@pytest.mark.parametrize("shift", [(0.0, 0.0), (1.0, -2.0)])
def test_whole_pixels_keep_every_bit(make, shift):
    """Find the same light a pixel on where the camera moves by whole pixels: nothing is interpolated."""
    rng = np.random.default_rng(16)
    frames = Frames(make, direct_iterations=0, diffuse_radius=0)
    before = frames.show(noise(rng))
    frames.move(shift)
    after = frames.show(0.0, weight=0.0)
    x, y = int(shift[0]), int(-shift[1])
    assert (after[: SIZE - y, x:] == before[y:, : SIZE - x]).all() and before.std() > 0.5


@BOTH
def test_reset_forgets(make):
    """Show nothing of before after a reset."""
    frames = Frames(make)
    for _ in range(10):
        frames.show(5.0)
    frames.denoiser.reset()
    assert (frames.show(1.0) == 1.0).all()
    assert (frames.lengths() == 1.0).all()


@pytest.mark.parametrize("iterations", [0, 1, 2, 5])
def test_any_number_of_passes(iterations):
    """Blur the more the more passes there are, and not at all with none."""
    rng = np.random.default_rng(14)
    frames = Frames(direct_iterations=iterations)
    sample = rng.lognormal(-0.02, 0.2, (SIZE, SIZE)).astype(np.float16).astype(np.float32)
    result = frames.show(sample)[..., 0]
    assert result.mean() == pytest.approx(sample.mean(), rel=1e-3)
    if iterations == 0:
        assert (result == sample).all()
    else:
        assert result.std() < sample.std() * (0.75, 0.6, 0.5, 0.5, 0.5)[iterations - 1]


@BOTH
def test_debug_views(make):
    """Draw every debug view in finite colours: lengths grow lighter, blur and error fade."""
    rng = np.random.default_rng(15)
    frames = Frames(make)
    picture = wp.zeros(SIZE * SIZE, dtype=wp.vec4, device=DEVICE)
    for name in make.debug_views:
        brightness = []
        frames.denoiser.reset()
        frames.frame = 0
        for frame in range(12):
            frames.show(rng.lognormal(-0.02, 0.2, (SIZE, SIZE)))
            if frame in (1, 11):
                graph = FrameGraph(DEVICE)
                frames.denoiser.record_debug(graph, frame & 1, name, picture)
                graph.replay()
                assert np.isfinite(picture.numpy()).all()
                brightness.append(picture.numpy()[:, :3].mean())
        assert (brightness[1] > brightness[0]) == name.endswith("history")
