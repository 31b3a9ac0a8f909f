# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur of final renders: the scene is evaluated at moments while the shutter is open, and samples add up.

Everything that Blender animates blurs therefore: objects, cameras, deforming meshes, particles, lamps, materials and
worlds. Only what an evaluation changed is read anew, and where nothing did samples are taken together. Shadows and
reflections of a moment are those of that moment, as in Cycles. The active camera is the frame's own throughout.

Cycles moves each sample's time; here many samples share a moment. Depth, Position, Normal, UV, indices, Mist, Vector,
Cryptomatte, occlusion and shader AOVs are those of the frame's own moment; Cycles blurs Normal, UV, Cryptomatte,
occlusion and AOVs, and takes Depth, Position and indices at random moments. May run outside the main thread.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..engine.moments import plan_moments, rounds
from ..engine.report import Report
from ..engine.scene import CameraData, SceneDelta
from ..engine.settings import Integrator, RenderSettings
from .extract.scene import ExtractionCancelled, SceneExtractor
from .sampling import Sampling

__all__ = ["Shutter", "is_open", "path_traced", "read_surfaces"]

STARTS = {'START': 0.0, 'CENTER': -0.5, 'END': -1.0}
"""Where the shutter opens, in times that it is open from the frame, by motion_blur_position"""
CURVE_PLACES = 257
"""At which the shutter's curve is read"""
SURFACES = ("Depth", "Position", "Normal", "UV", "Object Index", "Material Index")
"""Passes that come with samples of the film but belong to the frame's own moment"""
SURFACE_SAMPLES = 16


def is_open(engine: Any, depsgraph: Any) -> bool:
    """Tell whether a view layer's picture has motion blur."""
    render = depsgraph.scene_eval.render
    # The view layer's own switch came with Blender 5.
    layer = getattr(depsgraph.view_layer_eval, "use_motion_blur", True)
    return bool(render.use_motion_blur and layer and render.motion_blur_shutter > 0.0 and not engine.is_preview)


def path_traced(settings: RenderSettings) -> RenderSettings:
    """Return the settings with which such pictures are made: real-time frames live from the frames before."""
    return dataclasses.replace(
        settings, sampling=dataclasses.replace(settings.sampling, integrator=Integrator.REFERENCE))


def read_surfaces(session: Any, names: set[str], samples: int, should_stop: Callable[[], bool]) -> dict[str, Any]:
    """Return those of the passes `names` that show the frame's own moment, of samples that are forgotten again."""
    wanted = [name for name in SURFACES if name in names]
    if not wanted:
        return {}
    session.step(min(samples, SURFACE_SAMPLES), should_stop)
    pixels = {name: session.read(name) for name in wanted}
    session.reset()
    return pixels


class Shutter:
    """Exposes pictures of one frame to the scene's moments."""

    def __init__(self, engine: Any, depsgraph: Any, session: Any, extractor: SceneExtractor,
                 settings: RenderSettings, report: Report) -> None:
        """Make it while `depsgraph` is at the frame, and `session` has what `extractor` read of it.

        Args:
            engine: Renders `depsgraph`.
            depsgraph: Of a final render.
            session: Moves.
            extractor: Reads what moved.
            settings: Samples, time limit, seed and number of moments.
            report: Takes what is odd at one of the moments alone.
        """
        self.engine, self.depsgraph, self.session, self.extractor = engine, depsgraph, session, extractor
        self.report = report
        scene, render = depsgraph.scene, depsgraph.scene_eval.render
        self.frame = scene.frame_current + scene.frame_subframe
        self._opens = self.frame + STARTS[render.motion_blur_position] * render.motion_blur_shutter
        self._lasts = render.motion_blur_shutter
        sampling = settings.sampling
        # The same for all views, or eyes would see a thing at different places.
        self.moments = plan_moments(
            sampling.samples, sampling.motion_steps, (sampling.seed, scene.frame_current & 0xFFFFFFFF), curve(render))
        self._camera: CameraData | None = None
        self._pending = 0

    def expose(self, sampling: Sampling, camera: Callable[[], CameraData]) -> None:
        """Take a picture's samples, and leave scene and session at the frame, unless the user has cancelled.

        Args:
            sampling: Of the picture, which the session is configured for.
            camera: Returns the picture's camera as it is evaluated.
        """
        self._camera = camera()
        try:
            self._expose(sampling, camera)
        except ExtractionCancelled:
            return
        finally:
            self._evaluate(self.frame)
        if not sampling.cancelled():
            self._read(sampling, camera)

    def _expose(self, sampling: Sampling, camera: Callable[[], CameraData]) -> None:
        def elapsed() -> float:
            self._flush(sampling)
            return sampling.elapsed

        for moment, samples in rounds(self.moments, sampling.limit, elapsed):
            self._evaluate(self._opens + moment.place * self._lasts)
            self._read(sampling, camera)
            self._pending += samples
            if sampling.cancelled():
                break
        self._flush(sampling)

    def _evaluate(self, frame: float) -> None:
        whole = math.floor(frame)
        self.engine.frame_set(whole, frame - whole)

    def _read(self, sampling: Sampling, camera: Callable[[], CameraData]) -> None:
        """Take over what the evaluation changed; samples of before are taken before."""
        found = Report()
        delta = self.extractor.extract(self.depsgraph, viewport=True, report=found, cancelled=sampling.cancelled)
        here = camera()
        if here == self._camera and unchanged(delta):
            return
        self._flush(sampling)
        self.session.move(delta, here)
        self._camera = here
        for entry, count in found.counts.items():
            self.report.counts.setdefault(entry, count)

    def _flush(self, sampling: Sampling) -> None:
        """Take the samples that are due where the session is now."""
        samples, self._pending = self._pending, 0
        sampling.add(sampling.done + samples, sampling.cancelled)


def curve(render: Any) -> np.ndarray:
    """Return how much light the shutter lets through at CURVE_PLACES places from when it opens to when it closes."""
    mapping = render.motion_blur_shutter_curve
    mapping.initialize()
    return np.array([mapping.evaluate(mapping.curves[0], place) for place in np.linspace(0.0, 1.0, CURVE_PLACES)])


def unchanged(delta: SceneDelta) -> bool:
    """Tell whether a delta changes nothing."""
    return not (delta.full or delta.meshes or delta.materials or delta.images or delta.instances is not None
                or delta.lights is not None or delta.world is not None)
