# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes as Blender stores them, by triangles (engine/stored_mesh.py)."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.mesh_features import ISLAND, POINTINESS
from burnish.engine.sanitize import sanitize_mesh
from burnish.engine.stored_mesh import CORNER, FACE, POINT, StoredMesh


def house(**changes) -> StoredMesh:
    """Return a square of two triangles and a triangle above it, of two materials."""
    values = {
        "name": "house",
        "positions": np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [0.5, 0, 2]], np.float32),
        "corner_vertices": np.array([0, 1, 2, 3, 3, 2, 4], np.int32),
        "corners": np.array([0, 1, 2, 0, 2, 3, 4, 5, 6], np.int32),
        "faces": np.array([0, 0, 1], np.int32),
        "slots": np.array([3, 1], np.int32),
        "normals": np.tile(np.array([[0, -1, 0]], np.float32), (7, 1))}
    return StoredMesh(**values | changes)


def test_a_mesh_of_any_faces_is_told_by_triangles():
    """Corners name vertices through the faces' corners, slots follow the faces."""
    mesh = house().by_triangles()
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 4]]
    assert mesh.material_slots.tolist() == [3, 3, 1]
    assert mesh.corner_normals.shape == (3, 3, 3) and (mesh.corner_normals == [0, -1, 0]).all()


def test_a_mesh_of_triangles_alone_needs_no_corners():
    """Where every face is a triangle, corners and faces are what they are."""
    mesh = house(corner_vertices=np.array([2, 1, 0], np.int32), corners=None, faces=None,
                 slots=np.array([5], np.int32), normals=np.eye(3, dtype=np.float32)).by_triangles()
    assert mesh.triangles.tolist() == [[2, 1, 0]] and mesh.material_slots.tolist() == [5]
    assert (mesh.corner_normals[0] == np.eye(3)).all()


@pytest.mark.parametrize(("domain", "expected"), [
    (POINT, [[0, 1, 2], [0, 2, 3], [3, 2, 4]]),
    (CORNER, [[0, 1, 2], [0, 2, 3], [4, 5, 6]]),
    (FACE, [[0, 0, 0], [0, 0, 0], [1, 1, 1]])])
def test_attributes_of_each_domain_reach_the_corners(domain, expected):
    """Each value is its own number: what arrives tells where it came from."""
    count = {POINT: 5, CORNER: 7, FACE: 2}[domain]
    values = np.repeat(np.arange(count, dtype=np.float32)[:, None], 4, axis=1)
    mesh = house(attributes={"number": (domain, values)}).by_triangles()
    found = mesh.attributes["number"]
    assert found.shape == (3, 3, 4) and found.flags["C_CONTIGUOUS"]
    assert (found[..., 0] == expected).all() and (found[..., 3] == expected).all()


def test_uv_maps_keep_their_order():
    """The first is the one that is active for rendering."""
    maps = {name: np.random.default_rng(3).random((7, 2), np.float32) for name in ("second", "first")}
    mesh = house(uv_maps=maps).by_triangles()
    assert list(mesh.uv_maps) == ["second", "first"]
    assert (mesh.uv_maps["first"][1] == maps["first"][[0, 2, 3]]).all()


def test_without_slots_all_faces_have_the_first():
    """Most meshes have one material."""
    assert house(slots=None).by_triangles().material_slots.tolist() == [0, 0, 0]


def test_zero_normals_point_up_and_what_was_read_stays():
    """As in Cycles; the arrays that were read may belong to another."""
    normals = np.zeros((7, 3), np.float32)
    normals[0] = (1, 0, 0)
    stored = house(normals=normals)
    mesh = stored.by_triangles()
    assert mesh.corner_normals[0].tolist() == [[1, 0, 0], [0, 0, 1], [0, 0, 1]]
    assert (stored.normals[1:] == 0).all()


def test_unknown_normals_are_left_to_the_faces():
    """Zeros, which sanitize_mesh replaces."""
    mesh, counts = sanitize_mesh(house(normals=None).by_triangles())
    assert counts.normals == 9
    assert np.allclose(np.abs(mesh.corner_normals[..., 1]), 1.0)


def test_vertices_that_do_not_exist_are_no_error_yet():
    """sanitize_mesh drops the triangle that names one."""
    values = np.arange(5, dtype=np.float32)[:, None].repeat(4, 1)
    mesh = house(corner_vertices=np.array([0, 1, 2, 3, 3, 2, 40], np.int32), normals=None,
                 attributes={"number": (POINT, values)}).by_triangles()
    cleaned, counts = sanitize_mesh(mesh)
    assert counts.bad_indices == 1 and len(cleaned.triangles) == 2


def test_features_are_worked_out_from_the_edges():
    """Two parts have two numbers; a plane is flat."""
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]], np.int32)
    mesh = house(derived=frozenset((ISLAND, POINTINESS)), edges=edges,
                 vertex_normals=np.tile(np.array([[0, -1, 0]], np.float32), (5, 1))).by_triangles()
    islands = mesh.attributes[ISLAND][..., 0]
    assert len(np.unique(islands[:2])) == 1 and islands[2, 2] != islands[0, 0]
    assert np.allclose(mesh.attributes[POINTINESS][:2], 0.5)


def test_no_triangles_are_no_error():
    """Of a mesh without any faces."""
    none = house(positions=np.empty((0, 3), np.float32), corner_vertices=np.empty(0, np.int32), corners=None,
                 faces=None, slots=None, normals=None).by_triangles()
    assert none.triangles.shape == (0, 3) and none.corner_normals.shape == (0, 3, 3)
