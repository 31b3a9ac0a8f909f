# SPDX-License-Identifier: GPL-3.0-or-later
"""The real-time integrator through Blender's final render and the command line, with the real engine."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

Run = Callable[..., subprocess.CompletedProcess]

CORNELL = Path(__file__).resolve().parents[2] / "sample_blends" / "cornell.blend"
TIMEOUT = 600.0
"""The first run may have to build all kernels"""

SCENE = """
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("World")
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.4, 0.3, 1.0)
bpy.ops.mesh.primitive_plane_add(size=40.0)
floor = bpy.context.object
bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0.0, 0.0, 0.5))
cube = bpy.context.object
material = bpy.data.materials.new("Chalk")
material.node_tree.nodes.clear()
diffuse = material.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
diffuse.inputs["Color"].default_value = (0.8, 0.5, 0.2, 1.0)
output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
material.node_tree.links.new(diffuse.outputs[0], output.inputs[0])
for thing in (floor, cube):
    thing.data.materials.append(material)
bpy.ops.object.light_add(type='POINT', location=(2.0, -2.0, 3.0))
bpy.context.object.data.energy = 300.0
bpy.ops.object.camera_add(location=(0.0, -4.0, 3.0), rotation=(0.95, 0.0, 0.0))
scene.camera = bpy.context.object
scene.render.engine = 'BURNISH'
scene.render.resolution_x, scene.render.resolution_y = 48, 32
settings = scene.burnish
settings.device = 'CPU'
settings.sampling.integrator, settings.sampling.samples = 'REALTIME', 12
pictures = []
final.on_finished[:] = [lambda layer, view, pixels, information: pictures.append((pixels, information))]
"""


SCRIPTS = {
    "light passes make up the picture": """
layer = scene.view_layers[0]
for name in ("direct", "indirect", "color"):
    setattr(layer, f"use_pass_diffuse_{name}", True)
layer.use_pass_z = True
settings.film.pixel_filter = 'BOX'
bpy.ops.render.render()
pixels = pictures[0][0]
direct, indirect, color = (pixels[f"Diffuse {name}"] for name in ("Direct", "Indirect", "Color"))
surface = pixels["Depth"][..., 0] < 1e9
assert surface.mean() > 0.5
for name, part in (("direct", direct), ("indirect", indirect)):
    assert np.isfinite(part).all() and (part >= 0.0).all() and part[surface].mean() > 0.05, (name, part.mean())
assert np.abs(color[surface] - (0.8, 0.5, 0.2)).max() < 0.01, color[surface].mean(0)
made, seen = ((direct + indirect) * color)[surface], pixels["Combined"][..., :3][surface]
# The passes average the filtered frames as the picture does, but round to half floats on the way.
assert np.abs(made.mean(0) / seen.mean(0) - 1.0).max() < 0.02, (made.mean(0), seen.mean(0))
""",
    # Only the camera moves: a moved object would leave the flattened structure, in which hits round otherwise.
    "animation frames do not depend on each other": """
scene.render.filepath = folder + "/"
scene.render.use_persistent_data = True
camera = scene.camera
camera.keyframe_insert("location", frame=1)
camera.location.x = 1.0
camera.keyframe_insert("location", frame=2)
scene.frame_start, scene.frame_end = 1, 2
bpy.ops.render.render(animation=True)
scene.render.use_persistent_data = False
scene.frame_start = 2
bpy.ops.render.render(animation=True)
first, second, alone = (picture[0]["Combined"] for picture in pictures)
assert not np.array_equal(first, second)
# Rounding of a kept scene's structures apart; what a history of frame 1 leaves would be a hundred times as much.
assert np.abs(second - alone).max() < 1e-3, np.abs(second - alone).max()
""",
    "more frames than the filters take": """
settings.denoiser.rest_frames = 4
settings.sampling.samples = 68
bpy.ops.render.render()
settings.sampling.integrator = 'REFERENCE'
settings.sampling.samples = 256
bpy.ops.render.render()
mixed, reference = (picture[0]["Combined"][..., :3] for picture in pictures)
assert pictures[0][1].samples == 68
assert np.abs(mixed.mean((0, 1)) / reference.mean((0, 1)) - 1.0).max() < 0.03, (mixed.mean(), reference.mean())
""",
}
"""What is run after the scene is set up, each in a scene of its own, one after another in one process"""

RUNNER = """
import json, traceback
import bpy, burnish, numpy as np
from burnish.addon import final

burnish.register()
setup, scripts, errors = *json.loads(sys.argv[1]), {}
for name, script in scripts.items():
    errors[name] = ""
    try:
        exec(setup + script, {"bpy": bpy, "np": np, "final": final, "folder": sys.argv[2]})
    except Exception:
        errors[name] = traceback.format_exc()
burnish.unregister()
print("RESULT " + json.dumps(errors))
"""


@pytest.fixture(scope="module")
def errors(run_python: Run, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return what each script has raised, as text, "" where it ended well."""
    result = run_python(RUNNER, json.dumps([SCENE, SCRIPTS]), tmp_path_factory.mktemp("frames"), timeout=TIMEOUT)
    assert result.returncode == 0, result.stdout + result.stderr
    return json.loads(result.stdout.rpartition("RESULT ")[2])


RENDERS = """
from burnish.addon.cli import main
raise SystemExit(any([main(arguments) for arguments in json.loads(sys.argv[1])]))
"""


def test_command_line(run_python: Run, tmp_path: Path) -> None:
    """Render frames with a table of timings, the same bits twice, and a debug view that is another picture."""
    def render(*commands: tuple[str, ...]) -> str:
        arguments = [["render", str(CORNELL), "--output", str(tmp_path / name), "--size", "48", "32", "--samples", "3",
                      "--integrator", "realtime", "--device", "cpu", *more] for name, *more in commands]
        result = run_python("import json" + RENDERS, json.dumps(arguments), timeout=TIMEOUT)
        assert result.returncode == 0 and result.stderr == "", result.stdout + result.stderr
        return result.stdout

    text = render(("normals.exr", "--debug-view", "gbuffer.normal"), ("first.exr", "--timings"))
    assert re.search(r"^one frame +[\d.]+ ms$", text, re.M), text
    sections = re.findall(r"^  \S.*? +([\d.]+) ms$", text, re.M)
    assert len(sections) > 8
    total = float(re.search(r"^one frame +([\d.]+) ms$", text, re.M)[1])
    assert sum(map(float, sections)) == pytest.approx(total, rel=0.01)
    assert re.search(r"^approximated: reflections of a roughness from 0.6 on take diffuse light", text, re.M), text
    # Not always the last line: Blender 5.0 speaks of memory as it ends.
    assert any(line.startswith(f"{tmp_path / 'first.exr'} 48x32 3 samples") for line in text.splitlines()), text
    # Another process; the timed frame runs section by section.
    render(("second.exr",))
    normals, picture, second = (np.asarray(oiio.ImageBuf(str(tmp_path / f"{name}.exr")).get_pixels(oiio.FLOAT))[..., :3]
                                for name in ("normals", "first", "second"))
    assert np.isfinite(picture).all() and (picture > 0.0).mean() > 0.9
    np.testing.assert_array_equal(second, picture)
    assert normals.min() >= 0.0 and normals.max() <= 1.0 and np.abs(normals - picture).mean() > 0.1


def test_light_passes_make_up_the_picture(errors: dict[str, str]) -> None:
    """Combine Diffuse Direct, Indirect and Color to the picture of a scene without any other light."""
    assert errors["light passes make up the picture"] == ""


def test_animation_frames_do_not_depend_on_each_other(errors: dict[str, str]) -> None:
    """Render the same second frame after a first one with Persistent Data as on its own."""
    assert errors["animation frames do not depend on each other"] == ""


def test_more_frames_than_the_filters_take(errors: dict[str, str]) -> None:
    """Go over to path tracing after the frames at rest: close to the reference, which the report then allows for."""
    assert errors["more frames than the filters take"] == ""
