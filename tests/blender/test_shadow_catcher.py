# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow catchers against Cycles: a ball on a plane under a sun and a sky, with a clear film and before the world."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

CODE = r'''
def build(kind):
    scene = new_scene()
    scene.world = bpy.data.worlds.new("World")
    background = scene.world.node_tree.nodes["Background"]
    background.inputs[0].default_value, background.inputs[1].default_value = (0.3, 0.5, 0.8, 1.0), 0.6
    add_camera(scene, (0.0, -6.0, 3.0), (0.0, 0.0, 0.6))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", 'SUN'))
    sun.data.energy, sun.data.angle, sun.rotation_euler = 3.0, 0.05, (0.6, 0.5, 0.0)
    scene.collection.objects.link(sun)
    bpy.ops.mesh.primitive_plane_add(size=12)
    plane = bpy.context.object
    plane.is_shadow_catcher = True
    plane.data.materials.append(bpy.data.materials.new("floor"))
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, location=(0.0, 0.0, 1.0))
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    ball.data.materials.append(bpy.data.materials.new("ball"))
    node = ball.data.materials[0].node_tree.nodes["Principled BSDF"]
    node.inputs["Base Color"].default_value = (0.8, 0.1, 0.05, 1.0)
    if kind == "mirror":
        node.inputs["Metallic"].default_value, node.inputs["Roughness"].default_value = 1.0, 0.05
    if kind == "wall":
        bpy.ops.mesh.primitive_cube_add(size=2, location=(2.2, 1.0, 1.0))
        bpy.context.object.is_shadow_catcher = True
    return scene

def picture(scene, engine, samples):
    render = scene.render
    render.engine, render.resolution_x, render.resolution_y = engine, 96, 60
    settings = scene.cycles
    settings.samples, settings.use_adaptive_sampling, settings.use_denoising = samples, False, False
    settings.sample_clamp_indirect, settings.blur_glossy, settings.pixel_filter_type = 0, 0, 'BOX'
    settings.max_bounces = settings.diffuse_bounces = settings.glossy_bounces = 32
    scene.burnish.device, scene.burnish.film.pixel_filter = DEVICE, 'BOX'
    scene.burnish.sampling.samples = samples
    render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR', '32'
    render.image_settings.color_mode = 'RGBA'
    render.filepath = f"{FOLDER}/{engine}.exr"
    made = []
    final.on_finished[:] = [lambda layer, view, pixels, information: made.append(information.report.text())]
    bpy.ops.render.render(write_still=True)
    return np.array(oiio.ImageBuf(render.filepath).get_pixels()), made

def parts(scene, engine, samples):
    """Return Combined and the pass Shadow Catcher."""
    layer, settings = scene.view_layers[0], scene.render.image_settings
    layer.cycles.use_pass_shadow_catcher = True
    scene.render.film_transparent = True
    picture(scene, engine, samples)
    if hasattr(settings, "media_type"):
        settings.media_type = 'MULTI_LAYER_IMAGE'
    settings.file_format, scene.render.filepath = 'OPEN_EXR_MULTILAYER', f"{FOLDER}/parts_{engine}.exr"
    bpy.ops.render.render(write_still=True)
    found, number = {}, 0
    while number < oiio.ImageBuf(scene.render.filepath).nsubimages:
        part = oiio.ImageBuf(scene.render.filepath, number, 0)
        for channel, name in enumerate(part.spec().channelnames):
            found[name.removeprefix("ViewLayer.")] = np.array(part.get_pixels())[..., channel]
        number += 1
    if hasattr(settings, "media_type"):
        settings.media_type = 'IMAGE'
    return [np.stack([found[f"{name}.{channel}"] for channel in channels], -1)
            for name, channels in (("Combined", "RGBA"), ("Shadow Catcher", "RGB"))]

results = {}
for kind in ("ball", "wall", "none"):
    scene = build(kind)
    for each in scene.objects if kind == "none" else ():
        each.is_shadow_catcher = False
    ours, cycles = parts(scene, 'BURNISH', 96), parts(scene, 'CYCLES', 256)
    results[f"pass, {kind}"] = [[[each.mean((0, 1)).tolist() for each in both] for both in (ours, cycles)],
                                [float(np.abs(a - b).mean()) for a, b in zip(ours, cycles)]]
for kind, transparent in (("ball", True), ("ball", False), ("mirror", True), ("wall", True), ("wall", False)):
    scene = build(kind)
    scene.render.film_transparent = transparent
    ours, report = picture(scene, 'BURNISH', 96)
    cycles, _ = picture(scene, 'CYCLES', 256)
    results[f"{kind}, {'clear' if transparent else 'world'}"] = [
        ours.mean((0, 1)).tolist(), cycles.mean((0, 1)).tolist(), float(np.abs(ours - cycles).mean()), report[0]]
scene = build("ball")
scene.render.film_transparent = True
scene.burnish.denoiser.final_denoise = True
# On the plane, beside the shadow.
denoised = picture(scene, 'BURNISH', 16)[0][40:58, 60:92, 3]
scene.burnish.denoiser.final_denoise = False
noisy = picture(scene, 'BURNISH', 16)[0][40:58, 60:92, 3]
results["denoised"] = [float(denoised.std()), float(noisy.std()), float(denoised.mean() - noisy.mean())]
finish(results)
'''


@pytest.fixture(scope="module")
def results(run_pictures: Callable[..., Any]) -> dict[str, list]:
    """Return by scene both engines' means, how far pixels are from each other, and the report."""
    return run_pictures(CODE)


@pytest.mark.parametrize("name", ["ball, clear", "ball, world", "mirror, clear", "wall, clear", "wall, world"])
def test_shadows_are_those_of_cycles(results: dict[str, list], name: str) -> None:
    """Give every channel and alpha Cycles' mean within 2 %, sparks in mirrors aside, and pixels its values."""
    ours, cycles, off, report = results[name]
    np.testing.assert_allclose(ours[3], cycles[3], rtol=0.01)
    np.testing.assert_allclose(ours, cycles, rtol=0.06 if name.startswith("mirror") else 0.02)
    assert off < 0.01 and cycles[3] > 0.2, (off, cycles)
    assert "path-traced" in report and "not drawn" not in report


@pytest.mark.parametrize("kind", ["ball", "wall", "none"])
def test_the_pass_is_that_of_cycles(results: dict[str, list], kind: str) -> None:
    """Give the shadow as a factor for backgrounds, more light included; then the picture lacks it, as in Cycles."""
    (ours, cycles), off = results[f"pass, {kind}"]
    np.testing.assert_allclose(ours[0], cycles[0], rtol=0.02)
    np.testing.assert_allclose(ours[1], cycles[1], rtol=0.005)
    assert max(off) < 0.01, off
    if kind == "none":
        assert ours[1] == [1.0, 1.0, 1.0]
    else:
        assert ours[1][2] < 0.97


def test_denoised_shadows_are_smooth(results: dict[str, list]) -> None:
    """Denoise alpha too, where the shadow is."""
    denoised, noisy, off = results["denoised"]
    assert denoised < 0.6 * noisy and abs(off) < 0.3 * noisy, (denoised, noisy, off)
