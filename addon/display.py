# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws a finished picture into the viewport, scene-linear: Blender applies the view transform afterwards.

One interface. Two portable ways: packed colours in an R32F texture, unpacked by our own fragment shader (4 bytes a
pixel; uploads in about 1 ms at 1080p), and RGBA16F for pictures with alpha, or where the shader can't be built. And
gl_interop.py's for pictures that are still on the GPU. A GPUTexture can't be written to by Blender's API, so each new
picture makes a new one; the previous is kept until the next draw, because the GPU may still be reading it.
"""

from __future__ import annotations

import logging
from typing import Any

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from . import compat, gl_interop
from .picture import EXPONENT_MIN, HALF_MAX, Picture, unpack_colors

__all__ = ["Display", "free_shader", "shader_available"]

log = logging.getLogger(__name__)

VERTEX_SOURCE = """
void main()
{
  uv = position;
  gl_Position = view_projection * vec4(mix(area.xy, area.zw, position), 0.0, 1.0);
}
"""

# The inverse of picture.pack_colors; `uv` runs over the picture, and enlarged pictures are filtered bilinearly.
FRAGMENT_SOURCE = """
vec3 unpack_color(ivec2 texel)
{
  uint bits = floatBitsToUint(texelFetch(picture, clamp(texel, ivec2(0), size - 1), 0).r);
  int stored = int(bits >> 27u);
  int code = stored - (stored > 16 ? 3 : 1);
  vec3 mantissa = vec3(float(bits & 511u), float((bits >> 9u) & 511u), float((bits >> 18u) & 511u));
  return mantissa * exp2(float(code + EXPONENT_BIAS));
}

void main()
{
  vec2 texel = uv * vec2(size) - 0.5;
  ivec2 corner = ivec2(floor(texel));
  vec2 weight = texel - floor(texel);
  vec3 bottom = mix(unpack_color(corner), unpack_color(corner + ivec2(1, 0)), weight.x);
  vec3 top = mix(unpack_color(corner + ivec2(0, 1)), unpack_color(corner + ivec2(1, 1)), weight.x);
  color = vec4(mix(bottom, top, weight.y), 1.0);
}
"""

_shader: Any = None
_batch: Any = None
_shader_failed = False


def _build_shader() -> None:
    global _shader, _batch
    interface = gpu.types.GPUStageInterfaceInfo("burnish_picture_interface")
    interface.smooth('VEC2', "uv")
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant('MAT4', "view_projection")
    info.push_constant('VEC4', "area")
    info.push_constant('IVEC2', "size")
    info.define("EXPONENT_BIAS", str(EXPONENT_MIN - 9))
    info.sampler(0, 'FLOAT_2D', "picture")
    info.vertex_in(0, 'VEC2', "position")
    info.vertex_out(interface)
    info.fragment_out(0, 'VEC4', "color")
    info.vertex_source(VERTEX_SOURCE)
    info.fragment_source(FRAGMENT_SOURCE)
    _shader = gpu.shader.create_from_info(info)
    corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    _batch = batch_for_shader(_shader, 'TRIS', {"position": corners}, indices=((0, 1, 2), (0, 2, 3)))


def shader_available() -> bool:
    """Tell whether packed pictures can be drawn; builds the shader at the first call, with a GPU context."""
    global _shader_failed
    if _shader is None and not _shader_failed:
        try:
            _build_shader()
        except Exception:
            _shader_failed = True
            log.warning("The shader for packed pictures can't be built; half-float textures are used", exc_info=True)
    return _shader is not None


def free_shader() -> None:
    """Drop the shader (unregister, exit)."""
    global _shader, _batch, _shader_failed
    _shader, _batch, _shader_failed = None, None, False


def make_texture(pixels: np.ndarray, texture_format: str) -> Any:
    """Upload float32 [h, w] or [h, w, 4] into a new GPUTexture; the Buffer is a view of the array, not a copy."""
    height, width = pixels.shape[:2]
    data = gpu.types.Buffer('FLOAT', pixels.size, pixels.reshape(-1))
    return gpu.types.GPUTexture((width, height), format=texture_format, data=data)


class Display:
    """The textures of one viewport; every method needs a GPU context and the main thread."""

    def __init__(self) -> None:
        self._texture: Any = None
        self._previous: Any = None
        self._serial = -1
        self._packed = False
        self._shared = gl_interop.SharedTextures()

    @staticmethod
    def can_share(device: str) -> bool:
        """Tell whether pictures may stay on `device` (Warp's name)."""
        return bool(device) and gl_interop.probe(device)

    def draw(self, picture: Picture, width: int, height: int) -> None:
        """Draw `picture` over its part of a region of width x height pixels, in Blender's pixel-space matrices."""
        if picture.serial != self._serial:
            self._upload(picture)
        left, bottom, right, top = picture.area
        area = (left * width, bottom * height, right * width, top * height)
        if self._packed:
            self._draw_packed(picture, area)
        else:
            self._draw_plain(area)

    def free(self) -> None:
        """Drop the textures."""
        self._texture = self._previous = None
        self._shared.free()
        self._serial = -1

    def _upload(self, picture: Picture) -> None:
        self._previous = self._texture
        self._packed = picture.packed and shader_available()
        if self._packed:
            self._texture = make_texture(picture.pixels, 'R32F')
        elif picture.on_device:
            self._texture = self._shared.upload(picture.pixels)
        else:
            self._texture = make_texture(plain_pixels(picture), 'RGBA16F')
        if not self._packed:
            compat.set_texture_filter(self._texture, True)
        self._serial = picture.serial

    def _draw_packed(self, picture: Picture, area: tuple[float, float, float, float]) -> None:
        height, width = picture.pixels.shape
        gpu.state.blend_set('NONE')
        _shader.bind()
        to_clip = gpu.matrix.get_projection_matrix() @ gpu.matrix.get_model_view_matrix()
        _shader.uniform_float("view_projection", to_clip)
        _shader.uniform_float("area", area)
        _shader.uniform_int("size", (width, height))
        _shader.uniform_sampler("picture", self._texture)
        _batch.draw(_shader)

    def _draw_plain(self, area: tuple[float, float, float, float]) -> None:
        from gpu_extras.presets import draw_texture_2d

        gpu.state.blend_set('ALPHA_PREMULT')
        draw_texture_2d(self._texture, area[:2], area[2] - area[0], area[3] - area[1])
        gpu.state.blend_set('NONE')


def plain_pixels(picture: Picture) -> np.ndarray:
    """Return a picture's pixels as float32 [h, w, 4] within half floats."""
    if not picture.packed:
        return picture.pixels
    rgba = np.ones((*picture.pixels.shape, 4), np.float32)
    rgba[..., :3] = np.minimum(unpack_colors(picture.pixels), np.float32(HALF_MAX))
    return rgba
