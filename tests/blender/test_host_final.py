# SPDX-License-Identifier: GPL-3.0-or-later
"""Final renders through Blender with a fake session: sizes, passes, layers, views, cancellation, failures."""

from __future__ import annotations

from pathlib import Path

import pytest

PREAMBLE = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})
import os, bpy, numpy as np
from host_fakes import FakeExtractor, FakeSession, register_with_fakes
final = register_with_fakes()
scene = bpy.context.scene
render = scene.render
pictures = []
final.on_finished.append(lambda *arguments: pictures.append(arguments))
"""
EPILOGUE = "\nimport burnish; burnish.unregister(); print('done')"


@pytest.fixture
def run_host(run_python):
    """Return a function that runs a script with the add-on registered over fakes, and checks that it ends well."""

    def run(script: str, *arguments: object):
        result = run_python(PREAMBLE + script + EPILOGUE, *arguments)
        assert result.returncode == 0 and result.stdout.rstrip().endswith("done"), result.stdout + result.stderr
        return result

    return run


def test_failure_raises_and_writes_nothing(run_host, tmp_path):
    """Make every failure of extraction or engine raise in the operator, save no file and free the session."""
    target = tmp_path / "frame.png"
    result = run_host(f"""
render.filepath = {str(target)!r}
for failure in ("open", "update", "configure", "step", "read", "extract"):
    FakeExtractor.fail_in_extract, FakeSession.fail_in = failure == "extract", failure
    try:
        bpy.ops.render.render(write_still=True)
        raise SystemExit(f"the operator did not raise: {{failure}}")
    except RuntimeError as error:
        assert "Burnish: Unexpected" in str(error) and f"made to fail in {{failure}}" in str(error), error
    assert not os.path.exists({str(target)!r}), failure
    assert all(session.closed for session in FakeSession.opened), failure
assert not pictures
FakeSession.fail_in, FakeExtractor.fail_in_extract = "", False
bpy.ops.render.render(write_still=True)
assert os.path.exists({str(target)!r})
assert all(session.closed for session in FakeSession.opened)
""")
    assert result.stderr.count("Traceback") == 6, result.stderr


def test_a_gpu_begins_with_more_samples_than_a_processor(run_host):
    """Begin with one sample on a processor, which stops soon; on a GPU with more than those that end paths sooner."""
    run_host("""
scene.burnish.sampling.integrator = "REFERENCE"
for device, samples, limit, first in (
        ("cpu", 20, 0.0, 1), ("cuda:0", 20, 0.0, 4), ("cuda:0", 2, 0.0, 2), ("cuda:0", 20, 9.0, 1)):
    FakeSession.device = device
    scene.burnish.sampling.samples, scene.burnish.sampling.time_limit = samples, limit
    bpy.ops.render.render()
    assert FakeSession.opened[-1].steps[0][0] == first, (device, samples, limit, FakeSession.opened[-1].steps)
""")


def test_failure_ends_an_animation_at_its_first_frame(run_host, tmp_path):
    """Stop an animation that fails, without a single file."""
    run_host(f"""
FakeSession.fail_in = "step"
render.filepath = {str(tmp_path) + "/"!r}
scene.frame_end = 3
try:
    bpy.ops.render.render(animation=True)
    raise SystemExit("the operator did not raise")
except RuntimeError:
    pass
assert len(FakeSession.opened) == 1, len(FakeSession.opened)
""")
    assert not list(tmp_path.iterdir())


def test_user_errors_are_their_own_sentence(run_host):
    """Report an engine error with its sentence alone, without type or traceback."""
    result = run_host("""
from burnish.engine.errors import OutOfDeviceMemory
def raising(settings):
    raise OutOfDeviceMemory("The scene needs 9 GiB; the device has 8")
final.open_session = raising
try:
    bpy.ops.render.render()
    raise SystemExit("the operator did not raise")
except RuntimeError as error:
    assert "Burnish: The scene needs 9 GiB; the device has 8" in str(error), error
""")
    assert "Traceback" not in result.stderr


def test_passes_are_written(run_host, tmp_path):
    """Write every pass of the table under Blender's names, and only those asked for."""
    target = tmp_path / "passes.exr"
    run_host(f"""
layer = scene.view_layers[0]
for name in ("z", "position", "normal", "uv", "object_index", "material_index", "emit", "environment", "mist",
             "ambient_occlusion", "shadow", "cryptomatte_object", "cryptomatte_asset"):
    setattr(layer, f"use_pass_{{name}}", True)
layer.pass_cryptomatte_depth = 2
for name, kind in (("heat", 'COLOR'), ("weight", 'VALUE')):
    aov = layer.aovs.add()
    aov.name, aov.type = name, kind
settings = render.image_settings
settings.media_type = 'MULTI_LAYER_IMAGE'
settings.file_format, settings.color_depth = 'OPEN_EXR_MULTILAYER', '32'
render.filepath = {str(target)!r}
bpy.ops.render.render(write_still=True)
names = set(pictures[0][2])
assert names == {{"Combined", "Depth", "Position", "Normal", "UV", "Object Index", "Material Index", "Emission",
                 "Environment", "Mist", "Ambient Occlusion", "Shadow", "CryptoObject00", "CryptoAsset00", "heat",
                 "weight"}}, names
layer.use_pass_z = False
bpy.ops.render.render()
assert "Depth" not in pictures[1][2]
""")
    names, ramp = read_parts(target)
    for expected in ("Combined.R", "Depth.Z", "Position.X", "Normal.X", "UV.U", "Object Index.X", "Material Index.X",
                     "Emission.R", "Environment.R", "Mist.Z", "Ambient Occlusion.R", "CryptoObject00.r",
                     "CryptoAsset00.a", "heat.A", "weight.X"):
        assert f"ViewLayer.{expected}" in names, (expected, names)
    assert ramp == list(range(32))


def test_passes_that_are_not_there_are_named(run_host):
    """Name each pass once that a view layer asks for and no integrator has."""
    run_host("""
from burnish.addon import report
layer = scene.view_layers[0]
layer.use_pass_subsurface_direct = layer.use_pass_subsurface_color = layer.use_pass_mist = True
bpy.ops.render.render()
said = sorted(entry.message for entry in report.published("Render").entries() if "is left out" in entry.message)
assert said == [f"the pass {name} is left out; this version does not have it"
                for name in ("Subsurface Color", "Subsurface Direct")], said
""")


def test_integrators_have_different_passes(run_host):
    """Give the passes of light by lobes with both, light groups with the path tracer alone, and say so once."""
    run_host("""
from burnish.addon import report
layer = scene.view_layers[0]
scene.use_nodes = True
light = {f"{lobe} {part}" for lobe in ("Diffuse", "Glossy", "Transmission") for part in ("Direct", "Indirect", "Color")}
for name in light:
    setattr(layer, f"use_pass_{name.lower().replace(' ', '_')}", True)
for name in ("Key", "Fill"):
    layer.lightgroups.add().name = name
both = {"Combined"} | light
for integrator, expected in (('REALTIME', both), ('REFERENCE', both | {"Combined_Key", "Combined_Fill"})):
    scene.burnish.sampling.integrator = integrator
    bpy.ops.render.render()
    assert set(pictures[-1][2]) == expected, pictures[-1][2].keys()
    said = [entry.message for entry in report.published("Render").entries() if "left out" in entry.message]
    assert said == ([] if integrator == 'REFERENCE' else [
        "the light groups Key, Fill are left out; the reference integrator has them"]), said
""")


def test_realtime_frames_start_cold_and_one_is_timed(run_host):
    """Forget history before each picture, measure the eighth frame alone, and tell the figures."""
    run_host("""
from burnish.addon import report
scene.burnish.sampling.integrator = 'REALTIME'
scene.burnish.sampling.samples = 20
bpy.ops.render.render()
session = FakeSession.opened[-1]
assert session.resets == 1 and pictures[0][3].samples == 20
timed = [index for index, (_, flag) in enumerate(session.steps) if flag]
assert len(timed) == 1 and session.steps[timed[0]][0] == 1, session.steps
assert sum(count for count, _ in session.steps[:timed[0]]) == 7, session.steps
assert pictures[0][3].frame_times == {"Surfaces": 1.0, "Composite": 0.5}
assert "Real-time frame: 1.50 ms" in report.published_text(), report.published_text()
scene.burnish.sampling.samples = 1
bpy.ops.render.render()
assert FakeSession.opened[-1].steps == [(1, True)]
scene.burnish.sampling.integrator = 'REFERENCE'
bpy.ops.render.render()
assert not pictures[2][3].frame_times and not FakeSession.opened[-1].was_timed
""")


def test_debug_views_stay_out_of_final_renders(run_host):
    """Ignore the scene's debug view, which is for viewports, but show the one that the command line asks for."""
    run_host("""
scene.burnish.sampling.integrator = 'REALTIME'
scene.burnish.debug.view = 'cache.light'
bpy.ops.render.render()
assert FakeSession.opened[-1].settings.debug.view == ""
final.debug_view = "probes.radiance"
bpy.ops.render.render()
assert FakeSession.opened[-1].settings.debug.view == "probes.radiance"
""")


def read_parts(path: Path) -> tuple[list[str], list[float]]:
    """Return all channel names of a multi-part EXR and the first row of its first channel."""
    import OpenImageIO as oiio

    image, names, part = oiio.ImageInput.open(str(path)), [], 0
    ramp = image.read_image("float")[0, :, 0].tolist()
    while image.seek_subimage(part, 0):
        names += image.spec().channelnames
        part += 1
    return names, ramp


@pytest.mark.parametrize("cropped", [pytest.param(False, marks=pytest.mark.slow), True])
def test_border(run_host, tmp_path, cropped):
    """Render inside the border only; Blender keeps the frame's size unless it is cropped to."""
    target = tmp_path / "border.exr"
    run_host(f"""
render.use_border, render.use_crop_to_border = True, {cropped}
render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.5, 1.0
render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR', '32'
render.filepath = {str(target)!r}
bpy.ops.render.render(write_still=True)
assert FakeSession.opened[0].configured[0][2:5] == (32, 18, (8, 9, 16, 9)), FakeSession.opened[0].configured
assert pictures[0][2]["Combined"].shape == (9, 16, 4)
assert pictures[0][3].crop == (8, 9, 16, 9)
""")
    import OpenImageIO as oiio

    pixels = oiio.ImageInput.open(str(target)).read_image("float")
    if cropped:
        assert pixels.shape[:2] == (9, 16)
        assert pixels[0, :, 0].tolist() == list(range(8, 24))
    else:
        assert pixels.shape[:2] == (18, 32)
        assert pixels[0, 8:24, 0].tolist() == list(range(8, 24))
        assert not pixels[:, :8].any() and not pixels[9:].any()


def test_percentage_and_layers(run_host):
    """Render each enabled view layer once, at the resolution's percentage."""
    run_host("""
render.resolution_percentage = 50
scene.view_layers.new("Second")
scene.view_layers.new("Off").use = False
bpy.ops.render.render()
assert [picture[0] for picture in pictures] == ["ViewLayer", "Second"], pictures
assert all(picture[2]["Combined"].shape == (9, 16, 4) for picture in pictures)
assert len(FakeSession.opened) == 2 and all(session.closed for session in FakeSession.opened)
""")


def test_stereo_views(run_host):
    """Render both eyes from cameras on either side, from one scene upload."""
    run_host("""
render.use_multiview = True
scene.camera.data.stereo.interocular_distance = 0.2
bpy.ops.render.render()
assert [picture[1] for picture in pictures] == ["left", "right"], pictures
session, = FakeSession.opened
left, right = (np.array(config[1].transform).reshape(4, 4) for config in session.configured)
axis = np.array(scene.camera.matrix_world.normalized())[:3, 0]
assert abs((right - left)[:3, 3] @ axis - 0.2) < 1e-4, (left, right)
windows = [config[1].window for config in session.configured]
assert windows[0][0] > windows[1][0], windows  # Off-axis convergence: each eye's window leans to the other side.
""")


def test_cancel_is_quick_and_keeps_what_is_done(run_host):
    """End within 0.2 s of a cancellation, in the middle of a slow sample."""
    run_host("""
import time
from burnish.addon.progress import Cancelled
FakeSession.step_seconds = 30.0

class FakeEngine:
    is_preview, camera_override, resolution_x, resolution_y = False, None, 32, 18
    failures, ended = [], []
    def __init__(self):
        self.deadline = time.perf_counter() + 0.5
    def test_break(self):
        return time.perf_counter() > self.deadline
    def begin_result(self, x, y, w, h, layer="", view=""):
        from types import SimpleNamespace
        return SimpleNamespace(layers=[SimpleNamespace(passes=[])])
    def end_result(self, result, cancel=False):
        self.ended.append(cancel)
    def report(self, kind, text):
        self.failures.append(text)
    error_set = active_view_set = lambda self, text: None
    update_stats = lambda self, stats, text: None
    update_progress = lambda self, value: None
    update_memory_stats = lambda self, memory_used, memory_peak: None

engine = FakeEngine()
final.render(engine, bpy.context.evaluated_depsgraph_get())
assert time.perf_counter() - engine.deadline < 0.2, time.perf_counter() - engine.deadline
assert engine.ended == [False] and not engine.failures, (engine.ended, engine.failures)
assert pictures[0][3].cancelled and pictures[0][3].samples == 0
assert FakeSession.opened[0].closed
""")


def test_time_limit(run_host):
    """Stop sampling at the time limit, with at least one sample."""
    run_host("""
FakeSession.step_seconds = 0.05
scene.burnish.sampling.samples = 100000
scene.burnish.sampling.time_limit = 0.3
bpy.ops.render.render()
information = pictures[0][3]
assert 1 <= information.samples < 20 and 0.2 < information.seconds < 1.0, information
scene.burnish.sampling.time_limit = 0.001
bpy.ops.render.render()
assert pictures[1][3].samples == 1, pictures[1][3]
""")


def test_farm_lines(run_host):
    """Print lines that Deadline Cloud's pattern matches, the last of them at 100 %."""
    import re

    result = run_host("bpy.ops.render.render()")
    found = re.findall(r"^Fra:.*Sample (\d+)/(\d+)$", result.stdout, re.MULTILINE)
    assert found and found[-1] == ("4", "4"), result.stdout


def test_report_is_published(run_host):
    """Show entries of extraction and engine, with figures, after a render."""
    run_host("""
from burnish.addon import report
bpy.ops.render.render()
text = report.published_text()
assert "Noise Texture replaced by its mean" in text and "volumes are not drawn" in text, text
assert "Triangles: 12" in text, text
""")


@pytest.mark.parametrize("persistent", [pytest.param(False, marks=pytest.mark.slow), True])
def test_animation_keeps_its_session_with_persistent_data(run_host, tmp_path, persistent):
    """Open a session for each frame, or one for all with Persistent Data; close all of them in the end."""
    run_host(f"""
render.use_persistent_data = {persistent}
render.filepath = {str(tmp_path) + "/"!r}
scene.frame_end = 3
bpy.ops.render.render(animation=True)
assert len(FakeSession.opened) == (1 if {persistent} else 3), len(FakeSession.opened)
assert [picture[3].frame for picture in pictures] == [1, 2, 3]
if {persistent}:
    FakeSession.fail_in = "step"
    try:
        bpy.ops.render.render()
        raise SystemExit("the operator did not raise")
    except RuntimeError:
        pass
assert all(session.closed for session in FakeSession.opened)
""")
    assert len(list(tmp_path.iterdir())) == 3
