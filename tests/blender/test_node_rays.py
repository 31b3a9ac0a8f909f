# SPDX-License-Identifier: GPL-3.0-or-later
"""The nodes Ambient Occlusion and Bevel against Cycles: things that shine with what they say, and are lit by it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

CODE = r'''
scene = new_scene()

def material(name, kind, shader, **values):
    """Return a material whose shader's colour, or normal for diffuse, is a node's output."""
    made = bpy.data.materials.new(name)
    made.cycles.emission_sampling = 'NONE'
    tree = made.node_tree
    tree.nodes.clear()
    node = tree.nodes.new(kind)
    for key, value in values.items():
        if key[0].islower():
            setattr(node, key, value)
        else:
            node.inputs[key].default_value = value
    surface = tree.nodes.new(shader)
    out = node.outputs[0]
    if kind == "ShaderNodeBevel" and shader == "ShaderNodeEmission":
        scale = tree.nodes.new("ShaderNodeVectorMath")
        scale.operation = 'MULTIPLY_ADD'
        scale.inputs[1].default_value = scale.inputs[2].default_value = (0.5, 0.5, 0.5)
        tree.links.new(out, scale.inputs[0])
        out = scale.outputs[0]
    tree.links.new(out, surface.inputs["Normal" if shader == "ShaderNodeBsdfDiffuse" else "Color"])
    tree.links.new(surface.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return made

def box(name, made, location, size, rotation=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0), smooth=False):
    bpy.ops.mesh.primitive_cube_add(size=size, location=location, rotation=rotation)
    item = bpy.context.object
    item.name, item.scale = name, scale
    item.data.materials.append(made)
    if smooth:
        item.data.shade_smooth()
    return item

ao, glow, matte, bevel = ("ShaderNodeAmbientOcclusion", "ShaderNodeEmission", "ShaderNodeBsdfDiffuse",
                          "ShaderNodeBevel")
plain = bpy.data.materials.new("plain")
clear = bpy.data.materials.new("clear")
# Black, so that light that goes to and fro within does not count: Cycles ends paths earlier.
for name, value in (("Alpha", 0.5), ("Base Color", (0.0, 0.0, 0.0, 1.0)), ("Specular IOR Level", 0.0)):
    clear.node_tree.nodes["Principled BSDF"].inputs[name].default_value = value
MAKE
add_camera(scene, (0.0, -7.0, 5.0), (0.0, 0.0, 0.3))
world = bpy.data.worlds.new("world")
scene.world = world
world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.25, 0.3, 1.0)
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", 'SUN'))
sun.rotation_euler, sun.data.energy = (0.6, 0.4, 0.0), 0.4
scene.collection.objects.link(sun)
scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = 64
finish([picture(scene, engine, (80, 50), samples, integrator)[0][..., :3].tolist()
        for engine, samples, integrator in (('BURNISH', *SAMPLES), ('CYCLES', 64, 'REFERENCE'))])
'''

OCCLUSION = {
    "plain": "ao, glow, Distance=1.5, Color=(1.0, 0.5, 0.25, 1.0), samples=4",
    "inside": "ao, glow, Distance=0.6, inside=True, samples=4",
    "local": "ao, glow, Distance=1.5, only_local=True, samples=4",
    "local inside": "ao, glow, Distance=0.5, only_local=True, inside=True, samples=4",
}

BOXES = '''
made = material("made", ARGUMENTS)
box("floor", made, (0.0, 0.0, -0.5), 1.0, scale=(8.0, 8.0, 1.0))
box("left", made, (-2.0, 0.0, 0.6), 1.2, (0.0, 0.0, 0.5))
box("right", made, (1.2, 0.3, 0.5), 1.0, (0.3, 0.4, 0.5), (1.0, 2.0, 0.6))
box("mirrored", made, (2.6, -0.6, 0.5), 1.0, (0.0, 0.3, 0.8), (-1.0, 0.7, 1.0))
box("smooth", made, (-0.4, 0.8, 0.5), 1.0, (0.0, 0.0, 0.3), smooth=True)
box("pane", clear, (0.2, -1.2, 0.45), 0.8)
hidden = box("seen by the camera alone", plain, (-2.0, -1.6, 0.4), 0.8)
hidden.visible_shadow = False
box("ordinary", plain, (2.0, 1.5, 0.4), 0.8).visible_glossy = False
'''


def script(arguments: str, samples: int, integrator: str) -> str:
    """Return a script of boxes whose material is made with some arguments."""
    return CODE.replace("MAKE", BOXES.replace("ARGUMENTS", arguments)).replace("SAMPLES", repr((samples, integrator)))


def means(pictures: np.ndarray) -> np.ndarray:
    """Return the differences of the engines' means over blocks of 10 x 10 pixels: [5, 8, 3]."""
    blocks = pictures.reshape(2, 5, 10, 8, 10, 3).mean((2, 4))
    return blocks[0] - blocks[1]


@pytest.mark.parametrize("name", OCCLUSION)
def test_occlusion_is_that_of_cycles(run_pictures: Callable[..., Any], name: str) -> None:
    """Show how much is occluded, everywhere as Cycles does."""
    pictures = np.array(run_pictures(script(OCCLUSION[name], 64, "REFERENCE")))
    differences = means(pictures)
    assert np.abs(differences).max() < 0.02, np.abs(differences).max()
    assert np.abs(pictures[0].mean((0, 1)) - pictures[1].mean((0, 1))).max() < 0.003, pictures.mean((1, 2))


@pytest.mark.parametrize("arguments", ["bevel, glow, Radius=0.25, samples=8", "bevel, matte, Radius=0.2, samples=4"])
def test_bevels_are_those_of_cycles(run_pictures: Callable[..., Any], arguments: str) -> None:
    """Round edges of boxes, turned, stretched, mirrored and smooth ones, as Cycles does."""
    pictures = np.array(run_pictures(script(arguments, 64, "REFERENCE")))
    differences = means(pictures)
    assert np.abs(differences).max() < 0.02, np.abs(differences).max()
    assert np.abs(pictures[0].mean((0, 1)) - pictures[1].mean((0, 1))).max() < 0.003, pictures.mean((1, 2))


@pytest.mark.parametrize("arguments", [OCCLUSION["plain"], "bevel, glow, Radius=0.25, samples=8"])
def test_frames_have_both(run_pictures: Callable[..., Any], arguments: str) -> None:
    """Send rays from what the camera sees in real-time frames, too."""
    pictures = np.array(run_pictures(script(arguments, 7, "REALTIME")))
    assert np.abs(np.median(pictures[0] - pictures[1], (0, 1))).max() < 0.01
    assert np.abs(means(pictures)).mean() < 0.015, np.abs(means(pictures)).mean()
    # Plain boxes are lit by surfaces of which nothing is occluded there.
    assert np.abs(pictures[0].mean((0, 1)) - pictures[1].mean((0, 1))).max() < 0.02, pictures.mean((1, 2))
