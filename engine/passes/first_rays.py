# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of one ray from each first hit, Ambient Occlusion and Shadow, traced when they are read.

Both integrators have the same.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ...kernels import occlusion, path_lists, shadow_share
from ...kernels.paths import Options
from ...kernels.types import Scene
from ..device import launch
from ..history import copy_struct
from .material_steps import evaluate_step
from .reference import Band, ReferencePass, hit_steps
from .shadow_steps import shadow_steps
from .wavefront import Step, Wavefront

__all__ = ["FirstRays", "LampShadow", "Occlusion"]

SAMPLES = 16, 256
"""Fewest and most rays a pixel: else as many as the picture has samples"""


class FirstRays:
    """Such a pass of one session; nothing is allocated before it is read."""

    name: str
    """Of what is recorded for it"""
    aim: wp.Kernel
    """Sets up the rays"""
    add: wp.Kernel
    """Adds what they have found to the sums"""

    def __init__(self, device: str):
        self.device = device
        self.sums: wp.array | None = None
        """vec3 [h * w], of all samples"""
        self._samples = 0
        self._options: Options | None = None

    def reset(self) -> None:
        """Forget everything: what is seen has changed."""
        self.sums, self._samples, self._options = None, 0, None

    def gather(self, tracer: ReferencePass, scene: Scene, frame: np.ndarray, options: Options, table: wp.array,
               samples: int, *inputs: float) -> np.ndarray:
        """Return the sums over all samples, divided by their number: float32 [h * w, 3].

        Args:
            tracer: Its bands are the picture's; lends its path states.
            scene: The device scene.
            frame: One FrameData row.
            options: Of the path tracer.
            table: Inverse distribution of the pixel filter.
            samples: How many the picture has.
            inputs: Of `aim`, after the scene.
        """
        fewest, most = SAMPLES
        wanted = min(max(samples, fewest), most)
        if self._samples < wanted:
            if self.sums is None:
                count = sum(band.count for band in tracer.bands)
                self.sums = wp.zeros(count, dtype=wp.vec3, device=self.device)
                # The same object each time, for what is recorded with it.
                self._options = plain_options(options)

            tracer.each_band(tracer.bands, lambda band: self._trace(
                tracer, band, scene, frame, table, inputs, wanted))
            self._samples = wanted
        return self.sums.numpy() / self._samples

    def _trace(self, tracer: ReferencePass, band: Band, scene: Scene, frame: np.ndarray, table: wp.array,
               inputs: tuple[float, ...], wanted: int) -> None:
        """Bring a band's pixels to so many samples, in as few batches as there are path states for."""
        options = self._options

        def trace(slot: Wavefront, done: int, count: int) -> None:
            # The first round ends all paths.
            slot.trace(self.name, (scene, options), lambda: self._steps(slot, scene, options, inputs),
                       frame, table, (band.first, band.count), (done, count), 1, lambda: False)
            launch(self.add, band.count, [slot.paths, band.first, band.count, count], [self.sums], self.device)

        tracer.in_batches(band, self._samples, wanted, trace)

    def _steps(self, slot: Wavefront, scene: Scene, options: Options, inputs: tuple[float, ...]) -> list[Step]:
        """Return what finds first hits, sends a ray from each and tells whether it arrives."""
        return [
            *hit_steps(slot, scene, options), evaluate_step(slot, scene),
            Step(self.aim, [scene, *inputs]), *shadow_steps(slot, scene, options),
            Step(path_lists.list_living, [slot.paths.state], fills=("next",), changes=False)]


class Occlusion(FirstRays):
    """The share of directions in which nothing is near."""

    name, aim, add = "occlusion", occlusion.aim_occlusion_rays, occlusion.average_occlusion

    def read(self, tracer: ReferencePass, scene: Scene, frame: np.ndarray, options: Options, table: wp.array,
             samples: int, distance: float) -> np.ndarray:
        """Return the pass, float32 [h * w, 3]; `distance`: how far things count as near [m]. See `gather`."""
        return self.gather(tracer, scene, frame, options, table, samples, distance)


class LampShadow(FirstRays):
    """The share of lamps' light that arrives."""

    name, aim, add = "shadow", shadow_share.aim_at_lamps, shadow_share.add_shadows

    def read(self, tracer: ReferencePass, scene: Scene, frame: np.ndarray, options: Options, table: wp.array,
             samples: int) -> np.ndarray:
        """Return the pass, float32 [h * w, 3], all channels alike: 1 where nothing is, 0 where no lamp shines."""
        arrived, sent, nothing = self.gather(tracer, scene, frame, options, table, samples).T
        share = np.divide(arrived, sent, out=np.zeros_like(sent), where=sent > 0.0)
        return np.repeat((nothing + (1.0 - nothing) * np.minimum(share, 1.0))[:, None], 3, axis=1)


def plain_options(options: Options) -> Options:
    """Return options with which light is neither clamped nor kept for other passes."""
    plain = copy_struct(options)
    plain.clamp_direct = plain.clamp_indirect = 0.0
    plain.passes = 0
    return plain
