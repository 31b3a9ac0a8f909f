# SPDX-License-Identifier: GPL-3.0-or-later
"""Forced failures through the command line: one sentence, exit status 1 and no file, or else a correct picture.

The scenes are built once, by Blender in a child process. A second one renders them all, one command after another as
a farm's worker does; each test looks at its own command. Only what breaks the process itself has one of its own.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

Run = Callable[..., subprocess.CompletedProcess]

BUILD = """
from pathlib import Path
import bpy

folder = Path(sys.argv[1])

def start(camera=True):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 32, 16
    scene.view_settings.view_transform = 'Standard'
    world = bpy.data.worlds.new("World")
    scene.world = world
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.5, 0.25, 0.125, 1.0)
    if camera:
        data = bpy.data.cameras.new("Camera")
        thing = bpy.data.objects.new("Camera", data)
        thing.location = (0.0, 0.0, 5.0)
        scene.collection.objects.link(thing)
        scene.camera = thing
    return scene

def add_plane(material=None):
    mesh = bpy.data.meshes.new("Plane")
    mesh.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new(name="UVMap")
    if material:
        mesh.materials.append(material)
    thing = bpy.data.objects.new("Plane", mesh)
    bpy.context.scene.collection.objects.link(thing)
    return mesh

def save(name):
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{name}.blend"))

start(); save("empty")
start(camera=False); save("no_camera")
start().world = None; save("nothing")

start()
emission = bpy.data.materials.new("Missing")
tree = emission.node_tree
tree.nodes.clear()
output, shader = tree.nodes.new('ShaderNodeOutputMaterial'), tree.nodes.new('ShaderNodeEmission')
texture = tree.nodes.new('ShaderNodeTexImage')
texture.image = bpy.data.images.new("lost", 4, 4)
texture.image.source = 'FILE'
texture.image.filepath = "//no/such/picture.png"
tree.links.new(texture.outputs["Color"], shader.inputs["Color"])
tree.links.new(shader.outputs["Emission"], output.inputs["Surface"])
add_plane(emission)
save("missing_image")

start()
mesh = add_plane()
mesh.vertices[0].co = (float("nan"), 0.0, 0.0)
mesh.vertices[2].co = (float("inf"), 9.0, 0.0)
save("nan_mesh")

scene = start()
scene.render.use_border, scene.render.use_crop_to_border = True, False
scene.render.border_min_x, scene.render.border_max_x = 0.5, 1.0
scene.render.border_min_y, scene.render.border_max_y = 0.0, 0.5
save("border")

scene = start()
scene.render.film_transparent = True
save("transparent")
"""

WORLD = (0.5, 0.25, 0.125)

COMMANDS = {
    "no_camera": "no_camera.blend",
    "unknown_camera": "empty.blend --camera Left",
    "unknown_view_layer": "empty.blend --view-layer Fog",
    "garbage": "garbage.blend",
    "cut": "cut.blend",
    "no_cuda": "empty.blend --device cuda",
    "unwritable": "empty.blend --output {folder}/garbage.blend/a.exr",
    "empty": "empty.blend",
    "nothing": "nothing.blend",
    "transparent": "transparent.blend",
    "border": "border.blend",
    "missing_image": "missing_image.blend",
    "nan_mesh": "nan_mesh.blend",
    "1x1": "empty.blend --size 1 1 --samples 1",
    "16384x3": "empty.blend --size 16384 3 --samples 1",
    "3x517": "empty.blend --size 3 517 --samples 1",
    "time": "empty.blend --time 0.5",
    "png": "empty.blend --output {folder}/png.png",
}
"""Arguments of `burnish render` by the test that looks at them; two samples of the reference integrator, the processor
and NAME.exr by default."""

REALTIME = ("empty", "nothing", "transparent", "border", "missing_image", "nan_mesh", "1x1", "16384x3", "3x517")
"""Those that are rendered by the real-time integrator too"""
COMMANDS |= {f"{name}_realtime": f"{COMMANDS[name]} --integrator realtime" for name in REALTIME}

BATCH = """
import json, os, tempfile
from burnish.addon.cli import main

folder, commands = sys.argv[1], json.loads(sys.argv[2])
results = {}
for name, text in commands.items():
    arguments = text.format(folder=folder).split()
    arguments[0] = os.path.join(folder, arguments[0])
    for option, default in (("--output", f"{folder}/{name}.exr"), ("--samples", "2"), ("--device", "cpu"),
                            ("--integrator", "reference")):
        if option not in arguments and not (option == "--samples" and "--time" in arguments):
            arguments += [option, default]
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as error:
        sys.stdout.flush()
        saved = os.dup(1), os.dup(2)
        os.dup2(out.fileno(), 1)
        os.dup2(error.fileno(), 2)
        status = main(["render", *arguments])
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(saved[0], 1)
        os.dup2(saved[1], 2)
        out.seek(0)
        error.seek(0)
        results[name] = {"status": status, "out": out.read(), "error": error.read()}
with open(os.path.join(folder, "results.json"), "w") as file:
    json.dump(results, file)
"""


@pytest.fixture(scope="module")
def scenes(run_python: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with all scenes."""
    folder = tmp_path_factory.mktemp("scenes")
    process = run_python(BUILD, folder)
    assert process.returncode == 0, process.stderr
    (folder / "garbage.blend").write_bytes(b"This is no scene." * 100)
    (folder / "cut.blend").write_bytes((folder / "empty.blend").read_bytes()[:5000])
    return folder


@pytest.fixture(scope="module")
def results(scenes: Path, run_python: Run) -> dict[str, dict]:
    """Return exit status, output and errors of every command."""
    process = run_python(BATCH, scenes, json.dumps(COMMANDS), environment={"CUDA_VISIBLE_DEVICES": "-1"}, timeout=300)
    assert process.returncode == 0, process.stdout + process.stderr
    return json.loads((scenes / "results.json").read_text())


@pytest.fixture
def sentence(results: dict[str, dict], scenes: Path) -> Callable[[str], str]:
    """Return a function that expects that a command failed in the right way and returns its sentence."""

    def expect(name: str) -> str:
        result = results[name]
        assert result["status"] == 1, result
        assert result["out"] == ""
        assert result["error"].count("\n") == 1, result["error"]
        assert result["error"].endswith(".\n")
        assert not list(scenes.glob(f"*{name}*.exr"))
        return result["error"].strip()

    return expect


@pytest.fixture
def picture(results: dict[str, dict], scenes: Path) -> Callable[..., np.ndarray]:
    """Return a function that expects that a command succeeded and returns its pixels, the top row first."""

    def read(name: str, samples: int = 2) -> np.ndarray:
        result, path = results[name], scenes / f"{name}.exr"
        assert result["status"] == 0, result
        assert result["error"] == ""
        pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
        last = result["out"].splitlines()[-1]
        assert last.startswith(f"{path} {pixels.shape[1]}x{pixels.shape[0]} {samples} samples "), last
        assert np.isfinite(pixels).all()
        assert (pixels >= 0.0).all()
        return pixels

    return read


def test_missing_camera(sentence: Callable) -> None:
    """Name the camera as what is missing."""
    assert "camera" in sentence("no_camera")


def test_unknown_camera(sentence: Callable) -> None:
    """Name the cameras that there are."""
    assert "'Left'; it has 'Camera'" in sentence("unknown_camera")


def test_unknown_view_layer(sentence: Callable) -> None:
    """Name the view layers that there are."""
    assert "'Fog'; it has 'ViewLayer'" in sentence("unknown_view_layer")


@pytest.mark.parametrize("name", ["garbage", "cut"])
def test_unreadable_scene(sentence: Callable, name: str) -> None:
    """Name the file that can't be opened."""
    assert f"{name}.blend' can't be opened" in sentence(name)


def test_missing_device(sentence: Callable) -> None:
    """Say that there is no CUDA device and what to do; never render on another one silently."""
    text = sentence("no_cuda")
    assert "CUDA" in text
    assert "cpu" in text


def test_unwritable_output(sentence: Callable) -> None:
    """Say that the picture can't be saved where its folder is a file."""
    assert "can't be saved" in sentence("unwritable")


@pytest.mark.slow
def test_failing_kernel(scenes: Path, run_python: Run, tmp_path: Path) -> None:
    """Turn a failure in the middle of sampling into a sentence, without a file, through the real RenderEngine."""
    script = """
from burnish.addon import cli
from burnish.engine.session import Session
step, calls = Session.step, []

def broken(self, *arguments, **keywords):
    calls.append(1)
    if len(calls) > 1:
        raise RuntimeError("CUDA error 700: an illegal memory access was encountered")
    return step(self, *arguments, **keywords)

Session.step = broken
raise SystemExit(cli.main(sys.argv[1:]))
"""
    path = tmp_path / "picture.exr"
    process = run_python(script, "render", scenes / "empty.blend", "-o", path, "--samples", 64, "--device", "cpu",
                         "--integrator", "reference")
    assert process.returncode == 1, process.stdout + process.stderr
    assert "illegal memory access" in process.stderr
    assert process.stderr.count("\n") == 1
    assert process.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_failing_render_keeps_blender_from_saving(scenes: Path, run_python: Run, tmp_path: Path) -> None:
    """Make bpy.ops.render.render raise and write no file, as a farm that runs Blender itself sees it."""
    script = """
import bpy, burnish
from burnish.engine.session import Session

def broken(self, *arguments, **keywords):
    raise MemoryError

Session.update = broken
burnish.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
scene = bpy.context.scene
scene.render.engine = 'BURNISH'
scene.render.filepath = sys.argv[2]
try:
    bpy.ops.render.render(write_still=True)
    status = 3
except RuntimeError as error:
    status = 0 if "memory" in str(error) else 4
burnish.unregister()
raise SystemExit(status)
"""
    process = run_python(script, scenes / "empty.blend", tmp_path / "picture.png")
    assert process.returncode == 0, process.stdout + process.stderr
    assert list(tmp_path.iterdir()) == []


def test_empty_scene_shows_the_world(picture: Callable) -> None:
    """Render the world's colour exactly, with alpha 1."""
    expected = np.broadcast_to((*WORLD, 1.0), (16, 32, 4))
    np.testing.assert_allclose(picture("empty")[..., :4], expected, rtol=1e-5)


def test_scene_with_nothing_is_black(picture: Callable) -> None:
    """Render black where there is not even a world."""
    assert (picture("nothing")[..., :3] == 0.0).all()


def test_transparent_film(picture: Callable) -> None:
    """Leave the world out, alpha included."""
    assert (picture("transparent")[..., :4] == 0.0).all()


def test_border_keeps_the_frame(picture: Callable) -> None:
    """Put the border's pixels (here the lower right quarter) where they belong in the full frame."""
    pixels = picture("border")
    assert pixels.shape[:2] == (16, 32)
    np.testing.assert_allclose(pixels[8:, 16:, :3], np.broadcast_to(WORLD, (8, 16, 3)), rtol=1e-5)
    assert (pixels[:8] == 0.0).all()
    assert (pixels[:, :16] == 0.0).all()


def test_missing_image_is_magenta_and_reported(picture: Callable, results: dict[str, dict]) -> None:
    """Draw an image that can't be read in magenta and name it."""
    pixels = picture("missing_image")
    np.testing.assert_allclose(pixels[..., :3], np.broadcast_to((1.0, 0.0, 1.0), (16, 32, 3)), atol=1e-5)
    lines = results["missing_image"]["out"].splitlines()
    assert any("lost" in line and line.startswith("missing: ") for line in lines), lines


def test_nan_mesh_is_dropped_and_reported(picture: Callable, results: dict[str, dict]) -> None:
    """Leave triangles with impossible corners out, show the rest, and say so."""
    pixels = picture("nan_mesh")
    np.testing.assert_allclose(pixels[..., :3], np.broadcast_to(WORLD, (16, 32, 3)), rtol=1e-5)
    lines = results["nan_mesh"]["out"].splitlines()[:-1]
    assert any("Plane" in line for line in lines), lines


@pytest.mark.parametrize("name", ["1x1", "16384x3", "3x517"])
def test_odd_sizes(picture: Callable, name: str) -> None:
    """Render sizes from one pixel to very wide."""
    pixels = picture(name, samples=1)
    width, height = map(int, name.split("x"))
    assert pixels.shape[:2] == (height, width)
    np.testing.assert_allclose(pixels[..., :3], np.broadcast_to(WORLD, (height, width, 3)), rtol=1e-5)


@pytest.mark.parametrize("name", REALTIME)
def test_realtime_draws_the_same(picture: Callable, name: str) -> None:
    """Draw what needs no sampling as the path tracer does, to the rounding of half floats."""
    samples = 1 if "--samples 1" in COMMANDS[name] else 2
    expected = picture(name, samples=samples)
    np.testing.assert_allclose(picture(f"{name}_realtime", samples=samples), expected, rtol=2e-3, atol=1e-4)


def test_time_limit_ends_the_render(results: dict[str, dict], scenes: Path) -> None:
    """Stop after the given time with as many samples as fitted in."""
    samples = int(results["time"]["out"].split()[-4])
    assert samples > 1
    assert oiio.ImageBuf(str(scenes / "time.exr")).spec().get_int_attribute("burnish:samples") == samples


def test_png_goes_through_the_view_transform(results: dict[str, dict], scenes: Path) -> None:
    """Save sRGB-encoded bytes under the Standard view."""
    assert results["png"]["status"] == 0, results["png"]
    pixels = oiio.ImageBuf(str(scenes / "png.png")).get_pixels(oiio.FLOAT) * 255.0
    expected = 255.0 * (1.055 * np.array(WORLD) ** (1.0 / 2.4) - 0.055)
    np.testing.assert_allclose(pixels[..., :3], np.broadcast_to(expected, (16, 32, 3)), atol=1.0)


def test_nothing_unfinished_is_left(results: dict[str, dict], scenes: Path) -> None:
    """Leave no temporary file beside the pictures."""
    assert not [entry.name for entry in scenes.iterdir() if entry.name.startswith(".")]
    good = [name for name, result in results.items() if result["status"] == 0 and name != "png"]
    assert {entry.stem for entry in scenes.glob("*.exr")} == set(good)
