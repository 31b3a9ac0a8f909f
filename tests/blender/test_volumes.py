# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes against Cycles: bodies of several media, with and without a surface; what is read and said of them."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable

import numpy as np
import pytest

from tests.exr_passes import read_passes

NAMES = ("Combined", "Volume Direct", "Volume Indirect")
PIXELS = 16
"""Sides of a body's part of the picture"""
TIMEOUT = 600.0
"""The first run may have to build all kernels"""

GLASS = "BsdfGlass"
CASES = {
    "absorption": (None, [("VolumeAbsorption", {"Color": [0.9, 0.3, 0.1, 1.0], "Density": 0.7})]),
    "glass": (GLASS, [("VolumeAbsorption", {"Color": [0.9, 0.3, 0.1, 1.0], "Density": 0.7})]),
    "back": (None, [("VolumeScatter", {"Color": [0.9, 0.6, 0.3, 1.0], "Density": 2.0, "Anisotropy": -0.5})]),
    "forward": (None, [("VolumeScatter", {"Color": [0.9, 0.6, 0.3, 1.0], "Density": 5.0, "Anisotropy": 0.8})]),
    "principled": (None, [("VolumePrincipled", {
        "Color": [0.8, 0.5, 0.3, 1.0], "Density": 2.0, "Anisotropy": 0.3, "Absorption Color": [0.1, 0.4, 0.8, 1.0],
        "Emission Strength": 0.1, "Emission Color": [0.1, 0.3, 1.0, 1.0]})]),
    "coefficients": (None, [("VolumeCoefficients", {
        "Absorption Coefficients": [0.1, 0.5, 1.0], "Scatter Coefficients": [1.5, 1.0, 0.5],
        "Emission Coefficients": [0.0, 0.1, 0.2], "Anisotropy": 0.2})]),
    "fire": (None, [("VolumePrincipled", {"Density": 0.3, "Blackbody Intensity": 1.0, "Temperature": 1400.0,
                                          "Blackbody Tint": [1.0, 0.8, 0.6, 1.0]})]),
    "two": (None, [("VolumeScatter", {"Color": [0.9, 0.6, 0.3, 1.0], "Density": 1.0, "Anisotropy": 0.7}),
                   ("VolumeScatter", {"Color": [0.2, 0.5, 0.9, 1.0], "Density": 1.0, "Anisotropy": -0.7}),
                   ("Emission", {"Color": [0.1, 0.2, 0.3, 1.0]})]),
}

BUILD = """
import json
import bpy
import burnish

def fill(tree, output, surface, media):
    def node(kind, inputs):
        made = tree.nodes.new("ShaderNode" + kind)
        for name, value in inputs.items():
            made.inputs[name].default_value = value
        return made

    if surface:
        tree.links.new(node(surface, {"Roughness": 0.0, "IOR": 1.2}).outputs[0], output.inputs["Surface"])
    total = None
    for kind, inputs in media:
        made = node(kind, inputs)
        if total is not None:
            add = tree.nodes.new("ShaderNodeAddShader")
            tree.links.new(total.outputs[0], add.inputs[0])
            tree.links.new(made.outputs[0], add.inputs[1])
            made = add
        total = made
    tree.links.new(total.outputs[0], output.inputs["Volume"])

def material(surface, media):
    made = bpy.data.materials.new("material")
    made.node_tree.nodes.clear()
    fill(made.node_tree, made.node_tree.nodes.new("ShaderNodeOutputMaterial"), surface, media)
    return made

burnish.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("World")
"""

RENDER = BUILD + """
cases, pixels, folder = json.loads(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.3, 0.3, 1.0)
for i, (surface, media) in enumerate(cases):
    bpy.ops.mesh.primitive_cube_add(location=(3.0 * i, 0.0, 0.0), rotation=(0.2, 0.3, 0.4))
    bpy.context.object.data.materials.append(material(surface, media))
bpy.ops.object.light_add(type='SUN', rotation=(0.6, -0.7, 0.0))
bpy.context.object.data.energy = 3.0
bpy.ops.object.camera_add(location=(1.5 * (len(cases) - 1), 0.0, 50.0))
scene.camera = bpy.context.object
scene.camera.data.type, scene.camera.data.ortho_scale = 'ORTHO', 3.0 * len(cases)
render = scene.render
render.resolution_x, render.resolution_y = pixels * len(cases), pixels
render.image_settings.media_type = 'MULTI_LAYER_IMAGE'
render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR_MULTILAYER', '32'
cycles_layer = bpy.context.view_layer.cycles
cycles_layer.use_pass_volume_direct = cycles_layer.use_pass_volume_indirect = True
sampling = scene.burnish.sampling
sampling.integrator, sampling.samples = 'REFERENCE', 256
settings = scene.cycles
settings.samples, settings.use_adaptive_sampling, settings.use_denoising = 256, False, False
settings.sample_clamp_indirect, settings.blur_glossy, settings.pixel_filter_type = 0.0, 0.0, 'BOX'
for name in ("max", "diffuse", "transmission", "transparent_max", "volume"):
    setattr(settings, f"{name}_bounces", 64)
for name in ("BURNISH", "CYCLES"):
    render.engine = name
    render.filepath = f"{folder}/{name}.exr"
    bpy.ops.render.render(write_still=True)
burnish.unregister()
"""

READ = BUILD + """
from burnish.addon.extract.material import extract_material, extract_world
from burnish.engine.report import Report

def told(made):
    report = Report()
    data = (extract_world if isinstance(made, bpy.types.World) else extract_material)(made, None, report)
    medium = data.medium
    coefficients = None if not medium else {
        "varying": medium.varying is not None, "extinction": medium.extinction, "emission": medium.emission,
        "phases": [[each.scattering, each.anisotropy] for each in medium.phases]}
    return {"text": report.text(), "transparency": getattr(data, "has_transparency", None), "medium": coefficients}

def linked(kind, socket, name):
    made = material(None, [(kind, {"Color": (1.0, 1.0, 1.0, 1.0)})])
    tree = made.node_tree
    volume = next(node for node in tree.nodes if node.bl_idname == "ShaderNode" + kind)
    texture = tree.nodes.new("ShaderNode" + name)
    tree.links.new(texture.outputs[0], volume.inputs[socket])
    return made

found = {}
scatter = ("VolumeScatter", {"Color": (0.5, 1.0, 2.0, 1.0), "Density": 2.0})
plain = material(None, [scatter])
found["scatter"] = told(plain)
for phase in ("RAYLEIGH", "DRAINE", "FOURNIER_FORAND", "MIE"):
    plain.node_tree.nodes["Volume Scatter"].phase = phase
    found[phase] = told(plain)
found["noise"] = told(linked("VolumeScatter", "Density", "TexNoise"))
found["glass"] = told(material("BsdfGlass", [scatter]))
found["surface in a volume"] = told(material(None, [("BsdfDiffuse", {})]))
mixed = material(None, [scatter])
tree = mixed.node_tree
mix = tree.nodes.new("ShaderNodeMixShader")
mix.inputs[0].default_value = 0.25
output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
tree.links.new(output.inputs["Volume"].links[0].from_socket, mix.inputs[1])
tree.links.new(mix.outputs[0], output.inputs["Volume"])
found["mixed"] = told(mixed)
world = scene.world
fill(world.node_tree, world.node_tree.nodes["World Output"], None, [scatter])
found["world"] = told(world)
print("FOUND" + json.dumps(found))
burnish.unregister()
"""


@pytest.fixture(scope="module")
def means(
    run_python: Callable[..., subprocess.CompletedProcess], tmp_path_factory: pytest.TempPathFactory,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the passes of Burnish and of Cycles, means of each body's part: [cases, 3] each."""
    folder = tmp_path_factory.mktemp("volumes")
    result = run_python(RENDER, json.dumps(list(CASES.values())), str(PIXELS), folder, timeout=TIMEOUT)
    assert result.returncode == 0 and "Traceback" not in result.stderr, result.stdout + result.stderr
    found = []
    for name in ("BURNISH", "CYCLES"):
        passes = read_passes(folder / f"{name}.exr", NAMES)
        found.append({each: pixels.reshape(PIXELS, len(CASES), PIXELS, 3).mean((0, 2), dtype=np.float64)
                      for each, pixels in passes.items()})
    return found[0], found[1]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_volumes_are_those_of_cycles(means, case: str) -> None:
    """Match each channel of each body; a percent is noise."""
    mine, cycles = (each["Combined"][list(CASES).index(case)] for each in means)
    assert cycles.min() > 0.02
    # Blue of black bodies is below nothing in Rec.709: Cycles takes it from the light of others.
    np.testing.assert_allclose(mine, cycles, rtol=0.02, atol=0.005 if case == "fire" else 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES[1:])
def test_passes_are_those_of_cycles(means, name: str) -> None:
    """Have the light that a medium has scattered first, direct where it has met nothing else."""
    mine, cycles = (each[name] for each in means)
    assert cycles.max() > 0.1
    np.testing.assert_allclose(mine, cycles, rtol=0.05, atol=0.002)


@pytest.fixture(scope="module")
def found(run_python: Callable[..., subprocess.CompletedProcess]) -> dict:
    """Return what is read of some materials and a world, and what is said of them."""
    result = run_python(READ, timeout=TIMEOUT)
    assert result.returncode == 0 and "Traceback" not in result.stderr, result.stdout + result.stderr
    return json.loads(result.stdout.split("FOUND")[1].splitlines()[0])


def test_media_are_read(found: dict) -> None:
    """Read coefficients of materials and worlds, and make a boundary without a surface transparent."""
    for name, share in (("scatter", 1.0), ("glass", 1.0), ("mixed", 0.75), ("world", 1.0)):
        medium = found[name]["medium"]
        assert medium["extinction"] == pytest.approx([share, 2.0 * share, 4.0 * share])
        assert medium["phases"] == [[medium["extinction"], 0.0]] and not any(medium["emission"])
        assert "volume" not in found[name]["text"]
    assert found["scatter"]["transparency"] and not found["glass"]["transparency"]


def test_what_is_approximated_is_named(found: dict) -> None:
    """Name other phase functions and shaders of surfaces; trees that vary have programs and an estimate of the mean."""
    for name in ("RAYLEIGH", "DRAINE"):
        assert f"phase function {name}" in found[name]["text"] and found[name]["medium"]["phases"][0][1] == 0.0
    g, back = found["FOURNIER_FORAND"]["medium"]["phases"][0][1], np.linspace(-1.0, 0.0, 2001)
    # The node sends a tenth back.
    assert np.mean(0.5 * (1.0 - g * g) / (1.0 + g * g - 2.0 * g * back) ** 1.5) == pytest.approx(0.1, rel=1e-3)
    first, second = found["MIE"]["medium"]["phases"]
    assert first[1] > 0.99 and 0.3 < second[1] < 0.9
    noise = found["noise"]
    assert "volume" not in noise["text"] and noise["medium"]["varying"] and not found["scatter"]["medium"]["varying"]
    assert noise["medium"]["extinction"] == pytest.approx([0.5] * 3)
    assert "does not fill a volume" in found["surface in a volume"]["text"]
