# SPDX-License-Identifier: GPL-3.0-or-later
"""What rays meet after edits that leave a structure with something odd: nothing at all, no height, other neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.device_scene import DeviceScene
from burnish.engine.scene import ImageData, SceneDelta, Visibility
from burnish.engine.settings import PerformanceSettings
from burnish.engine.structures import decides_layers

from tests import scenes
from tests.unit.engine import test_instanced_layers as layers
from tests.unit.engine.test_structures import MATERIALS, check, meshes, objects, opened

SETTINGS = PerformanceSettings(instancing_threshold=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("instanced", [False, True])
def test_meshes_that_lose_all_triangles_are_gone(instanced: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Meet nothing of a mesh whose triangles have all gone, and those that it gets later."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0 if instanced else 1 << 20)
    # So many triangles stay that what is gone is no reason to build anew.
    shapes = {**meshes(), "plane": scenes.sphere(0.7, rings=20)}
    made = DeviceScene(layers.DEVICE)
    made.apply(scenes.delta(shapes, objects(), MATERIALS), SETTINGS)
    nothing = scenes.mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    for ball in (nothing, meshes(8, 0.25)["ball"], nothing, meshes(12)["ball"]):
        made.apply(SceneDelta(meshes={"ball": ball}), SETTINGS)
        check(made, {**shapes, "ball": ball}, objects())


def squashed(axes: tuple[float, float, float]) -> list[tuple]:
    """Make spheres whose scale is so along the axes, over and beside a sphere as it is in object space."""
    placed = [("plane", scenes.place(z=-0.4), "grey"), ("ball", np.eye(4), "grey")]
    for i in range(9):
        matrix = scenes.place(x=0.8 * (i % 3) - 0.8 + 0.02 * i, y=0.8 * (i // 3) - 0.8, z=0.5 + 0.02 * i)
        placed.append(("ball", matrix @ np.diag([*axes, 1.0]), "clear" if i % 3 else "grey"))
    return placed


@pytest.mark.slow
@pytest.mark.parametrize(("instanced", "axes"), [
    pytest.param(instanced, axes, id=f"{instanced}-axes{i}") for instanced in (False, True)
    for i, axes in enumerate((
        (0.0, 0.0, 0.0), (1.0, 0.7, 0.0), (0.0, -0.5, 1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1e-42)))])
def test_squashed_instances_are_met_where_they_are(
    instanced: bool, axes: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Meet discs where a scale is 0 along an axis, nothing where it is along two: flattened or not, moved or not."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0 if instanced else 1 << 20)
    shapes, placed = {"ball": scenes.sphere(0.6, rings=5), "plane": scenes.quad(3.0)}, squashed(axes)
    made = DeviceScene(layers.DEVICE)
    made.apply(scenes.delta(shapes, placed, MATERIALS), SETTINGS)
    seen = np.count_nonzero(axes) > 1
    assert (check(made, shapes, placed) > 1).any() == seen
    for scale in (1.0, 0.0):
        moved = placed[:2] + [(key, matrix @ scenes.place(x=0.1) + scale * np.diag([0.3, 0.3, 0.3, 0.0]), material)
                              for key, matrix, material in placed[2:]]
        made.apply(SceneDelta(instances=scenes.instances(moved)), SETTINGS)
        assert (check(made, shapes, moved) > 1).any() == (seen or scale > 0.0)


@pytest.mark.parametrize("seen_first", [False, True])
def test_maps_are_not_shared_with_what_some_rays_pass(seen_first: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave an instance that throws no shadow to tests where its mesh's other instances have maps."""
    shadowless = Visibility.ALL & ~Visibility.SHADOW
    placed = [("leaves", scenes.place(x=0.4 * i), "leaf", shadowless if (i < 2) != seen_first else Visibility.ALL)
              for i in range(4)]
    made = layers.opened(placed, flat=False, monkeypatch=monkeypatch)
    assert not decides_layers(made.scene)
    assert len(made.structures.levels.local) == 2
    _, face, solid, _ = layers.looked(made)
    hidden = np.array([visibility == shadowless for *_, visibility in placed])
    assert not solid[hidden[face[..., 0]] & (face[..., 0] >= 0)].any() and solid.any()
    for now in (Visibility.ALL, shadowless):
        made.apply(SceneDelta(instances=scenes.instances([(*one[:3], now) for one in placed])), SETTINGS)
        assert decides_layers(made.scene) == (now == Visibility.ALL)


def test_images_renew_the_maps_of_what_has_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make maps anew after another of a mesh's instances has joined those that moved."""
    placed = [("leaves", scenes.place(x=0.4 * i, z=0.3 * i), "leaf") for i in range(4)]
    made = layers.opened(placed, flat=True, monkeypatch=monkeypatch)
    for i in (2, 1):
        placed[i] = ("leaves", scenes.place(y=0.1) @ placed[i][1], "leaf")
        made.apply(SceneDelta(instances=scenes.instances(placed)), PerformanceSettings())
        assert decides_layers(made.scene)
    pixels = layers.delta(placed).images["leaf"].pixels
    made.apply(SceneDelta(images={"leaf": ImageData(
        name="leaf", pixels=pixels[::-1].copy(), source_colorspace="Non-Color")}), PerformanceSettings())
    assert decides_layers(made.scene)


@pytest.mark.slow
def test_boxes_are_compared_with_those_that_were_built() -> None:
    """Build anew after the first jump, of a mesh or of instances, not only after one beyond that."""
    made, seen = opened(meshes(), objects()), []
    for radius in (0.3, 1.2, 1.2):
        shapes = meshes(10, radius)
        made.apply(SceneDelta(meshes={"ball": shapes["ball"]}), PerformanceSettings())
        check(made, shapes, objects())
        seen += [part.tree.wide.nodes.ptr for local in made.structures.levels.local.values()
                 for part in local.parts[:1] if part.tree]
    assert seen[0] == seen[1] != seen[2]
    made, seen = opened(meshes(), objects()), []
    for spread in (0.01, 4.0, 4.1):
        placed = [(key, scenes.place(x=spread * (i % 3), z=0.01 + spread * (i % 2)) @ matrix, material)
                  for i, (key, matrix, material) in enumerate(objects())]
        moved = replace(made.table, transforms=scenes.instances(placed).transforms)
        made.apply(SceneDelta(instances=moved), PerformanceSettings())
        check(made, meshes(), placed)
        seen.append(made.structures.levels.opaque.struct().nodes)
    assert seen[0] == seen[1] != seen[2]


def test_forests_are_no_larger_than_they_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Build several forests where the meshes together have too many triangles for one."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0)
    monkeypatch.setattr("burnish.engine.instance_level.FOREST", 300)
    shapes = {f"ball {i}": scenes.sphere(0.3, rings=5 + i) for i in range(6)}
    placed = [(key, scenes.place(x=0.6 * i - 1.5, y=k), "grey") for i, key in enumerate(shapes) for k in range(2)]
    made = DeviceScene(layers.DEVICE)
    made.apply(scenes.delta(shapes, placed, MATERIALS), SETTINGS)
    trees = {id(local.opaque.tree.wide): local.opaque.tree.wide for local in made.structures.levels.local.values()}
    assert 1 < len(trees) < 6
    check(made, shapes, placed)


@pytest.mark.slow
def test_room_of_what_has_gone_is_won_back() -> None:
    """Keep the buffers small, what rays meet and where surfaces were while a mesh has other triangles each time."""
    shapes = {**meshes(), "other": scenes.sphere(0.2, rings=6)}
    placed = [*objects(), ("other", scenes.place(x=1.9, z=0.3), "grey")]
    made = DeviceScene(layers.DEVICE)
    made.apply(scenes.delta(shapes, placed, MATERIALS), SETTINGS)
    made.store.remember = True
    sizes, live, packed = [], [], 0
    for i in range(24):
        shapes["ball"] = scenes.sphere(0.3, rings=8 + i % 2)
        before = made.store.positions.used
        made.store.replaced.clear()
        made.apply(SceneDelta(meshes={
            "ball": shapes["ball"], "other": scenes.sphere(0.2 + 0.001 * i, rings=6)}), SETTINGS)
        shapes["other"] = scenes.sphere(0.2 + 0.001 * i, rings=6)
        r = made.store.ranges["other"]
        packed += made.store.positions.used < before
        assert made.store.replaced["other"][:2] == (r.vertex_start, r.vertex_count)
        for key, mesh in shapes.items():
            r = made.store.ranges[key]
            part = slice(r.triangle_start, r.triangle_start + r.triangle_count)
            corners = made.store.positions.array.numpy()[made.store.triangles.array.numpy()[part]]
            np.testing.assert_array_equal(corners, mesh.positions[mesh.triangles].astype(np.float32))
        sizes.append(len(made.store.triangles.array))
        live.append(sum(len(mesh.triangles) for mesh in shapes.values()))
    check(made, shapes, placed)
    assert max(sizes) < 3 * max(live) and packed > 4
