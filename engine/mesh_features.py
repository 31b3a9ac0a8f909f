# SPDX-License-Identifier: GPL-3.0-or-later
"""What the Geometry node tells of a mesh as a whole: Random Per Island and Pointiness, as Cycles works them out.

By its scene export (intern/cycles/blender/mesh.cpp): a part's random number is Bob Jenkins' hash of the vertex that
stands for it in a disjoint-set forest; Pointiness is the angle between a vertex's normal and the mean of its edges'
directions over pi, averaged with the vertices around. Vertices in one place count as one.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels.mesh_islands import join_edges
from .device import launch, start_warp

__all__ = ["HAIR", "ISLAND", "POINTINESS", "ROOT", "STRAND", "derived_names", "hashed", "pointiness",
           "random_per_island"]

ISLAND, POINTINESS = ".island", ".pointiness"
"""Names of attributes in programs and meshes"""

HAIR, ROOT, STRAND = ".hair", ".root", ".strand"
"""Of hair (hair_info.py)"""


def derived_names(names) -> frozenset[str]:
    """Return which of these attributes must be worked out."""
    return frozenset(names) & {ISLAND, POINTINESS, HAIR, ROOT, STRAND}


def random_per_island(vertex_count: int, edges: np.ndarray) -> np.ndarray:
    """Return a number of 0..1 for each vertex, the same for those that edges (int32 [E, 2]) connect: float32 [V]."""
    start_warp()
    parents = wp.array(np.arange(vertex_count, dtype=np.int32), dtype=int, device="cpu")
    ranks = wp.zeros(vertex_count, dtype=int, device="cpu")
    pairs = wp.array(np.ascontiguousarray(edges, np.int32).reshape(-1, 2), dtype=wp.vec2i, device="cpu")
    launch(join_edges, 1, [pairs], [parents, ranks], "cpu")
    return (hashed(parents.numpy()) / np.float32(0xFFFFFFFF)).astype(np.float32)


def hashed(values: np.ndarray, count: int = 1) -> np.ndarray:
    """Return Cycles' hash of whole numbers (util/hash.h; Jenkins' lookup3): uint32 [N]; `count` 2: with a zero each."""
    seed = np.uint32((0xDEADBEEF + (count << 2) + 13) & 0xFFFFFFFF)
    state = [seed + values.astype(np.uint32), np.full(len(values), seed), np.full(len(values), seed)]
    for left, right, bits in ((2, 1, 14), (0, 2, 11), (1, 0, 25), (2, 1, 16), (0, 2, 4), (1, 0, 14), (2, 1, 24)):
        turned = (state[right] << np.uint32(bits)) | (state[right] >> np.uint32(32 - bits))
        state[left] = (state[left] ^ state[right]) - turned
    return state[2]


def pointiness(positions: np.ndarray, normals: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return float32 [V], 0.5 on what is flat.

    Args:
        positions: float32 [V, 3].
        normals: float32 [V, 3], the vertices' own.
        edges: int32 [E, 2].
    """
    _, first, welded = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    welded, count = welded.reshape(-1), len(first)
    normal = _sums(welded, normals, count)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    pairs = np.unique(np.sort(welded[edges], axis=1), axis=0)
    a, b = pairs[pairs[:, 0] != pairs[:, 1]].T
    along = positions[first[b]].astype(np.float64) - positions[first[a]]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    edge_counts = np.bincount(a, minlength=count) + np.bincount(b, minlength=count)
    mean = (_sums(a, along, count) - _sums(b, along, count)) / np.maximum(edge_counts, 1)[:, None]
    angle = np.arccos(np.clip((normal * mean).sum(1), -1.0, 1.0)) / np.pi
    raw = np.where(edge_counts > 0, angle, 0.0)
    around = np.bincount(a, raw[b], count) + np.bincount(b, raw[a], count)
    return ((raw + around) / (edge_counts + 1))[welded].astype(np.float32)


def _sums(index: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Return the sums of vectors by index: float64 [count, 3]."""
    return np.stack([np.bincount(index, values[:, axis], count) for axis in range(3)], 1)
