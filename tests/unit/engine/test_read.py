# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading OpenEXR files: plain pictures, parts of others, and what is neither."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from burnish.engine.errors import BurnishError
from burnish.engine.read import read_exr
from burnish.engine.write import LayerPixels, PassPixels, write_exr


def make(path: Path) -> np.ndarray:
    """Write a picture with a second pass and return both, [2, h, w, 3]."""
    pixels = np.random.default_rng(1).random((2, 3, 5, 3), np.float32)
    passes = tuple(PassPixels(name, "RGB", pixels[i]) for i, name in enumerate(("Combined", "Noisy Image")))
    write_exr(path, [LayerPixels("Layer", passes)], {})
    return pixels


def test_plain_picture_comes_back(tmp_path: Path) -> None:
    """Read what was written, the same row first."""
    pixels = make(tmp_path / "a.exr")
    assert (read_exr(tmp_path / "a.exr") == pixels[0]).all()


def test_a_pass_is_found_by_name(tmp_path: Path) -> None:
    """Read another pass than the picture."""
    pixels = make(tmp_path / "a.exr")
    assert (read_exr(tmp_path / "a.exr", "Noisy Image") == pixels[1]).all()


def test_what_is_no_picture_is_named(tmp_path: Path) -> None:
    """Say which file can't be read, and what it lacks."""
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(BurnishError, match=r"text\.exr' can't be read"):
        read_exr(tmp_path / "text.exr")
    make(tmp_path / "a.exr")
    with pytest.raises(BurnishError, match="no part 'Albedo'"):
        read_exr(tmp_path / "a.exr", "Albedo")
    write_exr(tmp_path / "depth.exr", [LayerPixels("Layer", (PassPixels("Combined", "Z", np.ones((2, 2, 1))),))], {})
    with pytest.raises(BurnishError, match="no plain R, G, B picture"):
        read_exr(tmp_path / "depth.exr")
