# SPDX-License-Identifier: GPL-3.0-or-later
"""A structure over triangles with what is known of its faces."""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels.types import FlatTriangles
from .wide_bvh import WideBvh, build_wide

__all__ = ["FlatStructure"]


class FlatStructure:
    """Triangles in one structure: those of flattened instances in world space, or of meshes in object space."""

    def __init__(self, device: str):
        self.device = device
        self.wide: WideBvh | None = None
        """None without triangles"""
        self.faces = wp.zeros(1, dtype=wp.vec2i, device=device)
        """(instance, triangle) per face; in object space one of the instances that share it"""
        self.decided = False
        """Whether rays decide by themselves which triangles stop them, FlatTriangles.decided"""
        self._nothing = wp.empty(0, dtype=wp.uint32, device=device)

    def build(
        self, points: wp.array, indices: list[np.ndarray], faces: list[np.ndarray], *, opaque: bool = True,
    ) -> None:
        """Build over triangles: indices into world-space points and (instance, triangle) of each, in parts."""
        if sum(len(part) for part in indices) == 0:
            return
        self.wide = build_wide(
            points, wp.array(np.concatenate(indices).ravel(), dtype=int, device=self.device), opaque=opaque)
        self.faces = wp.array(np.concatenate(faces), dtype=wp.vec2i, device=self.device)

    def struct(self) -> FlatTriangles:
        """Return it as kernels take it."""
        flat = FlatTriangles()
        flat.nodes = self._nothing if self.wide is None else self.wide.nodes
        flat.triangles = self._nothing if self.wide is None else self.wide.triangles
        flat.faces = self.faces
        flat.decided = int(self.decided)
        flat.tubes = int(self.wide is not None and self.wide.tubes)
        return flat
