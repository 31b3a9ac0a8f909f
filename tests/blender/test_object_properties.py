# SPDX-License-Identifier: GPL-3.0-or-later
"""Attribute nodes' properties of objects, instancers and view layers, and Particle Info, against Cycles."""

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
layer = scene.view_layers[0]
ASKED = [('OBJECT', "color", "Color"), ('OBJECT', "color", "Alpha"), ('OBJECT', "color", "Fac"),
         ('OBJECT', "pass_index", "Fac"), ('OBJECT', "number", "Color"), ('OBJECT', "whole", "Fac"),
         ('OBJECT', "flag", "Color"), ('OBJECT', "three", "Vector"), ('OBJECT', "four", "Alpha"),
         ('OBJECT', "two", "Color"), ('OBJECT', "text", "Color"), ('OBJECT', "ofmesh", "Color"),
         ('OBJECT', "nobody", "Color"), ('OBJECT', "number", "Alpha"), ('OBJECT', "nobody", "Alpha"),
         ('OBJECT', "scale", "Color"), ('OBJECT', '["three"]', "Color"), ('OBJECT', "five", "Color"),
         ('OBJECT', "ints", "Color"), ('OBJECT', "show_bounds", "Color"), ('INSTANCER', "number", "Color"),
         ('INSTANCER', "color", "Color"), ('INSTANCER', "onlyholder", "Fac"), ('INSTANCER', "tint", "Color"),
         ('OBJECT', "tint", "Color"),
         ('VIEW_LAYER', "layered", "Color"), ('VIEW_LAYER', "ofscene", "Color"), ('VIEW_LAYER', "samples", "Fac"),
         ('VIEW_LAYER', "ofworld", "Color"), ('VIEW_LAYER', "nobody", "Alpha"), ('VIEW_LAYER', "frame_current", "Fac")]
scene.world = bpy.data.worlds.new("World")
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs[1].default_value = 0.0
layer["layered"], scene["ofscene"], scene.world["ofworld"], scene["layered"] = 0.4, [0.1, 0.2, 0.3], 0.7, 0.9

def shining(kind, name, output):
    made = bpy.data.materials.new(f"{kind} {name} {output}")
    tree = made.node_tree
    tree.nodes.clear()
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_type, node.attribute_name = kind, name
    emission, out = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(node.outputs[output], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], out.inputs["Surface"])
    return made

def square(name, made):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    mesh.materials.append(made)
    mesh["ofmesh"] = [0.2, 0.3, 0.9]
    item = bpy.data.objects.new(name, mesh)
    item.color, item.pass_index = (0.2, 0.4, 0.6, 0.3), 2
    item["number"], item["whole"], item["flag"], item["text"] = 0.25, 3, True, "words"
    item["two"], item["three"], item["four"] = [0.5, 0.1], [0.3, 0.6, 0.9], [0.1, 0.2, 0.3, 0.4]
    item["five"], item["ints"] = [0.1, 0.2, 0.3, 0.4, 0.5], [1, 2, 3]
    item.scale = (0.9, 0.8, 0.7)
    return item

def geometry_nodes(item, source):
    """Put three instances of an object on the points of another, which geometry nodes tint."""
    group = bpy.data.node_groups.new("points", 'GeometryNodeTree')
    group.interface.new_socket("Geometry", in_out='INPUT', socket_type='NodeSocketGeometry')
    group.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    make = group.nodes.new
    start, end, place = make("NodeGroupInput"), make("NodeGroupOutput"), make("GeometryNodeInstanceOnPoints")
    info, store = make("GeometryNodeObjectInfo"), make("GeometryNodeStoreNamedAttribute")
    random = make("FunctionNodeRandomValue")
    random.data_type, store.data_type, store.domain = 'FLOAT_VECTOR', 'FLOAT_COLOR', 'INSTANCE'
    info.inputs["Object"].default_value, info.inputs["As Instance"].default_value = source, True
    store.inputs["Name"].default_value = "tint"
    for a, b in ((start.outputs[0], place.inputs["Points"]), (info.outputs["Geometry"], place.inputs["Instance"]),
                 (place.outputs[0], store.inputs["Geometry"]), (random.outputs[0], store.inputs["Value"]),
                 (store.outputs[0], end.inputs[0])):
        group.links.new(a, b)
    item.modifiers.new("points", 'NODES').node_group = group

for number, asked in enumerate(ASKED):
    item = square("square", shining(*asked))
    item.location = (1.0 * (number % 8), 1.0 * (number // 8), 0.0)
    scene.collection.objects.link(item)
# Row 4: instances of a collection; row 5: those of geometry nodes.
for number, asked in enumerate([('INSTANCER', "number", "Color"), ('INSTANCER', "color", "Color"),
                                ('INSTANCER', "onlyholder", "Fac"), ('OBJECT', "number", "Color"),
                                ('INSTANCER', "ofmesh", "Color"), ('OBJECT', "onlyholder", "Color")]):
    inside = bpy.data.collections.new("inside")
    inside.objects.link(square("inner", shining(*asked)))
    holder = bpy.data.objects.new("holder", None)
    holder["number"], holder["onlyholder"], holder.color = 0.6, 0.35, (0.9, 0.1, 0.5, 1.0)
    holder.instance_type, holder.instance_collection = 'COLLECTION', inside
    holder.location = (number, 4.0, 0.0)
    scene.collection.objects.link(holder)
for column, kind in ((0, 'INSTANCER'), (4, 'OBJECT')):
    points = bpy.data.meshes.new("points")
    points.from_pydata([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [], [])
    item = bpy.data.objects.new("points", points)
    item["tint"] = 0.15
    item.location = (column, 5.0, 0.0)
    scene.collection.objects.link(item)
    geometry_nodes(item, square("source", shining(kind, "tint", "Color")))

look_down(scene, (4.0, 3.0, 5.0), 8.0)
(ours, report), (cycles, _) = (picture(scene, engine, (80, 60), 4) for engine in ('BURNISH', 'CYCLES'))
# The middle of each square; picture rows count from below.
def cells(values):
    values = values[::-1, :, :3]
    return [values[10 * row + 3:10 * row + 6, 10 * column + 3:10 * column + 6].mean((0, 1)).tolist()
            for row in range(6) for column in range(8)]

# What an update brings along.
graph, extractor = bpy.context.evaluated_depsgraph_get(), SceneExtractor()
extractor.extract(graph, viewport=False, report=Report())
same = extractor.extract(graph, viewport=False, report=Report())
scene.objects["square"].color = (1.0, 1.0, 1.0, 1.0)
scene["ofscene"] = [0.5, 0.5, 0.5]
scene.update_tag()
graph.update()
other = extractor.extract(graph, viewport=False, report=Report())
facts = {"same": same.instances is None and not same.materials, "table": other.instances is not None,
         "materials": [data.name for data in other.materials.values()]}
finish([cells(ours), cells(cycles), report[0], facts, len(ASKED)])
'''


@pytest.fixture(scope="module")
def results(run_pictures: Callable[..., Any]) -> list:
    """Return what both engines show in each cell, the report, and what updates brought."""
    return run_pictures(CODE)


def test_properties_are_those_of_cycles(results: list) -> None:
    """Show every property as Cycles does, of objects, instances and the view layer."""
    ours, cycles = np.array(results[0]), np.array(results[1])
    off = np.abs(ours - cycles).max(1)
    assert off.max() < 1e-3, [(int(cell), ours[cell], cycles[cell]) for cell in np.flatnonzero(off >= 1e-3)]
    # Most of them say something.
    assert (cycles.max(1) > 0.05).sum() >= 25


def test_nothing_is_said_of_them(results: list) -> None:
    """Name no property in the report: all are read."""
    assert "property" not in results[2], results[2]


def test_updates_bring_what_changed(results: list) -> None:
    """Send the table anew where an object's property changed, and a view layer's materials where its own did."""
    assert results[3] == {"same": True, "table": True, "materials": ["VIEW_LAYER ofscene Color"]}


PARTICLES = r'''
scene = new_scene()
OUTPUTS = ("Index", "Random", "Age", "Lifetime", "Location", "Size", "Velocity", "Angular Velocity")

def square(name, x, size):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-size, -size, 0), (size, -size, 0), (size, size, 0), (-size, size, 0)], [], [(0, 1, 2, 3)])
    item = bpy.data.objects.new(name, mesh)
    item.location.x = x
    scene.collection.objects.link(item)
    return item

for column, output in enumerate(OUTPUTS):
    made = bpy.data.materials.new(output)
    tree = made.node_tree
    tree.nodes.clear()
    node, emission = tree.nodes.new("ShaderNodeParticleInfo"), tree.nodes.new("ShaderNodeEmission")
    tree.links.new(node.outputs[output], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    shown = square("shown", 0.0, 1.0)
    shown.data.materials.append(made)
    shown.hide_render = True
    emitter = square("emitter", 1.0 * column, 0.3)
    emitter.show_instancer_for_render = False
    emitter.modifiers.new("particles", 'PARTICLE_SYSTEM')
    settings = emitter.particle_systems[0].settings
    settings.count, settings.frame_start, settings.frame_end, settings.lifetime = 6, 1, 5, 40
    settings.lifetime_random, settings.size_random, settings.particle_size = 0.4, 0.5, 0.15
    settings.render_type, settings.instance_object = 'OBJECT', shown
    settings.normal_factor, settings.factor_random = 0.05, 0.1
    settings.effector_weights.gravity = 0.0
look_down(scene, (3.5, 0.0, 5.0), 8.4)
for frame in range(1, 11):
    scene.frame_set(frame)
finish([picture(scene, engine, (160, 24), 16)[0][..., :3].tolist() for engine in ('BURNISH', 'CYCLES')])
'''


def test_particle_info_is_that_of_cycles(run_pictures: Callable[..., Any]) -> None:
    """Show what Particle Info tells of the particles that made squares as Cycles does, but where edges are."""
    # This engine shows no negative light.
    ours, cycles = np.maximum(np.array(run_pictures(PARTICLES)), 0.0)
    columns = 160 / 8.4
    for number in range(8):
        part = slice(int(columns * (number + 0.2)), int(columns * (number + 1.2)))
        there = cycles[:, part].max(-1) > 1e-4
        # None of these turns.
        assert there.sum() > 30 or number in (7,), (number, there.sum())
        off = np.abs(ours - cycles)[:, part].max(-1) / max(cycles[:, part].max(), 1e-3)
        assert np.median(off[there]) < 1e-3 if there.any() else off.max() < 1e-3, (number, np.median(off[there]))
