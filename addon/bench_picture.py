# SPDX-License-Identifier: GPL-3.0-or-later
"""Side-by-side pictures of the benchmark, as labelled PNG files: reference, test, signed difference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import blf
import bpy
import imbuf
import numpy as np

from ..engine.image_error import box_filter, encode_srgb, signed_difference

__all__ = ["save_comparison", "save_strip"]

PANEL_WIDTH = 480
"""Pictures narrower than this are enlarged by whole factors [px]"""
BAR = 26
"""Height of the labels' bar [px]"""
TEXT_SIZE = 14.0
BAR_COLOR = 0.12
BOX = 4
FULL_SCALE, FULL_SCALE_BOX = 0.25, 0.1
"""Relative differences shown in full colour"""


def save_comparison(path: Path, reference: np.ndarray, test: np.ndarray, labels: Sequence[str],
                    exposure: float = 0.0) -> None:
    """Save reference, test and their signed differences (scene-linear [h, w, 3], bottom row first) side by side.

    The second difference is of the pictures after a box filter, with a finer scale: noise averages out there and what
    stays is wrong. `labels` are those of the two pictures; `exposure` in stops applies to them only.
    """
    factor = 2.0 ** exposure
    panels = [encode_srgb(np.nan_to_num(image) * factor) for image in (reference, test)]
    panels.append(signed_difference(reference, test, FULL_SCALE))
    coarse = signed_difference(*(box_filter(image, BOX) for image in (reference, test)), FULL_SCALE_BOX)
    panels.append(enlarge(coarse, BOX, reference.shape))
    texts = [f"difference, red brighter, blue darker by {100 * FULL_SCALE:g} %",
             f"the same after {BOX}x{BOX} box, {100 * FULL_SCALE_BOX:g} %"]
    save_strip(path, panels, [*labels, *texts])


def enlarge(image: np.ndarray, factor: int, shape: tuple[int, ...]) -> np.ndarray:
    """Return each pixel as a square of `factor` pixels, the last row and column repeated to reach `shape`."""
    image = np.repeat(np.repeat(image, factor, 0), factor, 1)
    return np.pad(image, ((0, shape[0] - image.shape[0]), (0, shape[1] - image.shape[1]), (0, 0)), "edge")


def save_strip(path: Path, panels: Sequence[np.ndarray], labels: Sequence[str]) -> None:
    """Save panels of one size (sRGB values 0..1, [h, w, 3], bottom row first) side by side under their labels."""
    scale = max(1, -(-PANEL_WIDTH // panels[0].shape[1]))
    enlarged = [np.repeat(np.repeat(panel, scale, 0), scale, 1) for panel in panels]
    strip = np.concatenate(enlarged, 1)
    bar = np.full((BAR, strip.shape[1], 3), BAR_COLOR, np.float32)
    save_png(path, np.concatenate([strip, bar], 0))
    width, height = enlarged[0].shape[1], strip.shape[0]
    write_labels(path, [(i * width + 8, height + 8, label) for i, label in enumerate(labels)])


def save_png(path: Path, pixels: np.ndarray) -> None:
    """Save sRGB values [h, w, 3], bottom row first, as they are."""
    height, width, _ = pixels.shape
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = pixels
    path.parent.mkdir(parents=True, exist_ok=True)
    image = bpy.data.images.new(path.stem, width, height, alpha=False)
    try:
        image.pixels.foreach_set(rgba.ravel())
        image.filepath_raw, image.file_format = str(path.resolve()), 'PNG'
        image.save()
    finally:
        bpy.data.images.remove(image)


def write_labels(path: Path, labels: Sequence[tuple[float, float, str]]) -> None:
    """Write texts into a PNG file, each at x, y [px] from the bottom left."""
    if not hasattr(blf, "bind_imbuf"):
        return  # Older Blenders can't write into pictures; the file's name says what it shows.
    buffer = imbuf.load(str(path.resolve()))
    font = 0  # Blender's own
    blf.size(font, TEXT_SIZE)
    blf.color(font, 0.92, 0.92, 0.92, 1.0)
    with blf.bind_imbuf(font, buffer):
        for x, y, text in labels:
            blf.position(font, x, y, 0.0)
            blf.draw_buffer(font, text)
    imbuf.write(buffer, filepath=str(path.resolve()))
    buffer.free()
