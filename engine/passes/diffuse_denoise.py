# SPDX-License-Identifier: GPL-3.0-or-later
"""The denoiser of diffuse indirect light: a mean over frames, blurred where it is short (GI-1.0; method 7.5, 7.6).

Owns the means of this frame and the last. 81 bytes a pixel where nothing is blurred.
"""

from __future__ import annotations

import warp as wp

from ...kernels import denoise_debug, diffuse_blur, diffuse_temporal
from ...kernels.diffuse_temporal import DiffuseHistory
from ...kernels.gbuffer import GBuffer
from ...kernels.reprojection import Reprojection
from ..frame_graph import FrameGraph
from ..history import History
from ..settings import DenoiserSettings

__all__ = ["DiffuseDenoisePass"]


class DiffuseDenoisePass:
    """Filters the irradiance that the screen probes give."""

    name = "diffuse denoise"

    debug_views = {
        "diffuse.history": "Frames averaged in diffuse indirect light: black where it started anew, white from 1024 on",
        "diffuse.blur": "Radius of the blur of diffuse indirect light, white at the largest",
    }

    def __init__(self, device: str, settings: DenoiserSettings | None = None):
        self.device = device
        self.settings = settings or DenoiserSettings()
        self.width = self.height = 0

    def resize(self, width: int, height: int) -> None:
        """Allocate all buffers for a size [px]."""
        self.width, self.height = width, height
        count, device = width * height, self.device

        def history() -> DiffuseHistory:
            h = DiffuseHistory()
            h.irradiance = wp.zeros(count, dtype=wp.uint64, device=device)
            h.state = wp.zeros(count, dtype=wp.uint64, device=device)
            return h

        self.history: History[DiffuseHistory] = History("diffuse denoise", history)
        self._rows = wp.zeros(count, dtype=wp.uint64, device=device)
        self._irradiance = wp.zeros(count, dtype=wp.vec4h, device=device)

    def reset(self) -> None:
        """Forget all frames."""
        self.history.reset()

    def record(
        self, graph: FrameGraph, parity: int, views: wp.array, gbuffer: GBuffer, previous_gbuffer: GBuffer,
        reprojection: Reprojection, irradiance: wp.array,
    ) -> wp.array:
        """Record both filters; return the filtered light.

        Args:
            graph: Takes the launches.
            parity: Of the frames recorded.
            views: One View.
            gbuffer: Of this frame.
            previous_gbuffer: Of the frame before.
            reprojection: Of this frame.
            irradiance: vec4h [h * w]: irradiance / pi, exposed; w = confidence.

        Returns:
            Like `irradiance`, w is above 0 where light is known; the same array in every frame, of either parity.
        """
        count, size = self.width * self.height, [self.width, self.height]
        filtered = self._irradiance.view(wp.uint64)
        history, radius = self.history.current(parity), self.settings.diffuse_radius
        graph.launch(
            diffuse_temporal.accumulate_diffuse, count,
            [views, gbuffer, previous_gbuffer, reprojection, *size, irradiance.view(wp.uint64),
             self.history.previous(parity), float(self.settings.diffuse_history)],
            [history, filtered])
        graph.launch(
            diffuse_blur.blur_diffuse_x, count, [views, gbuffer, *size, radius, history], [self._rows, filtered])
        graph.launch(
            diffuse_blur.blur_diffuse_y, count, [views, gbuffer, *size, radius, self._rows],
            [history, filtered])
        return self._irradiance

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` of this frame into `picture` (vec4 [h * w]); comes after record()."""
        count, history = self.width * self.height, self.history.current(parity)
        if name == "diffuse.history":
            graph.launch(denoise_debug.show_diffuse_history, count, [history], [picture])
            return
        graph.launch(
            denoise_debug.show_diffuse_blur, count,
            [history, self.width, self.height, self.settings.diffuse_radius], [picture])
