# SPDX-License-Identifier: GPL-3.0-or-later
"""Transparent triangles of instances: their maps and answers against those of the same triangles, flattened."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.scene import ImageData, SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import Integrator, PerformanceSettings
from burnish.engine.structures import decides_layers
from burnish.kernels.decided_instances import share_through_all
from burnish.kernels.intersect import any_hit
from burnish.kernels.types import Scene
from burnish.kernels.wide_instances import chance_layer_in_instances

from tests import scenes
from tests.device import DEVICE
from tests.unit.engine.test_opacity_maps import blobs, follow, leaves, masked

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

RAYS = 2000
MATERIALS = {"leaf": masked(), "coarse": masked(0.6, channel=1), "half": scenes.transparent(0.4, color=0.7),
             "grey": scenes.material(color=0.5)}


@wp.kernel
def look_through_all(
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
    share_out[i] = share_through_all(scene.geometry, origin[i], direction[i], t_max)


@wp.kernel
def pass_by_chance(
    # In:
    scene: Scene,
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    t_max: float,
    # Out:
    passed_out: wp.array2d[int],
):
    """Find whether rays pass all layers of instances, once for each seed; -1: something opaque is in the way."""
    i, k = wp.tid()
    level = scene.geometry.instanced_filtered
    found = chance_layer_in_instances(
        level.nodes, level.records, origin[i], direction[i], t_max, wp.uint32(k * 977 + 13))
    passed_out[i, k] = wp.where(wp.cast(found[3], int) < 0, 1, 0)
    if any_hit(scene.geometry, origin[i], direction[i], t_max):
        passed_out[i, k] = -1


def grove(materials: tuple[str, ...] = ("leaf", "coarse", "leaf", "half")) -> list[tuple]:
    """Make two meshes of leaves, each with instances of several materials, sheared and mirrored, over a plane."""
    made = [("plane", scenes.place(z=-1.8), "grey")]
    for i, material in enumerate(materials * 2):
        matrix = scenes.place(x=0.5 * i - 1.6, y=0.4 * (i % 3), z=0.2 * i - 0.7)
        matrix[0, 1] = 0.2
        matrix[1, 1] = -0.6 if i % 2 else 0.7
        made.append(("leaves" if i < len(materials) else "others", matrix, material))
    return made


def opened(placed: list[tuple], *, flat: bool, monkeypatch: pytest.MonkeyPatch) -> DeviceScene:
    """Put instances on the device, flattened or all in two levels."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 1 << 20 if flat else 0)
    made = DeviceScene(DEVICE)
    made.apply(delta(placed), PerformanceSettings(instancing_threshold=1.0))
    assert (made.structures.levels.filtered is None) == flat
    return made


def delta(placed: list[tuple]) -> SceneDelta:
    """Make the scene."""
    meshes = {"leaves": leaves(30), "others": leaves(20, seed=6), "plane": scenes.quad(3.0)}
    made = scenes.delta(meshes, placed, MATERIALS)
    pixels = blobs(steep=2.0)
    pixels[..., 1] = blobs(seed=4)[..., 3]
    made.images["leaf"] = ImageData(name="leaf", pixels=pixels, source_colorspace="Non-Color")
    return made


def looked(made: DeviceScene, t_max: float = 1e30) -> list[np.ndarray]:
    """Return what `follow` and `look_through_all` find for random rays."""
    rng = np.random.default_rng(7)
    rays = rng.uniform(-2, 2, (RAYS, 3)), rng.normal(size=(RAYS, 3))
    inputs = [made.scene, *(wp.array(x.astype(np.float32), dtype=wp.vec3, device=DEVICE) for x in rays), t_max]
    outputs = [wp.zeros(shape, dtype=kind, device=DEVICE) for shape, kind in (
        ((2, RAYS), float), ((2, RAYS), wp.vec2i), ((2, RAYS), int), (RAYS, float))]
    wp.launch(follow, RAYS, inputs, outputs[:3], device=DEVICE)
    wp.launch(look_through_all, RAYS, inputs, outputs[3:], device=DEVICE)
    return [output.numpy() for output in outputs]


def check_alike(made: DeviceScene, flat: DeviceScene) -> None:
    """Compare what rays meet; those through edges and outlines may differ."""
    assert decides_layers(made.scene) == decides_layers(flat.scene)
    t, face, solid, share = looked(made)
    expected_t, expected_face, expected_solid, expected_share = looked(flat)
    same = (face == expected_face).all(-1) & (solid == expected_solid)
    assert same[0].mean() > 0.997, same[0].mean()
    np.testing.assert_allclose(t[0][same[0]], expected_t[0][same[0]], rtol=1e-3, atol=1e-4)
    # A shadow ray may end at any solid triangle that it meets before it knows of something closer.
    ended = (solid[1] == 1) | (expected_solid[1] == 1)
    assert (same[1] | ended).mean() > 0.997 and ((solid[1] == 1) & (expected_solid[1] == 1)).any()
    assert (np.abs(share - expected_share) > 5e-3).mean() < 0.005
    assert (expected_solid[0] == 1).any() and ((expected_share > 0.01) & (expected_share < 0.99)).any()


def test_instances_share_their_meshes_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Decide hits on instances as on flattened triangles, each by its own material."""
    made = opened(grove(), flat=False, monkeypatch=monkeypatch)
    assert decides_layers(made.scene) and made.opacity_maps.bytes > 0
    assert len(made.structures.levels.local) == 6, "two meshes of three materials; the plane is used once"
    check_alike(made, opened(grove(), flat=True, monkeypatch=monkeypatch))


def test_other_materials_bring_their_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Decide by the new material where an instance gets another that needs a test too."""
    made = opened(grove(), flat=False, monkeypatch=monkeypatch)
    swapped = grove(("coarse", "half", "leaf", "leaf"))
    made.apply(SceneDelta(instances=scenes.instances(swapped)), PerformanceSettings(instancing_threshold=1.0))
    check_alike(made, opened(swapped, flat=True, monkeypatch=monkeypatch))
    made.use_opacity_maps(False)
    assert not decides_layers(made.scene) and made.opacity_maps.bytes == 0
    made.use_opacity_maps(True)
    check_alike(made, opened(swapped, flat=True, monkeypatch=monkeypatch))


def test_chances_of_instances_are_their_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let rays pass as often as light does, also where they meet one triangle of a mesh in several instances."""
    placed = [("leaves", scenes.place(z=0.7 * i), "half") for i in range(3)]
    made = opened(placed, flat=False, monkeypatch=monkeypatch)
    rng = np.random.default_rng(3)
    origin = np.concatenate([rng.uniform(-1, 1, (100, 2)), np.full((100, 1), -4.0)], 1).astype(np.float32)
    direction = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (100, 1))
    passed = wp.zeros((100, 4000), dtype=int, device=DEVICE)
    rays = [wp.array(x, dtype=wp.vec3, device=DEVICE) for x in (origin - made.origin.astype(np.float32), direction)]
    wp.launch(pass_by_chance, (100, 4000), [made.scene, *rays, 1e30], [passed], device=DEVICE)
    shares = wp.zeros(100, dtype=float, device=DEVICE)
    wp.launch(look_through_all, 100, [made.scene, *rays, 1e30], [shares], device=DEVICE)
    share = shares.numpy()
    assert len(np.unique(share.round(4))) > 3
    np.testing.assert_allclose(passed.numpy().mean(1), share, atol=0.035)


def test_what_moves_keeps_its_maps_and_what_is_edited_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Decide hits on masked objects that have moved out of the flattened triangles; of edited ones programs decide."""
    made = opened(grove(), flat=True, monkeypatch=monkeypatch)
    moved = [(key, scenes.place(z=0.1) @ matrix, material) if i in (2, 3) else (key, matrix, material)
             for i, (key, matrix, material) in enumerate(grove())]
    made.apply(SceneDelta(instances=scenes.instances(moved)), PerformanceSettings())
    assert len(made.structures.masked()) == 2 and decides_layers(made.scene)
    check_alike(made, opened(moved, flat=True, monkeypatch=monkeypatch))
    made.apply(SceneDelta(meshes={"others": leaves(20, seed=6)}), PerformanceSettings())
    assert not decides_layers(made.scene)


@pytest.mark.parametrize(("integrator", "samples"), [
    (Integrator.REFERENCE, 128), pytest.param(Integrator.REALTIME, 96, marks=pytest.mark.slow)])
def test_pictures_are_the_same(integrator: Integrator, samples: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw instanced leaves as bright as flattened ones, with both integrators, with maps and without."""
    pictures = []
    for flat, maps in ((True, True), (False, True), (False, False)):
        monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 1 << 20 if flat else 0)
        settings = dataclasses.replace(
            scenes.SETTINGS, performance=PerformanceSettings(opacity_maps=maps, instancing_threshold=1.0),
            sampling=dataclasses.replace(scenes.SETTINGS.sampling, integrator=integrator))
        session = Session(settings)
        lit = delta(grove())
        lit.world = scenes.delta({}, [], {}, background=0.7).world
        session.update(lit)
        assert decides_layers(session._scene.scene) == maps
        session.configure(settings, scenes.camera_above(height=3.0, half=1.6), 24, 24)
        session.step(samples)
        pictures.append(session.read()[..., :3].astype(float))
        session.close()
    for picture in pictures[1:]:
        assert picture.mean() == pytest.approx(pictures[0].mean(), rel=0.015)
        blocks = [each.reshape(4, 6, 4, 6, 3).mean((1, 3)) for each in (pictures[0], picture)]
        np.testing.assert_allclose(blocks[1], blocks[0], rtol=0.1)


@pytest.mark.parametrize("flat", [True, False])
def test_leaves_far_off_keep_their_light(flat: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw leaves of many texels a pixel as bright as programs do with the image's finest level, of which maps tell."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 1 << 20 if flat else 0)
    pictures = []
    for maps in (True, False):
        settings = dataclasses.replace(
            scenes.SETTINGS, performance=PerformanceSettings(opacity_maps=maps, instancing_threshold=1.0))
        session = Session(settings)
        lit = delta(grove(("leaf",))[1:])
        lit.images["leaf"] = ImageData(name="leaf", pixels=blobs((256, 256), steep=3.0))
        lit.lights = [scenes.lamp("POINT", 5000.0, scenes.place(z=8.0))]
        session.update(lit)
        if not maps:
            session._scene.textures.arrays.look_up_finest({0})
            session._scene._assemble()
        session.configure(settings, scenes.camera_above(height=3.0, half=12.0), 24, 24)
        session.step(256)
        pictures.append(session.read()[8:16, 8:16, :3].mean())
        session.close()
    assert pictures[0] == pytest.approx(pictures[1], rel=0.01)
