# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of bytes widened and halved by kernels (kernels/mip_levels.py); Python's lock is free meanwhile."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import mip_levels as kernels
from .device import host_array, is_loaded, launch

__all__ = ["can_halve", "can_widen", "halve", "widen"]

FEWEST = 1 << 10
"""Texels below which NumPy is as fast"""


def can_halve(rgba: np.ndarray) -> bool:
    """Tell whether `halve` takes [H, W, 4] texels, is worth its launch, and need not be built first."""
    height, width = rgba.shape[:2]
    return (rgba.dtype == np.uint8 and height % 2 == 0 and width % 2 == 0 and height * width >= FEWEST
            and rgba.flags.c_contiguous and is_loaded(kernels.build_levels, "cpu"))


def can_widen(pixels: np.ndarray) -> bool:
    """Tell whether `widen` takes [H, W, C] pixels, is worth its launch, and need not be built first."""
    return (pixels.dtype == np.uint8 and pixels.shape[2] == 3 and pixels.size >= 3 * FEWEST
            and pixels.flags.c_contiguous and is_loaded(kernels.widen_bytes, "cpu"))


def widen(pixels: np.ndarray) -> np.ndarray:
    """Return pixels, uint8 [H, W, 3], with an alpha of 1: [H, W, 4]; see `can_widen`."""
    texels = np.empty((*pixels.shape[:2], 4), np.uint8)
    launch(kernels.widen_bytes, pixels.size // 3, [host_array(pixels.reshape(-1, 3), wp.vec3ub)],
           [host_array(texels.reshape(-1, 4), wp.vec4ub)], "cpu")
    return texels


def halve(
    rgba: np.ndarray, srgb: bool, decode: np.ndarray, encode: np.ndarray,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return an image's levels, until a side is odd: the last in linear light, uint16, and all as texels, uint8.

    Args:
        rgba: Level 0, uint8 [H, W, 4]; see `can_halve`.
        srgb: Whether texels are encoded, but for alpha.
        decode: uint16 [256], linear by encoded.
        encode: uint8 [65536], encoded by linear.
    """
    shapes = [rgba.shape[:2]]
    while shapes[-1][0] % 2 == 0 and shapes[-1][1] % 2 == 0:
        shapes.append((shapes[-1][0] // 2, shapes[-1][1] // 2))
    ends = np.cumsum([height * width for height, width in shapes[1:]]).tolist()
    linear, texels = np.empty((ends[-1], 4), np.uint16), np.empty((ends[-1], 4), np.uint8)
    tables = [host_array(decode, wp.uint16), host_array(encode, wp.uint8)]
    launch(kernels.build_levels, 1, [
        rgba.shape[1], rgba.shape[0], len(ends), int(srgb), *tables, host_array(rgba.reshape(-1, 4), wp.vec4ub)],
        [host_array(linear, wp.vec4us), host_array(texels, wp.vec4ub)], "cpu")
    starts = [0, *ends[:-1]]
    levels = [texels[start:end].reshape(*shape, 4) for start, end, shape in zip(starts, ends, shapes[1:], strict=True)]
    return linear[starts[-1]:].reshape(*shapes[-1], 4), levels
