# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of GGX: normalisation, masking, samplers against their pdfs, reciprocity, and extreme roughness."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels import ggx
from burnish.kernels.sampling import sample_pair

from tests.bsdf_cases import chi_squared_score, count_on_sphere, counts_due, sphere_grid, view
from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

REFLECTION, GLASS_REFLECTION, REFRACTION = 0, 1, 2
ROWS, COLUMNS, FINE = 32, 32, (24, 6)


@wp.kernel
def evaluate_d(
    # In:
    normals: wp.array[wp.vec3], alpha_x: float, alpha_y: float,
    # Out:
    d_out: wp.array[float],
):
    i = wp.tid()
    d_out[i] = ggx.ggx_d(normals[i], alpha_x, alpha_y)


@wp.kernel
def evaluate_lobe(
    # In:
    wo: wp.vec3, wi: wp.array[wp.vec3], alpha: wp.vec2, eta: float, lobe: int,
    # Out:
    value_out: wp.array[wp.vec3],
):
    i = wp.tid()
    if lobe == 0:
        value_out[i] = ggx.ggx_reflection(wo, wi[i], alpha[0], alpha[1])
    elif lobe == 1:
        value_out[i] = ggx.ggx_glass_reflection(wo, wi[i], alpha[0])
    else:
        value_out[i] = ggx.ggx_refraction(wo, wi[i], alpha[0], eta)


@wp.kernel
def draw(
    # In:
    wo: wp.vec3, alpha: wp.vec2, eta: float, lobe: int,
    # Out:
    wi_out: wp.array[wp.vec3],
):
    i = wp.tid()
    u = sample_pair(wp.uint32(1), wp.uint32(i), 0)
    if lobe == 0:
        wi_out[i] = ggx.sample_ggx_reflection(wo, alpha[0], alpha[1], u)
    else:
        m = ggx.sample_ggx_normal(wo, alpha[0], alpha[1], u)
        if lobe == 1:
            wi_out[i] = ggx.reflect_about(wo, m)
        else:
            wi_out[i] = ggx.refract_about(wo, m, eta)


def lobe_at(wo: tuple, wi: np.ndarray, alpha: tuple, lobe: int, eta: float = 1.5) -> np.ndarray:
    """Return (value, pdf, cosine at the normal) for the directions wi."""
    out = wp.zeros(len(wi), dtype=wp.vec3, device=DEVICE)
    directions = wp.array(wi.astype(np.float32), dtype=wp.vec3, device=DEVICE)
    wp.launch(evaluate_lobe, len(wi), [wp.vec3(*wo), directions, wp.vec2(*alpha), eta, lobe], [out], device=DEVICE)
    return out.numpy()


def draw_many(wo: tuple, alpha: tuple, lobe: int, eta: float = 1.5, count: int = 1 << 17) -> np.ndarray:
    """Return sampled directions."""
    out = wp.zeros(count, dtype=wp.vec3, device=DEVICE)
    wp.launch(draw, count, [wp.vec3(*wo), wp.vec2(*alpha), eta, lobe], [out], device=DEVICE)
    return out.numpy()


@pytest.mark.parametrize("alpha_x, alpha_y", [(1e-3, 1e-3), (0.01, 0.01), (0.3, 0.3), (1.0, 1.0), (0.05, 0.8)])
def test_density_projects_to_one(alpha_x: float, alpha_y: float) -> None:
    """Integrate D(m) m.z over the hemisphere to 1."""
    n = 400
    u, phi = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n * 2 * np.pi, indexing="ij")
    # Slopes spread as GGX has them; the Jacobian of that map is worked out by hand below.
    radius = np.sqrt(u / (1 - u))
    slope = np.stack([alpha_x * radius * np.cos(phi), alpha_y * radius * np.sin(phi)], -1)
    cos2 = 1 / (1 + (slope**2).sum(-1))
    normals = np.concatenate([slope, np.ones((n, n, 1))], -1) * np.sqrt(cos2)[..., None]
    out = wp.zeros(n * n, dtype=float, device=DEVICE)
    flat = wp.array(normals.reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device=DEVICE)
    wp.launch(evaluate_d, n * n, [flat, alpha_x, alpha_y], [out], device=DEVICE)
    # m.z dm = m.z^4 dslope, and dslope = alpha_x alpha_y / (2 (1 - u)^2) du dphi.
    jacobian = cos2**2 * alpha_x * alpha_y / (2 * (1 - u) ** 2)
    assert abs((out.numpy().reshape(n, n) * jacobian).mean() * 2 * np.pi - 1) < 2e-3


@pytest.mark.parametrize("cosine", [0.05, 0.4, 1.0])
@pytest.mark.parametrize("alpha", [(0.3, 0.3), (1.0, 1.0), (0.2, 0.9), (0.9, 0.2)])
def test_bounded_sampling_follows_its_pdf(alpha: tuple, cosine: float) -> None:
    """Pass a chi-squared test on the upper hemisphere, where the pdf holds."""
    wo = view(cosine)
    wi = draw_many(wo, alpha, REFLECTION)
    above = wi[wi[:, 2] > 0]
    cells = sphere_grid(ROWS, COLUMNS, FINE)
    expected = counts_due(lobe_at(wo, cells, alpha, REFLECTION)[:, 1], ROWS, COLUMNS, FINE, len(wi))
    assert expected.sum() <= len(wi) * 1.002
    assert abs(expected.sum() - len(above)) < 0.003 * len(wi)
    assert chi_squared_score(count_on_sphere(above, ROWS, COLUMNS), expected) < 5


@pytest.mark.parametrize("lobe", [GLASS_REFLECTION, REFRACTION])
@pytest.mark.parametrize("eta", [1.5, 1 / 1.5])
@pytest.mark.parametrize("cosine", [0.1, 0.6, 1.0])
def test_glass_sampling_follows_its_pdf(lobe: int, eta: float, cosine: float) -> None:
    """Pass a chi-squared test on the side where each lobe goes, total internal reflection included."""
    wo, alpha = view(cosine), (0.5, 0.5)
    wi = draw_many(wo, alpha, lobe, eta)
    side = wi[:, 2] < 0 if lobe == REFRACTION else wi[:, 2] > 0
    cells = sphere_grid(ROWS, COLUMNS, FINE)
    expected = counts_due(lobe_at(wo, cells, alpha, lobe, eta)[:, 1], ROWS, COLUMNS, FINE, len(wi))
    assert abs(expected.sum() - side.sum()) < 0.005 * len(wi)
    assert chi_squared_score(count_on_sphere(wi[side], ROWS, COLUMNS), expected) < 5


@pytest.mark.parametrize("lobe", [REFLECTION, GLASS_REFLECTION])
def test_reflection_is_reciprocal(lobe: int) -> None:
    """Exchange the directions: f wi.z / wi.z stays the same."""
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(200, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 0.05
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for a, b in directions.reshape(100, 2, 3):
        there = lobe_at(tuple(a), b[None], (0.4, 0.4), lobe)[0, 0] / b[2]
        back = lobe_at(tuple(b), a[None], (0.4, 0.4), lobe)[0, 0] / a[2]
        assert there == pytest.approx(back, rel=1e-4)


def test_refraction_is_reciprocal_up_to_the_squared_index() -> None:
    """Exchange the directions and invert the index: f scales by the square of the index (no compression here)."""
    wo, alpha, eta = view(0.7), (0.4, 0.4), 1.5
    wi = draw_many(wo, alpha, REFRACTION, eta, 200)
    wi = wi[wi[:, 2] < -0.05]
    flip = np.array([1, 1, -1])
    for direction in wi:
        there = lobe_at(wo, direction[None], alpha, REFRACTION, eta)[0, 0] / abs(direction[2])
        back = lobe_at(tuple(direction * flip), (np.array(wo) * flip)[None], alpha, REFRACTION, 1 / eta)[0, 0] / wo[2]
        assert there == pytest.approx(back * eta**2, rel=2e-3)


@pytest.mark.parametrize("alpha", [1.5e-5, 1e-4, 1e-3, 0.03, 1.0])
@pytest.mark.parametrize("cosine", [1e-4, 0.5, 1.0])
def test_weights_stay_bounded_at_any_roughness(alpha: float, cosine: float) -> None:
    """Get value / pdf in [0, 1] for all samples of lobes from nearly mirrors to chalk."""
    wo = view(cosine)
    wi = draw_many(wo, (alpha, alpha), REFLECTION, count=4096)
    wi = wi[wi[:, 2] > 0]
    value = lobe_at(wo, wi, (alpha, alpha), REFLECTION)
    assert np.isfinite(value).all() and (value[:, :2] >= 0).all()
    weight = value[:, 0] / np.maximum(value[:, 1], 1e-30)
    assert weight.max() <= 1.001
    assert np.median(weight) > 0.2


def test_bound_spares_samples() -> None:
    """Lose fewer directions below the horizon than plain visible normals do."""
    wo, alpha = view(0.2), (0.6, 0.6)
    bounded = (draw_many(wo, alpha, REFLECTION)[:, 2] <= 0).mean()
    plain = (draw_many(wo, alpha, GLASS_REFLECTION)[:, 2] <= 0).mean()
    assert bounded < 0.8 * plain
