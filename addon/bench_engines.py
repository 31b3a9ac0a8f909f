# SPDX-License-Identifier: GPL-3.0-or-later
"""How the benchmark sets Burnish, Cycles and EEVEE and lets each render through Blender, all with the same film.

Owns the comparable settings: no adaptive sampling, no clamping, no blurred caustics, 32 bounces of every kind, the
same pixel filter; compositing, sequencer, border and motion blur off.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..engine.errors import BurnishError
from ..engine.measure import View
from ..engine.presets import governed_values, preset_values, write_values
from ..engine.read import read_exr
from ..engine.scene import CameraData, SceneDelta
from ..engine.session import Session
from ..engine.setting_changes import Change
from ..engine.settings import Preset, RenderSettings
from ..engine.write import LayerPixels, PassPixels, write_exr
from . import final
from .bench_store import OWN, Job
from .extract.settings import settings_from_scene

__all__ = ["BenchScene", "KeptSession", "kept_sessions", "open_scene", "save_picture", "sentence"]

BOUNCES = 32
FILTER_WIDTH = 1.5
"""Full width of the Blackman-Harris pixel filter [px], Cycles' default"""


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


def save_picture(path: Path, pixels: np.ndarray) -> None:
    """Write colours [h, w, 3], bottom row first, to an OpenEXR file; raises BurnishError."""
    write_exr(path, [LayerPixels("ViewLayer", (PassPixels("Combined", "RGB", pixels),))], {})


class KeptSession(Session):
    """A session that final renders fill; it tells what reading the scene took and stays open if asked to."""

    def __init__(self, settings: RenderSettings, keep: bool) -> None:
        self.keep = keep
        self.extraction = 0.0
        """Seconds that reading Blender's scene took"""
        self.view: View | None = None
        super().__init__(settings)

    def update(self, delta: SceneDelta, progress: Callable[[str, float], None] | None = None) -> None:
        """Take over what changed in the scene."""
        self.extraction = float(delta.extra.get("extract_seconds", 0.0))
        super().update(delta, progress)

    def configure(self, settings: RenderSettings, camera: CameraData, width: int, height: int,
                  crop: tuple[int, int, int, int] | None = None, passes: tuple[str, ...] = ("Combined",)) -> Change:
        """Set what to render."""
        self.view = View(camera, width, height, crop, passes)
        return super().configure(settings, camera, width, height, crop, passes)

    def close(self) -> None:
        """Give the device's memory back, unless the session is kept."""
        if not self.keep:
            super().close()


@contextlib.contextmanager
def kept_sessions(*, keep: bool) -> Iterator[list[KeptSession]]:
    """Let final renders open sessions of ours while this is entered; yield those that they have opened."""
    opened: list[KeptSession] = []

    def open_session(settings: RenderSettings) -> KeptSession:
        opened.append(KeptSession(settings, keep))
        return opened[-1]

    before, final.open_session = final.open_session, open_session
    try:
        yield opened
    finally:
        final.open_session = before


class BenchScene:
    """The open scene: sets engines and renders it by F12. The first render of each engine only loads its kernels."""

    def __init__(self, scene: Any, size: tuple[int, int], device: str) -> None:
        self.scene, self.size, self.device = scene, size, device
        self.exposure = float(scene.view_settings.exposure)
        self.persistent = False
        """Whether engines keep the scene between renders"""
        self._loaded: set[str] = set()
        self._governed = governed_values(settings_from_scene(scene, viewport=False))
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
        """Render a job by F12 to an OpenEXR file and return its record: seconds and, for Burnish, where they went.

        Raises:
            BurnishError: The engine failed, with its sentence.
        """
        if job.engine not in self._loaded:
            self.configure(Job(engine=job.engine, samples=1))
            self.shoot()
            self._loaded.add(job.engine)
        self.configure(job)
        with kept_sessions(keep=False) as opened:
            seconds, information = self.shoot(path)
        record = {"engine": job.engine, "samples": job.samples, "seed": job.seed, "budget": job.budget,
                  "clock": job.clock, "seconds": seconds, "device": self.device, "blender": bpy.app.version_string}
        if information is not None:
            stats = information.stats
            times = {name: float(value) for name, value in getattr(stats, "times", {}).items()}
            times = {"extraction": opened[-1].extraction, **times} if opened else times
            record |= {"samples_done": information.samples, "device": information.device,
                       "sampling_seconds": information.seconds, "report": information.report.text(),
                       "times": times, "frame_times": information.frame_times, "skipped": information.skipped,
                       "triangles": int(getattr(stats, "triangles", 0)), "structure": getattr(stats, "structure", "")}
        return record

    def shoot(self, path: Path | None = None) -> tuple[float, final.RenderInfo | None]:
        """Render the scene as it is set; return wall seconds, without saving, and Burnish's own figures.

        Raises:
            BurnishError: The engine failed, with its sentence.
        """
        found: list[final.RenderInfo] = []

        def keep(layer: str, view: str, pixels: dict[str, np.ndarray], information: final.RenderInfo) -> None:
            found.append(information)

        self.scene.render.use_persistent_data = self.persistent
        final.on_finished.append(keep)
        start = time.perf_counter()
        try:
            outcome = bpy.ops.render.render(scene=self.scene.name)
        except RuntimeError as error:
            raise BurnishError(sentence(error)) from error
        finally:
            final.on_finished.remove(keep)
        seconds = time.perf_counter() - start
        if 'FINISHED' not in outcome:
            raise BurnishError("The render was cancelled")
        if path is not None:
            self._save(path)
        return seconds, found[0] if found else None

    def _save(self, path: Path) -> None:
        partial = path.with_name(f".{path.stem}.partial.exr")
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        try:
            bpy.data.images["Render Result"].save_render(str(partial.resolve()), scene=self.scene)
        except (KeyError, RuntimeError) as error:
            raise BurnishError(f"The engine made no picture ({sentence(error)}); run it in Blender to see why"
                               ) from error
        partial.replace(path)

    def shoot_part(self, job: Job, offset: int, total: int, path: Path) -> tuple[np.ndarray, float]:
        """Render `job.samples` samples of Cycles that come after the first `offset`; return [h, w, 3] and seconds.

        `total` is how many there will be in the end: Cycles' sequences depend on it, so that only parts of the same
        total add up to what one render of all would be.
        """
        self.configure(job)
        cycles = self.scene.cycles
        cycles.use_sample_subset, cycles.sample_offset, cycles.sample_subset_length = True, offset, job.samples
        cycles.samples = total
        try:
            seconds, _ = self.shoot(path)
        finally:
            cycles.use_sample_subset, cycles.sample_offset = False, 0
        return read_exr(path), seconds

    def shoot_both(self, job: Job, plain: Path, denoised: Path) -> float:
        """Render Cycles with its denoiser and save the picture before and after that; return the wall seconds."""
        self.configure(job)
        settings, layer = self.scene.render.image_settings, self.scene.view_layers[0]
        both = denoised.with_name(f".{denoised.stem}.both.exr")
        kept = {name: getattr(settings, name) for name in ("media_type", "file_format") if hasattr(settings, name)}
        layer.cycles.denoising_store_passes = True
        try:
            seconds, _ = self.shoot()
            if "media_type" in kept:
                settings.media_type = 'MULTI_LAYER_IMAGE'
            settings.file_format = 'OPEN_EXR_MULTILAYER'
            self._save(both)
        finally:
            layer.cycles.denoising_store_passes = False
            for name, value in kept.items():
                setattr(settings, name, value)
        try:
            save_picture(plain, read_exr(both, "Noisy Image"))
            save_picture(denoised, read_exr(both, "Combined"))
        finally:
            both.unlink(missing_ok=True)
        return seconds

    def configure(self, job: Job) -> None:
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
        settings.sampling.integrator = 'REFERENCE' if job.engine.startswith("reference") else 'REALTIME'
        settings.sampling.samples, settings.sampling.time_limit = job.samples, 0.0
        settings.sampling.seed = job.seed
        settings.light_paths.clamp_direct = settings.light_paths.clamp_indirect = 0.0
        # As Cycles' paths, which meet one surface more than they have bounces.
        settings.light_paths.max_bounces = BOUNCES + 1
        settings.film.exposure = float(self.scene.cycles.film_exposure)
        settings.film.pixel_filter, settings.film.filter_width = 'BLACKMAN_HARRIS', FILTER_WIDTH
        write_values(settings, preset_values(Preset.DRAFT) if job.engine == "draft" else self._governed)
        settings.denoiser.final_denoise = job.engine.endswith("+oidn")

    def _configure_cycles(self, job: Job) -> None:
        self.scene.render.engine = 'CYCLES'
        cycles = self.scene.cycles
        cycles.device = choose_cycles_device(self.device)
        cycles.samples, cycles.seed, cycles.time_limit = job.samples, job.seed, 0.0
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
