# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of prepared BSDFs: sampling against evaluation, energy, delta lobes, layers, normals, and hostile input."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from burnish.kernels import types

from tests.bsdf_cases import (
    albedo,
    chi_squared_score,
    closure,
    count_on_sphere,
    counts_due,
    emission,
    evaluate,
    point,
    sample,
    sphere_grid,
    view,
)

ROWS, COLUMNS, FINE = 32, 32, (24, 6)
SAMPLES = 1 << 16

MATERIALS = {
    "dielectric": dict(color=(0.8, 0.5, 0.2)),
    "metal": dict(metallic=1.0, color=(0.9, 0.6, 0.2), specular_tint=(0.8, 1, 1)),
    "anisotropic": dict(metallic=1.0, anisotropic=0.9, tangent=(0.6, 0.8, 0), anisotropic_rotation=0.1, roughness=0.6),
    "coat": dict(coat=1.0, coat_roughness=0.4, coat_tint=(0.9, 0.5, 0.3), roughness=0.7),
    "sheen": dict(sheen=1.0, sheen_roughness=0.4, roughness=0.8),
    "glass": dict(transmission=1.0, roughness=0.8),
    "half glass": dict(transmission=0.5, metallic=0.2, roughness=0.8, color=(0.5, 0.8, 0.9)),
    "thin glass": dict(transmission=1.0, thin_wall=1, roughness=0.6),
    "thin paper": dict(subsurface=1.0, thin_wall=1, subsurface_anisotropy=0.2, diffuse_roughness=0.7, roughness=0.6),
    "film": dict(film_thickness=400.0, film_ior=1.8, color=(0.1, 0.2, 0.3), roughness=0.6),
    "metal film": dict(film_thickness=300.0, film_ior=1.33, metallic=1.0, color=(0.9, 0.6, 0.2), roughness=0.6),
    "glass film": dict(film_thickness=300.0, film_ior=1.33, transmission=1.0, roughness=0.8),
    "diffuse node": dict(kind=int(types.CLOSURE_DIFFUSE), roughness=1.0, color=(0.9, 0.5, 0.1)),
    "glossy node": dict(kind=int(types.CLOSURE_GLOSSY), roughness=0.5, anisotropic=-0.5, tangent=(1, 0, 0)),
    "glass node": dict(kind=int(types.CLOSURE_GLASS), roughness=0.8),
    "refraction node": dict(kind=int(types.CLOSURE_REFRACTION), roughness=0.8),
    "translucent node": dict(kind=int(types.CLOSURE_TRANSLUCENT)),
    "sheen node": dict(kind=int(types.CLOSURE_SHEEN), roughness=0.6),
    "toon node": dict(kind=int(types.CLOSURE_TOON_DIFFUSE), roughness=0.5, anisotropic=0.3),
    "glossy toon node": dict(kind=int(types.CLOSURE_TOON_GLOSSY), roughness=0.7, anisotropic=0.2),
}
SEEN = [(1.0, 0), (0.5, 0), (0.15, 0), (0.5, 1)]
"""(cosine of the view, back face)"""


def cases(**fields: object) -> tuple[list, list]:
    """Return the closures and points of one material for all of SEEN."""
    return [closure(**fields) for _ in SEEN], [point(view(c), backfacing=back) for c, back in SEEN]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if i % 2 else ()) for i, name in enumerate(MATERIALS)])
def test_sampling_follows_the_pdf(name: str) -> None:
    """Pass a chi-squared test over the whole sphere, and integrate to at most 1."""
    closures, points = cases(**MATERIALS[name])
    drawn = sample(closures, points, SAMPLES)
    cells = sphere_grid(ROWS, COLUMNS, FINE)
    pdf = evaluate(closures, points, np.broadcast_to(cells, (len(SEEN), *cells.shape)))[1]
    for i, seen in enumerate(SEEN):
        expected = counts_due(pdf[i], ROWS, COLUMNS, FINE, SAMPLES)
        wi = drawn["wi"][i][drawn["pdf"][i] > 0]
        assert expected.sum() < SAMPLES * 1.005, seen
        assert abs(expected.sum() - len(wi)) < 0.006 * SAMPLES, seen
        assert chi_squared_score(count_on_sphere(wi, ROWS, COLUMNS), expected) < 5, seen


@pytest.mark.parametrize("name", MATERIALS)
def test_weights_are_value_over_pdf(name: str) -> None:
    """Find weight * pdf = f cos and the same pdf when evaluating sampled directions."""
    closures, points = cases(**MATERIALS[name])
    drawn = sample(closures, points, 2000)
    f, pdf = evaluate(closures, points, drawn["wi"])
    hit = drawn["pdf"] > 0
    assert hit.mean() > 0.3
    assert not drawn["delta"][hit].any()
    np.testing.assert_allclose(drawn["pdf"][hit], pdf[hit], rtol=1e-4)
    np.testing.assert_allclose((drawn["weight"] * drawn["pdf"][..., None])[hit], f[hit], rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("name", MATERIALS)
def test_kind_tells_the_side(name: str) -> None:
    """Send transmission below the surface and the rest above it."""
    closures, points = cases(**MATERIALS[name])
    drawn = sample(closures, points, 2000)
    hit = drawn["pdf"] > 0
    below = drawn["wi"][..., 2] < 0
    np.testing.assert_array_equal(below[hit], (drawn["kind"] == int(types.VISIBLE_TRANSMISSION))[hit])


FURNACE = list(itertools.product((0.0, 0.3, 0.7, 1.0), (0.0, 1.0), (1.0, 1.5, 3.0), (0.0, 1.0)))


@pytest.mark.parametrize("cosine", [0.25, 0.6, 1.0])
def test_white_furnace(cosine: float) -> None:
    """Return all light from white opaque materials, to 2 %, in every corner of roughness, metal, index and coat."""
    closures = [closure(roughness=r, metallic=m, ior=i, coat=c, coat_roughness=r) for r, m, i, c in FURNACE]
    result = albedo(closures, [point(view(cosine))] * len(closures))
    for case, value in zip(FURNACE, result, strict=True):
        assert value == pytest.approx(1.0, abs=0.02), case
    # A single lobe with nothing beneath is exact but for the tables' interpolation.
    metals = result[[i for i, case in enumerate(FURNACE) if case[1] == 1.0 and case[3] == 0.0]]
    np.testing.assert_allclose(metals, 1.0, atol=0.004)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("ior", [1.0, 1.33, 1.5, 2.0, 0.7])
def test_white_furnace_of_glass(roughness: float, ior: float) -> None:
    """Keep light at glass from outside; from inside lose at most what Cycles loses, and never gain."""
    cosines = (0.25, 0.5, 1.0)
    for backfacing in (0, 1):
        closures = [closure(transmission=1.0, roughness=roughness, ior=ior)] * len(cosines)
        result = albedo(closures, [point(view(c), backfacing=backfacing) for c in cosines])
        assert result.max() < 1.01
        outside = (ior >= 1.0) == (backfacing == 0)
        assert result.min() > (0.98 if outside else 0.85)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_plain_ggx_loses_energy(metallic: float) -> None:
    """Darken rough materials without multiple scattering."""
    closures = [closure(roughness=1.0, metallic=metallic, multiscatter=flag, ior=2.5) for flag in (0, 1)]
    plain, preserved = albedo(closures, [point(view(0.8))] * 2)[:, 0]
    assert plain < preserved - 0.02


def test_smooth_metal_is_a_mirror() -> None:
    """Reflect by Schlick's curve into the mirror direction, without a density."""
    wo = view(0.6)
    closures, points = [closure(metallic=1.0, roughness=0.0, color=(0.5, 0.5, 0.5))], [point(wo)]
    drawn = sample(closures, points, 64)
    assert drawn["delta"].all() and (drawn["kind"] == int(types.VISIBLE_GLOSSY)).all()
    np.testing.assert_allclose(drawn["wi"][0], np.broadcast_to((-wo[0], 0, wo[2]), (64, 3)), atol=1e-6)
    np.testing.assert_allclose(drawn["weight"], 0.5 + 0.5 * 0.4**5, rtol=1e-4)
    np.testing.assert_allclose(drawn["pdf"], 1.0)
    f, pdf = evaluate(closures, points, np.array([[(-wo[0], 0, wo[2]), (0, 0, 1)]]))
    assert not f.any() and not pdf.any()


@pytest.mark.parametrize("backfacing", [0, 1])
@pytest.mark.parametrize("cosine", [0.2, 0.6, 0.95])
def test_smooth_glass_follows_snell(backfacing: int, cosine: float) -> None:
    """Refract by Snell's law and split by Fresnel's, total internal reflection included."""
    wo, eta = view(cosine), 1.5 if backfacing == 0 else 1 / 1.5
    drawn = sample([closure(transmission=1.0, roughness=0.0, color=(0.25, 0.25, 0.25))],
                   [point(wo, backfacing=backfacing)], 4096)
    through = drawn["kind"][0] == int(types.VISIBLE_TRANSMISSION)
    sin_t = wo[0] / eta
    if sin_t >= 1:
        assert not through.any()
        np.testing.assert_allclose(drawn["weight"], 1.0, atol=1e-5)
        return
    np.testing.assert_allclose(
        drawn["wi"][0][through], np.broadcast_to((-sin_t, 0, -np.sqrt(1 - sin_t**2)), (through.sum(), 3)), atol=1e-5)
    cos_t = np.sqrt(1 - sin_t**2)
    f = 0.5 * (((cosine - eta * cos_t) / (cosine + eta * cos_t)) ** 2
               + ((eta * cosine - cos_t) / (eta * cosine + cos_t)) ** 2)
    reflected = drawn["weight"][0, ~through, 0].sum() / 4096
    refracted = drawn["weight"][0, through, 0].sum() / 4096
    assert reflected == pytest.approx(f, abs=0.01)
    # The tint along the path is the root of the colour: light crosses two faces of a glass body.
    assert refracted == pytest.approx((1 - f) * 0.5, abs=0.01)


def test_smooth_thin_wall_lets_light_straight_through() -> None:
    """Pass light unbent through a smooth sheet."""
    wo = view(0.7)
    drawn = sample([closure(transmission=1.0, thin_wall=1, roughness=0.0)], [point(wo)], 512)
    through = drawn["kind"][0] == int(types.VISIBLE_TRANSMISSION)
    assert 0.7 < through.mean() < 0.99 and drawn["delta"].all()
    np.testing.assert_allclose(drawn["wi"][0][through], np.broadcast_to(-np.array(wo), (through.sum(), 3)), atol=1e-5)


def test_index_near_one_goes_straight() -> None:
    """Treat the transmission of matched indices as unbent, however rough."""
    wo = view(0.4)
    drawn = sample([closure(transmission=1.0, roughness=0.8, ior=1.0)], [point(wo)], 256)
    assert drawn["delta"].all()
    np.testing.assert_allclose(drawn["wi"][0], np.broadcast_to(-np.array(wo), (256, 3)), atol=1e-5)
    np.testing.assert_allclose(drawn["weight"], 1.0, atol=1e-4)


def test_coat_and_sheen_dim_what_lies_below() -> None:
    """Attenuate the emission by each layer, more at grazing angles."""
    layers = [dict(), dict(coat=1.0), dict(sheen=1.0), dict(coat=1.0, coat_tint=(0.5, 1, 1)), dict(weight=(0.5,) * 3)]
    closures = [closure(emission_layered=(2, 2, 2), emission=(0, 0, 1), **fields) for fields in layers]
    bare, coated, sheened, tinted, half = emission(closures, [point(view(0.9))] * len(layers))
    grazing = emission(closures, [point(view(0.1))] * len(layers))
    np.testing.assert_allclose(bare, (2, 2, 3), rtol=1e-5)
    np.testing.assert_allclose(coated, (1.92, 1.92, 2.92), rtol=0.01)
    assert (sheened < bare).all() and (grazing[1] < coated).all() and (grazing[2] < sheened).all()
    assert tinted[0] < 0.55 * coated[0] and tinted[1] == pytest.approx(coated[1], rel=1e-3)
    np.testing.assert_allclose(half, (1, 1, 2), rtol=1e-5)


def test_weight_scales_the_lobe() -> None:
    """Multiply the albedo by the closure's weight, channel by channel."""
    closures = [closure(weight=(0.2, 0.5, 1.0), roughness=0.4)]
    np.testing.assert_allclose(albedo(closures, [point(view(0.7))])[0], (0.2, 0.5, 1.0), rtol=0.01)


def test_black_and_missing_closures_absorb() -> None:
    """Return pdf 0 for materials without any lobe."""
    closures = [closure(kind=int(types.CLOSURE_NONE)), closure(weight=(0, 0, 0)),
                closure(kind=int(types.CLOSURE_DIFFUSE), color=(0, 0, 0))]
    drawn = sample(closures, [point(view(0.5))] * 3, 16)
    assert not drawn["pdf"].any() and not drawn["weight"].any()


def test_specular_lobes_vanish_below_the_shading_normal() -> None:
    """Reflect nothing glossy where the view is below the lobe's normal, and stay finite."""
    tilted = (-0.995, 0.0, 0.0998)
    wo = view(0.3)
    closures = [closure(metallic=1.0, normal=tilted, coat_normal=tilted, multiscatter=0)]
    drawn = sample(closures, [point(wo)], 256)
    assert np.isfinite(drawn["weight"]).all()
    # The normal was turned until the mirrored view leaves the surface, so the metal still reflects upwards.
    assert (drawn["wi"][drawn["pdf"] > 0][:, 2] > 0).all()


@pytest.mark.parametrize("angle", [10.0, 35.0, 60.0])
def test_bump_shadows_the_far_side(angle: float) -> None:
    """Let no light through a bumped diffuse surface from behind the smooth one, and dim grazing light."""
    bumped = (np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle)))
    closures = [closure(kind=int(types.CLOSURE_DIFFUSE), roughness=0.0, normal=n) for n in (bumped, (0, 0, 1))]
    wi = np.array([(0.995, 0, -0.0998), (0.995, 0, 0.0998), bumped])
    f = evaluate(closures, [point(view(0.9))] * 2, np.broadcast_to(wi, (2, 3, 3)))[0][..., 0]
    assert f[0, 0] == 0.0
    lambert = max(float(wi[1] @ bumped), 0.0) / np.pi
    assert 0.0 < f[0, 1] < lambert
    assert f[0, 2] > 0.8 / np.pi
    assert f[1, 1] == pytest.approx(0.0998 / np.pi, rel=1e-3)


def test_reflections_leave_the_triangle() -> None:
    """Absorb samples that the shading normal sends below the triangle."""
    smooth = (0.6, 0.0, 0.8)
    for fields in (dict(kind=int(types.CLOSURE_DIFFUSE)), dict(metallic=1.0, roughness=0.4)):
        drawn = sample([closure(normal=smooth, coat_normal=smooth, **fields)],
                       [point(view(0.6), normal=smooth, geometric=(0, 0, 1))], 4000)
        assert (drawn["wi"][drawn["pdf"] > 0][:, 2] > 0).all()


EXTREMES = {
    "roughness": (0.0, 1e-3, 0.5, 1.0, 5.0, -1.0), "ior": (0.0, 1e-5, 0.99995, 1.0, 1.5, 1e5), "metallic": (0, 0.5, 1),
    "color": ((0, 0, 0), (1, 1, 1), (7, 0.5, 0), (-1, 2, 0)), "transmission": (0, 0.5, 1), "coat": (0, 1),
    "coat_roughness": (0.0, 1.0), "coat_ior": (1.0, 1.5, 1e5), "coat_tint": ((1, 1, 1), (0, 0.5, 3)), "sheen": (0, 1),
    "sheen_roughness": (0.0, 0.5, 1.0), "specular_level": (0.0, 0.5, 1.0, 40.0), "thin_wall": (0, 1),
    "specular_tint": ((1, 1, 1), (0, 0, 0), (3, 1, 0.5)), "subsurface": (0, 1), "diffuse_roughness": (0.0, 1.0),
    "anisotropic": (0.0, 1.0), "tangent": ((0, 0, 0), (1, 0, 0), (0, 0, 1)), "multiscatter": (0, 1),
    "normal": ((0, 0, 1), (0.8, 0, 0.6), (0, 0, 0), (0, 0.9999, -0.01)), "kind": tuple(range(8)),
}


def test_extreme_input_stays_finite() -> None:
    """Get finite, non-negative values and weights for every mixture of hostile parameters, views and lights."""
    rng = np.random.default_rng(11)
    count = 4000
    closures, points = [], []
    for _ in range(count):
        fields = {name: values[rng.integers(len(values))] for name, values in EXTREMES.items()}
        if rng.random() < 0.6:
            fields["kind"] = int(types.CLOSURE_PRINCIPLED)
        number = {name: value if name in ("kind", "thin_wall", "multiscatter") or isinstance(value, tuple)
                  else float(value) for name, value in fields.items()}
        closures.append(closure(coat_normal=fields["normal"], **{k: v for k, v in number.items()}))
        cosine = rng.choice([1e-7, 1e-3, 0.3, 1.0])
        points.append(point(view(cosine), backfacing=int(rng.integers(2))))
    drawn = sample(closures, points, 16)
    for name in ("weight", "pdf", "wi"):
        assert np.isfinite(drawn[name]).all(), name
    assert (drawn["weight"] >= 0).all() and (drawn["pdf"] >= 0).all()
    hit = drawn["pdf"] > 0
    np.testing.assert_allclose(np.linalg.norm(drawn["wi"][hit], axis=-1), 1.0, atol=1e-4)
    wi = rng.normal(size=(count, 8, 3))
    wi /= np.linalg.norm(wi, axis=-1, keepdims=True)
    wi[:, 0] = (1, 0, 0)
    wi[:, 1] = (0, 0, 1)
    f, pdf = evaluate(closures, points, wi)
    assert np.isfinite(f).all() and np.isfinite(pdf).all()
    assert (f >= 0).all() and (pdf >= 0).all()
