# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the G-buffer's reflecting lobes: a coat reflects as much as its albedo says, alone and above a base."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels.albedo_tables import plane_point, view_at
from burnish.kernels.gbuffer import Surface, SurfaceMaterial
from burnish.kernels.specular_lobes import lobes_pdf, lobes_value, sample_lobes, specular_lobes

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SAMPLES = 8192
COSINES = (1.0, 0.8, 0.5, 0.3, 0.15)
ROUGHNESSES = (0.0, 0.03, 0.1, 0.3, 0.5, 0.8, 1.0)
COAT = 0.08


@wp.kernel
def integrate(
    # In:
    cosines: wp.array[float], roughnesses: wp.array[float], base: float, samples: int,
    # Out:
    albedo_out: wp.array2d[float],
):
    """Integrate a coat of albedo COAT above a rough base that reflects the share `base` of light along each normal."""
    i, j = wp.tid()
    surface = Surface()
    surface.normal = wp.vec3(0.0, 0.0, 1.0)
    surface.geometric_normal = surface.normal
    m = SurfaceMaterial()
    m.coat = COAT
    m.coat_roughness = roughnesses[j]
    m.roughness = 0.6
    m.f0 = wp.vec3(base, base, base)
    m.f90 = base
    m.specular = wp.vec3(COAT + base, COAT + base, COAT + base)
    lobes = specular_lobes(m, surface, view_at(cosines[i]))
    total = float(0.0)
    k = int(0)
    while k < samples:
        wi = sample_lobes(lobes, plane_point(k), float(k * 5 % 4096) / 4096.0)
        pdf = lobes_pdf(lobes, wi)
        if pdf > 0.0:
            total += lobes_value(m, lobes, wi)[0] / pdf
        k += 1
    albedo_out[i, j] = total / float(samples)


def integral(base: float) -> np.ndarray:
    """Return the albedos [cosine, roughness]."""
    out = wp.zeros((len(COSINES), len(ROUGHNESSES)), dtype=float, device=DEVICE)
    wp.launch(integrate, out.shape, [
        *(wp.array(rows, dtype=float, device=DEVICE) for rows in (COSINES, ROUGHNESSES)), base, SAMPLES], [out],
        device=DEVICE)
    return out.numpy()


def test_a_coat_reflects_its_albedo() -> None:
    """Compare the coat's integral with its albedo: near-exact where it is sharp, within 8 % where it is all rough."""
    error = np.abs(integral(0.0) / COAT - 1.0)
    assert error[:, :2].max() < 0.006, error
    assert error[:, :5].max() < 0.04, error
    assert error.max() < 0.085, error


@pytest.mark.parametrize("base", [0.05, 0.5])
def test_coat_and_base_add_up(base: float) -> None:
    """Sample both lobes by one density: together they reflect what each does alone."""
    both, coat = integral(base), integral(0.0)
    # Of the base alone, from the sharpest coat: what is above the coat does not depend on the coat's roughness.
    left = both - coat
    np.testing.assert_allclose(left, np.repeat(left[:, :1], left.shape[1], 1), rtol=0.03)
    assert (left < base).all() and (left > 0.7 * base).all()
