# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of the first surfaces as F12 and the command line write them, against Cycles' own in the same scene."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

TIMEOUT = 600.0
"""The first run may have to build all kernels"""
LEVELS = 4
SWITCHES = ("mist", "cryptomatte_object", "cryptomatte_material", "cryptomatte_asset", "ambient_occlusion", "vector")

SCRIPT = """
import bpy, burnish, json
import addon_utils

folder, switches, levels = sys.argv[1], json.loads(sys.argv[2]), int(sys.argv[3])
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable("cycles")
burnish.register()
scene = bpy.context.scene
world = scene.world = bpy.data.worlds.new("World")
mist = world.mist_settings
mist.start, mist.depth, mist.falloff = 2.0, 9.0, 'QUADRATIC'
world.light_settings.distance = 1.5


def aov(tree, name, socket, value):
    node = tree.nodes.new("ShaderNodeOutputAOV")
    node.aov_name = name
    node.inputs[socket].default_value = value
    return node


def material(name, alpha=1.0):
    made = bpy.data.materials.new(name)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    output, last = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeBsdfDiffuse")
    if alpha < 1.0:
        mix = nodes.new("ShaderNodeMixShader")
        mix.inputs[0].default_value = alpha
        links.new(nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
        links.new(last.outputs[0], mix.inputs[2])
        last = mix
    links.new(last.outputs[0], output.inputs[0])
    return made


chalk, veil = material("Chalk"), material("Veil", 0.6)
place = aov(chalk.node_tree, "place", "Color", (0.0, 0.0, 0.0, 1.0))
chalk.node_tree.links.new(chalk.node_tree.nodes.new("ShaderNodeNewGeometry").outputs["Position"], place.inputs[0])
# A group's AOV counts as one of the tree's own.
group = bpy.data.node_groups.new("Group", 'ShaderNodeTree')
aov(group, "number", "Value", -2.0)
chalk.node_tree.nodes.new("ShaderNodeGroup").node_tree = group
aov(veil.node_tree, "place", "Color", (1.0, 2.0, 3.0, 1.0))
aov(world.node_tree, "number", "Value", 7.0)


def named(name, *materials):
    bpy.context.object.name = name
    for each in materials:
        bpy.context.object.data.materials.append(each)
    return bpy.context.object


bpy.ops.mesh.primitive_plane_add(size=12.0)
named("Floor", chalk)
bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0.0, 0.0, 0.5))
named("Box")
root, middle = (bpy.data.objects.new(name, None) for name in ("Root", "Middle"))
for each in (root, middle):
    scene.collection.objects.link(each)
middle.parent = root
bpy.ops.mesh.primitive_uv_sphere_add(radius=0.6, location=(1.3, 0.5, 0.6), segments=16, ring_count=8)
named("B\u00e4ll", chalk).parent = middle
bpy.ops.mesh.primitive_plane_add(size=1.5, location=(-0.8, -1.2, 0.8), rotation=(1.3, 0.0, 0.0))
named("Veil", veil)
bpy.ops.object.camera_add(location=(0.0, -4.0, 3.0), rotation=(1.05, 0.0, 0.0))
scene.camera = bpy.context.object
scene.render.resolution_x, scene.render.resolution_y = 64, 48
layer = scene.view_layers[0]
for name in switches:
    setattr(layer, f"use_pass_{name}", True)
layer.pass_cryptomatte_depth = levels
for name, kind in (("place", 'COLOR'), ("number", 'VALUE'), ("nowhere", 'COLOR')):
    added = layer.aovs.add()
    added.name, added.type = name, kind
scene.frame_current = 10
# The box moves and turns, the ball deforms and its parent moves, the camera moves: not evenly.
box, ball, camera = (bpy.data.objects[name] for name in ("Box", "B\u00e4ll", scene.camera.name))
ball.shape_key_add(name="Basis")
key = ball.shape_key_add(name="Tall")
for point in key.data:
    point.co.z *= 1.5
for frame, x, turn, value, step in ((9, -0.3, 0.0, 0.0, 0.0), (10, 0.0, 0.2, 0.5, 0.1), (11, 0.1, 0.5, 0.7, 0.4)):
    box.location.x, box.rotation_euler.z, key.value = x, turn, value
    root.location.y, camera.location.x = step, 0.2 * step
    for each, path in ((box, "location"), (box, "rotation_euler"), (key, "value"), (root, "location"),
                       (camera, "location")):
        each.keyframe_insert(path, frame=frame)
scene.frame_set(10)
settings = scene.render.image_settings
settings.media_type = 'MULTI_LAYER_IMAGE'
settings.file_format, settings.color_depth = 'OPEN_EXR_MULTILAYER', '32'
scene.burnish.device, scene.burnish.sampling.samples = 'CPU', 64
scene.cycles.device, scene.cycles.samples = 'CPU', 256
scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
for name, engine, integrator in (
        ("cycles", 'CYCLES', 'REFERENCE'), ("reference", 'BURNISH', 'REFERENCE'), ("realtime", 'BURNISH', 'REALTIME')):
    scene.render.engine, scene.burnish.sampling.integrator = engine, integrator
    scene.render.filepath = f"{folder}/{name}.exr"
    bpy.ops.render.render(write_still=True)
# The compositor's node finds a thing by its name.
tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositing", 'CompositorNodeTree')
tree.interface.new_socket("Image", in_out='OUTPUT', socket_type='NodeSocketColor')
node = tree.nodes.new("CompositorNodeCryptomatteV2")
node.source, node.scene = 'RENDER', scene
node.layer_name, node.matte_id = "ViewLayer.CryptoObject", "Box"
tree.links.new(node.outputs["Matte"], tree.nodes.new("NodeGroupOutput").inputs[0])
settings.media_type = 'IMAGE'
settings.file_format, settings.color_depth = 'OPEN_EXR', '32'
scene.render.filepath = f"{folder}/matte.exr"
bpy.ops.render.render(write_still=True)
bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/scene.blend")
from burnish.addon import report
print("REPORT", report.published("Render").text())
burnish.unregister()

from burnish.addon.cli import main
raise SystemExit(main(["render", f"{folder}/scene.blend", "--output", f"{folder}/command.exr", "--samples", "64",
                       "--integrator", "reference"]))
"""


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return all channels of all parts of a file, and its Cryptomatte header entries."""
    channels, header, file = {}, {}, oiio.ImageInput.open(str(path))
    part = 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        pixels = file.read_image(part, 0, 0, spec.nchannels, oiio.FLOAT)
        channels |= {name: pixels[..., index] for index, name in enumerate(spec.channelnames)}
        header |= {each.name: each.value for each in spec.extra_attribs if each.name.startswith("cryptomatte/")}
        part += 1
    file.geterror()
    file.close()
    return channels, header


@pytest.fixture(scope="module")
def pictures(run_python: Callable[..., subprocess.CompletedProcess], tmp_path_factory: pytest.TempPathFactory) -> dict:
    """Return channels and header of the same scene by Cycles, both integrators and the command line, and the text."""
    folder = tmp_path_factory.mktemp("passes")
    result = run_python(SCRIPT, folder, json.dumps(SWITCHES), LEVELS, timeout=TIMEOUT)
    assert result.returncode == 0, result.stdout + result.stderr
    found = {name: read(folder / f"{name}.exr") for name in ("cycles", "reference", "realtime", "command", "matte")}
    return found | {"text": result.stdout}


BURNISH = pytest.mark.parametrize("name", ["reference", "realtime", "command"])


def difference(pictures: dict, name: str, channel: str) -> np.ndarray:
    """Return how a channel differs from Cycles'."""
    return pictures[name][0][f"ViewLayer.{channel}"] - pictures["cycles"][0][f"ViewLayer.{channel}"]


@BURNISH
def test_mist(pictures: dict, name: str) -> None:
    """Agree with Cycles in every pixel but for noise at edges."""
    error = difference(pictures, name, "Mist.Z")
    assert abs(error.mean()) < 5e-4 and np.sqrt((error**2).mean()) < 0.006


@BURNISH
def test_motion(pictures: dict, name: str) -> None:
    """Agree with Cycles where things, their parents, their vertices and the camera move, but at edges."""
    for channel, least in (("X", 0.4), ("Y", 0.1), ("Z", 0.4), ("W", 0.1)):
        motion = pictures["cycles"][0][f"ViewLayer.Vector.{channel}"]
        error = difference(pictures, name, f"Vector.{channel}")
        assert motion.std() > least and np.quantile(np.abs(error), 0.75) < 1e-3, channel
        assert np.sqrt((error**2).mean()) < 0.1 * motion.std(), channel


@BURNISH
def test_occlusion(pictures: dict, name: str) -> None:
    """Agree with Cycles but for noise."""
    error = difference(pictures, name, "Ambient Occlusion.R")
    assert abs(error.mean()) < 2e-3 and np.sqrt((error**2).mean()) < 0.04
    assert np.abs(error.reshape(6, 8, 8, 8).mean((1, 3))).max() < 0.02


@BURNISH
def test_shader_values(pictures: dict, name: str) -> None:
    """Agree with Cycles, through groups, in the world and where no material has a value."""
    for channel, tolerance in (("place.R", 0.05), ("place.G", 0.05), ("place.B", 0.03), ("place.A", 0.02),
                               ("number.X", 0.1)):
        error = difference(pictures, name, channel)
        assert abs(error.mean()) < 0.1 * tolerance and np.sqrt((error**2).mean()) < tolerance, channel
    assert not pictures[name][0]["ViewLayer.nowhere.R"].any()


def mattes(channels: dict[str, np.ndarray], kind: str) -> dict[int, np.ndarray]:
    """Return the coverage by each thing, by the bits of its id."""
    found: dict[int, np.ndarray] = {}
    for number in range(LEVELS // 2):
        for pair in ("rg", "ba"):
            ids, coverage = (channels[f"ViewLayer.{kind}{number:02d}.{letter}"] for letter in pair)
            bits = np.ascontiguousarray(ids).view(np.uint32)
            for each in np.unique(bits[coverage > 0.0]).tolist():
                found[each] = found.get(each, 0.0) + np.where(bits == each, coverage, 0.0)
    return found


@BURNISH
@pytest.mark.parametrize("kind", ["CryptoObject", "CryptoMaterial", "CryptoAsset"])
def test_cryptomatte(pictures: dict, name: str, kind: str) -> None:
    """Give things the ids that Cycles gives them and the same coverage, the largest first, and name them alike."""
    channels, header = pictures[name]
    found, expected = mattes(channels, kind), mattes(pictures["cycles"][0], kind)
    assert set(found) == set(expected) and len(found) == (3 if kind == "CryptoMaterial" else 4)
    for bits, coverage in expected.items():
        error = found[bits] - coverage
        assert abs(error.mean()) < 1e-3 and np.sqrt((error**2).mean()) < 0.01
    assert (channels[f"ViewLayer.{kind}00.g"] >= channels[f"ViewLayer.{kind}00.a"]).all()
    prefix, = (key.removesuffix("name") for key, value in header.items() if value == f"ViewLayer.{kind}")
    theirs = pictures["cycles"][1]
    for key in ("name", "hash", "conversion"):
        assert header[prefix + key] == theirs[prefix + key]
    manifest, known = json.loads(header[f"{prefix}manifest"]), json.loads(theirs[f"{prefix}manifest"])
    assert len(manifest) == len(found) and manifest.items() <= known.items()


def test_compositor_finds_things_by_name(pictures: dict) -> None:
    """Get the coverage of the box, whose name the Cryptomatte node is given, from a render that is composited."""
    found = mattes(pictures["realtime"][0], "CryptoObject")[0x80BB1009]
    matte = pictures["matte"][0]["R"]
    assert 0.1 < found.mean() < 0.2
    np.testing.assert_allclose(matte, found, atol=1e-3)
