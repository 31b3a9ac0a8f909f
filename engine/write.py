# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes pictures to OpenEXR files: 32-bit floats, scene-linear, all passes as named channels of one part.

Owns the channel names. A file appears under its name only once it is complete.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from .errors import BurnishError

__all__ = ["LayerPixels", "PassPixels", "complete_file", "write_exr"]


@dataclass(frozen=True, eq=False)
class PassPixels:
    """One render pass."""

    name: str
    channels: str
    """A letter per channel: `RGBA`, `XYZ`, `Z`"""
    pixels: np.ndarray
    """float32 [h, w, c], bottom row first"""


@dataclass(frozen=True, eq=False)
class LayerPixels:
    """One view layer's passes; `Combined` is among them."""

    name: str
    passes: tuple[PassPixels, ...]

    @property
    def combined(self) -> np.ndarray:
        """The picture itself: float32 [h, w, 4], bottom row first, premultiplied."""
        return next(layer_pass.pixels for layer_pass in self.passes if layer_pass.name == "Combined")


@contextmanager
def complete_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, which gets its name when the block ends and is removed when it raises."""
    partial = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        partial.replace(path)
    except OSError as error:
        raise BurnishError(f"The picture can't be saved as '{path}': {error.strerror or error}.") from error
    finally:
        with suppress(OSError):
            partial.unlink()


def write_exr(path: Path, layers: Sequence[LayerPixels], attributes: Mapping[str, str | int | float]) -> None:
    """Write view layers to an OpenEXR file; raises BurnishError where that is impossible.

    The first layer's picture is R, G, B, A, so that any reader shows it; its other passes, and all passes of further
    layers, are `Layer.Pass.Channel` as in Blender's multi-layer files. `attributes` go into the header.
    """
    names: list[str] = []
    arrays: list[np.ndarray] = []
    for layer in layers:
        for layer_pass in layer.passes:
            plain = layer is layers[0] and layer_pass.name == "Combined"
            names += [c if plain else f"{layer.name}.{layer_pass.name}.{c}" for c in layer_pass.channels]
            arrays.append(layer_pass.pixels)
    pixels = np.ascontiguousarray(np.concatenate(arrays, axis=2)[::-1], np.float32)
    height, width, _ = pixels.shape
    spec = oiio.ImageSpec(width, height, len(names), oiio.FLOAT)
    spec.channelnames = names
    spec.attribute("compression", "zip")
    for key, value in attributes.items():
        spec.attribute(key, value)
    with complete_file(path) as partial:
        output = oiio.ImageOutput.create(str(partial))
        if output is None:
            raise BurnishError(f"The picture can't be saved as '{path}': {oiio.geterror()}.")
        written = output.open(str(partial), spec) and output.write_image(pixels)
        if not (output.close() and written):
            raise BurnishError(f"The picture can't be saved as '{path}': {output.geterror()}.")
