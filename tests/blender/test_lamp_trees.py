# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps whose node trees vary against Cycles: gobos, IES profiles, falloff, textured area lamps and suns.

Pictures are compared by the means of each channel over each quarter, so that a pattern that is turned or mirrored is
found out.
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
import bpy, burnish, numpy as np, mathutils
import OpenImageIO as oiio
from burnish.addon import final

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = 48, 36

def place(data, location, target=None, roll=0.0):
    item = bpy.data.objects.new(data.name, data)
    item.location = location
    if target:
        direction = mathutils.Vector(target) - item.location
        turned = direction.to_track_quat('-Z', 'Y') @ mathutils.Quaternion((0.0, 0.0, 1.0), roll)
        item.rotation_euler = turned.to_euler()
    scene.collection.objects.link(item)
    return item

def surface(name, corners):
    made = bpy.data.materials.new(name)
    node = made.node_tree.nodes["Principled BSDF"]
    node.inputs["Base Color"].default_value = (0.7, 0.7, 0.7, 1.0)
    node.inputs["Specular IOR Level"].default_value = 0.0
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    mesh.materials.append(made)
    return place(mesh, (0.0, 0.0, 0.0))

surface("floor", [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)])
surface("wall", [(-4, 1.5, 0), (4, 1.5, 0), (4, 1.5, 4), (-4, 1.5, 4)])
scene.camera = place(bpy.data.cameras.new("Camera"), (0.3, -4.5, 3.0), (0.0, 0.5, 0.8))

def lamp(kind, energy, location=(0.5, -0.8, 2.6), target=(0.0, 0.5, 0.3), **values):
    light = bpy.data.lights.new("Lamp", kind)
    light.energy = energy
    for key, value in values.items():
        setattr(light, key, value)
    global nodes, links, emission
    nodes, links = light.node_tree.nodes, light.node_tree.links
    emission = next(node for node in nodes if node.bl_idname == "ShaderNodeEmission")
    return place(light, location, target, roll=0.4)

def node(kind, socket=None, source=None, **values):
    made = nodes.new("ShaderNode" + kind)
    for key, value in values.items():
        if key in made.inputs:
            made.inputs[key].default_value = value
        else:
            setattr(made, key, value)
    if source:
        links.new(source, made.inputs[socket])
    return made

def checker(source, scale):
    made = node("TexChecker", "Vector", source, Scale=scale, Color1=(1.0, 0.3, 0.1, 1.0), Color2=(0.05, 0.1, 1.0, 1.0))
    links.new(made.outputs["Color"], emission.inputs["Color"])

def image():
    made = bpy.data.images.new("gobo", 16, 12)
    x, y = np.meshgrid(np.arange(16) / 16, np.arange(12) / 12)
    made.pixels.foreach_set(np.stack([x, y, (x > 0.5) * (y < 0.5), np.ones_like(x)], -1).astype(np.float32).ravel())
    return made

def profile(vertical, horizontal, candela):
    values = [" ".join(f"{candela(h, v):.2f}" for v in vertical) for h in horizontal]
    text = bpy.data.texts.new("profile")
    text.from_string("\n".join([
        "IESNA:LM-63-2002", "TILT=NONE", f"1 1000 1.2 {len(vertical)} {len(horizontal)} 1 2 0 0 0", "0.9 1 50",
        " ".join(map(str, vertical)), " ".join(map(str, horizontal)), *values, ""]))
    made = node("TexIES", mode='INTERNAL')
    made.ies = text
    links.new(made.outputs[0], emission.inputs["Strength"])
'''

SCENES = {
    "spot, checker over its cone": '''
lamp('SPOT', 300.0, spot_size=1.3, shadow_soft_size=0.02)
checker(node("TexCoord").outputs["UV"], 5.0)
''',
    "spot, image through a mapping": '''
lamp('SPOT', 300.0, spot_size=1.3, shadow_soft_size=0.05)
mapping = node("Mapping", "Vector", node("TexCoord").outputs["UV"], Rotation=(0.0, 0.0, 0.6), Scale=(1.3, 0.8, 1.0))
links.new(node("TexImage", "Vector", mapping.outputs[0], image=image()).outputs[0], emission.inputs["Color"])
''',
    "spot that is a sphere, by its normal": '''
lamp('SPOT', 300.0, spot_size=1.5, shadow_soft_size=0.3, use_soft_falloff=False)
checker(node("TexCoord").outputs["Normal"], 3.0)
''',
    "stretched point, IES": '''
lamp('POINT', 4.0, shadow_soft_size=0.05).scale = (1.6, 0.8, 1.0)
profile(range(0, 181, 10), (0, 45, 90, 135, 180),
        lambda h, v: 300.0 + 250.0 * np.cos(np.radians(2.0 * h)) * np.sin(np.radians(v)))
''',
    "area, IES": '''
lamp('AREA', 4.0, size=0.5)
profile(range(0, 91, 10), (0, 90, 180, 270, 360), lambda h, v: 900.0 - 8.0 * v - 1.0 * min(h, 360 - h))
''',
    "area, image and spread": '''
lamp('AREA', 60.0, (0.2, -0.3, 1.2), shape='RECTANGLE', size=1.4, size_y=0.9, spread=1.6)
links.new(node("TexImage", image=image()).outputs[0], emission.inputs["Color"])
''',
    "ellipse, gradient of its parametric coordinate": '''
lamp('AREA', 60.0, (0.2, -0.3, 1.2), shape='ELLIPSE', size=1.4, size_y=0.9)
gradient = node("TexGradient", "Vector", node("NewGeometry").outputs["Parametric"])
links.new(gradient.outputs["Color"], emission.inputs["Color"])
''',
    "sun, by its normal": '''
lamp('SUN', 3.0, angle=0.1)
checker(node("NewGeometry").outputs["Normal"], 1.7)
''',
    "linear falloff of a point": '''
lamp('POINT', 120.0, shadow_soft_size=0.1)
falloff = node("LightFalloff", Strength=0.5)
links.new(falloff.outputs["Linear"], emission.inputs["Strength"])
''',
    "constant falloff, smooth, of a spot with a checker": '''
lamp('SPOT', 120.0, spot_size=1.6, shadow_soft_size=0.05)
falloff = node("LightFalloff", Strength=0.5, Smooth=2.0)
links.new(falloff.outputs["Constant"], emission.inputs["Strength"])
checker(node("TexCoord").outputs["UV"], 4.0)
''',
    "checker seen in a mirror": '''
lamp('AREA', 60.0, (0.2, -1.0, 1.8), (0.0, 1.5, 1.4), size=1.0)
checker(node("TexCoord").outputs["UV"], 3.0)
wall = bpy.data.objects["wall"].data.materials[0].node_tree.nodes["Principled BSDF"]
wall.inputs["Metallic"].default_value, wall.inputs["Roughness"].default_value = 1.0, 0.0
''',
}

MEASURE = r'''
def cycles(samples):
    scene.render.engine = 'CYCLES'
    settings = scene.cycles
    settings.samples, settings.use_denoising, settings.use_adaptive_sampling = samples, False, False
    settings.pixel_filter_type, settings.filter_width = 'BOX', 1.0
    settings.max_bounces = settings.diffuse_bounces = settings.glossy_bounces = 32
    settings.blur_glossy = settings.sample_clamp_indirect = 0.0
    scene.render.image_settings.file_format = 'OPEN_EXR'
    scene.render.image_settings.color_depth = '32'
    scene.render.filepath = f"{folder}/cycles.exr"
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
    return made[0][0]["Combined"][..., :3].astype(np.float64), made[0][1]

def quarters(picture):
    h, w = picture.shape[0] // 2, picture.shape[1] // 2
    return [part.mean((0, 1)).tolist() for rows in (picture[:h], picture[h:]) for part in (rows[:, :w], rows[:, w:])]

traced, report = ours('REFERENCE', 256)
frames, _ = ours('REALTIME', 64)
means = {"cycles": quarters(cycles(256)), "traced": quarters(traced), "frames": quarters(frames)}
'''

RUNNER = r'''
import json
import burnish

burnish.register()
setup, scenes, measure, device = json.loads(sys.argv[1])
results = {}
for name, code in scenes.items():
    names = {"device": device, "folder": sys.argv[2]}
    exec(setup + code + measure, names)
    results[name] = {key: names[key] for key in ("means", "report")}
burnish.unregister()
print("RESULT " + json.dumps(results))
'''


@pytest.fixture(scope="module")
def results(run_python: Callable[..., subprocess.CompletedProcess], device: str,
            tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict]:
    """Return each scene's means by engine, quarter and channel, and its report."""
    chosen = "CPU" if device == "cpu" else "CUDA"
    process = run_python(
        RUNNER, json.dumps([SETUP, SCENES, MEASURE, chosen]), tmp_path_factory.mktemp("lamps"), timeout=TIMEOUT)
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout.rpartition("RESULT ")[2])


@pytest.mark.parametrize("name", SCENES)
def test_light_is_that_of_cycles(results: dict[str, dict], name: str) -> None:
    """Light each quarter of the picture as Cycles does, with both integrators; nothing is named in the report."""
    means = {engine: np.array(parts) for engine, parts in results[name]["means"].items()}
    brightest = means["cycles"].max()
    off = {engine: float(np.abs(means[engine] - means["cycles"]).max() / brightest) for engine in ("traced", "frames")}
    assert off["traced"] < 0.01 and off["frames"] < 0.05, (off, means)
    assert "light" not in results[name]["report"], results[name]["report"]
