# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the Fresnel reflectances: against float64 formulas, at their defining points, and their averages."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels import fresnel

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def evaluate_dielectric(
    # In:
    cosines: wp.array[float], eta: float, f0: wp.vec3,
    # Out:
    f_out: wp.array[wp.vec2], schlick_out: wp.array[wp.vec3], average_out: wp.array[float],
):
    i = wp.tid()
    f_out[i] = fresnel.fresnel_dielectric(cosines[i], eta)
    schlick_out[i] = fresnel.fresnel_generalized_schlick(cosines[i], eta, f0)
    average_out[i] = fresnel.fresnel_dielectric_average(eta)


@wp.kernel
def evaluate_f82(
    # In:
    cosines: wp.array[float], f0: wp.vec3, tint: wp.vec3,
    # Out:
    f_out: wp.array[wp.vec3], average_out: wp.array[wp.vec3],
):
    i = wp.tid()
    b = fresnel.f82_tint_term(f0, tint)
    f_out[i] = fresnel.fresnel_f82(cosines[i], f0, b)
    average_out[i] = fresnel.fresnel_f82_average(f0, b)


@wp.kernel
def evaluate_inverse(
    # In:
    iors: wp.array[float],
    # Out:
    ior_out: wp.array[float],
):
    i = wp.tid()
    ior_out[i] = fresnel.ior_from_f0(fresnel.f0_from_ior(iors[i]))


def dielectric(cosines: np.ndarray, eta: float, f0: tuple = (0.04, 0.5, 1.0)) -> tuple[np.ndarray, ...]:
    """Return (reflectance and refracted cosine, generalised Schlick, average) at the cosines."""
    count = len(cosines)
    outputs = [wp.zeros(count, dtype=wp.vec2, device=DEVICE), wp.zeros(count, dtype=wp.vec3, device=DEVICE),
               wp.zeros(count, dtype=float, device=DEVICE)]
    inputs = [wp.array(cosines, dtype=float, device=DEVICE), float(eta), wp.vec3(*f0)]
    wp.launch(evaluate_dielectric, count, inputs, outputs, device=DEVICE)
    return tuple(output.numpy() for output in outputs)


def metal(cosines: np.ndarray, f0: tuple, tint: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Return (reflectance, average) of the F82 model at the cosines."""
    outputs = [wp.zeros(len(cosines), dtype=wp.vec3, device=DEVICE) for _ in range(2)]
    inputs = [wp.array(cosines, dtype=float, device=DEVICE), wp.vec3(*f0), wp.vec3(*tint)]
    wp.launch(evaluate_f82, len(cosines), inputs, outputs, device=DEVICE)
    return outputs[0].numpy(), outputs[1].numpy()


@pytest.mark.parametrize("eta", [1e-5, 0.5, 1 / 1.5, 0.99, 1.0, 1.0001, 1.5, 2.4, 1e5])
def test_dielectric_is_the_mean_of_both_polarisations(eta: float) -> None:
    """Agree with Fresnel's equations in float64, total internal reflection included."""
    c = np.linspace(0.0, 1.0, 401)[1:]
    got = dielectric(c, eta)[0]
    # The kernels see the rounded index.
    eta64 = float(np.float32(eta))
    c64 = np.float32(c).astype(np.float64)
    sin_t2 = (1 - c64**2) / eta64**2
    cos_t = np.sqrt(np.maximum(1 - sin_t2, 0))
    s = (c64 - eta64 * cos_t) / (c64 + eta64 * cos_t)
    p = (eta64 * c64 - cos_t) / (eta64 * c64 + cos_t)
    want = np.where(sin_t2 >= 1, 1.0, 0.5 * (s * s + p * p))
    # Near the critical angle the root amplifies rounding.
    safe = np.abs(1 - sin_t2) > 1e-5
    np.testing.assert_allclose(got[safe, 0], want[safe], atol=2e-4)
    np.testing.assert_allclose(got[safe, 1], np.where(sin_t2 >= 1, 0, cos_t)[safe], atol=2e-4)


def test_dielectric_ignores_the_sign_of_the_cosine() -> None:
    """Reflect alike from both sides of the normal."""
    c = np.linspace(0.01, 1.0, 50)
    np.testing.assert_array_equal(dielectric(c, 1.5)[0], dielectric(-c, 1.5)[0])


def test_index_and_reflectance_invert_each_other() -> None:
    """Return the index that a reflectance came from, up to the cap of 0.99."""
    iors = np.geomspace(1.0001, 300.0, 100).astype(np.float32)
    out = wp.zeros(len(iors), dtype=float, device=DEVICE)
    wp.launch(evaluate_inverse, len(iors), [wp.array(iors, device=DEVICE)], [out], device=DEVICE)
    np.testing.assert_allclose(out.numpy(), iors, rtol=1e-3)


def test_generalised_schlick_spans_f0_to_white() -> None:
    """Start at F0, end at 1, and be the real curve where F0 is the real one."""
    c = np.linspace(1.0, 1e-4, 200)
    f, schlick, _ = dielectric(c, 1.5, f0=(0.04, 0.3, 1.0))
    np.testing.assert_allclose(schlick[0], (0.04, 0.3, 1.0), atol=1e-6)
    np.testing.assert_allclose(schlick[-1], 1.0, atol=1e-3)
    np.testing.assert_allclose(schlick[:, 0], f[:, 0], atol=1e-6)
    assert (np.diff(schlick[:, 1]) >= -1e-6).all()


@pytest.mark.parametrize("eta", [0.6, 0.75, 1.2, 1.5, 2.0, 3.0])
def test_dielectric_average_fits_the_integral(eta: float) -> None:
    """Keep within the error of Kulla and Conty's fit."""
    c = (np.arange(20000) + 0.5) / 20000
    f, _, average = dielectric(c, eta)
    assert abs(2 * (f[:, 0] * c).mean() - average[0]) < 0.015


def test_f82_passes_its_defining_points() -> None:
    """Reflect F0 head on, Schlick's value times the tint at cos = 1/7, and everything at grazing angles."""
    f0, tint = np.array([0.9, 0.5, 0.1]), np.array([0.3, 1.0, 0.8])
    f, _ = metal(np.array([1.0, 1 / 7, 0.0]), tuple(f0), tuple(tint))
    np.testing.assert_allclose(f[0], f0, atol=1e-6)
    np.testing.assert_allclose(f[1], (f0 + (1 - f0) * (6 / 7) ** 5) * tint, atol=1e-5)
    np.testing.assert_allclose(f[2], 1.0, atol=1e-6)


def test_f82_average_is_the_integral() -> None:
    """Agree with a quadrature for tints that don't reach the clamp."""
    c = (np.arange(20000) + 0.5) / 20000
    f, average = metal(c, (0.9, 0.5, 0.2), (0.8, 1.0, 0.9))
    np.testing.assert_allclose(2 * (f * c[:, None]).mean(0), average[0], atol=1e-4)
