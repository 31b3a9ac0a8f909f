# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a part of a triangle from the texels that may be looked up in it. Functions only.

It is clear (solid) where all texels that bilinear filtering there can touch have values for which the material's
program lets all (no) light pass; engine/alpha_masks.py finds which those are. Textures count by their finest level, as
in Cycles, which has no others.
"""

from __future__ import annotations

import warp as wp

from .texture import (
    ALPHA_UNRELATED,
    EXTENSION_CLIP,
    EXTENSION_MIRROR,
    EXTENSION_REPEAT,
    TEXELS_BYTE,
    TEXELS_HALF,
    TEXELS_SHORT,
    associated,
    byte_texel,
    half_texel,
    short_texel,
    srgb_to_linear,
)
from .types import Scene, TextureInfo, Textures
from .wide_bvh import OPACITY_CLEAR, OPACITY_SOLID, OPACITY_UNKNOWN

# More texels than these in a part aren't looked at: it stays unknown.
MAX_TEXELS = wp.constant(2048)
# Rounding of coordinates: in texels, and of their magnitude. Beyond the limit it would be a texel.
ROUNDING_TEXELS = wp.constant(0.02)
ROUNDING = wp.constant(1.0e-6)
FAR_TEXELS = wp.constant(5.0e5)
# Rounding of filtered values.
VALUE_ROUNDING = wp.constant(1.0e-5)

# AlphaMask.channel beside the components 0 to 3 of a look-up.
CHANNEL_LUMINANCE = wp.constant(4)


@wp.struct
class AlphaMask:
    """How transparent a material is as a function of one value that it reads from an image."""

    texture: int
    """-1: none, the value is 0"""
    uv_map: int
    """Of the mesh; -1: (0, 0) everywhere"""
    extension: int
    """EXTENSION_* in texture.py"""
    associate: int
    """1: colour is multiplied by alpha"""
    channel: int
    u: wp.vec3
    """The look-up's u is this times (u, v, 1)"""
    v: wp.vec3
    clear: wp.vec2
    """Range of the value in which all light passes; empty: the first is the larger"""
    solid: wp.vec2
    """Range in which none does"""
    passing: float
    """What share passes everywhere; -1: that depends on the value, or is not known"""
    answers: int
    """Word where the answers begin by which rays decide it themselves (opacity_answers.py); -1: none"""


@wp.struct
class Piece:
    """A triangle or a part of one in the image: vertices in texels, texel centres at whole numbers."""

    a: wp.vec2
    b: wp.vec2
    c: wp.vec2


@wp.func
def texel_place(scene: Scene, mask: AlphaMask, info: TextureInfo, instance: int, triangle: int, corner: int) -> wp.vec2:
    """Return where a vertex lies in the image."""
    u = wp.vec3(0.0, 0.0, 1.0)
    row = scene.geometry.instances[instance]
    if mask.uv_map >= 0:
        base = scene.geometry.uv_offsets[row.mesh, mask.uv_map]
        if base >= 0:
            uv = scene.geometry.uvs[base + 3 * (triangle - row.triangle_offset) + corner]
            u = wp.vec3(uv[0], uv[1], 1.0)
    return wp.vec2(
        wp.dot(mask.u, u) * float(info.width) - 0.5, wp.dot(mask.v, u) * float(info.height) - 0.5)


@wp.func
def triangle_piece(scene: Scene, mask: AlphaMask, info: TextureInfo, instance: int, triangle: int) -> Piece:
    """Return a whole triangle in its mask's image."""
    piece = Piece()
    piece.a = texel_place(scene, mask, info, instance, triangle, 0)
    piece.b = texel_place(scene, mask, info, instance, triangle, 1)
    piece.c = texel_place(scene, mask, info, instance, triangle, 2)
    return piece


@wp.func
def is_near(piece: Piece) -> bool:
    """Return whether coordinates are finite and not so large that their rounding would be a texel."""
    low = wp.min(piece.a, wp.min(piece.b, piece.c))
    high = wp.max(piece.a, wp.max(piece.b, piece.c))
    reach = wp.max(wp.max(wp.abs(low[0]), wp.abs(low[1])), wp.max(wp.abs(high[0]), wp.abs(high[1])))
    total = piece.a + piece.b + piece.c
    return wp.isfinite(total[0]) and wp.isfinite(total[1]) and reach <= FAR_TEXELS


@wp.func
def part_of(piece: Piece, digit: int) -> Piece:
    """Return one of the four triangles that halved edges make; the middle one's vertices face the whole's."""
    ab = 0.5 * (piece.a + piece.b)
    bc = 0.5 * (piece.b + piece.c)
    ca = 0.5 * (piece.c + piece.a)
    part = Piece()
    part.a = wp.where(digit == 0, piece.a, wp.where(digit == 1, ab, wp.where(digit == 2, ca, bc)))
    part.b = wp.where(digit == 0, ab, wp.where(digit == 1, piece.b, wp.where(digit == 2, bc, ca)))
    part.c = wp.where(digit == 0, ca, wp.where(digit == 1, bc, wp.where(digit == 2, piece.c, ab)))
    return part


@wp.func
def longest_edge(piece: Piece) -> float:
    """Return the length of the longest edge [texel]."""
    return wp.max(
        wp.length(piece.b - piece.a), wp.max(wp.length(piece.c - piece.b), wp.length(piece.a - piece.c)))


@wp.func
def covered_texels(piece: Piece) -> float:
    """Return the area [texel]."""
    p = piece.b - piece.a
    q = piece.c - piece.a
    return 0.5 * wp.abs(p[0] * q[1] - p[1] * q[0])


@wp.func
def wrapped(i: int, size: int, extension: int) -> int:
    """Return the texel that stands for number i of a row, which goes on forever; -1 where nothing does."""
    if i >= 0 and i < size:
        return i
    if extension == EXTENSION_REPEAT:
        return ((i % size) + size) % size
    if extension == EXTENSION_MIRROR:
        j = ((i % (2 * size)) + 2 * size) % (2 * size)
        return wp.min(j, 2 * size - 1 - j)
    return wp.where(extension == EXTENSION_CLIP, -1, wp.clamp(i, 0, size - 1))


@wp.func
def load_texel(textures: Textures, format: int, index: int) -> wp.vec4:
    """Return one texel as stored, integers as 0..1."""
    if format == TEXELS_BYTE:
        return byte_texel(textures.bytes4[index])
    if format == TEXELS_HALF:
        return half_texel(textures.halves4[index])
    if format == TEXELS_SHORT:
        return short_texel(textures.shorts4[index])
    return textures.floats4[index]


@wp.func
def texel_value(textures: Textures, info: TextureInfo, mask: AlphaMask, index: int) -> wp.vec3:
    """Return what texture.sample_texture filters, for a texel alone: colour or alpha; index -1 is none."""
    if index < 0:
        return wp.vec3(0.0, 0.0, 0.0)
    texel = load_texel(textures, info.format, index)
    if mask.channel == 3:
        return wp.vec3(texel[3], texel[3], texel[3])
    texel = associated(texel, info.alpha)
    color = wp.vec3(texel[0], texel[1], texel[2])
    if info.alpha != ALPHA_UNRELATED and mask.associate == 0 and texel[3] != 0.0:
        color = color / texel[3]
    return color


@wp.func
def mask_value(info: TextureInfo, mask: AlphaMask, luminance: wp.vec3, filtered: wp.vec3) -> float:
    """Return what the program reads of a filtered colour: grows with each of its components."""
    if mask.channel == 3:
        return filtered[0]
    color = filtered
    if info.srgb != 0:
        color = wp.vec3(srgb_to_linear(color[0]), srgb_to_linear(color[1]), srgb_to_linear(color[2]))
    if mask.channel == CHANNEL_LUMINANCE:
        return wp.dot(color, luminance)
    return color[mask.channel]


@wp.func
def per_rise(p: wp.vec2, q: wp.vec2) -> float:
    """Return one over an edge's rise; 0 for one that has none, all of which slab_range then takes."""
    rise = q[1] - p[1]
    return wp.where(wp.abs(rise) > 1.0e-12, 1.0 / rise, 0.0)


@wp.func
def slab_range(p: wp.vec2, q: wp.vec2, scale: float, low: float, high: float, x_range: wp.vec2) -> wp.vec2:
    """Widen a range by the x of an edge's points with y from low to high; `scale` is from per_rise."""
    if wp.max(p[1], q[1]) < low or wp.min(p[1], q[1]) > high:
        return x_range
    s = wp.clamp((low - p[1]) * scale, 0.0, 1.0)
    t = wp.where(scale == 0.0, 1.0, wp.clamp((high - p[1]) * scale, 0.0, 1.0))
    x0 = p[0] + (q[0] - p[0]) * s
    x1 = p[0] + (q[0] - p[0]) * t
    return wp.vec2(wp.min(x_range[0], wp.min(x0, x1)), wp.max(x_range[1], wp.max(x0, x1)))


@wp.func
def state_of(value: wp.vec2, mask: AlphaMask) -> int:
    """Return what a range of values means."""
    if value[0] >= mask.clear[0] - VALUE_ROUNDING and value[1] <= mask.clear[1] + VALUE_ROUNDING:
        return OPACITY_CLEAR
    if value[0] >= mask.solid[0] - VALUE_ROUNDING and value[1] <= mask.solid[1] + VALUE_ROUNDING:
        return OPACITY_SOLID
    return OPACITY_UNKNOWN


@wp.func
def piece_state(textures: Textures, info: TextureInfo, mask: AlphaMask, luminance: wp.vec3, piece: Piece) -> int:
    """Return what is known of a piece from the texels that a bilinear look-up anywhere in it can touch."""
    if not is_near(piece):
        return OPACITY_UNKNOWN
    low = wp.min(piece.a, wp.min(piece.b, piece.c))
    high = wp.max(piece.a, wp.max(piece.b, piece.c))
    reach = wp.max(wp.max(wp.abs(low[0]), wp.abs(low[1])), wp.max(wp.abs(high[0]), wp.abs(high[1])))
    if (high[0] - low[0] + 3.0) * (high[1] - low[1] + 3.0) > float(MAX_TEXELS):
        return OPACITY_UNKNOWN
    margin = ROUNDING_TEXELS + ROUNDING * reach
    scale_ab = per_rise(piece.a, piece.b)
    scale_bc = per_rise(piece.b, piece.c)
    scale_ca = per_rise(piece.c, piece.a)
    state = int(OPACITY_UNKNOWN)
    darkest = wp.vec3(3.0e38, 3.0e38, 3.0e38)
    brightest = -darkest
    y = int(wp.floor(low[1] - margin))
    last = int(wp.floor(high[1] + margin)) + 1
    while y <= last:
        # A row counts for all points less than a texel above or below.
        bottom = float(y) - 1.0 - margin
        top = float(y) + 1.0 + margin
        x_range = slab_range(piece.a, piece.b, scale_ab, bottom, top, wp.vec2(3.0e38, -3.0e38))
        x_range = slab_range(piece.b, piece.c, scale_bc, bottom, top, x_range)
        x_range = slab_range(piece.c, piece.a, scale_ca, bottom, top, x_range)
        if x_range[0] <= x_range[1]:
            row = wrapped(y, info.height, mask.extension)
            x = int(wp.floor(x_range[0] - margin))
            last_x = int(wp.floor(x_range[1] + margin)) + 1
            while x <= last_x:
                column = wrapped(x, info.width, mask.extension)
                index = info.offset + (info.height - 1 - row) * info.width + column
                value = texel_value(textures, info, mask, wp.where(row < 0 or column < 0, -1, index))
                darkest = wp.min(darkest, value)
                brightest = wp.max(brightest, value)
                x = x + 1
            state = state_of(wp.vec2(
                mask_value(info, mask, luminance, darkest), mask_value(info, mask, luminance, brightest)), mask)
            if state == OPACITY_UNKNOWN:
                return OPACITY_UNKNOWN
        y = y + 1
    return state
