# SPDX-License-Identifier: GPL-3.0-or-later
"""engine/geometry_store.py: what lies on the device after meshes have come, changed, grown and gone."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.device_scene import DeviceScene
from burnish.engine.geometry_store import GeometryStore
from burnish.engine.sanitize import sanitize_mesh
from burnish.engine.scene import MeshData
from burnish.engine.settings import PerformanceSettings

from tests import scenes


def random_mesh(seed: int, vertices: int, triangles: int, maps: int = 1) -> MeshData:
    """Make a mesh of random numbers."""
    rng = np.random.default_rng(seed)
    return MeshData(
        name=f"{seed}", positions=rng.normal(size=(vertices, 3)).astype(np.float32),
        triangles=rng.integers(0, vertices, (triangles, 3)).astype(np.int32),
        material_slots=rng.integers(0, 3, triangles).astype(np.int32),
        corner_normals=rng.normal(size=(triangles, 3, 3)).astype(np.float32),
        uv_maps={f"{i}": rng.random((triangles, 3, 2), np.float32) for i in range(maps)},
        attributes={"color": rng.random((triangles, 3, 4), np.float32)})


def check(store: GeometryStore, meshes: dict[str, MeshData]) -> None:
    """Compare what lies on the device with meshes."""
    arrays = {name: getattr(store, name).array.numpy()
              for name in ("positions", "triangles", "slots", "corners", "uvs", "attributes")}
    uv_offsets, attribute_offsets = (table.numpy() for table in store.tables())
    for key, mesh in meshes.items():
        r, count = store.ranges[key], len(mesh.triangles)
        rows = slice(r.triangle_start, r.triangle_start + count)
        vertices = arrays["positions"][r.vertex_start:r.vertex_start + len(mesh.positions)]
        np.testing.assert_array_equal(vertices, mesh.positions)
        np.testing.assert_array_equal(arrays["triangles"][rows] - r.vertex_start, mesh.triangles)
        np.testing.assert_array_equal(arrays["slots"][rows], mesh.material_slots)
        assert r.used_slots.tolist() == sorted(set(mesh.material_slots.tolist()))
        corners = arrays["corners"][6 * r.triangle_start:6 * (r.triangle_start + count)].reshape(count, 6, 4)
        np.testing.assert_array_equal(corners[:, :3, :3], mesh.positions[mesh.triangles])
        np.testing.assert_array_equal(corners[:, 0, 3], mesh.material_slots)
        np.testing.assert_array_equal(corners[:, 3:, :3], mesh.corner_normals)
        for table, buffer, parts, ids in (
                (uv_offsets, "uvs", mesh.uv_maps, store.uv_id),
                (attribute_offsets, "attributes", mesh.attributes, store.attribute_id)):
            for name, values in parts.items():
                start = table[r.row, ids(name)]
                np.testing.assert_array_equal(
                    arrays[buffer][start:start + 3 * count], values.reshape(3 * count, values.shape[-1]))


def test_meshes_are_what_was_put(device: str) -> None:
    """Keep every number of meshes that come together, are changed in place, grow, come later and move together."""
    store = GeometryStore(device)
    meshes = {"a": random_mesh(1, 20, 30), "empty": random_mesh(2, 3, 0), "b": random_mesh(3, 500, 5000, maps=2),
              "c": random_mesh(4, 7, 9, maps=0)}
    store.put(meshes)
    check(store, meshes)
    edits = {"c": random_mesh(5, 6, 9, maps=0), "a": random_mesh(6, 20, 30), "d": random_mesh(7, 30, 40)}
    store.put(edits)
    meshes |= edits
    check(store, meshes)
    store.put({"a": random_mesh(8, 90, 200, maps=2), "b": random_mesh(9, 4, 5)})
    meshes |= {"a": random_mesh(8, 90, 200, maps=2), "b": random_mesh(9, 4, 5)}
    check(store, meshes)
    assert store.compact(), "most of what b had lies idle"
    check(store, meshes)
    store.put({"e": random_mesh(10, 60, 70)})
    check(store, {**meshes, "e": random_mesh(10, 60, 70)})


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_loose_vertices_that_are_not_finite_bound_nothing(device: str, value: float) -> None:
    """Draw a mesh of which a vertex that no triangle has is nowhere, with bounds of what it shows."""
    mesh = scenes.quad()
    loose = np.concatenate([mesh.positions, np.full((1, 3), value, np.float32)])
    mesh, counts = sanitize_mesh(MeshData(**{**vars(mesh), "positions": loose}))
    assert counts.dropped == 0
    scene = DeviceScene(device)
    scene.apply(scenes.delta({"quad": mesh}, [("quad", np.eye(4), "grey")], {"grey": scenes.material()}),
                PerformanceSettings())
    assert scene.drawn.all() and np.isfinite(scene.low).all() and np.isfinite(scene.high).all()
    assert 2.0 < scene.radius < 3.0
