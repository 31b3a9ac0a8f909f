# SPDX-License-Identifier: GPL-3.0-or-later
"""Test what the G-buffer holds of reflecting lobes: as much light as the BSDF reflects, and as the packed lobe does."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.tables import albedo_tables
from burnish.kernels.albedo_tables import plane_point, view_at
from burnish.kernels.gbuffer import GBuffer, Surface, SurfaceMaterial, load_material, store_material
from burnish.kernels.geometry_math import TWO_PI
from burnish.kernels.layering import prepare_bsdf
from burnish.kernels.principled import evaluate_bsdf
from burnish.kernels.reflectance import bsdf_albedo, fit_lobe
from burnish.kernels.reflection_glass import is_inside, sample_inside, trapped_albedo
from burnish.kernels.specular_lobes import lobes_pdf, lobes_value, sample_lobes, specular_lobes
from burnish.kernels.types import CLOSURE_PRINCIPLED, CLOSURE_REFRACTION, Bsdf, Closure, ShadingPoint, Tables

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SAMPLES = 4096
SUM_SAMPLES = 16384
COSINES = (1.0, 0.7, 0.4, 0.2, 0.1)
ROUGHNESSES = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)
WORDS = ("diffuse", "specular", "f0", "material", "translucent", "transmitted", "coat")


@wp.struct
class Look:
    """A Principled material."""

    color: float
    metallic: float
    transmission: float
    coat: float
    ior: float


@wp.func
def point_at(cosine: float, backfacing: int) -> ShadingPoint:
    p = ShadingPoint()
    p.wo = view_at(cosine)
    p.normal = wp.vec3(0.0, 0.0, 1.0)
    p.geometric_normal = p.normal
    p.backfacing = backfacing
    return p


@wp.func
def prepared(tables: Tables, look: Look, roughness: float, p: ShadingPoint) -> Bsdf:
    c = Closure()
    c.kind = CLOSURE_PRINCIPLED
    white = wp.vec3(1.0, 1.0, 1.0)
    c.weight = white
    c.color = white * look.color
    c.normal = p.normal
    c.coat_normal = p.normal
    c.roughness = roughness
    c.metallic = look.metallic
    c.transmission = look.transmission
    c.ior = look.ior
    c.specular_level = 0.5
    c.specular_tint = white
    c.coat = look.coat
    c.coat_ior = 1.5
    c.coat_roughness = 0.05
    c.coat_tint = white
    c.multiscatter = 1
    return prepare_bsdf(tables, c, p)


@wp.kernel
def compare(
    # In:
    tables: Tables, look: Look, cosines: wp.array[float], roughnesses: wp.array[float],
    # Out:
    packed_out: wp.array2d[float], summed_out: wp.array2d[float], words_out: GBuffer,
):
    """Find the packed lobe's integral, and that of the BSDF where it is rough, by the albedo that is stored."""
    i, j = wp.tid()
    p = point_at(cosines[i], 0)
    bsdf = prepared(tables, look, roughnesses[j], p)
    albedo = bsdf_albedo(tables, bsdf, p.wo)
    m = SurfaceMaterial()
    m.roughness = albedo.roughness
    m = fit_lobe(tables, albedo, cosines[i], m)
    m.specular = albedo.specular
    m.coat = albedo.coat
    m.coat_roughness = albedo.coat_roughness
    place = i * roughnesses.shape[0] + j
    store_material(words_out, place, m)
    m = load_material(words_out, place)
    surface = Surface()
    surface.normal = p.normal
    surface.geometric_normal = p.normal
    lobes = specular_lobes(m, surface, p.wo)
    total = float(0.0)
    k = int(0)
    while k < SAMPLES:
        wi = sample_lobes(lobes, plane_point(k), float(k * 5 % 4096) / 4096.0)
        pdf = lobes_pdf(lobes, wi)
        if pdf > 0.0:
            total += lobes_value(m, lobes, wi)[0] / pdf
        k += 1
    packed_out[i, j] = total / float(SAMPLES) / m.specular[0]
    direct = float(0.0)
    n = int(0)
    while n < SUM_SAMPLES:
        u = plane_point(n)
        r = wp.sqrt(1.0 - u[0] * u[0])
        value = evaluate_bsdf(bsdf, p.wo, wp.vec3(r * wp.cos(TWO_PI * u[1]), r * wp.sin(TWO_PI * u[1]), u[0]))
        direct += value.f[0] - value.diffuse[0]
        n += 1
    summed_out[i, j] = direct * TWO_PI / float(SUM_SAMPLES) / albedo.specular[0]


def ratios(color: float, metallic: float, ior: float, coat: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return both integrals by the stored albedo, [cosine, roughness]."""
    look = Look()
    look.color, look.metallic, look.ior, look.coat = color, metallic, ior, coat
    words = GBuffer()
    shape = (len(COSINES), len(ROUGHNESSES))
    for name in WORDS:
        setattr(words, name, wp.zeros(shape[0] * shape[1], dtype=wp.uint32, device=DEVICE))
    out = [wp.zeros(shape, dtype=float, device=DEVICE) for _ in range(2)]
    axes = [wp.array(axis, dtype=float, device=DEVICE) for axis in (COSINES, ROUGHNESSES)]
    wp.launch(compare, shape, [albedo_tables(DEVICE), look, *axes], [*out, words], device=DEVICE)
    return out[0].numpy(), out[1].numpy()


@pytest.mark.parametrize(("color", "metallic", "ior", "coat"), [
    (0.0, 0.0, 1.5, 0.0), (0.0, 0.0, 1.33, 0.0), (0.0, 0.0, 3.0, 0.0), (1.0, 1.0, 1.5, 0.0), (0.5, 1.0, 1.5, 0.0),
    (1.0, 0.5, 1.5, 0.0), (0.8, 1.0, 1.5, 1.0)])
def test_albedo_is_the_integral(color, metallic, ior, coat):
    """Find the stored albedo as the packed lobe's integral, and as that of what the path tracer evaluates."""
    packed, summed = ratios(color, metallic, ior, coat)
    assert np.abs(packed - 1.0).max() < 0.015, packed
    assert np.abs(packed.mean() - 1.0) < 0.004, packed
    if coat == 0.0:
        rough = summed[:, ROUGHNESSES.index(0.45):]
        assert np.abs(rough - 1.0).max() < 0.015, rough


@wp.kernel
def leave_glass(
    # In:
    tables: Tables, look: Look, cosine: float, roughness: float,
    # Out:
    light_out: wp.array[float],
):
    """Find the mean weight of directions drawn inside of glass, and what trapped_albedo says gets out."""
    p = point_at(cosine, 1)
    bsdf = prepared(tables, look, roughness, p)
    trapped = trapped_albedo(tables, bsdf, p.wo)
    total = float(0.0)
    k = int(0)
    while k < SAMPLES:
        s = sample_inside(bsdf, trapped, p.wo, plane_point(k), float(k * 5 % 4096) / 4096.0, 1)
        total += s.weight[0]
        k += 1
    light_out[0] = total / float(SAMPLES)
    light_out[1] = trapped[0]
    light_out[2] = wp.where(is_inside(bsdf, p), 1.0, 0.0)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("cosine", [0.3, 0.6, 0.9])
def test_glass_keeps_light_inside(cosine, roughness):
    """Lose none of the light inside of white glass, whether it is reflected in total or not."""
    look = Look()
    look.color, look.transmission, look.ior = 1.0, 1.0, 1.5
    out = wp.zeros(3, dtype=float, device=DEVICE)
    wp.launch(leave_glass, 1, [albedo_tables(DEVICE), look, cosine, roughness], [out], device=DEVICE)
    kept, trapped, inside = out.numpy()
    assert inside == 1.0
    # Cycles' tables count some light as kept that its lobe drops, see albedo_tables.glass_sample.
    assert abs(kept - 1.0) < 0.06
    assert abs(trapped - 1.0) < 0.03


@wp.kernel
def refract(tables: Tables, roughness: float, coat: float, found_out: wp.array[float]):
    """Find the roughness that the G-buffer gets of a Refraction BSDF."""
    c = Closure()
    c.kind = CLOSURE_REFRACTION
    c.weight = wp.vec3(1.0, 1.0, 1.0)
    c.color = c.weight
    c.roughness = roughness
    c.ior = 1.45
    p = point_at(0.8, 0)
    c.normal = p.normal
    bsdf = prepare_bsdf(tables, c, p)
    bsdf.coat_normal = p.normal
    bsdf.coat = wp.vec3(coat, coat, coat)
    bsdf.coat_ior = 1.5
    bsdf.coat_alpha = 0.09
    bsdf.pick_coat = coat
    albedo = bsdf_albedo(tables, bsdf, p.wo)
    found_out[0] = albedo.roughness
    found_out[1] = albedo.transmitted[0]


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.7])
def test_filters_know_how_sharp_refraction_is(roughness):
    """Where nothing reflects, the roughness by which light through a surface is filtered is that of its glass."""
    out = wp.zeros(2, dtype=float, device=DEVICE)
    wp.launch(refract, 1, [albedo_tables(DEVICE), roughness, 0.0], [out], device=DEVICE)
    found, transmitted = out.numpy()
    assert transmitted > 0.5
    assert found == pytest.approx(roughness, abs=1.0e-3)
    wp.launch(refract, 1, [albedo_tables(DEVICE), roughness, 0.5], [out], device=DEVICE)
    # One lobe reflects, and the G-buffer has one roughness.
    assert out.numpy()[0] == pytest.approx(0.3, abs=1.0e-3)
