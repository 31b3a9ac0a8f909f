# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a scene by both engines, for scripts of tests that compare them; run through the fixture run_pictures."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Any

import bpy
import burnish
import mathutils
import numpy as np
import OpenImageIO as oiio
from burnish.addon import final

DEVICE, FOLDER = sys.argv[1:3]
"""As settings name it; for files"""

Place = Sequence[float]


def new_scene() -> bpy.types.Scene:
    """Register the engine once and return an empty scene."""
    if not hasattr(bpy.types.Scene, "burnish"):
        burnish.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def add_camera(scene: bpy.types.Scene, place: Place, target: Place | None = None) -> bpy.types.Object:
    """Return a camera that looks at a target, down without one; the scene's."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = place
    if target is not None:
        way = mathutils.Vector(target) - camera.location
        camera.rotation_euler = way.to_track_quat('-Z', 'Y').to_euler()
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


def look_down(scene: bpy.types.Scene, place: Place, width: float) -> None:
    """Look down in parallel on so many metres, and leave colors as they are."""
    camera = add_camera(scene, place)
    camera.data.type, camera.data.ortho_scale = 'ORTHO', width
    scene.view_settings.view_transform = 'Raw'


def picture(
    scene: bpy.types.Scene, engine: str, size: tuple[int, int], samples: int, integrator: str = 'REFERENCE',
) -> tuple[np.ndarray, list[str]]:
    """Return a picture, rows from above, [h, w, 3 or 4], and reports of it if it is Burnish's.

    Path-traced, unless `integrator` says otherwise. Pixels are boxes, for both alike.
    """
    render = scene.render
    render.engine, (render.resolution_x, render.resolution_y) = engine, size
    settings = scene.cycles
    settings.samples, settings.use_adaptive_sampling, settings.use_denoising = samples, False, False
    settings.pixel_filter_type = 'BOX'
    sampling = scene.burnish.sampling
    sampling.samples, sampling.integrator = samples, integrator
    scene.burnish.film.pixel_filter, scene.burnish.device = 'BOX', DEVICE
    render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR', '32'
    render.filepath = f"{FOLDER}/{engine}.exr"
    reports: list[str] = []

    def keep(layer: str, view: str, pixels: Any, information: Any) -> None:
        reports.append(information.report.text())

    final.on_finished[:] = [keep]
    bpy.ops.render.render(write_still=True)
    return np.array(oiio.ImageBuf(render.filepath).get_pixels()), reports


def finish(result: Any) -> None:
    """Hand the result to the test."""
    burnish.unregister()
    print("RESULT " + json.dumps(result))
