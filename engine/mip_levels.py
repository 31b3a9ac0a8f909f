# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of bytes widened and halved by kernels (kernels/mip_levels.py) on the calling thread, without Python's lock."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels import mip_levels as kernels
from .device import launch, start_warp

__all__ = ["can_halve", "can_widen", "halve", "widen"]

FEWEST = 1 << 10
"""Texels below which NumPy is as fast"""


def can_halve(values: np.ndarray) -> bool:
    """Tell whether `halve` takes [H, W, 4] values, and is worth its launch."""
    height, width = values.shape[:2]
    return (values.dtype in (np.uint8, np.uint16) and height % 2 == 0 and width % 2 == 0
            and height * width >= FEWEST and values.flags.c_contiguous)


def can_widen(pixels: np.ndarray) -> bool:
    """Tell whether `widen` takes [H, W, C] pixels, and is worth its launch."""
    return (pixels.dtype == np.uint8 and pixels.shape[2] == 3 and pixels.size >= 3 * FEWEST
            and pixels.flags.c_contiguous)


def widen(pixels: np.ndarray) -> np.ndarray:
    """Return pixels, uint8 [H, W, 3], with an alpha of 1: [H, W, 4]; see `can_widen`."""
    start_warp()
    texels = np.empty((*pixels.shape[:2], 4), np.uint8)
    launch(kernels.widen_bytes, pixels.size // 3, [_shared(pixels.reshape(-1, 3), wp.vec3ub)],
           [_shared(texels.reshape(-1, 4), wp.vec4ub)], "cpu")
    return texels


def halve(
    values: np.ndarray, srgb: bool, decode: np.ndarray, encode: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the next level in linear light, uint16, and as texels, uint8: [H / 2, W / 2, 4] each.

    Args:
        values: uint8 as stored, or uint16 in linear light; see `can_halve`.
        srgb: Whether texels are encoded, but for alpha.
        decode: uint16 [256], linear by encoded.
        encode: uint8 [65536], encoded by linear.
    """
    start_warp()
    height, width = values.shape[0] // 2, values.shape[1] // 2
    linear, texels = np.empty((height, width, 4), np.uint16), np.empty((height, width, 4), np.uint8)
    tables = [_shared(encode, wp.uint8)]
    kernel, kind = kernels.halve_linear, wp.vec4us
    if values.dtype == np.uint8:
        kernel, kind, tables = kernels.halve_bytes, wp.vec4ub, [_shared(decode, wp.uint16), *tables]
    launch(kernel, height * width, [2 * width, int(srgb), *tables, _shared(values.reshape(-1, 4), kind)],
           [_shared(linear.reshape(-1, 4), wp.vec4us), _shared(texels.reshape(-1, 4), wp.vec4ub)], "cpu")
    return linear, texels


def _shared(values: np.ndarray, dtype: type) -> wp.array:
    return wp.array(values, dtype=dtype, device="cpu", copy=False)
