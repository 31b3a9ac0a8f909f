# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's passes of light against Cycles' own, of one small scene with all kinds of lobes and lights."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable

import numpy as np
import pytest

from tests.exr_passes import read_passes

SIZE = 72, 48
TIMEOUT = 600.0
"""The first run may have to build all kernels"""

LOBES = ("Diffuse", "Glossy", "Transmission")
NAMES = ("Combined", "Emission", "Environment", *(f"{lobe} {part}" for lobe in LOBES
                                                  for part in ("Direct", "Indirect", "Color")))
GROUPS = ("Combined_lamps", "Combined_sun", "Combined_glow", "Combined_sky")

SCENE = """
import json
import bpy, numpy as np
import burnish
from burnish.addon import final

names, size, folder = json.loads(sys.argv[1]), json.loads(sys.argv[2]), sys.argv[3]
burnish.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = size
scene.world = bpy.data.worlds.new("World")
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.4, 0.3, 1.0)

def principled(**inputs):
    made = bpy.data.materials.new("material")
    node = made.node_tree.nodes["Principled BSDF"]
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = (*value, 1.0) if isinstance(value, tuple) else value
    bpy.context.object.data.materials.append(made)

bpy.ops.mesh.primitive_plane_add(size=5.0)
principled(Base_Color=(0.8, 0.4, 0.2), Roughness=0.3)
for i, inputs in enumerate((
        dict(Base_Color=(0.9, 0.7, 0.3), Metallic=1.0, Roughness=0.2),
        dict(Transmission_Weight=1.0, Roughness=0.0),
        dict(Base_Color=(0.5, 0.9, 0.8), Transmission_Weight=1.0, Roughness=0.4),
        dict(Base_Color=(0.3, 0.1, 0.5), Sheen_Weight=0.8, Coat_Weight=0.6, Coat_Roughness=0.2),
        dict(Base_Color=(0.3, 0.6, 0.5), Transmission_Weight=0.5, Roughness=0.3, Metallic=0.2),
        dict(Base_Color=(0.5, 0.5, 0.5), Emission_Color=(3.0, 2.0, 1.0), Emission_Strength=1.0))):
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.45, segments=32, ring_count=16,
                                         location=(i % 3 - 1.0, i // 3 - 0.5, 0.47))
    bpy.ops.object.shade_smooth()
    principled(**inputs)
bpy.context.object.lightgroup = "glow"
bpy.ops.mesh.primitive_plane_add(size=1.0, location=(-1.5, -1.2, 0.5), rotation=(1.2, 0.0, 0.3))
leaf = bpy.data.materials.new("leaf")
leaf.node_tree.nodes.clear()
node = leaf.node_tree.nodes.new("ShaderNodeBsdfTranslucent")
node.inputs[0].default_value = (0.2, 0.7, 0.1, 1.0)
leaf.node_tree.links.new(node.outputs[0], leaf.node_tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
bpy.context.object.data.materials.append(leaf)
bpy.ops.mesh.primitive_plane_add(size=1.2, location=(0.2, -1.6, 0.6), rotation=(1.5, 0.0, 0.0))
principled(Base_Color=(0.7, 0.2, 0.2), Alpha=0.4)
bpy.ops.mesh.primitive_plane_add(size=1.0, location=(1.3, -1.0, 0.6), rotation=(1.4, 0.0, 0.0))
principled(Base_Color=(0.8, 0.9, 1.0), Transmission_Weight=1.0, Roughness=0.2)
bpy.ops.object.light_add(type='AREA', location=(0.5, 0.2, 2.5))
bpy.context.object.data.energy, bpy.context.object.data.size = 60.0, 0.6
bpy.context.object.lightgroup = "lamps"
bpy.ops.object.light_add(type='POINT', location=(-1.5, -1.0, 1.5))
bpy.context.object.data.energy, bpy.context.object.data.shadow_soft_size = 40.0, 0.1
bpy.context.object.lightgroup = "lamps"
bpy.ops.object.light_add(type='SUN', rotation=(0.6, 0.4, 0.0))
bpy.context.object.data.energy, bpy.context.object.data.angle = 1.0, 0.05
bpy.context.object.lightgroup, scene.world.lightgroup = "sun", "sky"
bpy.ops.object.camera_add(location=(0.0, -4.6, 2.4), rotation=(1.15, 0.0, 0.0))
scene.camera = bpy.context.object
layer = scene.view_layers[0]
for name in names[1:]:
    setattr(layer, f"use_pass_{name.lower().replace(' ', '_').replace('emission', 'emit')}", True)
for name in ("lamps", "sun", "glow", "sky"):
    layer.lightgroups.add().name = name
settings = scene.burnish
settings.device, settings.sampling.integrator, settings.sampling.samples = 'CPU', 'REFERENCE', 96
settings.film.pixel_filter, settings.film.exposure = 'BOX', 1.5
settings.light_paths.clamp_indirect = scene.cycles.sample_clamp_indirect = 2.0
cycles = scene.cycles
cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = 192, False, False
cycles.pixel_filter_type, cycles.film_exposure, cycles.blur_glossy = 'BOX', 1.5, 0.0
for name in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
    setattr(cycles, f"{name}_bounces", 32)
image = scene.render.image_settings
image.media_type = 'MULTI_LAYER_IMAGE'
image.file_format, image.color_depth = 'OPEN_EXR_MULTILAYER', '32'
for name in ("BURNISH", "CYCLES"):
    scene.render.engine = name
    scene.render.filepath = f"{folder}/{name}.exr"
    bpy.ops.render.render(write_still=True)
burnish.unregister()
"""


@pytest.fixture(scope="module")
def pictures(
    run_python: Callable[..., subprocess.CompletedProcess], tmp_path_factory: pytest.TempPathFactory,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the passes that Burnish and Cycles write to files."""
    folder = tmp_path_factory.mktemp("passes")
    result = run_python(SCENE, json.dumps(NAMES), json.dumps(SIZE), folder, timeout=TIMEOUT)
    assert result.returncode == 0 and "Traceback" not in result.stderr, result.stdout + result.stderr
    names = (*NAMES, *GROUPS)
    return read_passes(folder / "BURNISH.exr", names), read_passes(folder / "CYCLES.exr", names)


def test_passes_make_up_the_picture(pictures) -> None:
    """Get Combined within rounding from the passes in the file."""
    mine = pictures[0]
    total = mine["Emission"] + mine["Environment"]
    for lobe in LOBES:
        total = total + (mine[f"{lobe} Direct"] + mine[f"{lobe} Indirect"]) * mine[f"{lobe} Color"]
    np.testing.assert_allclose(total, mine["Combined"], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(sum(mine[name] for name in GROUPS), mine["Combined"], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", (*NAMES, *GROUPS))
def test_passes_are_those_of_cycles(pictures, name: str) -> None:
    """Match Cycles on the whole and in most blocks of 8 x 8 pixels, light by what it adds to the picture."""
    mine, cycles = (each[name] for each in pictures)
    lobe, _, part = name.partition(" ")
    if part in ("Direct", "Indirect"):
        mine, cycles = (each[name] * each[f"{lobe} Color"] for each in pictures)
    assert cycles.mean() > 0.001
    # Emission, the world and colours have no noise but the filter's; light has most in caustics.
    exact = part == "Color" or name in ("Emission", "Environment")
    np.testing.assert_allclose(mine.mean((0, 1)), cycles.mean((0, 1)), rtol=0.01 if exact else 0.06)
    width, height = SIZE
    a, b = (picture.reshape(height // 8, 8, width // 8, 8, 3).mean((1, 3)) for picture in (mine, cycles))
    off = np.abs(a - b) / (np.maximum(a, b) + 0.05)
    assert np.percentile(off, 90) < (0.04 if exact else 0.2), np.percentile(off, (50, 75, 90, 95))
    assert np.median(off) < 0.04
