# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished viewport picture and how its colours are packed for upload; NumPy only.

Owns the 4-byte pixel format. It is RGB9E5 (three 9-bit mantissas under one exponent) whose exponent code skips the
values that would make the 32 bits, seen as a float, a NaN, an infinity or a denormal: a texture upload or a shader may
change those. The fragment shader in display.py is its only reader.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["HALF_MAX", "Picture", "display_pixels", "pack_colors", "unpack_colors"]

HALF_MAX = 65504.0
"""Largest finite half float; above it a half-float texture holds infinities and the viewport turns black."""

EXPONENT_MIN = -10
EXPONENT_COUNT = 28
MANTISSA_MAX = 511.0
COLOR_MAX = 131071.0
"""Largest colour that can be packed: just below 2**17, the largest exponent's limit."""

# 2**9 over 2**exponent, by exponent code: what turns a colour into a 9-bit mantissa.
MANTISSA_SCALES = np.exp2(9.0 - np.arange(EXPONENT_MIN, EXPONENT_MIN + EXPONENT_COUNT)).astype(np.float32)

# Stored exponents: 5 bits whose low 4 are the top bits of the float's exponent, never 0000 (a zero or denormal)
# and never 1111 (a NaN or infinity).
STORED_EXPONENTS = np.array([code + 1 if code < 14 else code + 3 for code in range(EXPONENT_COUNT)], np.uint32)


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture to draw; the arrays belong to it and never change."""

    serial: int
    """Rises with each picture of a viewport."""
    pixels: Any
    """float32, bottom row first: [h, w] packed by `pack_colors`, or [h, w, 4] premultiplied scene-linear RGBA; or an
    engine.display.DevicePicture, which has not left the GPU."""
    area: tuple[float, float, float, float]
    """left, bottom, right, top of the drawn rectangle, as fractions of the region."""
    samples: int
    divider: int
    """Screen pixels per rendered pixel, along a side."""

    @property
    def packed(self) -> bool:
        """Whether `pixels` holds packed opaque colours."""
        return isinstance(self.pixels, np.ndarray) and self.pixels.ndim == 2

    @property
    def on_device(self) -> bool:
        """Whether `pixels` are still on the GPU."""
        return not isinstance(self.pixels, np.ndarray)


def display_pixels(rgba: np.ndarray, transparent: bool) -> np.ndarray:
    """Return RGBA float32 [h, w, 4] as Picture.pixels: packed where it is opaque, else clamped to half floats."""
    if transparent:
        # fmax and fmin rather than clip: they also turn NaN into a number.
        return np.ascontiguousarray(np.fmin(np.fmax(rgba, np.float32(0.0)), np.float32(HALF_MAX)))
    return pack_colors(rgba)


def pack_colors(rgb: np.ndarray) -> np.ndarray:
    """Pack colours float32 [h, w, 3 or 4] into float32 [h, w]; negative and NaN become 0, large ones are clamped.

    The relative error of the largest channel is at most 1/512.
    """
    channels = [np.fmin(np.fmax(rgb[..., i], np.float32(0.0)), np.float32(COLOR_MAX)) for i in range(3)]
    largest = np.maximum(np.maximum(channels[0], channels[1]), channels[2])
    # The exponent of the smallest power of two above, from the float's own bits: exact, and quicker than frexp.
    exponent = (largest.view(np.uint32) >> np.uint32(23)).astype(np.int32) - 126
    code = np.clip(exponent - EXPONENT_MIN, 0, EXPONENT_COUNT - 1)
    scale = MANTISSA_SCALES[code]
    bits = STORED_EXPONENTS[code] << np.uint32(27)
    for i, channel in enumerate(channels):
        mantissa = np.minimum(channel * scale + np.float32(0.5), np.float32(MANTISSA_MAX)).astype(np.uint32)
        bits |= mantissa << np.uint32(9 * i)
    return bits.view(np.float32)


def unpack_colors(packed: np.ndarray) -> np.ndarray:
    """Return the colours float32 [h, w, 3] in what `pack_colors` made: what the fragment shader computes."""
    bits = np.ascontiguousarray(packed).view(np.uint32)
    stored = (bits >> np.uint32(27)).astype(np.int32)
    code = stored - np.where(stored > 16, 3, 1)
    scale = np.exp2((code + (EXPONENT_MIN - 9)).astype(np.float32))
    return np.stack([((bits >> np.uint32(9 * i)) & np.uint32(511)).astype(np.float32) * scale for i in range(3)], -1)
