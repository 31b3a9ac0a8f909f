# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the passes of files that Blender has written."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio


def read_passes(path: Path, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Return passes of color, float32 [h, w, 3] each, of a file with any number of parts."""
    channels, part = {}, 0
    file = oiio.ImageInput.open(str(path))
    while file.seek_subimage(part, 0):
        found = file.spec().channelnames
        pixels = file.read_image(part, 0, 0, len(found), oiio.FLOAT)
        channels |= {name: pixels[..., i] for i, name in enumerate(found)}
        part += 1
    return {name: np.stack([channels[f"ViewLayer.{name}.{c}"] for c in "RGB"], -1) for name in names}
