# SPDX-License-Identifier: GPL-3.0-or-later
"""Light and shadow linking against Cycles: what reaches each object of small scenes, by both integrators.

Objects are told apart by their pass index; means are over the pixels whose neighbours show the same object.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable

import numpy as np
import pytest

pytestmark = pytest.mark.slow

TIMEOUT = 1200.0
"""The first run may have to build all kernels"""

SETUP = r'''
import json
import bpy, burnish, numpy as np, mathutils
import OpenImageIO as oiio
from burnish.addon import final

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = 64, 40
scene.view_layers[0].use_pass_object_index = True
indices = {}

def material(name, color=(0.7, 0.7, 0.7), **inputs):
    made = bpy.data.materials.new(name)
    node = made.node_tree.nodes["Principled BSDF"]
    node.inputs["Base Color"].default_value = (*color, 1.0)
    node.inputs["Specular IOR Level"].default_value = 0.0
    for key, value in inputs.items():
        node.inputs[key.replace("_", " ")].default_value = value
    return made

def place(name, data, location, rotation=(0.0, 0.0, 0.0), collection=None):
    item = bpy.data.objects.new(name, data)
    item.location, item.rotation_euler = location, rotation
    (collection or scene.collection).objects.link(item)
    indices[name] = item.pass_index = len(indices) + 1
    return item

def square(name, location, made, size=1.6, rotation=(0.0, 0.0, 0.0), collection=None):
    mesh, h = bpy.data.meshes.new(name), size / 2
    mesh.from_pydata([(-h, -h, 0), (h, -h, 0), (h, h, 0), (-h, h, 0)], [], [(0, 1, 2, 3)])
    mesh.materials.append(made)
    return place(name, mesh, location, rotation, collection)

def lamp(name, kind, color, energy, location, rotation=(0.0, 0.0, 0.0), collection=None, **values):
    light = bpy.data.lights.new(name, kind)
    light.color, light.energy = color, energy
    for key, value in values.items():
        setattr(light, key, value)
    return place(name, light, location, rotation, collection)

def collect(name, include=(), exclude=()):
    """Make a collection of objects and collections that are included or excluded."""
    made = bpy.data.collections.new(name)
    for state, things in (('INCLUDE', include), ('EXCLUDE', exclude)):
        for thing in things:
            is_object = isinstance(thing, bpy.types.Object)
            (made.objects if is_object else made.children).link(thing)
            of = made.objects if is_object else made.children
            settings = made.collection_objects if is_object else made.collection_children
            settings[list(of).index(thing)].light_linking.link_state = state
    return made

def only(item, *include, exclude=()):
    item.light_linking.receiver_collection = collect("for " + item.name, include, exclude)

def shaded(item, *include, exclude=()):
    item.light_linking.blocker_collection = collect("shadows of " + item.name, include, exclude)

def look(location, target):
    camera = place("Camera", bpy.data.cameras.new("Camera"), location)
    direction = mathutils.Vector(target) - camera.location
    camera.rotation_euler = direction.to_track_quat('-Z', 'Y').to_euler()
    scene.camera = camera
'''

PLANES = r'''
grey = material("grey")
left, right = square("left", (-0.9, 0.0, 0.0), grey), square("right", (0.9, 0.0, 0.0), grey)
back = square("back", (0.0, 1.0, 0.8), grey, size=3.4, rotation=(1.5708, 0.0, 0.0))
red = lamp("red", 'POINT', (1.0, 0.1, 0.0), 60.0, (-0.3, -0.4, 1.6), shadow_soft_size=0.2)
green = lamp("green", 'AREA', (0.0, 1.0, 0.1), 40.0, (0.3, -0.4, 1.6), size=0.5)
look((0.0, -4.0, 3.2), (0.0, 0.2, 0.3))
'''

SCENES = {
    "two lamps": PLANES + r'''
only(red, left)
only(green, right)
''',
    "lamps that are instances, spot and sun": PLANES + r'''
lit = bpy.data.collections.new("lit")
sun = lamp("sun", 'SUN', (0.2, 0.2, 1.0), 1.0, (0.0, 0.0, 3.0), rotation=(0.3, 0.2, 0.0), angle=0.1)
spot = lamp("spot", 'SPOT', (1.0, 1.0, 1.0), 80.0, (0.0, 0.0, 2.0), collection=lit, spot_size=1.8)
holder = place("holder", None, (0.3, -0.3, 0.0))
holder.instance_type, holder.instance_collection = 'COLLECTION', lit
only(sun, back, left)
only(spot, right)
only(red, left)
only(green, back)
''',
    "exclude": PLANES + r'''
only(red, exclude=(left,))
only(green, collect("most", include=(left, back)), exclude=(back,))
''',
    "empty and child collections": PLANES + r'''
# The states within a child count for nothing: it is included as a whole.
inner = collect("inner", include=(left,), exclude=(right,))
outer = collect("outer", exclude=(inner,))
only(red, outer)
# A child's state counts for all that it holds; the object's own, which comes later, overrules it.
only(green, right, exclude=(collect("all", include=(left, right, back)),))
white = lamp("white", 'POINT', (0.0, 0.0, 1.0), 10.0, (0.0, -0.6, 1.2), shadow_soft_size=0.1)
only(white)
''',
    "instances": r'''
grey = material("grey")
inside = bpy.data.collections.new("inside")
leaf = square("leaf", (0.0, 0.0, 0.0), grey, size=1.2, collection=inside)
def holder(name, x):
    item = place(name, None, (x, 0.0, 0.0))
    item.instance_type, item.instance_collection = 'COLLECTION', inside
    return item
first, second, third = holder("first", -1.4), holder("second", 0.0), holder("third", 1.4)
red = lamp("red", 'POINT', (1.0, 0.1, 0.0), 60.0, (-0.3, -0.4, 1.6), shadow_soft_size=0.2)
green = lamp("green", 'AREA', (0.0, 1.0, 0.1), 40.0, (0.3, -0.4, 1.6), size=0.5)
only(red, first, leaf)
only(green, exclude=(second,))
look((0.0, -4.0, 3.2), (0.0, 0.2, 0.0))
for item in (first, second, third):
    item.pass_index = 0
leaf.pass_index = 1
indices = {"leaf": 1}
''',
    "emissive mesh": r'''
scene.cycles.max_bounces = 32
kinds = {"diffuse": material("diffuse"), "rough": material("rough", Metallic=1.0, Roughness=0.35),
         "mirror": material("mirror", Metallic=1.0, Roughness=0.0)}
shown = {}
for i, (kind, made) in enumerate(kinds.items()):
    for j, group in enumerate(("lit", "unlit")):
        shown[kind, group] = square(f"{kind} {group}", (1.3 * (i - 1), 1.3 * j - 1.0, 0.0), made, size=1.2)
glow = material("glow", Emission_Color=(1.0, 0.6, 0.2, 1.0), Emission_Strength=4.0)
panel = square("panel", (0.0, 1.3, 1.6), glow, size=3.0, rotation=(2.0, 0.0, 0.0))
lamp("fill", 'POINT', (0.3, 0.3, 1.0), 30.0, (0.0, -2.0, 2.5), shadow_soft_size=0.5)
only(panel, *(item for (_, group), item in shown.items() if group == "lit"))
look((0.0, -4.0, 2.6), (0.0, 0.1, 0.4))
''',
    "lamps in mirrors and through glass": r'''
scene.cycles.max_bounces = 32
for item in ("caustics_reflective", "caustics_refractive"):
    setattr(scene.cycles, item, True)
mirror = material("mirror", Metallic=1.0, Roughness=0.05)
rough = material("rough", Metallic=1.0, Roughness=0.3)
glass = material("glass", (1.0, 1.0, 1.0), Transmission_Weight=1.0, Roughness=0.1, IOR=1.3)
items = [square(f"{name} {group}", (1.3 * i - 1.3, 1.3 * j - 1.0, 0.0), made, size=1.2)
         for j, group in enumerate(("lit", "unlit")) for i, (name, made) in enumerate(
             (("rough", rough), ("mirror", mirror), ("glass", glass)))]
area = lamp("area", 'AREA', (1.0, 0.8, 0.3), 60.0, (0.0, 1.6, 2.0), size=2.4)
area.rotation_euler = (mathutils.Vector((0.0, -1.2, -0.8))).to_track_quat('-Z', 'Y').to_euler()
under = lamp("under", 'AREA', (0.2, 0.4, 1.0), 20.0, (1.3, 0.3, -1.5), rotation=(3.1416, 0.0, 0.0), size=3.0)
for light in (area, under):
    only(light, *items[:3])
look((0.0, -4.0, 2.6), (0.0, 0.1, 0.2))
''',
    # No light of these is for some objects alone: Cycles then counts that of area lamps with such shadows twice.
    "shadows of some objects": r'''
grey, dark = material("grey"), material("dark", (0.05, 0.05, 0.05))
floor = square("floor", (0.0, 0.0, 0.0), grey, size=4.0)
bars = [square(f"bar {i}", (0.8 * i - 0.8, 0.2, 0.5), dark, size=0.5, rotation=(0.3, 0.2, 0.4 * i)) for i in range(3)]
red = lamp("red", 'POINT', (1.0, 0.1, 0.0), 60.0, (-0.3, -0.4, 2.0), shadow_soft_size=0.2)
green = lamp("green", 'AREA', (0.0, 1.0, 0.1), 40.0, (0.5, -0.4, 2.0), size=0.5)
sun = lamp("sun", 'SUN', (0.1, 0.1, 1.0), 1.0, (0.0, 0.0, 3.0), rotation=(0.3, 0.2, 0.0), angle=0.1)
shaded(red, bars[0], bars[1])
shaded(green, exclude=(bars[1],))
shaded(sun, collect("all bars", include=bars), exclude=(bars[0],))
look((0.0, -4.0, 3.2), (0.0, 0.2, 0.3))
''',
    "shadows of an emissive mesh, and glossy floors": r'''
dark = material("dark", (0.05, 0.05, 0.05))
rough, plain = material("rough", Metallic=1.0, Roughness=0.35), material("plain")
left, right = square("left", (-1.0, 0.0, 0.0), rough, size=1.9), square("right", (1.0, 0.0, 0.0), plain, size=1.9)
bars = [square(f"bar {i}", (1.4 * i - 0.7, 0.3, 0.6), dark, size=0.7, rotation=(0.9, 0.0, 0.0)) for i in range(2)]
glow = material("glow", Emission_Color=(1.0, 0.6, 0.2, 1.0), Emission_Strength=4.0)
panel = square("panel", (0.0, 1.6, 1.4), glow, size=2.6, rotation=(1.9, 0.0, 0.0))
area = lamp("area", 'AREA', (0.2, 0.4, 1.0), 40.0, (0.0, 1.4, 2.2), rotation=(-0.6, 0.0, 0.0), size=1.0)
shaded(panel, bars[0])
look((0.0, -4.0, 2.6), (0.0, 0.1, 0.2))
''',
}

MEASURE = r'''
def inner(index):
    """Return which pixels have neighbours of the same index all around."""
    same, (height, width) = np.zeros(index.shape, bool), index.shape
    same[1:-1, 1:-1] = np.logical_and.reduce([
        index[1 + y:height - 1 + y, 1 + x:width - 1 + x] == index[1:-1, 1:-1] for y in (-1, 0, 1) for x in (-1, 0, 1)])
    return same

def cycles(samples):
    scene.render.engine = 'CYCLES'
    settings = scene.cycles
    settings.samples, settings.use_adaptive_sampling, settings.use_denoising = samples, False, False
    settings.sample_clamp_indirect, settings.blur_glossy, settings.pixel_filter_type = 0, 0, 'BOX'
    settings.max_bounces = settings.diffuse_bounces = settings.glossy_bounces = settings.transmission_bounces = 32
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = 'OPEN_EXR', '32'
    scene.render.filepath = folder + "/cycles.exr"
    bpy.ops.render.render(write_still=True)
    return oiio.ImageInput.open(scene.render.filepath).read_image()[::-1, :, :3].astype(np.float64)

def ours(integrator, samples):
    scene.render.engine = 'BURNISH'
    settings = scene.burnish
    settings.device = device
    settings.sampling.integrator, settings.sampling.samples = integrator, samples
    settings.film.pixel_filter, settings.denoiser.path_traced_rest = 'BOX', False
    made = []
    final.on_finished[:] = [lambda layer, view, pixels, information: made.append((pixels, information.report.text()))]
    bpy.ops.render.render()
    return made[0]

pixels, report = ours('REFERENCE', 256)
index = np.rint(pixels["Object Index"][..., 0]).astype(int)
frames, frame_report = ours('REALTIME', 64)
pictures = {"cycles": cycles(512), "traced": pixels["Combined"][..., :3].astype(np.float64),
            "frames": frames["Combined"][..., :3].astype(np.float64)}
if len(indices) == 1:
    index = index * (1 + np.arange(index.shape[1]) * 3 // index.shape[1])
    indices = {"first": 1, "second": 2, "third": 3}
whole = inner(index)
masks = {key: whole & (index == number) for key, number in indices.items()}
means = {key: {engine: picture[mask].mean(0).tolist() for engine, picture in pictures.items()}
         for key, mask in masks.items() if mask.sum() >= 6}
np.savez(f"{folder}/{name.replace(' ', '_')}.npz", **pictures)
'''

RUNNER = r'''
import json
import burnish

burnish.register()
setup, scenes, measure, device = json.loads(sys.argv[1])
results = {}
for name, code in scenes.items():
    names = {"device": device, "folder": sys.argv[2], "name": name}
    exec(setup + code + measure, names)
    results[name] = {key: names[key] for key in ("means", "report", "frame_report")}
burnish.unregister()
print("RESULT " + json.dumps(results))
'''


@pytest.fixture(scope="module")
def results(run_python: Callable[..., subprocess.CompletedProcess], device: str,
            tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict]:
    """Return each scene's means by object and engine, and its reports."""
    folder = tmp_path_factory.mktemp("linking")
    chosen = "CPU" if device == "cpu" else "CUDA"
    process = run_python(RUNNER, json.dumps([SETUP, SCENES, MEASURE, chosen]), folder, timeout=TIMEOUT)
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout.rpartition("RESULT ")[2])


def differences(means: dict[str, dict[str, list[float]]], engine: str) -> dict[str, float]:
    """Return by object how far an engine's mean is from Cycles': of the brightest channel of any object a share."""
    brightest = max(max(each["cycles"]) for each in means.values())
    return {key: float(np.abs(np.subtract(each[engine], each["cycles"])).max()) / brightest
            for key, each in means.items()}


@pytest.mark.parametrize("name", SCENES)
def test_path_traced_light_is_that_of_cycles(results: dict[str, dict], name: str) -> None:
    """Light each object as Cycles does, with the reference integrator."""
    means = results[name]["means"]
    assert len(means) >= 3
    off = differences(means, "traced")
    assert max(off.values()) < 0.01, (off, means)
    assert "link" not in results[name]["report"], results[name]["report"]


@pytest.mark.parametrize("name", SCENES)
def test_frames_light_what_cycles_lights(results: dict[str, dict], name: str) -> None:
    """Light each object about as Cycles does in real-time frames alone."""
    means = results[name]["means"]
    off = differences(means, "frames")
    assert max(off.values()) < 0.05, (off, means)
