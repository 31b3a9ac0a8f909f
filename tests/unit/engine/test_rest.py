# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the blend at rest: never worse than the better of its two pictures, and in the limit the path traced one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp
from burnish.engine.passes.film_buffers import FilmBuffers
from burnish.engine.passes.rest import RestBlend
from burnish.engine.passes.wavefront import make_paths
from burnish.kernels import film as film_kernels
from burnish.kernels.paths import Options

W, H = 96, 64
BIAS = 0.03


def truth() -> np.ndarray:
    """Return a smooth picture with an edge and a dark corner, [n, 3]."""
    y, x = np.mgrid[0:H, 0:W] / H
    gray = 0.02 + 0.6 * x + 0.2 * np.sin(4.0 * y) ** 2 + np.where(x > 0.8, 1.0, 0.0)
    return np.stack([gray, 0.8 * gray, 0.5 * gray], -1).reshape(-1, 3)


def opaque(color: np.ndarray) -> np.ndarray:
    """Return [n, 4] with alpha 1."""
    return np.concatenate([color, np.ones((len(color), 1))], 1).astype(np.float32)


class Samples:
    """A film of m path-traced samples a pixel, drawn from heavy-tailed noise with a relative variance of `noise`."""

    def __init__(self, device: str, color: np.ndarray, m: int, noise: float, seed: int = 0):
        rng = np.random.default_rng(seed)
        sigma = np.sqrt(np.log1p(noise))
        total, squares, left = np.zeros(len(color)), np.zeros(len(color)), m
        while left:
            k = min(left, 256)
            draws = rng.lognormal(-0.5 * sigma * sigma, sigma, (len(color), k))
            total, squares, left = total + draws.sum(1), squares + (draws * draws).sum(1), left - k
        self.buffers = FilmBuffers.make(len(color), False, device)
        film = self.buffers.film
        film.color.assign(np.concatenate([color * total[:, None], np.full((len(color), 1), m)], 1).astype(np.float32))
        film.squares.assign(((color * color).mean(1) * squares).astype(np.float32))
        film.samples.assign(np.full(len(color), m, np.int32))
        self.mean = color * total[:, None] / m


def blend_of(device: str, film: FilmBuffers, picture: np.ndarray, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the blend [n, 4] and the path-traced share [n]."""
    blend = RestBlend(device)
    blend.resize(W, H)
    result = blend.resolve(film, wp.array(picture, dtype=wp.vec4, device=device), **options)
    return result.numpy(), blend.weight.numpy()


@pytest.mark.parametrize(("m", "noise"), [
    pytest.param(m, noise, marks=() if (m, noise) in ((16, 3.0), (256, 0.3)) else pytest.mark.slow)
    for m in (1, 16, 256, 4096, 16384) for noise in (0.3, 3.0)])
def test_blend_is_as_good_as_the_better_picture(device, m, noise):
    """Err no more than the better of a 3 % biased and a noisy picture (within 10 %), at any number of samples."""
    color = truth()
    samples = Samples(device, color, m, noise)
    picture, weight = blend_of(device, samples.buffers, opaque(color * (1.0 + BIAS)))

    def error(values: np.ndarray) -> float:
        return float((((values - color) / color) ** 2).mean())

    biased, noisy, blended = BIAS * BIAS, error(samples.mean), error(picture[:, :3])
    print(f"m {m}: filtered {biased:.2e}, traced {noisy:.2e}, blend {blended:.2e}, weight {weight.mean():.3f}")
    assert blended <= 1.1 * min(biased, noisy)


def test_first_samples_do_not_show(device):
    """Change the picture by less than a hundredth with the first samples of a noisy scene: nobody sees the change."""
    color = truth()
    for m in (1, 2, 3):
        picture, _ = blend_of(device, Samples(device, color, m, 10.0).buffers, opaque(color))
        assert (np.abs(picture[:, :3] / color - 1.0)).mean() < 0.01


def test_limit_is_the_path_traced_picture(device):
    """Be the path traced picture to the last bit where it has no noise, however good the filtered one is."""
    color = truth()
    for factor in (1.0, 1.005, 3.0):
        samples = Samples(device, color, 64, 0.0)
        samples.buffers.film.squares.zero_()
        picture, weight = blend_of(device, samples.buffers, opaque(color * factor))
        expected = (color * 64).astype(np.float32) / np.float32(64)
        assert (weight == 1.0).all() and (picture[:, :3] == expected).all()


def test_error_falls_with_the_samples(device):
    """Come nearer to the truth steadily, whether the filtered picture lacks detail, light, or nothing."""
    color = truth()
    y, x = np.mgrid[0:H, 0:W]
    stripes = np.where(x % 8 < 4, 1.1, 0.9).reshape(-1, 1)
    for filtered in (color * stripes, color * 0.8, color):
        biased, before = float(np.abs(filtered / color - 1.0).mean()), 1.0
        for m in (16, 256, 4096):
            samples = Samples(device, color, m, 1.0)
            picture, _ = blend_of(device, samples.buffers, opaque(filtered))
            noisy = float(np.abs(samples.mean / color - 1.0).mean())
            error = float(np.abs(picture[:, :3] / color - 1.0).mean())
            print(f"m {m}: filtered {biased:.4f}, traced {noisy:.4f}, both {error:.4f}")
            assert error < min(before, noisy, max(0.8 * biased, 0.012))
            before = error


def test_light_that_is_missing_comes_with_few_samples(device):
    """Mend a filtered picture that is 20 % too dark with 16 samples of twice its light in noise."""
    color = truth()
    picture, _ = blend_of(device, Samples(device, color, 16, 4.0).buffers, opaque(0.8 * color))
    ratio = picture[:, :3] / color
    assert abs(ratio.mean() - 1.0) < 0.01
    assert ratio.std() < 0.1


def test_one_firefly_stays_out(device):
    """Keep a sample of ten thousand times the light out of its pixel, and let its neighbours be."""
    color = truth()
    samples = Samples(device, color, 1024, 0.1)
    before, _ = blend_of(device, samples.buffers, opaque(color))
    film, bad = samples.buffers.film, (H // 2) * W + W // 2
    sums, squares = film.color.numpy(), film.squares.numpy()
    sums[bad, :3] += color[bad] * 1e4
    squares[bad] += (color[bad] ** 2).mean() * 1e8
    film.color.assign(sums)
    film.squares.assign(squares)
    after, weight = blend_of(device, samples.buffers, opaque(color))
    assert np.abs(after[bad, :3] / color[bad] - 1.0).max() < 0.01
    others = np.arange(len(color)) != bad
    assert np.abs(after[others, :3] / before[others, :3] - 1.0).max() < 0.03
    assert weight[bad] < 1e-3


def test_pixels_without_samples_show_the_filtered_picture(device):
    """Keep F where no sample was traced or all were rejected, and where sums have overflowed."""
    color = truth()
    samples = Samples(device, color, 8, 0.1)
    film = samples.buffers.film
    sums, counts, rejected = film.color.numpy(), film.samples.numpy(), film.rejected.numpy()
    counts[:W] = 0
    rejected[W:2 * W] = 8.0
    sums[2 * W:3 * W] = np.inf
    film.color.assign(sums)
    film.samples.assign(counts)
    film.rejected.assign(rejected)
    filtered = opaque(color * 1.1)
    picture, weight = blend_of(device, samples.buffers, filtered)
    assert np.isfinite(picture).all() and (weight[:3 * W] == 0.0).all()
    assert (picture[:3 * W] == filtered[:3 * W]).all()


def test_alpha_is_blended_or_one(device):
    """Blend alpha by the same weight with a transparent film, else keep it 1."""
    color = truth()
    samples = Samples(device, color, 64, 0.1)
    filtered = opaque(color * 1.2)
    filtered[:, 3] = 0.5
    picture, weight = blend_of(device, samples.buffers, filtered)
    np.testing.assert_allclose(picture[:, 3], 0.5 + 0.5 * weight, rtol=1e-5)
    assert (blend_of(device, samples.buffers, filtered, transparent=False)[0][:, 3] == 1.0).all()


def test_film_counts_squares(device):
    """Sum the squares of the samples that the film accepts, and forget them with the rest."""
    rng = np.random.default_rng(3)
    radiance = rng.random((4, 10, 4)).astype(np.float32)
    radiance[1, 3] = np.nan
    paths = make_paths(40, False, device)
    paths.radiance.assign(radiance.reshape(-1, 4))
    options, buffers = Options(), FilmBuffers.make(10, False, device)
    options.exposure, buffers.empty = 2.0, False
    wp.launch(film_kernels.accumulate_samples, 10, [paths, options, 0, 10, 4, 0], [buffers.film], device=device)
    expected = np.nansum((2.0 * radiance[..., :3]) ** 2, axis=(0, 2)) / 3.0
    np.testing.assert_allclose(buffers.film.squares.numpy(), expected, rtol=1e-5)
    buffers.clear()
    assert not buffers.film.squares.numpy().any()


@pytest.mark.parametrize(("error_of_frames", "share"), [(1.0, 0.5), (3.0, 0.05)])
def test_pixels_without_any_like_them(device, error_of_frames, share):
    """Take noise off single pixels whose normals are mixed, as at edges, and put right what frames got wrong there."""
    color = truth().reshape(H, W, 3)
    lonely = np.zeros((H, W), bool)
    lonely[::8, ::8] = True
    color[lonely] *= np.exp(np.random.default_rng(1).uniform(1.5, 6.0, (lonely.sum(), 1)))
    lonely, color = lonely.reshape(-1), color.reshape(-1, 3)
    normals = np.where(lonely[:, None], [0.0, 0.0, 0.7], [0.0, 0.0, 1.0]).astype(np.float32)
    samples = Samples(device, color, 32, 3.0)
    frames = np.where(lonely[:, None], color * error_of_frames, color)
    picture, _ = blend_of(
        device, samples.buffers, opaque(frames), normals=wp.array(normals, dtype=wp.vec3, device=device))

    def error(values: np.ndarray) -> float:
        return float(((values / color - 1.0)[lonely] ** 2).mean())

    assert error(picture[:, :3]) < share * max(error(samples.mean), error(frames))
