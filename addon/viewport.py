# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered viewports: extracts scene changes, posts views to a worker, draws its newest picture. Main thread only.

Blender tells about scene changes in view_update; camera moves, zoom, resizes, borders and shading options show only as
another view_draw, so they are compared there. A timer looks for new pictures while a worker is busy and ends with it,
so that a viewport at rest costs nothing.
"""

from __future__ import annotations

import logging
import time
import weakref
from typing import Any

import bpy

from ..engine.device import start_warp
from ..engine.report import Report, ReportKind
from ..engine.report_realtime import SceneFacts, realtime_approximations, scene_facts
from ..engine.scene import SceneDelta
from . import oidn, preferences, report
from .builds import build_kernels, open_session
from .display import Display, free_shader
from .extract.camera import border_from_view, camera_from_view
from .extract.scene import SceneExtractor
from .extract.settings import settings_from_scene
from .view_request import ViewRequest
from .worker import ViewportWorker

__all__ = ["Viewport", "forget_scenes", "stop_all", "view_draw", "view_update", "viewports"]

log = logging.getLogger(__name__)

TICK_SECONDS = 1.0 / 60.0
JOIN_SECONDS = 2.0

viewports: set[Viewport] = set()
"""All viewports that have a worker."""


def view_update(engine: Any, context: Any, depsgraph: Any) -> None:
    """Take in scene changes for the viewport of `engine`; the first call opens it."""
    try:
        ensure_viewport(engine).update(context, depsgraph)
    except Exception as error:
        stop_with_message(engine, error)


def view_draw(engine: Any, context: Any, depsgraph: Any) -> None:
    """Post what the viewport of `engine` should show and draw what there is."""
    try:
        ensure_viewport(engine).draw(context, depsgraph)
    except Exception as error:
        stop_with_message(engine, error)


def ensure_viewport(engine: Any) -> Viewport:
    """Return the Viewport of a RenderEngine instance, made at the first call."""
    viewport = getattr(engine, "viewport", None)
    if viewport is None:
        viewport = engine.viewport = Viewport(engine)
        # Not __del__: Blender's own documentation of it raises AttributeError in 5.2.
        weakref.finalize(engine, viewport.close).atexit = False
    return viewport


def stop_with_message(engine: Any, error: Exception) -> None:
    """Stop a viewport after an error on the main thread and show a sentence in it."""
    sentence = report.error_sentence(error)
    viewport = getattr(engine, "viewport", None)
    if viewport is not None:
        viewport.stop_worker()
        viewport.message = sentence
    engine.update_stats("Burnish stopped", sentence)


class Viewport:
    """One rendered 3D view: its worker, its extractor and its textures."""

    def __init__(self, engine: Any) -> None:
        self._engine = weakref.ref(engine)
        self._display = Display()
        self._worker: ViewportWorker | None = None
        self._extractor: SceneExtractor | None = None
        self._drawn_serial = -1
        self._status_serial = -1
        self._device: Any = None
        self._report = Report()
        self._view_report = Report()
        self._facts = SceneFacts()
        self._approximations = Report()
        self._report_counts: dict[Any, int] = {}
        self.message = ""
        """Error of the main thread's half, shown until the next update."""
        self.draw_seconds = 0.0
        """Time of the last view_draw [s]"""

    # Called by Blender -----------------------------------------------------------------------------------------------

    def update(self, context: Any, depsgraph: Any) -> None:
        """Extract what changed and post it; a failed worker is replaced, with the full scene."""
        self.message = ""
        performance = None
        if self._worker is None or self._worker.failed or not self._worker.alive:
            self._restart()
            performance = settings_from_scene(context.scene, viewport=True).performance
        self._report = Report()
        delta = self._extractor.extract(depsgraph, viewport=True, report=self._report, space=context.space_data,
                                        performance=performance)
        if delta.full or delta.materials or delta.world is not None or delta.instances is not None:
            self._facts = scene_facts(
                self._extractor.materials(), self._extractor.linked_materials(), self._extractor.world,
                catchers=self._extractor.has_catchers)
        if not is_empty(delta):
            self._worker.post_scene(delta)
            start_timer()

    def draw(self, context: Any, depsgraph: Any) -> None:
        """Post the view if it changed; draw the newest picture and the status line."""
        start = time.perf_counter()
        engine = self._engine()
        if self._worker is None:
            engine.update_stats("Burnish", self.message or "Stopped")
            return
        region = context.region
        request = self._request(context, depsgraph)
        if self._device is not None and request.settings.device != self._device:
            # The scene lives on the old device: start over; view_update follows the tag.
            self.stop_worker()
            engine.tag_update()
        self._device = request.settings.device
        self._approximations = realtime_approximations(
            request.settings, self._facts, request.camera.aperture_radius, request.camera.panoramic)
        if self._worker is not None and self._worker.post_view(request):
            start_timer()
        self._show(engine, region)
        self.draw_seconds = time.perf_counter() - start

    # Called by the timer and the handlers ----------------------------------------------------------------------------

    def tick(self) -> bool:
        """Ask for a redraw if there is something new to draw; return whether the worker is still busy."""
        worker, engine = self._worker, self._engine()
        if engine is None:
            self.close()
            return False
        if worker is None:
            return False
        status, picture = worker.status, worker.picture
        serial = picture.serial if picture is not None else -1
        if serial != self._drawn_serial or status.serial != self._status_serial:
            try:
                engine.tag_redraw()
            except ReferenceError:
                self.close()
                return False
        self._publish(status)
        return status.busy

    def forget_scene(self) -> None:
        """Make the next update read everything (after undo, every cached data-block may have been replaced)."""
        if self._extractor is not None:
            self._extractor.refresh()

    def stop_worker(self) -> None:
        """Ask the worker to end, without waiting, and drop it."""
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.stop()
            viewports.discard(self)
            _stopped.add(worker)

    def close(self) -> None:
        """End the viewport: called when Blender frees its engine."""
        self.stop_worker()
        self._extractor = None
        self._display.free()

    # Parts -----------------------------------------------------------------------------------------------------------

    def _restart(self) -> None:
        self.stop_worker()
        self._extractor = SceneExtractor()
        self._device = None
        self._drawn_serial = -1
        self._display.free()
        # Before the extraction, which folds constants with Warp's functions and would start it with its banner.
        start_warp()
        self._worker = ViewportWorker(open_session, build_kernels, library=oidn.library())
        self._worker.start()
        viewports.add(self)

    def _request(self, context: Any, depsgraph: Any) -> ViewRequest:
        region, view, space = context.region, context.region_data, context.space_data
        # The original scene, not the evaluated copy: add-on properties don't always reach the copy at once.
        settings = preferences.with_device(settings_from_scene(context.scene, viewport=True))
        self._note_shading(space.shading)
        return ViewRequest(settings=settings, camera=camera_from_view(region, view, space, depsgraph),
                           width=region.width, height=region.height, traced=self._facts.traced,
                           crop=border_from_view(region, view, space, depsgraph))

    def _note_shading(self, shading: Any) -> None:
        self._view_report = Report()
        if not shading.use_scene_lights_render:
            self._view_report.add(ReportKind.SKIPPED, "3D view",
                                  "Scene Lights switched off: the lamps are drawn all the same")
        if not shading.use_scene_world_render:
            self._view_report.add(ReportKind.SKIPPED, "3D view",
                                  "Scene World switched off: the scene's world is drawn instead of the studio light")
        if shading.render_pass != 'COMBINED':
            self._view_report.add(ReportKind.SKIPPED, "3D view", "only the Combined pass is drawn in the viewport")

    def _show(self, engine: Any, region: Any) -> None:
        if self._worker is None:
            return
        status, picture = self._worker.status, self._worker.picture
        if self._worker.device and not self._worker.share_pictures:
            # Quick after the first time; a GPU context is only current while drawing.
            self._worker.share_pictures = self._display.can_share(self._worker.device)
        if picture is not None:
            engine.bind_display_space_shader(bpy.context.scene)
            self._display.draw(picture, region.width, region.height)
            engine.unbind_display_space_shader()
            self._drawn_serial = picture.serial
        structure = getattr(status.stats, "structure", "") if status.stats is not None else ""
        engine.update_stats("Burnish stopped" if status.error else structure, self.message or status.text)
        self._status_serial = status.serial

    def _publish(self, status: Any) -> None:
        merged = Report()
        for part in (self._report, self._view_report, self._approximations, status.report):
            merged.merge(part)
        if status.error:
            merged.add(ReportKind.ERROR, "3D view", status.error)
        if merged.counts != self._report_counts:
            self._report_counts = merged.counts
            report.publish("Viewport", merged)
        if status.stats is not None:
            report.publish_details("Viewport", report.stats_details(status.stats)
                                   + report.timing_details(status.frame_times, status.skipped))


def is_empty(delta: SceneDelta) -> bool:
    """Tell whether a delta changes nothing: then the picture need not start anew."""
    return not (delta.full or delta.meshes or delta.materials or delta.images) and (
        delta.instances is None and delta.lights is None and delta.world is None)


_stopped: weakref.WeakSet[ViewportWorker] = weakref.WeakSet()


def start_timer() -> None:
    """Start looking for new pictures, unless it is being done already."""
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=TICK_SECONDS)


def _tick() -> float | None:
    busy = False
    for viewport in list(viewports):
        try:
            busy |= viewport.tick()
        except Exception:
            log.exception("A viewport's timer failed")
            viewport.close()
    return TICK_SECONDS if busy else None


def forget_scenes() -> None:
    """Make every viewport read its whole scene at its next update."""
    for viewport in list(viewports):
        viewport.forget_scene()


def stop_all() -> None:
    """Stop all viewports and wait for their threads (file load, unregister, exit)."""
    for viewport in list(viewports):
        viewport.close()
    for worker in list(_stopped):
        if not worker.join(JOIN_SECONDS):
            log.warning("A viewport's worker did not end within %s s", JOIN_SECONDS)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    free_shader()
