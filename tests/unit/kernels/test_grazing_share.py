# SPDX-License-Identifier: GPL-3.0-or-later
"""The curve of reflectance that frames have for the path tracer's: dielectrics by their index, metals by Schlick's."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels.fresnel import DIELECTRIC_F90, f0_from_ior, fresnel_dielectric, grazing_share, metal_part

COSINES = np.cos(np.radians(np.arange(0.0, 81.0, 2.5)))


@wp.kernel
def compare(
    # In:
    cosines: wp.array[float], ior: float,
    # Out:
    curve_out: wp.array[float], truth_out: wp.array[float],
):
    """Reflect at a cosine as frames and as the path tracer do."""
    i = wp.tid()
    f0 = f0_from_ior(ior)
    curve_out[i] = wp.lerp(f0, DIELECTRIC_F90, grazing_share(cosines[i], metal_part(f0, 1.0)))
    truth_out[i] = fresnel_dielectric(cosines[i], ior)[0]


@wp.kernel
def reflect_metal(
    # In:
    cosines: wp.array[float],
    # Out:
    share_out: wp.array[float],
):
    """Find the share of a metal's F90."""
    i = wp.tid()
    share_out[i] = grazing_share(cosines[i], metal_part(0.5, 1.0))


@pytest.mark.parametrize("ior", [1.45, 1.5, 1.6])
def test_dielectrics_reflect_by_their_index(device, ior):
    """Be within 5 % of Fresnel's equations up to 80 degrees, where Schlick's curve is a fifth too dark at 60."""
    out = [wp.zeros(len(COSINES), dtype=float, device=device) for _ in range(2)]
    wp.launch(compare, len(COSINES), [wp.array(COSINES, dtype=float, device=device), ior], out, device=device)
    curve, truth = (each.numpy() for each in out)
    np.testing.assert_allclose(curve, truth, rtol=0.05)
    f0 = ((ior - 1.0) / (ior + 1.0)) ** 2
    schlick = f0 + (1.0 - f0) * (1.0 - COSINES) ** 5
    assert np.abs(curve / truth - 1.0).max() < 0.25 * np.abs(schlick / truth - 1.0).max()


def test_metals_reflect_as_by_schlick(device):
    """Keep the fifth power for what reflects half of the light along its normal."""
    out = wp.zeros(len(COSINES), dtype=float, device=device)
    wp.launch(reflect_metal, len(COSINES), [wp.array(COSINES, dtype=float, device=device)], [out], device=device)
    np.testing.assert_allclose(out.numpy(), (1.0 - COSINES) ** 5, atol=1e-6)
