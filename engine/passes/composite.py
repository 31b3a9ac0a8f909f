# SPDX-License-Identifier: GPL-3.0-or-later
"""The last pass of a real-time frame: the composite, its temporal anti-aliasing and the diffuse light passes.

Owns the composites of this frame and the last (other passes look for light of the frame before there), the averaged
picture and the sums of the light passes. Knows nothing of how the light was found.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from ...kernels import antialias, composite, composite_debug
from ...kernels.antialias import Accumulation
from ...kernels.composite import LightPasses
from ...kernels.gbuffer import GBuffer
from ...kernels.types import Scene
from ..device import launch
from ..frame_graph import FrameGraph
from ..history import History, arrays_of
from ..settings import DenoiserSettings

__all__ = ["LIGHT_PASSES", "CompositePass"]

LIGHT_PASSES = ("Diffuse Direct", "Diffuse Indirect", "Diffuse Color")
"""Names of the pictures that read_light_pass() gives, of the real-time integrator only: (direct + indirect) * color is
the picture's diffuse light."""


class CompositePass:
    """Puts light and surface colours together and averages the frames."""

    name = "composite"

    debug_views = {
        "composite.direct": "Emission and direct light with the surfaces' colours",
        "composite.indirect": "Indirect light with the surfaces' colours",
        "composite.history": "Frames averaged by anti-aliasing: dark where it started anew",
    }

    def __init__(self, device: str, settings: DenoiserSettings, light_passes: bool = False):
        self.device = device
        self.settings = settings
        self.light_passes = light_passes
        self.width = self.height = 0
        self._inputs: dict[int, tuple] = {}
        """What compose() was recorded with for each parity: debug views read the same"""

    def resize(self, width: int, height: int) -> None:
        """Allocate all buffers for a size [px]."""
        self.width, self.height = width, height
        count, device = width * height, self.device

        def accumulation() -> Accumulation:
            a = Accumulation()
            a.color = wp.zeros(count, dtype=wp.vec4, device=device)
            a.samples = wp.zeros(count, dtype=wp.uint16, device=device)
            return a

        self.color: History[wp.array] = History(
            "composite.color", lambda: wp.zeros(count, dtype=wp.vec4h, device=device))
        self.accumulated: History[Any] = History("composite.accumulated", accumulation)
        self._inputs = {}
        self._sums = LightPasses()
        extra = count if self.light_passes else 1
        self._sums.direct = wp.zeros(extra, dtype=wp.vec3, device=device)
        self._sums.indirect = wp.zeros(extra, dtype=wp.vec3, device=device)
        self._sums.albedo = wp.zeros(extra, dtype=wp.vec4, device=device)

    def reset(self) -> None:
        """Forget all frames."""
        self.color.reset()
        self.accumulated.reset()
        for array in arrays_of(self._sums):
            array.zero_()

    def record(
        self, graph: FrameGraph, parity: int, scene: Scene, views: wp.array, gbuffer: GBuffer, reprojection: Any,
        direct: Any, irradiance: wp.array, specular_ratio: wp.array | None = None,
    ) -> wp.array:
        """Record the composite and its anti-aliasing; return the picture.

        Args:
            graph: Takes the launches.
            parity: Of the frames recorded.
            scene: Not read; passes are recorded alike.
            views: One View.
            gbuffer: Of this frame.
            reprojection: Has `position` (vec2) and `taps` (uint8), see kernels/reprojection.py.
            direct: Has `diffuse` and `specular` (vec4h): exposed, without the surfaces' colours.
            irradiance: vec4h, diffuse indirect light: irradiance / pi, exposed.
            specular_ratio: float16, what a reflection gets of that light; None: 1 everywhere.

        Returns:
            vec4 [h * w]: exposed colour, premultiplied by alpha, as the film shows it; kept for two frames.
        """
        count = self.width * self.height
        color = self.color.current(parity)
        if specular_ratio is None:
            specular_ratio = wp.full(count, 1.0, dtype=wp.float16, device=self.device)
        lights = [gbuffer, direct.diffuse, direct.specular, irradiance, specular_ratio]
        self._inputs[parity] = tuple(lights)
        graph.launch(composite.compose, count, [views, *lights], [color])
        if self.light_passes:
            graph.launch(
                composite.accumulate_light_passes, count,
                [views, gbuffer, direct.diffuse, irradiance, specular_ratio], [self._sums])
        accumulated = self.accumulated.current(parity)
        graph.launch(
            antialias.antialias, count,
            [views, color, gbuffer.depth, reprojection.position, reprojection.taps,
             self.accumulated.previous(parity), self.width, self.height, int(self.settings.antialiasing)],
            [accumulated])
        return accumulated.color

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` of this frame into `picture` (vec4 [h * w]); comes after record()."""
        count = self.width * self.height
        if name == "composite.history":
            graph.launch(
                composite_debug.show_history, count, [self.accumulated.current(parity).samples], [picture])
            return
        what = composite_debug.SHOW_DIRECT if name == "composite.direct" else composite_debug.SHOW_INDIRECT
        graph.launch(composite_debug.show_light, count, [*self._inputs[parity], int(what)], [picture])

    def read_light_pass(self, name: str) -> wp.array:
        """Return one of LIGHT_PASSES of the frames since the picture came to rest: vec3 [h * w], exposed.

        Raises:
            KeyError: No such pass, or the light passes were not asked for.
        """
        if not self.light_passes or name not in LIGHT_PASSES:
            raise KeyError(name)
        count = self.width * self.height
        pictures = [wp.empty(count, dtype=wp.vec3, device=self.device) for _ in LIGHT_PASSES]
        launch(composite.resolve_light_passes, count, [0, self._sums], pictures, self.device)
        return pictures[LIGHT_PASSES.index(name)]
