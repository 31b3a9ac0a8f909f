# SPDX-License-Identifier: GPL-3.0-or-later
"""The denoiser of direct light: means over frames, then an edge-stopping blur as strong as their errors (SVGF).

Owns the means of this frame and the last, and what has changed between them. 137 + 44 n bytes a pixel for n passes of
the blur.
"""

from __future__ import annotations

import warp as wp

from ...kernels import denoise_debug, direct_atrous, direct_change, direct_temporal
from ...kernels.direct_light import DirectLight
from ...kernels.direct_temporal import DirectHistory
from ...kernels.gbuffer import GBuffer
from ...kernels.reprojection import Reprojection
from ..frame_graph import FrameGraph
from ..history import History
from ..settings import DenoiserSettings

__all__ = ["DirectDenoisePass"]


class DirectDenoisePass:
    """Filters diffuse and specular direct light together."""

    name = "direct denoise"

    debug_views = {
        "direct.history": "Frames averaged in direct light: black where it started anew, white from 1024 on",
        "direct.variance": "Error that is left in the mean of direct light, relative to it; white from 100 % on",
    }

    def __init__(self, device: str, settings: DenoiserSettings | None = None):
        self.device = device
        self.settings = settings or DenoiserSettings()
        self.width = self.height = 0

    def resize(self, width: int, height: int) -> None:
        """Allocate all buffers for a size [px]."""
        self.width, self.height = width, height
        count, device = width * height, self.device

        def history() -> DirectHistory:
            h = DirectHistory()
            h.diffuse = wp.zeros(count, dtype=wp.uint64, device=device)
            h.specular = wp.zeros(count, dtype=wp.uint64, device=device)
            h.moments = wp.zeros(count, dtype=wp.uint64, device=device)
            h.length = wp.zeros(count, dtype=wp.float16, device=device)
            h.albedo = wp.zeros(count, dtype=wp.uint32, device=device)
            return h

        def light() -> DirectLight:
            pair = DirectLight()
            pair.diffuse = wp.zeros(count, dtype=wp.vec4h, device=device)
            pair.specular = wp.zeros(count, dtype=wp.vec4h, device=device)
            return pair

        self.history: History[DirectHistory] = History("direct denoise", history)
        self._lights = (light(), light())
        self._change = light()

    def reset(self) -> None:
        """Forget all frames."""
        self.history.reset()

    def record(
        self, graph: FrameGraph, parity: int, views: wp.array, gbuffer: GBuffer, previous_gbuffer: GBuffer,
        reprojection: Reprojection, direct: DirectLight, *, noisy: bool = True, changing: bool = True,
    ) -> DirectLight:
        """Record both filters; return the filtered light.

        Args:
            graph: Takes the launches.
            parity: Of the frames recorded.
            views: One View.
            gbuffer: Of this frame.
            previous_gbuffer: Of the frame before.
            reprojection: Of this frame.
            direct: Exposed, demodulated; w = 0 where this frame has no sample.
            noisy: Whether the light is new and of lights with some extent. Else one pass does: means over frames have
                little noise that is not the edge of a shadow.
            changing: Whether something but the camera may just have moved.

        Returns:
            Like `direct`, w = 1 where light is known; the same arrays in every frame, of either parity.
        """
        count, size = self.width * self.height, [self.width, self.height]
        source, target = self._lights
        history = self.history.current(parity)
        previous, change = self.history.previous(parity), _words(self._change)
        if changing:
            # What pixels have found goes where the filters will put their light.
            compared = [*_words(source), _words(target)[0]]
            graph.launch(
                direct_change.compare_direct, count,
                [views, gbuffer, reprojection, *size, *_words(direct), previous], compared)
            graph.launch(
                direct_change.find_direct_changes, count, [views, gbuffer, *size, *compared], change)
        graph.launch(
            direct_temporal.accumulate_direct, count,
            [views, gbuffer, previous_gbuffer, reprojection, *size, *_words(direct), previous, *change,
             float(self.settings.direct_history)],
            [history, *_words(source)])
        passes = self.settings.direct_iterations if noisy else min(self.settings.direct_iterations, 1)
        # Runs even where nothing is to be blurred: it also finds changes of the light.
        graph.launch(
            direct_atrous.filter_direct_first, count,
            [views, gbuffer, *size, int(passes > 0), int(passes <= 1), *_words(source)], [*_words(target), history])
        for index in range(1, passes):
            source, target = target, source
            stride = 1 << index
            # Mirrored in every other pass: their grids then share few points.
            turn = stride // 2 if index % 2 else -stride // 2
            graph.launch(
                direct_atrous.filter_direct, count,
                [views, gbuffer, *size, stride, turn, int(index == passes - 1), *_words(source)], _words(target))
        return target

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` of this frame into `picture` (vec4 [h * w]); comes after record()."""
        kernel = {
            "direct.history": denoise_debug.show_direct_history,
            "direct.variance": denoise_debug.show_direct_variance,
        }[name]
        graph.launch(kernel, self.width * self.height, [self.history.current(parity)], [picture])


def _words(light: DirectLight) -> list[wp.array]:
    """Return both images as the kernels take them: one word of 64 bits a pixel."""
    return [light.diffuse.view(wp.uint64), light.specular.view(wp.uint64)]
