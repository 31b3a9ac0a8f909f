# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture lookup: wrapping, bilinear filtering, alpha and colour decoding. Functions only.

Texels lie in flat arrays, one array for each storage format (kernels.types.Textures), rows **top first** as in image
files; uv (0, 0) is the lower left corner of the picture, so rows are counted from the bottom and flipped on reading.
Texel centres lie at (i + 0.5) / size. Which taps are taken, how they are wrapped, that filtering happens on stored
(sRGB-encoded) values with colour multiplied by alpha, and that decoding comes last all follow Cycles
(kernel/device/gpu/image.h and svm/image.h of Blender 5.2). Mip levels are Burnish's own.

Hardware textures (wp.Texture2D) are not used: they fix wrapping when they are made though one image may be used with
several, they build mip levels from encoded values, and they can't weight colour by alpha; see
tests/performance/texture_speed.py for their speed.
"""

from __future__ import annotations

import warp as wp

from .types import TextureInfo, Textures
from .wide_loads import load_texture_info, load_uint, load_vec4, load_vec4h, load_vec4us

__all__ = ["sample_texture", "srgb_to_linear"]

# The argument `extension`
EXTENSION_REPEAT = wp.constant(0)
EXTENSION_EXTEND = wp.constant(1)
EXTENSION_CLIP = wp.constant(2)
EXTENSION_MIRROR = wp.constant(3)

# The argument `interpolation`: one of the first three, plus SAMPLE_ASSOCIATED or not
INTERPOLATION_LINEAR = wp.constant(0)
INTERPOLATION_CLOSEST = wp.constant(1)
INTERPOLATION_CUBIC = wp.constant(2)
SAMPLE_ASSOCIATED = wp.constant(4)
"""Return colour multiplied by alpha: what Cycles does where a node's Alpha output is not used"""

# TextureInfo.format
TEXELS_BYTE = wp.constant(0)
TEXELS_SHORT = wp.constant(1)
TEXELS_HALF = wp.constant(2)
TEXELS_FLOAT = wp.constant(3)

# TextureInfo.alpha
ALPHA_UNRELATED = wp.constant(0)
"""Opaque, or alpha is one more data channel: colour is left as it is"""
ALPHA_STRAIGHT = wp.constant(1)
"""Colour is stored as it is, and is multiplied by alpha for filtering"""
ALPHA_ASSOCIATED = wp.constant(2)
"""Colour is stored multiplied by alpha"""


@wp.struct
class Texels:
    """Four neighbours."""

    lower_left: wp.vec4
    lower_right: wp.vec4
    upper_left: wp.vec4
    upper_right: wp.vec4


@wp.func
def srgb_to_linear(c: float) -> float:
    """Decode the sRGB transfer function (IEC 61966-2-1); negative values become 0."""
    if c < 0.04045:
        return wp.max(c, 0.0) * (1.0 / 12.92)
    return wp.pow((c + 0.055) * (1.0 / 1.055), 2.4)


@wp.func
def wrap_coordinate(x: float, extension: int) -> float:
    """Bring one finite texture coordinate into [0, 1]; for EXTENSION_CLIP into [-1, 2], outside which all is clear."""
    if extension == EXTENSION_REPEAT:
        return x - wp.floor(x)
    if extension == EXTENSION_MIRROR:
        t = x * 0.5
        t = 2.0 * (t - wp.floor(t))
        return wp.min(t, 2.0 - t)
    if extension == EXTENSION_CLIP:
        return wp.clamp(x, -1.0, 2.0)
    return wp.clamp(x, 0.0, 1.0)


@wp.func
def wrap_index(i: int, size: int, extension: int) -> int:
    """Bring a texel index of a wrapped coordinate into [0, size)."""
    # A mirrored coordinate lies within the picture: the texel beyond its edge is the edge's own.
    around = wp.where(i < 0, i + size, wp.where(i >= size, i - size, i))
    return wp.where(extension == EXTENSION_REPEAT, around, wp.clamp(i, 0, size - 1))


@wp.func
def byte_texel(texel: wp.uint32) -> wp.vec4:
    """Return a texel of bytes as 0..1."""
    mask = wp.uint32(255)
    return (1.0 / 255.0) * wp.vec4(
        float(texel & mask),
        float((texel >> wp.uint32(8)) & mask),
        float((texel >> wp.uint32(16)) & mask),
        float(texel >> wp.uint32(24)),
    )


@wp.func
def half_texel(halves: wp.vec4h) -> wp.vec4:
    """Return a texel of halves as floats."""
    return wp.vec4(float(halves[0]), float(halves[1]), float(halves[2]), float(halves[3]))


@wp.func
def short_texel(shorts: wp.vec4us) -> wp.vec4:
    """Return a texel of 16-bit integers as 0..1."""
    return (1.0 / 65535.0) * wp.vec4(float(shorts[0]), float(shorts[1]), float(shorts[2]), float(shorts[3]))


@wp.func
def load_texels(textures: Textures, format: int, indices: wp.vec4i) -> Texels:
    """Return four texels as stored, integers as 0..1.

    Together: one by one each would be waited for, since the ways to decode them part.
    """
    t = Texels()
    if format == TEXELS_BYTE:
        b0 = load_uint(textures.bytes4, indices[0])
        b1 = load_uint(textures.bytes4, indices[1])
        b2 = load_uint(textures.bytes4, indices[2])
        b3 = load_uint(textures.bytes4, indices[3])
        t.lower_left = byte_texel(b0)
        t.lower_right = byte_texel(b1)
        t.upper_left = byte_texel(b2)
        t.upper_right = byte_texel(b3)
    elif format == TEXELS_HALF:
        h0 = load_vec4h(textures.halves4, indices[0])
        h1 = load_vec4h(textures.halves4, indices[1])
        h2 = load_vec4h(textures.halves4, indices[2])
        h3 = load_vec4h(textures.halves4, indices[3])
        t.lower_left = half_texel(h0)
        t.lower_right = half_texel(h1)
        t.upper_left = half_texel(h2)
        t.upper_right = half_texel(h3)
    elif format == TEXELS_SHORT:
        s0 = load_vec4us(textures.shorts4, indices[0])
        s1 = load_vec4us(textures.shorts4, indices[1])
        s2 = load_vec4us(textures.shorts4, indices[2])
        s3 = load_vec4us(textures.shorts4, indices[3])
        t.lower_left = short_texel(s0)
        t.lower_right = short_texel(s1)
        t.upper_left = short_texel(s2)
        t.upper_right = short_texel(s3)
    else:
        t.lower_left = load_vec4(textures.floats4, indices[0])
        t.lower_right = load_vec4(textures.floats4, indices[1])
        t.upper_left = load_vec4(textures.floats4, indices[2])
        t.upper_right = load_vec4(textures.floats4, indices[3])
    return t


@wp.func
def associated(texel: wp.vec4, alpha: int) -> wp.vec4:
    """Return a texel, its colour multiplied by its alpha unless the two are unrelated."""
    if alpha == ALPHA_STRAIGHT:
        a = texel[3]
        return wp.vec4(texel[0] * a, texel[1] * a, texel[2] * a, a)
    return texel


@wp.func
def sample_closest(textures: Textures, info: TextureInfo, uv: wp.vec2, extension: int) -> wp.vec4:
    """Return the texel of level 0 that holds `uv` (wrapped)."""
    x = int(wp.floor(uv[0] * float(info.width)))
    y = int(wp.floor(uv[1] * float(info.height)))
    if extension == EXTENSION_CLIP:
        if x < 0 or x >= info.width or y < 0 or y >= info.height:
            return wp.vec4(0.0, 0.0, 0.0, 0.0)
    # uv = 1 belongs to the last texel.
    x = wp.clamp(x, 0, info.width - 1)
    y = wp.clamp(y, 0, info.height - 1)
    index = info.offset + (info.height - 1 - y) * info.width + x
    return associated(load_texels(textures, info.format, wp.vec4i(index, index, index, index)).lower_left, info.alpha)


@wp.func
def sample_level(
    textures: Textures, info: TextureInfo, offset: int, width: int, height: int, uv: wp.vec2, extension: int
) -> wp.vec4:
    """Return the bilinear mix of the four texels around `uv` (wrapped) in the level at `offset`."""
    x = uv[0] * float(width) - 0.5
    y = uv[1] * float(height) - 0.5
    x_floor = wp.floor(x)
    y_floor = wp.floor(y)
    x0 = int(x_floor)
    y0 = int(y_floor)
    right = x - x_floor
    top = y - y_floor
    left = 1.0 - right
    bottom = 1.0 - top
    if extension == EXTENSION_CLIP:
        # Texels outside are transparent black, so that the border fades over one texel.
        if x0 < 0 or x0 >= width:
            left = 0.0
        if x0 < -1 or x0 + 1 >= width:
            right = 0.0
        if y0 < 0 or y0 >= height:
            bottom = 0.0
        if y0 < -1 or y0 + 1 >= height:
            top = 0.0
    column0 = wrap_index(x0, width, extension)
    column1 = wrap_index(x0 + 1, width, extension)
    row0 = offset + (height - 1 - wrap_index(y0, height, extension)) * width
    row1 = offset + (height - 1 - wrap_index(y0 + 1, height, extension)) * width
    texels = load_texels(
        textures, info.format, wp.vec4i(row0 + column0, row0 + column1, row1 + column0, row1 + column1))
    lower = left * associated(texels.lower_left, info.alpha)
    lower += right * associated(texels.lower_right, info.alpha)
    upper = left * associated(texels.upper_left, info.alpha)
    upper += right * associated(texels.upper_right, info.alpha)
    return bottom * lower + top * upper


@wp.func
def sample_filtered(textures: Textures, info: TextureInfo, uv: wp.vec2, width: float, extension: int) -> wp.vec4:
    """Return the bilinear mix of the four texels around `uv` in the mip level whose texels are nearest to `width`.

    In one level, not in two: texels are far smaller than pixels (tracing.FOOTPRINT_SCALE), so that nobody sees where
    levels change, and what look-ups wait for is memory.
    """
    detail = 0.0
    if width > 0.0:
        texels = width * float(wp.max(info.width, info.height))
        detail = wp.min(wp.log2(wp.max(texels, 1.0)), float(info.levels - 1))
    offset = int(info.offset)
    level_width = int(info.width)
    level_height = int(info.height)
    level = int(detail + 0.5)
    for _i in range(level):
        offset += level_width * level_height
        level_width = wp.max(level_width // 2, 1)
        level_height = wp.max(level_height // 2, 1)
    return sample_level(textures, info, offset, level_width, level_height, uv, extension)


@wp.func
def sample_texture(
    textures: Textures, texture: int, uv: wp.vec2, width: float, extension: int, interpolation: int
) -> wp.vec4:
    """Look up an image.

    Args:
        textures: All images.
        texture: Which one; outside the table (-1) or removed it is the magenta of a missing image.
        uv: Texture coordinates, (0, 0) lower left; not finite: transparent black.
        width: Footprint in uv units, along the image's longer side; 0 or less reads level 0.
        extension: EXTENSION_*
        interpolation: INTERPOLATION_* (cubic is drawn as linear; closest reads level 0 only), with
            SAMPLE_ASSOCIATED added for colour multiplied by alpha.

    Returns:
        Scene-linear RGB, not multiplied by alpha unless SAMPLE_ASSOCIATED asks for it, and alpha.
    """
    if texture < 0 or texture >= textures.infos.shape[0]:
        return wp.vec4(1.0, 0.0, 1.0, 1.0)
    if not (wp.isfinite(uv[0]) and wp.isfinite(uv[1])):
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    info = load_texture_info(textures.infos, texture)
    if info.levels < 1:
        return wp.vec4(1.0, 0.0, 1.0, 1.0)
    wrapped = wp.vec2(wrap_coordinate(uv[0], extension), wrap_coordinate(uv[1], extension))
    result = wp.vec4()
    if (interpolation & 3) == INTERPOLATION_CLOSEST:
        result = sample_closest(textures, info, wrapped, extension)
    else:
        result = sample_filtered(textures, info, wrapped, width, extension)
    a = result[3]
    scale = 1.0
    if info.alpha != ALPHA_UNRELATED and (interpolation & SAMPLE_ASSOCIATED) == 0 and a != 0.0:
        scale = 1.0 / a
    r = result[0] * scale
    g = result[1] * scale
    b = result[2] * scale
    if info.srgb != 0:
        r = srgb_to_linear(r)
        g = srgb_to_linear(g)
        b = srgb_to_linear(b)
    return wp.vec4(r, g, b, a)
