# SPDX-License-Identifier: GPL-3.0-or-later
"""Test what the G-buffer says of materials: directional albedos, the fitted GGX lobe, packing; and history taps."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.passes.gbuffer import GBUFFER_ARRAYS
from burnish.engine.tables import albedo_tables
from burnish.kernels import gbuffer, types
from burnish.kernels.gbuffer import GBuffer, Surface, SurfaceMaterial, load_material, store_material
from burnish.kernels.principled import evaluate_bsdf, prepare_bsdf, sample_bsdf
from burnish.kernels.reflectance import bsdf_albedo, fit_lobe
from burnish.kernels.reprojection import tap_pixel, tap_weight
from burnish.kernels.sampling import sample_pair, sample_sphere
from burnish.kernels.surface_brdf import evaluate_brdf
from burnish.kernels.types import Closure, ShadingPoint, Tables

from tests import bsdf_cases
from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SAMPLES = 16384

LOBES = {
    "plastic": {"color": (0.8, 0.5, 0.2)},
    "smooth plastic": {"color": (0.8, 0.5, 0.2), "roughness": 0.1},
    "rough plastic": {"color": (0.1, 0.1, 0.1), "roughness": 1.0},
    "gold": {"metallic": 1.0, "color": (1.0, 0.7, 0.3), "roughness": 0.3},
    "white metal": {"metallic": 1.0, "roughness": 1.0},
    "tinted metal": {"metallic": 1.0, "color": (0.9, 0.6, 0.5), "specular_tint": (0.3, 0.5, 1.0), "roughness": 0.4},
    "half metal": {"metallic": 0.5, "color": (0.3, 0.6, 0.9), "roughness": 0.6},
    "plain metal": {"metallic": 1.0, "roughness": 0.8, "multiscatter": 0},
    "clay": {"diffuse_roughness": 1.0, "specular_level": 0.0, "color": (0.7, 0.4, 0.1)},
    "coat": {"coat": 1.0, "color": (0.6, 0.1, 0.1), "roughness": 0.7, "coat_tint": (1.0, 0.8, 0.6)},
    "rough coat": {"coat": 1.0, "color": (0.6, 0.1, 0.1), "roughness": 0.9, "coat_roughness": 0.4},
    "coated metal": {"coat": 1.0, "metallic": 1.0, "color": (0.9, 0.5, 0.1), "roughness": 0.5, "coat_roughness": 0.1},
    "coated mirror": {"coat": 0.5, "metallic": 1.0, "roughness": 0.06},
    "coat alone": {"coat": 1.0, "color": (0.1, 0.1, 0.1), "specular_level": 0.0, "coat_roughness": 0.3},
    "sheen": {"sheen": 1.0, "color": (0.2, 0.2, 0.3), "specular_level": 0.0},
    "thin leaf": {"thin_wall": 1, "subsurface": 1.0, "color": (0.3, 0.6, 0.1)},
    "glass": {"transmission": 1.0, "roughness": 0.2},
    "thin glass": {"transmission": 1.0, "roughness": 0.2, "thin_wall": 1, "color": (0.9, 0.8, 0.7)},
    "glass node": {"kind": int(types.CLOSURE_GLASS), "color": (0.9, 0.8, 0.7), "roughness": 0.4},
    "refraction": {"kind": int(types.CLOSURE_REFRACTION), "roughness": 0.3},
    "diffuse": {"kind": int(types.CLOSURE_DIFFUSE), "color": (0.7, 0.4, 0.1), "roughness": 0.0},
    "rough diffuse": {"kind": int(types.CLOSURE_DIFFUSE), "color": (0.7, 0.4, 0.1), "roughness": 0.8},
    "glossy": {"kind": int(types.CLOSURE_GLOSSY), "color": (0.7, 0.4, 0.1), "roughness": 0.5},
    "translucent": {"kind": int(types.CLOSURE_TRANSLUCENT), "color": (0.7, 0.4, 0.1)},
    "toon": {"kind": int(types.CLOSURE_TOON_DIFFUSE), "color": (0.7, 0.4, 0.1), "roughness": 0.3, "anisotropic": 0.5},
    "wide toon": {"kind": int(types.CLOSURE_TOON_DIFFUSE), "roughness": 0.8, "anisotropic": 0.9},
}


@wp.kernel
def measure_albedos(
    # In:
    tables: Tables, closures: wp.array[Closure], points: wp.array[ShadingPoint], samples: int,
    # Out:
    table_out: wp.array2d[wp.vec3], integral_out: wp.array2d[wp.vec3],
):
    """Write diffuse, translucent, specular and transmitted albedo of case i, and the same integrals by sampling."""
    i = wp.tid()
    bsdf = prepare_bsdf(tables, closures[i], points[i])
    albedo = bsdf_albedo(tables, bsdf, points[i].wo)
    table_out[i, 0] = albedo.diffuse
    table_out[i, 1] = albedo.translucent
    table_out[i, 2] = albedo.specular
    table_out[i, 3] = albedo.transmitted
    for k in range(samples):
        u = sample_pair(wp.uint32(i), wp.uint32(k), 0)
        v = sample_pair(wp.uint32(i), wp.uint32(k), 1)
        s = sample_bsdf(bsdf, points[i].wo, wp.vec3(u[0], u[1], v[0]))
        if s.pdf > 0.0:
            diffuse = wp.vec3(0.0)
            if s.delta == 0:
                diffuse = evaluate_bsdf(bsdf, points[i].wo, s.wi).diffuse / s.pdf
            side = wp.where(s.wi[2] > 0.0, 0, 1)
            integral_out[i, 2 + side] = integral_out[i, 2 + side] + (s.weight - diffuse) / float(samples)
            integral_out[i, side] = integral_out[i, side] + diffuse / float(samples)


@wp.kernel
def fit_and_integrate(
    # In:
    tables: Tables, closures: wp.array[Closure], points: wp.array[ShadingPoint], samples: int,
    # Out:
    gbuffer_out: GBuffer, specular_out: wp.array[wp.vec3], integral_out: wp.array[wp.vec3],
):
    """Pack case i's material and integrate the lobes that come out again."""
    i = wp.tid()
    wo = points[i].wo
    bsdf = prepare_bsdf(tables, closures[i], points[i])
    albedo = bsdf_albedo(tables, bsdf, wo)
    material = SurfaceMaterial()
    material.roughness = albedo.roughness
    material = fit_lobe(tables, albedo, wp.dot(bsdf.specular_normal, wo), material)
    material.diffuse = albedo.diffuse
    material.translucent = albedo.translucent
    material.specular = albedo.specular
    material.coat = albedo.coat
    material.coat_roughness = albedo.coat_roughness
    store_material(gbuffer_out, i, material)
    specular_out[i] = albedo.specular
    unpacked = load_material(gbuffer_out, i)
    surface = Surface()
    surface.normal = wp.vec3(0.0, 0.0, 1.0)
    surface.geometric_normal = surface.normal
    total = wp.vec3(0.0)
    # Sampled by the real BSDF: the fitted lobes are where it is.
    for k in range(samples):
        u = sample_pair(wp.uint32(i), wp.uint32(k), 0)
        v = sample_pair(wp.uint32(i), wp.uint32(k), 1)
        s = sample_bsdf(bsdf, wo, wp.vec3(u[0], u[1], v[0]))
        if s.pdf > 0.0 and s.delta == 0:
            total += evaluate_brdf(unpacked, surface, surface.normal, wo, s.wi).specular / s.pdf
    integral_out[i] = total / float(samples)


def run_cases(names: list[str], cosines: list[float]) -> tuple[list, list]:
    """Return closures and points of all pairs."""
    pairs = [(name, cosine) for name in names for cosine in cosines]
    return ([bsdf_cases.closure(**LOBES[name]) for name, _ in pairs],
            [bsdf_cases.point(bsdf_cases.view(cosine)) for _, cosine in pairs])


def device_array(values: list, dtype: type) -> wp.array:
    """Return a device array of structs."""
    return wp.array(values, dtype=dtype, device=DEVICE)


def make_gbuffer(count: int) -> GBuffer:
    """Return an empty G-buffer."""
    buffers = GBuffer()
    for name, dtype in GBUFFER_ARRAYS.items():
        setattr(buffers, name, wp.zeros(count, dtype=dtype, device=DEVICE))
    return buffers


@pytest.mark.parametrize("name", LOBES)
def test_albedos_are_the_lobes_integrals(name: str) -> None:
    """Compare table look-ups with integration by sampling, for views from steep to shallow."""
    closures, points = run_cases([name], [0.95, 0.7, 0.4, 0.2])
    table = wp.zeros((4, 4), dtype=wp.vec3, device=DEVICE)
    integral = wp.zeros((4, 4), dtype=wp.vec3, device=DEVICE)
    wp.launch(measure_albedos, 4, [albedo_tables(DEVICE), device_array(closures, Closure),
                                   device_array(points, ShadingPoint), SAMPLES], [table, integral], device=DEVICE)
    # Refraction without Fresnel has no table of its own: that of glass stands in.
    tolerance = 0.05 if name == "refraction" else 0.02
    np.testing.assert_allclose(table.numpy(), integral.numpy(), atol=0.012, rtol=tolerance)


@pytest.mark.parametrize("name", [
    "plastic", "smooth plastic", "rough plastic", "gold", "white metal", "tinted metal", "half metal", "plain metal",
    "glossy", "coat", "rough coat", "coated metal", "coated mirror", "coat alone", "glass"])
def test_packed_lobes_keep_the_albedo(name: str) -> None:
    """Pack and unpack the reflecting lobes and integrate them: as much is reflected as by the material."""
    cosines = [0.95, 0.7, 0.4, 0.2]
    closures, points = run_cases([name], cosines)
    packed = make_gbuffer(len(cosines))
    outputs = [packed, *(wp.zeros(len(cosines), dtype=wp.vec3, device=DEVICE) for _ in range(2))]
    inputs = [albedo_tables(DEVICE), device_array(closures, Closure), device_array(points, ShadingPoint)]
    wp.launch(fit_and_integrate, len(cosines), [*inputs, 4 * SAMPLES], outputs, device=DEVICE)
    # A rough coat's albedo is a fit, see specular_lobes.coat_albedo.
    np.testing.assert_allclose(outputs[2].numpy(), outputs[1].numpy(), rtol=0.04 if name == "rough coat" else 0.02)


@pytest.mark.parametrize(("name", "coat", "roughness"), [
    ("coat", 0.03, 0.7), ("coated metal", 0.1, 0.5), ("coated mirror", 0.0, 0.06), ("coat alone", 0.0, 0.3)])
def test_a_coat_is_a_lobe_of_its_own_where_it_shows(name: str, coat: float, roughness: float) -> None:
    """Keep the coat's roughness and the base's apart unless one lobe can stand for both."""
    closures, points = run_cases([name], [0.7])
    packed = make_gbuffer(1)
    outputs = [packed, *(wp.zeros(1, dtype=wp.vec3, device=DEVICE) for _ in range(2))]
    wp.launch(fit_and_integrate, 1, [albedo_tables(DEVICE), device_array(closures, Closure),
                                     device_array(points, ShadingPoint), 1], outputs, device=DEVICE)
    material, coated = int(packed.material.numpy()[0]), int(packed.coat.numpy()[0])
    assert bool(material & int(gbuffer.SURFACE_COATED)) == (coat > 0.0)
    assert (material & 65535) / 65535 == pytest.approx(roughness, abs=5e-3)
    if coat > 0.0:
        assert (coated >> 16) / 65535 == pytest.approx(coat, abs=1e-4)
        assert 0.04 < (coated & 65535) / 65535 < 0.06


@wp.kernel
def compare_values(
    # In:
    tables: Tables, closures: wp.array[Closure], points: wp.array[ShadingPoint], packed: GBuffer,
    # Out:
    real_out: wp.array2d[wp.vec3], packed_out: wp.array2d[wp.vec3],
):
    """Evaluate case i's BSDF and its packed form towards random directions: specular, and all the rest."""
    i, j = wp.tid()
    wo = points[i].wo
    bsdf = prepare_bsdf(tables, closures[i], points[i])
    wi = sample_sphere(sample_pair(wp.uint32(7), wp.uint32(j), 0))
    real = evaluate_bsdf(bsdf, wo, wi)
    surface = Surface()
    surface.normal = wp.vec3(0.0, 0.0, 1.0)
    surface.geometric_normal = surface.normal
    value = evaluate_brdf(load_material(packed, i), surface, surface.normal, wo, wi)
    real_out[i, 2 * j] = real.f - real.diffuse
    packed_out[i, 2 * j] = value.specular
    real_out[i, 2 * j + 1] = real.diffuse
    packed_out[i, 2 * j + 1] = value.diffuse + value.transmitted


@pytest.mark.parametrize(("name", "tolerance"), [
    ("diffuse", 0.005), ("translucent", 0.005), ("thin leaf", 0.1), ("glossy", 0.02), ("gold", 0.05), ("plastic", 0.1)])
def test_packed_material_has_the_same_values(name: str, tolerance: float) -> None:
    """Compare the packed lobes with the material's own BSDF, direction by direction."""
    count, directions = 2, 512
    closures, points = run_cases([name], [0.9, 0.5])
    packed = make_gbuffer(count)
    tables = albedo_tables(DEVICE)
    inputs = [tables, device_array(closures, Closure), device_array(points, ShadingPoint)]
    scratch = [wp.zeros(count, dtype=wp.vec3, device=DEVICE) for _ in range(2)]
    wp.launch(fit_and_integrate, count, [*inputs, 1], [packed, *scratch], device=DEVICE)
    outputs = [wp.zeros((count, 2 * directions), dtype=wp.vec3, device=DEVICE) for _ in range(2)]
    wp.launch(compare_values, (count, directions), [*inputs, packed], outputs, device=DEVICE)
    real, value = outputs[0].numpy(), outputs[1].numpy()
    assert real.max() > 0.05
    np.testing.assert_allclose(value, real, rtol=tolerance, atol=tolerance * real.max())


@wp.kernel
def weigh_taps(
    # In:
    positions: wp.array[wp.vec2],
    # Out:
    weights_out: wp.array2d[float], pixels_out: wp.array2d[int],
):
    """Write weight and pixel of all taps in a picture 100 px wide."""
    i, tap = wp.tid()
    weights_out[i, tap] = tap_weight(positions[i], tap)
    pixels_out[i, tap] = tap_pixel(positions[i], tap, 100)


def test_taps_interpolate() -> None:
    """Weigh the 2x2 pixels around a position bilinearly; a pixel's centre counts that pixel alone."""
    positions = np.array([[3.5, 7.5], [3.75, 7.5], [4.0, 8.0], [3.5, 7.25]], np.float32)
    weights = wp.zeros((4, 4), dtype=float, device=DEVICE)
    pixels = wp.zeros((4, 4), dtype=int, device=DEVICE)
    wp.launch(weigh_taps, (4, 4), [wp.array(positions, dtype=wp.vec2, device=DEVICE)], [weights, pixels], device=DEVICE)
    expected = [[1, 0, 0, 0], [0.75, 0.25, 0, 0], [0.25] * 4, [0.25, 0, 0.75, 0]]
    np.testing.assert_allclose(weights.numpy(), expected, atol=1e-6)
    assert pixels.numpy()[:3].tolist() == [[703, 704, 803, 804]] * 3
    assert pixels.numpy()[3].tolist() == [603, 604, 703, 704]


def test_bright_reflectance_survives_packing() -> None:
    """Keep the reflectance of rough white metal above 1, and flags that are not those of packing."""
    closures, points = run_cases(["white metal"], [1.0])
    packed = make_gbuffer(1)
    outputs = [packed, *(wp.zeros(1, dtype=wp.vec3, device=DEVICE) for _ in range(2))]
    wp.launch(fit_and_integrate, 1, [albedo_tables(DEVICE), device_array(closures, Closure),
                                     device_array(points, ShadingPoint), SAMPLES], outputs, device=DEVICE)
    assert int(packed.material.numpy()[0]) & int(gbuffer.SURFACE_BRIGHT)
    np.testing.assert_allclose(outputs[2].numpy(), 1.0, atol=0.02)
