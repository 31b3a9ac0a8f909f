# SPDX-License-Identifier: GPL-3.0-or-later
"""Final renders: one call per view layer, its views in a loop; border, progress, cancel, passes, failures.

Owns the error contract: whatever goes wrong ends in report.fail, so that `bpy.ops.render.render` raises and no file is
written; device memory is freed in `finally`. May run outside the main thread: never touches bpy.context's window.
"""

from __future__ import annotations

import dataclasses
import logging
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ..engine.cryptomatte import matte_header
from ..engine.errors import BurnishError, InvalidScene
from ..engine.report import Report, ReportKind
from ..engine.report_realtime import SceneFacts, realtime_approximations, scene_facts
from ..engine.scene import CameraData
from ..engine.session import DENOISED
from ..engine.settings import DebugSettings, RenderSettings
from . import builds, oidn, passes, preferences, preview, report, shutter
from .extract.camera import camera_from_scene
from .extract.motion import OtherFrame, read_other_frames
from .extract.scene import ExtractionCancelled, SceneExtractor
from .extract.settings import settings_from_scene
from .passes import LIGHT_PASSES
from .progress import Cancelled, RenderProgress
from .sampling import Sampling

__all__ = ["FinishedHook", "RenderInfo", "crop_rectangle", "on_finished", "render"]

log = logging.getLogger(__name__)

debug_view = ""
"""Intermediate result that final renders show instead of the picture, for the command line. The scene's own choice is
for viewports alone: left on by mistake, it would spoil an animation."""

open_session = builds.open_session
build_kernels = builds.build_kernels


@dataclass(frozen=True, kw_only=True)
class RenderInfo:
    """Figures of one rendered picture, for on_finished."""

    frame: int
    samples: int
    """Samples per pixel reached"""
    seconds: float
    """Time spent sampling [s]"""
    device: str
    cancelled: bool
    crop: tuple[int, int, int, int] | None
    """x, y, width, height [px] of the border in the full frame"""
    stats: Any
    report: Report
    frame_times: dict[str, float] = dataclasses.field(default_factory=dict)
    """Milliseconds of each section of a real-time frame"""
    skipped: dict[str, str] = dataclasses.field(default_factory=dict)
    """Sections that real-time frames did without, with the reason"""
    channels: dict[str, str] = dataclasses.field(default_factory=dict)
    """A letter per channel of each pass"""
    header: dict[str, str] = dataclasses.field(default_factory=dict)
    """What files say beside the pixels: Cryptomatte's names"""


FinishedHook = Callable[[str, str, dict[str, np.ndarray], RenderInfo], None]

on_finished: list[FinishedHook] = []
"""Called after each picture with the names of view layer and view and the passes by name, [h, w, c], bottom row first.

Blender has no pixels of a 'Render Result' in background; who needs them (the command line, tests) listens here.
"""


def render(engine: Any, depsgraph: Any) -> None:
    """Render the view layer of `depsgraph` into `engine`; never raises: a failure is reported to Blender."""
    if engine.is_preview:
        preview.render(engine, depsgraph)
        return
    try:
        with_session(engine, depsgraph, FinalRender(engine, depsgraph))
    except (Cancelled, ExtractionCancelled):
        log.info("Render cancelled")
    except Exception as error:
        report.fail(engine, error)


def with_session(engine: Any, depsgraph: Any, job: FinalRender) -> None:
    """Build the kernels, run `job` in a session, and close that whatever happens, unless Blender wants it kept."""
    build_kernels(job.settings.device, job.progress.stage, should_stop=engine.test_break,
                  integrator=job.settings.sampling.integrator)
    session, extractor = take_kept(engine, job.settings) or (open_session(job.settings), SceneExtractor())
    keep = False
    try:
        with builds.telling_builds(job.progress.stage):
            job.run(session, extractor, depsgraph)
        keep = job.scene.render.use_persistent_data
    finally:
        report.publish("Render", merged(session.report, job.report), report.session_details(session))
        if keep:
            keep_session(engine, session, extractor, job.settings)
        else:
            session.close()


def take_kept(engine: Any, settings: RenderSettings) -> tuple[Any, SceneExtractor] | None:
    """Return the session and extractor that the previous frame left in `engine` (Persistent Data), or None."""
    kept = getattr(engine, "kept", None)
    if not kept:
        return None
    session, extractor, device = kept.pop()
    if device == settings.device:
        return session, extractor
    session.close()
    return None


def keep_session(engine: Any, session: Any, extractor: SceneExtractor, settings: RenderSettings) -> None:
    """Leave a session in `engine`, which Blender keeps between frames, and close it when Blender frees that."""
    if getattr(engine, "kept", None) is None:
        engine.kept = []
        weakref.finalize(engine, close_kept, engine.kept).atexit = False
    engine.kept.append((session, extractor, settings.device))


def close_kept(kept: list[tuple[Any, SceneExtractor, Any]]) -> None:
    """Close the sessions in a list."""
    while kept:
        kept.pop()[0].close()


def merged(first: Report, second: Report) -> Report:
    """Return a new report with the entries of both."""
    both = Report()
    both.merge(first)
    both.merge(second)
    return both


class FinalRender:
    """One view layer of one frame: what to render, in which order, and where to."""

    def __init__(self, engine: Any, depsgraph: Any, overrides: Callable[[RenderSettings], RenderSettings] | None = None,
                 ) -> None:
        scene = depsgraph.scene_eval
        self.engine = engine
        self.scene = scene
        self.layer = depsgraph.view_layer_eval.name
        self.settings = preferences.with_device(settings_from_scene(scene, viewport=False))
        if overrides is not None:
            self.settings = overrides(self.settings)
        self.settings = dataclasses.replace(self.settings, debug=DebugSettings(view=debug_view))
        self.blurred = shutter.is_open(engine, depsgraph) and not debug_view
        self.denoised = self.settings.denoiser.final_denoise and not self.settings.debug.view
        integrator = self.settings.sampling.integrator
        self.aovs = tuple(passes.enabled_aovs(depsgraph.view_layer_eval, integrator))
        self.report = passes.missing_passes(depsgraph.view_layer_eval, integrator)
        self.alpha_threshold = depsgraph.view_layer_eval.pass_alpha_threshold
        self.facts = SceneFacts()
        self.others: tuple[OtherFrame, ...] = ()
        """The frames before and after, where they are asked for"""
        self.mesh_keys: dict[tuple[int, int], int] = {}
        self.views = view_names(scene.render)
        self.width, self.height = engine.resolution_x, engine.resolution_y
        self.crop = crop_rectangle(scene.render, self.width, self.height)
        self.progress = RenderProgress(engine, frame=scene.frame_current, layer=self.layer, parts=len(self.views),
                                       background=bpy.app.background)

    def run(self, session: Any, extractor: SceneExtractor, depsgraph: Any) -> None:
        """Extract the scene once and render each view."""
        if any(aov.source == "Vector" for aov in self.aovs):
            self.progress.stage("Reading the frames before and after")
            self.others = read_other_frames(self.engine, depsgraph, lambda: self._cameras(depsgraph))
            self.scene = depsgraph.scene_eval
        self.progress.stage("Reading the scene")
        delta = extractor.extract(depsgraph, viewport=False, report=self.report, progress=self.progress.stage,
                                  cancelled=self.engine.test_break, performance=self.settings.performance)
        self.facts = scene_facts(
            extractor.materials(), extractor.linked_materials(), extractor.world, catchers=extractor.has_catchers)
        session.update(delta, self.progress.stage)
        self.mesh_keys = extractor.mesh_keys() if self.others else {}
        # Markers change the scene's camera from frame to frame.
        self.camera = self.engine.camera_override or depsgraph.scene.camera
        exposure = shutter.Shutter(self.engine, depsgraph, session, extractor, self.settings,
                                   self.report) if self.blurred else None
        for part, view in enumerate(self.views):
            self.progress.part = part
            if len(self.views) > 1:
                self.progress.title = f"{self.layer} | {view}"
            self._render_view(session, depsgraph, view, exposure)
            if self.engine.test_break():
                return

    def _cameras(self, depsgraph: Any) -> dict[str, CameraData]:
        """Return the cameras of all views as they are evaluated now."""
        cameras = {}
        for view in self.views:
            self.engine.active_view_set(view)
            cameras[view] = self._camera(depsgraph)
        return cameras

    def _camera(self, depsgraph: Any, camera_object: Any = None) -> CameraData:
        """Return the camera of the active view as it is evaluated now; the scene's where no object is given."""
        return view_camera(self.engine, depsgraph, self.width, self.height, stereo=len(self.views) > 1,
                           camera_object=camera_object)

    def _render_view(self, session: Any, depsgraph: Any, view: str, exposure: shutter.Shutter | None) -> None:
        engine = self.engine
        engine.active_view_set(view)
        camera = self._camera(depsgraph)
        names = (*(aov.source for aov in self.aovs), *((DENOISED,) if self.denoised else ()))
        # A picture to be denoised has frames for its light passes alone, else it is path-traced from the start.
        lit = any(name in LIGHT_PASSES for name in names)
        traced = self.denoised and not lit and self.settings.denoiser.path_traced_rest
        approximations = Report() if traced else realtime_approximations(
            self.settings, self.facts, camera.aperture_radius, camera.panoramic, self.blurred)
        for (kind, owner, message), count in approximations.counts.items():
            # Once, however many views there are.
            self.report.counts[kind, owner, message] = count
        session.first_hits.alpha_threshold = self.alpha_threshold
        session.first_hits.motion = tuple(other.motion(view, self.mesh_keys) for other in self.others) or None
        drawn = shutter.path_traced(self.settings) if self.blurred else self.settings
        session.configure(drawn, camera, self.width, self.height, self.crop, names)
        # A kept session remembers the frame before: a picture must not depend on what was rendered before it.
        session.reset()
        width, height = (self.width, self.height) if self.crop is None else self.crop[2:]
        # With a border, Blender's result has the border's size while it renders; Blender itself puts it into the frame.
        result = engine.begin_result(0, 0, width, height, layer=self.layer, view=view)
        if result is None:
            raise BurnishError(f"Blender has no result of {width} x {height} pixels for view layer '{self.layer}'")
        finished = False
        try:
            # A picture to be denoised has no frames, or no more than its light passes need.
            sampling = Sampling(session, drawn, self.progress, timed=not self.denoised, cancelled=self._cancelled,
                                show=lambda: self._show(session, result))
            surfaces = self._sample(session, depsgraph, sampling, exposure)
            samples, seconds = sampling.done, sampling.elapsed
            pixels = {aov.name: self._combined(session) if aov.name == "Combined"
                      else session.read(aov.source) if aov.source not in surfaces else surfaces[aov.source]
                      for aov in self.aovs}
            self._write(result, pixels)
            header = matte_header(self.layer, session.first_hits.manifests)
            for field, text in header.items():
                # Where compositor nodes and files look for it; `result` hands over pixels alone.
                engine.get_result().stamp_data_add_field(field, text)
            finished = True
        finally:
            engine.end_result(result, cancel=not finished)
        info = RenderInfo(frame=self.scene.frame_current, samples=samples, seconds=seconds, crop=self.crop,
                          device=session.device_name, cancelled=bool(engine.test_break()), stats=session.stats,
                          report=merged(session.report, self.report), frame_times=dict(session.frame_times),
                          skipped=dict(session.skipped), header=header,
                          channels={aov.name: aov.channels for aov in self.aovs})
        for hook in list(on_finished):
            hook(self.layer, view, pixels, info)

    def _combined(self, session: Any) -> np.ndarray:
        """Return the combined pass, denoised if asked for; where that fails it is not, and the report says so."""
        if self.denoised and not self.engine.test_break():
            self.progress.stage("Denoising")
            try:
                return oidn.denoise(session)
            except BurnishError as error:
                self.report.add(ReportKind.ERROR, "", f"the picture is not denoised. {error}")
                self.engine.report({'WARNING'}, f"Burnish: the picture is not denoised. {error}")
        return session.read("Combined")

    def _cancelled(self) -> bool:
        return bool(self.engine.test_break())

    def _show(self, session: Any, result: Any) -> None:
        """Show the picture as it is so far."""
        self._write(result, {"Combined": session.read("Combined")})
        self.engine.update_result(result)

    def _sample(self, session: Any, depsgraph: Any, sampling: Sampling,
                exposure: shutter.Shutter | None) -> dict[str, np.ndarray]:
        """Take the picture's samples: until there are enough, the time is up or the user cancels.

        Returns the passes that can't be read afterwards.
        """
        if exposure is None:
            sampling.add(sampling.total, lambda: self._cancelled() or sampling.late())
            return {}
        surfaces = shutter.read_surfaces(
            session, {aov.source for aov in self.aovs}, sampling.total, self._cancelled)
        try:
            exposure.expose(sampling, lambda: self._camera(depsgraph, self.camera))
        finally:
            # Evaluated anew.
            self.scene = depsgraph.scene_eval
        return surfaces

    def _write(self, result: Any, pixels: dict[str, np.ndarray]) -> None:
        for render_pass in result.layers[0].passes:
            if render_pass.name in pixels:
                passes.write_pass(render_pass, pixels[render_pass.name])


def view_names(render_settings: Any) -> tuple[str, ...]:
    """Return the names of the views to render; one empty name without multiview."""
    if not render_settings.use_multiview:
        return ("",)
    views = [view.name for view in render_settings.views if view.use]
    if render_settings.views_format == 'STEREO_3D':
        views = [name for name in views if name in {"left", "right"}]
    if not views:
        raise InvalidScene("Stereoscopy is on, but no view is enabled; enable one in Output Properties > Stereoscopy")
    return tuple(views)


def crop_rectangle(render_settings: Any, width: int, height: int) -> tuple[int, int, int, int] | None:
    """Return the render border in pixels (x, y, width, height) from the bottom left, or None without one.

    Truncates as Blender does for its result (render_init_from_main in Blender's pipeline.cc), or sizes would differ.
    """
    if not render_settings.use_border:
        return None
    left, right = int(render_settings.border_min_x * width), int(render_settings.border_max_x * width)
    bottom, top = int(render_settings.border_min_y * height), int(render_settings.border_max_y * height)
    if right <= left or top <= bottom:
        raise InvalidScene("The render border is empty; draw it again or turn it off in Output Properties > Format")
    return left, bottom, right - left, top - bottom


def view_camera(engine: Any, depsgraph: Any, width: int, height: int, *, stereo: bool,
                camera_object: Any = None) -> CameraData:
    """Return the camera of the engine's active view, with its stereo offset; the scene's where no object is given."""
    camera_object = camera_object or engine.camera_override or depsgraph.scene.camera
    if camera_object is None:
        raise InvalidScene("The scene has no camera; add one and make it active in Scene Properties")
    camera_object = camera_object.evaluated_get(depsgraph)
    camera = camera_from_scene(depsgraph.scene_eval, camera_object, width, height)
    return stereo_camera(engine, camera_object, camera) if stereo else camera


def stereo_camera(engine: Any, camera_object: Any, camera: CameraData) -> CameraData:
    """Move a camera to its eye: Blender gives the eye's matrix and lens shift, in units of the fitted sensor side."""
    # A flat list of 16 floats, column after column.
    columns = np.array(engine.camera_model_matrix(camera_object), np.float64).reshape(4, 4)
    matrix = columns.T if abs(columns[3, 3] - 1.0) < 1e-6 and np.allclose(columns[:3, 3], 0.0) else columns
    axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-30)
    eye = np.eye(4)
    eye[:3, :3], eye[:3, 3] = axes, matrix[:3, 3]
    if camera.panoramic:
        return dataclasses.replace(camera, transform=tuple(float(v) for v in eye.ravel()))
    left, right, bottom, top = camera.window
    fit = camera_object.data.sensor_fit
    wide = fit == 'HORIZONTAL' or (fit == 'AUTO' and right - left >= top - bottom)
    side = (right - left) if wide else (top - bottom)
    shift = (engine.camera_shift_x(camera_object) - camera_object.data.shift_x) * side
    return dataclasses.replace(camera, transform=tuple(float(v) for v in eye.ravel()),
                               window=(left + shift, right + shift, bottom, top))
