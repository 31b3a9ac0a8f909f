# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of reflection lobes as harmonics see them: the table and its interpolation against sums over directions."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.lobe_moments import lobe_moments
from burnish.kernels import lobe_moments as kernels
from burnish.kernels.gbuffer import SurfaceMaterial
from burnish.kernels.probe_records import WorldBands

from tests.ggx_sums import directions, lobe_values

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

UP = np.array([0.0, 0.0, 1.0])
SCALES = np.repeat((1.0 / (4.0 * np.pi), 1.0 / (2.0 * np.pi), 15.0 / (32.0 * np.pi)), (1, 3, 5))
"""From moments of radiance to what records hold"""


@wp.kernel
def read_lobe(
    # In:
    moments: wp.array[wp.uint64], n: wp.vec3, wo: wp.vec3, roughness: float, f0: float, f90: float,
    # Out:
    bands_out: wp.array[WorldBands],
):
    bands_out[0] = kernels.lobe_bands(moments, n, wo, roughness, f0, f90)


@pytest.fixture(scope="module")
def read(device):
    """Return a function that returns the factors of a record's nine coefficients."""

    def factors(n, wo, roughness, f0, f90):
        bands = wp.zeros(1, dtype=WorldBands, device=device)
        wp.launch(read_lobe, 1, [lobe_moments(device), wp.vec3(*n), wp.vec3(*wo), roughness, f0, f90], [bands],
                  device=device, block_dim=1)
        return bands.numpy()[0].astype(np.float64)

    return factors


@wp.kernel
def read_albedo(
    # In:
    moments: wp.array[wp.uint64], material: SurfaceMaterial, cosine: float,
    # Out:
    albedo_out: wp.array[wp.vec3],
):
    albedo_out[0] = kernels.fitted_albedo(moments, material, cosine)


def view(cosine, azimuth=0.0):
    """Return a direction by its cosine with z."""
    sine = np.sqrt(1.0 - cosine * cosine)
    return np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])


def functions(d):
    """Return the functions of which records hold the moments, of directions [..., 3]: those of world_basis are dual."""
    x, y, z = np.moveaxis(d, -1, 0)
    third = 1.0 / 3.0
    return np.stack([np.ones_like(x), x, y, z, x * x - third, y * y - third, x * y, y * z, x * z], -1)


def record(light, d):
    """Return the coefficients of a probe's record: of radiances [n] from directions spread evenly over a hemisphere."""
    return functions(d).T @ light * (2.0 * np.pi / len(d)) * SCALES


def skies(count):
    """Return radiances of skies with one bright cap each [count, n], with their directions."""
    generator, d = np.random.default_rng(5), directions(96)
    caps = generator.normal(size=(count, 3))
    caps /= np.linalg.norm(caps, axis=1, keepdims=True)
    return np.where(caps @ d.T > generator.uniform(-0.3, 0.7, size=(count, 1)), 1.0, 0.1), d


@pytest.mark.parametrize("cosine", [0.05, 0.15, 0.3, 0.7, 1.0])
@pytest.mark.parametrize(("roughness", "most"), [(0.65, 0.26), (0.8, 0.14), (1.0, 0.06)])
@pytest.mark.parametrize(("f0", "f90"), [(0.9, 1.0), (0.04, 1.0), (0.04, 0.5), (1.0, 0.0)])
def test_light_of_skies(read, cosine, roughness, most, f0, f90):
    """Find the light that a lobe reflects of skies with bright caps, in the mean of them without a bias."""
    lights, d = skies(48)
    lobe = lobe_values(cosine, roughness, f0, f90, d)
    bands = read(UP, view(cosine), roughness, f0, f90)
    ratios = np.array([record(light, d) @ bands / (light @ lobe / lobe.sum()) for light in lights])
    assert np.sqrt(((ratios - 1.0) ** 2).mean()) < most, ratios
    assert abs(ratios.mean() - 1.0) < 0.05


@pytest.mark.parametrize("roughness", [0.0, 0.5, 0.8, 1.0])
def test_white_sky_is_exact(read, roughness):
    """Reflect all of a white sky's light from every view."""
    for cosine in (0.01, 0.3, 1.0):
        bands = read(UP, view(cosine), roughness, 0.04, 1.0)
        assert abs(0.5 * bands[0] + 0.5 * bands[3] - 1.0) < 0.004


@pytest.mark.parametrize("roughness", [0.35, 0.5, 0.62, 0.8, 1.0])
@pytest.mark.parametrize("f0", [0.04, 0.4, 0.9])
def test_albedo(device, f0, roughness):
    """Know how much dielectrics and metals reflect of a white sky: facets of the former reflect more aslant."""
    material = SurfaceMaterial()
    material.f0, material.f90, material.roughness = wp.vec3(f0, f0, f0), 1.0, roughness
    for cosine in (0.15, 0.3, 0.6, 0.9):
        albedo = wp.zeros(1, dtype=wp.vec3, device=device)
        wp.launch(read_albedo, 1, [lobe_moments(device), material, cosine], [albedo], device=device, block_dim=1)
        known = lobe_values(cosine, roughness, f0, 1.0, directions()).mean() * 2.0 * np.pi
        assert abs(albedo.numpy()[0, 0] / known - 1.0) < 0.01, cosine


def test_leaning_normals(read):
    """Find the light of skies about a surface whose shading normal leans by 20 degrees, to all sides."""
    ratios = []
    lights, d = skies(24)
    for azimuth in np.radians((0.0, 90.0, 180.0)):
        n = view(np.cos(np.radians(20.0)), azimuth)
        frame = np.stack([np.cross([0.0, 1.0, 0.0], n), [0.0, 1.0, 0.0], n])
        frame[0] /= np.linalg.norm(frame[0])
        frame[1] = np.cross(n, frame[0])
        wo = view(0.5) @ frame
        lobe = lobe_values(0.5, 0.8, 0.04, 1.0, d @ frame.T) * (d @ n > 0.0)
        bands = read(n, wo, 0.8, 0.04, 1.0)
        share = 0.5 * bands[0] + 0.5 * bands[3]
        ratios += [record(light, d) @ bands / share / (light @ lobe / lobe.sum()) for light in lights]
    ratios = np.array(ratios)
    assert np.sqrt(((ratios - 1.0) ** 2).mean()) < 0.15 and abs(ratios.mean() - 1.0) < 0.05


def test_lobes_turn_with_the_view(read):
    """Reflect what is opposite the view, whatever its azimuth."""
    d = directions(96)
    for azimuth in (0.0, 1.0, 3.0):
        wo = view(0.3, azimuth)
        bands = read(UP, wo, 0.6, 1.0, 1.0)
        ahead, behind, aside = (record((d @ side > 0.5).astype(float), d) @ bands for side in (
            -view(0.0, azimuth), view(0.0, azimuth), view(0.0, azimuth + np.pi / 2)))
        assert ahead > 0.5 > 0.3 > aside > behind


def test_what_reflects_nothing_has_a_lobe(read):
    """Give finite factors where both reflectances are 0."""
    assert np.isfinite(read(UP, view(0.5), 0.0, 0.0, 0.0)).all()
