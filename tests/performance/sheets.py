# SPDX-License-Identifier: GPL-3.0-or-later
"""Labelled pictures side by side as PNG files, maps of errors, and tables (Markdown, JSON), for measuring scripts."""

from __future__ import annotations

import importlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from burnish.engine.image_error import encode_srgb

BAR = 20
"""Height of a label's bar [px]"""
GAP = 4
NARROW = 240
"""Narrower pictures are enlarged by whole factors, so that labels fit [px]"""


def tone(image: np.ndarray, exposure: float = 0.0) -> np.ndarray:
    """Return sRGB values 0..1 of a scene-linear picture, `exposure` in stops."""
    return encode_srgb(np.nan_to_num(image[..., :3], nan=0.0, posinf=0.0, neginf=0.0) * 2.0**exposure)


def flip_map(reference: np.ndarray, test: np.ndarray) -> tuple[np.ndarray, float]:
    """Return NVIDIA's FLIP error as colours (dark: equal) and its mean, of scene-linear pictures."""
    evaluator = importlib.import_module("flip_evaluator")
    picture, mean, _ = evaluator.evaluate(tone(reference), tone(test), "LDR", inputsRGB=True)
    return np.asarray(picture, np.float32), float(mean)


def error_map(reference: np.ndarray, test: np.ndarray, gain: float = 4.0, exposure: float = 0.0) -> np.ndarray:
    """Return the difference of two scene-linear pictures as displayed, enlarged."""
    return np.clip(gain * np.abs(tone(test, exposure) - tone(reference, exposure)), 0.0, 1.0)


def save_sheet(
    path: Path, rows: Sequence[Sequence[tuple[np.ndarray, str]]], shrink: int = 1, narrow: int = NARROW,
) -> None:
    """Save a grid of (sRGB picture [h, w, 3], label), bottom row of each picture first, all of one size."""
    grow = max(1, -(-narrow // rows[0][0][0].shape[1]))
    rows = [[(np.repeat(np.repeat(picture, grow, 0), grow, 1), label) for picture, label in row] for row in rows]
    height, width = (side // shrink for side in rows[0][0][0].shape[:2])
    columns = max(len(row) for row in rows)
    sheet = np.full((len(rows) * (height + BAR), columns * (width + GAP) - GAP, 3), 0.12, np.float32)
    for j, row in enumerate(rows):
        for i, (picture, _) in enumerate(row):
            x, y = i * (width + GAP), j * (height + BAR) + BAR
            small = picture[:height * shrink, :width * shrink].reshape(height, shrink, width, shrink, 3).mean((1, 3))
            sheet[y:y + height, x:x + width] = small[::-1]
    buffer = oiio.ImageBuf(oiio.ImageSpec(sheet.shape[1], sheet.shape[0], 3, oiio.UINT8))
    buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(sheet))
    for j, row in enumerate(rows):
        for i, (_, label) in enumerate(row):
            at = i * (width + GAP) + 5, j * (height + BAR) + BAR - 6
            oiio.ImageBufAlgo.render_text(buffer, *at, label, fontsize=13, textcolor=(0.9, 0.9, 0.9))
    path.parent.mkdir(parents=True, exist_ok=True)
    if not buffer.write(str(path)):
        raise OSError(f"'{path}' could not be written: {buffer.geterror()}")


class Table:
    """Rows that are printed as they come and saved as Markdown."""

    def __init__(self, columns: Sequence[str]):
        self.columns = list(columns)
        self.rows: list[list[str]] = []
        self.values: list[dict[str, Any]] = []

    def add(self, *cells: Any) -> None:
        """Add a row: floats get four significant digits."""
        row = [f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in cells]
        self.rows.append(row)
        self.values.append(dict(zip(self.columns, cells, strict=True)))
        print("  ".join(f"{name} {cell}" if name else cell for name, cell in zip(self.columns, row, strict=True)),
              flush=True)

    def markdown(self) -> str:
        """Return the table."""
        lines = [self.columns, ["---"] * len(self.columns), *self.rows]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"

    def save(self, path: Path, title: str, legend: str = "") -> None:
        """Append the table to a Markdown file, under a title."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(f"\n## {title}\n\n{legend}{chr(10) * 2 if legend else ''}{self.markdown()}")

    def save_json(self, path: Path) -> None:
        """Write all rows, by column, with all digits."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.values, indent=1, default=float) + "\n", encoding="utf-8")
