# SPDX-License-Identifier: GPL-3.0-or-later
"""What extraction hands over of a volume object: its grids, on one lattice of cells. NumPy and Python values only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["VolumeData"]


@dataclass(kw_only=True, eq=False)
class VolumeData:
    """Grids of one volume object or smoke domain."""

    grids: dict[str, np.ndarray]
    """float32 [z, y, x, 4] by name: a number in all of xyz or a colour, alpha in w"""
    to_object: np.ndarray
    """float64 [4, 4], from cells to object space; the first cell's middle is at (0.5, 0.5, 0.5)"""
    cells: tuple[int, int, int]
    """Along x, y and z"""
    scaled: bool = False
    """Whether an object that is scaled up is less dense"""

    @property
    def box(self) -> tuple[tuple[float, ...], tuple[float, ...], tuple[int, int, int]]:
        """Return corner, sides and numbers of cells, all in cells."""
        return (0.0, 0.0, 0.0), tuple(float(n) for n in self.cells), self.cells

    def density(self, transform: np.ndarray) -> float:
        """Return the factor on extinction of an object with a transform, as Cycles has it (scene/object.cpp)."""
        if not self.scaled:
            return 1.0
        return 1.0 / max(float(np.linalg.norm(transform[:3, :3].sum(1))) / 3.0**0.5, 1e-30)
