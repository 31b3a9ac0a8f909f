# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds out what a world's program does to its sky, so that a lamp can stand for the sky's sun."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..kernels import node_codes as codes
from .program import ProgramBuilder, Value

__all__ = ["SkyProbe"]


class SkyProbe(ProgramBuilder):
    """Compiles a world as it would be were its sky a constant, for rays of one kind.

    Where the emission is constant then, the world shows nothing but its sky, however changed.
    """

    def __init__(self, kind: int, sky: Sequence[float]) -> None:
        """Start an empty program.

        Args:
            kind: Visibility bit of the rays.
            sky: Radiance that stands for the sky in all directions.
        """
        super().__init__()
        self._kind = kind
        self._sky = tuple(float(x) for x in sky)
        self.place: Value | None = None
        """Where the sky is looked up; None: nowhere"""

    def input(self, name: str, mask: int = 0) -> Value:
        """Return an input; the ray's kind is known."""
        if name == "RAY_KIND":
            return self.constant(1.0 if mask & self._kind else 0.0)
        return super().input(name, mask)

    def sky_at(self, place: Value) -> Value:
        """Return what stands for the sky."""
        self.place = place
        return self.constant(self._sky)

    def turn(self) -> np.ndarray | None:
        """Return the rotation or reflection [3, 3] from the world's directions to the sky's, None if it isn't one."""
        value, matrix = self.place, np.eye(3)
        while value is not None and value.op == codes.OP_TRANSFORM and value.immediates[0] >= 0:
            rows = np.asarray(self.rows[value.immediates[0]])
            if value.sub == codes.TRANSFORM_POINT and rows[:, 3].any():
                return None
            matrix = matrix @ rows[:, :3]
            value = self.values[value.args[0]]
        directions = (codes.INPUT_POSITION, codes.INPUT_GENERATED, codes.INPUT_OBJECT)
        if value is None or value.op != codes.OP_INPUT or value.sub not in directions:
            return None
        return matrix if np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-5 else None
