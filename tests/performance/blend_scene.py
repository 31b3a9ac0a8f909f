# SPDX-License-Identifier: GPL-3.0-or-later
"""A .blend file for measuring: its plain data for a Session, its camera, and Cycles' picture of the same.

Opened once, with the benchmark's comparable settings (addon/bench_engines.py). Main thread only: one file is open at a
time.
"""

from __future__ import annotations

import importlib
import sys
import tempfile
from pathlib import Path

import bpy
import mathutils
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
importlib.import_module("tests.conftest")  # makes `burnish` this checkout

from burnish.addon.bench_engines import open_scene  # noqa: E402
from burnish.addon.bench_store import Job  # noqa: E402
from burnish.addon.extract.camera import camera_from_scene  # noqa: E402
from burnish.addon.extract.scene import SceneExtractor  # noqa: E402
from burnish.engine.device import choose_device  # noqa: E402
from burnish.engine.read import read_exr  # noqa: E402
from burnish.engine.report import Report  # noqa: E402
from burnish.engine.scene import CameraData, SceneDelta  # noqa: E402

from tests.performance.matte_copy import make_matte  # noqa: E402


class BlendScene:
    """The scene of a .blend file, as a matte copy where asked for."""

    def __init__(self, path: Path, size: tuple[int, int], device: str, matte: bool = True):
        self._bench = open_scene(Path(path), tuple(size), choose_device(device))
        self._bench.persistent = True
        self._bench.configure(Job(engine="cycles", samples=1))
        self.name, self.size, self.scene = Path(path).stem, tuple(size), self._bench.scene
        self.exposure = self._bench.exposure
        self.scene.cycles.film_exposure = 1.0
        self.matte = make_matte(self.scene) if matte else 0
        self._release_camera()
        for item in bpy.data.objects:
            # The evaluated scene is the viewport's, Cycles renders the other.
            item.hide_viewport = item.hide_render
            for modifier in item.modifiers:
                modifier.show_viewport = modifier.show_render
                if modifier.type == 'SUBSURF':
                    modifier.levels = modifier.render_levels
        self._matrix = self.scene.camera.matrix_world.copy()
        self.camera: CameraData = self.camera_for(self.size)
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
        camera_object = self.scene.camera
        camera_object.matrix_world = self._matrix
        if camera is not None:
            camera_object.matrix_world = mathutils.Matrix(np.array(camera.transform).reshape(4, 4).tolist())
        self._bench.configure(Job(engine="cycles+oidn" if denoise else "cycles", samples=samples, seed=seed))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "cycles.exr"
            seconds, _ = self._bench.shoot(path)
            return read_exr(path), seconds

    def _release_camera(self) -> None:
        """Take the camera out of all that would move it back."""
        camera = self.scene.camera
        matrix = camera.matrix_world.copy()
        camera.parent = None
        camera.constraints.clear()
        camera.animation_data_clear()
        camera.matrix_world = matrix
        bpy.context.view_layer.update()
