# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray visibility of objects and holdouts against Cycles: what each switch of a cube changes on the things about it."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

SWITCHES = ("visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission", "visible_shadow",
            "is_holdout")

CODE = r'''
switches = json.loads(sys.argv[3])
scene = new_scene()
scene.view_layers[0].use_pass_object_index = True
names = []

def material(name, color=(0.7, 0.7, 0.7), **inputs):
    made = bpy.data.materials.new(name)
    node = made.node_tree.nodes["Principled BSDF"]
    node.inputs["Base Color"].default_value = (*color, 1.0)
    for key, value in inputs.items():
        node.inputs[key.replace("_", " ")].default_value = value
    return made

def placed(name, data, location, rotation=(0.0, 0.0, 0.0)):
    item = bpy.data.objects.new(name, data)
    item.location, item.rotation_euler = location, rotation
    scene.collection.objects.link(item)
    names.append(name)
    item.pass_index = len(names)
    return item

def square(name, location, made, size, rotation=(0.0, 0.0, 0.0)):
    mesh, h = bpy.data.meshes.new(name), size / 2
    mesh.from_pydata([(-h, -h, 0), (h, -h, 0), (h, h, 0), (-h, h, 0)], [], [(0, 1, 2, 3)])
    mesh.materials.append(made)
    return placed(name, mesh, location, rotation)

square("floor", (0.0, 0.0, 0.0), material("grey", Specular_IOR_Level=0.0), 5.0)
square("mirror", (-1.3, 1.6, 0.9), material("mirror", Metallic=1.0, Roughness=0.0), 1.8, (1.4, 0.0, 0.5))
square("rough", (1.3, 1.6, 0.9), material("rough", Metallic=1.0, Roughness=0.4), 1.8, (1.4, 0.0, -0.5))
pane = material("glass", (1.0, 1.0, 1.0), Transmission_Weight=1.0, Roughness=0.0, IOR=1.1)
square("pane", (0.55, -0.9, 0.7), pane, 0.9, (1.3, 0.0, 0.0))
bpy.ops.mesh.primitive_cube_add(size=0.7, location=(0.0, 0.2, 0.7))
cube = bpy.context.object
cube.data.materials.append(material("red", (0.9, 0.05, 0.05)))
light = bpy.data.lights.new("key", 'AREA')
light.energy, light.size = 60.0, 0.6
placed("key", light, (0.5, -1.0, 2.5))
scene.world = bpy.data.worlds.new("World")
scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.2, 0.3, 0.5, 1.0)
camera = placed("Camera", bpy.data.cameras.new("Camera"), (0.0, -4.0, 2.4))
camera.rotation_euler = (mathutils.Vector((0.0, 0.3, 0.5)) - camera.location).to_track_quat('-Z', 'Y').to_euler()
scene.camera = camera
scene.render.resolution_x, scene.render.resolution_y = 64, 40
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = 'OPEN_EXR', '32'
settings = scene.cycles
settings.samples, settings.use_adaptive_sampling, settings.use_denoising = 256, False, False
settings.sample_clamp_indirect, settings.blur_glossy, settings.pixel_filter_type = 0, 0, 'BOX'
settings.max_bounces = settings.diffuse_bounces = settings.glossy_bounces = settings.transmission_bounces = 32
scene.burnish.sampling.samples, scene.burnish.sampling.integrator = 192, 'REFERENCE'
scene.burnish.film.pixel_filter, scene.burnish.device = 'BOX', DEVICE

def means():
    made, pictures = [], []
    final.on_finished[:] = [lambda layer, view, pixels, information: made.append(pixels)]
    for engine in ('BURNISH', 'CYCLES'):
        scene.render.engine, scene.render.filepath = engine, f"{FOLDER}/{engine}.exr"
        bpy.ops.render.render(write_still=True)
        pictures.append(np.array(oiio.ImageBuf(scene.render.filepath).get_pixels())[::-1, :, :3])
    index = np.rint(made[0]["Object Index"][..., 0]).astype(int)
    return {name: [picture[index == number + 1].mean(0).tolist() for picture in pictures]
            for number, name in enumerate(names) if (index == number + 1).sum() > 8}

results = {"": means()}
for switch in switches:
    setattr(cube, switch, switch == "is_holdout")
    results[switch] = means()
    setattr(cube, switch, switch != "is_holdout")
finish(results)
'''


@pytest.fixture(scope="module")
def results(run_pictures: Callable[..., Any]) -> dict[str, dict]:
    """Return by switch and object the mean colors of both engines; "" is the scene without any."""
    return run_pictures(CODE, json.dumps(SWITCHES))


@pytest.mark.parametrize("switch", SWITCHES)
def test_switches_change_what_they_change_in_cycles(results: dict[str, dict], switch: str) -> None:
    """Change the light on every object by as much as Cycles does, and any object's enough to see."""
    largest = 0.0
    for name in results[switch]:
        ours, cycles = np.subtract(results[switch][name], results[""][name])
        assert np.abs(ours - cycles).max() < 0.008, (name, ours, cycles)
        largest = max(largest, float(np.abs(cycles).max()))
    assert largest > 0.004, (switch, largest)
