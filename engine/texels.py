# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels made ready for the device: four channels, a storage format, and a chain of mip levels.

Formats. Level 0 holds the image's own values, bit for bit: 8- and 16-bit integers and half floats stay what they are.
32-bit floats become halves where that costs nothing visible (a colour whose values fit), and stay floats where values
exceed the half range or are data (normals, heights) whose precision matters.

Levels. Each texel of a level is the area average of the texels it covers in the level above, also for odd sizes.
Colours are averaged in linear light, weighted by alpha, and then encoded as level 0 is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from ..kernels.texture import (
    ALPHA_ASSOCIATED,
    ALPHA_STRAIGHT,
    ALPHA_UNRELATED,
    TEXELS_BYTE,
    TEXELS_FLOAT,
    TEXELS_HALF,
    TEXELS_SHORT,
)
from .mip_levels import can_halve, can_widen, halve, widen

__all__ = [
    "TEXEL_BYTES", "Texels", "average", "clean", "expand_channels", "linear_to_srgb", "make_texels", "srgb_to_linear",
]

HALF_MAX = 65504.0
CLEAR = np.float32(1e-4)
"""Least weight of a straight colour: what alpha 0 hides must not bleed, but where all is clear colour is kept"""
BAND = 128
"""Rows decoded at a time; even"""
TEXEL_BYTES = {TEXELS_BYTE: 4, TEXELS_SHORT: 8, TEXELS_HALF: 8, TEXELS_FLOAT: 16}
"""Bytes of one texel by format"""
FORMATS = {"uint8": TEXELS_BYTE, "uint16": TEXELS_SHORT, "float16": TEXELS_HALF, "float32": TEXELS_FLOAT}


@dataclass(kw_only=True, eq=False)
class Texels:
    """One image ready for upload."""

    levels: list[np.ndarray]
    """[H, W, 4] each, top row first, C-contiguous; all of one type"""
    srgb: bool
    """Decode the sRGB transfer function after filtering"""
    alpha: int
    """ALPHA_* of kernels/texture.py"""
    levels_max: int = 0
    """How many levels may be looked up, 0 for all"""
    cleaned: int = 0
    """Texels that held NaN or infinity and were set to 0"""

    @property
    def format(self) -> int:
        """TEXELS_* of kernels/texture.py."""
        return FORMATS[self.levels[0].dtype.name]

    @property
    def count(self) -> int:
        """Texels of all levels."""
        return sum(level.shape[0] * level.shape[1] for level in self.levels)

    def forget(self, count: int) -> None:
        """Leave the `count` largest levels out."""
        self.levels = self.levels[count:]
        self.levels_max = max(self.levels_max - count, 1) if self.levels_max else 0


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Decode the sRGB transfer function (IEC 61966-2-1); values below 0 become 0."""
    values = np.maximum(values, 0.0)
    return np.where(values < 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """Encode with the sRGB transfer function; values below 0 become 0."""
    values = np.maximum(values, 0.0)
    return np.where(values < 0.0031308, values * 12.92, 1.055 * values ** (1.0 / 2.4) - 0.055)


@cache
def _decode_table() -> np.ndarray:
    """Return linear uint16 by sRGB uint8."""
    return np.rint(srgb_to_linear(np.arange(256) / 255.0) * 65535.0).astype(np.uint16)


@cache
def _encode_table() -> np.ndarray:
    """Return sRGB uint8 by linear uint16."""
    return np.rint(linear_to_srgb(np.arange(65536) / 65535.0) * 255.0).astype(np.uint8)


def expand_channels(pixels: np.ndarray, *, gray_alpha: bool = True) -> np.ndarray:
    """Return pixels [H, W, C] as [H, W, 4]: grey is repeated, absent alpha is 1, channels past the fourth are left out.

    Two channels are grey and alpha, or with `gray_alpha` False red and green.
    """
    height, width, channels = pixels.shape
    if channels == 4:
        return np.ascontiguousarray(pixels)
    if can_widen(pixels):
        return widen(pixels)
    rgba = np.empty((height, width, 4), pixels.dtype)
    rgba[..., 3] = 1 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
    if channels == 1 or (channels == 2 and gray_alpha):
        rgba[..., :3] = pixels[..., :1]
        if channels == 2:
            rgba[..., 3] = pixels[..., 1]
    elif channels == 2:
        rgba[..., :2] = pixels
        rgba[..., 2] = 0
    else:
        rgba[..., :min(channels, 4)] = pixels[..., :4]
    return rgba


LARGEST = np.float32(1e30)
"""Larger values are taken for this: sums of a few of them stay within float32"""


def clean(rgba: np.ndarray) -> tuple[np.ndarray, int]:
    """Set every texel with a channel that is not finite to 0, as Cycles does; return the result and how many were."""
    if rgba.dtype.kind != "f":
        return rgba, 0
    bad = ~np.isfinite(rgba).all(axis=2)
    count = int(np.count_nonzero(bad))
    if count:
        rgba = rgba.copy()
        rgba[bad] = 0
    if rgba.dtype == np.float32 and rgba.size and max(rgba.max(), -rgba.min()) > LARGEST:
        rgba = np.clip(rgba, -LARGEST, LARGEST)
    return rgba, count


def _blend_pairs(values: np.ndarray) -> np.ndarray:
    """Halve the first axis of float values by area; an odd length 2 m + 1 spreads each texel over at most two."""
    length = values.shape[0]
    if length == 1:
        return values
    half = length // 2
    if length % 2 == 0:
        return (values[0::2] + values[1::2]) * 0.5
    shape = (half,) + (1,) * (values.ndim - 1)
    i = np.arange(half, dtype=values.dtype).reshape(shape)
    return ((half - i) * values[0:-1:2] + half * values[1::2] + (i + 1) * values[2::2]) / length


def average(values: np.ndarray) -> np.ndarray:
    """Halve both sides of [H, W, 4] by area average, rounding sizes down (1 stays 1).

    uint16 values stay uint16, rounded; floats stay floats.
    """
    height, width = values.shape[:2]
    if values.dtype == np.uint16 and height % 2 == 0 and width % 2 == 0:
        total = np.add(values[0::2], values[1::2], dtype=np.uint32)
        total = total[:, 0::2] + total[:, 1::2]
        total += 2
        total >>= 2
        return total.astype(np.uint16)
    blended = _blend_pairs(values.astype(np.float32))
    blended = _blend_pairs(blended.swapaxes(0, 1)).swapaxes(0, 1)
    return np.rint(blended).astype(np.uint16) if values.dtype == np.uint16 else np.ascontiguousarray(blended)


def _decode(rgba: np.ndarray, srgb: bool, straight: bool) -> np.ndarray:
    """Return the linear values that levels are averaged in: uint16 for bytes where that is exact enough, or float32."""
    if rgba.dtype == np.uint8 and not straight:
        if not srgb:
            return rgba * np.uint16(257)
        values = _decode_table()[rgba]
        values[..., 3] = rgba[..., 3] * np.uint16(257)
        return values
    if rgba.dtype == np.uint8 and srgb:
        values = _decode_table().astype(np.float32)[rgba]
        values *= 1.0 / 65535.0
        values[..., 3] = rgba[..., 3] * np.float32(1.0 / 255.0)
    else:
        values = rgba.astype(np.float32)
        if rgba.dtype.kind != "f":
            values *= 1.0 / np.iinfo(rgba.dtype).max
        if srgb:
            values[..., :3] = srgb_to_linear(values[..., :3])
    if straight:
        values[..., :3] *= np.maximum(values[..., 3:], CLEAR)
    return values


def _encode(values: np.ndarray, dtype: np.dtype, srgb: bool, straight: bool) -> np.ndarray:
    """Undo `_decode`, rounding to `dtype`."""
    if straight:
        values = values.copy()
        values[..., :3] /= np.maximum(values[..., 3:], CLEAR)
    if dtype == np.uint8 and srgb:
        if values.dtype != np.uint16:
            values = np.rint(np.clip(values, 0.0, 1.0) * 65535.0).astype(np.uint16)
        texels = _encode_table()[values]
        texels[..., 3] = _narrow(values[..., 3])
        return texels
    if values.dtype == np.uint16:
        return _narrow(values)
    if srgb:
        values = np.concatenate([linear_to_srgb(values[..., :3]), values[..., 3:]], axis=2)
    if dtype.kind == "f":
        return values.astype(dtype)
    return np.rint(np.clip(values, 0.0, 1.0) * np.iinfo(dtype).max).astype(dtype)


def _narrow(values: np.ndarray) -> np.ndarray:
    """Round uint16 to uint8."""
    return ((values.astype(np.uint32) + 128) // 257).astype(np.uint8)


def _first_average(rgba: np.ndarray, srgb: bool, straight: bool) -> np.ndarray:
    """Return the linear values of level 1, in bands so that level 0 is never held decoded as a whole."""
    height = rgba.shape[0]
    if height % 2 or height <= BAND:
        return average(_decode(rgba, srgb, straight))
    bands = [average(_decode(rgba[y:y + BAND], srgb, straight)) for y in range(0, height, BAND)]
    return np.concatenate(bands)


def choose_type(rgba: np.ndarray, data: bool) -> np.ndarray:
    """Return float32 texels as halves where they are colours within the half range, everything else as it is."""
    if rgba.dtype != np.float32 or data or (rgba.size and float(np.abs(rgba).max()) > HALF_MAX):
        return rgba
    return rgba.astype(np.float16)


def make_texels(rgba: np.ndarray, *, srgb: bool, alpha: int, data: bool = False, halvings: int = 0) -> Texels:
    """Build an image's levels.

    Args:
        rgba: uint8, uint16, float16 or float32 [H, W, 4], top row first.
        srgb: Whether colours are sRGB-encoded.
        alpha: ALPHA_* of kernels/texture.py; opaque images become ALPHA_UNRELATED.
        data: Values are no colours: precision matters.
        halvings: Levels to leave out at the top (the image is reduced by 2**halvings).

    Returns:
        Levels down to 1 by 1, `levels[0]` being `rgba` where `halvings` is 0 and nothing had to be cleaned.
    """
    assert rgba.ndim == 3 and rgba.shape[2] == 4 and rgba.dtype.name in FORMATS, (rgba.shape, rgba.dtype)
    rgba, cleaned = clean(rgba)
    rgba = choose_type(rgba, data)
    opaque = 1 if rgba.dtype.kind == "f" else np.iinfo(rgba.dtype).max
    if alpha != ALPHA_UNRELATED and bool((rgba[..., 3] == opaque).all()):
        alpha = ALPHA_UNRELATED
    assert alpha in (ALPHA_UNRELATED, ALPHA_STRAIGHT, ALPHA_ASSOCIATED), alpha
    straight = alpha == ALPHA_STRAIGHT
    levels = [rgba] if halvings == 0 else []
    values, level = None, 0
    if not straight and can_halve(rgba):
        values, made = halve(rgba, srgb, _decode_table(), _encode_table())
        level = len(made)
        levels += made[max(halvings - 1, 0):]
    while max(rgba.shape[:2] if values is None else values.shape[:2]) > 1:
        values, level = _first_average(rgba, srgb, straight) if values is None else average(values), level + 1
        if level >= halvings:
            levels.append(_encode(values, rgba.dtype, srgb, straight))
    return Texels(levels=levels or [rgba], srgb=srgb, alpha=alpha, cleaned=cleaned)
