# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker thread of one viewport: owns an engine Session and turns what is posted into pictures.

Knows nothing of bpy and never sees the RenderEngine: the main thread posts scene changes and views and takes the
newest picture. It renders coarsely first and refines, and sleeps without any timer once it has nothing to do. In real
time each frame is shown, and the size stays the same while something moves, since another one would lose the history.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from ..engine.errors import BurnishError
from ..engine.report import Report
from ..engine.scene import SceneDelta
from ..engine.settings import RenderSettings
from .builds import build_kernels, build_rest, open_session, telling_builds
from .picture import Picture, display_pixels
from .resolution import ResolutionControl, divided_size
from .rest_denoise import RestDenoiser
from .view_request import ViewRequest, divided_crop, divided_settings, picture_area, real_time, restarts, step_text

__all__ = ["ViewportWorker", "WorkerStatus"]

log = logging.getLogger(__name__)

STEP_SECONDS = 0.1
"""Aimed-at length of one Session.step once the picture has its full resolution."""
PUBLISH_SECONDS = 0.1
"""Shortest time between two pictures of the same view."""
PUBLISH_SHARE = 0.1
"""Largest share of the time that goes into reading and packing pictures."""
SETTLE_SECONDS = 0.3
"""Time without any change after which real-time frames go from the size for navigation to the full one."""
SHOWN_FRAMES = 32
"""Frames at rest that are all shown; later ones differ too little."""
TIMING_SECONDS = 1.0
"""Time between two real-time frames whose sections are measured: that makes a frame slower."""


@dataclass(frozen=True, kw_only=True)
class WorkerStatus:
    """What the viewport shows about its worker; replaced as a whole, never changed."""

    serial: int = 0
    """Rises whenever anything below changes."""
    text: str = ""
    progress: float = 0.0
    busy: bool = False
    """False when converged, idle, failed or stopped."""
    error: str = ""
    stats: Any = None
    """SessionStats, once there are some"""
    report: Report = field(default_factory=Report)
    frame_times: dict[str, float] = field(default_factory=dict)
    """Milliseconds of each section of a recent real-time frame"""
    skipped: dict[str, str] = field(default_factory=dict)
    """Sections that real-time frames do without, with the reason"""


class ViewportWorker:
    """One thread and one Session. All public methods are for the main thread and return at once."""

    def __init__(self, session_factory: Callable[[RenderSettings], Any] = open_session,
                 build: Callable[..., None] = build_kernels,
                 build_others: Callable[[str], None] = build_rest, library: Any = None) -> None:
        """Make the thread; start() starts it.

        Args:
            session_factory: Opens the session.
            build: Builds the kernels of the first picture.
            build_others: Builds those that it does not need.
            library: Open Image Denoise, from oidn.library; None: nothing is denoised.
        """
        self._session_factory = session_factory
        self._build, self._build_others = build, build_others
        self._wakeup = threading.Condition()
        self._deltas: list[SceneDelta] = []
        self._request: ViewRequest | None = None
        self._pending = False
        self._stopping = False
        self._picture: Picture | None = None
        self._status = WorkerStatus()
        self.device = ""
        """Warp's name of the session's device, once it is open."""
        self.share_pictures = False
        """Set by the main thread once it can draw pictures straight from the device (gl_interop.py)."""
        # Below: touched by the thread only.
        self._reader: Any = None
        self._session: Any = None
        self._control: ResolutionControl | None = None
        self._levels: tuple[int, ...] = (1,)
        self._level = 0
        self._rendered_level = -1
        self._changed_at = 0.0
        self._timed_at = 0.0
        self._recorded = True
        """Whether the last step recorded launches, too slow to tell the speed of those that follow."""
        self._picture_serial = 0
        self._published_at = 0.0
        self._publish_cost = 0.0
        self._has_scene = False
        self._planned: ViewRequest | None = None
        self._rest = RestDenoiser(library)
        self._thread = threading.Thread(target=self._run, name="burnish viewport", daemon=True)

    # Main thread -----------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def post_scene(self, delta: SceneDelta) -> None:
        """Hand over a scene change; changes are applied in the order in which they come."""
        with self._wakeup:
            self._deltas.append(delta)
            self._wake()

    def post_view(self, request: ViewRequest) -> bool:
        """Ask for a view; return whether it differs from the one asked for last."""
        with self._wakeup:
            if request == self._request:
                return False
            self._request = request
            self._wake()
            return True

    @property
    def picture(self) -> Picture | None:
        """The newest picture, or None before the first."""
        return self._picture

    @property
    def status(self) -> WorkerStatus:
        """The newest status."""
        return self._status

    @property
    def failed(self) -> bool:
        """Whether the thread ended with an error; only a new worker with the full scene goes on."""
        return bool(self._status.error)

    @property
    def alive(self) -> bool:
        """Whether the thread still runs."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Ask the thread to end and to free its device memory; does not wait."""
        with self._wakeup:
            self._stopping = True
            self._wakeup.notify()

    def join(self, timeout: float) -> bool:
        """Wait up to `timeout` seconds for the end; return whether it has come."""
        if self._thread.is_alive():
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def _wake(self) -> None:
        self._pending = True
        if not self._status.error:
            self._set_status(busy=True)
        self._wakeup.notify()

    # Worker thread ---------------------------------------------------------------------------------------------------

    def _set_status(self, **changes: Any) -> None:
        # With the lock held by either thread, or by the worker alone after it stopped listening: last write wins.
        current = self._status
        self._status = replace(current, serial=current.serial + 1, **changes)

    def _publish_status(self, **changes: Any) -> None:
        with self._wakeup:
            self._set_status(**changes)

    def _run(self) -> None:
        try:
            with telling_builds(self._show_progress):
                while self._wait():
                    self._serve()
        except BurnishError as error:
            self._fail(str(error))
        except Exception as error:
            log.exception("The viewport's worker failed")
            self._fail(f"Unexpected {type(error).__name__} while rendering: {error}")
        finally:
            self._close()

    def _fail(self, sentence: str) -> None:
        self._publish_status(error=sentence, text=sentence, busy=False)

    def _close(self) -> None:
        session, self._session = self._session, None
        try:
            if session is not None:
                session.close()
        except Exception:
            log.exception("Closing the viewport's session failed")
        self._publish_status(busy=False)

    def _wait(self) -> bool:
        """Sleep until there is something to do; return False when it is time to end."""
        with self._wakeup:
            while not self._stopping and not self._pending and not self._unfinished():
                if self._status.busy:
                    self._set_status(busy=False)
                self._wakeup.wait()
            return not self._stopping

    def _unfinished(self) -> bool:
        if self._session is None or self._request is None or not self._has_scene:
            return False
        if self._rendered_level < len(self._levels) - 1:
            return True
        limit = self._request.settings.sampling.viewport_samples
        return limit == 0 or self._session.samples_done < limit

    def _serve(self) -> None:
        with self._wakeup:
            request, deltas, pending = self._request, self._deltas, self._pending
            if request is None:
                # The session needs settings: keep the scene until the first view is asked for.
                self._pending = False
                return
            self._deltas, self._pending = [], False
        if self._session is None:
            self._open(request.settings)
        for delta in deltas:
            self._publish_status(text="Updating the scene", busy=True)
            self._session.update(delta, self._show_progress)
            self._has_scene = True
        if not self._has_scene or self._stopping:
            return
        if deltas or (pending and restarts(request, self._planned)):
            self._plan_levels(request)
        self._planned = request
        self._render(request)

    def _open(self, settings: RenderSettings) -> None:
        self._build(settings.device, self._show_progress, should_stop=lambda: self._stopping,
                    integrator=settings.sampling.integrator)
        self._session = self._session_factory(settings)
        self.device = getattr(self._session, "device", "")
        if hasattr(self._session, "resolve"):
            from ..engine.display import PictureReader

            self._reader = PictureReader(self.device)
        on_processor = str(getattr(self._session, "device_name", "cpu")).lower().startswith("cpu")
        self._on_processor = on_processor

    def _show_progress(self, text: str, progress: float) -> None:
        self._publish_status(text=text, progress=progress, busy=True)

    def _plan_levels(self, request: ViewRequest) -> None:
        if self._planned is not None and real_time(request) != real_time(self._planned):
            # One integrator's speed says nothing about the other's.
            self._planned = None
        if self._planned is None:
            coarse = 16 if self._on_processor else 4
            # A graphics processor that is too slow for the full size in real time shows that in its first frames.
            self._control = ResolutionControl(1 if real_time(request) and not self._on_processor else coarse)
        performance, pixels = request.settings.performance, self._pixels(request, 1)
        arguments = pixels, performance.frame_time, performance.viewport_pixel_size
        if real_time(request):
            first = self._control.steady_divider(*arguments, current=self._levels[0] if self._planned else 0)
            self._levels = (first, 1) if first > 1 else (1,)
        else:
            self._levels = self._control.levels(*arguments)
        self._level, self._rendered_level = 0, -1
        self._changed_at = time.perf_counter()

    @staticmethod
    def _rendered_size(request: ViewRequest, divider: int) -> tuple[int, int]:
        if request.crop is not None:
            return divided_crop(request.crop, divider)[2:]
        return divided_size(request.width, divider), divided_size(request.height, divider)

    def _pixels(self, request: ViewRequest, divider: int) -> int:
        width, height = self._rendered_size(request, divider)
        return width * height

    def _interrupted(self) -> bool:
        return self._stopping or self._pending

    def _render(self, request: ViewRequest) -> None:
        """Render one step of the current level and publish what there is."""
        divider = self._levels[self._level]
        last_level = self._level == len(self._levels) - 1
        session = self._session
        crop = None if request.crop is None else divided_crop(request.crop, divider)
        settings = divided_settings(request.settings, divider)
        session.configure(settings, request.camera, divided_size(request.width, divider),
                          divided_size(request.height, divider), crop)
        before, records = session.samples_done, records_of(session)
        pixels = self._pixels(request, divider)
        timed = self._timing_due(request)
        count = self._count(request, pixels, before) if last_level and not timed else 1
        # The first, coarse picture of a view, or one real-time frame, is never given up for a newer view: else nothing
        # would ever be seen while the mouse moves.
        kept = count == 1 and (real_time(request) or (self._level == 0 and before == 0))
        session.timed = timed
        start = time.perf_counter()
        done = session.step(count, (lambda: self._stopping) if kept else self._interrupted)
        if done <= before:
            return
        self._rendered_level = self._level
        self._recorded = records_of(session) != records
        if not timed and not self._recorded:
            self._control.record(pixels, done - before, time.perf_counter() - start)
        limit = request.settings.sampling.viewport_samples
        finished = last_level and limit > 0 and done >= limit
        if not last_level and self._may_refine(request):
            self._level += 1
        shown = SHOWN_FRAMES if real_time(request) else 2
        if last_level and self._rest.takes_over(request, session):
            picture = self._rest.picture(session, self._interrupted, last=finished)
            if picture is not None:
                self._publish(request, divider, done, picture)
        elif not last_level or done <= shown or finished or self._publishing_pays():
            self._publish(request, divider, done)
        if last_level:
            # An edit may need any of them; the first picture came first.
            self._build_others(self.device)
        self._publish_status(text=step_text(request, done), progress=0.0, stats=session.stats,
                             report=copy_report(session.report), **frame_figures(session, timed))

    def _count(self, request: ViewRequest, pixels: int, before: int) -> int:
        """Return how many samples or frames the next step at full resolution takes."""
        alone = SHOWN_FRAMES if real_time(request) else 1
        count = self._control.samples_within(pixels, STEP_SECONDS) if before >= alone else 1
        limit = request.settings.sampling.viewport_samples
        return min(count, max(1, limit - before)) if limit > 0 else count

    def _may_refine(self, request: ViewRequest) -> bool:
        return not real_time(request) or time.perf_counter() - self._changed_at >= SETTLE_SECONDS

    def _timing_due(self, request: ViewRequest) -> bool:
        now = time.perf_counter()
        if not real_time(request) or self._recorded or now - self._timed_at < TIMING_SECONDS:
            return False
        self._timed_at = now
        return True

    def _publishing_pays(self) -> bool:
        elapsed = time.perf_counter() - self._published_at
        return elapsed >= max(PUBLISH_SECONDS, self._publish_cost / PUBLISH_SHARE)

    def _publish(self, request: ViewRequest, divider: int, samples: int, picture: Any = None) -> None:
        start = time.perf_counter()
        self._picture_serial += 1
        self._picture = Picture(serial=self._picture_serial, pixels=self._pixels_to_draw(request, divider, picture),
                                area=picture_area(request, divider), samples=samples, divider=divider)
        self._published_at = time.perf_counter()
        self._publish_cost = self._published_at - start

    def _pixels_to_draw(self, request: ViewRequest, divider: int, picture: Any) -> Any:
        """Return the session's picture, or another one of its device (vec4 [h * w]), as it is drawn."""
        transparent = request.settings.film.transparent
        if self._reader is None:
            return display_pixels(self._session.read("Combined"), transparent)
        width, height = self._rendered_size(request, divider)
        picture = self._session.resolve() if picture is None else picture
        if self.share_pictures and self._reader.cuda:
            return self._reader.on_device(picture, width, height)
        if not transparent:
            return self._reader.packed(picture, width, height)
        return display_pixels(picture.numpy().reshape(height, width, 4), transparent)


def records_of(session: Any) -> int:
    """Return how many real-time frames of a session were recorded so far, see Pipeline.records."""
    return 0 if session.pipeline is None else session.pipeline.records


def frame_figures(session: Any, timed: bool) -> dict[str, dict]:
    """Return what a status says of a frame that was timed, or of an integrator without frames; else nothing."""
    times = dict(session.frame_times)
    return {"frame_times": times, "skipped": dict(session.skipped)} if timed or not times else {}


def copy_report(report: Report) -> Report:
    """Return a copy that the main thread may read while the session goes on."""
    return Report(dict(report.counts))
