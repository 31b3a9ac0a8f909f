# SPDX-License-Identifier: GPL-3.0-or-later
"""Cleaning of meshes: what is dropped, what is repaired, and that good ones pass untouched and quickly."""

from __future__ import annotations

import time

import numpy as np
import pytest
from burnish.engine.device import load_module, start_warp
from burnish.engine.report import Report
from burnish.engine.sanitize import (
    COORDINATE_LIMIT,
    SanitizeCounts,
    has_defects,
    report_counts,
    sanitize_mesh,
    sanitize_meshes,
)
from burnish.engine.scene import MeshData
from burnish.kernels.mesh_checks import find_defects


def grid(side: int) -> MeshData:
    """Return a flat grid of 2 * (side - 1)**2 triangles with one UV map and one attribute."""
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    positions = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3).astype(np.float32)
    index = np.arange(side * side).reshape(side, side)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    count = len(triangles)
    normals = np.zeros((count, 3, 3), np.float32)
    normals[..., 2] = 1.0
    rng = np.random.default_rng(1)
    return MeshData(
        name="grid", positions=positions, triangles=triangles.astype(np.int32),
        material_slots=np.arange(count, dtype=np.int32), corner_normals=normals,
        uv_maps={"UV": rng.random((count, 3, 2), np.float32)},
        attributes={"Color": rng.random((count, 3, 4), np.float32)})


def without_triangles():
    """Return a mesh of loose vertices."""
    mesh = grid(3)
    mesh.triangles, mesh.material_slots = mesh.triangles[:0], mesh.material_slots[:0]
    mesh.corner_normals, mesh.uv_maps, mesh.attributes = mesh.corner_normals[:0], {}, {}
    return mesh


@pytest.fixture(autouse=True, params=[True, False], ids=["kernel", "NumPy"])
def built(request, monkeypatch):
    """Run each test with the kernel that looks for defects, and as it goes before that is built."""
    start_warp()
    load_module(find_defects.module.name, "cpu")
    if not request.param:
        monkeypatch.setattr("burnish.engine.sanitize.is_loaded", lambda kernel, device: False)


def test_good_mesh_is_returned_as_it_is():
    """Return the very same object where nothing is wrong."""
    mesh = grid(5)
    cleaned, counts = sanitize_mesh(mesh)
    assert cleaned is mesh and counts == SanitizeCounts()


def test_empty_meshes():
    """Accept a mesh without triangles and one without vertices."""
    assert sanitize_mesh(without_triangles())[1] == SanitizeCounts()
    mesh = grid(2)
    mesh.positions = mesh.positions[:0]
    cleaned, counts = sanitize_mesh(mesh)
    assert len(cleaned.triangles) == 0 and counts.bad_indices == 2


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_vertex_drops_its_triangles(value):
    """Drop the triangles around a vertex that isn't finite, with everything that belongs to them."""
    mesh = grid(4)
    mesh.positions[5, 1] = value
    touched = (mesh.triangles == 5).any(axis=1)
    cleaned, counts = sanitize_mesh(mesh)
    assert counts == SanitizeCounts(non_finite=int(touched.sum())) and counts.non_finite == 6
    assert cleaned.material_slots.tolist() == np.flatnonzero(~touched).tolist()
    np.testing.assert_array_equal(cleaned.uv_maps["UV"], mesh.uv_maps["UV"][~touched])
    np.testing.assert_array_equal(cleaned.attributes["Color"], mesh.attributes["Color"][~touched])
    assert np.isfinite(cleaned.positions).all(), "bounds made of all vertices must be finite"
    assert np.isnan(mesh.positions[5, 1]) or np.isinf(mesh.positions[5, 1]), "the argument is left alone"
    assert cleaned.triangles.flags.c_contiguous and cleaned.corner_normals.flags.c_contiguous


def test_each_defect_is_counted_once():
    """Count out-of-range, non-finite, far and flat triangles separately, each triangle once."""
    mesh = grid(3)
    mesh.triangles[0, 1] = 99
    mesh.triangles[1, 0] = -1
    mesh.positions[8] = (0.0, 0.0, 2.0 * COORDINATE_LIMIT)
    mesh.triangles[2] = (0, 0, 1)
    mesh.triangles[3] = (0, 1, 2)
    far = (mesh.triangles == 8).any(axis=1)
    far[[0, 1, 2, 3]] = False
    cleaned, counts = sanitize_mesh(mesh)
    assert counts.bad_indices == 2 and counts.degenerate == 2 and counts.too_far == int(far.sum()) > 0
    assert counts.dropped == len(mesh.triangles) - len(cleaned.triangles)
    assert cleaned.triangles.min() >= 0 and cleaned.triangles.max() < len(cleaned.positions)
    assert np.abs(cleaned.positions).max() <= COORDINATE_LIMIT


def test_normals_are_replaced_by_the_face_normal():
    """Repair zero, NaN and infinite corner normals; keep the others bit by bit."""
    mesh = grid(3)
    for corner, bad in enumerate((0.0, np.nan, np.inf)):
        mesh.corner_normals[2, corner] = bad
    mesh.corner_normals[3, 1] = (0.6, 0.0, 0.8)
    cleaned, counts = sanitize_mesh(mesh)
    assert counts == SanitizeCounts(normals=3)
    np.testing.assert_array_equal(cleaned.corner_normals[2], [[0.0, 0.0, 1.0]] * 3)
    np.testing.assert_array_equal(cleaned.corner_normals[3], mesh.corner_normals[3])
    assert np.isnan(mesh.corner_normals[2, 1]).all()


def test_coordinates_become_zero():
    """Set non-finite UVs and attributes to zero, corner by corner."""
    mesh = grid(3)
    mesh.uv_maps["UV"][1, 2] = (np.nan, 0.5)
    mesh.attributes["Color"][0, 0, 3] = np.inf
    mesh.attributes["Big"] = np.full_like(mesh.attributes["Color"], 1e30)
    cleaned, counts = sanitize_mesh(mesh)
    assert counts == SanitizeCounts(coordinates=2)
    assert cleaned.uv_maps["UV"][1, 2].tolist() == [0.0, 0.0]
    assert cleaned.attributes["Color"][0, 0].tolist() == [0.0] * 4
    np.testing.assert_array_equal(cleaned.uv_maps["UV"][0], mesh.uv_maps["UV"][0])
    np.testing.assert_array_equal(cleaned.attributes["Big"], mesh.attributes["Big"])


def test_random_damage_never_survives():
    """Leave nothing broken behind, whatever is thrown in."""
    rng = np.random.default_rng(7)
    bad = np.array([np.nan, np.inf, -np.inf, 1e30, -1e20, 0.0], np.float32)
    for _ in range(20):
        mesh = grid(6)
        for array in (mesh.positions, mesh.corner_normals, mesh.uv_maps["UV"], mesh.attributes["Color"]):
            flat = array.reshape(-1)
            flat[rng.integers(0, len(flat), 4)] = rng.choice(bad, 4)
        mesh.triangles.reshape(-1)[rng.integers(0, mesh.triangles.size, 3)] = rng.integers(-9, 99, 3)
        cleaned, counts = sanitize_mesh(mesh)
        corners = cleaned.positions[cleaned.triangles].astype(np.float64)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        assert (area > 0.0).all() and np.isfinite(cleaned.corner_normals).all()
        assert np.isfinite(cleaned.positions).all() and np.isfinite(cleaned.uv_maps["UV"]).all()
        assert counts.dropped == len(mesh.triangles) - len(cleaned.triangles)


def test_counts_become_report_entries():
    """Report each kind of defect once, with its count; flat triangles for the whole scene."""
    report = Report()
    report_counts(report, "object 'Floor'", SanitizeCounts(non_finite=3, degenerate=2))
    report_counts(report, "object 'Wall'", SanitizeCounts(degenerate=5))
    entries = {(entry.owner, entry.count) for entry in report.entries()}
    assert entries == {("object 'Floor'", 3), ("", 7)}


@pytest.mark.parametrize(("array", "place", "value"), [
    ("positions", (7, 1), np.nan), ("positions", (0, 0), -np.inf), ("positions", (11, 2), 2e9),
    ("triangles", (17, 2), 16), ("triangles", (0, 0), -1), ("triangles", (3, slice(None)), 5),
    ("corner_normals", (17, 2), 0.0), ("corner_normals", (4, 0, 1), np.inf), ("material_slots", (9,), -1),
    ("material_slots", (17,), 1 << 24),
])
def test_the_quick_look_finds_every_defect(array: str, place: tuple, value: float) -> None:
    """Tell a whole mesh from one with a single wrong number, wherever that is."""
    mesh = grid(4)
    assert not has_defects(mesh)
    getattr(mesh, array)[place] = value
    assert has_defects(mesh)


def test_a_million_triangles_take_a_moment():
    """Stay far below a second for a million triangles (40 ms measured; the bound only catches slow rewrites)."""
    mesh = grid(708)
    start = time.perf_counter()
    sanitize_mesh(mesh)
    assert time.perf_counter() - start < 1.0


def test_slots_stay_in_a_range_that_float32_holds():
    """Clip slots that no object can have: kernels read them as float32, and an overflow would index before an array."""
    mesh = grid(3)
    mesh.material_slots[:4] = (-(2**31), -1, 2**31 - 1, 2**24)
    cleaned, counts = sanitize_mesh(mesh)
    assert counts == SanitizeCounts(), "the surface stays as it is"
    assert cleaned.material_slots[:2].tolist() == [0, 0] and cleaned.material_slots[4:].tolist() == [4, 5, 6, 7]
    assert (cleaned.material_slots.astype(np.float32).astype(np.int64) == cleaned.material_slots).all()
    assert (cleaned.material_slots[2:4] > 2**20).all()


def names_another_s_vertex(mesh):
    """Name a vertex that only the next mesh has."""
    mesh.triangles[3, 1] = len(mesh.positions)


def has_no_normal(mesh):
    """Have a corner without a normal."""
    mesh.corner_normals[2, 1] = 0.0


def has_no_area(mesh):
    """Have a triangle without area."""
    mesh.triangles[1] = mesh.triangles[1, 0]


def has_no_place(mesh):
    """Have a vertex that is nowhere, and an infinite one."""
    mesh.positions[4], mesh.positions[5, 0] = np.nan, np.inf


def has_bad_coordinates(mesh):
    """Have a texture coordinate and a colour that are not finite."""
    mesh.uv_maps["UV"][0, 0, 0], mesh.attributes["Color"][1, 2, 3] = np.nan, np.inf


BREAKS = [names_another_s_vertex, has_no_normal, has_no_area, has_no_place, has_bad_coordinates]


def test_good_meshes_are_returned_as_they_are():
    """Return the very same objects where nothing is wrong with any of them."""
    meshes = [grid(5), without_triangles(), grid(2)]
    assert all(found is mesh and counts == SanitizeCounts()
               for mesh, (found, counts) in zip(meshes, sanitize_meshes(meshes), strict=True))
    assert sanitize_meshes([]) == []


@pytest.mark.parametrize("spoil", BREAKS)
@pytest.mark.parametrize("small", [100, 40])
def test_meshes_together_are_cleaned_as_each_is(monkeypatch, spoil, small):
    """Find in any of several meshes what is found in it by itself, and leave the others as they are."""
    monkeypatch.setattr("burnish.engine.sanitize.SMALL_TRIANGLES", small)
    for place in range(3):
        meshes = [grid(5), grid(4), grid(6)]
        spoil(meshes[place])
        alone, alone_counts = sanitize_mesh(meshes[place])
        assert alone_counts != SanitizeCounts()
        for index, (found, counts) in enumerate(sanitize_meshes(meshes)):
            if index != place:
                assert found is meshes[index] and counts == SanitizeCounts()
                continue
            assert counts == alone_counts
            for name in ("positions", "triangles", "material_slots", "corner_normals"):
                np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))
            np.testing.assert_array_equal(found.uv_maps["UV"], alone.uv_maps["UV"])
