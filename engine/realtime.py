# SPDX-License-Identifier: GPL-3.0-or-later
"""The real-time integrator: a picture every frame, and at rest the way from filtered frames to path-traced samples.

Three regimes, counted in steps since anything changed: the first SETTLING steps are the pipeline's frames; then frames
and samples of the reference integrator take turns until there are `DenoiserSettings.rest_frames` frames; from then on
every step is a sample. The samples go into a film of their own, and passes/rest.py makes one picture from both, whose
limit is the reference integrator's. A picture that is going to be denoised takes no part in this: to a denoiser samples
are worth more than frames, so that every step is a sample, but for the frames of light passes. Between its samples are
a few frames that nobody sees: they fill the radiance cache, in which paths may end (`KnownLight`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import warp as wp

from ..kernels import film
from ..kernels.known_light import KnownLight
from ..kernels.paths import Options
from .device import launch
from .device_scene import DeviceScene
from .errors import OutOfDeviceMemory
from .history import copy_struct
from .media import SceneMedia
from .passes.composite import LIGHT_PASSES
from .passes.film_buffers import FilmBuffers
from .passes.radiance_cache import smallest_cell
from .passes.reference import ReferencePass
from .passes.rest import SETTLING, TURN, RestBlend
from .pipeline import Pipeline
from .pixel_filter import filter_table, motion_reach, sharpness_of
from .ray_budget import densified
from .scene import CameraData
from .settings import FRAME_GROUPS, CacheKey, Integrator, RenderSettings
from .supersampling import Supersampling
from .view_data import ViewTracker
from .warmup import warm_up

__all__ = ["Realtime", "fog_traced", "settings_for"]

KEYS_REPEAT = 1 << 14
"""Smallest cells that the camera may jump: at twice as many the keys of the cache's flat cells repeat"""
LIGHT_FRAMES = 16
"""Frames for the light passes of a picture that is going to be denoised"""
ENDED_SAMPLES = 64
"""Samples of which all paths may end in the cache"""
FILLING_AT = {"cpu": (2, 8, 24, 56, 120), "cuda": (12, 40, 120)}
"""Samples after which frames fill the cache, unseen: fewer times on a GPU, where each waits for its longest paths, and
later, where the first take as long as five samples"""
FILLING_FRAMES = {"cpu": 2, "cuda": 4}
"""So many each time: on a processor one takes two thirds of a sample's time"""
LONG_PATHS = 3.4
"""Rays of a path, shadow rays left out, from which on ends in the cache pay for the frames: outdoors they don't"""
LEAST_PIXELS = 240 * 135
"""Of pictures whose paths end in the cache: in smaller ones it has too few rays, and up to 5 % too little light"""
LEAST_FILLED = {"cpu": LEAST_PIXELS, "cuda": 480 * 270}
"""Pixels of those that have frames for it: samples of small pictures take less of a GPU's time than these would"""
MANY_BOUNCES = 24
"""Limit of a path's bounces from which on the light beyond it does not count: all that cells know may be added"""


class Realtime:
    """Pipeline, view and rest regime for one picture size."""

    def __init__(self, device: str):
        warm_up(device, integrator=Integrator.REALTIME)
        self.device = device
        self._kind = "cuda" if wp.get_device(device).is_cuda else "cpu"
        self.views = ViewTracker(device)
        self.pipeline = Pipeline(device)
        self.reference = ReferencePass(device)
        self.timed = False
        self._film: FilmBuffers | None = None
        self._blend = RestBlend(device)
        self._settings: RenderSettings | None = None
        self._size = (0, 0, 0)
        self._light_passes: tuple[str, ...] = ()
        self._denoised = False
        self._moved = self._lit = False
        self._whole_paths = False
        self._blended = False
        self._resolved: wp.array | None = None
        self._ending_options: Options | None = None
        """Those with which paths may end in the cache"""
        self._ending_for: tuple[Options, int] | None = None
        """What they were made of, and how many frames had been recorded: these change what is in the grid"""
        self._supersampling = Supersampling(device)
        self._shown: wp.array | None = None
        """What frames show, at the picture's size"""

    def configure(self, settings: RenderSettings, width: int, height: int, lines: int, light_passes: tuple[str, ...],
                  denoised: bool = False) -> None:
        """Allocate for settings and a size [px]; a change of either forgets all history.

        Args:
            settings: All settings.
            width: Of the rendered region [px].
            height: Of the rendered region [px].
            lines: Height of the full frame [px].
            light_passes: Names from LIGHT_PASSES (passes/composite.py) that will be read.
            denoised: Whether the picture is going to be denoised.
        """
        old, size = self._settings, (width, height, lines)
        same = (size, light_passes, denoised) == (self._size, self._light_passes, self._denoised)
        if same and same_frames(settings, old):
            alone, self._settings = self._traced_alone, settings
            if settings.debug != old.debug:
                self.pipeline.show(settings.debug.view)
                # The blend at rest would take the newest frame for the picture that it blends with.
                self._forget_samples()
                if alone != self._traced_alone:
                    # Unseen frames ask no probe for its light.
                    self._empty_pipeline()
            return
        self._settings, self._size, self._light_passes, self._denoised = settings, size, light_passes, denoised
        film, supersampling = settings.film, self._supersampling
        self._filter = wp.array(filter_table(film.pixel_filter, film.filter_width), dtype=float, device=self.device)
        self._film = None
        supersampling.configure(settings, width, height)
        self._quantiles = supersampling.quantiles(film)
        self._motion_reach = motion_reach(self._quantiles)
        self._empty_pipeline()
        self._blend.resize(width, height)
        self.restart()

    def _empty_pipeline(self) -> None:
        """Set the pipeline up without any history; its buffers come with the first frame."""
        self._ending_options = self._ending_for = None
        self.views.restart()
        factor = self._supersampling.factor
        fine = tuple(factor * side for side in self._size)
        self.pipeline.configure(
            densified(self._settings, *fine, self.device, factor, seen=not self._traced_alone), *fine[:2],
            self._light_passes)
        self.pipeline.composite.sharpness = sharpness_of(self._quantiles)

    def restart(self) -> None:
        """Forget everything: the next frame is the first."""
        self.views.restart()
        self.pipeline.reset()
        self._forget_samples()

    def note(self, *, moved: bool, lit: bool) -> None:
        """Take in that the scene has changed since the last frame: objects moved, light or materials were edited."""
        self._moved |= moved
        self._lit |= lit
        self._forget_samples()

    def note_camera(self) -> None:
        """Take in that the camera has changed."""
        self._forget_samples()

    def _forget_samples(self) -> None:
        self.frames = 0
        self.reference.reset()
        self._blend.reset()
        self._blended = False
        self._resolved = None
        self._whole_paths = False
        if self._film is not None:
            self._film.clear()

    @property
    def samples_done(self) -> int:
        """Return path-traced samples since anything changed, and the frames that are part of the picture."""
        return self.reference.samples_done + (0 if self._traced_alone else self.frames)

    @property
    def _traced_alone(self) -> bool:
        """Return whether no frame is part of the picture."""
        return self._denoised and not self._light_passes and self._traces

    @property
    def _traces(self) -> bool:
        """Return whether pictures at rest have path-traced samples."""
        settings = self._settings
        return settings.denoiser.path_traced_rest and settings.debug.view in ("", *RestBlend.debug_views)

    @property
    def shows_frames(self) -> bool:
        """Return whether there are frames in the picture."""
        return self.frames > 0 and not self._traced_alone

    def step(
        self, scene: DeviceScene, camera: np.ndarray, options: Callable[[], Options], samples: int,
        should_stop: Callable[[], bool],
    ) -> None:
        """Render up to `samples` frames, or path-traced samples of a picture at rest."""
        target = self.samples_done + samples
        self._resolved = None
        while self.samples_done < target and not should_stop():
            turn = self._samples_due()
            if turn:
                self._trace(scene, camera, options(), min(turn, target - self.samples_done), should_stop)
            elif self._traced_alone:
                self._fill(scene, camera)
            else:
                self._frame(scene, camera)

    def _samples_due(self) -> int:
        """Return how many path-traced samples come next; 0 when it is a frame's turn."""
        denoiser, traced = self._settings.denoiser, self.reference.samples_done
        if not self._traces:
            return 0
        if self._denoised:
            return max(self._filled_until() - traced, 0) if self._traced_alone else (
                1 << 30 if self.frames >= LIGHT_FRAMES else 0)
        if self.frames >= max(denoiser.rest_frames, 1):
            return 1 << 30
        if self.frames < SETTLING:
            return 0
        # A turn of samples ends when they have come level with the frames, one of frames when those are TURN ahead.
        ahead = self.frames - SETTLING + TURN - traced
        return ahead if ahead >= TURN or traced % TURN else 0

    def _fill(self, scene: DeviceScene, camera: np.ndarray) -> None:
        """Let a frame fill the cache; where it does not fit the device, paths go to their ends."""
        try:
            self._frame(scene, camera, unseen=True)
        except OutOfDeviceMemory:
            self._whole_paths = True
            self._empty_pipeline()

    def _filled_until(self) -> int:
        """Return how many samples there are when the next frame fills the cache."""
        starts, pixels = FILLING_AT[self._kind], self._size[0] * self._size[1]
        turn = self.frames // FILLING_FRAMES[self._kind]
        if self._whole_paths or turn >= len(starts) or not self._ends_paths or pixels < LEAST_FILLED[self._kind]:
            return 1 << 30
        if self.frames == 0 and self.reference.samples_done == starts[0]:
            # Asked once: the device is waited for.
            rays = self.reference.rays / (pixels * starts[0])
            self._whole_paths = rays < LONG_PATHS
        return 1 << 30 if self._whole_paths else starts[turn]

    def _frame(self, scene: DeviceScene, camera: np.ndarray, unseen: bool = False) -> None:
        settings, camera = self._settings, self._supersampling.camera(camera)
        if self.views.moved_by(camera) > KEYS_REPEAT * smallest_cell(settings.cache, scene.radius):
            self.restart()
        self.views.advance(
            camera, moved=self._moved, lit=self._lit, exposure=settings.film.exposure,
            transparent=settings.film.transparent,
            filter_quantiles=self._quantiles if settings.denoiser.antialiasing else None,
            motion_reach=self._motion_reach)
        self._moved = self._lit = False
        self.pipeline.frame(scene, self.views, timed=self.timed, unseen=unseen)
        self.frames += 1
        if unseen:
            return
        self._shown = self._supersampling.average(self.pipeline.picture)
        if self._settings.denoiser.path_traced_rest and self.views.rest > 0:
            self._blend.add_frame(self.pipeline.gbuffer.current(self.views.parity), self._supersampling.factor)

    def _trace(
        self, scene: DeviceScene, camera: np.ndarray, options: Options, count: int, should_stop: Callable[[], bool],
    ) -> None:
        target = self.reference.samples_done + count
        self.reference.take_scene(scene)
        self.reference.render(
            scene.scene, camera, self._ending(options), self._filter, self._samples_film(), target, should_stop)
        self._blended = True

    @property
    def _ends_paths(self) -> bool:
        """Return whether paths shall end in the cache: where it and they have all bounces."""
        cache, limit = self._settings.cache, self._settings.light_paths.max_bounces
        whole = cache.bounces == 0 and (limit == 0 or limit >= MANY_BOUNCES)
        return (cache.ends_paths and whole and cache.key == CacheKey.NORMAL
                and self._size[0] * self._size[1] >= LEAST_PIXELS)

    def _ending(self, options: Options) -> Options:
        """Return options with which paths may end in the cache, if that is wanted and frames have filled it."""
        if self.frames == 0 or not self._ends_paths:
            return options
        made, records = self._ending_for, self.pipeline.records
        if made is None or made[0] is not options or made[1] != records:
            self._ending_for = options, records
            known = KnownLight()
            known.samples, known.views, known.grid = ENDED_SAMPLES, self.views.array, self.pipeline.cache.grid
            ending = copy_struct(options)
            ending.known = known
            # The same object as long as it has the same numbers and addresses: launches are recorded with it.
            if self._ending_options is None or bytes(self._ending_options._ctype) != bytes(ending._ctype):
                self._ending_options = ending
        return self._ending_options

    def _samples_film(self) -> FilmBuffers:
        """Return the film of path-traced samples, made when it is first asked for."""
        if self._film is None:
            pixels = self._size[0] * self._size[1]
            self._film = FilmBuffers.make(pixels, False, self.device, denoised=self._denoised)
            self.reference.resize(pixels, False, denoised=self._denoised)
        return self._film

    def picture(self) -> wp.array:
        """Return the newest picture: vec4 [h * w], as the film shows it."""
        if self._denoised and not self.shows_frames:
            buffers = self._samples_film()
            launch(film.resolve_color, buffers.pixel_count, [buffers.film, int(self._settings.film.transparent)],
                   [buffers.picture], self.device)
            return buffers.picture
        blend = self._newest_blend()
        if blend is None:
            return self._shown
        return self._blend.show_weight() if self._settings.debug.view else blend

    @property
    def supersampled(self) -> bool:
        """Return whether frames have more pixels than the picture."""
        return self._supersampling.factor > 1

    def samples(self) -> tuple[ReferencePass, FilmBuffers] | None:
        """Return the path-traced samples and their tracer; None before the first."""
        return (self.reference, self._film) if self._film is not None and self.reference.samples_done > 0 else None

    def light_pass(self, name: str) -> wp.array:
        """Return one of LIGHT_PASSES as the newest picture has it: vec3 [h * w], exposed."""
        composite, average = self.pipeline.composite, self._supersampling.average
        light, blend = composite.read_light_pass(name, average), self._newest_blend()
        sharp = composite.accumulated.current(self.views.parity).color
        if name.endswith(" Color") or (blend is None and self.pipeline.picture is sharp):
            return light
        return self._blend.scale_light(average(sharp), self._shown if blend is None else blend, light)

    def _newest_blend(self) -> wp.array | None:
        """Return frames and samples as one picture, made once after each step; None without samples."""
        if self._resolved is None and self._blended and self.reference.samples_done > 0:
            self._resolved = self._blend.resolve(self._film, self._shown, self._settings.film.transparent)
        return self._resolved


def settings_for(settings: RenderSettings, camera: CameraData, *, traced: bool = False) -> RenderSettings:
    """Return the settings with which a camera's pictures are made: real-time frames project and reproject.

    `traced`: whether the scene has what frames don't know.
    """
    if settings.sampling.integrator != Integrator.REALTIME or not (camera.panoramic or traced):
        return settings
    return replace(settings, sampling=replace(settings.sampling, integrator=Integrator.REFERENCE))


def fog_traced(media: SceneMedia | None, passes: tuple[str, ...]) -> bool:
    """Return whether a scene's fog is path-traced in every frame: where it is dense, and with some passes.

    Those of surfaces' light: in frames these know nothing of what is before them.
    """
    if media is None or media.fog is None:
        return False
    return media.fog.traced or any(name in LIGHT_PASSES for name in passes)


def same_frames(new: RenderSettings, old: RenderSettings | None) -> bool:
    """Tell whether frames with `new` settings look like those with `old` ones, apart from the debug view."""
    if old is None or new.performance.deterministic != old.performance.deterministic:
        return False
    return new.sampling.seed == old.sampling.seed and all(
        getattr(new, name) == getattr(old, name) for name in FRAME_GROUPS)
