# SPDX-License-Identifier: GPL-3.0-or-later
"""A builder for trees that must come to constants: what varies is taken at one level of its range.

Media are drawn the same everywhere. Textures mostly lie near the middle of 0 to 1, so the mean of what a tree comes to
at several levels about it stands for its mean in space.
"""

from __future__ import annotations

import numpy as np

from .program import ProgramBuilder, Value

__all__ = ["LEVELS", "MeanBuilder"]

LEVELS = (0.3, 0.4, 0.5, 0.6, 0.7)
"""About the tenth, thirtieth, ... part of what noise is below"""

LUMINANCE = (0.2126729, 0.7151522, 0.0721750)
"""Of Rec.709, near enough in other working spaces"""


class MeanBuilder(ProgramBuilder):
    """Folds everything: textures, attributes and coordinates are a constant."""

    def __init__(self, level: float) -> None:
        """Start an empty program; `level`: what stands in."""
        super().__init__()
        self.level = level
        self.varied = False
        """Whether anything varies"""

    def _any(self, *_args, **_options) -> Value:
        """Return what stands in for a value that varies."""
        self.varied = True
        return self.constant(self.level)

    input = uv = attribute = uv_tangent = camera_space = image = procedural = white_noise = fresnel = _any
    normal_map = bump = _any

    def space(self, name: str, value) -> Value:
        """Return a vector as it is: no object is known."""
        return self._any() if self.constant(value).constant is None else self.constant(value)

    def transform(self, rows, value, *, direction: bool = False) -> Value:
        """Return a constant vector transformed."""
        vector = self.constant(value).constant
        moved = np.asarray(rows, float)[:3, :3] @ vector[:3]
        return self.constant(tuple(moved if direction else moved + np.asarray(rows, float)[:3, 3]))

    def ramp(self, name: str, table: bytes, value) -> Value:
        """Look a constant up."""
        rows = np.frombuffer(table, np.float32).reshape(-1, 4)
        x = self.constant(value).constant
        places = np.clip(np.nan_to_num(x[:3]), 0.0, 1.0) * (len(rows) - 1)
        if name == "CONSTANT":
            return self.constant(tuple(float(v) for v in rows[int(places[0])]))
        if name == "LINEAR":
            return self.constant(tuple(float(np.interp(places[0], np.arange(len(rows)), column)) for column in rows.T))
        # Curves: a component each.
        return self.constant(tuple(
            float(np.interp(places[c], np.arange(len(rows)), rows[:, c])) for c in range(3)))

    def luminance(self, color) -> Value:
        """Return a constant's luminance."""
        return self.constant(float(np.dot(self.constant(color).constant[:3], LUMINANCE)))
