# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramic cameras: pictures and passes against Cycles' of the same scene, for every type of panorama."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

TIMEOUT = 600.0
"""The first run may have to build all kernels"""

OBLONG = 1.7 if sys.version_info >= (3, 13) else 1.0
"""Blender 5.0, which runs on Python 3.11, fails to write several layers of pixels that are not square"""

CASES: dict[str, dict] = {
    "equirectangular": {"panorama_type": "EQUIRECTANGULAR"},
    "range and shift": {
        "panorama_type": "EQUIRECTANGULAR", "latitude_min": -0.6, "latitude_max": 1.0, "longitude_min": -1.0,
        "longitude_max": 2.0, "shift_x": 0.1, "shift_y": -0.05},
    "cube face": {"panorama_type": "EQUIANGULAR_CUBEMAP_FACE"},
    "mirror ball": {"panorama_type": "MIRRORBALL"},
    "equidistant": {"panorama_type": "FISHEYE_EQUIDISTANT", "fisheye_fov": 3.6},
    "equisolid": {"panorama_type": "FISHEYE_EQUISOLID", "fisheye_fov": 2.8, "fisheye_lens": 8.0},
    "tall": {"panorama_type": "FISHEYE_EQUISOLID", "fisheye_fov": 2.8, "fisheye_lens": 8.0, "size": (40, 80),
             "shift_x": 0.1, "shift_y": 0.07},
    "vertical fit": {"panorama_type": "FISHEYE_EQUISOLID", "fisheye_fov": 2.8, "fisheye_lens": 8.0,
                     "sensor_fit": "VERTICAL", "aspect": OBLONG},
    "polynomial": {"panorama_type": "FISHEYE_LENS_POLYNOMIAL", "fisheye_fov": 2.6, "fisheye_polynomial_k1": -0.1,
                   "fisheye_polynomial_k3": -1e-4},
    "cylinder": {
        "panorama_type": "CENTRAL_CYLINDRICAL", "central_cylindrical_range_u_min": -2.5,
        "central_cylindrical_range_u_max": 2.0, "central_cylindrical_range_v_min": -0.7,
        "central_cylindrical_range_v_max": 1.1, "central_cylindrical_radius": 1.3},
    "lens": {"panorama_type": "EQUIRECTANGULAR", "lens_open": True},
    "mirror ball's lens": {"panorama_type": "MIRRORBALL", "lens_open": True},
    "clipped": {"panorama_type": "EQUIRECTANGULAR", "clip_start": 3.2, "clip_end": 4.6},
}
REALTIME = ("equirectangular", "equidistant")
"""Cases drawn with the real-time integrator too"""

SCRIPT = """
import json, math
import bpy, burnish
import addon_utils
from burnish.addon import report

cases, realtime, folder = json.loads(sys.argv[1]), json.loads(sys.argv[2]), sys.argv[3]
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable("cycles")
burnish.register()
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("World")
scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.4, 0.45, 0.5, 1.0)


def shining(color, output=""):
    made = bpy.data.materials.new("Shining")
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    emission = nodes.new("ShaderNodeEmission")
    emission.inputs[0].default_value = (*color, 1.0)
    if output:
        positive = nodes.new("ShaderNodeVectorMath")
        positive.operation = 'ABSOLUTE'
        links.new(nodes.new("ShaderNodeCameraData").outputs[output], positive.inputs[0])
        links.new(positive.outputs[0], emission.inputs[0])
    links.new(emission.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs[0])
    bpy.context.object.data.materials.append(made)


bpy.ops.mesh.primitive_plane_add(size=40.0, location=(0.0, 0.0, -1.0))
chalk = bpy.data.materials.new("Chalk")
chalk.node_tree.nodes.clear()
chalk.node_tree.links.new(chalk.node_tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0],
                          chalk.node_tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
bpy.context.object.data.materials.append(chalk)
boxes = (((0, 5, 0.3), (1, 0.1, 0.1), ""), ((4, 2, 0), (0.1, 1, 0.1), "View Vector"), ((-4, 1, 0.5), (0.1, 0.1, 1), ""),
         ((1.5, -4, 0), (1, 1, 0.1), ""), ((0.4, 1, 4), (1, 0.1, 1), ""), ((-2, 4, -0.5), (0.1, 1, 1), "View Z Depth"))
for number, (place, color, output) in enumerate(boxes):
    bpy.ops.mesh.primitive_cube_add(size=1.2, location=place, rotation=(0.2 * number, 0.3 * number, 0.5))
    shining(color, output)
bpy.ops.object.camera_add(location=(0.2, -0.3, 0.4), rotation=(1.45, 0.1, 0.15))
camera = scene.camera = bpy.context.object
data = camera.data
data.type = 'PANO'
box = bpy.data.objects["Cube"]
for frame, x in ((0, -0.4), (1, 0.0), (2, 0.3)):
    box.location.x, camera.location.y = x, -0.3 + 0.1 * frame
    box.keyframe_insert("location", frame=frame)
    camera.keyframe_insert("location", frame=frame)
scene.frame_set(1)
layer = scene.view_layers[0]
for name in ("z", "position", "mist", "vector", "ambient_occlusion", "diffuse_color", "diffuse_direct"):
    setattr(layer, f"use_pass_{name}", True)
settings = scene.render.image_settings
settings.media_type = 'MULTI_LAYER_IMAGE'
settings.file_format, settings.color_depth = 'OPEN_EXR_MULTILAYER', '32'
scene.burnish.device, scene.burnish.sampling.samples = 'CPU', 64
scene.cycles.device, scene.cycles.samples = 'CPU', 256
scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
plain = {"size": (80, 40), "aspect": 1.0, "lens_open": False, "shift_x": 0.0, "shift_y": 0.0, "sensor_fit": "AUTO",
         "clip_start": 0.1, "clip_end": 1000.0, "latitude_min": -0.5 * math.pi, "latitude_max": 0.5 * math.pi,
         "longitude_min": -math.pi, "longitude_max": math.pi}
dof = data.dof
dof.focus_distance, dof.aperture_fstop, dof.aperture_blades = 2.0, 0.06, 3
dof.aperture_rotation, dof.aperture_ratio = 0.4, 1.6
for number, (name, case) in enumerate(cases.items()):
    case = {**plain, **case}
    scene.render.resolution_x, scene.render.resolution_y = case.pop("size")
    scene.render.pixel_aspect_x, dof.use_dof = case.pop("aspect"), case.pop("lens_open")
    for field, value in case.items():
        setattr(data, field, value)
    engines = [("cycles", 'CYCLES', 'REFERENCE'), ("reference", 'BURNISH', 'REFERENCE')]
    for label, engine, integrator in engines + [("realtime", 'BURNISH', 'REALTIME')] * (name in realtime):
        scene.render.engine, scene.burnish.sampling.integrator = engine, integrator
        scene.render.filepath = f"{folder}/{label} {number}.exr"
        bpy.ops.render.render(write_still=True)
        if label == "realtime":
            print("REPORT", report.published("Render").text())
burnish.unregister()
"""


def read(path: Path) -> dict[str, np.ndarray]:
    """Return all channels of all parts of a file as float32 [h, w, channels], by pass."""
    parts, file, number = {}, oiio.ImageInput.open(str(path)), 0
    while file.seek_subimage(number, 0):
        spec = file.spec()
        pixels = file.read_image(number, 0, 0, spec.nchannels, oiio.FLOAT)
        for index, name in enumerate(spec.channelnames):
            parts.setdefault(name.split(".")[-2], []).append(pixels[..., index])
        number += 1
    file.close()
    return {name: np.stack(channels, -1) for name, channels in parts.items()}


@pytest.fixture(scope="module")
def pictures(run_python: Callable[..., subprocess.CompletedProcess], tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Return the passes by engine and case, and the text that was printed."""
    folder = tmp_path_factory.mktemp("panoramas")
    result = run_python(SCRIPT, json.dumps(CASES), json.dumps(REALTIME), folder, timeout=TIMEOUT)
    assert result.returncode == 0, result.stdout + result.stderr
    names = list(CASES)
    found = {}
    for path in folder.iterdir():
        label, number = path.stem.split()
        found[label, names[int(number)]] = read(path)
    return found | {"text": result.stdout}


pytestmark = pytest.mark.slow

ENGINES = pytest.mark.parametrize(
    ("label", "name"), [("reference", name) for name in CASES] + [("realtime", name) for name in REALTIME])


@ENGINES
def test_pictures(pictures: dict, label: str, name: str) -> None:
    """Show what Cycles shows, but for noise at edges and on what is lit; a pixel beside it is worse."""
    expected, found = (pictures[each, name]["Combined"] for each in ("cycles", label))
    assert expected.shape == found.shape and expected[..., :3].std() > 0.08
    error = np.abs(found - expected)
    assert error.mean() < 0.005 and np.quantile(error.max(2), 0.98) < 0.08
    for axis in (0, 1):
        assert np.abs(np.roll(found, 1, axis) - expected).mean() > 1.6 * error.mean()


@ENGINES
def test_passes(pictures: dict, label: str, name: str) -> None:
    """Agree in distance, place, mist, motion, occlusion and colour wherever no edge or lens makes samples differ."""
    expected, found = pictures["cycles", name], pictures[label, name]
    seen = (expected["Depth"] < 1e9)[..., 0] & (found["Depth"] < 1e9)[..., 0]
    assert seen.any() and ((expected["Depth"] < 1e9) != (found["Depth"] < 1e9)).mean() < 0.12
    lens = CASES[name].get("lens_open", False)
    ratio = (found["Depth"] / expected["Depth"])[seen]
    assert abs(np.median(ratio) - 1.0) < 0.01 and np.quantile(np.abs(ratio - 1.0), 0.5) < 0.06
    for key, tolerance in (("Mist", 0.004), ("Ambient Occlusion", 0.02), ("Diffuse Color", 0.008)):
        error = found[key] - expected[key]
        assert abs(error.mean()) < 0.25 * tolerance and np.abs(error).mean() < (2.5 if lens else 1.0) * tolerance, key
    motion = expected["Vector"]
    error = np.abs(found["Vector"] - motion).max(2)
    assert np.abs(motion).max() > 0.5 and np.quantile(error, 0.5) < 2e-3
    assert np.quantile(error, 0.75) < (1.0 if lens else 0.05)


def test_report(pictures: dict) -> None:
    """Say once a picture that frames of the real-time integrator are path-traced samples, and nothing else."""
    lines = [line for line in pictures["text"].splitlines() if line.startswith("REPORT")]
    assert lines == ["REPORT info: panoramic cameras are path-traced"] * len(REALTIME)
