# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays that decide by themselves what stops them: their answers against the programs', and where they may not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import AlphaMode, ImageData, MaterialData, Visibility
from burnish.engine.session import Session
from burnish.engine.settings import Integrator, PerformanceSettings
from burnish.engine.structures import decides_layers
from burnish.kernels.decided_layers import passing_share
from burnish.kernels.types import Scene
from burnish.kernels.wide_layers import chance_layer_wide

from tests import scenes
from tests.device import DEVICE
from tests.unit.engine.test_opacity_maps import ask_materials, blobs, crossed, leaves, masked, opened

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def look_through(
    # In:
    scene: Scene,
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    t_max: float,
    # Out:
    share_out: wp.array[float],
):
    """Find what share of light comes through everything."""
    i = wp.tid()
    share_out[i] = passing_share(scene.geometry, origin[i], direction[i], t_max)


@wp.kernel
def stop_by_chance(
    # In:
    scene: Scene,
    origin: wp.vec3,
    direction: wp.vec3,
    t_max: float,
    # Out:
    t_out: wp.array[float],
    passing_out: wp.array[float],
):
    """Find where one ray is stopped, once for each seed."""
    i = wp.tid()
    flat = scene.geometry.flat_filtered
    found = chance_layer_wide(flat.nodes, flat.triangles, origin, direction, t_max, wp.uint32(i * 977 + 13))
    t_out[i] = wp.where(wp.cast(found[3], int) < 0, -1.0, found[0])
    passing_out[i] = found[4]


def programs_say(made: DeviceScene, faces: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return what share the materials' programs let pass at points: instance and triangle, weights of all vertices."""
    answer = wp.zeros(len(faces), dtype=wp.vec3, device=DEVICE)
    points = wp.array(np.ascontiguousarray(weights[:, 1:], np.float32), dtype=wp.vec2, device=DEVICE)
    wp.launch(ask_materials, len(faces), [
        made.scene, wp.array(faces.astype(np.int32), dtype=wp.vec2i, device=DEVICE), points], [answer], device=DEVICE)
    return answer.numpy()[:, 0]


def rays(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rays through the leaves."""
    rng = np.random.default_rng(7)
    return rng.uniform(-2, 2, (count, 3)).astype(np.float32), rng.normal(size=(count, 3)).astype(np.float32)


def check_shares(made: DeviceScene, mesh, count: int = 1500) -> np.ndarray:
    """Compare the light that rays let through with the product of what programs let; return the shares."""
    origin, direction = rays(count)
    shares = wp.zeros(count, dtype=float, device=DEVICE)
    wp.launch(look_through, count, [
        made.scene, *(wp.array(x, dtype=wp.vec3, device=DEVICE) for x in (origin, direction)), 1e30], [shares],
        device=DEVICE)
    t, weights = crossed(mesh, origin.astype(float), direction.astype(float))
    met = np.argwhere(np.isfinite(t))
    expected = np.ones(count)
    passing = programs_say(made, np.stack([np.zeros(len(met), int), met[:, 1]], 1), weights[met[:, 0], met[:, 1]])
    np.multiply.at(expected, met[:, 0], passing)
    far = np.abs(shares.numpy() - expected) > 5e-3
    # Rays through edges, and points within rounding of a threshold.
    assert far.mean() < 0.004, far.mean()
    return shares.numpy()


@pytest.mark.parametrize("extension", range(3))
@pytest.mark.parametrize("threshold", [None, 0.3])
def test_shares_agree_with_programs(extension: int, threshold: float | None) -> None:
    """Let as much light through as programs do, under every way in which pictures go on but mirrored."""
    mesh = leaves(60)
    made = opened(masked(threshold, extension), blobs(steep=2.0), mesh)
    assert decides_layers(made.scene)
    shares = check_shares(made, mesh)
    between = (shares > 0.01) & (shares < 0.99)
    assert (shares == 1.0).any() and (shares == 0.0).any()
    assert between.mean() > 0.003 if threshold is None else between.mean() < 0.02


@pytest.mark.parametrize(("fields", "image"), [
    ({"channel": 0}, {"alpha_mode": AlphaMode.CHANNEL_PACKED}),
    ({"channel": 2, "threshold": 0.4}, {"source_colorspace": "Non-Color"}),
    ({"rows": [[1.5, 0.7, 0.0, 0.1], [-0.7, 1.5, 0.0, 0.3], [0.0, 0.0, 1.0, 0.0]]}, {}),
    ({"interpolation": 2}, {}),
])
def test_shares_agree_for_other_look_ups(fields: dict, image: dict) -> None:
    """Agree for colours, encoded or not, for moved coordinates, and where cubic stands for linear."""
    pixels = blobs(steep=2.0)
    pixels[..., :3] = np.moveaxis(np.stack([blobs(seed=k, steep=2.0)[..., 3] for k in range(3)]), 0, -1)
    mesh = leaves(60)
    made = opened(masked(**fields), pixels, mesh, **image)
    assert decides_layers(made.scene)
    check_shares(made, mesh)


def test_constant_shares_are_known() -> None:
    """Know of half transparent materials how much passes, without an image."""
    mesh = leaves(20)
    made = opened(scenes.transparent(0.4), mesh=mesh)
    assert decides_layers(made.scene)
    shares = check_shares(made, mesh)
    assert ((shares > 0.0) & (shares < 0.5)).any()


def test_edges_count_once() -> None:
    """Weaken light by one layer where rays go exactly through the edges and the corners that triangles share."""
    cells = 4
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(cells + 1.0), np.arange(cells + 1.0)))
    corner = np.array([k for k in range(cells * (cells + 1)) if k % (cells + 1) < cells])
    quads = np.stack([corner, corner + 1, corner + cells + 2, corner + cells + 1], 1)
    # Every second triangle faces down.
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 3, 2]]])
    mesh = scenes.mesh(np.stack([x, y, 0 * x], 1), triangles)
    made = opened(scenes.transparent(0.4), mesh=mesh)
    places = np.linspace(0.5, cells - 0.5, 4 * (cells - 1) + 1)
    origin = np.array([(a, b, 3.0) for a in places for b in places], np.float32)
    for direction in ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0)):
        shares = wp.zeros(len(origin), dtype=float, device=DEVICE)
        start = origin * (1, 1, -direction[2])
        wp.launch(look_through, len(origin), [
            made.scene, *(wp.array(np.broadcast_to(rows, origin.shape).astype(np.float32), dtype=wp.vec3, device=DEVICE)
                          for rows in (start, direction)), 1e30], [shares], device=DEVICE)
        np.testing.assert_allclose(shares.numpy(), 0.4, rtol=1e-6)


def tinted() -> MaterialData:
    """Make a material that lets more red pass than blue."""
    build = ProgramBuilder()
    build.transparent((0.9, 0.5, 0.2), 0.7)
    build.closure("DIFFUSE", 0.3, color=0.8)
    return MaterialData(name="leaf", program=build.finish(), has_transparency=True)


@pytest.mark.parametrize(("material", "pixels", "image"), [
    (masked(extension=3), None, {}),
    (masked(interpolation=1), None, {}),
    (masked(), np.float32, {}),
    (masked(), np.uint16, {}),
    (masked(channel=1), None, {}),
    (masked(has_emission=True), None, {}),
    (tinted(), None, {}),
])
def test_programs_decide_the_rest(material: MaterialData, pixels, image: dict) -> None:
    """Leave to programs: mirrored pictures, closest texels, more than 8 bits, colours under alpha, emission, tints."""
    picture = blobs()
    if pixels is np.uint16:
        picture = picture.astype(np.uint16) * 257
    elif pixels is not None:
        picture = (picture / 255).astype(pixels)
    assert not decides_layers(opened(material, picture, **image).scene)


def test_one_triangle_left_is_enough() -> None:
    """Ask programs where an object is hidden from shadow rays, or coordinates are far away; not when it has gone."""
    hidden = int(Visibility.ALL & ~Visibility.SHADOW)
    made = opened(masked(), objects=[("leaves", np.eye(4), "leaf"), ("leaves", np.eye(4), "leaf", hidden)])
    assert not decides_layers(made.scene)
    mesh = leaves(4)
    mesh.uv_maps["UVMap"].reshape(-1, 3, 2)[1, 1] = 1e9
    assert not decides_layers(opened(masked(), mesh=mesh).scene)
    made = opened(masked())
    assert decides_layers(made.scene)
    made.use_opacity_maps(False)
    assert not decides_layers(made.scene)
    made.use_opacity_maps(True)
    assert decides_layers(made.scene)


def test_chance_is_the_share() -> None:
    """Stop a ray at each of the layers before it as often as their shares say, and tell the share."""
    mesh = leaves(60)
    made = opened(masked(), blobs(steep=1.0), mesh)
    origin, direction = rays(400)
    t, weights = crossed(mesh, origin.astype(float), direction.astype(float))
    ray = int(np.argmax(np.isfinite(t).sum(1)))
    order = [k for k in np.argsort(t[ray]) if np.isfinite(t[ray, k])]
    passing = programs_say(made, np.stack([np.zeros(len(order), int), order], 1), weights[ray, order])
    assert len(order) >= 4 and ((passing > 0.05) & (passing < 0.95)).sum() >= 2
    count = 20000
    found, share = (wp.zeros(count, dtype=float, device=DEVICE) for _ in range(2))
    wp.launch(stop_by_chance, count, [
        made.scene, wp.vec3(*origin[ray].tolist()), wp.vec3(*direction[ray].tolist()), 1e30], [found, share],
        device=DEVICE)
    left = 1.0
    for k, passes in zip(order, passing, strict=True):
        here = np.abs(found.numpy() - t[ray, k]) < 1e-4
        assert abs(here.mean() - left * (1.0 - passes)) < 0.015
        np.testing.assert_allclose(share.numpy()[here], passes, atol=5e-3)
        left *= passes
    assert abs((found.numpy() < 0.0).mean() - left) < 0.015


def curtained_room():
    """Make a room under a sky, with half transparent curtains and leaves with soft edges over a glossy floor."""
    delta = scenes.delta(
        {"leaves": leaves(30, reach=0.3), "plane": scenes.quad(3.0)},
        [("plane", scenes.place(z=-1.5), "floor"), ("leaves", scenes.place(z=-0.3), "leaf"),
         ("plane", scenes.place(z=1.4), "curtain"), ("plane", scenes.place(z=1.6), "curtain")],
        {"leaf": masked(), "curtain": scenes.transparent(0.5, color=0.8),
         "floor": scenes.material("PRINCIPLED", color=0.5, roughness=0.1, metallic=0.5)},
        lights=[scenes.lamp("POINT", 100.0, scenes.place(z=4.0))], background=0.5)
    delta.images["leaf"] = ImageData(name="leaf", pixels=blobs(steep=2.0))
    return delta


@pytest.mark.parametrize(("integrator", "samples"), [
    (Integrator.REFERENCE, 256), pytest.param(Integrator.REALTIME, 128, marks=pytest.mark.slow)])
def test_pictures_are_the_same(integrator: Integrator, samples: int) -> None:
    """Draw what lies under leaves and curtains as bright as programs do, with both integrators, alone and in sum."""
    pictures = []
    for enabled in (True, False):
        settings = dataclasses.replace(
            scenes.SETTINGS, performance=PerformanceSettings(opacity_maps=enabled),
            sampling=dataclasses.replace(scenes.SETTINGS.sampling, integrator=integrator))
        session = Session(settings)
        session.update(curtained_room())
        assert decides_layers(session._scene.scene) == enabled
        session.configure(settings, scenes.camera_above(height=1.3, half=1.2), 24, 24)
        session.step(samples)
        pictures.append(session.read()[..., :3].astype(float))
        session.close()
    assert pictures[0].mean() == pytest.approx(pictures[1].mean(), rel=0.015)
    blocks = [picture.reshape(4, 6, 4, 6, 3).mean((1, 3)) for picture in pictures]
    np.testing.assert_allclose(blocks[0], blocks[1], rtol=0.08)


def test_known_layers_need_no_lists() -> None:
    """Launch nothing that runs transparency programs for the rays of caches and lamps, where rays decide."""
    for enabled in (True, False):
        settings = dataclasses.replace(
            scenes.SETTINGS, performance=PerformanceSettings(opacity_maps=enabled),
            sampling=dataclasses.replace(scenes.SETTINGS.sampling, integrator=Integrator.REALTIME))
        session = Session(settings)
        session.update(curtained_room())
        session.configure(settings, scenes.camera_above(height=1.3, half=1.2), 24, 24)
        session.step(1)
        names = {kernel for _, kernel in session._realtime.pipeline.launches()}
        session.close()
        assert ("trace_decided_shadows" in names) == ("trace_decided_rays" in names) == enabled
        assert ("weaken_shadow_rays_lean" in names) == ("filter_paths_lean" in names) == (not enabled)
