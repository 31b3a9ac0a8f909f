# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of a mesh's triangles are tubes: kernels/tube_items.py tells what they are for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import tube_items as kernels
from .device import launch

__all__ = ["TubeItems", "find_tubes"]


@dataclass(frozen=True, eq=False)
class TubeItems:
    """T tubes among triangles."""

    heads: np.ndarray
    """int32 [T], first face of each, ascending"""
    faces: np.ndarray
    """int32 [T], how many faces each has"""
    others: np.ndarray
    """int32, the faces that are part of none, ascending"""


def find_tubes(points: wp.array, indices: wp.array) -> TubeItems | None:
    """Return the tubes among triangles, None where there are none.

    Args:
        points: vec3 [V].
        indices: int [3 * N].
    """
    device, count = points.device.alias, len(indices) // 3
    faces, found = wp.empty(count, dtype=wp.uint8, device=device), wp.zeros(1, dtype=int, device=device)
    launch(kernels.find_tubes, count, [points, indices], [faces, found], device)
    if not found.numpy()[0]:
        return None
    marks = faces.numpy()
    heads = np.flatnonzero(marks).astype(np.int32)
    # Where faces are listed more than once tubes may overlap: then the later ones are triangles.
    sizes = marks[heads].astype(np.int32)
    apart = heads >= np.concatenate([[0], np.maximum.accumulate(heads + sizes)[:-1]])
    heads, sizes = heads[apart], sizes[apart]
    ends = np.zeros(count + 1, np.int8)
    ends[heads] += 1
    ends[heads + sizes] -= 1
    return TubeItems(heads, sizes, np.flatnonzero(np.cumsum(ends[:-1], dtype=np.int8) == 0).astype(np.int32))
