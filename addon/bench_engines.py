# SPDX-License-Identifier: GPL-3.0-or-later
"""How the benchmark sets Burnish, Cycles and EEVEE and lets each render through Blender, all with the same film.

Owns the comparable settings: no adaptive sampling, no clamping, no blurred caustics, 32 bounces of every kind, the
same pixel filter; compositing, sequencer, border and motion blur off.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine.errors import BurnishError
from . import final
from .bench_store import OWN, Job, source_hash

__all__ = ["BenchScene", "open_scene", "read_exr", "sentence"]

BOUNCES = 32
FILTER_WIDTH = 1.5
"""Full width of the Blackman-Harris pixel filter [px], Cycles' default"""
BUDGET_SAMPLES = 1 << 16
"""Samples that nobody reaches before the time of a budget is up"""


def sentence(error: BaseException) -> str:
    """Return what an exception says in one line, without the words that Blender puts around it."""
    lines = [line.strip().removeprefix("Error: ") for line in str(error).splitlines() if line.strip()]
    own = [line.removeprefix("Burnish: ") for line in lines if line.startswith("Burnish: ")]
    return (own or lines or [type(error).__name__])[0]


def open_scene(path: Path, size: tuple[int, int], device: str) -> BenchScene:
    """Open a .blend file and prepare it; `device` is `cpu` or `cuda:N`. Raises BurnishError."""
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise BurnishError(f"The scene '{path}' can't be opened: {sentence(error)}") from error
    if bpy.context.scene.camera is None:
        raise BurnishError(f"The scene '{path}' has no active camera; set one in the file")
    return BenchScene(bpy.context.scene, size, device)


def read_exr(path: Path) -> np.ndarray:
    """Return the colours of an OpenEXR file, float32 [h, w, 3], bottom row first, scene-linear; raises BurnishError."""
    try:
        image = bpy.data.images.load(str(path.resolve()), check_existing=False)
    except RuntimeError as error:
        raise BurnishError(f"'{path}' can't be read: {sentence(error)}") from error
    try:
        image.colorspace_settings.name = 'Non-Color'
        width, height = image.size
        pixels = np.empty(width * height * image.channels, np.float32)
        if not pixels.size or image.channels < 3 or image.type == 'MULTILAYER':
            raise BurnishError(f"'{path}' has no plain R, G, B picture; save it as a single-layer OpenEXR file")
        image.pixels.foreach_get(pixels)
        return pixels.reshape(height, width, -1)[..., :3].copy()
    finally:
        bpy.data.images.remove(image)


class BenchScene:
    """The open scene: renders jobs and times them. The first render of each engine only loads its kernels."""

    def __init__(self, scene: Any, size: tuple[int, int], device: str) -> None:
        self.scene = scene
        self.device = device
        self.exposure = float(scene.view_settings.exposure)
        self._loaded: set[str] = set()
        render = scene.render
        render.resolution_x, render.resolution_y = size
        render.resolution_percentage = 100
        render.use_border = render.use_compositing = render.use_sequencer = render.use_motion_blur = False
        render.filter_size = FILTER_WIDTH
        if hasattr(render.image_settings, "media_type"):
            render.image_settings.media_type = 'IMAGE'
        render.image_settings.file_format, render.image_settings.color_depth = 'OPEN_EXR', '32'
        render.image_settings.color_mode = 'RGB'
        for layer in list(scene.view_layers)[1:]:
            layer.use = False

    def render(self, job: Job, path: Path) -> dict[str, Any]:
        """Render a job to an OpenEXR file and return its record: seconds and, for Burnish, where they went.

        Raises:
            BurnishError: The engine failed, with its sentence.
        """
        if job.engine not in self._loaded:
            self._configure(Job(engine=job.engine, samples=1))
            self._shoot(path)
            self._loaded.add(job.engine)
        self._configure(job)
        seconds, information = self._shoot(path)
        record = {"engine": job.engine, "samples": job.samples, "seed": job.seed, "budget": job.budget,
                  "seconds": seconds, "device": self.device, "blender": bpy.app.version_string}
        if information is not None:
            stats = information.stats
            record |= {"source": source_hash(), "samples_done": information.samples, "device": information.device,
                       "sampling_seconds": information.seconds, "report": information.report.text(),
                       "times": {name: float(value) for name, value in getattr(stats, "times", {}).items()},
                       "frame_times": information.frame_times, "skipped": information.skipped,
                       "triangles": int(getattr(stats, "triangles", 0)), "structure": getattr(stats, "structure", "")}
        return record

    def _shoot(self, path: Path) -> tuple[float, final.RenderInfo | None]:
        """Render the scene as it is set; return wall seconds and Burnish's own figures."""
        found: list[final.RenderInfo] = []

        def keep(layer: str, view: str, pixels: dict[str, np.ndarray], information: final.RenderInfo) -> None:
            found.append(information)

        partial = path.with_name(f".{path.stem}.partial.exr")
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        self.scene.render.filepath = str(partial.resolve())
        final.on_finished.append(keep)
        start = time.perf_counter()
        try:
            bpy.ops.render.render(write_still=True, scene=self.scene.name)
        except RuntimeError as error:
            raise BurnishError(sentence(error)) from error
        finally:
            final.on_finished.remove(keep)
        seconds = time.perf_counter() - start
        if not partial.is_file():
            raise BurnishError("The engine wrote no picture; run it in Blender to see why")
        partial.replace(path)
        return seconds, found[0] if found else None

    def _configure(self, job: Job) -> None:
        """Select a job's engine and set it."""
        if job.engine in OWN:
            self._configure_burnish(job)
        elif job.engine == "eevee":
            self.scene.render.engine = 'BLENDER_EEVEE'
            self.scene.eevee.use_raytracing = True
            self.scene.eevee.taa_render_samples = job.samples
        else:
            self._configure_cycles(job)

    def _configure_burnish(self, job: Job) -> None:
        self.scene.render.engine = 'BURNISH'
        settings = self.scene.burnish
        settings.device = 'CUDA' if self.device.startswith("cuda") else 'CPU'
        settings.sampling.integrator = 'REALTIME' if job.engine == "realtime" else 'REFERENCE'
        settings.sampling.samples = BUDGET_SAMPLES if job.budget else job.samples
        settings.sampling.time_limit = job.budget
        settings.sampling.seed = job.seed
        settings.light_paths.clamp_direct = settings.light_paths.clamp_indirect = 0.0
        settings.light_paths.max_bounces = 0
        settings.film.exposure = float(self.scene.cycles.film_exposure)
        settings.film.pixel_filter, settings.film.filter_width = 'BLACKMAN_HARRIS', FILTER_WIDTH

    def _configure_cycles(self, job: Job) -> None:
        self.scene.render.engine = 'CYCLES'
        cycles = self.scene.cycles
        cycles.device = choose_cycles_device(self.device)
        cycles.samples, cycles.seed = (BUDGET_SAMPLES if job.budget else job.samples), job.seed
        cycles.time_limit = job.budget
        cycles.use_adaptive_sampling = cycles.use_animated_seed = cycles.use_guiding = False
        cycles.use_light_tree = True
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
        cycles.caustics_reflective = cycles.caustics_refractive = True
        for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max", "volume"):
            setattr(cycles, f"{kind}_bounces", BOUNCES)
        cycles.pixel_filter_type, cycles.filter_width = 'BLACKMAN_HARRIS', FILTER_WIDTH
        cycles.use_denoising = job.engine == "cycles+oidn"
        if cycles.use_denoising:
            cycles.denoiser, cycles.denoising_use_gpu = 'OPENIMAGEDENOISE', cycles.device == 'GPU'


def choose_cycles_device(device: str) -> str:
    """Give Cycles the CUDA devices if `device` is one, and return its device setting; raises BurnishError."""
    addons = bpy.context.preferences.addons
    if "cycles" not in addons:
        bpy.ops.preferences.addon_enable(module="cycles")
    if not device.startswith("cuda"):
        return 'CPU'
    preferences = addons["cycles"].preferences
    try:
        preferences.compute_device_type = 'CUDA'
    except TypeError as error:
        raise BurnishError("This Blender's Cycles has no CUDA; use --device cpu") from error
    preferences.get_devices()
    for entry in preferences.devices:
        entry.use = entry.type == 'CUDA'
    if not any(entry.use for entry in preferences.devices):
        raise BurnishError("Cycles finds no CUDA device; use --device cpu")
    return 'GPU'
