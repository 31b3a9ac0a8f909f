# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that write what rays decide by themselves: the values of masks' images in a form that takes one load a hit.

wide_bvh.py says what it looks like and reads it. A word of an image has the four texels that a bilinear look-up between
them blends, a byte each, which is exact for images of 8 bits.
"""

from __future__ import annotations

import warp as wp

from .opacity_pieces import CHANNEL_LUMINANCE, AlphaMask, texel_value, wrapped
from .types import Scene, TextureInfo
from .wide_bvh import IMAGE_BORDER
from .wide_loads import load_texture_info

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.func
def stored_value(scene: Scene, mask: AlphaMask, info: TextureInfo, x: int, y: int) -> wp.uint32:
    """Return what is filtered of a texel as a byte, rows from the bottom; 0 where nothing is."""
    column = wrapped(x, info.width, mask.extension)
    row = wrapped(y, info.height, mask.extension)
    if column < 0 or row < 0:
        return wp.uint32(0)
    index = info.offset + (info.height - 1 - row) * info.width + column
    texel = texel_value(scene.textures, info, mask, index)
    value = texel[wp.min(mask.channel, 2)]
    if mask.channel == CHANNEL_LUMINANCE:
        value = wp.dot(texel, scene.luminance)
    return wp.uint32(wp.clamp(value, 0.0, 1.0) * 255.0 + 0.5)


@wp.kernel
def fill_answers(
    # In:
    first: int,
    scene: Scene,
    masks: wp.array[AlphaMask],
    row: int,
    offset: int,
    # Out:
    words_out: wp.array[wp.uint32],
):
    """Write a word of the image of mask `row`, which begins at word `offset`."""
    word = first + wp.tid()
    mask = masks[row]
    info = load_texture_info(scene.textures.infos, mask.texture)
    pitch = info.width + 2 * IMAGE_BORDER - 1
    x = word % pitch - IMAGE_BORDER
    y = word // pitch - IMAGE_BORDER
    value = stored_value(scene, mask, info, x, y)
    value = value | (stored_value(scene, mask, info, x + 1, y) << wp.uint32(8))
    value = value | (stored_value(scene, mask, info, x, y + 1) << wp.uint32(16))
    words_out[offset + word] = value | (stored_value(scene, mask, info, x + 1, y + 1) << wp.uint32(24))
