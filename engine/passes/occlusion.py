# SPDX-License-Identifier: GPL-3.0-or-later
"""The Ambient Occlusion pass, traced when it is read; both integrators have the same."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...kernels import materials, occlusion, path_lists
from ...kernels.paths import Options
from ...kernels.types import Scene
from ..device import launch
from ..history import copy_struct
from .reference import Band, ReferencePass, hit_steps
from .shadow_steps import shadow_steps
from .wavefront import Step, Wavefront

__all__ = ["Occlusion"]

SAMPLES = 16, 256
"""Fewest and most rays a pixel: else as many as the picture has samples"""


class Occlusion:
    """The pass of one session; nothing is allocated before it is read."""

    def __init__(self, device: str):
        self.device = device
        self.light: wp.array | None = None
        """vec3 [h * w], the sum of all samples"""
        self._samples = 0
        self._options: Options | None = None

    def reset(self) -> None:
        """Forget everything: what is seen has changed."""
        self.light, self._samples, self._options = None, 0, None

    def read(self, tracer: ReferencePass, scene: Scene, frame: np.ndarray, options: Options, table: wp.array,
             distance: float, samples: int) -> np.ndarray:
        """Return the share of directions in which nothing is near: float32 [h * w, 3].

        Args:
            tracer: Its bands are the picture's; lends its path states.
            scene: The device scene.
            frame: One FrameData row.
            options: Of the path tracer.
            table: Inverse distribution of the pixel filter.
            distance: How far things count as near [m].
            samples: How many the picture has.
        """
        fewest, most = SAMPLES
        wanted = min(max(samples, fewest), most)
        if self._samples < wanted:
            if self.light is None:
                count = sum(band.count for band in tracer.bands)
                self.light = wp.zeros(count, dtype=wp.vec3, device=self.device)
                # The same object each time, for what is recorded with it.
                self._options = plain_options(options)

            tracer.each_band(tracer.bands, lambda band: self._trace(
                tracer, band, scene, frame, table, distance, wanted))
            self._samples = wanted
        return self.light.numpy() / self._samples

    def _trace(self, tracer: ReferencePass, band: Band, scene: Scene, frame: np.ndarray, table: wp.array,
               distance: float, wanted: int) -> None:
        """Bring a band's pixels to so many samples, in as few batches as there are path states for."""
        options = self._options

        def trace(slot: Wavefront, done: int, count: int) -> None:
            # The first round ends all paths.
            slot.trace("occlusion", (scene, options), lambda: occlusion_steps(slot, scene, options, distance),
                       frame, table, (band.first, band.count), (done, count), 1, lambda: False)
            launch(occlusion.average_occlusion, band.count, [slot.paths, band.first, band.count, count],
                   [self.light], self.device)

        tracer.in_batches(band, self._samples, wanted, trace)


def plain_options(options: Options) -> Options:
    """Return options with which light is neither clamped nor kept for other passes."""
    plain = copy_struct(options)
    plain.clamp_direct = plain.clamp_indirect = 0.0
    plain.passes = 0
    return plain


def occlusion_steps(slot: Wavefront, scene: Scene, options: Options, distance: float) -> list[Step]:
    """Return what finds first hits and tells from how many directions light comes to them."""
    return [
        *hit_steps(slot, scene, options), Step(materials.evaluate_materials, [scene]),
        Step(occlusion.aim_occlusion_rays, [scene, distance]), *shadow_steps(slot, scene, options),
        Step(path_lists.list_living, [slot.paths.state], fills=("next",), changes=False)]
