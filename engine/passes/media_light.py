# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of the path tracer's passes Volume Direct and Indirect: light that a medium has scattered first."""

from __future__ import annotations

from collections.abc import Iterable

import warp as wp

from ...kernels import composite, light_split
from ...kernels.light_split import LightSplit
from ...kernels.paths import Paths
from ..device import launch
from ..history import arrays_of
from .composite import light_passes

__all__ = ["VOLUME_PASSES", "VolumeFilm"]

VOLUME_PASSES = ("Volume Direct", "Volume Indirect")


class VolumeFilm:
    """Sums of these passes, where they are asked for, one entry a pixel."""

    def __init__(self, passes: Iterable[str], pixel_count: int, device: str):
        """Make empty sums if `passes` has one of VOLUME_PASSES."""
        self.device, self.pixel_count = device, pixel_count
        self.asked = any(name in VOLUME_PASSES for name in passes)
        self._sums = light_passes(pixel_count, device) if self.asked else None

    def clear(self) -> None:
        """Forget all samples."""
        if self.asked:
            for array in arrays_of(self._sums):
                array.zero_()

    def add(
        self, paths: Paths, scattered: wp.array, split: LightSplit, exposure: float, first: int, count: int,
        samples: int,
    ) -> None:
        """Add the finished paths of `count` pixels from `first` on, `samples` each; `scattered`: MediaPaths.first."""
        if self.asked:
            launch(light_split.accumulate_scattered, count,
                   [paths, scattered, split, exposure, first, count, samples], [self._sums], self.device)

    def read(self, name: str) -> wp.array:
        """Return a pass on the device: vec3 [pixels], exposed.

        Raises:
            KeyError: It was not asked for.
        """
        if not self.asked:
            raise KeyError(name)
        pictures = [wp.empty(self.pixel_count, dtype=wp.vec3, device=self.device) for _ in range(3)]
        launch(composite.resolve_light_passes, self.pixel_count, [0, self._sums], pictures, self.device)
        return pictures[VOLUME_PASSES.index(name)]
