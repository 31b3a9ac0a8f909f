# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of thin films: colours against sums over all wavelengths in float64, where films end, and BSDFs with one."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.film_colors import COLOR_MATCHING, WAVELENGTHS
from burnish.engine.sky.image import TO_REC709
from burnish.engine.tables import albedo_tables
from burnish.kernels import fresnel, thin_film
from burnish.kernels.layering import prepare_bsdf
from burnish.kernels.reflectance import bsdf_albedo
from burnish.kernels.types import CLOSURE_GLASS, Closure, ShadingPoint, Tables

from tests.bsdf_cases import albedo, closure, evaluate, point, view
from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

COSINES = np.linspace(0.05, 1.0, 20)


@wp.kernel
def evaluate_films(
    # In:
    tables: Tables, thickness: float, ior: float, eta: float, f0: wp.vec3, tint: wp.vec3, cosines: wp.array[float],
    # Out:
    dielectric_out: wp.array[wp.vec3], metal_out: wp.array[wp.vec3],
):
    i = wp.tid()
    dielectric_out[i] = thin_film.film_dielectric(tables.film, thickness, ior, eta, cosines[i])
    b = fresnel.f82_tint_term(f0, tint)
    metal_out[i] = thin_film.film_metal(tables.film, thickness, ior, f0, b, cosines[i])


@wp.kernel
def find_albedos(
    # In:
    tables: Tables, closures: wp.array[Closure], points: wp.array[ShadingPoint],
    # Out:
    specular_out: wp.array[wp.vec3],
):
    i = wp.tid()
    bsdf = prepare_bsdf(tables, closures[i], points[i])
    specular_out[i] = bsdf_albedo(tables, bsdf, points[i].wo).specular


def films(thickness: float, ior: float, *, eta: float = 1.5, f0=(0.9, 0.6, 0.3), tint=(1.0, 1.0, 1.0)) -> tuple:
    """Return the reflectances of a dielectric and a metal under a film at COSINES."""
    out = [wp.zeros(len(COSINES), dtype=wp.vec3, device=DEVICE) for _ in range(2)]
    cosines = wp.array(COSINES, dtype=float, device=DEVICE)
    wp.launch(evaluate_films, len(COSINES), [
        albedo_tables(DEVICE), thickness, ior, eta, wp.vec3(*f0), wp.vec3(*tint), cosines], out, device=DEVICE)
    return out[0].numpy(), out[1].numpy()


def exact(thickness: float, ior: float, below: complex | np.ndarray) -> np.ndarray:
    """Return the reflectance of a film by the sum of all waves in it, integrated over all wavelengths: [cosine, rgb].

    `below` is the index under the film, of each channel.
    """
    wavelengths = np.arange(380.0, 780.5, 1.0)
    sensitivity = np.stack([np.interp(wavelengths, WAVELENGTHS, row) for row in COLOR_MATCHING.T], -1)
    sensitivity = sensitivity @ np.array(TO_REC709).T
    sensitivity /= sensitivity.sum(0)
    indices = np.broadcast_to(np.asarray(below, complex), 3)
    total = np.zeros((len(COSINES), 3))
    cos1 = COSINES[:, None].astype(complex)
    cos2 = np.sqrt(1 - (1 - cos1**2) / ior**2)
    for c, index in enumerate(indices):
        cos3 = np.sqrt(1 - (1 - cos1**2) / index**2)
        turn = np.exp(4j * np.pi * ior * thickness * cos2 / wavelengths)
        for upper, lower in (
                ((cos1 - ior * cos2) / (cos1 + ior * cos2), (ior * cos2 - index * cos3) / (ior * cos2 + index * cos3)),
                ((ior * cos1 - cos2) / (ior * cos1 + cos2), (index * cos2 - ior * cos3) / (index * cos2 + ior * cos3))):
            wave = (upper + lower * turn) / (1 + upper * lower * turn)
            total[:, c] += 0.5 * (np.abs(wave) ** 2 * sensitivity[:, c]).sum(1)
    return total


@pytest.mark.parametrize(("thickness", "ior", "eta"), [
    (100.0, 1.33, 1.5), (300.0, 1.8, 1.5), (550.0, 1.2, 1.5), (1000.0, 1.5, 2.4), (400.0, 1.3, 1.0)])
def test_dielectrics_have_the_colors_of_all_wavelengths(thickness: float, ior: float, eta: float) -> None:
    """Find the integral over the spectrum but for the orders that are left out, for films above and below the base."""
    found = films(thickness, ior, eta=eta)[0]
    steep = COSINES > 0.25
    np.testing.assert_allclose(found[steep], np.maximum(exact(thickness, ior, eta)[steep], 0.0), atol=6e-3)
    assert np.ptp(found[steep], axis=1).max() > 0.01


def test_metals_turn_the_phase() -> None:
    """Find the integral over the spectrum of a film on the metal's complex index, along the normal."""
    f0 = np.array((0.9, 0.6, 0.3))
    edge = f0 + (1 - f0) * (6 / 7) ** 5
    root = np.sqrt(f0)
    n = (1 + root) / (1 - root) * (1 - edge) + (1 - f0) / (1 + f0) * edge
    k = np.sqrt((f0 * (n + 1) ** 2 - (n - 1) ** 2) / (1 - f0))
    for thickness in (120.0, 250.0, 400.0):
        found = films(thickness, 1.4)[1]
        np.testing.assert_allclose(found[-1], exact(thickness, 1.4, n + 1j * k)[-1], atol=0.012)
        assert found.max() <= 1.0


def test_thin_and_thick_films_have_no_color() -> None:
    """Fade to the surface alone for films without thickness, and to grey for thick ones."""
    bare = films(0.2, 1.0)[0]
    np.testing.assert_allclose(films(0.2, 1.8)[0], bare, rtol=0.01)
    assert np.ptp(bare, axis=1).max() < 1e-6
    assert np.ptp(films(20000.0, 1.8)[0], axis=1).max() < 2e-3


def test_no_film_changes_nothing() -> None:
    """Evaluate a BSDF to the bit as without a film where that is thinner than any."""
    looks = [dict(), dict(metallic=1.0, color=(0.9, 0.6, 0.3)), dict(transmission=1.0)]
    wi = np.random.default_rng(1).normal(size=(len(looks), 64, 3))
    wi /= np.linalg.norm(wi, axis=-1, keepdims=True)
    points = [point(view(0.6))] * len(looks)
    found = [evaluate([closure(**look, **film) for look in looks], points, wi)[0]
             for film in ({}, {"film_thickness": 0.1, "film_ior": 1.8}, {"film_thickness": 300.0, "film_ior": 1.8})]
    np.testing.assert_array_equal(found[0], found[1])
    assert all((found[0][i] != found[2][i]).any() for i in range(len(looks)))


@pytest.mark.parametrize("film", [(100.0, 1.2), (300.0, 1.8), (600.0, 1.33)])
def test_white_furnace(film: tuple) -> None:
    """Return no more light than there is from any surface with a film, seen from both sides."""
    looks = [dict(roughness=r, **look) for r in (0.05, 0.3, 0.6) for look in (
        dict(), dict(metallic=1.0), dict(transmission=1.0), dict(transmission=1.0, thin_wall=1),
        dict(kind=int(CLOSURE_GLASS)), dict(metallic=0.5, coat=1.0), dict(ior=1.0))]
    for backfacing in (0, 1):
        for cosine in (0.3, 1.0):
            result = albedo([closure(**look, film_thickness=film[0], film_ior=film[1]) for look in looks],
                            [point(view(cosine), backfacing=backfacing)] * len(looks), 2048)
            # Shares of light are those of smooth surfaces, so rough ones are off by some percent, as in Cycles.
            assert result.max() < 1.06, (backfacing, cosine)
            assert result.min() > 0.5, (backfacing, cosine)


@pytest.mark.parametrize("look", [dict(color=(0, 0, 0)), dict(metallic=1.0, color=(0.9, 0.6, 0.3))])
def test_albedo_of_films(look: dict) -> None:
    """Tell the real-time integrator how much a film reflects, by channel, for smooth and for rough surfaces."""
    for roughness in (0.05, 0.3, 0.6):
        closures, points = [], []
        for thickness, ior in ((150.0, 1.33), (400.0, 1.8)):
            for cosine in (0.4, 0.9):
                closures.append(closure(roughness=roughness, film_thickness=thickness, film_ior=ior, **look))
                points.append(point(view(cosine)))
        out = wp.zeros(len(closures), dtype=wp.vec3, device=DEVICE)
        arrays = [wp.array(closures, dtype=Closure, device=DEVICE), wp.array(points, dtype=ShadingPoint, device=DEVICE)]
        wp.launch(find_albedos, len(closures), [albedo_tables(DEVICE), *arrays], [out], device=DEVICE)
        expected = albedo(closures, points, 1 << 13)
        np.testing.assert_allclose(out.numpy(), expected, rtol=0.03, atol=2e-3)
