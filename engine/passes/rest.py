# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture at rest: filtered frames blended with path-traced samples by estimated error.

Owns the blended picture and the weights. Real-time frames have stopped when this runs, so it is launched on its own
and is no part of a frame's record.
"""

from __future__ import annotations

import warp as wp

from ...kernels import composite_debug, rest_blend
from ..device import launch
from .reference import FilmBuffers

__all__ = ["RestBlend"]

WINDOW_RADIUS = 4
"""Pixels to each side over which the filtered picture's bias is measured"""


class RestBlend:
    """Goes over from filtered frames to the reference integrator's picture, unseen."""

    name = "rest"

    debug_views = {
        "rest.weight":
            "Share of path-traced samples in the picture, once it has been at rest for long: white is all",
    }

    def __init__(self, device: str):
        self.device = device
        self.width = self.height = 0

    def resize(self, width: int, height: int) -> None:
        """Allocate for a size [px]."""
        self.width, self.height = width, height
        count = width * height
        self.weight = wp.zeros(count, dtype=float, device=self.device)
        self._picture = wp.zeros(count, dtype=wp.vec4, device=self.device)
        self._errors = wp.zeros(count, dtype=wp.vec4, device=self.device)
        self._sums = wp.zeros(count, dtype=wp.vec4, device=self.device)

    def reset(self) -> None:
        """Forget the last blend."""
        self.weight.zero_()

    def resolve(self, film_buffers: FilmBuffers, f_picture: wp.array, transparent: bool = True) -> wp.array:
        """Return the blend on the device, valid until the next call: vec4 [h * w].

        Args:
            film_buffers: Path-traced samples since the picture came to rest, any number of them.
            f_picture: vec4 [h * w], what real-time frames have averaged at rest, exposed as the film is.
            transparent: Whether alpha is kept; else it is 1, as film.resolve_color has it.
        """
        count, film = self.width * self.height, film_buffers.film
        launch(rest_blend.measure_errors, count, [0, film, f_picture], [self._errors], self.device)
        launch(rest_blend.sum_rows, count, [0, self._errors, self.width, WINDOW_RADIUS], [self._sums], self.device)
        launch(
            rest_blend.blend, count,
            [0, self._sums, film, f_picture, self.width, self.height, WINDOW_RADIUS, int(transparent)],
            [self._picture, self.weight], self.device)
        return self._picture

    def show_weight(self) -> wp.array:
        """Return the last blend's weights as a picture on the device: vec4 [h * w]."""
        launch(composite_debug.show_weight, self.width * self.height, [0, self.weight], [self._picture], self.device)
        return self._picture
