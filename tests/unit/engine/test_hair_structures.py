# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair in the acceleration structures, where pieces of strands are items of their own."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.device_scene import DeviceScene
from burnish.engine.hair import Strands, make_tubes
from burnish.engine.scene import MeshData, SceneDelta
from burnish.engine.settings import PerformanceSettings

from tests import scenes
from tests.device import DEVICE
from tests.unit.engine.test_structures import MATERIALS, check


@pytest.mark.slow
@pytest.mark.parametrize("levels", [1, 2])
def test_hair_of_instances_is_met(levels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Meet the strands of hair, which are tubes in the tree, flattened, instanced, mirrored, moved and deformed."""
    monkeypatch.setattr("burnish.engine.structures.ALWAYS_FLATTEN", 0 if levels == 2 else 1 << 20)

    def fur(seed: int) -> MeshData:
        rng = np.random.default_rng(seed)
        points = rng.uniform(-0.5, 0.5, (25, 1, 3)) + np.linspace(0, 0.6, 4)[:, None] * rng.normal(size=(25, 1, 3))
        radii = np.tile(np.float32([0.03, 0.03, 0.02, 0.0]), 25)
        hair = make_tubes(Strands(points.reshape(-1, 3).astype(np.float32), radii, np.full(25, 4)), 1)
        return scenes.mesh(hair.positions, hair.triangles)

    def objects(x: float) -> list[tuple]:
        mirrored = scenes.place(x=-0.7) @ np.diag([1.0, 1.0, -1.0, 1.0])
        return [("plane", np.eye(4), "grey"), ("fur", scenes.place(x=x, z=0.4), "grey"), ("fur", mirrored, "grey")]

    shapes, settings = {"plane": scenes.quad(3.0), "fur": fur(1)}, PerformanceSettings(instancing_threshold=1.0)
    made = DeviceScene(DEVICE)
    made.apply(scenes.delta(shapes, objects(0.8), MATERIALS), settings)
    geometry = made.scene.geometry
    assert (geometry.flat.tubes, geometry.instanced.tubes) == ((0, 1) if levels == 2 else (1, 0))
    check(made, shapes, objects(0.8))
    made.apply(SceneDelta(instances=scenes.instances(objects(1.1))), settings)
    assert made.scene.geometry.instanced.tubes == 1
    check(made, shapes, objects(1.1))
    for seed in (2, 3):
        shapes["fur"] = fur(seed)
        made.apply(SceneDelta(meshes={"fur": shapes["fur"]}), settings)
        check(made, shapes, objects(1.1))
