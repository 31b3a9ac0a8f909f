# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur of final renders: against what a moving square leaves, against Cycles, and beside passes."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

TIMEOUT = 600.0
"""The first run may have to build all kernels"""
SIDE, SPEED, SHUTTER = 8.0, 20.0, 0.5
"""Of the square [px], [px per frame], [frames]"""
WIDTH, HEIGHT = 64, 36

SETUP = """
import bpy, burnish, numpy as np
import addon_utils

folder, side, speed, shutter, width, height = sys.argv[1], *map(float, sys.argv[2:])
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable("cycles")
burnish.register()
from burnish.addon import final, report
scene, kept = bpy.context.scene, []
render, sampling = scene.render, scene.burnish.sampling
render.engine, scene.burnish.device, scene.burnish.film.pixel_filter = 'BURNISH', 'CPU', 'BOX'
render.resolution_x, render.resolution_y, render.resolution_percentage = int(width), int(height), 100
render.use_motion_blur, render.motion_blur_shutter = True, shutter
sampling.samples, sampling.integrator = 128, 'REFERENCE'
final.on_finished.append(lambda layer, view, passes, info: kept.append((passes, info)))
result = {}


def keys(owner, path, **values):
    for frame, value in values.items():
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=int(frame[1:]))
    for layer in owner.id_data.animation_data.action.layers:
        for curve in (curve for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves):
            for point in curve.keyframe_points:
                point.interpolation = 'LINEAR'


def picture(name, **options):
    old = {path: getattr(render, path) for path in options}
    for path, value in options.items():
        setattr(render, path, value)
    bpy.ops.render.render()
    for path, value in old.items():
        setattr(render, path, value)
    assert scene.frame_current_final == frame, (name, scene.frame_current_final)
    result[name] = kept[-1][0]["Combined"]
    result[name + " samples"] = kept[-1][1].samples
    result[name + " report"] = kept[-1][1].report.text()
"""

SQUARE = SETUP + """
material = bpy.data.materials.new("Light")
nodes = material.node_tree.nodes
nodes.clear()
light = nodes.new("ShaderNodeEmission")
material.node_tree.links.new(light.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs[0])
bpy.ops.mesh.primitive_plane_add(size=side)
square = bpy.context.object
square.data.materials.append(material)
bpy.ops.object.camera_add(location=(0.0, 0.0, 10.0))
camera = scene.camera = bpy.context.object
camera.data.type, camera.data.ortho_scale = 'ORTHO', width
frame = 10.0
scene.frame_set(10)

picture("unmoved")
picture("still", use_motion_blur=False)
keys(square, "location", f9=(-speed, 0, 0), f11=(speed, 0, 0))
scene.frame_set(10)
for position in ('START', 'CENTER', 'END'):
    picture(position, motion_blur_position=position)
sampling.integrator = 'REALTIME'
picture("realtime")
sampling.integrator = 'REFERENCE'
sampling.samples = 50
picture("odd")
sampling.samples, sampling.time_limit = 1 << 22, 2.0
picture("limit")
result["limit seconds"] = kept[-1][1].seconds
sampling.samples, sampling.time_limit = 128, 0.0
layer = scene.view_layers[0]
layer.use_motion_blur = False
picture("layer off")
layer.use_motion_blur = True
frame = 9.75
scene.frame_set(9, subframe=0.75)
picture("subframe")
frame = 10.0
scene.frame_set(10)
mapping = render.motion_blur_shutter_curve
for point, height in zip(mapping.curves[0].points, (0.0, 0.5, 1.0)):
    point.location.y = height
    point.handle_type = 'VECTOR'
mapping.update()
picture("curve")
for point in mapping.curves[0].points:
    point.location.y = 1.0
mapping.update()

square.pass_index = 3
for name in ("z", "position", "normal", "uv", "object_index", "emit", "environment", "vector", "cryptomatte_object",
             "diffuse_direct"):
    setattr(layer, f"use_pass_{name}", True)
picture("passes")
for name, pixels in kept[-1][0].items():
    result["pass " + name] = pixels
for name in ("z", "position", "normal", "uv", "object_index", "emit", "environment", "vector", "cryptomatte_object",
             "diffuse_direct"):
    setattr(layer, f"use_pass_{name}", False)
if burnish.addon.oidn.library() is not None:
    scene.burnish.denoiser.final_denoise, sampling.samples = True, 32
    picture("denoised")
    scene.burnish.denoiser.final_denoise, sampling.samples = False, 128

square.animation_data_clear()
square.location.x = 0.0
keys(camera, "location", f9=(speed, 0, 10), f11=(-speed, 0, 10))
scene.frame_set(10)
picture("camera")
other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))
scene.collection.objects.link(other)
for number, each in ((1, camera), (10, other), (11, camera)):
    scene.timeline_markers.new(each.name, frame=number).camera = each
other.data.type, other.data.ortho_scale, other.location = 'ORTHO', width, (5.0, 0.0, 10.0)
scene.frame_set(10)
picture("marker")
assert scene.camera == other
scene.timeline_markers.clear()
scene.camera = camera
camera.animation_data_clear()
camera.location.x = 0.0
square.shape_key_add(name="Basis")
key = square.shape_key_add(name="Far")
for point in key.data:
    point.co.x += speed
square.data.shape_keys.use_relative = True
key.slider_min, key.slider_max = -1.0, 1.0
keys(key, "value", f9=-1.0, f11=1.0)
scene.frame_set(10)
picture("shape")
for persistent in (False, True):
    render.use_persistent_data = persistent
    for frame in (9.75, 10.0):
        scene.frame_set(int(frame), subframe=frame % 1.0)
        picture(f"persistent {persistent} {frame}")
render.use_persistent_data = False
square.shape_key_clear()
keys(light.inputs[1], "default_value", f9=0.0, f11=2.0)
scene.frame_set(10)
picture("strength", motion_blur_shutter=2.0)
light.inputs[1].default_value = 1.0
material.node_tree.animation_data_clear()
keys(square, "hide_render", f1=False, f10=True)
scene.frame_set(10)
picture("hidden")
scene.world = bpy.data.worlds.new("World")
background = scene.world.node_tree.nodes["Background"]
background.inputs[0].default_value = (1.0, 1.0, 1.0, 1.0)
keys(background.inputs[1], "default_value", f9=0.0, f11=2.0)
scene.frame_set(10)
picture("world", motion_blur_shutter=2.0)
np.savez(folder + "/square.npz", **result)
"""

AGAINST_CYCLES = SETUP + """
bpy.ops.mesh.primitive_plane_add(size=30.0)
bpy.ops.mesh.primitive_cube_add(size=1.5, location=(-1.0, 0.0, 0.75))
keys(bpy.context.object, "location", f9=(-2.2, 0.0, 0.75), f11=(0.0, 0.0, 0.95))
bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, location=(1.6, 0.0, 0.8))
ball = bpy.context.object
ball.shape_key_add(name="Basis")
tall = ball.shape_key_add(name="Tall")
for point in tall.data:
    point.co.z = point.co.z * 2.0 + 0.8
keys(tall, "value", f9=0.0, f11=1.0)
for name, place in (("Key", (-3.0, -3.0, 5.0)), ("Fill", (4.0, -1.0, 4.0))):
    lamp = bpy.data.lights.new(name, 'POINT')
    lamp.energy, lamp.shadow_soft_size = 500.0, 0.5
    each = bpy.data.objects.new(name, lamp)
    each.location = place
    scene.collection.objects.link(each)
bpy.ops.object.camera_add(location=(0.0, -8.0, 3.0), rotation=(1.3, 0.0, 0.0))
scene.camera = bpy.context.object
keys(scene.camera, "location", f9=(-0.5, -8.0, 3.0), f11=(0.5, -8.0, 3.2))
frame = 10.0
scene.frame_set(10)
render.motion_blur_position = 'START'
mapping = render.motion_blur_shutter_curve
for point, height in zip(mapping.curves[0].points, (1.0, 0.6, 0.1)):
    point.location.y = height
mapping.update()
sampling.samples, sampling.motion_steps = 512, 256
cycles = scene.cycles
cycles.device, cycles.samples, cycles.pixel_filter_type = 'CPU', 512, 'BOX'
cycles.use_denoising = cycles.use_adaptive_sampling = False
cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
settings = render.image_settings
settings.file_format, settings.color_depth = 'OPEN_EXR', '32'
import OpenImageIO as oiio
for name, engine, blur in (("burnish", 'BURNISH', True), ("cycles", 'CYCLES', True), ("sharp", 'CYCLES', False)):
    render.engine, render.use_motion_blur, render.filepath = engine, blur, f"{folder}/{name}.exr"
    bpy.ops.render.render(write_still=True)
    result[name] = oiio.ImageInput.open(render.filepath).read_image("float")[::-1, :, :3]
np.savez(folder + "/cycles.npz", **result)
"""


def run(script: str, folder: Path, name: str, run_python: Callable[..., subprocess.CompletedProcess]) -> dict:
    """Return the pictures and figures that a script saves."""
    process = run_python(script, folder, SIDE, SPEED, SHUTTER, WIDTH, HEIGHT, timeout=TIMEOUT)
    assert process.returncode == 0, process.stdout + process.stderr
    return dict(np.load(folder / name))


@pytest.fixture(scope="module")
def square(tmp_path_factory, run_python) -> dict:
    """Return pictures of a square of radiance 1 that moves to the right."""
    return run(SQUARE, tmp_path_factory.mktemp("square"), "square.npz", run_python)


def profile(picture: np.ndarray) -> np.ndarray:
    """Return the mean of the rows that the square covers."""
    middle, half = HEIGHT // 2, int(SIDE / 2) - 1
    return picture[middle - half:middle + half, :, 0].mean(0)


def expected(opens: float, closes: float, weigh: Callable[[float], float] = lambda part: 1.0) -> np.ndarray:
    """Return the profile of a shutter that is open between two times [frames] from the frame, when x is 0."""
    left = np.arange(WIDTH) - 0.5 * WIDTH
    parts = (np.arange(2000) + 0.5) / 2000
    weights = np.array([weigh(part) for part in parts])
    x = SPEED * (opens + parts * (closes - opens))
    low = np.maximum(left[:, None], x - 0.5 * SIDE)
    high = np.minimum(left[:, None] + 1.0, x + 0.5 * SIDE)
    return np.maximum(high - low, 0.0) @ weights / weights.sum()


ENERGY = SIDE * SIDE
SLACK = 0.03
"""An edge passes a pixel during a tenth of the shutter: there lie 3 of 32 moments, of which one may as well not; the
rest is noise"""


@pytest.mark.parametrize(("name", "opens", "closes"), [
    ("START", 0.0, 0.5), ("CENTER", -0.25, 0.25), ("END", -0.5, 0.0), ("camera", -0.25, 0.25),
    ("shape", -0.25, 0.25), ("odd", -0.25, 0.25), ("realtime", -0.25, 0.25), ("subframe", -0.5, 0.0),
    ("limit", -0.25, 0.25)])
def test_moving_square_leaves_a_trapezoid(square, name, opens, closes):
    """Spread a square's light over its way: moved by itself, by the camera, by its shape, with either integrator."""
    np.testing.assert_allclose(profile(square[name]), expected(opens, closes), atol=SLACK)
    assert abs(square[name][..., 0].sum() / ENERGY - 1.0) < 0.01


def test_the_curve_weighs_time(square):
    """Show more of what a shutter sees that opens slowly."""
    np.testing.assert_allclose(profile(square["curve"]), expected(-0.25, 0.25, lambda part: part), atol=SLACK)
    assert abs(square["curve"][..., 0].sum() / ENERGY - 1.0) < 0.01


def test_whatever_is_animated_blurs(square):
    """Average a material's and the world's strength over the shutter, and a thing that is hidden half of the time."""
    assert abs(square["strength"][..., 0].sum() / ENERGY - 1.0) < 0.02
    assert abs(square["hidden"][..., 0].sum() / ENERGY - 0.5) < 0.02
    assert abs(square["world"][0, 0, 0] - 1.0) < 0.02


def test_unmoved_pictures_are_the_same(square):
    """Take the same samples where nothing moves, whatever the number of moments; none where the layer has no blur."""
    np.testing.assert_array_equal(square["unmoved"], square["still"])
    np.testing.assert_array_equal(square["layer off"], square["still"])


def test_samples_are_as_many_as_asked_for(square):
    """Give each picture its samples, and one with a time limit as many as there is time for."""
    counts = [int(square[f"{name} samples"]) for name in ("still", "CENTER", "unmoved", "odd")]
    assert counts == [128, 128, 128, 50]
    assert 32 <= int(square["limit samples"]) < 1 << 22 and int(square["limit samples"]) % 32 == 0
    assert square["limit seconds"] < 4.0


def test_realtime_pictures_are_path_traced(square):
    """Make the same picture with either integrator, and say so once; say nothing else of motion blur."""
    np.testing.assert_array_equal(square["realtime"], square["CENTER"])
    assert str(square["realtime report"]) == "info: motion blur is path-traced"
    assert not str(square["CENTER report"]) and not str(square["still report"])


def test_the_camera_stays_the_frame_s_own(square):
    """Look through one camera all the time where a marker changes it within the shutter."""
    picture = np.roll(square["still"], -5, 1)
    np.testing.assert_allclose(square["marker"], picture, atol=0.02)


def test_data_passes_are_of_the_frame(square):
    """Show surfaces where they are at the frame itself, light where it was while the shutter was open."""
    still = square["still"][..., 0]
    assert (square["pass Object Index"][..., 0] == 3.0 * (still > 0.5)).all()
    np.testing.assert_allclose(square["pass Depth"][..., 0][still > 0.5], 10.0, rtol=1e-5)
    np.testing.assert_allclose(square["pass Normal"][..., 2], still, atol=1e-5)
    np.testing.assert_allclose(square["pass Emission"][..., 0], square["passes"][..., 0], atol=1e-5)
    np.testing.assert_array_equal(square["passes"], square["CENTER"])
    seen = square["pass Vector"][still > 0.5]
    np.testing.assert_allclose(np.abs(seen[:, ::2]), SPEED, rtol=1e-4)
    np.testing.assert_allclose(square["pass CryptoObject00"][..., 1], still, atol=0.01)


def test_denoised_pictures_stay_blurred(square):
    """Denoise with guides that are blurred as well."""
    if "denoised" not in square:
        pytest.skip("this Blender has no Open Image Denoise")
    np.testing.assert_allclose(profile(square["denoised"]), expected(-0.25, 0.25), atol=0.06)


def test_persistent_data_changes_nothing(square):
    """Render the same frames with Persistent Data."""
    for frame in (9.75, 10.0):
        np.testing.assert_allclose(
            square[f"persistent True {frame}"], square[f"persistent False {frame}"], atol=1e-5)


@pytest.mark.slow
def test_blur_is_that_of_cycles(tmp_path, run_python):
    """Blur objects, a shape, shadows and a camera as Cycles does, with a shutter that closes slowly."""
    found = run(AGAINST_CYCLES, tmp_path, "cycles.npz", run_python)
    ours, theirs, sharp = (found[name].astype(float) for name in ("burnish", "cycles", "sharp"))
    error = np.abs(ours - theirs).mean() / theirs.mean()
    blur = np.abs(sharp - theirs).mean() / theirs.mean()
    print("error", error, "blur", blur)
    # Noise of 512 samples of either.
    assert error < 0.02 and blur > 0.08, (error, blur)
    assert abs(ours.mean() / theirs.mean() - 1.0) < 0.005
