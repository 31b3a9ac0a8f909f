# SPDX-License-Identifier: GPL-3.0-or-later
"""Broken meshes made in Blender: extraction gives something drawable and says what it left out."""

from __future__ import annotations

import json

import pytest

SCRIPT = r'''
import json
import bpy
import numpy as np
from burnish.addon.extract.scene import SceneExtractor
from burnish.engine.report import Report

bpy.ops.wm.read_factory_settings(use_empty=True)


def add(name, vertices, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    item = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(item)
    return item


corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
nan, inf = float("nan"), float("inf")
add("Good", corners, [(0, 1, 2, 3)])
add("NaN", [*corners, (nan, 0, 0)], [(0, 1, 2), (0, 1, 4)])
add("Infinite", [*corners, (0, inf, 0)], [(0, 1, 2), (0, 1, 4)])
add("Far", [*corners, (0, 0, 1e30)], [(0, 1, 2), (0, 1, 4)])
add("Flat", [*corners, (2, 0, 0)], [(0, 1, 2), (0, 1, 4), (0, 1, 1)])
add("Missing Vertex", corners, [(0, 1, 2), (0, 1, 9)])
add("Missing Polygon Vertex", corners, [(0, 1, 2, 77)])
add("All Broken", [(nan, nan, nan)] * 4, [(0, 1, 2, 3)])
add("No Faces", corners, [])
add("Nothing", [], [])
odd = add("Broken UV", corners, [(0, 1, 2, 3)])
odd.data.uv_layers.new(name="UV").uv.foreach_set("vector", [nan, 0, 1, inf, 0, 0, 1, 1])
deep = add("Slots", corners, [(0, 1, 2, 3)])
deep.data.polygons[0].material_index = 30000
broken = add("Broken Transform", corners, [(0, 1, 2, 3)])
broken.location.x = nan
huge = add("Huge", corners, [(0, 1, 2, 3)])
huge.scale = (1e30, 1e30, 1e30)
report = Report()
delta = SceneExtractor().extract(bpy.context.evaluated_depsgraph_get(), viewport=False, report=report)
table = delta.instances
meshes = {}
for row, index in enumerate(table.object_name_index):
    mesh = delta.meshes[table.mesh_keys[table.mesh_index[row]]]
    points = mesh.positions[mesh.triangles]
    meshes[table.object_names[index]] = {
        "triangles": len(mesh.triangles), "slots": mesh.material_slots.tolist(),
        "finite": bool(np.isfinite(points).all() and np.isfinite(mesh.corner_normals).all()
                       and np.isfinite(mesh.positions).all()
                       and all(np.isfinite(uv).all() for uv in mesh.uv_maps.values())),
        "unit": bool(np.allclose(np.linalg.norm(mesh.corner_normals, axis=-1), 1.0, atol=1e-3))}
print("RESULT " + json.dumps({"meshes": meshes, "text": report.text(),
                              "finite": bool(np.isfinite(table.transforms).all())}))
'''


@pytest.fixture(scope="module")
def extracted(run_python):
    """Return what came out of the scene of broken meshes."""
    process = run_python(SCRIPT)
    lines = [line for line in process.stdout.splitlines() if line.startswith("RESULT ")]
    assert process.returncode == 0 and lines, process.stdout + process.stderr
    return json.loads(lines[-1].removeprefix("RESULT "))


def test_what_is_left_can_be_drawn(extracted):
    """Keep the good triangles of each mesh, all of them finite."""
    counts = {name: mesh["triangles"] for name, mesh in extracted["meshes"].items()}
    assert counts == {"Good": 2, "NaN": 1, "Infinite": 1, "Far": 1, "Flat": 1, "Missing Vertex": 1, "Broken UV": 2,
                      "Slots": 2}
    assert all(mesh["finite"] and mesh["unit"] for mesh in extracted["meshes"].values())
    assert extracted["meshes"]["Slots"]["slots"] == [0, 0]
    assert extracted["finite"]


@pytest.mark.parametrize(("owner", "words"), [
    ("NaN", "NaN or infinite coordinates"),
    ("Infinite", "NaN or infinite coordinates"),
    ("All Broken", "NaN or infinite coordinates"),
    ("Far", "more than 1e9 m"),
    ("Missing Vertex", "vertices that don't exist"),
    ("Missing Polygon Vertex", "vertices that don't exist"),
    ("Broken UV", "broken texture coordinates"),
    ("Broken Transform", "broken transform"),
    ("Huge", "larger than 1e9 m"),
])
def test_what_is_left_out_is_said(extracted, owner, words):
    """Name the object and the reason in the report."""
    lines = [line for line in extracted["text"].splitlines() if f"object '{owner}'" in line]
    assert any(words in line for line in lines), extracted["text"]


def test_good_meshes_are_not_mentioned(extracted):
    """Say nothing about objects that are fine, nor about those that have no faces."""
    for name in ("Good", "Slots", "No Faces", "Nothing"):
        assert f"object '{name}'" not in extracted["text"]
    assert "triangles without area were left out (x2)" in extracted["text"]
