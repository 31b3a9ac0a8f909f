# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the denoisers on made-up frames: nothing lost, nothing leaked, nothing left behind."""

import os

import numpy as np
import pytest
import warp as wp
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.passes.diffuse_denoise import DiffuseDenoisePass
from burnish.engine.passes.direct_denoise import DirectDenoisePass
from burnish.engine.settings import DenoiserSettings
from burnish.kernels.direct_light import DirectLight
from burnish.kernels.gbuffer import GBuffer
from burnish.kernels.reprojection import Reprojection
from burnish.kernels.view import View

SIZE = 32
DEVICE = os.environ.get("BURNISH_TEST_DEVICE", "cpu")
UP, SIDE = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
LONG_AGO = 5000


def packed_normal(n):
    """Pack like kernels/packing.py does, for axis-aligned normals looking forwards."""
    x, y = round(n[0] * 32767) + 32768, round(n[1] * 32767) + 32768
    return np.uint32(x | (y << 16))


class Frames:
    """A camera that looks down on a plane 5 m away, and one or both denoisers."""

    def __init__(self, make=DirectDenoisePass, depth=5.0, normal=UP, size=SIZE, **settings):
        self.size = size
        count = size * size
        self.denoiser = make(DEVICE, DenoiserSettings(**settings))
        self.denoiser.resize(size, size)
        self.direct = make is DirectDenoisePass
        self.gbuffer = GBuffer()
        depths = np.broadcast_to(np.asarray(depth, np.float32), (size, size)).reshape(-1)
        normals = np.empty((size, size), np.uint32)
        normals[:] = packed_normal(normal) if isinstance(normal, tuple) else normal
        self.gbuffer.depth = wp.array(depths.copy(), dtype=float, device=DEVICE)
        for name in ("normal", "geometric_normal"):
            setattr(self.gbuffer, name, wp.array(normals.reshape(-1), dtype=wp.uint32, device=DEVICE))
        self.reprojection = Reprojection()
        self.reprojection.position = wp.zeros(count, dtype=wp.vec2, device=DEVICE)
        self.reprojection.taps = wp.zeros(count, dtype=wp.uint8, device=DEVICE)
        self.input = [wp.zeros(count, dtype=wp.vec4h, device=DEVICE) for _ in range(2)]
        self.row = np.zeros(1, View.numpy_dtype())
        for name in ("camera", "previous"):
            camera = self.row[name]
            camera["camera_to_world"] = camera["world_to_camera"] = np.eye(4)
            camera["window"] = (-0.5, 0.5, -0.5, 0.5)
            camera["width"] = camera["height"] = camera["crop_width"] = camera["crop_height"] = size
            camera["spread"] = 1.0 / size
        self.row["exposure"] = 1.0
        self.views = wp.zeros(1, dtype=View, device=DEVICE)
        self.graphs = [self.record(parity) for parity in (0, 1)]
        self.frame = 0
        self.move((0.0, 0.0))

    def record(self, parity):
        graph = FrameGraph(DEVICE)
        light = self.input[0]
        if self.direct:
            light = DirectLight()
            light.diffuse, light.specular = self.input
        self.output = self.denoiser.record(
            graph, parity, self.views, self.gbuffer, self.gbuffer, self.reprojection, light)
        return graph

    def move(self, shift, valid=None):
        """Let every pixel have been `shift` pixels to the left and below of where it is now."""
        y, x = np.mgrid[: self.size, : self.size].astype(np.float32)
        position = np.stack([x + 0.5 - shift[0], y + 0.5 - shift[1]], -1)
        taps = np.zeros((self.size, self.size), np.uint8)
        corner = np.floor(position - 0.5).astype(int)
        for tap in range(4):
            at = corner + (tap & 1, tap >> 1)
            taps |= np.where(((at >= 0) & (at < self.size)).all(-1), 1 << tap, 0).astype(np.uint8)
        if valid is not None:
            taps *= valid
        self.reprojection.position.assign(position.reshape(-1, 2))
        self.reprojection.taps.assign(taps.reshape(-1))

    def show(self, light, specular=None, weight=1.0, rest=0, light_age=LONG_AGO):
        """Denoise a frame; return the picture (the first of the two) as [h, w, 3]."""
        for array, values in zip(self.input, (light, light if specular is None else specular), strict=True):
            image = np.empty((self.size, self.size, 4), np.float16)
            image[..., :3] = np.broadcast_to(np.asarray(values, np.float32), (self.size, self.size))[..., None]
            image[..., 3] = weight
            array.assign(image.reshape(-1, 4))
        self.row["rest"], self.row["light_age"], self.row["frame"] = rest, light_age, LONG_AGO + self.frame
        self.views.assign(self.row)
        self.graphs[self.frame & 1].replay()
        self.frame += 1
        return self.picture()

    def picture(self, specular=False):
        array = self.output
        if self.direct:
            array = array.specular if specular else array.diffuse
        return array.numpy().astype(np.float32).reshape(self.size, self.size, 4)[..., :3]

    def lengths(self):
        history = self.denoiser.history.current((self.frame - 1) & 1)
        if self.direct:
            values = np.abs(history.length.numpy())
        else:
            values = history.state.numpy().view(np.float16).reshape(-1, 4)[:, 0]
        return values.astype(np.float32).reshape(self.size, self.size)


BOTH = pytest.mark.parametrize("make", [DirectDenoisePass, DiffuseDenoisePass])
"""Both denoisers."""


def halves(left, right):
    """Return a picture whose left and right half differ."""
    return np.where(np.arange(SIZE) < SIZE // 2, left, right)[None, :].repeat(SIZE, 0)


def noise(rng):
    """Return log-normal samples of mean 1, sigma 1."""
    return rng.lognormal(-0.5, 1.0, (SIZE, SIZE))


@BOTH
def test_constant_stays_constant(make):
    """Give back a constant exactly, in motion and at rest."""
    frames = Frames(make)
    for frame in range(40):
        frames.move((0.37, -0.21) if frame < 20 else (0.0, 0.0))
        assert (frames.show(0.625, rest=max(frame - 20, 0)) == 0.625).all()


@BOTH
@pytest.mark.parametrize("still", [False, True])
def test_mean_of_noise_is_kept(make, still):
    """Neither darken nor brighten skewed noise by more than 1 % after 64 frames."""
    rng = np.random.default_rng(5)
    frames = Frames(make, size=SIZE)
    shown = 0.0
    for frame in range(64):
        sample = noise(rng)
        shown += sample.mean() if still else 0.0
        result = frames.show(sample, rest=frame if still else 0)
    # At rest the average of all samples is known; in motion that of the last 32 or 64 frames only by its own error.
    expected = shown / 64 if still else 1.0
    assert result.mean() == pytest.approx(expected, abs=0.005 if still else 0.01)
    assert result.std() < 0.2


@pytest.mark.parametrize("make, off", [
    (DirectDenoisePass, {"direct_iterations": 0}), (DiffuseDenoisePass, {"diffuse_radius": 0})])
def test_long_rest_is_the_plain_mean(make, off):
    """Give each pixel the plain average of 1000 frames at rest within 0.1 %, though kept in eight bytes."""
    rng = np.random.default_rng(6)
    frames = Frames(make, size=8, **off)
    total = np.zeros((8, 8))
    for frame in range(1000):
        sample = rng.lognormal(-0.5, 1.0, (8, 8)).astype(np.float16)
        total += sample
        # The first frames are taken to be at rest for long, so that chance is not taken for a change of the light.
        result = frames.show(sample, rest=frame + 64)
    assert frames.lengths() == pytest.approx(1000)
    assert result[..., 0] == pytest.approx(total / 1000, rel=1e-3)


@BOTH
def test_blur_vanishes_at_rest(make):
    """Let a fine pattern of light under noise come out at rest: what is blurred of it stays below the noise's error."""
    rng = np.random.default_rng(7)
    pattern = np.where(np.indices((SIZE, SIZE)).sum(0) % 2, 1.0, 0.8)
    frames = Frames(make)
    lost = {}
    for frame in range(512):
        result = frames.show(pattern * rng.lognormal(-0.02, 0.2, pattern.shape), rest=frame)[..., 0]
        lost[frame + 1] = 0.2 - (result[pattern == 1.0].mean() - result[pattern == 0.8].mean())
    assert lost[512] < 0.5 * lost[64] + 0.001
    assert lost[512] < 0.2 / np.sqrt(512)


EDGES = {
    "depth": {"depth": halves(5.0, 5.6)},
    "world": {"depth": halves(5.0, 1.0e18)},
    "normal": {"normal": np.where(halves(0, 1) == 1, packed_normal(SIDE), packed_normal(UP)).astype(np.uint32)},
}


@BOTH
@pytest.mark.parametrize("edge", EDGES)
def test_nothing_leaks_over_edges(make, edge):
    """Keep light on its own side of an edge of depth, normal or the world, from the first frame on."""
    rng = np.random.default_rng(8)
    frames = Frames(make, **EDGES[edge])
    for _ in range(20):
        result = frames.show(halves(1.0, 0.0) * rng.lognormal(-0.02, 0.2, (SIZE, SIZE)))[..., 0]
        left, right = result[:, : SIZE // 2], result[:, SIZE // 2:]
        assert right.max() < 1e-3
        # No darker in the columns at the edge than elsewhere (their own noise is some 5 %).
        assert left[:, -2:].mean() == pytest.approx(left.mean(), rel=0.1)


def test_shadow_edges_stay_sharp():
    """Bring out the edge of a shadow on one surface: 2 % off beside it after 32 frames, 1 % two pixels away."""
    frames = Frames()
    for _ in range(32):
        result = frames.show(halves(1.0, 0.0))[..., 0]
    error = np.abs(result - halves(1.0, 0.0)).max(0)
    assert error.max() < 0.02
    assert error[: SIZE // 2 - 2].max() < 0.01 and error[SIZE // 2 + 2:].max() < 0.01


def test_moving_shadow_leaves_no_trail():
    """Follow a shadow that moves by a pixel a frame: 1 % left three pixels behind its edge."""
    frames = Frames()
    for _ in range(40):
        frames.show(1.0)
    for edge in range(24):
        shadow = np.where(np.arange(SIZE) > edge, 1.0, 0.0)[None, :].repeat(SIZE, 0)
        result = frames.show(shadow)[SIZE // 2, :, 0]
    assert result[:21].max() < 0.01
    assert result[27:].min() > 0.98


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
    """Average indirect light over half of the frames since an edit at most: the first lack most of its bounces."""
    frames = Frames(DiffuseDenoisePass, diffuse_radius=0)
    for frame in range(60):
        result = frames.show(1.0 - 0.9**frame, rest=frame, light_age=frame)
    assert frames.lengths() == pytest.approx(1.0 + 0.5 * 59)
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


@BOTH
def test_one_bright_frame_is_no_change(make):
    """Keep the mean's length through a single outlier, and most of the outlier out of the picture."""
    frames = Frames(make)
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
    assert frames.lengths()[inside, inside].mean() > 20
    assert (expected * found).sum() / (expected**2).sum() == pytest.approx(1.0, abs=0.04)
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
