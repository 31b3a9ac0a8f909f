# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of reflections looked up in the screen probes: energy, shape, absorption, parallax, pixels without probes."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.frame_graph import FrameGraph
from burnish.engine.settings import ProbeSettings
from burnish.engine.tables import albedo_tables
from burnish.kernels.gbuffer import GBuffer, SurfaceMaterial, load_surface, store_material, view_direction
from burnish.kernels.packing import unpack_normal
from burnish.kernels.principled import prepare_bsdf
from burnish.kernels.reflectance import bsdf_albedo, fit_lobe
from burnish.kernels.reflection_types import (
    SAMPLE_FAR,
    SOURCE_PROBE,
    SOURCE_RAY,
    ReflectionOptions,
    ReflectionSamples,
)
from burnish.kernels.types import Closure, ShadingPoint, Tables
from burnish.kernels.view import View

from tests import bsdf_cases, scenes
from tests.ggx_sums import directions, lobe_values
from tests.light_scenes import look_at
from tests.probe_bench import ProbeBench

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SIZE = (32, 32)
SETTINGS = ProbeSettings(contact_detail=False)
METAL = {"metallic": 1.0, "specular_level": 0.0}
PLASTIC = {"color": (0.0, 0.0, 0.0)}


@wp.kernel
def set_materials(
    # In:
    tables: Tables, closures: wp.array[Closure], views: wp.array[View], width: int,
    # Out:
    gbuffer_out: GBuffer,
):
    """Give each pixel the lobe that fits a closure seen from where it is."""
    pixel = wp.tid()
    s = load_surface(views[0], gbuffer_out, width, pixel)
    point = ShadingPoint()
    point.wo = view_direction(views[0], s)
    point.normal = s.normal
    point.geometric_normal = s.geometric_normal
    closure = closures[0]
    closure.normal = s.normal
    bsdf = prepare_bsdf(tables, closure, point)
    albedo = bsdf_albedo(tables, bsdf, point.wo)
    m = SurfaceMaterial()
    m.roughness = albedo.roughness
    m = fit_lobe(tables, albedo, wp.dot(s.normal, point.wo), m)
    m.specular = albedo.specular
    store_material(gbuffer_out, pixel, m)


@wp.kernel
def unpack_directions(
    # In:
    packed: wp.array[wp.uint32],
    # Out:
    direction_out: wp.array[wp.vec3],
):
    """Unpack."""
    direction_out[wp.tid()] = unpack_normal(packed[wp.tid()])


class LookUps:
    """A bench of probes whose pixels ask for reflections, one in each block of 2 x 2."""

    def __init__(self, camera=None, meshes=None, radiances=(0.0,), material=None, **fields):
        fields.setdefault("settings", SETTINGS)
        self.bench = ProbeBench(meshes or {"floor": scenes.quad(50.0)}, radiances,
                                camera or scenes.camera_above(half=0.5), SIZE, **fields)
        device, self.device = self.bench.device, self.bench.device
        o = self.options = ReflectionOptions()
        o.width, o.height, o.stride = *SIZE, 2
        o.columns, o.rows = SIZE[0] // 2, SIZE[1] // 2
        self.count = o.columns * o.rows
        self.source = wp.full(self.count, SOURCE_PROBE, dtype=wp.uint8, device=device)
        self.samples = ReflectionSamples()
        for name, dtype in (("place", wp.uint8), ("radiance", wp.uint64), ("direction", wp.uint32), ("pdf", float)):
            setattr(self.samples, name, wp.zeros(self.count, dtype=dtype, device=device))
        self.closures = wp.array([bsdf_cases.closure(**(material or METAL))], dtype=Closure, device=device)
        self.record()

    def record(self):
        """Record the look-ups; needed again after the bench was."""
        b = self.bench
        self.graph = FrameGraph(self.device)
        self.graph.launch(
            set_materials, SIZE[0] * SIZE[1], [albedo_tables(self.device), self.closures, b.tracker.array, SIZE[0]],
            [b.gbuffer], banded=False)
        b.probes.record_look_ups(self.graph, b.tracker.array, b.gbuffer, self.options, self.source, self.samples)

    def sun(self, direction, cosine, radiance=1.0):
        """Put a sun into the sky."""
        lighting = self.bench.lighting
        lighting.sun, lighting.sun_cosine, lighting.sun_direction = radiance, cosine, wp.vec3(*direction)
        self.bench.record()

    def frame(self):
        """Run a frame and return what blocks got [blocks, 4]: demodulated colour and distance."""
        self.bench.frame()
        frame = self.bench.tracker.frame
        # The turns of reflection_rays.place_of_frame.
        self.samples.place.fill_((0, 3, 1, 2)[frame % 4])
        self.graph.replay()
        return self.samples.radiance.numpy().view(np.float16).reshape(-1, 4).astype(np.float64)

    def mean(self, frames=64, warm=24):
        """Return the mean of the samples of some frames [4] after others."""
        for _ in range(warm):
            self.bench.frame()
        return np.mean([self.frame().mean(0) for _ in range(frames)], 0)

    def directions(self):
        """Return the directions drawn last [blocks, 3]."""
        out = wp.zeros(self.count, dtype=wp.vec3, device=self.device)
        wp.launch(unpack_directions, self.count, [self.samples.direction], [out], device=self.device)
        return out.numpy()


def slanted(cosine):
    """Make a camera that sees a small piece of the floor under an angle, from -x."""
    return look_at((-20 * np.sqrt(1 - cosine**2), 0.0, 20 * cosine), (0.0, 0.0, 0.0), SIZE, 0.02)


@pytest.mark.parametrize("material", [METAL, PLASTIC], ids=["metal", "plastic"])
@pytest.mark.parametrize("cosine", [1.0, 0.6, 0.25, 0.1])
@pytest.mark.parametrize("roughness", [0.2, 0.35, 0.5, 0.7])
def test_white_sky(material, cosine, roughness):
    """Reflect a white sky as white for every roughness and view."""
    got = LookUps(slanted(cosine), material=material | {"roughness": roughness}, sky=1.0).mean(24, 8)
    np.testing.assert_allclose(got[:3], 1.0, atol=0.015)
    assert got[3] > 0.9 * SAMPLE_FAR


def test_sun_through_the_lobe():
    """Reflect a part of the sky as the sum of the lobe over the probes' bilinear maps, in the mean."""
    cosine, roughness, sun = 0.7, 0.4, np.array([0.8, 0.0, 0.6])
    b = LookUps(slanted(cosine), material=METAL | {"roughness": roughness})
    b.sun(sun, 0.9)
    got = b.mean(160, 160)[0]
    pool = b.bench.probes.pool
    used = pool.used.numpy() == pool.used.numpy().max()
    cells = b.bench.probes.pool.radiance.numpy()[..., 0].astype(np.float64).reshape(-1, 8, 8)[used].mean(0)
    # The probes' frame about +z is the world's; the view comes from -x.
    d = directions(512)
    f = lobe_values(cosine, roughness, 1.0, 1.0, d * [-1.0, 1.0, 1.0])
    r = np.sqrt(1 - d[:, 2])
    phi = np.arctan2(np.abs(d[:, 1]), np.abs(d[:, 0])) / (np.pi / 2)
    one, two = np.where(d[:, 0] < 0, -1, 1) * r * (1 - phi), np.where(d[:, 1] < 0, -1, 1) * r * phi
    u, v = (np.clip(8 * (0.5 + 0.5 * (one + sign * two)) - 0.5, 0.0, 7.0) for sign in (1, -1))
    i, j = np.minimum(u.astype(int), 6), np.minimum(v.astype(int), 6)
    u, v = u - i, v - j
    light = ((cells[j, i] * (1 - u) + cells[j, i + 1] * u) * (1 - v)
             + (cells[j + 1, i] * (1 - u) + cells[j + 1, i + 1] * u) * v)
    due = (f * light).sum() / f.sum()
    truth = f[d @ sun > 0.9].sum() / f.sum()
    assert abs(got / due - 1) < 0.02
    # The cells blur the sky by 18 degrees, the lobe is about as wide.
    assert abs(got / truth - 1) < 0.2


def test_light_of_a_near_wall():
    """Find the wall that a floor reflects through the probes' distances, though they lie a tile away."""
    wall = scenes.mesh([[0, -50, 0], [0, 50, 0], [0, 50, 0.4], [0, -50, 0.4]], [[0, 1, 2], [0, 2, 3]])
    floor = scenes.mesh([[0, -50, 0], [50, -50, 0], [50, 50, 0], [0, 50, 0]], [[0, 1, 2], [0, 2, 3]])
    b = LookUps(scenes.camera_above(half=0.5), {"floor": floor, "wall": wall}, (0.0, 1.0),
                METAL | {"roughness": 0.6})
    for _ in range(120):
        b.bench.frame()
    got = np.mean([b.frame().reshape(16, 16, 4).mean(0) for _ in range(200)], 0)[8:, 0]
    d = directions(256)
    f = lobe_values(1.0, 0.6, 1.0, 1.0, d)
    x = (np.arange(8) + 0.5) / 16
    due = np.array([f[-d[:, 0] * 0.4 > d[:, 2] * at].sum() / f.sum() for at in x])
    # Without their distances it is 0.13 beside the wall.
    assert np.abs(got - due).max() < 0.1
    assert abs(got.sum() / due.sum() - 1) < 0.1


def test_absorbs_below_the_surface():
    """Count directions below the geometric surface as black samples, with a density."""
    tilt = np.radians(50)
    b = LookUps(material=METAL | {"roughness": 0.5}, sky=1.0, tilt=(np.sin(tilt), 0.0, np.cos(tilt)))
    for _ in range(8):
        b.bench.frame()
    below, black, light = [], [], []
    for _ in range(40):
        values = b.frame()
        below.append(b.directions()[:, 2] < -1e-3)
        black.append(values[:, 0] == 0)
        light.append(values[:, 0])
        assert b.samples.pdf.numpy().min() > 0
    below, black, light = (np.concatenate(a) for a in (below, black, light))
    assert 0.1 < below.mean() < 0.6
    assert black[below].all() and black[~below].mean() < 0.01
    assert light.mean() < 0.95


def test_pixels_without_probes_are_not_black():
    """Give the pixel's diffuse light where no probe knows the direction, and leave blocks alone that have a ray."""
    b = LookUps(material=METAL | {"roughness": 0.4}, sky=1.0)
    for _ in range(8):
        b.frame()
    probes = b.bench.probes
    probes.records.fill_(0x4E6E6B284E6E6B28)  # 1e9, 1e9: off the film
    probes.irradiance.fill_(wp.vec4h(0.5, 0.5, 0.5, 1.0))
    probes.specular_ratio.fill_(3.0)
    source = np.full(b.count, SOURCE_PROBE, np.uint8)
    source[::2] = SOURCE_RAY
    b.source.assign(source)
    b.samples.radiance.fill_(wp.uint64(7))
    b.graph.replay()
    packed = b.samples.radiance.numpy()
    assert (packed[::2] == 7).all()
    values = packed.view(np.float16).reshape(-1, 4)[1::2].astype(float)
    assert abs(values[:, 0].mean() / 1.5 - 1) < 0.1 and (values[:, 3] == np.float16(SAMPLE_FAR)).all()
