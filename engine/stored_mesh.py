# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh as Blender stores it, by vertices, faces and faces' corners, and what becomes of it by triangles.

Only reading it needs Blender's thread; the rest can go on in others meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .mesh_features import ISLAND, POINTINESS, pointiness, random_per_island
from .scene import MeshData

__all__ = ["CORNER", "FACE", "POINT", "StoredMesh"]

POINT, CORNER, FACE = 'POINT', 'CORNER', 'FACE'
"""Domains of attributes, named as in Blender"""


@dataclass(kw_only=True)
class StoredMesh:
    """Copies of a mesh's arrays; V vertices, L corners, F faces, T triangles."""

    name: str
    positions: np.ndarray
    """float32 [V, 3]"""
    corner_vertices: np.ndarray
    """int32 [L]; may name vertices that don't exist: sanitize_mesh drops those triangles afterwards"""
    corners: np.ndarray | None
    """int32 [3T], the corners of each triangle; None where every face is one"""
    faces: np.ndarray | None
    """int32 [T], the face of each triangle; None where every face is one"""
    slots: np.ndarray | None = None
    """int32 [F], material slots; None: all the first"""
    normals: np.ndarray | None = None
    """float32 [L, 3], flat faces, sharp edges and custom normals included; None: unknown"""
    uv_maps: dict[str, np.ndarray] = field(default_factory=dict)
    """float32 [L, 2] by name, the one active for rendering first"""
    attributes: dict[str, tuple[str, np.ndarray]] = field(default_factory=dict)
    """Domain and values float32 [N, 4] by name"""
    generated: tuple[np.ndarray, np.ndarray] | None = None
    """As in MeshData"""
    derived: frozenset[str] = frozenset()
    """Which of ISLAND and POINTINESS to work out, from the next two"""
    edges: np.ndarray | None = None
    """int32 [E, 2], vertices"""
    vertex_normals: np.ndarray | None = None
    """float32 [V, 3]"""

    def by_triangles(self) -> MeshData:
        """Return the mesh with values at the corners of its triangles: it may not be fit to be drawn yet."""
        triangles = self._at_corners(self.corner_vertices).reshape(-1, 3)
        slots = np.zeros(len(triangles), np.int32) if self.slots is None else self._at_faces(self.slots)
        attributes = {name: self._expand(values, domain, triangles)
                      for name, (domain, values) in self.attributes.items()}
        return MeshData(
            name=self.name, positions=self.positions, triangles=triangles, material_slots=slots,
            corner_normals=self._corner_normals(len(triangles)),
            uv_maps={name: self._by_corners(values) for name, values in self.uv_maps.items()},
            attributes=attributes | self._features(triangles), generated=self.generated)

    def _at_corners(self, values: np.ndarray) -> np.ndarray:
        return values if self.corners is None else values.take(self.corners, axis=0)

    def _by_corners(self, values: np.ndarray) -> np.ndarray:
        """Return [T, 3, C] of the [L, C] `values`."""
        return self._at_corners(values).reshape(-1, 3, values.shape[-1])

    def _at_faces(self, values: np.ndarray) -> np.ndarray:
        return values if self.faces is None else values.take(self.faces, axis=0)

    def _expand(self, values: np.ndarray, domain: str, triangles: np.ndarray) -> np.ndarray:
        """Return [T, 3, C] of the [N, C] `values` on a domain."""
        if domain == POINT:
            return values.take(triangles, axis=0, mode='clip')
        if domain == CORNER:
            return self._by_corners(values)
        return np.ascontiguousarray(np.repeat(self._at_faces(values)[:, None], 3, axis=1))

    def _corner_normals(self, count: int) -> np.ndarray:
        """Return float32 [T, 3, 3]; where there are none they are 0, for which sanitize_mesh puts in the faces'."""
        if self.normals is None:
            return np.zeros((count, 3, 3), np.float32)
        normals = self.normals
        # Of corners between faces without area; Cycles packs normals as points of an octahedron, which has no zero.
        zero = (normals[:, 0] == 0.0) & (normals[:, 1] == 0.0) & (normals[:, 2] == 0.0)
        if zero.any():
            normals = np.where(zero[:, None], np.float32((0.0, 0.0, 1.0)), normals)
        return self._by_corners(normals)

    def _features(self, triangles: np.ndarray) -> dict[str, np.ndarray]:
        """Return the attributes that are worked out from the mesh's edges."""
        found = {}
        if ISLAND in self.derived:
            found[ISLAND] = random_per_island(len(self.positions), self.edges)
        if POINTINESS in self.derived:
            found[POINTINESS] = pointiness(self.positions, self.vertex_normals, self.edges)
        return {name: self._expand(np.repeat(values[:, None], 4, axis=1), POINT, triangles)
                for name, values in found.items()}
