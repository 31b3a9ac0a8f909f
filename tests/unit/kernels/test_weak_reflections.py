# SPDX-License-Identifier: GPL-3.0-or-later
"""Which reflections are traced: by their roughness, and by how much of the light they reflect."""

import numpy as np
import pytest
import warp as wp
from burnish.engine.passes.ray_scene import reflection_options
from burnish.engine.settings import ReflectionSettings
from burnish.kernels.reflection_types import STRONG_ALBEDO, WEAK_ALBEDO, ReflectionOptions, ray_share

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def write_shares(
    # In:
    options: ReflectionOptions,
    roughness: wp.array[float],
    albedo: wp.array[float],
    # Out:
    share_out: wp.array[float],
):
    """Write ray_share of each."""
    i = wp.tid()
    share_out[i] = ray_share(options, roughness[i], albedo[i])


def shares(roughness, albedo, **settings):
    """Return the share of rays for each pair."""
    roughness, albedo = np.broadcast_arrays(np.float32(roughness), np.float32(albedo))
    out = wp.zeros(roughness.size, dtype=float, device=DEVICE)
    wp.launch(write_shares, roughness.size,
              [reflection_options(ReflectionSettings(**settings), 8, 8),
               wp.array(roughness.reshape(-1), dtype=float, device=DEVICE),
               wp.array(albedo.reshape(-1), dtype=float, device=DEVICE)], [out], device=DEVICE)
    return out.numpy().reshape(roughness.shape)


def test_weak_reflections_are_traced_less_far():
    """Trace plastic seen from above up to one roughness, metals up to another, both with the zone beyond."""
    settings = {"roughness_traced": 0.5, "roughness_weak": 0.25, "roughness_blend": 0.1}
    roughness = np.array([0.0, 0.25, 0.3, 0.36, 0.5, 0.55, 0.61])
    assert shares(roughness, 0.04, **settings) == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0], abs=1e-5)
    assert shares(roughness, 0.8, **settings) == pytest.approx([1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0], abs=1e-5)


def test_no_border_between_weak_and_strong():
    """Let the share of rays rise with the albedo without a jump, and never beyond what both limits allow."""
    albedo = np.linspace(0.0, 1.0, 401)
    for roughness in (0.1, 0.3, 0.4, 0.5):
        found = shares(roughness, albedo)
        assert (np.diff(found) > -1e-6).all() and np.abs(np.diff(found)).max() < 0.15
        assert found[albedo <= float(WEAK_ALBEDO)] == pytest.approx(float(shares(roughness, 0.0)), abs=1e-6)
        assert found[albedo >= float(STRONG_ALBEDO)] == pytest.approx(float(shares(roughness, 1.0)), abs=1e-6)


def test_weak_ones_never_reach_farther():
    """Keep to the limit of all reflections where that of weak ones is set beyond it."""
    assert shares(0.4, 0.02, roughness_traced=0.2, roughness_weak=0.9) == pytest.approx(0.0)
