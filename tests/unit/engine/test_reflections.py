# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the samples of reflections and refraction: energy under a white sky, pictures against the path tracer's."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
import warp as wp
from burnish.engine.debug_views import DEBUG_VIEWS
from burnish.engine.passes import reflections
from burnish.engine.passes.reflections import DEBUG_CHANNELS
from burnish.engine.reflectors import find_reflectors
from burnish.engine.session import Session
from burnish.engine.settings import (
    CacheSettings,
    DenoiserSettings,
    Integrator,
    ReflectionResolution,
    ReflectionSettings,
    SamplingSettings,
)
from burnish.kernels.gbuffer import SURFACE_TRANSLUCENT, SURFACE_TRANSMITS
from burnish.kernels.long_mean import pack_mean
from burnish.kernels.packed_halves import unpack_halves
from burnish.kernels.packing import rgb
from burnish.kernels.reflection_rays import place_of_frame, sequence_index
from burnish.kernels.reflection_types import PLACE_MASK, ReflectionSamples
from burnish.kernels.types import MATERIAL_LEAN, MATERIAL_PLAIN

from tests import scenes
from tests.glossy_scenes import glass, glossy, metal, panel
from tests.light_scenes import look_at, slab

SIZE = (24, 18)
WARM_UP = 12


@wp.kernel(module="unique")
def spread(samples: ReflectionSamples, light: wp.array[wp.uint64]):
    i = wp.tid()
    c = wp.vec3(0.0, 0.0, 0.0)
    if samples.pdf[i] > 0.0:
        c = rgb(unpack_halves(samples.radiance[i]))
    light[i] = pack_mean(c)


def unfiltered(light, graph, parity, views, gbuffer, previous, reprojection, options, samples, **_):
    """Stand in for the filter of samples at full resolution: change nothing."""
    graph.launch(spread, len(light), [samples], [light], banded=False)
    return light


class Samples:
    """A session whose samples are not filtered; one a pixel unless told otherwise."""

    def __init__(self, delta, camera, **reflections):
        reflections.setdefault("resolution", ReflectionResolution.FULL)
        settings = dataclasses.replace(
            scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME),
            # As large a cell in the scene as in a picture of usual size.
            cache=CacheSettings(capacity=16, cell_pixels=8.0, minimum_cell=0.02),
            # Every step is a frame.
            denoiser=DenoiserSettings(path_traced_rest=False), reflections=ReflectionSettings(**reflections))
        self.session = Session(settings)
        self.session.update(delta)
        self.session.configure(settings, camera, *SIZE)
        self.pipeline = self.session._realtime.pipeline
        if reflections["resolution"] == ReflectionResolution.FULL:
            for each in (self.pipeline.reflection_denoise, self.pipeline.refraction_denoise):
                light = wp.zeros(SIZE[0] * SIZE[1], dtype=wp.uint64, device=self.pipeline.device)
                each.record = functools.partial(unfiltered, light)
        self.session.step(1)

    def frame(self):
        """Render a frame."""
        self.session.step(1)
        return self

    def surface(self, name):
        """Return an array of this frame's G-buffer."""
        gbuffer = self.pipeline.gbuffer.current(self.session._realtime.views.parity)
        return getattr(gbuffer, name).numpy().reshape(SIZE[1], SIZE[0])

    def albedo(self, name):
        """Return an albedo of the G-buffer, [h, w, 3]."""
        packed = self.surface(name)
        return np.stack([packed & 2047, packed >> 11 & 2047, (packed >> 22) * 2047.0 / 1023.0], -1).astype(float) ** 2 \
            / 2047.0**2

    def radiance(self, which="reflections"):
        """Return this frame's samples at full resolution: light [h, w, 3], distance and density [h, w]."""
        samples = getattr(self.pipeline, which).samples
        words = samples.radiance.numpy().view(np.float16).reshape(SIZE[1], SIZE[0], 4).astype(np.float64)
        return words[..., :3], words[..., 3], samples.pdf.numpy().reshape(SIZE[1], SIZE[0])

    def mean(self, frames, which="reflections"):
        """Return the mean light of so many frames' samples."""
        return np.mean([self.frame().radiance(which)[0] for _ in range(frames)], 0)


def floor_scene(material, background=1.0, lights=()):
    """Make a floor of one material under a sky."""
    return scenes.delta({"floor": scenes.quad(50.0)}, [("floor", np.eye(4), "m")], {"m": material}, list(lights),
                        background=background)


def aslant(height=1.0):
    """Look at the floor from 30 degrees above it."""
    return look_at((0.0, -1.8 * height, height), (0.0, 0.0, 0.0), SIZE, 0.8)


@pytest.mark.parametrize(("roughness", "tolerance"), [(0.0, 0.003), (0.1, 0.01), (0.2, 0.015)])
def test_white_sky_in_metal_is_white(roughness, tolerance):
    """Have samples of mean 1 under a sky of 1: the albedo accounts for all that is absorbed."""
    mean = Samples(floor_scene(metal(roughness)), aslant()).mean(64)
    np.testing.assert_allclose(mean.mean((0, 1)), 1.0, atol=tolerance)
    np.testing.assert_allclose(mean[SIZE[1] // 2 :].mean(), 1.0, atol=1.5 * tolerance)


@pytest.mark.parametrize("roughness", [0.0, 0.2])
def test_white_sky_through_glass_is_white(roughness):
    """The same for what a pane of glass lets through, all bounces inside of it included."""
    pane = scenes.delta({"pane": slab((-5.0, 0.0, -5.0), (5.0, 0.1, 5.0))}, [("pane", np.eye(4), "glass")],
                        {"glass": glass(roughness)}, background=1.0)
    samples = Samples(pane, look_at((0.3, -2.0, 0.4), (0.0, 0.0, 0.0), SIZE, 0.8), bounces=12)
    assert samples.albedo("transmitted").mean() > 0.8
    # Rough glass seen from inside loses some light in Cycles too, see albedo_tables.glass_sample.
    np.testing.assert_allclose(samples.mean(48, "refraction").mean(), 1.0, atol=0.01 if roughness == 0.0 else 0.03)


def test_coat_shows_both_lobes():
    """Have mean 1 for a sharp coat on a rough base: both lobes together."""
    material = glossy(color=0.3, roughness=0.5, coat=1.0, coat_roughness=0.05)
    np.testing.assert_allclose(Samples(floor_scene(material), aslant()).mean(96).mean(), 1.0, atol=0.04)


def picture_ratio(delta, camera, frames=64, truth_samples=1024, max_bounces=0, **settings):
    """Return where something reflects or transmits, the mean picture before anti-aliasing, and the path tracer's."""
    truth = scenes.render(delta, camera, SIZE, truth_samples, max_bounces=max_bounces)[..., :3]
    samples, total = Samples(delta, camera, **settings), 0.0
    for index in range(WARM_UP + frames):
        samples.frame()
        color = samples.pipeline.composite.color.current(samples.session._realtime.views.parity)
        if index >= WARM_UP:
            total = total + color.numpy().astype(np.float64).reshape(SIZE[1], SIZE[0], 4)[..., :3] / frames
    mask = samples.albedo("specular").mean(-1) > 0.5
    for flag in (SURFACE_TRANSMITS, SURFACE_TRANSLUCENT):
        if (samples.surface("material") & int(flag)).any():
            mask = (samples.surface("material") & int(flag)) != 0
    return mask, total, truth


def sun(strength, towards):
    """Make a small sun that shines in a direction."""
    back = -np.asarray(towards, float) / np.linalg.norm(towards)
    right = np.cross((0.0, 0.0, 1.0) if abs(back[2]) < 0.9 else (0.0, 1.0, 0.0), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, np.cross(back, right), back
    return scenes.lamp("SUN", strength, matrix, angle=0.02)


MATERIALS = {"grey": scenes.material(color=0.4), "red": scenes.material(color=(0.7, 0.2, 0.1))}


def mirror_room(roughness=0.0):
    """Make a mirror for a floor, and walls that a sun lights from below it: it meets no mirror."""
    meshes = {"floor": slab((-2, -2, -0.1), (2, 2, 0)), "back": slab((-2, 2, 0), (2, 2.1, 2)),
              "side": slab((2, -2, 0), (2.1, 2, 2)), "block": slab((-0.4, 0.4, 0.4), (0.2, 0.9, 1.0))}
    materials = {"floor": "mirror", "block": "red"}
    return scenes.delta(
        meshes, [(name, np.eye(4), materials.get(name, "grey")) for name in meshes],
        MATERIALS | {"mirror": metal(roughness)}, [sun(6.0, (0.0, 1.0, 0.15))], background=0.05)


def facing_mirrors():
    """Make two mirrors face to face, with a floor and a block between them."""
    meshes = {"floor": slab((-2, -2, -0.1), (2, 2, 0)), "a": slab((-1, 1.5, 0), (1, 1.6, 2)),
              "b": slab((-1, -1.6, 0), (1, -1.5, 2)), "block": slab((-0.4, 0.4, 0), (0.2, 0.9, 0.6))}
    materials = {"a": "mirror", "b": "mirror", "block": "red"}
    return scenes.delta(
        meshes, [(name, np.eye(4), materials.get(name, "grey")) for name in meshes],
        MATERIALS | {"mirror": metal(0.0)}, [sun(3.0, (0.0, 0.0, -1.0))], background=0.2)


def glass_room():
    """Make a block of glass in front of a panel that shines."""
    meshes = {"glass": slab((-1, 0, 0), (1, 0.2, 1.2)), "panel": slab((-0.5, 1, 0.2), (0.5, 1.1, 0.8))}
    return scenes.delta(
        meshes, [(name, np.eye(4), name) for name in meshes], {"glass": glass(), "panel": panel((1.0, 0.8, 0.5), 5.0)},
        background=0.5)


@pytest.mark.parametrize(("room", "eye", "target", "tolerance"), [
    pytest.param(mirror_room, (-0.8, -1.8, 0.9), (0.1, 0.8, 0.2), 0.05, marks=pytest.mark.slow),
    (facing_mirrors, (-0.3, -1.2, 1.0), (0.1, 1.5, 0.8), 0.05),
    pytest.param(glass_room, (-0.3, -1.8, 0.9), (0.1, 1.5, 0.5), 0.03, marks=pytest.mark.slow),
])
def test_pictures_are_the_path_tracers(room, eye, target, tolerance):
    """See in mirrors, in mirrors in mirrors and through glass what the path tracer sees, by sums and by pixels."""
    mask, picture, truth = picture_ratio(room(), look_at(eye, target, SIZE, 1.0))
    assert mask.sum() > 60
    np.testing.assert_allclose(picture[mask].mean(0), truth[mask].mean(0), rtol=tolerance)
    assert np.abs(picture - truth)[mask].mean() / truth[mask].mean() < 0.12


def red_panes():
    """Make four red panes before a panel that shines."""
    meshes = {f"red {i}": slab((-1, 0.3 * i, 0), (1, 0.3 * i + 0.05, 1.2)) for i in range(4)}
    return meshes | {"panel": slab((-0.8, 1.4, 0.0), (0.8, 1.5, 1.0))}, np.eye(4)


def red_in_clear():
    """Make a red block in a clear one below a panel that shines, both with an edge to the front: they catch light."""
    turned = np.eye(4)
    turned[:2, :2] = [[0.7071, 0.7071], [-0.7071, 0.7071]]
    meshes = {"clear": slab((-0.35, -0.35, 0), (0.35, 0.35, 2)), "red": slab((-0.28, -0.28, 0.1), (0.28, 0.28, 1.3))}
    return meshes | {"panel": slab((-5, -5, 5), (5, 5, 5.1))}, turned


@pytest.mark.slow
@pytest.mark.parametrize(("glasses", "background", "eye"), [
    (red_panes, 0.5, (-0.5, -1.8, 0.9)), (red_in_clear, 0.02, (0.0, -5.0, 2.8))])
def test_light_goes_through_many_glasses(glasses, background, eye):
    """Follow rays through more glass than over mirrors, pixel by pixel; cells know nothing of what glass has caught."""
    meshes, matrix = glasses()
    materials = {"clear": glass(), "red": glass(color=(0.8, 0.3, 0.1)), "panel": panel((1.0, 1.0, 1.0), 3.0)}
    delta = scenes.delta(
        meshes, [(name, matrix, name.split()[0]) for name in meshes], materials, background=background)
    mask, picture, truth = picture_ratio(delta, look_at(eye, (0.0, 0.0, 0.9), SIZE, 0.5), frames=32)
    assert mask.sum() > 100
    assert np.abs(picture - truth)[mask].mean() / truth[mask].mean() < 0.2


def blind_room(layers, behind):
    """Make a blind, some layers with gaps between, before a wall that the sun lights; what else shines is `behind`."""
    upright = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)
    blinds = [(f"blind {index}", upright @ scenes.place(z=0.02 * index), "blind") for index in range(layers)]
    meshes = {name: scenes.quad(1.5) for name, _, _ in blinds} | {
        "wall": slab((-3, 1, -3), (3, 1.1, 5)), "panel": slab((-0.9, 0.8, -0.4), (-0.3, 0.81, 0.2))}
    materials = {"blind": scenes.material("TRANSLUCENT", color=(0.8, 0.6, 0.4)), "wall": MATERIALS["red"],
                 "panel": panel((0.5, 0.8, 1.0), 3.0 * behind)}
    lamp = scenes.lamp("POINT", 30.0 * behind, scenes.place(0.5, 0.6, 0.3), radius=0.05)
    placed = [*blinds, *((name, np.eye(4), name) for name in ("wall", "panel"))]
    return scenes.delta(meshes, placed, materials, [sun(3.0, (0.0, 1.0, -1.0)), lamp], background=0.05)


@pytest.mark.parametrize(("layers", "behind"), [
    (1, 0.0), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((2, 1.0), (1, 1.0), (2, 0.0)))])
def test_translucent_surfaces_are_lit_from_behind(layers, behind):
    """Show through a blind the light that arrives behind it, bounced and direct, once each.

    As far as the wall, whose own indirect light no probe has ever asked for.
    """
    view = look_at((-0.3, -1.8, 0.4), (0.0, 0.0, 0.1), SIZE, 0.6)
    mask, picture, truth = picture_ratio(blind_room(layers, behind), view, max_bounces=1 + layers)
    assert mask.sum() > 200
    np.testing.assert_allclose(picture[mask].mean(0), truth[mask].mean(0), rtol=0.04, atol=0.0015)


@pytest.mark.parametrize("material", [
    metal(0.0), pytest.param(metal(0.1), marks=pytest.mark.slow), pytest.param(metal(0.2), marks=pytest.mark.slow),
    metal(0.28), pytest.param(glossy(color=0.3, roughness=0.1), marks=pytest.mark.slow),
    pytest.param(glossy(color=0.3, roughness=0.5, coat=1.0, coat_roughness=0.1), marks=pytest.mark.slow)])
def test_lamps_are_shown_once(material):
    """Share a lamp between rays and light samples, so that together they show it once, at every roughness."""
    lamp = scenes.lamp("AREA", 60.0, scenes.place(y=0.6, z=1.9), shape="SQUARE", size_x=0.8, size_y=0.8)
    delta = floor_scene(material, 0.2, [lamp])
    mask, picture, truth = picture_ratio(delta, look_at((-0.3, -1.8, 1.2), (0.0, -0.2, 0.0), SIZE, 1.2), frames=48)
    np.testing.assert_allclose(picture.mean(), truth.mean(), rtol=0.02)


def test_hits_light_the_cache():
    """Put the light of hits into cells where no probe ray goes: the cache alone is darker there."""
    view = look_at((0.0, -1.8, 0.9), (0.0, 0.2, 0.0), SIZE, 0.3)
    lit = Samples(mirror_room(), view, screen_reuse=False).mean(24).mean()
    dark = Samples(mirror_room(), view, screen_reuse=False, hit_lighting=False).mean(24).mean()
    assert lit > 1.05 * dark


def test_screen_reuse_changes_little():
    """Find about the same in the frame before as the hits' own light gives, with fewer shadow rays.

    Where the mirror shows lit walls: in dark corners the frame before has the error of its own diffuse light.
    """
    view = look_at((-0.8, -1.8, 0.9), (0.1, 0.8, 0.2), SIZE, 1.2)
    on, off = (Samples(mirror_room(), view, screen_reuse=reuse) for reuse in (True, False))
    with_it, without = on.mean(40)[:6], off.mean(40)[:6]
    np.testing.assert_allclose(with_it.mean(), without.mean(), rtol=0.05)
    shadows = [each.pipeline.reflections.stats()["reflection shadow rays"] for each in (on, off)]
    assert shadows[0] < 0.8 * shadows[1]


def test_lamps_are_no_light_of_what_is_behind_them():
    """Take from the frame before the light of a wall, not that of a lamp that the camera sees in front of it."""
    lamp = scenes.lamp("POINT", 20.0, scenes.place(0.0, 0.8, 0.7), radius=0.15)
    meshes = {"floor": slab((-2, -2, -0.1), (2, 2, 0)), "back": slab((-2, 2, 0), (2, 2.1, 2))}
    delta = scenes.delta(
        meshes, [("floor", np.eye(4), "m"), ("back", np.eye(4), "grey")],
        MATERIALS | {"m": glossy(color=0.02, roughness=0.4)}, [lamp], background=0.05)
    view = look_at((0.0, -1.8, 0.9), (0.0, 0.8, 0.5), SIZE, 1.2)
    on, off = (Samples(delta, view, screen_reuse=reuse) for reuse in (True, False))
    for each in (on, off):
        each.mean(12)
    assert on.session.read()[..., 0].max() > 10.0
    with_it, without = on.mean(24), off.mean(24)
    np.testing.assert_allclose(with_it.mean(), without.mean(), rtol=0.15)
    assert with_it.max() < 1.5 * without.max()


@pytest.mark.parametrize("stride", [1, 2, 4])
def test_pixels_take_turns(stride):
    """Give each place of a block its turn once, and each turn an index of its own."""
    @wp.kernel(module="unique")
    def turns(places: wp.array[int], indices: wp.array[wp.uint32]):
        i = wp.tid()
        places[i] = place_of_frame(stride, i)
        indices[i] = sequence_index(stride, i, places[i])

    count = 3 * stride * stride
    places, indices = (wp.zeros(count, dtype=dtype, device="cpu") for dtype in (int, wp.uint32))
    wp.launch(turns, count, outputs=[places, indices], device="cpu")
    rounds = places.numpy().reshape(3, -1)
    assert (np.sort(rounds, 1) == np.arange(stride * stride)).all()
    assert (indices.numpy().reshape(3, -1) == np.arange(3)[:, None]).all()


def test_half_resolution_samples_each_pixel_in_turn():
    """Sample every pixel of a mirror once in four frames, with a ray for every block."""
    samples = Samples(floor_scene(metal(0.0)), aslant(), resolution=ReflectionResolution.HALF)
    places = np.stack([samples.frame().pipeline.reflections.samples.place.numpy().copy() for _ in range(4)])
    assert (np.sort(places & int(PLACE_MASK), 0) == np.arange(4)[:, None]).all()
    assert samples.pipeline.reflections.stats()["reflection rays"] == SIZE[0] * SIZE[1] // 4


def test_scenes_without_reflections_record_none():
    """Know from the materials' programs what reflects sharply and what refracts."""
    found = find_reflectors([scenes.material(color=0.5).program, metal(0.7).program])
    assert found.sharpest == pytest.approx(0.7) and not found.refracts
    assert find_reflectors([glass(0.1).program]).refracts and not found.scatters
    assert find_reflectors([scenes.material("TRANSLUCENT").program]).scatters
    assert find_reflectors([scenes.material(color=0.5).program]).sharpest > 1.0
    samples = Samples(floor_scene(scenes.material(color=0.5)), aslant()).frame()
    assert {"reflections", "refraction"} <= set(samples.pipeline.skipped)
    assert samples.pipeline.reflections.stats() == {}


def test_debug_views_are_known():
    """Have a help text for each debug view."""
    assert set(DEBUG_CHANNELS) <= set(DEBUG_VIEWS)


def test_chains_end_alike_in_one_launch(monkeypatch):
    """Follow rays to their ends in one launch with the samples that launches for each segment give."""
    found = []
    for waves in (2, 99):
        monkeypatch.setattr(reflections, "WAVES", waves)
        samples = Samples(facing_mirrors(), look_at((-0.3, -1.2, 1.0), (0.1, 1.5, 0.8), SIZE, 1.0))
        steps = next(iter(samples.pipeline._graphs.values()))[0]._steps
        kernels = [step.kernel for step in steps if step.section.startswith(samples.pipeline.reflections.title)]
        found.append((samples.radiance(), kernels.count("trace_further") + kernels.count("trace_flat_further")))
    (one, few), (other, many) = found
    assert few == 1 and many > 3
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=1e-4)


def glass_and_mirror(roughness):
    """Make a block of glass before a mirror, with a panel that shines, over a floor."""
    meshes = {"floor": slab((-2, -2, -0.1), (2, 2, 0)), "glass": slab((-0.6, 0, 0), (0.6, 0.3, 1.2)),
              "mirror": slab((-1, 1.5, 0), (1, 1.6, 2)), "panel": slab((0.2, 0.8, 0.2), (0.5, 0.9, 0.8))}
    materials = MATERIALS | {
        "glass": glass(roughness), "mirror": metal(roughness), "panel": panel((1.0, 0.8, 0.5), 5.0)}
    return scenes.delta(
        meshes, [(name, np.eye(4), "grey" if name == "floor" else name) for name in meshes], materials, background=0.5)


@pytest.mark.parametrize("roughness", [0.0, 0.25])
def test_both_machines_follow_rays_alike(roughness):
    """Follow rays over mirrors and through glass with the lean machine, with the full one, and with both in turns."""
    found = []
    for full in (slice(0), slice(None), slice(0, None, 2)):
        samples = Samples(glass_and_mirror(roughness), look_at((-0.3, -1.2, 1.0), (0.1, 1.5, 0.5), SIZE, 1.0))
        table = samples.session._scene.material_table
        assert table.lean.plain and not table.lean.surface
        records = table._materials.numpy().copy()
        records["flags"][full] &= ~int(MATERIAL_LEAN | MATERIAL_PLAIN)
        table._materials.assign(records)
        table.lean = dataclasses.replace(table.lean, plain=full == slice(0))
        samples.frame()
        found.append([samples.radiance(which) for which in ("reflections", "refraction")])
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            assert (one[0] > 0.0).mean() > 0.1
            for a, b in zip(one, two, strict=True):
                assert np.isclose(a, b, rtol=5e-3, atol=1e-3).mean() > 0.99
