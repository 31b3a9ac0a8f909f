# SPDX-License-Identifier: GPL-3.0-or-later
"""Image files as pixels, read through OpenImageIO. This is the one file that reads images.

Reading and alpha follow Cycles (util/image_metadata.cpp of Blender 5.2): files are read without OpenImageIO's own
multiplication by alpha.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import OpenImageIO as oiio

from .texels import expand_channels

__all__ = [
    "DATA_SPACES", "FilePixels", "ImageUnreadable", "can_read_bytes", "read_bytes", "read_file", "read_size",
    "read_type", "to_linear",
]

T = TypeVar("T")
DATA_SPACES = {"Non-Color", "Raw", "Generic Data"}
"""Colour spaces whose values are no colours"""
UNKNOWN_ALPHA = {"dds", "psd"}
"""File formats whose reader doesn't say that alpha is straight, which it is (Cycles has the same exception)"""
TYPES = {"uint8": "uint8", "int8": "uint8", "uint16": "uint16", "int16": "uint16", "half": "half"}


class ImageUnreadable(OSError):
    """A file is absent, empty, damaged or in no known format."""


@dataclass(frozen=True, eq=False)
class FilePixels:
    """What a file holds."""

    pixels: np.ndarray
    """[H, W, C] uint8, uint16, float16 or float32, top row first"""
    has_alpha: bool
    straight: bool
    """Whether colours are stored without being multiplied by alpha"""
    cmyk: bool = False
    """Whether the file holds CMYK, converted to RGB without a profile"""


def _open(path: str) -> oiio.ImageInput:
    """Open a file, leaving straight alpha straight; raise ImageUnreadable."""
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(path, config)
    if source is None:
        raise ImageUnreadable(" ".join(oiio.geterror().split()) or "unknown format")
    return source


def _is_straight(source: oiio.ImageInput) -> bool:
    """Tell whether a file's colours are stored without being multiplied by alpha."""
    spec, name = source.spec(), source.format_name()
    if spec.alpha_channel < 0:
        return False
    if name == "targa":
        return spec.get_int_attribute("targa:alpha_type", -1) != 4
    return name in UNKNOWN_ALPHA or spec.get_int_attribute("oiio:UnassociatedAlpha", 0) == 1


def _cmyk_to_rgb(pixels: np.ndarray) -> np.ndarray:
    """Convert [H, W, 4] CMYK to RGB as Cycles does: (1 - c) (1 - k)."""
    largest = np.float32(np.iinfo(pixels.dtype).max if pixels.dtype.kind != "f" else 1.0)
    ink = pixels.astype(np.float32) / largest
    rgb = (1.0 - ink[..., :3]) * (1.0 - ink[..., 3:]) * largest
    return (np.rint(rgb) if pixels.dtype.kind != "f" else rgb).astype(pixels.dtype)


def _type(spec: oiio.ImageSpec) -> str:
    """Return the type to read a file's pixels as."""
    return TYPES.get(str(spec.format), "float")


def read_file(path: str) -> FilePixels:
    """Read an image file's first picture as it is stored; raise ImageUnreadable."""
    source = _open(path)
    spec = source.spec()
    pixels = source.read_image(0, 0, 0, min(spec.nchannels, 4), _type(spec))
    if pixels is None or pixels.size == 0:
        raise ImageUnreadable(" ".join(source.geterror().split()) or "no pixels")
    pixels = pixels.reshape(spec.height, spec.width, -1)
    cmyk = source.format_name() == "jpeg" and pixels.shape[2] == 4
    if cmyk:
        pixels = _cmyk_to_rgb(pixels)
    elif pixels.shape[2] == 2 and spec.alpha_channel != 1:
        pixels = expand_channels(pixels, gray_alpha=False)[..., :3]
    has_alpha = not cmyk and 0 <= spec.alpha_channel < pixels.shape[2]
    return FilePixels(pixels, has_alpha, _is_straight(source), cmyk)


def read_type(path: str) -> tuple[int, int, str]:
    """Return a file's width and height [px] and the type that its pixels are read as; raise ImageUnreadable."""
    spec = _open(path).spec()
    return spec.width, spec.height, _type(spec)


def read_size(data: str | bytes) -> tuple[int, int] | None:
    """Return width and height of an image file [px], given by its path or held in memory; None: it can't be read."""
    try:
        if isinstance(data, bytes):
            return _with_file(data, read_size)
        spec = _open(data).spec()
    except (OSError, RuntimeError):
        return None
    return (spec.width, spec.height) if min(spec.width, spec.height) > 0 else None


def can_read_bytes() -> bool:
    """Tell whether this system lets files be read from memory (`read_bytes`)."""
    return hasattr(os, "memfd_create") and os.path.isdir("/proc/self/fd")


def read_bytes(data: bytes) -> FilePixels:
    """Read an image file that lies in memory, writing nothing to disk; raise ImageUnreadable."""
    return _with_file(data, read_file)


def _with_file(data: bytes, use: Callable[[str], T]) -> T:
    """Return what is read of a file that lies in memory.

    OpenImageIO's Python binding has no reader for memory, but it reads an anonymous file of the kernel's (Linux).
    """
    assert can_read_bytes(), "ask can_read_bytes() first"
    handle = os.memfd_create("image", os.MFD_CLOEXEC)
    try:
        with open(handle, "wb", closefd=False) as file:
            file.write(data)
        return use(f"/proc/self/fd/{handle}")
    finally:
        os.close(handle)


def to_linear(picture: FilePixels, source_space: str, linear_space: str, config_path: str) -> np.ndarray | None:
    """Convert pixels from a named colour space of an OpenColorIO config to a linear one.

    Returns:
        float32 [H, W, 4], or None where the config lacks one of the spaces. Alpha stays as stored (straight or not).
    """
    rgba = expand_channels(picture.pixels)
    scale = 1.0 if rgba.dtype.kind == "f" else 1.0 / np.iinfo(rgba.dtype).max
    buffer = oiio.ImageBuf(np.ascontiguousarray(rgba.astype(np.float32) * np.float32(scale)))
    associated = picture.has_alpha and not picture.straight
    done = oiio.ImageBufAlgo.colorconvert(
        buffer, buffer, source_space, linear_space, unpremult=associated, colorconfig=config_path)
    if not done or buffer.has_error:
        buffer.geterror()
        return None
    return buffer.get_pixels(oiio.FLOAT).reshape(rgba.shape)
