# SPDX-License-Identifier: GPL-3.0-or-later
"""Which masks' images rays look up by themselves, and where what they read lies: see kernels/wide_bvh.py.

Images of 8 bits alone, of which a component is read that needs no other one: alpha, or a colour that alpha has no part
in. What else there is stays with materials' programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..kernels.opacity_pieces import CHANNEL_LUMINANCE
from ..kernels.texture import ALPHA_UNRELATED, EXTENSION_MIRROR, TEXELS_BYTE
from ..kernels.wide_bvh import ANSWER_STEPS, ANSWER_WORDS, IMAGE_BORDER
from .alpha_masks import MaskedBy

__all__ = ["Answers", "plan_answers"]

IMAGE_WORDS_MAX = 1 << 25
"""Room for all images, 128 MiB; the ones that have none left are read by programs"""


@dataclass
class Answers:
    """What rays read, and where it lies."""

    words: np.ndarray
    """uint32, all of it but for the images"""
    places: list[int]
    """Word where the answers of each mask begin, -1 for those that have none"""
    images: list[tuple[int, int, int]]
    """Images to be written: a mask that reads it, its first word, its words"""


def plan_answers(masks: Sequence[tuple[MaskedBy, int]], infos: np.ndarray, offset: int) -> Answers:
    """Plan what rays read.

    Args:
        masks: Each with its texture, -1 for none.
        infos: Of all textures, structured as kernels' TextureInfo.
        offset: Word where it begins, a multiple of 4.
    """
    places, images, begun, parts, end = [-1] * len(masks), [], {}, [], offset
    room = IMAGE_WORDS_MAX
    for i, (mask, texture) in enumerate(masks):
        info = infos[texture] if 0 <= texture < len(infos) else None
        if info is None or not _is_readable(mask, info):
            continue
        width, height = int(info["width"]), int(info["height"])
        more = 2 * int(IMAGE_BORDER) - 1
        count = (width + more) * (height + more)
        key = texture, mask.extension, mask.channel
        if key not in begun:
            if count > room:
                continue
            room -= count
            padded = -(-count // 4) * 4
            begun[key] = end
            images.append((i, end, count))
            parts.append(np.zeros(padded, np.uint32))
            end += padded
        places[i] = end
        header = np.zeros(int(ANSWER_WORDS), np.uint32)
        header[:4] = width, height, mask.extension, begun[key]
        header[4:5 + int(ANSWER_STEPS)] = _answers(mask, bool(info["srgb"])).view(np.uint32)
        parts.append(header)
        end += len(header)
    return Answers(np.concatenate([np.zeros(0, np.uint32), *parts]), places, images)


def _is_readable(mask: MaskedBy, info: np.void) -> bool:
    """Return whether bytes of one component tell how much light passes."""
    if mask.passing is None or mask.closest or mask.extension == EXTENSION_MIRROR:
        return False
    if info["levels"] < 1 or info["format"] != TEXELS_BYTE:
        return False
    return mask.channel == 3 or (
        info["alpha"] == ALPHA_UNRELATED and not (mask.channel == CHANNEL_LUMINANCE and info["srgb"]))


def _answers(mask: MaskedBy, srgb: bool) -> np.ndarray:
    """Return what share of light passes, float32 [ANSWER_STEPS + 1], by the value as stored."""
    known = np.linspace(0.0, 1.0, len(mask.passing))
    value = np.linspace(0.0, 1.0, int(ANSWER_STEPS) + 1)
    if srgb and mask.channel != 3:
        value = np.where(value < 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.interp(value, known, mask.passing).astype(np.float32)
