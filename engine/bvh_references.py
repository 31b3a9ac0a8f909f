# SPDX-License-Identifier: GPL-3.0-or-later
"""References: what the leaves of a BVH hold, each a triangle, a part of one or a tube."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import cluster_tree
from ..kernels import tube_items as tube_kernels
from ..kernels import wide_bvh_build as kernels
from ..kernels.wide_bvh import TRIANGLE_WORDS, TUBE_ROWS
from .device import launch
from .tube_items import TubeItems
from .work_list import make_queue

__all__ = ["References", "bound_tubes", "one_to_each", "whole_triangles", "with_tubes", "write_references"]


@dataclass
class References:
    """Triangles, parts of them and tubes: N items of a tree."""

    faces: wp.array
    """int [N], the triangle; of tubes the first"""
    steps: wp.array
    """vec2ui [N], see triangle_split.part_box"""
    lower: wp.array
    upper: wp.array
    sizes: np.ndarray | None = None
    """int32 [N], how many triangles each is; None where there are no tubes"""

    @property
    def arrays(self) -> tuple[wp.array, ...]:
        """Return what there is of each on the device."""
        return self.faces, self.steps, self.lower, self.upper

    @property
    def area(self) -> float:
        """Return half the area of all boxes; those that are not finite have none."""
        areas = wp.empty(len(self.lower), dtype=wp.float64, device=self.lower.device)
        launch(cluster_tree.measure_areas, len(areas), [self.lower, self.upper], [areas], areas.device.alias)
        return float(wp.utils.array_sum(areas))


def write_references(points: wp.array, indices: wp.array, items: wp.array, parts: References) -> wp.array:
    """Return the words of triangles and tubes, by `items`, the references in the leaves' order."""
    device, count = points.device, len(items)
    places, heads = np.zeros((2, 0), np.int32)
    if parts.sizes is not None:
        order = items.numpy()
        places = np.flatnonzero(parts.sizes[order] > 1).astype(np.int32)
        heads = parts.faces.numpy()[order[places]]
    words = wp.empty(TRIANGLE_WORDS * count + 4 * int(TUBE_ROWS) * len(heads), dtype=wp.uint32, device=device)
    launch(kernels.write_triangles, count, [points, indices, items, parts.faces, parts.steps], [words], device.alias)
    launch(tube_kernels.write_tubes, len(heads), [
        points, indices, wp.array(heads, dtype=int, device=device), wp.array(places, dtype=int, device=device), count],
        [words], device.alias)
    return words


def one_to_each(points: wp.array, indices: wp.array, chosen: np.ndarray | None) -> References:
    """Return one reference to each triangle, or to each of those that are chosen."""
    device = points.device.alias
    faces = make_queue(len(indices) // 3, device) if chosen is None else wp.array(chosen, dtype=int, device=device)
    lower, upper = (wp.empty(len(faces), dtype=wp.vec3, device=device) for _ in range(2))
    launch(kernels.triangle_bounds, len(faces), [points, indices, faces], [lower, upper], device)
    return References(faces, wp.zeros(len(faces), dtype=wp.vec2ui, device=device), lower, upper)


def with_tubes(points: wp.array, indices: wp.array, parts: References, tubes: TubeItems) -> References:
    """Return references to tubes too, after the others."""
    device, first, count = points.device.alias, len(parts.faces), len(tubes.heads)
    made = References(*(wp.zeros(first + count, dtype=each.dtype, device=device) for each in parts.arrays),
                       np.ones(first + count, np.int32))
    for new, old in zip(made.arrays, parts.arrays, strict=True):
        if first:
            wp.copy(new, old)
    wp.copy(made.faces, wp.array(tubes.heads, dtype=int, device=device), dest_offset=first)
    bound_tubes(points, indices, made, tubes, np.arange(first, first + count, dtype=np.int32))
    return made


def bound_tubes(
    points: wp.array, indices: wp.array, parts: References, tubes: TubeItems, places: np.ndarray,
) -> None:
    """Make the references at int32 [T] places tubes."""
    heads, at = (wp.array(each, dtype=int, device=points.device) for each in (tubes.heads, places))
    launch(tube_kernels.bound_tubes, len(places), [points, indices, heads, at], [parts.lower, parts.upper],
           points.device.alias)
    parts.sizes[places] = tubes.faces


def whole_triangles(items: np.ndarray, parts: References) -> np.ndarray:
    """Return WideBvh.wholes, by `items`, the references in the leaves' order."""
    faces = parts.faces.numpy()[items]
    references = np.sort(np.unique(faces, return_index=True)[1]).astype(np.int32)
    if parts.sizes is None:
        return 16 * references
    sizes = parts.sizes[items][references]
    numbers = np.arange(sizes.sum(), dtype=np.int32) - np.repeat(np.cumsum(sizes) - sizes, sizes).astype(np.int32)
    return np.repeat(16 * references, sizes) + numbers
