# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the display formats: the packing kernel agrees with NumPy's bit by bit."""

from __future__ import annotations

import numpy as np
import warp as wp
from burnish.addon.picture import HALF_MAX, pack_colors
from burnish.engine.display import PictureReader
from burnish.kernels import display


def pictures() -> np.ndarray:
    """Return colours over 40 orders of two with every special value, float32 [100, 90, 4]."""
    colors = np.exp2(np.random.default_rng(3).uniform(-24.0, 18.0, (100, 90, 4))).astype(np.float32)
    colors[0, :45] = np.exp2(np.arange(-22, 23, dtype=np.float32))[:, None]
    colors[1, :7, :3] = np.array([0.0, -1.0, np.nan, np.inf, -np.inf, 1e-40, 131071.0], np.float32)[:, None]
    return colors


def test_kernel_packs_as_numpy_does(device):
    """Pack the same bits on the device as on the host."""
    colors = pictures()
    picture = wp.array(colors.reshape(-1, 4), dtype=wp.vec4, device=device)
    packed = PictureReader(device).packed(picture, 90, 100)
    assert (packed.view(np.uint32) == pack_colors(colors).view(np.uint32)).all()


def test_reader_follows_the_size_and_gives_copies(device):
    """Keep an earlier picture as it was while later ones, of another size, are read."""
    reader = PictureReader(device)
    first = reader.packed(wp.full(12, wp.vec4(1.0), dtype=wp.vec4, device=device), 4, 3)
    kept = first.copy()
    reader.packed(wp.full(12, wp.vec4(2.0), dtype=wp.vec4, device=device), 4, 3)
    assert reader.packed(wp.full(2, wp.vec4(2.0), dtype=wp.vec4, device=device), 1, 2).shape == (2, 1)
    assert (first == kept).all()


def test_halves_are_finite(device):
    """Clamp to finite half floats, with alpha up to 1."""
    colors = pictures().reshape(-1, 4)
    halves = wp.empty(len(colors), dtype=wp.vec4h, device=device)
    wp.launch(display.halve_picture, len(colors), [wp.array(colors, dtype=wp.vec4, device=device)], [halves],
              device=device)
    values = halves.numpy().astype(np.float32)
    assert np.isfinite(values).all() and values.min() >= 0.0
    assert values[:, :3].max() == HALF_MAX and values[:, 3].max() == 1.0
    expected = np.fmin(np.fmax(colors[:, :3], 0.0), HALF_MAX)
    np.testing.assert_allclose(values[:, :3], expected, rtol=1e-3, atol=1e-7)
