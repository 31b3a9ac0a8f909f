# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extraction tests' scripts use in the child process: an empty scene and ways to fill and extract it."""

from __future__ import annotations

import json
import warnings

import bpy
import numpy as np
from burnish.addon.extract.scene import ExtractionCancelled, SceneExtractor
from burnish.engine.report import Report
from burnish.engine.scene import Visibility

__all__ = ["ExtractionCancelled", "Report", "SceneExtractor", "Viewport", "Visibility", "bpy", "extract_all", "finish",
           "instance_grid", "link", "material", "names", "node_group", "np", "quad_mesh"]

warnings.simplefilter("ignore", DeprecationWarning)
bpy.ops.wm.read_factory_settings(use_empty=True)


def link(name, data, collection=None):
    """Make an object in the scene."""
    item = bpy.data.objects.new(name, data)
    (collection or bpy.context.scene.collection).objects.link(item)
    return item


def quad_mesh(name, size=1.0):
    """Make a square of two triangles."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (size, 0, 0), (size, size, 0), (0, size, 0)], [], [(0, 1, 2, 3)])
    return mesh


def material(name):
    """Make a material with a Principled BSDF."""
    result = bpy.data.materials.new(name)
    result.use_nodes = True
    return result


def node_group(name):
    """Make an empty geometry node group with its output node; returns (group, output node)."""
    group = bpy.data.node_groups.new(name, 'GeometryNodeTree')
    group.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    return group, group.nodes.new('NodeGroupOutput')


def instance_grid(name, count):
    """Make an object whose geometry nodes put cubes on a grid of count x count points."""
    group, output = node_group(name)
    grid, cube, place = (group.nodes.new(kind) for kind in (
        'GeometryNodeMeshGrid', 'GeometryNodeMeshCube', 'GeometryNodeInstanceOnPoints'))
    grid.inputs['Vertices X'].default_value = grid.inputs['Vertices Y'].default_value = count
    group.links.new(grid.outputs[0], place.inputs['Points'])
    group.links.new(cube.outputs[0], place.inputs['Instance'])
    group.links.new(place.outputs[0], output.inputs[0])
    item = link(name, bpy.data.meshes.new(name))
    item.modifiers.new("nodes", 'NODES').node_group = group
    return item


def extract_all(extractor=None, **options):
    """Extract as a final render does; returns (delta, report, extractor)."""
    extractor = extractor or SceneExtractor()
    report = Report()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return extractor.extract(depsgraph, viewport=False, report=report, **options), report, extractor


class Viewport:
    """Extracts whenever Blender evaluates the scene, as a viewport's view_update does."""

    def __init__(self):
        """Start listening."""
        self.extractor, self.delta, self.report = SceneExtractor(), None, None
        bpy.app.handlers.depsgraph_update_post.append(self.update)

    def update(self, scene, depsgraph):
        """Extract; called by Blender."""
        self.report = Report()
        self.delta = self.extractor.extract(depsgraph, viewport=True, report=self.report)

    def after(self, action):
        """Do something, let Blender evaluate it, and return what was sent, as a dict."""
        self.delta = None
        action()
        bpy.context.view_layer.update()
        delta = self.delta
        if delta is None:
            return None
        return {"full": delta.full, "meshes": len(delta.meshes), "instances": delta.instances is not None,
                "materials": len(delta.materials), "lights": delta.lights is not None,
                "world": delta.world is not None, "walked": self.extractor.counts.instances}


def names(table):
    """Return the object name of each instance."""
    return [table.object_names[index] for index in table.object_name_index]


def finish(**result):
    """Hand the result to the test."""
    print("RESULT " + json.dumps(result))
