# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of the path tracer's light passes: what is kept of paths under way, and the sums on the film.

Only where passes ask for it: other renders launch none of these kernels and have none of these buffers. Light groups
are in light_groups.py.
"""

from __future__ import annotations

from collections.abc import Iterable

import warp as wp

from ...kernels import composite, light_shares, light_split
from ...kernels.composite import LightPasses
from ...kernels.light_split import LightSplit
from ...kernels.paths import Paths
from ...kernels.types import Scene
from ..device import launch
from ..history import arrays_of
from .composite import LIGHT_PASSES, PASS_LOBES, PASS_PARTS, light_passes
from .wavefront import Step

__all__ = ["SPLIT_BYTES", "LobeFilm", "make_split", "steps_after_exit_shadows", "steps_after_shading",
           "steps_after_shadows", "steps_before_shading"]

SPLIT_ARRAYS = {
    "ray": wp.vec4, "throughput": wp.vec3, "diffuse_color": wp.vec3, "glossy_color": wp.vec3,
    "transmission_color": wp.vec3, "lamp_share": wp.vec4, "path_share": wp.vec4, "seen": wp.vec3, "lamps": wp.vec3,
    "direct": wp.vec3,
}

SPLIT_BYTES = 136
"""Of one path's: the arrays above and a place in a list"""


def make_split(count: int, device: str) -> LightSplit:
    """Allocate what is kept of `count` paths."""
    split = LightSplit()
    for name, dtype in SPLIT_ARRAYS.items():
        setattr(split, name, wp.zeros(count, dtype=dtype, device=device))
    return split


def steps_before_shading(paths: Paths, split: LightSplit, rounds: wp.array, evaluate: Step) -> list[Step]:
    """Return what keeps how camera rays arrive, and `evaluate`, which runs the programs of the materials there."""
    return [Step(light_split.keep_first_hits, [paths, rounds], fills=("first_hits",), changes=False, outputs=[split]),
            evaluate]


def steps_after_shading(paths: Paths, split: LightSplit, scene: Scene, rounds: wp.array) -> list[Step]:
    """Return what keeps the light of first and second hits, and finds what the first do with light."""
    return [Step(light_split.keep_met_light, [paths, rounds], changes=False, outputs=[split]),
            Step(light_shares.share_first_light, [scene, paths], over="first_hits", changes=False, outputs=[split])]


def steps_after_shadows(paths: Paths, split: LightSplit, rounds: wp.array) -> list[Step]:
    """Return what keeps the light of the first hits' shadow rays."""
    return [Step(light_split.keep_lamp_light, [paths, rounds], changes=False, outputs=[split])]


def steps_after_exit_shadows(paths: Paths, split: LightSplit, rounds: wp.array) -> list[Step]:
    """Return what keeps the light of the shadow rays where paths come out of the first surface."""
    return [Step(light_split.keep_exit_light, [paths, rounds], "exits", changes=False, outputs=[split])]


class LobeFilm:
    """Sums of the light passes of those lobes that are asked for, one entry a pixel."""

    def __init__(self, passes: Iterable[str], pixel_count: int, device: str):
        """Make empty sums for those of `passes` that are in LIGHT_PASSES."""
        self.device, self.pixel_count = device, pixel_count
        lobes = {name.partition(" ")[0] for name in passes if name in LIGHT_PASSES}
        self._sums: dict[str, LightPasses] = {
            lobe: light_passes(pixel_count, device) for lobe in PASS_LOBES if lobe in lobes}

    @property
    def asked(self) -> bool:
        """Return whether there are any."""
        return bool(self._sums)

    def clear(self) -> None:
        """Forget all samples."""
        for sums in self._sums.values():
            for array in arrays_of(sums):
                array.zero_()

    def add(self, paths: Paths, split: LightSplit, exposure: float, first: int, count: int, samples: int) -> None:
        """Add the finished paths of `count` pixels from `first` on, `samples` each."""
        for lobe, sums in self._sums.items():
            launch(light_split.accumulate_split, count,
                   [paths, split, exposure, int(PASS_LOBES[lobe]), first, count, samples], [sums], self.device)

    def read(self, name: str) -> wp.array:
        """Return a light pass on the device: vec3 [pixels], exposed.

        Raises:
            KeyError: It was not asked for.
        """
        lobe, _, part = name.partition(" ")
        pictures = [wp.empty(self.pixel_count, dtype=wp.vec3, device=self.device) for _ in PASS_PARTS]
        launch(composite.resolve_light_passes, self.pixel_count, [0, self._sums[lobe]], pictures, self.device)
        return pictures[PASS_PARTS.index(part)]
