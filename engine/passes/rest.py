# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture at rest: path-traced samples, denoised by what filtered frames know.

Owns the picture and its bands. Frames hardly change any more when this runs, so it is launched on its own and is no
part of a frame's record.
"""

from __future__ import annotations

import warp as wp

from ...kernels import composite_debug, rest_blend, rest_lonely
from ...kernels.gbuffer import GBuffer
from ..device import launch
from .film_buffers import FilmBuffers

__all__ = ["SETTLING", "TURN", "RestBlend"]

SETTLING = 8
"""Frames at rest before the first path-traced sample: light has spread by then, and a camera that stops for a moment
costs nothing"""
TURN = 8
"""Samples, then frames, that follow one another where several are asked for at once: samples are faster in batches"""
BANDS = 6
"""Of the a-trous transform: the widest kernel reaches 63 pixels to each side"""


class RestBlend:
    """Goes over from filtered frames to the reference integrator's picture, unseen."""

    name = "rest"

    debug_views = {
        "rest.weight":
            "Share of the finest detail that comes from path-traced samples, once the picture has been at rest for "
            "some frames: white is all",
    }

    def __init__(self, device: str):
        self.device = device
        self.width = self.height = 0
        self._frames = 0
        self._ready = False

    def resize(self, width: int, height: int) -> None:
        """Set the size [px]."""
        self.width, self.height = width, height
        self._ready = False
        self.reset()

    def reset(self) -> None:
        """Forget the frames at rest."""
        self._frames = 0

    def _allocate(self) -> None:
        """Allocate when a picture has come to rest: one that never does costs no memory."""
        count = self.width * self.height
        self._normals = wp.zeros(count, dtype=wp.vec3, device=self.device)
        self.weight = wp.zeros(count, dtype=float, device=self.device)
        self._share, self._variance, self._trust = (
            wp.zeros(count, dtype=float, device=self.device) for _ in range(3))
        self._picture, self._kept, self._guide, *self._colors = (
            wp.zeros(count, dtype=wp.vec4, device=self.device) for _ in range(5))
        self._ratio = wp.zeros(count, dtype=wp.vec2, device=self.device)
        self._ready = True

    def add_frame(self, gbuffer: GBuffer, factor: int = 1) -> None:
        """Take in the surfaces of a frame at rest that has `factor` times the picture's width and height."""
        if not self._ready:
            self._allocate()
        launch(rest_blend.add_normals, self.width * self.height, [0, gbuffer, self.width, factor, self._frames],
               [self._normals], self.device)
        self._frames += 1

    def resolve(self, film_buffers: FilmBuffers, f_picture: wp.array, transparent: bool = True,
                normals: wp.array | None = None) -> wp.array:
        """Return the picture on the device, valid until the next call: vec4 [h * w].

        Args:
            film_buffers: Path-traced samples since the picture came to rest, any number of them.
            f_picture: vec4 [h * w], what real-time frames have averaged at rest, exposed as the film is.
            transparent: Whether alpha is kept; else it is 1, as film.resolve_color has it.
            normals: vec3 [h * w], mean normals to use instead of those of the frames at rest.
        """
        if not self._ready:
            self._allocate()
        count, film = self.width * self.height, film_buffers.film
        color, coarser = self._colors
        launch(rest_blend.measure_variance, count, [0, film, f_picture], [self._variance], self.device)
        launch(rest_blend.start_residual, count,
               [0, film, f_picture, self._variance, self._normals if normals is None else normals,
                self.width, self.height],
               [color, self._trust, self._guide, self._kept], self.device)
        for band in range(BANDS):
            residual = self._residual(color)
            launch(rest_blend.split_band, count, [0, residual, film, self._trust, 1 << band],
                   [coarser, self._ratio], self.device)
            launch(rest_blend.take_noise, count, [0, residual, coarser, self._ratio, film, f_picture],
                   [self._kept, self._share if band else self.weight], self.device)
            color, coarser = coarser, color
        residual = self._residual(color)
        launch(rest_lonely.split_lonely, count, [0, residual, film, self._variance, BANDS], [coarser, self._ratio],
               self.device)
        launch(rest_lonely.take_lonely_noise, count, [0, residual, coarser, self._ratio, f_picture], [self._kept],
               self.device)
        launch(rest_blend.finish, count, [0, film, f_picture, self._kept, self.weight, int(transparent)],
               [self._picture], self.device)
        return self._picture

    def _residual(self, color: wp.array) -> rest_blend.Residual:
        """Return what the kernels take of one level."""
        residual = rest_blend.Residual()
        residual.color, residual.guide = color, self._guide
        residual.width, residual.height = self.width, self.height
        return residual

    def scale_light(self, sharp: wp.array, shown: wp.array, light: wp.array) -> wp.array:
        """Return a lobe's direct or indirect light, vec3 [h * w], as a picture that is shown has it.

        Args:
            sharp: vec4 [h * w], what real-time frames have averaged, of which the light is a part.
            shown: vec4 [h * w], blurred by a lens or blended with path-traced samples.
            light: vec3 [h * w].
        """
        scaled = wp.empty_like(light)
        launch(rest_blend.scale_light, len(light), [0, sharp, shown, light], [scaled], self.device)
        return scaled

    def show_weight(self) -> wp.array:
        """Return the last blend's weights as a picture on the device: vec4 [h * w]."""
        launch(composite_debug.show_weight, self.width * self.height, [0, self.weight], [self._kept], self.device)
        return self._kept
