# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the packed pixel format."""

from __future__ import annotations

import numpy as np
from burnish.addon.picture import COLOR_MAX, HALF_MAX, display_pixels, pack_colors, unpack_colors


def random_colors(seed: int = 1) -> np.ndarray:
    """Return colours over 40 orders of two, [200, 300, 4]."""
    return np.exp2(np.random.default_rng(seed).uniform(-22.0, 18.0, (200, 300, 4))).astype(np.float32)


def test_round_trip_within_a_mantissa_step():
    """Keep each channel within 1/512 of the largest one's power of two (or of the smallest step)."""
    colors = random_colors()
    limited = np.minimum(colors[..., :3], COLOR_MAX)
    error = np.abs(unpack_colors(pack_colors(colors)) - limited)
    step = np.maximum(limited.max(-1, keepdims=True), 2.0**-10) / 256.0
    # Half a step from rounding; a whole one where the largest mantissa would have rounded up to 512.
    assert (error <= step).all()
    assert (error <= 0.5 * step + 1e-12).mean() > 0.99


def test_bits_are_ordinary_floats():
    """Avoid NaN, infinity, zero and denormals: uploads and shaders may change those."""
    extremes = [np.full((1, 300, 4), value, np.float32) for value in (0.0, 1e30)]
    colors = np.concatenate([random_colors(), *extremes])
    packed = pack_colors(colors)
    assert np.isfinite(packed).all()
    assert (np.abs(packed) >= np.finfo(np.float32).tiny).all()


def test_bad_values_become_black_or_the_limit():
    """Turn NaN and negative values into 0 and infinities into the largest colour."""
    colors = np.array([[[np.nan, -1.0, 0.5], [np.inf, 1.0, 0.0]]], np.float32)
    values = unpack_colors(pack_colors(colors))
    assert values[0, 0].tolist() == [0.0, 0.0, 0.5]
    assert values[0, 1, 0] > 0.99 * COLOR_MAX and np.isfinite(values).all()


def test_common_values_are_exact():
    """Keep black, white and powers of two exactly."""
    colors = np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.25, 0.5, 4.0]]], np.float32)
    assert (unpack_colors(pack_colors(colors)) == colors).all()


def test_transparent_pictures_keep_alpha_within_half_floats():
    """Keep four channels where alpha matters, clamped to what a half-float texture holds."""
    rgba = np.array([[[1e6, np.nan, -1.0, 0.25]]], np.float32)
    assert display_pixels(rgba, transparent=True).tolist() == [[[HALF_MAX, 0.0, 0.0, 0.25]]]
    assert display_pixels(rgba, transparent=False).shape == (1, 1)
