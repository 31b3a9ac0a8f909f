# SPDX-License-Identifier: GPL-3.0-or-later
"""Two levels of structures: trees of meshes in object space, and one over instances of them.

kernels/wide_instances.py tells what they look like. Both follow what moves without being built anew: their boxes are
fitted to where things are. Once the boxes together have grown beyond GROWTH they say so, and are built again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import types
from ..kernels.cluster_tree import write_areas
from ..kernels.wide_bvh import TRIANGLE_WORDS
from ..kernels.wide_bvh_edit import place_triangles
from ..kernels.wide_instances import RECORD_WORDS
from ..kernels.wide_instances_edit import MESH_WORDS, write_boxes, write_records
from .device import launch, record
from .frame_graph import FrameGraph
from .staging import RowWriter
from .wide_bvh import WideBvh, build_forest, build_over, build_wide

__all__ = ["InstanceLevel", "MeshTree", "ObjectTrees"]

ALONE = 50_000
"""Triangles from which a mesh gets a tree by itself, whose upper levels are mended"""

FOREST = 1 << 24
"""Triangles beyond which meshes that come next make another forest: building takes several times the memory"""

GROWTH = 1.5
"""Area of all boxes, as a multiple of what it was when they were built, at which rays are the slower for it"""


class _Area:
    """Area of a tree's boxes, told a while later, as nobody waits for the device."""

    def __init__(self, device: str):
        self._sum = wp.zeros(1, dtype=float, device=device)
        self._told = wp.zeros(1, dtype=float, device="cpu", pinned=wp.get_device(device).is_cuda)
        self._view = self._told.numpy()
        self._first = 0.0

    def note(self, lower: wp.array, upper: wp.array) -> None:
        """Add up the boxes, vec3 [N] each."""
        areas = wp.empty(len(lower), dtype=float, device=lower.device)
        launch(write_areas, len(lower), [lower, upper], [areas], lower.device.alias)
        self.add_up(areas)

    def add_up(self, areas: wp.array) -> None:
        """Add up the boxes' areas, float [N]: not fit for graphs everywhere, as it takes memory for a while."""
        wp.utils.array_sum(areas, out=self._sum)
        wp.copy(self._told, self._sum)

    @property
    def outgrown(self) -> bool:
        """Return whether it has grown too much since it was first noted."""
        now = float(self._view[0])
        self._first = self._first or now
        return now > GROWTH * self._first


@dataclass(frozen=True)
class MeshTree:
    """A mesh's tree in object space."""

    wide: WideBvh
    root: int
    """Its node"""
    faces: int
    """How many faces of other meshes come before its own"""


class ObjectTrees:
    """Trees of meshes that are built, and deformed, together."""

    def __init__(
        self, points: wp.array, parts: list[np.ndarray], *, deforming: bool = False, opaque: bool = True,
    ):
        """Build them.

        Args:
            points: vec3 [V], in object space.
            parts: int32 [T, 3] of each mesh, into the points; T > 0.
            deforming: Whether they shall follow moving vertices.
            opaque: Whether rays ask for hits, not for layers; see build_wide.

        Raises:
            InvalidScene: One has too many triangles.
        """
        counts = np.array([len(part) for part in parts], np.int64)
        self._parts = parts if deforming else []
        self._built: list[tuple[WideBvh, wp.array, _Area]] = []
        self.trees: list[MeshTree] = []
        forest, alone = np.zeros(0, np.int64), np.arange(len(parts))
        if (counts < ALONE).sum() > 1:
            forest, alone = np.flatnonzero(counts < ALONE), np.flatnonzero(counts >= ALONE)
        trees: dict[int, MeshTree] = {}
        ends = np.cumsum(counts[forest])
        for members in np.split(forest, np.flatnonzero(np.diff(ends // FOREST)) + 1) if len(forest) else []:
            indices = self._upload(points, [parts[i] for i in members])
            wide = build_forest(points, indices, counts[members], opaque=opaque)
            if wide is None:
                alone = np.concatenate([alone, members])
                continue
            self._built.append((wide, indices, _Area(points.device.alias)))
            first = np.concatenate([[0], np.cumsum(counts[members])]).tolist()
            trees.update((i, MeshTree(wide, root, first[root])) for root, i in enumerate(members.tolist()))
        for i in alone.tolist():
            indices = self._upload(points, [parts[i]])
            wide = build_wide(points, indices, opaque=opaque, deforming=deforming)
            self._built.append((wide, indices, _Area(points.device.alias)))
            trees[i] = MeshTree(wide, 0, 0)
        if deforming:
            self._fit(points)
        else:
            self._built.clear()
        self.trees = [trees[i] for i in range(len(parts))]

    @staticmethod
    def _upload(points: wp.array, parts: list[np.ndarray]) -> wp.array:
        return wp.array(np.concatenate(parts).ravel(), dtype=int, device=points.device)

    def follow(self, points: wp.array, parts: list[np.ndarray]) -> bool:
        """Fit the trees to where their vertices are now; return whether they could.

        They can't where triangles are others than before, or where boxes have grown so much that rays take longer.
        """
        same = len(parts) == len(self._parts) and all(
            np.array_equal(new, old) for new, old in zip(parts, self._parts, strict=True))
        if not same or any(area.outgrown for _, _, area in self._built):
            return False
        self._fit(points)
        return True

    def _fit(self, points: wp.array) -> None:
        for wide, indices, area in self._built:
            launch(place_triangles, wide.references, [points, indices, wide.parts], [wide.triangles],
                   points.device.alias)
            area.note(*wide.refit())


class InstanceLevel:
    """An 8-wide BVH over instances of meshes with trees."""

    def __init__(
        self, chosen: np.ndarray, low: np.ndarray, high: np.ndarray, mesh_of: np.ndarray,
        trees: list[tuple[MeshTree, int] | None], device: str,
    ):
        """Build it.

        Args:
            chosen: int [N], ascending: the instances; N > 0.
            low: float32 [N, 3], bounds in world space.
            high: The same.
            mesh_of: int [N], which mesh each is of.
            trees: Of each mesh, and where its faces begin in Geometry.mesh_faces; None: no instance is of it.
            device: Where it is.
        """
        self.device, self.chosen = device, chosen
        self._corners = np.stack([low, high], 1).reshape(-1, 3)
        """float32 [2 * N, 3], lower and upper one of each in turn"""
        self._bounds = wp.array(self._corners, dtype=wp.vec3, device=device)
        self._writer, self._area = RowWriter(wp.vec3, device), _Area(device)
        self._fitting: tuple[FrameGraph, wp.array] | None = None
        self._placing: tuple[wp.array, wp.Launch] | None = None
        nodes, self._items, levels = build_over(
            *(wp.array(values, dtype=wp.vec3, device=device) for values in (low, high)))
        boxes = wp.zeros(TRIANGLE_WORDS * len(chosen), dtype=wp.uint32, device=device)
        self._wide = WideBvh(nodes, boxes, levels, len(chosen), wp.zeros(0, dtype=int, device=device))
        self._records = wp.zeros(int(RECORD_WORDS) * len(chosen), dtype=wp.uint32, device=device)
        self._rows = [wp.array(values.astype(np.int32), dtype=int, device=device) for values in (chosen, mesh_of)]
        self._wides = list({id(tree[0].wide): tree[0].wide for tree in trees if tree}.values())
        numbers = {id(wide): i for i, wide in enumerate(self._wides)}
        self._wide_of = np.array([numbers[id(tree[0].wide)] if tree else len(numbers) for tree in trees], np.int64)
        """By mesh; one more for those without instances"""
        self._roots = np.array(
            [(tree[0].root, tree[1] - tree[0].faces) if tree else (0, 0) for tree in trees], np.int64)
        """By mesh, with what is added to a face"""
        self._places: list[tuple[int, int]] = []
        """Addresses that records have of nodes and triangles"""
        self._meshes = wp.zeros((len(trees), int(MESH_WORDS)), dtype=wp.uint32, device=device)
        launch(write_boxes, len(chosen), [self._items, self._bounds], [boxes], device)
        self._area.note(*self._wide.refit())

    def write_records(self, instances: wp.array) -> None:
        """Take over the transforms of kernels.types.Instance [all], and where trees lie, in place."""
        places = [(wide.nodes.ptr, wide.triangles.ptr) for wide in self._wides] + [(0, 0)]
        if places != self._places:
            self._places = places
            places = np.array(places, np.uint64)[self._wide_of]
            low, high = (places & np.uint64(0xFFFFFFFF)).astype(np.uint32), (places >> np.uint64(32)).astype(np.uint32)
            # Words 12 to 17 of a record.
            self._meshes.assign(np.column_stack(
                [low[:, 0], high[:, 0], low[:, 1], high[:, 1], self._roots.astype(np.uint32)]))
        if self._placing is None or self._placing[0] is not instances:
            self._placing = instances, record(
                write_records, [self._items, *self._rows, self._meshes, instances], [self._records], self.device,
                len(self.chosen))
        self._placing[1].launch()

    def holds(self, instances: np.ndarray) -> np.ndarray:
        """Return which of some instances, int, are among the chosen: bool."""
        places = np.minimum(np.searchsorted(self.chosen, instances), len(self.chosen) - 1)
        return self.chosen[places] == instances

    def move(self, moved: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
        """Follow instances to other bounds, in place; return whether that could be done.

        It can't where boxes have grown so much that rays take longer.

        Args:
            moved: int, ascending, all of them among the chosen.
            low: float32 [len(moved), 3].
            high: The same.
        """
        if self._area.outgrown:
            return False
        places = 2 * np.searchsorted(self.chosen, moved)
        self._corners[places], self._corners[places + 1] = low, high
        self._writer.write(self._bounds, self._corners, np.stack([places, places + 1], 1).reshape(-1))
        self._fitting = self._fitting or self._record_fitting()
        graph, areas = self._fitting
        graph.replay()
        self._area.add_up(areas)
        return True

    def _record_fitting(self) -> tuple[FrameGraph, wp.array]:
        """Record what fits all boxes to the bounds, for each step of a drag; return that and their areas."""
        graph, wide = FrameGraph(self.device), self._wide
        graph.launch(write_boxes, len(self.chosen), [self._items, self._bounds], [wide.triangles], banded=False)
        lower, upper = wide.record_refit(graph)
        areas = wp.empty(len(lower), dtype=float, device=self.device)
        graph.launch(write_areas, len(lower), [lower, upper], [areas], banded=False)
        return graph, areas

    def struct(self) -> types.InstanceLevel:
        """Return it as kernels take it: the same after moves."""
        level = types.InstanceLevel()
        level.nodes, level.records = self._wide.nodes.ptr, self._records.ptr
        level.tubes = int(any(wide.tubes for wide in self._wides))
        return level
