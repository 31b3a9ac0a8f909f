# SPDX-License-Identifier: GPL-3.0-or-later
"""What the Hair Info node and Generated coordinates tell, as attributes of hair.

By Cycles' definitions (intern/cycles: blender/curves.cpp and kernel/geom/curve.h). Meshes that aren't hair lack the
attributes, which then are 0. Only hair has them whose materials ask for them.
"""

from __future__ import annotations

import numpy as np

from .hair import SIDES, Strands, Tubes
from .mesh_features import HAIR, ROOT, STRAND, hashed

__all__ = ["along_strands", "hair_attributes"]


def along_strands(points: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return float64 [K], how far 0..1 each point is along its strand of straight pieces, and [C], their lengths.

    Args:
        points: [K, 3].
        counts: int64 [C], points of each strand.
    """
    if not len(points):
        return np.zeros(0), np.zeros(len(counts))
    steps = np.zeros(len(points))
    steps[1:] = np.linalg.norm(np.diff(points.astype(np.float64), axis=0), axis=1)
    first, last = (np.cumsum(counts) - counts)[counts > 0], np.cumsum(counts)[counts > 0] - 1
    steps[first] = 0
    before = np.cumsum(steps)
    lengths = np.zeros(len(counts))
    lengths[counts > 0] = before[last] - before[first]
    start, length = (np.repeat(values, counts[counts > 0]) for values in (before[first], lengths[counts > 0]))
    return (before - start) / np.maximum(length, 1e-30), lengths


def hair_attributes(names: frozenset[str], strands: Strands, tubes: Tubes, numbers: np.ndarray,
                    along: tuple[np.ndarray, np.ndarray] | None = None,
                    roots: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Return those of HAIR, ROOT and STRAND that are in `names`: float32 [T, 3, 4].

    HAIR is Intercept, Length, Thickness and Random, ROOT what Generated coordinates are, and 1, STRAND the direction in
    object space, and 1.

    Args:
        names: Of attributes.
        strands: What is drawn.
        tubes: Around them.
        numbers: int [C], number of each strand among all of its object.
        along: What `along_strands` says, where points of the strands have been left out since.
        roots: [C, 3], Generated coordinates where they are those of the strands' roots.
    """
    found = {}
    if HAIR in names:
        intercept, lengths = along_strands(strands.points, strands.counts) if along is None else along
        of_vertices = np.empty((len(tubes.positions), 4), np.float32)
        of_vertices[:, 0] = tubes.of_points(intercept)
        of_vertices[:, 1] = lengths[tubes.strand]
        of_vertices[:, 2] = 2 * tubes.of_points(strands.radii)
        of_vertices[:, 3] = (hashed(numbers, 2) / np.float32(0xFFFFFFFF))[tubes.strand]
        found[HAIR] = of_vertices[tubes.triangles]
    if STRAND in names:
        directions = np.ones((len(tubes.directions), 4), np.float32)
        directions[:, :3] = tubes.directions
        found[STRAND] = directions[tubes.triangles // SIDES]
    if ROOT in names and roots is not None:
        of_strands = np.ones((len(roots), 4), np.float32)
        of_strands[:, :3] = roots
        found[ROOT] = of_strands[tubes.strand[tubes.triangles]]
    return found
