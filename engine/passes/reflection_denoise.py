# SPDX-License-Identifier: GPL-3.0-or-later
"""The denoiser of reflections: clean-up, a-trous filter with upscaling, means over frames (Eto et al. 2023).

Owns the means of this frame and the last. One instance filters what reflects, another what glass lets through.
"""

from __future__ import annotations

import warp as wp

from ...kernels import (
    reflection_atrous,
    reflection_blocks,
    reflection_cleanup,
    reflection_filter_debug,
    reflection_temporal,
    reflection_upscale,
)
from ...kernels.antialias import Mirrors
from ...kernels.gbuffer import GBuffer
from ...kernels.reflection_blocks import ReflectionBlocks, ReflectionHistory, ReflectionLight
from ...kernels.reflection_lobe import FilterPass
from ...kernels.reflection_temporal import MIRROR_SHARE, RENEWED_LENGTH
from ...kernels.reflection_types import LOBE_REFLECTION, ReflectionOptions, ReflectionSamples
from ...kernels.reprojection import Reprojection
from ..frame_graph import FrameGraph
from ..history import History
from ..settings import DenoiserSettings

__all__ = ["ReflectionDenoisePass", "filter_passes"]

GAUSSIAN_WIDTH = 1.065
"""Standard deviation of a pass by its step: fits the spline kernel of the paper's figure 6"""

MIRROR_FRAMES = 1.9
"""Frames in the mean of a mirror from which on it shows nothing new, at most"""

DEBUG_VIEWS = {
    "reflections.filtered": "Reflections of this frame after their filter, before they are averaged over frames",
    "reflections.history": "Samples averaged in reflections: black where it started anew, white from 1024 on",
    "reflections.variance": "Error left in the mean of reflections, relative to it: white from 100 % on",
    "reflections.marked": "Reflection samples that are replaced: sparks red, missing ones blue",
}


def filter_passes(settings: DenoiserSettings, stride: int, lobe: int, jitter: bool) -> list[FilterPass]:
    """Return the passes of the filter, each twice as wide as the one before.

    Args:
        settings: Number of passes, width of the first, weights.
        stride: Pixels of a block's side.
        lobe: LOBE_REFLECTION or LOBE_TRANSMISSION.
        jitter: Whether the last pass moves its taps where the roughness varies.
    """
    passes, before = [], 0.0
    for index in range(settings.reflection_iterations):
        step = (1 << index) * max(stride / 2, 1.0) * settings.reflection_kernel
        part = FilterPass()
        part.sigma = GAUSSIAN_WIDTH * step
        part.before = before
        part.spacing = max(round(step / stride), 1)
        part.radius = 1 if part.sigma < 0.8 * part.spacing * stride else 2
        part.first = int(index == 0)
        part.ratio = int(settings.reflection_ratio)
        part.jitter = int(jitter)
        passes.append(part)
        # The ratio's pass does not widen the lobe.
        if index > 0 or lobe != LOBE_REFLECTION:
            before += part.sigma**2
    return passes


class ReflectionDenoisePass:
    """Filters the samples of one lobe."""

    def __init__(self, device: str, settings: DenoiserSettings | None = None, lobe: int = LOBE_REFLECTION):
        self.device = device
        self.settings = settings or DenoiserSettings()
        self.lobe = lobe
        self.name = "reflection denoise" if lobe == LOBE_REFLECTION else "transmission denoise"
        self.debug_views = dict(DEBUG_VIEWS) if lobe == LOBE_REFLECTION else {}
        self.width = self.height = self.stride = 0

    def resize(self, width: int, height: int, stride: int) -> None:
        """Allocate all buffers for a size [px] and blocks of stride x stride pixels."""
        self.width, self.height, self.stride = width, height, stride
        pixels, device = width * height, self.device
        blocks = -(-width // stride) * -(-height // stride)

        def light(count: int) -> ReflectionLight:
            out = ReflectionLight()
            out.light = wp.zeros(count, dtype=wp.uint64, device=device)
            out.state = wp.zeros(count, dtype=wp.uint64, device=device)
            return out

        def history() -> ReflectionHistory:
            h = ReflectionHistory()
            h.light = wp.zeros(pixels, dtype=wp.uint64, device=device)
            h.state = wp.zeros(pixels, dtype=wp.uint64, device=device)
            return h

        self.history: History[ReflectionHistory] = History(self.name, history)
        self.blocks = ReflectionBlocks()
        self.blocks.surface = wp.zeros(blocks, dtype=wp.uint64, device=device)
        self.blocks.mark = wp.zeros(blocks, dtype=wp.uint8, device=device)
        self.blocks.closeness = wp.zeros(blocks, dtype=wp.float16, device=device)
        self._excess = wp.zeros(blocks, dtype=wp.uint64, device=device)
        self._lights = (light(blocks), light(blocks))
        self.filtered = light(pixels)
        """This frame's light at all pixels, before it is averaged"""

    def reset(self) -> None:
        """Forget all frames."""
        self.history.reset()

    def record(
        self, graph: FrameGraph, parity: int, views: wp.array, gbuffer: GBuffer,
        previous_gbuffer: GBuffer, reprojection: Reprojection, options: ReflectionOptions,
        samples: ReflectionSamples, *, jitter: bool = True,
    ) -> wp.array:
        """Record the filters; return the mean.

        Args:
            graph: Takes the launches.
            parity: Of the frames recorded.
            views: One View.
            gbuffer: Of this frame.
            previous_gbuffer: Of the frame before.
            reprojection: Of this frame.
            options: Sizes and zones of roughness; `lobe` is this pass's.
            samples: Of this frame, one a block.
            jitter: Whether the last pass of the filter moves its taps where the roughness varies.

        Returns:
            uint64 [h * w]: pack_mean of demodulated, exposed radiance of every pixel that is sampled, else 0; one array
            for even, another for odd frames.
        """
        pixels, count = self.width * self.height, len(self.blocks.mark)
        self.options, self._views, self._samples = options, views, samples
        source, target = self._lights
        graph.launch(
            reflection_blocks.gather_samples, count, [gbuffer, options, samples], [self.blocks, source])
        cleanup = self.settings.reflection_cleanup
        graph.launch(
            reflection_cleanup.mark_samples, count, [views, gbuffer, options, int(cleanup), self.blocks, source],
            [self.blocks.mark, self.blocks.closeness, target, self._excess])
        if cleanup:
            graph.launch(
                reflection_cleanup.clean_samples, count,
                [views, gbuffer, options, self.blocks, target, self._excess], [source])
        before = self.history.previous(parity)
        *inner, last = filter_passes(self.settings, self.stride, self.lobe, jitter)
        for part in inner:
            kernel = reflection_atrous.filter_samples if part.first else reflection_atrous.filter_blocks
            graph.launch(
                kernel if part.ratio else reflection_atrous.filter_published, count,
                [views, gbuffer, options, part, samples, self.blocks, source, before], [target])
            source, target = target, source
        later = not last.first and last.ratio
        graph.launch(
            reflection_upscale.upscale_blocks if later else reflection_upscale.upscale_samples, pixels,
            [views, gbuffer, options, last, samples, self.blocks, source, before, reprojection], [self.filtered])
        history = self.history.current(parity)
        graph.launch(
            reflection_temporal.accumulate_reflections, pixels,
            [views, gbuffer, previous_gbuffer, reprojection, options, samples, self.filtered, before,
             int(self.settings.reflection_temporal), float(self.settings.reflection_history),
             float(self.settings.reflection_clamp)],
            [history])
        return history.light

    def known(self, parity: int) -> ReflectionHistory | None:
        """Return the means of the frame before one of this parity; None where none are kept."""
        return self.history.previous(parity) if self.settings.reflection_temporal else None

    def mirrors(self, parity: int, gbuffer: GBuffer) -> Mirrors:
        """Return what a frame of this parity knows of how long mirrors have shown what they show; as of record()."""
        mirrors = Mirrors()
        length = min(self.settings.reflection_history * MIRROR_SHARE, MIRROR_FRAMES)
        if self.settings.reflection_temporal and length > RENEWED_LENGTH:
            mirrors.material, mirrors.state = gbuffer.material, self.history.current(parity).state
            mirrors.known = length
        return mirrors

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` of this frame into `picture` (vec4 [h * w]); comes after record()."""
        show, history, views = reflection_filter_debug, self.history.current(parity), self._views
        kernel, inputs = {
            "reflections.filtered": (
                show.show_filtered_reflections, [views, self.options, self._samples, self.filtered]),
            "reflections.history": (show.show_reflection_history, [history]),
            "reflections.variance": (show.show_reflection_variance, [history]),
            "reflections.marked": (show.show_marked_samples, [self.options, self.blocks]),
        }[name]
        graph.launch(kernel, self.width * self.height, inputs, [picture])
