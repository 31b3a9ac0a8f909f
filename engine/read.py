# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the colours of OpenEXR files: one part's red, green and blue, as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from .errors import BurnishError

__all__ = ["read_exr"]


def read_exr(path: Path, part: str = "") -> np.ndarray:
    """Return the colours of an OpenEXR file: float32 [h, w, 3], bottom row first, scene-linear.

    Args:
        path: The file.
        part: End of the name of the wanted pass (`Noisy Image`); empty: the file must hold a plain R, G, B picture.

    Raises:
        BurnishError: It can't be read or has no such picture.
    """
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise BurnishError(f"'{path}' can't be read: {oiio.geterror() or 'it is no picture'}")
    try:
        index = 0
        while source.seek_subimage(index, 0):
            spec = source.spec()
            for first, name in enumerate(spec.channelnames[:-2]):
                prefix, _, letter = name.rpartition(".")
                if letter != "R" or not (prefix.endswith(part) if part else not prefix):
                    continue
                start = name[:-1]
                if spec.channelnames[first:first + 3] != (start + "R", start + "G", start + "B"):
                    continue
                pixels = source.read_image(index, 0, first, first + 3, oiio.FLOAT)
                if pixels is None:
                    raise BurnishError(f"'{path}' can't be read: {source.geterror()}")
                shaped = np.asarray(pixels, np.float32).reshape(spec.height, spec.width, 3)
                return np.ascontiguousarray(shaped[::-1])
            index += 1
    finally:
        source.close()
    what = f"part '{part}'" if part else "plain R, G, B picture; save it as a single-layer OpenEXR file"
    raise BurnishError(f"'{path}' has no {what}")
