# SPDX-License-Identifier: GPL-3.0-or-later
"""Random Per Island and Pointiness against Cycles: meshes that shine with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

CODE = r'''
from burnish.addon.extract.scene import SceneExtractor
from burnish.engine.report import Report

scene = new_scene()

def shining(output):
    made = bpy.data.materials.new(output)
    tree = made.node_tree
    tree.nodes.clear()
    node, emission = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeEmission")
    tree.links.new(node.outputs[output], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return made

def place(name, mesh, material, x):
    mesh.materials.append(material)
    item = bpy.data.objects.new(name, mesh)
    item.location.x = x
    scene.collection.objects.link(item)
    return item

# Twelve islands, of one, two and three faces, with vertices in no order.
vertices, faces = [], []
random = np.random.default_rng(3)
for i in range(12):
    first, count = len(vertices), i % 3 + 1
    vertices += [(0.5 * (i % 4) + 0.2 * x, 0.6 * (i // 4) + 0.45 * y, 0.0) for x in range(count + 1) for y in (0, 1)]
    faces += [(first + 2 * x, first + 2 * x + 2, first + 2 * x + 3, first + 2 * x + 1) for x in range(count)]
order = random.permutation(len(vertices))
islands = bpy.data.meshes.new("islands")
moved = {int(old): new for new, old in enumerate(order)}
islands.from_pydata([vertices[i] for i in order], [], [tuple(moved[v] for v in face) for face in faces])
place("islands", islands, shining("Random Per Island"), -2.2)

# Bumps, cut in two along vertices that lie in one place.
side, vertices, faces = 14, [], []
for half in (0, 1):
    first = len(vertices)
    vertices += [(x / 7, (y + 7 * half) / 7, 0.15 * np.sin(x * 1.3) * np.cos((y + 7 * half) * 1.1))
                 for y in range(8) for x in range(side)]
    faces += [(corner, corner + 1, corner + side + 1, corner + side)
              for y in range(7) for corner in range(first + y * side, first + y * side + side - 1)]
bumps = bpy.data.meshes.new("bumps")
bumps.from_pydata(vertices, [], faces)
place("bumps", bumps, shining("Pointiness"), 0.2)

look_down(scene, (0.0, 1.0, 5.0), 4.6)
(ours, report), (cycles, _) = (picture(scene, engine, (96, 48), 16) for engine in ('BURNISH', 'CYCLES'))

# Which meshes are read when a material begins to ask.
graph, extractor = bpy.context.evaluated_depsgraph_get(), SceneExtractor()
plain = bpy.data.materials.new("plain")
asking = scene.objects["bumps"].data.materials[0]
scene.objects["bumps"].data.materials[0] = plain
graph.update()
first = extractor.extract(graph, viewport=False, report=Report())
names = {data.name: sorted(data.attributes) for data in first.meshes.values()}
scene.objects["bumps"].material_slots[0].link = 'OBJECT'
scene.objects["bumps"].material_slots[0].material = asking
graph.update()
second = extractor.extract(graph, viewport=False, report=Report())
later = {data.name: sorted(data.attributes) for data in second.meshes.values()}
third = extractor.extract(graph, viewport=False, report=Report())
finish([ours[..., 0].tolist(), cycles[..., 0].tolist(), report[0], names, later, len(third.meshes)])
'''


@pytest.fixture(scope="module")
def results(run_pictures: Callable[..., Any]) -> list:
    """Return both pictures, the report, and the attributes that meshes came with."""
    return run_pictures(CODE)


@pytest.mark.parametrize("half", ["islands", "bumps"])
def test_values_are_those_of_cycles(results: list, half: str) -> None:
    """Show Cycles' numbers, but where pixels show edges, which samples differ about."""
    columns = slice(0, 48) if half == "islands" else slice(48, 96)
    ours, cycles = np.array(results[0])[:, columns], np.array(results[1])[:, columns]
    covered = cycles > 0.01
    assert covered.sum() > 500 and len(np.unique(np.round(cycles[covered], 2))) >= 8
    off = np.abs(ours - cycles)[covered]
    assert np.median(off) < 1e-3 and np.percentile(off, 75) < 0.02, (np.median(off), np.percentile(off, 75))
    assert "Random Per Island" not in results[2] and "Pointiness" not in results[2]


def test_meshes_are_read_again_for_what_is_asked(results: list) -> None:
    """Work out nothing that no material wants, and read those meshes alone again of which one wants more."""
    _, _, _, names, later, third = results
    assert names["bumps"] == [] and names["islands"] == [".island"]
    assert later == {"bumps": [".pointiness"]} and third == 0
