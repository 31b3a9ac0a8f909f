# SPDX-License-Identifier: GPL-3.0-or-later
"""What the scenes are made of that scripts for measuring make in Blender."""

from __future__ import annotations

from pathlib import Path

import bpy
from mathutils import Vector


def surface(color: tuple[float, float, float], roughness: float = 0.5, metallic: float = 0.0) -> bpy.types.Material:
    """Return a plain material."""
    made = bpy.data.materials.new("surface")
    node = made.node_tree.nodes["Principled BSDF"]
    node.inputs["Base Color"].default_value = (*color, 1.0)
    node.inputs["Roughness"].default_value, node.inputs["Metallic"].default_value = roughness, metallic
    return made


def add(data: bpy.types.ID, place: tuple, target: tuple) -> bpy.types.Object:
    """Add an object that looks at a place."""
    made = bpy.data.objects.new(data.name, data)
    bpy.context.scene.collection.objects.link(made)
    made.location = place
    made.rotation_euler = (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    return made


def finish(path: Path, world: tuple, camera: tuple, target: tuple, lens: float) -> None:
    """Add world and camera, and save."""
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("world")
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (*world, 1.0)
    scene.camera = add(bpy.data.cameras.new("camera"), camera, target)
    scene.camera.data.lens = lens
    scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
    bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()))
