# SPDX-License-Identifier: GPL-3.0-or-later
"""Small pictures on a GPU are drawn at twice their width and height and averaged.

Frames of a small picture leave most of a GPU idle. With four times the pixels edges, textures and shadows in motion are
nearer to the truth than any history makes them, and no more rays are needed than for a large picture.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from ..kernels import supersampling
from .device import launch
from .pixel_filter import filter_table
from .ray_budget import is_small
from .settings import FilmSettings, PixelFilter, RenderSettings

__all__ = ["Supersampling"]

FACTOR = 2
"""Pixels of a frame along each side of a pixel of the picture"""

LEAST_JITTER = 0.1
"""Share of the filter's variance that must be left to the jitter: less would leave gaps between the samples"""

AVERAGES = {wp.vec3: supersampling.average_light, wp.vec4: supersampling.average_colors}


class Supersampling:
    """How many times as large as the picture its frames are, and the way back."""

    def __init__(self, device: str):
        self.device = device
        self.factor = 1
        self._width = self._height = 0

    def configure(self, settings: RenderSettings, width: int, height: int) -> None:
        """Set the picture's size [px] and choose the factor by it, the device and the settings."""
        denoiser = settings.denoiser
        wanted = self.device != "cpu" and denoiser.antialiasing and denoiser.supersample_small
        self.factor = FACTOR if wanted and is_small(width, height) and fine_width(settings.film, FACTOR) > 0.0 else 1
        self._width, self._height = width, height

    def camera(self, row: np.ndarray) -> np.ndarray:
        """Return a FrameData row (frame_data.py) of the larger frames."""
        if self.factor == 1:
            return row
        fine = row.copy()
        for name in ("width", "height", "crop_x", "crop_y", "crop_width", "crop_height"):
            fine[name] *= self.factor
        for name in ("spread", "pixel_size"):
            fine[name] /= self.factor
        return fine

    def quantiles(self, film: FilmSettings) -> np.ndarray:
        """Return the filter_table from which frames' jitter is drawn [px of a frame].

        The mean over a block widens what single pixels have; the rest of the filter's variance is left to the jitter.
        """
        width = film.filter_width if self.factor == 1 else fine_width(film, self.factor)
        return filter_table(film.pixel_filter, width)

    def average(self, picture: wp.array) -> wp.array:
        """Return what frames show, vec3 or vec4, at the picture's size [h * w]; itself where that is the same."""
        if self.factor == 1:
            return picture
        averaged = wp.empty(self._width * self._height, dtype=picture.dtype, device=self.device)
        launch(AVERAGES[picture.dtype], len(averaged), [0, picture, self._width, self.factor], [averaged], self.device)
        return averaged


def fine_width(film: FilmSettings, factor: int) -> float:
    """Return the width of the filter [px of a frame] that makes the picture's, together with the mean over blocks.

    By variances, which add up; a box is met exactly. 0 where the picture's filter is narrower than a block's mean.
    """
    if film.pixel_filter == PixelFilter.BOX:
        return film.filter_width
    wanted = float(np.var(filter_table(film.pixel_filter, film.filter_width))) * factor * factor
    left = 1.0 - (factor * factor - 1) / 12.0 / max(wanted, 1e-12)
    return film.filter_width * factor * math.sqrt(left) if left > LEAST_JITTER else 0.0
