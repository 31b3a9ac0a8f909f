# SPDX-License-Identifier: GPL-3.0-or-later
"""Depths of the Light Path node and the Wireframe node against Cycles: a floor that shines with them, in mirrors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

CODE = r'''
scene = new_scene()

def simple(name, shader, **values):
    made = bpy.data.materials.new(name)
    tree = made.node_tree
    tree.nodes.clear()
    node = tree.nodes.new(shader)
    for key, value in values.items():
        node.inputs[key].default_value = value
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return made

def square(name, made, location, size, rotation=(0.0, 0.0, 0.0), steps=1):
    line = np.linspace(-size / 2, size / 2, steps + 1)
    count = steps + 1
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(x, y, 0.0) for x in line for y in line], [], [
        (i * count + j, (i + 1) * count + j, (i + 1) * count + j + 1, i * count + j + 1)
        for i in range(steps) for j in range(steps)])
    mesh.materials.append(made)
    item = bpy.data.objects.new(name, mesh)
    item.location, item.rotation_euler = location, rotation
    scene.collection.objects.link(item)
    return item

floor = simple("floor", "ShaderNodeEmission")
floor.cycles.emission_sampling = 'NONE'
tree = floor.node_tree
path, edges, color = (tree.nodes.new(kind) for kind in (
    "ShaderNodeLightPath", "ShaderNodeWireframe", "ShaderNodeCombineColor"))
edges.inputs["Size"].default_value = 0.12
scale = [tree.nodes.new("ShaderNodeMath") for _ in range(2)]
for node, output in zip(scale, ("Glossy Depth", "Transmission Depth")):
    node.operation = 'MULTIPLY'
    node.inputs[1].default_value = 0.2
    tree.links.new(path.outputs[output], node.inputs[0])
for value, channel in ((scale[0], "Red"), (scale[1], "Green"), (edges, "Blue")):
    tree.links.new(value.outputs[0], color.inputs[channel])
tree.links.new(color.outputs[0], tree.nodes["Emission"].inputs["Color"])
square("floor", floor, (0.0, 0.0, 0.0), 8.0, steps=5)
mirror = simple("mirror", "ShaderNodeBsdfGlossy", Color=(1.0, 1.0, 1.0, 1.0), Roughness=0.0)
square("far", mirror, (0.0, 2.0, 1.0), 2.6, (1.75, 0.0, 0.0))
square("side", mirror, (1.5, 0.8, 1.0), 2.2, (0.0, 1.85, 0.0))
pane = simple("pane", "ShaderNodeBsdfRefraction", Color=(1.0, 1.0, 1.0, 1.0), Roughness=0.0, IOR=1.05)
square("pane", pane, (-1.6, -0.4, 0.5), 1.4)
square("second pane", pane, (-1.3, -0.2, 0.9), 0.9)

add_camera(scene, (0.0, -6.0, 2.2), (0.0, 0.6, 0.7))
finish([picture(scene, engine, (96, 60), 16)[0][..., :3].tolist() for engine in ('BURNISH', 'CYCLES')])
'''


@pytest.fixture(scope="module")
def pictures(run_pictures: Callable[..., Any]) -> np.ndarray:
    """Return this engine's picture and Cycles': [2, h, w, 3]."""
    return np.array(run_pictures(CODE))


@pytest.mark.parametrize(("channel", "values"), [(0, (0.2, 0.4)), (1, (0.2, 0.4))], ids=["glossy", "transmission"])
def test_depths_are_counted_by_kind(pictures: np.ndarray, channel: int, values: tuple[float, ...]) -> None:
    """Count reflections and refractions each for itself, as Cycles does."""
    ours, cycles = pictures[..., channel]
    assert np.percentile(np.abs(ours - cycles), 90) < 0.01 and abs(ours.mean() - cycles.mean()) < 0.002
    for value in values:
        there = np.abs(cycles - value) < 1e-3
        assert there.sum() > 12, (value, there.sum())
        assert (np.abs(ours - value) < 1e-3)[there].mean() > 0.9


def test_lines_are_those_of_cycles(pictures: np.ndarray) -> None:
    """Draw the triangles' edges as wide as Cycles does."""
    ours, cycles = pictures[..., 2]
    assert 0.02 < cycles.mean() < 0.5 and abs(ours.mean() / cycles.mean() - 1.0) < 0.01
    assert np.abs(ours - cycles).mean() < 0.02
