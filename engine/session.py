# SPDX-License-Identifier: GPL-3.0-or-later
"""A Session: one scene on one device, seen by one camera, drawn by one of the integrators.

update() takes what changed in the scene, configure() takes settings and camera, step() adds samples, read() gives
pictures; move() goes on to another moment of the same one. One thread at a time. Knows nothing of Blender.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp

from ..kernels.paths import Options
from .device import choose_device, device_errors, device_info, used_memory
from .device_scene import DeviceScene
from .errors import InvalidScene
from .frame_data import frame_row
from .oidn import never
from .pass_names import SHADOW_CATCHER, first_hit_channels
from .passes.composite import LIGHT_PASSES
from .passes.film_buffers import FilmBuffers
from .passes.final_denoise import FinalDenoise
from .passes.first_hits import FirstHits
from .passes.path_light import is_light_pass
from .passes.reference import ReferencePass
from .passes.shadow_catcher import ShadowCatchers, shadow_pass
from .path_options import path_options
from .pipeline import Pipeline
from .pixel_filter import filter_table
from .realtime import Realtime, fog_traced, settings_for
from .report import Report, ReportKind
from .scene import CameraData, SceneDelta
from .session_stats import SessionStats
from .setting_changes import Change, change_since
from .settings import Integrator, RenderSettings
from .staging import PicturePages
from .warmup import warm_up

__all__ = ["DENOISED", "PASSES", "Session"]

GEOMETRY_SAMPLES = 16
"""Samples a pixel of the passes that tell of the first surface, where the real-time integrator makes the picture"""

PASSES = {
    "Combined": 4, "Depth": 1, "Normal": 3, "Position": 3, "UV": 3, "Emission": 3, "Environment": 3,
    "Object Index": 1, "Material Index": 1, **dict.fromkeys(LIGHT_PASSES, 3),
}
"""Channels of each picture that read() gives, beside those of pass_names.py"""

DENOISED = "Denoised"
"""Stands among the passes of configure() for read_denoised()"""

MAX_PIXELS = 1 << 30

DIMMED = 5e-4
"""Share of all light of before below which what an edit leaves of it is lost among averages of before, which forget
within a dozen frames but for a hundredth"""


class Session:
    """Renders a scene progressively."""

    def __init__(self, settings: RenderSettings):
        """Open the device.

        Raises:
            DeviceUnavailable: The device that the settings ask for does not exist.
            KernelBuildFailed: The kernels can't be built.
        """
        self.settings = settings
        self.device = choose_device(settings.device)
        self.device_name = device_info(self.device).name
        warm_up(self.device, integrator=settings.sampling.integrator)
        self.stats = SessionStats()
        self._scene = DeviceScene(self.device)
        self._pass = ReferencePass(self.device)
        self._film: FilmBuffers | None = None
        self._pages = PicturePages()
        self._frame: np.ndarray | None = None
        self._key: tuple = ()
        self._camera: CameraData | None = None
        self._size: tuple[int, int, tuple[int, int, int, int] | None] = (0, 0, None)
        self._sampling_report = Report()
        self._kept_options: dict[bool, tuple[tuple, Options]] = {}
        self._filter_shape: tuple | None = None
        self._realtime: Realtime | None = None
        self.denoiser = FinalDenoise(self.device)
        self.first_hits = FirstHits(self.device)
        self.timed = False
        """Measure every section of real-time frames (slower: each is waited for)"""

    @property
    def report(self) -> Report:
        """Return what the device scene approximated, skipped or missed."""
        report = Report()
        report.merge(self._scene.report)
        report.merge(self._sampling_report)
        if self._camera is not None and self._camera.panoramic and self._scene.material_table.uses_window:
            report.add(ReportKind.APPROXIMATED, "", "Window coordinates are not those of the panoramic camera")
        return report

    def update(self, delta: SceneDelta, progress: Callable[[str, float], None] | None = None) -> None:
        """Take over what changed in the scene; the accumulated samples are forgotten.

        Args:
            delta: Changes since the last update.
            progress: Called with a stage's name and the share done, 0..1.

        Raises:
            OutOfDeviceMemory: The scene does not fit.
        """
        scene, power = self._scene, self._scene.power
        scene.apply(delta, self.settings.performance, progress)
        self.stats = SessionStats(
            triangles=scene.triangle_count, instances=len(scene.rows),
            lights=len(scene.lamps) + len(scene.emitters.power), texture_bytes=int(scene.textures.bytes),
            structure=scene.structures.description, times=dict(scene.times, **delta.extra.get("times", {})))
        self.stats.device_bytes = used_memory(self.device)
        changes = scene.changes
        self._pass.note_scene()
        if not changes.followed:
            self._set_frame()
        # Averages of light so much brighter would glow for hundreds of frames. Without any light they may fade: what is
        # known of the surfaces helps when it comes back.
        dimmed = 0.0 < scene.power < DIMMED * power
        if self._realtime is not None and (changes.replaced or dimmed):
            self._realtime.restart()
        elif self._realtime is not None:
            self._realtime.note(moved=changes.moved, lit=changes.lit)
        self._forget_film()

    def move(self, delta: SceneDelta, camera: CameraData) -> None:
        """Go on to another moment of a path-traced picture (motion blur): samples of before stay, and count the same.

        Args:
            delta: Changes since the last update or move.
            camera: Where it is at the moment; nothing else of what configure() was given changes.

        Raises:
            OutOfDeviceMemory: The scene does not fit.
        """
        assert self._realtime is None, "real-time frames have a history of their own"
        known = dict(self._scene.report.counts)
        self._scene.apply(delta, self.settings.performance)
        # What is odd at each moment is odd once.
        self._scene.report.counts |= known
        self._pass.note_scene()
        if self._film.guides is not None:
            self._film.guides.moving = True
        self._camera = camera
        self._set_frame()
        self.first_hits.reset()

    def configure(
        self, settings: RenderSettings, camera: CameraData, width: int, height: int,
        crop: tuple[int, int, int, int] | None = None, passes: tuple[str, ...] = ("Combined",),
    ) -> Change:
        """Set what to render; anything that invalidates the samples forgets them.

        Args:
            settings: All settings; the device must be the session's. Panoramic cameras, shadow catchers and some
                fog know no real-time frames: they get the reference integrator.
            camera: In world space.
            width: Of the full frame [px].
            height: Of the full frame [px].
            crop: Region rendered, as x, y, width, height with a bottom-left origin; None is everything.
            passes: Names that will be read, from PASSES or of light groups, and DENOISED if the picture is denoised.

        Raises:
            InvalidScene: The size or region is impossible.
            OutOfDeviceMemory: The film does not fit.
        """
        crop = crop or (0, 0, width, height)
        if width < 1 or height < 1 or crop[2] < 1 or crop[3] < 1 or crop[2] * crop[3] > MAX_PIXELS:
            raise InvalidScene(f"A picture of {crop[2]} x {crop[3]} pixels can't be rendered; change the resolution.")
        catchers = self._scene.table is not None and self._scene.table.has_catchers
        settings = settings_for(settings, camera, traced=catchers or fog_traced(self._scene.media, passes))
        change = change_since(settings, self.settings)
        if settings.performance.opacity_maps != self.settings.performance.opacity_maps:
            self._scene.use_opacity_maps(settings.performance.opacity_maps)
        traced, apart = settings.sampling.integrator == Integrator.REFERENCE, SHADOW_CATCHER in passes
        light = tuple(name for name in passes if name in LIGHT_PASSES or (traced and is_light_pass(name)))
        extra = any(name in PASSES and name not in ("Combined", *light) for name in passes)
        denoised = DENOISED in passes
        key = (crop[2] * crop[3], extra, settings.sampling.integrator, catchers and 1 + apart,
               denoised and traced, light if traced else ())
        if self._film is None or key != self._key:
            change |= Change.RESIZE | Change.RESTART
        view = camera, (width, height, crop)
        if view != (self._camera, self._size):
            change |= Change.RESTART
        if change != Change.NONE or self._frame is None:
            self.settings, (self._camera, self._size) = settings, view
            self._set_frame()
        self.settings = settings
        self.first_hits.configure(passes, crop[2] * crop[3])
        with device_errors(f"a picture of {crop[2]} x {crop[3]} pixels"):
            if change & Change.RESIZE:
                self._film = None
                self._film = FilmBuffers.make(key[0], extra, self.device, key[-1], key[-2])
                self._pass.catchers = ShadowCatchers(self.device, apart) if catchers else None
                self._pass.resize(key[0], extra, self._film.light, key[-2])
                self._key = key
            if settings.sampling.integrator == Integrator.REALTIME:
                self._realtime = self._realtime or Realtime(self.device)
                self._realtime.configure(settings, crop[2], crop[3], height, light, denoised)
                if change & Change.RESTART:
                    self._realtime.note_camera()
            else:
                self._realtime = None
        if change & Change.RESTART:
            shape = (settings.film.pixel_filter, settings.film.filter_width)
            if shape != self._filter_shape:
                self._filter_shape, self._filter = shape, wp.array(
                    filter_table(*shape), dtype=float, device=self.device)
            self._forget_film()
        return change

    def step(self, samples: int = 1, should_stop: Callable[[], bool] | None = None) -> int:
        """Add up to `samples` samples per pixel and return how many there are in all.

        Args:
            samples: How many to add.
            should_stop: Polled often; when it returns True the step ends within a tenth of a second, and what has
                been accumulated stays valid.
        """
        assert self._film is not None and self._frame is not None, "configure() comes before step()"
        start = time.perf_counter()
        stop = should_stop or (lambda: False)
        with device_errors("the path states"):
            if self._realtime is not None:
                self._realtime.timed = self.timed
                self._realtime.step(self._scene, self._frame, lambda: self._options(False), samples, stop)
            else:
                self._trace(self._pass.samples_done + samples, stop)
        self.stats.times["sampling"] = self.stats.times.get("sampling", 0.0) + time.perf_counter() - start
        return self.samples_done

    def _trace(self, target: int, stop: Callable[[], bool]) -> None:
        self._film.light.prepare(self._scene)
        self._pass.prepare(self._scene, self._film.pixel_count, self._options(False))
        self._pass.render(
            self._scene.scene, self._frame, self._options(self._film.passes), self._filter, self._film, target, stop)

    @property
    def samples_done(self) -> int:
        """Return how many samples every pixel has; real-time frames count as one each."""
        return self._pass.samples_done if self._realtime is None else self._realtime.samples_done

    @property
    def frame_times(self) -> dict[str, float]:
        """Return the milliseconds of each section of the last timed real-time frame."""
        return {} if self._realtime is None else self._realtime.pipeline.times

    @property
    def pipeline(self) -> Pipeline | None:
        """Return the passes of real-time frames, to look at; None before there are any."""
        return None if self._realtime is None else self._realtime.pipeline

    @property
    def skipped(self) -> dict[str, str]:
        """Return the sections that real-time frames of this scene do without, with the reason."""
        return {} if self._realtime is None else self._realtime.pipeline.skipped

    def counts(self) -> dict[str, int]:
        """Return what the last real-time frame counted: rays by kind, cells, probes. Waits for the device."""
        return {} if self._realtime is None else self._realtime.pipeline.counts()

    @property
    def rays(self) -> int:
        """Return the path segments traced since the last reset."""
        return self._pass.rays

    def reset(self) -> None:
        """Forget all samples and all history."""
        if self._realtime is not None:
            self._realtime.restart()
        self._forget_film()

    def _forget_film(self) -> None:
        if self._film is not None:
            self._film.clear()
        self._pass.reset()
        self.denoiser.reset()
        self.first_hits.reset()
        self.stats.times["sampling"] = 0.0

    def close(self) -> None:
        """Give the device's memory back."""
        self._film = self._realtime = None
        self.denoiser, self.first_hits = FinalDenoise(self.device), FirstHits(self.device)
        self._kept_options = {}
        self._pass = ReferencePass(self.device)
        self._scene = DeviceScene(self.device)

    def read(self, name: str = "Combined") -> np.ndarray:
        """Return a picture: float32 [h, w, channels], bottom row first, scene-linear, premultiplied.

        Raises:
            KeyError: No such pass, or configure() was not told that it would be read.
        """
        channels = first_hit_channels(name) or 3 * (name == SHADOW_CATCHER)
        if not (name == "Combined" or channels or is_light_pass(name) or (name in PASSES and self._film.passes)):
            raise KeyError(name)
        start, (width, height) = time.perf_counter(), self._size[2][2:]
        flat = self._pages.read(self.resolve()) if name == "Combined" else np.array(self._read_pass(name), np.float32)
        self.stats.times["read"] = time.perf_counter() - start
        return flat.reshape(height, width, channels or PASSES.get(name, 3))

    def resolve(self) -> wp.array:
        """Return the Combined picture on the device: vec4 [h * w], valid until the next call."""
        if self._realtime is not None:
            return self._realtime.picture()
        self._sampling_report = self._film.oddities(self._scene.structures.has_filtered)
        return self._pass.resolve(self._film, self.settings.film.transparent, self.settings.film.exposure)

    def guides(self, should_stop: Callable[[], bool] = never) -> tuple[wp.array, wp.array] | None:
        """Return albedo, 0..1, and normal of what pixels show, as denoising uses them: vec3 [h * w] each."""
        return self.denoiser.guides(
            *self._traced(), self._scene.scene, self._frame, self._options(False), self._filter, self.samples_done,
            should_stop)

    def _traced(self) -> tuple[ReferencePass, FilmBuffers]:
        """Return the path tracer that has states already, and its film."""
        traced = self._realtime.samples() if self._realtime is not None else None
        return (self._pass, self._film) if traced is None else traced

    @property
    def traced_samples(self) -> int:
        """Return how many path-traced samples the picture has, beside real-time frames or alone."""
        return self._traced()[0].samples_done

    def read_denoised(self, library: ctypes.CDLL) -> np.ndarray:
        """Return what resolve_denoised() does, as read() gives pictures: float32 [h, w, 4]."""
        start, (width, height) = time.perf_counter(), self._size[2][2:]
        flat = self._pages.read(self.resolve_denoised(library))
        self.stats.times["denoise"] = time.perf_counter() - start
        return flat.reshape(height, width, 4)

    def resolve_denoised(self, library: ctypes.CDLL, should_stop: Callable[[], bool] = never) -> wp.array | None:
        """Return the Combined picture without noise on the device: vec4 [h * w]; None where it was told to stop.

        Args:
            library: Open Image Denoise, from oidn.load.
            should_stop: As of step(), on a processor.

        Raises:
            BurnishError: The library failed, or what it needs does not fit (OutOfDeviceMemory).
        """
        traced, picture, large = (self._pass, self._film), None, False
        if self._realtime is not None:
            traced, large = self._realtime.samples(), self._realtime.supersampled
            picture = self._realtime.picture() if self._realtime.shows_frames else None
        with device_errors("denoising"):
            # A lens blurs what the guides show.
            guides = self.guides(should_stop)
            if guides is None:
                return None
            run = partial(
                self.denoiser.run, library, guides, self._size[2][2:], clean=self._camera.aperture_radius <= 0.0,
                transparent=self.settings.film.transparent, should_stop=should_stop, supersampled=large)
            catchers = self._pass.catchers
            return catchers.denoise(run, self.resolve()) if catchers else run(traced=traced, picture=picture)

    def _read_pass(self, name: str) -> np.ndarray:
        if name == SHADOW_CATCHER:
            return shadow_pass(self._pass.catchers, self._film.film).numpy()
        if is_light_pass(name):
            return (self._realtime.light_pass if self._realtime else self._film.light.read)(name).numpy()
        if first_hit_channels(name):
            with device_errors("passes of the first surfaces"):
                return self.first_hits.read(name, self._scene, self._frame, self._filter, self.samples_done,
                                            self._traced()[0], self._options(False))
        if self._realtime is not None and self._pass.samples_done < GEOMETRY_SAMPLES:
            self._trace(GEOMETRY_SAMPLES, lambda: False)
        return self._film.read_surfaces(name, self._scene.origin)

    def _set_frame(self) -> None:
        if self._camera is not None:
            (width, height, crop), origin = self._size, self._scene.origin
            # A camera that can't be used must not be met again by the next update.
            camera, self._camera = self._camera, None
            self._frame = frame_row(camera, width, height, crop, self.settings.sampling.seed, origin)
            self._camera = camera
            if self._scene.material_table.uses_camera:
                self._scene.material_table.set_camera(self._camera, tuple(origin))

    def _options(self, passes: bool) -> Options:
        """Return the kernels' settings; the same object as long as they are the same."""
        scene = self._scene
        key = (self.settings.light_paths, self.settings.film, scene.structures.has_filtered, scene.has_light_programs,
               scene.material_table.lean, scene.material_table.subsurface, scene.media is None)
        if passes not in self._kept_options or self._kept_options[passes][0] != key:
            self._kept_options[passes] = (key, path_options(self.settings, scene, passes))
        return self._kept_options[passes][1]
