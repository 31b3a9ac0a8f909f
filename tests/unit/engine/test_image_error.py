# SPDX-License-Identifier: GPL-3.0-or-later
"""Image errors: each figure on pictures whose error is known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine import image_error
from burnish.engine.errors import BurnishError


@pytest.fixture
def picture() -> np.ndarray:
    """Return a smooth picture of 64x96 pixels between 0.1 and 0.9."""
    y, x = np.mgrid[0:64, 0:96]
    return np.stack([0.5 + 0.4 * np.sin(0.1 * x), 0.5 + 0.4 * np.cos(0.07 * y), 0.1 + 0.008 * x], -1).astype(np.float32)


def test_equal_pictures_have_no_error(picture: np.ndarray) -> None:
    """Find nothing between a picture and itself."""
    error = image_error.compare(picture, picture)
    assert (error.flip, error.flip_box, error.relative_mse, error.bad_pixels) == (0.0, 0.0, 0.0, 0)
    assert [error.luminance, error.dark_luminance, error.block_p5, error.block_p95] == pytest.approx([1.0] * 4)


def test_brighter_picture_shows_in_every_ratio(picture: np.ndarray) -> None:
    """Find a picture 10 % brighter to be so, in the mean and in every block."""
    error = image_error.compare(picture, picture * 1.1)
    ratios = [error.luminance, error.dark_luminance, error.block_p5, error.block_p95]
    assert ratios == pytest.approx([1.1] * 4, rel=1e-4)
    squared = np.mean(picture ** 2, -1)
    # Clipping the worst 0.5 % of a smooth error changes its mean by far less than 1 %.
    assert error.relative_mse == pytest.approx(float(np.mean(0.01 * squared / (squared + 0.01))), rel=1e-2)
    assert error.flip > 0.01


def test_box_filter_removes_noise(picture: np.ndarray) -> None:
    """Give zero-mean noise a much smaller FLIP after the box filter than before."""
    noise = np.random.default_rng(1).normal(0.0, 0.08, picture.shape).astype(np.float32)
    error = image_error.compare(picture, picture + noise)
    assert error.flip_box < 0.6 * error.flip


def test_dark_ratio_ignores_bright_pixels(picture: np.ndarray) -> None:
    """Leave lamps out of the dark ratio, and let them decide the overall one."""
    reference = picture.copy()
    reference[:16, :32] = 50.0
    test = reference.copy()
    test[:16, :32] *= 2.0
    error = image_error.compare(reference, test)
    assert error.dark_luminance == pytest.approx(1.0, abs=1e-5)
    assert error.luminance > 1.5


def test_block_percentiles_find_a_local_change(picture: np.ndarray) -> None:
    """Show a quarter of the blocks 30 % darker in the 5th percentile only."""
    test = picture.copy()
    test[:32, :48] *= 0.7
    error = image_error.compare(picture, test)
    assert error.block_p5 == pytest.approx(0.7, abs=0.01)
    assert error.block_p95 == pytest.approx(1.0, abs=0.01)


def test_bad_pixels_are_counted_and_do_not_spread(picture: np.ndarray) -> None:
    """Count NaN, infinite and negative pixels once each and keep every figure finite."""
    test = picture.copy()
    test[0, 0, 0], test[1, 1, 1], test[2, 2] = np.nan, np.inf, -1.0
    error = image_error.compare(picture, test)
    assert error.bad_pixels == 3
    assert all(np.isfinite(value) for value in error.as_dict().values())


def test_fireflies_are_clipped(picture: np.ndarray) -> None:
    """Keep a few enormous pixels from deciding relMSE and the noise figure."""
    test = picture * 1.05
    clean = image_error.relative_mse(picture, test)
    test[5, 5:15] = 1e4
    assert image_error.relative_mse(picture, test) == pytest.approx(clean, rel=0.1)
    assert image_error.noise_rmse(picture, test) < 0.1


def test_black_reference_is_harmless() -> None:
    """Return finite figures for a black reference."""
    black = np.zeros((32, 32, 3), np.float32)
    assert all(np.isfinite(value) for value in image_error.compare(black, black + 0.1).as_dict().values())


def test_sizes_must_agree(picture: np.ndarray) -> None:
    """Name both sizes when they differ."""
    with pytest.raises(BurnishError, match="95 x 64.*96 x 64"):
        image_error.compare(picture, picture[:, :-1])


def test_noise_rmse_is_the_standard_deviation() -> None:
    """Recover a known noise from two pictures, and half of it from four times the samples."""
    random = np.random.default_rng(2)
    clean = random.random((128, 128, 3))
    figures = []
    for sigma in (0.2, 0.1):
        first, second = (clean + random.normal(0.0, sigma, clean.shape) for _ in range(2))
        figures.append(image_error.noise_rmse(first, second))
    # Leaving out the worst 0.5 % of a chi-squared distribution with 3 degrees of freedom lowers its mean by 2 to 3 %.
    assert figures[0] == pytest.approx(0.2, rel=0.05)
    assert figures[0] / figures[1] == pytest.approx(2.0, rel=0.03)


def test_srgb_encoding_has_known_values() -> None:
    """Encode black, middle grey and white as the standard does, clipping what lies outside."""
    encoded = image_error.encode_srgb(np.array([-1.0, 0.0, 0.002, 0.21404, 1.0, 7.0]))
    assert encoded == pytest.approx([0.0, 0.0, 0.02584, 0.5, 1.0, 1.0], abs=1e-4)


def test_signed_difference_shows_its_sign(picture: np.ndarray) -> None:
    """Paint brighter red, darker blue, equal grey and NaN magenta."""
    test = picture.copy()
    test[0], test[1], test[2] = picture[0] * 2.0, picture[1] * 0.5, np.nan
    shown = image_error.signed_difference(picture, test)
    assert (shown[0, :, 0] > 0.9).all() and (shown[1, :, 2] > 0.9).all()
    assert np.allclose(shown[2], [1.0, 0.0, 1.0]) and np.allclose(shown[3:], 0.5)
