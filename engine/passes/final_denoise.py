# SPDX-License-Identifier: GPL-3.0-or-later
"""The last step of a final render that is to be denoised: guides, Open Image Denoise, and what it may not take away.

The mean P of path-traced samples is denoised (O), not the picture that real-time frames make: their noise is the same
in neighbouring pixels, which no denoiser of this kind expects. O is blurred where P is noisy, however little, so P's
detail that stands out of its noise is put back as the picture at rest does it (rest.py with O in the frames' place,
R), and the two are averaged: their errors differ. O's share falls with the samples, so that the limit is P.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np
import warp as wp

from ...kernels import denoise_guides, denoise_guides_lean, film, path_lists
from ...kernels.path_guides import GUIDE_MIRRORS
from ...kernels.paths import Options
from ...kernels.types import Scene
from .. import oidn
from ..device import launch
from ..history import copy_struct
from ..oidn import never
from .film_buffers import FilmBuffers
from .material_steps import evaluate_step
from .reference import Band, ReferencePass, hit_steps
from .rest import RestBlend
from .wavefront import HIT_LISTS, Step, Wavefront

__all__ = ["FinalDenoise"]

GUIDE_SAMPLES = 8, 64
"""Fewest and most jittered first hits a pixel that guides are averaged of where no samples have collected them.

Between, doubled with the frames of the picture and at most a quarter of them, beside which they take little time. With
fewer than the most the guides are denoised themselves: their noise at edges and behind veils would be taken for
texture.
"""
CLEAN_SAMPLES = 256
"""From which on those that samples have collected are taken for free of noise: a quarter of the samples are guides"""
PROCESSOR_GUIDES = 1
"""Fewest on the processor: one takes as long there as a fifth to a third of a sample of the picture"""
PROCESSOR_HASTE = 3
"""Samples below which guides are not denoised on the processor: that takes as long as a sample or two, and a second
sample beside noisy guides is worth more than a first beside clean ones"""
MIRRORS = int(GUIDE_MIRRORS)
"""Mirrors and panes of glass that guides look through, one behind the other"""
EVEN_SAMPLES = 1000.0
"""Samples at which O and R count the same"""
DETAIL_SAMPLES = 32
"""Samples below which R is not made: it would count for less than 3 %, and its noise with it"""
FRAMES_SHARE = 0.4, 0.5
"""Of the picture made with real-time frames, where there are any, beside O: it errs differently from R. The second
where frames have twice the picture's size, and a quarter of the noise"""


class FinalDenoise:
    """Guides and pictures of one session; nothing is allocated before the first picture."""

    def __init__(self, device: str):
        self.device = device
        self.used = ""
        """Device that filtered the newest picture: "cuda" or "cpu" """
        self._guides: tuple[wp.array, wp.array] | None = None
        self._guide_samples = 0
        self._noiseless = False
        """Whether the guides are free of noise: made of most samples, or denoised"""
        self._options: tuple[Options, Options] | None = None
        """The path tracer's and those made of them: the same object again, for what is recorded with it"""
        self._blend = RestBlend(device)

    def reset(self) -> None:
        """Forget the guides: what is seen has changed."""
        self._guides = None

    def guides(
        self, tracer: ReferencePass, buffers: FilmBuffers, scene: Scene, frame: np.ndarray, options: Options,
        table: wp.array, samples: int, should_stop: Callable[[], bool] = never,
    ) -> tuple[wp.array, wp.array] | None:
        """Return albedo, 0..1, and normal of what each pixel shows, seen in mirrors too: vec3 [h * w] each.

        Those that the path tracer's samples have collected, if they are enough. None where it was told to stop.

        Args:
            tracer: Its bands are the picture's; lends its path states.
            buffers: Its film.
            scene: The device scene.
            frame: One FrameData row.
            options: Of the path tracer, without passes.
            table: Inverse distribution of the pixel filter.
            samples: How many the picture has, or frames.
            should_stop: Polled often.
        """
        fewest, most = GUIDE_SAMPLES
        wanted = fewest if tracer.cuda else PROCESSOR_GUIDES
        collected = buffers.guides
        if collected is not None and tracer.samples_done > 0:
            if self._guides is None or self._guide_samples != tracer.samples_done:
                self._guides, self._guide_samples = collected.means(), tracer.samples_done
                self._noiseless = self._guide_samples >= CLEAN_SAMPLES and not collected.moving
            return self._guides
        while 2 * wanted <= min(samples // 4, most):
            wanted *= 2
        if self._guides is None or self._guide_samples < wanted:
            if self._options is None or self._options[0] is not options:
                self._options = options, without_roulette(options)
            whole = self._options[1]
            count = sum(band.count for band in tracer.bands)
            guides = tuple(wp.zeros(count, dtype=wp.vec3, device=self.device) for _ in range(2))
            tracer.each_band(tracer.bands, lambda band: find_guides(
                tracer, band, scene, frame, whole, table, wanted, guides, should_stop))
            if should_stop():
                return None
            self._guides, self._guide_samples, self._noiseless = guides, wanted, wanted == most
        return self._guides

    def run(self, library: ctypes.CDLL, guides: tuple[wp.array, wp.array], size: tuple[int, int], *, clean: bool,
            traced: tuple[ReferencePass, FilmBuffers] | None, picture: wp.array | None, transparent: bool,
            should_stop: Callable[[], bool] = never, supersampled: bool = False) -> wp.array | None:
        """Return the denoised picture on the device: vec4 [h * w]; None where it was told to stop.

        Args:
            library: From oidn.load.
            guides: From `guides`.
            size: Width and height [px].
            clean: Whether the guides are free of noise: not where the lens blurs them. Nor where motion does.
            traced: Path-traced samples and what traced them; None without.
            picture: vec4 [h * w], what real-time frames (and samples, if any) make; None without frames. One of the
                two must be there.
            transparent: Whether alpha is kept.
            should_stop: Polled often on a processor.
            supersampled: Whether frames have twice the picture's size.

        Raises:
            BurnishError: The library failed.
        """
        count = size[0] * size[1]
        source = picture
        if traced is not None:
            samples, buffers = traced[0].samples_done, traced[1]
            source = wp.empty(count, dtype=wp.vec4, device=self.device)
            launch(film.resolve_color, count, [buffers.film, int(transparent)], [source], self.device)
        albedo, normal = guides
        hasty = traced is not None and samples < PROCESSOR_HASTE and not traced[0].cuda
        prefilter = not (self._noiseless or hasty)
        denoised = wp.clone(source)
        self.used = oidn.denoise(library, oidn.Images(
            color=source, output=denoised, albedo=albedo, normal=normal, width=size[0], height=size[1],
            clean=clean and (self._noiseless or prefilter), prefilter=prefilter), should_stop)
        if not self.used:
            # The guides may be half filtered.
            self._guides = None
            return None
        self._noiseless = self._noiseless or prefilter
        # A pixel that the denoiser has spoilt stays as it came.
        launch(denoise_guides.mix_pictures, count, [0, denoised, source, 1.0], [denoised], self.device)
        if traced is None:
            return denoised
        if samples >= DETAIL_SAMPLES:
            if (self._blend.width, self._blend.height) != size:
                self._blend.resize(*size)
            detailed = self._blend.resolve(buffers, denoised, transparent, normal)
            share = EVEN_SAMPLES / (EVEN_SAMPLES + samples)
            launch(denoise_guides.mix_pictures, count, [0, denoised, detailed, share], [denoised], self.device)
        if picture is not None:
            share = 1.0 - FRAMES_SHARE[int(supersampled)]
            launch(denoise_guides.mix_pictures, count, [0, denoised, picture, share], [denoised], self.device)
        return denoised


def without_roulette(options: Options) -> Options:
    """Return options with which no path ends by chance: guides would be noisy where they look through mirrors."""
    whole = copy_struct(options)
    whole.roulette_start = MIRRORS + 1
    return whole


def find_guides(tracer: ReferencePass, band: Band, scene: Scene, frame: np.ndarray, options: Options, table: wp.array,
                samples: int, guides: tuple[wp.array, wp.array], should_stop: Callable[[], bool]) -> None:
    """Find the guides of a band's pixels, means of `samples`, in as few batches as there are path states for."""
    def trace(slot: Wavefront, done: int, count: int) -> None:
        if should_stop():
            return
        # After so many rounds no path goes on.
        slot.trace("guides", (scene, options), lambda: guide_steps(slot, scene, options), frame, table,
                   (band.first, band.count), (done, count), MIRRORS + 1, should_stop)
        launch(denoise_guides.average_guides, band.count,
               [slot.paths, band.first, band.count, count, 1.0 / samples], list(guides), tracer.device)

    tracer.in_batches(band, 0, samples, trace)


def guide_steps(slot: Wavefront, scene: Scene, options: Options) -> list[Step]:
    """Return what follows paths to what they show."""
    shown = [scene, options.exposure]
    steps = [*hit_steps(slot, scene, options), Step(denoise_guides.show_misses, [options.exposure]),
             Step(denoise_guides_lean.find_lean_surfaces, shown)]
    if not options.all_lean:
        for hits in HIT_LISTS:
            steps += [evaluate_step(slot, scene, hits), Step(denoise_guides.find_surfaces, shown, over=hits)]
    return [*steps, Step(path_lists.list_living, [slot.paths.state], fills=("next",), changes=False)]
