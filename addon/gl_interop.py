# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that never leave the GPU: Blender's own OpenGL textures, written by CUDA.

Blender gives no native handle of a texture, but OpenGL tells the name of what is attached to the bound framebuffer.
Only where OpenGL and CUDA run on the same device; `probe` tries it once per start. Not on Vulkan or Metal.
"""

from __future__ import annotations

import ctypes
import logging
import sys
from typing import Any

import gpu
import numpy as np

__all__ = ["SharedTexture", "SharedTextures", "gl_texture_name", "probe"]

log = logging.getLogger(__name__)

# From Khronos' gl.xml.
GL_FRAMEBUFFER = 0x8D40
GL_COLOR_ATTACHMENT0 = 0x8CE0
GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE = 0x8CD0
GL_FRAMEBUFFER_ATTACHMENT_OBJECT_NAME = 0x8CD1
GL_TEXTURE = 0x1702

FUNCTION = "glGetFramebufferAttachmentParameteriv"
LIBRARIES = ("libOpenGL.so.0", "libGL.so.1")
PROBE_SIZE = 8
SIZES_MAX = 4
"""Textures kept for different sizes: navigation alternates between a few."""

_probed: dict[str, bool] = {}


def _query_function() -> Any:
    if sys.platform == "win32":
        address = ctypes.windll.opengl32.wglGetProcAddress
        address.restype, address.argtypes = ctypes.c_void_p, (ctypes.c_char_p,)
        prototype = ctypes.WINFUNCTYPE(None, ctypes.c_uint, ctypes.c_uint, ctypes.c_uint, ctypes.POINTER(ctypes.c_int))
        return prototype(address(FUNCTION.encode()))
    for library in LIBRARIES:
        try:
            function = getattr(ctypes.CDLL(library), FUNCTION)
        except (OSError, AttributeError):
            continue
        function.restype = None
        function.argtypes = (ctypes.c_uint, ctypes.c_uint, ctypes.c_uint, ctypes.POINTER(ctypes.c_int))
        return function
    raise RuntimeError("OpenGL's library was not found")


def gl_texture_name(texture: Any) -> int:
    """Return OpenGL's name of a GPUTexture; raises RuntimeError where it can't be found."""
    query, value = _query_function(), ctypes.c_int(0)
    with gpu.types.GPUFrameBuffer(color_slots=(texture,)).bind():
        query(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE, ctypes.byref(value))
        if value.value != GL_TEXTURE:
            raise RuntimeError(f"the framebuffer's attachment is no texture ({value.value:#x})")
        query(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_FRAMEBUFFER_ATTACHMENT_OBJECT_NAME, ctypes.byref(value))
    if value.value <= 0:
        raise RuntimeError("OpenGL gave no texture name")
    return value.value


class SharedTexture:
    """A half-float GPUTexture that CUDA writes; raises RuntimeError where that can't be."""

    def __init__(self, width: int, height: int, device: str) -> None:
        from ..engine.display import GlTexture

        self.texture = gpu.types.GPUTexture((width, height), format='RGBA16F')
        self._registered = GlTexture(gl_texture_name(self.texture), device)

    def write(self, picture: Any) -> None:
        """Copy an engine.display.DevicePicture of the same size."""
        self._registered.write(picture)


class SharedTextures:
    """The shared textures of one viewport, by size."""

    def __init__(self) -> None:
        self._textures: dict[tuple[int, int, str], SharedTexture] = {}

    def upload(self, picture: Any) -> Any:
        """Return a GPUTexture with the pixels of an engine.display.DevicePicture."""
        key = (picture.width, picture.height, picture.device)
        # Taken out and put back, so that the first key is the one unused for longest.
        shared = self._textures.pop(key, None) or SharedTexture(*key)
        self._textures[key] = shared
        if len(self._textures) > SIZES_MAX:
            del self._textures[next(iter(self._textures))]
        shared.write(picture)
        return shared.texture

    def free(self) -> None:
        """Drop all textures."""
        self._textures.clear()


def probe(device: str) -> bool:
    """Tell whether pictures on `device` (Warp's alias) can be shared; tries it once, with the GPU context current."""
    if device not in _probed:
        _probed[device] = device.startswith("cuda") and gpu.platform.backend_type_get() == 'OPENGL' and _try(device)
    return _probed[device]


def _try(device: str) -> bool:
    from ..engine.display import make_test_picture

    try:
        expected, picture = make_test_picture(device, PROBE_SIZE)
        textures = SharedTextures()
        pixels = np.array(textures.upload(picture).read().to_list(), np.float32).reshape(expected.shape)
        if np.array_equal(pixels, expected):
            return True
        log.info("Textures shared with CUDA hold wrong pixels; pictures are copied through memory")
    except Exception as error:
        log.info("Textures can't be shared with CUDA (%s); pictures are copied through memory", error)
    return False
