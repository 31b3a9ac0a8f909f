# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattering below surfaces against Cycles: bodies of several colours, radii and methods, path-traced, and passes."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable

import numpy as np
import pytest

from tests.exr_passes import read_passes

pytestmark = pytest.mark.slow

PIXELS = 16
"""Sides of a body's part of the picture"""
NAMES = ("Combined", "Diffuse Direct", "Diffuse Indirect", "Diffuse Color", "Glossy Direct", "Glossy Indirect",
         "Glossy Color")
TIMEOUT = 600.0
"""The first run may have to build all kernels"""

PRINCIPLED = {"Subsurface Weight": 1.0, "Subsurface Radius": [1.0, 0.5, 0.25], "Base Color": [0.8, 0.5, 0.3]}
CASES = {
    "near": ("RANDOM_WALK", "ball", PRINCIPLED | {"Subsurface Scale": 0.02, "Specular IOR Level": 0.0}),
    "far": ("RANDOM_WALK", "ball", PRINCIPLED | {"Subsurface Scale": 0.5, "Roughness": 0.7}),
    "slab": ("RANDOM_WALK", "slab", PRINCIPLED | {"Subsurface Scale": 0.2, "Specular IOR Level": 0.0}),
    "half": ("RANDOM_WALK", "ball", PRINCIPLED | {"Subsurface Scale": 0.2, "Subsurface Weight": 0.5, "Roughness": 0.7}),
    "skin": ("RANDOM_WALK_SKIN", "ball", PRINCIPLED | {"Subsurface Scale": 0.3, "Specular IOR Level": 0.0}),
    "forward": ("RANDOM_WALK_SKIN", "slab", PRINCIPLED | {"Subsurface Scale": 0.3, "Subsurface Anisotropy": 0.8}),
    "node": ("RANDOM_WALK", "ball", {"Color": [0.3, 0.5, 0.8], "Scale": 0.3, "Radius": [1.0, 0.5, 0.25]}),
    "white": ("RANDOM_WALK", "ball", PRINCIPLED | {"Subsurface Scale": 2.0, "Base Color": [1.0, 1.0, 1.0]}),
}

SCENE = """
import json
import bpy
import burnish

cases, names, pixels, folder = json.loads(sys.argv[1]), json.loads(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
burnish.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("World")
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.3, 0.3, 1.0)
for i, (method, body, inputs) in enumerate(cases):
    material = bpy.data.materials.new("material")
    tree = material.node_tree
    tree.nodes.clear()
    kind, field = ("SubsurfaceScattering", "falloff") if "Scale" in inputs else ("BsdfPrincipled", "subsurface_method")
    node = tree.nodes.new("ShaderNode" + kind)
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    setattr(node, field, method)
    for name, value in inputs.items():
        socket = node.inputs[name]
        socket.default_value = [*value, 1.0][:len(socket.default_value)] if isinstance(value, list) else value
    if body == "ball":
        bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, location=(3.0 * i, 0.0, 0.0))
        bpy.ops.object.shade_smooth()
    else:
        bpy.ops.mesh.primitive_cube_add(location=(3.0 * i, 0.0, 0.0), scale=(1.0, 1.0, 0.1))
    bpy.context.object.data.materials.append(material)
bpy.ops.object.light_add(type='SUN', rotation=(0.6, -0.7, 0.0))
bpy.context.object.data.energy = 3.0
bpy.ops.object.camera_add(location=(1.5 * (len(cases) - 1), 0.0, 50.0))
scene.camera = bpy.context.object
scene.camera.data.type, scene.camera.data.ortho_scale = 'ORTHO', 3.0 * len(cases)
render = scene.render
render.resolution_x, render.resolution_y, render.film_transparent = pixels * len(cases), pixels, True
render.image_settings.media_type = 'MULTI_LAYER_IMAGE'
render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR_MULTILAYER', '32'
layer = bpy.context.view_layer
for lobe in ("diffuse", "glossy"):
    for part in ("direct", "indirect", "color"):
        setattr(layer, f"use_pass_{lobe}_{part}", True)
burnish_settings = scene.burnish.sampling
burnish_settings.integrator, burnish_settings.samples = 'REFERENCE', 256
settings = scene.cycles
settings.samples, settings.use_adaptive_sampling, settings.use_denoising = 256, False, False
settings.sample_clamp_indirect, settings.blur_glossy, settings.pixel_filter_type = 0.0, 0.0, 'BOX'
settings.max_bounces = settings.diffuse_bounces = settings.glossy_bounces = 32
for name in ("BURNISH", "CYCLES"):
    render.engine = name
    render.filepath = f"{folder}/{name}.exr"
    bpy.ops.render.render(write_still=True)
burnish.unregister()
"""


@pytest.fixture(scope="module")
def means(
    run_python: Callable[..., subprocess.CompletedProcess], tmp_path_factory: pytest.TempPathFactory,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the passes of Burnish and of Cycles, means of each body's part: [cases, 3] each."""
    folder = tmp_path_factory.mktemp("subsurface")
    result = run_python(
        SCENE, json.dumps(list(CASES.values())), json.dumps(NAMES), str(PIXELS), folder, timeout=TIMEOUT)
    assert result.returncode == 0 and "Traceback" not in result.stderr, result.stdout + result.stderr
    found = []
    for name in ("BURNISH", "CYCLES"):
        passes = read_passes(folder / f"{name}.exr", NAMES)
        for lobe in ("Diffuse", "Glossy"):
            for part in ("Direct", "Indirect"):
                passes[f"{lobe} {part}"] = passes[f"{lobe} {part}"] * passes[f"{lobe} Color"]
        found.append({name: pixels.reshape(PIXELS, len(CASES), PIXELS, 3).mean((0, 2), dtype=np.float64)
                      for name, pixels in passes.items()})
    return found[0], found[1]


@pytest.mark.parametrize("case", CASES)
def test_bodies_are_those_of_cycles(means, case: str) -> None:
    """Match each channel of each body; some percent are noise."""
    mine, cycles = (each["Combined"][list(CASES).index(case)] for each in means)
    assert cycles.min() > 0.02
    np.testing.assert_allclose(mine, cycles, rtol=0.03)


@pytest.mark.parametrize("name", NAMES[1:])
def test_passes_are_those_of_cycles(means, name: str) -> None:
    """Count light that has been below a surface as diffuse, direct where it has met no other."""
    mine, cycles = (each[name] for each in means)
    np.testing.assert_allclose(mine, cycles, rtol=0.05, atol=0.001)
