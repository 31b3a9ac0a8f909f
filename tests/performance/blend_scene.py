# SPDX-License-Identifier: GPL-3.0-or-later
"""A .blend file for measuring: its plain data for a Session, its camera, and Cycles' picture of the same.

Opened once; settings of all engines are made comparable (32 bounces, no clamping, no adaptive sampling, no caustics
tricks, Blackman-Harris filter 1.5 px). Main thread only: one file is open at a time.
"""

from __future__ import annotations

import dataclasses
import importlib
import sys
import tempfile
import time
from pathlib import Path

import bpy
import mathutils
import numpy as np
import OpenImageIO as oiio

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.addon.extract.camera import camera_from_scene  # noqa: E402
from burnish.addon.extract.scene import SceneExtractor  # noqa: E402
from burnish.engine.report import Report  # noqa: E402
from burnish.engine.scene import CameraData, SceneDelta  # noqa: E402

from tests.performance.matte_copy import make_matte  # noqa: E402

BOUNCES = 32
FILTER_WIDTH = 1.5


class BlendScene:
    """The scene of a .blend file, as a matte copy where asked for."""

    def __init__(self, path: Path, size: tuple[int, int], device: str, matte: bool = True):
        bpy.ops.wm.open_mainfile(filepath=str(Path(path).resolve()), load_ui=False, use_scripts=False)
        self.name, self.size, self.device = Path(path).stem, tuple(size), device
        self.scene = bpy.context.scene
        self.matte = make_matte(self.scene) if matte else 0
        self._release_camera()
        for item in bpy.data.objects:
            # The evaluated scene is the viewport's, Cycles renders the other.
            item.hide_viewport = item.hide_render
            for modifier in item.modifiers:
                modifier.show_viewport = modifier.show_render
                if modifier.type == 'SUBSURF':
                    modifier.levels = modifier.render_levels
        self._configure()
        self.exposure = float(self.scene.view_settings.exposure)
        self._matrix = self.scene.camera.matrix_world.copy()
        graph = bpy.context.evaluated_depsgraph_get()
        self.camera: CameraData = camera_from_scene(
            self.scene, self.scene.camera.evaluated_get(graph), *self.size)
        self.report = Report()

    def extract(self) -> SceneDelta:
        """Return everything in the scene, read anew."""
        return SceneExtractor().extract(bpy.context.evaluated_depsgraph_get(), viewport=False, report=self.report)

    def camera_for(self, size: tuple[int, int]) -> CameraData:
        """Return the camera for a picture of another size [px]."""
        graph = bpy.context.evaluated_depsgraph_get()
        return camera_from_scene(self.scene, self.scene.camera.evaluated_get(graph), *size)

    def cycles(self, samples: int, *, denoise: bool, camera: CameraData | None = None, seed: int = 0,
               ) -> tuple[np.ndarray, float]:
        """Return Cycles' picture [h, w, 3], scene-linear, bottom row first, and the wall seconds it took."""
        scene, cycles = self.scene, self.scene.cycles
        cycles.samples, cycles.seed, cycles.use_denoising = samples, seed, denoise
        if denoise:
            cycles.denoiser, cycles.denoising_use_gpu = 'OPENIMAGEDENOISE', cycles.device == 'GPU'
        scene.camera.matrix_world = self._matrix
        if camera is not None:
            scene.camera.matrix_world = mathutils.Matrix(np.array(camera.transform).reshape(4, 4).tolist())
        with tempfile.TemporaryDirectory() as folder:
            scene.render.filepath = str(Path(folder) / "cycles.exr")
            start = time.perf_counter()
            bpy.ops.render.render(write_still=True, scene=scene.name)
            seconds = time.perf_counter() - start
            picture = oiio.ImageBuf(scene.render.filepath).get_pixels(oiio.FLOAT)
        return np.ascontiguousarray(np.asarray(picture)[::-1, :, :3]), seconds

    def _release_camera(self) -> None:
        """Take the camera out of all that would move it back."""
        camera = self.scene.camera
        matrix = camera.matrix_world.copy()
        camera.parent = None
        camera.constraints.clear()
        camera.animation_data_clear()
        camera.matrix_world = matrix
        bpy.context.view_layer.update()

    def _configure(self) -> None:
        if "cycles" not in bpy.context.preferences.addons:
            bpy.ops.preferences.addon_enable(module="cycles")
        scene, render, cycles = self.scene, self.scene.render, self.scene.cycles
        render.engine = 'CYCLES'
        render.resolution_x, render.resolution_y = self.size
        render.resolution_percentage = 100
        render.use_border = render.use_compositing = render.use_sequencer = render.use_motion_blur = False
        render.use_persistent_data = True
        if hasattr(render.image_settings, "media_type"):
            render.image_settings.media_type = 'IMAGE'
        render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR', '32'
        render.image_settings.color_mode = 'RGB'
        for layer in list(scene.view_layers)[1:]:
            layer.use = False
        cycles.use_adaptive_sampling = cycles.use_animated_seed = cycles.use_guiding = False
        cycles.use_light_tree = True
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
        cycles.caustics_reflective = cycles.caustics_refractive = True
        cycles.time_limit, cycles.film_exposure = 0.0, 1.0
        for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max", "volume"):
            setattr(cycles, f"{kind}_bounces", BOUNCES)
        cycles.pixel_filter_type, cycles.filter_width = 'BLACKMAN_HARRIS', FILTER_WIDTH
        cycles.device = 'GPU' if self.device == "cuda" and choose_cuda() else 'CPU'


def choose_cuda() -> bool:
    """Give Cycles the CUDA devices; returns whether there is one."""
    preferences = bpy.context.preferences.addons["cycles"].preferences
    try:
        preferences.compute_device_type = 'CUDA'
    except TypeError:
        return False
    preferences.get_devices()
    for entry in preferences.devices:
        entry.use = entry.type == 'CUDA'
    return any(entry.use for entry in preferences.devices)


def moved(camera: CameraData, matrix: np.ndarray) -> CameraData:
    """Return a camera with another transform, camera to world [4, 4]."""
    return dataclasses.replace(camera, transform=tuple(np.asarray(matrix, np.float64).ravel().tolist()))
