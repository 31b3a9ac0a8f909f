# SPDX-License-Identifier: GPL-3.0-or-later
"""A session's picture on its way to a viewport: packed on the device and read back, or copied into a GL texture.

Owns the small buffers between the film and the screen. Knows nothing of Blender; the caller finds the GL texture.
"""

from __future__ import annotations

import sys
import types
from typing import Any

import numpy as np
import warp as wp

from ..kernels import display
from .device import launch, record
from .staging import PicturePages

__all__ = ["DevicePicture", "GlTexture", "PictureReader", "make_test_picture"]

GL_TEXTURE_2D = 0x0DE1
GL_TEXTURE_1D = 0x0DE0
GL_TEXTURE_3D = 0x806F

RING = 3
"""Device pictures in turn: one being drawn, the newest, and the one being written."""


class DevicePicture:
    """A picture that stays on its CUDA device: half-float RGBA [h, w]."""

    def __init__(self, halves: wp.array):
        self.halves = halves
        self.height, self.width = halves.shape
        self.device = str(halves.device)


class PictureReader:
    """Reads pictures of one session in display formats; for the session's own thread."""

    def __init__(self, device: str):
        self.device = device
        self._packed: wp.array | None = None
        self._packing: wp.Launch | None = None
        """Recorded: to launch anew takes longer than all else here"""
        self._pages = PicturePages()
        self._ring: list[wp.array] = []
        self._turn = 0

    @property
    def cuda(self) -> bool:
        """Whether pictures can stay on the device."""
        return wp.get_device(self.device).is_cuda

    def packed(self, picture: wp.array, width: int, height: int) -> np.ndarray:
        """Return `picture` (vec4 [h * w] on the device) packed: float32 [h, w], bottom row first, owned by the caller.

        The floats are bit patterns, never NaN; see kernels/display.py.
        """
        count = width * height
        if self._packed is None or self._packed.size != count:
            self._packed = wp.empty(count, dtype=wp.uint32, device=self.device)
            self._packing = record(display.pack_picture, [picture], [self._packed], self.device, count)
        self._packing.set_param_by_name("picture", picture)
        self._packing.launch()
        return self._pages.read(self._packed).view(np.float32).reshape(height, width)

    def on_device(self, picture: wp.array, width: int, height: int) -> DevicePicture:
        """Return `picture` as half floats that stay on the device, valid until RING more were made."""
        if not self._ring or self._ring[0].shape != (height, width):
            self._ring = [wp.empty((height, width), dtype=wp.vec4h, device=self.device) for _ in range(RING)]
        self._turn = (self._turn + 1) % RING
        halves = self._ring[self._turn]
        launch(display.halve_picture, width * height, [picture], [halves.flatten()], self.device)
        # The picture must be complete before another thread copies it, whatever stream that uses.
        wp.synchronize_stream(wp.get_stream(self.device))
        return DevicePicture(halves)


def make_test_picture(device: str, size: int) -> tuple[np.ndarray, DevicePicture]:
    """Return a square picture of distinct values on the device, and the same as float32 [size, size, 4]."""
    values = np.arange(size * size * 4, dtype=np.float32).reshape(size, size, 4)
    return values, DevicePicture(wp.array(values.astype(np.float16), dtype=wp.vec4h, device=device))


class GlTexture:
    """A GL texture (RGBA16F) registered with CUDA; needs the thread and context that GL is current in.

    Raises:
        RuntimeError: GL and CUDA run on different devices, or the driver refuses.
    """

    def __init__(self, name: int, device: str):
        _stand_in_for_pyglet()
        self._resource = wp.GLTextureResource(name, GL_TEXTURE_2D, device=device)

    def write(self, picture: DevicePicture) -> None:
        """Copy a picture of the texture's size into it, on the device."""
        texture = self._resource.map()
        try:
            texture.copy_from(picture.halves)
        finally:
            self._resource.unmap()


def _stand_in_for_pyglet() -> None:
    # Warp imports pyglet for three of OpenGL's constants; Blender does not carry it.
    if "pyglet" in sys.modules:
        return
    module: Any = types.ModuleType("pyglet")
    module.gl = types.SimpleNamespace(
        GL_TEXTURE_1D=GL_TEXTURE_1D, GL_TEXTURE_2D=GL_TEXTURE_2D, GL_TEXTURE_3D=GL_TEXTURE_3D)
    sys.modules["pyglet"] = module
