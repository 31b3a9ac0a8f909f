# SPDX-License-Identifier: GPL-3.0-or-later
"""Final gather at rest: each pixel's mean of its own diffuse rays, and how it replaces the probes' irradiance.

Screen probes stand eight and more pixels apart: contacts, corners and ledges between them come out too bright. While
nothing moves there is time for a ray of the pixel's own (passes/reflections.py traces it); in motion nothing here runs.
"""

from __future__ import annotations

import warp as wp

from ...kernels import gather_blend, gather_temporal
from ...kernels.gather_temporal import GatherHistory
from ...kernels.gbuffer import GBuffer
from ...kernels.reflection_types import ReflectionOptions, ReflectionSamples
from ...kernels.reprojection import Reprojection
from ..frame_graph import FrameGraph
from ..history import History

__all__ = ["RestGatherPass"]


class RestGatherPass:
    """Averages the samples of final gather and mixes them with the light of the probes."""

    name = "rest gather"
    debug_views: dict[str, str] = {}

    def __init__(self, device: str):
        self.device = device
        self.width = self.height = 0

    def resize(self, width: int, height: int) -> None:
        """Allocate all buffers for a size [px]."""
        self.width, self.height = width, height
        count, device = width * height, self.device

        def history() -> GatherHistory:
            h = GatherHistory()
            h.light = wp.zeros(count, dtype=wp.uint64, device=device)
            h.state = wp.zeros(count, dtype=wp.uint64, device=device)
            return h

        self._indirect = wp.zeros(count, dtype=wp.uint64, device=device)
        self.history: History[GatherHistory] = History(self.name, history)

    def reset(self) -> None:
        """Forget all frames."""
        self.history.reset()

    def record(
        self, graph: FrameGraph, parity: int, views: wp.array, gbuffer: GBuffer, previous_gbuffer: GBuffer,
        reprojection: Reprojection, options: ReflectionOptions, samples: ReflectionSamples, irradiance: wp.array,
    ) -> wp.array:
        """Record a frame."""
        count = self.width * self.height
        graph.launch(
            gather_temporal.accumulate_gathered, count,
            [views, gbuffer, previous_gbuffer, reprojection, options, samples, self.history.previous(parity)],
            [self.history.current(parity)])
        graph.launch(
            gather_blend.blend_gathered, count,
            [views, gbuffer, self.width, self.height, options.stride, irradiance, self.history.current(parity)],
            [self._indirect])
        return self._indirect
