# SPDX-License-Identifier: GPL-3.0-or-later
"""The film on the device: sums of samples per pixel, of colours, first surfaces, light and the denoiser's guides."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels import denoise_guides, film
from ..device import launch
from ..report import Report, ReportKind
from .path_light import LightFilm
from .wavefront import Wavefront

__all__ = ["FilmBuffers", "GuideFilm"]

BACKGROUND_DEPTH = 1e10
"""Depth where there is no surface, as Cycles writes it"""

GUIDES_AT_ONCE, GUIDE_SHARE = 8, 0.25
"""First samples that are guides all, and share of those after: a sample that is one takes up to 4 % longer"""
GOLDEN_RATIO = 0.5 * (1.0 + math.sqrt(5.0))


class GuideFilm:
    """Albedo and normal of what paths show (kernels/path_guides.py), summed for the final denoiser."""

    def __init__(self, pixel_count: int, device: str):
        """Make empty sums."""
        self.device = device
        self.moving = False
        """Whether samples are of several moments. Their noise is of kinds that those of one don't have: means of many
        count as noisy too"""
        self._albedo = wp.zeros(pixel_count, dtype=wp.vec4, device=device)
        self._normal = wp.zeros(pixel_count, dtype=wp.vec3, device=device)

    def clear(self) -> None:
        """Forget all samples."""
        self.moving = False
        self._albedo.zero_()
        self._normal.zero_()

    @staticmethod
    def wants(first: int) -> bool:
        """Tell whether the samples of a batch that begins with that number are guides.

        Not in a regular order: those of a picture of several moments would miss some of them.
        """
        return first < GUIDES_AT_ONCE or first * GOLDEN_RATIO % 1.0 < GUIDE_SHARE

    def begin(self, slot: Wavefront, paths: int) -> None:
        """Let the first `paths` of a slot, which are about to start, be guides."""
        launch(denoise_guides.begin_guides, paths, [], [slot.paths], self.device)

    def add(self, slot: Wavefront, first: int, count: int, samples: int) -> None:
        """Add what finished paths have shown: `samples` of each of `count` pixels from `first` on."""
        launch(denoise_guides.add_guides, count, [first, count, samples], [slot.paths, self._albedo, self._normal],
               self.device)

    def means(self) -> tuple[wp.array, wp.array]:
        """Return the means: albedo, 0..1, and normal, vec3 [pixels] each."""
        means = tuple(wp.empty(len(self._normal), dtype=wp.vec3, device=self.device) for _ in range(2))
        launch(denoise_guides.mean_guides, len(self._normal), [self._albedo, self._normal], list(means), self.device)
        return means


@dataclass
class FilmBuffers:
    """The film on the device and how many samples each band has."""

    film: film.Film
    picture: wp.array
    pixel_count: int
    passes: bool
    light: LightFilm
    """Sums of the passes of light; false for none"""
    guides: GuideFilm | None = None
    """Where the picture is going to be denoised"""
    empty: bool = True
    """Whether no sample has come in since it was made or cleared"""

    @staticmethod
    def make(pixel_count: int, passes: bool, device: str, light_passes: Iterable[str] = (),
             denoised: bool = False) -> FilmBuffers:
        """Allocate a cleared film.

        Args:
            pixel_count: Of the picture.
            passes: Whether the first hits' data are kept.
            device: Warp's name.
            light_passes: Names of passes of light, as of is_light_pass.
            denoised: Whether the picture is going to be denoised.
        """
        buffers = film.Film()
        extra = pixel_count if passes else 1
        buffers.color = wp.zeros(pixel_count, dtype=wp.vec4, device=device)
        buffers.color_rest = wp.zeros(pixel_count, dtype=wp.vec4, device=device)
        buffers.squares = wp.zeros(pixel_count, dtype=float, device=device)
        buffers.samples = wp.zeros(pixel_count, dtype=int, device=device)
        # Counted as floats: Warp's sum of an array takes no integers.
        buffers.rejected = wp.zeros(pixel_count, dtype=float, device=device)
        buffers.overruns = wp.zeros(pixel_count, dtype=float, device=device)
        for name, dtype in (
            ("normal", wp.vec4), ("position", wp.vec4), ("uv", wp.vec4), ("depth", float), ("emission", wp.vec3),
            ("environment", wp.vec3),
        ):
            setattr(buffers, name, wp.zeros(extra, dtype=dtype, device=device))
        picture = wp.zeros(pixel_count, dtype=wp.vec4, device=device)
        return FilmBuffers(buffers, picture, pixel_count, passes, LightFilm(light_passes, pixel_count, device),
                           GuideFilm(pixel_count, device) if denoised else None)

    def clear(self) -> None:
        """Forget all samples."""
        if self.empty:
            # As in every frame of a real-time picture in motion.
            return
        self.empty = True
        for name in (
            "color", "color_rest", "squares", "samples", "rejected", "overruns", "normal", "position", "uv", "depth",
            "emission", "environment",
        ):
            getattr(self.film, name).zero_()
        self.light.clear()
        if self.guides is not None:
            self.guides.clear()

    def oddities(self, filtered: bool) -> Report:
        """Return a report of what the kernels counted while sampling; `filtered`: the scene has such triangles."""
        report = Report()
        rejected = int(wp.utils.array_sum(self.film.rejected))
        if rejected:
            report.add(ReportKind.ERROR, "", "samples that were not finite were left out of the picture", rejected)
        overruns = int(wp.utils.array_sum(self.film.overruns)) if filtered else 0
        if overruns:
            report.add(ReportKind.APPROXIMATED, "", "rays met more than 32 transparent layers and stopped there",
                       overruns)
        return report

    def read_surfaces(self, name: str, origin: np.ndarray) -> np.ndarray:
        """Return a pass of the first surfaces, Emission or Environment: float32 [h * w, channels].

        Args:
            name: As of Session.read.
            origin: float64 [3], the scene's origin, which positions are relative to.
        """
        counts = np.maximum(self.film.samples.numpy(), 1)[:, None]
        uv, position = self.film.uv.numpy(), self.film.position.numpy()
        if name == "Depth":
            seen = position.any(1) | (uv[:, 2] > 0)
            return np.where(seen, self.film.depth.numpy(), BACKGROUND_DEPTH)[:, None]
        if name == "Normal":
            return self.film.normal.numpy()[:, :3] / counts
        if name == "UV":
            return uv[:, :3] / counts
        if name == "Position":
            return np.where(uv[:, 2:3] > 0, position[:, :3] + origin.astype(np.float32), 0.0)
        if name in ("Emission", "Environment"):
            return getattr(self.film, name.lower()).numpy() / counts
        return position[:, 3:4] if name == "Object Index" else uv[:, 3:4]
