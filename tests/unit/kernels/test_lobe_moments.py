# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the moments of GGX lobes: the table and its interpolation against sums over directions."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.lobe_moments import lobe_moments
from burnish.kernels import lobe_moments as kernels

from tests.ggx_sums import directions, lobe_values

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def read_lobe(
    # In:
    moments: wp.array[wp.uint64], n: wp.vec3, wo: wp.vec3, roughness: float, f0: float, f90: float,
    # Out:
    mean_out: wp.array[wp.vec3], second_out: wp.array[float],
):
    lobe = kernels.reflection_lobe(moments, n, wo, roughness, f0, f90)
    mean_out[0] = lobe.axis * lobe.first
    second_out[0] = lobe.second


def read(cosine, roughness, f0, f90, azimuth=0.0):
    """Return mean direction (in the frame of the normal z, view in the plane of `azimuth`) and second moment."""
    sine = np.sqrt(1 - cosine * cosine)
    wo = wp.vec3(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)
    mean, second = wp.zeros(1, dtype=wp.vec3, device="cpu"), wp.zeros(1, dtype=float, device="cpu")
    wp.launch(read_lobe, 1, [lobe_moments("cpu"), wp.vec3(0.0, 0.0, 1.0), wo, roughness, f0, f90], [mean, second],
              device="cpu", block_dim=1)
    return mean.numpy()[0], float(second.numpy()[0])


@pytest.mark.parametrize("cosine", [0.05, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("roughness", [0.5, 0.8, 1.0])
@pytest.mark.parametrize(("f0", "f90"), [(0.9, 1.0), (0.04, 0.5), (1.0, 0.0)])
def test_moments(cosine, roughness, f0, f90):
    """Find mean direction and second moment of a sum over directions."""
    d = directions()
    f = lobe_values(cosine, roughness, f0, f90, d)
    mean = (f[:, None] * d).sum(0) / f.sum()
    length = np.linalg.norm(mean)
    second = (f * (1.5 * (d @ mean / length) ** 2 - 0.5)).sum() / f.sum()
    got, got_second = read(cosine, roughness, f0, f90)
    np.testing.assert_allclose(got, mean * min(length, 0.95) / length, atol=0.02)
    np.testing.assert_allclose(got_second, min(second, 0.65), atol=0.04)


def test_mean_turns_with_the_view():
    """Point away from the view, whatever its azimuth."""
    for azimuth in (0.0, 1.0, 3.0):
        mean, _ = read(0.3, 0.5, 1.0, 1.0, azimuth)
        assert mean @ [np.cos(azimuth), np.sin(azimuth), 0.0] < -0.5
        assert abs(mean @ [-np.sin(azimuth), np.cos(azimuth), 0.0]) < 1e-3


def test_what_reflects_nothing_has_a_lobe():
    """Give finite moments where both reflectances are 0."""
    mean, second = read(0.5, 0.0, 0.0, 0.0)
    assert np.isfinite(mean).all() and np.isfinite(second)
