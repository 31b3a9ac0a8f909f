# SPDX-License-Identifier: GPL-3.0-or-later
"""Forced failures through the command line: one sentence, exit status 1 and no file, or else a correct picture.

The scenes are built once by Blender in a child process; each render is a child process of its own.
"""

from __future__ import annotations

import os
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


@pytest.fixture(scope="module")
def scenes(run_python: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with all scenes."""
    folder = tmp_path_factory.mktemp("scenes")
    process = run_python(BUILD, folder)
    assert process.returncode == 0, process.stderr
    (folder / "garbage.blend").write_bytes(b"This is no scene." * 100)
    (folder / "cut.blend").write_bytes((folder / "empty.blend").read_bytes()[:5000])
    return folder


@pytest.fixture
def expect_failure(burnish: Run, tmp_path: Path) -> Callable[..., str]:
    """Return a function that runs `burnish render`, expects failure, and returns the sentence."""

    def expect(scene: Path, *options: object, **keywords: object) -> str:
        process = burnish("render", scene, "--output", tmp_path / "picture.exr", *options, **keywords)
        assert process.returncode == 1, process.stdout + process.stderr
        assert process.stdout == ""
        assert process.stderr.count("\n") == 1, process.stderr
        assert process.stderr.endswith(".\n")
        assert list(tmp_path.iterdir()) == []
        return process.stderr.strip()

    return expect


@pytest.fixture
def render(burnish: Run, tmp_path: Path) -> Callable[..., tuple[np.ndarray, list[str]]]:
    """Return a function that renders to an EXR and returns its pixels (top row first) and what was printed."""

    def run(scene: Path, *options: object, samples: int = 2) -> tuple[np.ndarray, list[str]]:
        path = tmp_path / "picture.exr"
        process = burnish("render", scene, "--output", path, "--samples", samples, "--device", "cpu", *options)
        assert process.returncode == 0, process.stdout + process.stderr
        assert process.stderr == ""
        pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
        lines = process.stdout.splitlines()
        assert lines[-1].startswith(f"{path} {pixels.shape[1]}x{pixels.shape[0]} {samples} samples ")
        assert np.isfinite(pixels).all()
        assert (pixels >= 0.0).all()
        return pixels, lines

    return run


def test_missing_camera(scenes: Path, expect_failure: Callable[..., str]) -> None:
    """Name the camera as what is missing."""
    assert "camera" in expect_failure(scenes / "no_camera.blend")


def test_unknown_camera(scenes: Path, expect_failure: Callable[..., str]) -> None:
    """Name the cameras that there are."""
    sentence = expect_failure(scenes / "empty.blend", "--camera", "Left eye")
    assert "'Left eye'" in sentence
    assert "'Camera'" in sentence


def test_unknown_view_layer(scenes: Path, expect_failure: Callable[..., str]) -> None:
    """Name the view layers that there are."""
    assert "'ViewLayer'" in expect_failure(scenes / "empty.blend", "--view-layer", "Fog")


@pytest.mark.parametrize("name", ["garbage", "cut"])
def test_unreadable_scene(scenes: Path, expect_failure: Callable[..., str], name: str) -> None:
    """Name the file that can't be opened."""
    assert f"{name}.blend" in expect_failure(scenes / f"{name}.blend")


def test_missing_device(scenes: Path, expect_failure: Callable[..., str]) -> None:
    """Say that there is no CUDA device and what to do; never render on another one silently."""
    sentence = expect_failure(scenes / "empty.blend", "--device", "cuda", environment={"CUDA_VISIBLE_DEVICES": "-1"})
    assert "CUDA" in sentence
    assert "cpu" in sentence


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
    process = run_python(script, "render", scenes / "empty.blend", "-o", path, "--samples", 64, "--device", "cpu")
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


def test_unwritable_output(scenes: Path, burnish: Run, tmp_path: Path) -> None:
    """Say that the picture can't be saved where its folder is a file."""
    blocker = tmp_path / "file"
    blocker.write_text("")
    process = burnish("render", scenes / "empty.blend", "-o", blocker / "a.exr", "--samples", 1, "--device", "cpu")
    assert process.returncode == 1
    assert "can't be saved" in process.stderr
    assert process.stderr.count("\n") == 1


def test_empty_scene_shows_the_world(scenes: Path, render: Callable) -> None:
    """Render the world's colour exactly, with alpha 1."""
    pixels, _ = render(scenes / "empty.blend")
    np.testing.assert_allclose(pixels[..., :4], np.broadcast_to((*WORLD, 1.0), (16, 32, 4)), rtol=1e-5)


def test_scene_with_nothing_is_black(scenes: Path, render: Callable) -> None:
    """Render black where there is not even a world."""
    pixels, _ = render(scenes / "nothing.blend")
    assert (pixels[..., :3] == 0.0).all()


def test_transparent_film(scenes: Path, render: Callable) -> None:
    """Leave the world out, alpha included."""
    pixels, _ = render(scenes / "transparent.blend")
    assert (pixels[..., :4] == 0.0).all()


def test_border_keeps_the_frame(scenes: Path, render: Callable) -> None:
    """Put the border's pixels (here the lower right quarter) where they belong in the full frame."""
    pixels, _ = render(scenes / "border.blend")
    assert pixels.shape[:2] == (16, 32)
    np.testing.assert_allclose(pixels[8:, 16:, :3], np.broadcast_to(WORLD, (8, 16, 3)), rtol=1e-5)
    assert (pixels[:8] == 0.0).all()
    assert (pixels[:, :16] == 0.0).all()


def test_missing_image_is_magenta_and_reported(scenes: Path, render: Callable) -> None:
    """Draw an image that can't be read in magenta and name it."""
    pixels, lines = render(scenes / "missing_image.blend")
    np.testing.assert_allclose(pixels[..., :3], np.broadcast_to((1.0, 0.0, 1.0), (16, 32, 3)), atol=1e-5)
    assert any("lost" in line and line.startswith("missing: ") for line in lines), lines


def test_nan_mesh_is_dropped_and_reported(scenes: Path, render: Callable) -> None:
    """Leave triangles with impossible corners out, show the rest, and say so."""
    pixels, lines = render(scenes / "nan_mesh.blend")
    np.testing.assert_allclose(pixels[..., :3], np.broadcast_to(WORLD, (16, 32, 3)), rtol=1e-5)
    assert any("Plane" in line for line in lines), lines


@pytest.mark.parametrize(("width", "height"), [(1, 1), (16384, 3), (3, 517)])
def test_odd_sizes(scenes: Path, render: Callable, width: int, height: int) -> None:
    """Render sizes from one pixel to very wide."""
    pixels, _ = render(scenes / "empty.blend", "--size", width, height, samples=1)
    assert pixels.shape[:2] == (height, width)
    np.testing.assert_allclose(pixels[..., :3], np.broadcast_to(WORLD, (height, width, 3)), rtol=1e-5)


def test_time_limit_ends_the_render(scenes: Path, burnish: Run, tmp_path: Path) -> None:
    """Stop after the given time with as many samples as fitted in."""
    path = tmp_path / "picture.exr"
    process = burnish("render", scenes / "empty.blend", "-o", path, "--time", 0.5, "--device", "cpu")
    assert process.returncode == 0, process.stderr
    samples = int(process.stdout.split()[-4])
    assert samples > 1
    assert oiio.ImageBuf(str(path)).spec().get_int_attribute("burnish:samples") == samples


def test_png_goes_through_the_view_transform(scenes: Path, burnish: Run, tmp_path: Path) -> None:
    """Save sRGB-encoded bytes under the Standard view."""
    path = tmp_path / "picture.png"
    process = burnish("render", scenes / "empty.blend", "-o", path, "--samples", 1, "--device", "cpu")
    assert process.returncode == 0, process.stderr
    pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT) * 255.0
    linear = np.array(WORLD)
    expected = 255.0 * (1.055 * linear ** (1.0 / 2.4) - 0.055)
    np.testing.assert_allclose(pixels[..., :3], np.broadcast_to(expected, (16, 32, 3)), atol=1.0)
    assert os.listdir(tmp_path) == ["picture.png"]
