# SPDX-License-Identifier: GPL-3.0-or-later
"""All unique meshes' arrays on the device, one after another in growing buffers: an edit uploads its mesh alone.

What several meshes bring goes up together: the transfers of a small one take longer than its bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ..kernels.flatten import write_corners
from .device import host_array, launch_bands
from .scene import Key, MeshData
from .volume_data import VolumeData

__all__ = ["GeometryStore", "MeshRange"]

SLACK = 1.25

WASTE_LIMIT = 0.5
"""Share of the triangles' room that may lie idle before meshes move together"""


@dataclass
class MeshRange:
    """Where a mesh lies in the buffers, and what the host must remember of it."""

    row: int
    """Row of the UV and attribute tables"""
    vertex_start: int
    vertex_count: int
    triangle_start: int
    triangle_count: int
    uv_start: int
    uv_count: int
    attribute_start: int
    attribute_count: int
    uv_names: tuple[str, ...]
    attribute_names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    """float64 [3], bounds in object space"""
    local_triangles: np.ndarray
    """int32 [T, 3], vertex indices within the mesh"""
    slots: np.ndarray
    """int32 [T]"""
    used_slots: np.ndarray
    """Those that any triangle has, ascending"""
    generated: tuple[np.ndarray, np.ndarray]
    volume: VolumeData | None
    """Of volume objects"""


class _Buffer:
    """One device array with spare room at the end; what is written to it gets there with `flush`."""

    def __init__(self, dtype: type, device: str):
        self.dtype = dtype
        self.device = device
        self.array = wp.zeros(1, dtype=dtype, device=device)
        self.used = 0
        self._waiting: list[tuple[int, np.ndarray]] = []

    def reserve(self, count: int) -> int:
        """Return the start of `count` new elements."""
        start = self.used
        self.used += count
        return start

    def write(self, start: int, values: np.ndarray) -> None:
        """Let host values go to [start, start + len); they must stay as they are until then."""
        if len(values):
            self._waiting.append((start, values))

    def flush(self) -> None:
        """Grow the array where needed and copy what waits."""
        held = len(self.array)
        if self.used > held:
            grown = wp.zeros(int(self.used * SLACK) if held > 1 else self.used, dtype=self.dtype, device=self.device)
            wp.copy(grown, self.array, count=held)
            self.array = grown
        waiting, self._waiting = self._waiting, []
        for start, values in contiguous(waiting):
            wp.copy(self.array, host_array(values, self.dtype), dest_offset=start, count=len(values))

    def pack(self, pieces: list[tuple[int, int]]) -> None:
        """Keep nothing but pieces, (start, count) each, one after another."""
        total = sum(count for _, count in pieces)
        packed, place = wp.zeros(max(total, 1), dtype=self.dtype, device=self.device), 0
        for start, count in pieces:
            if count:
                wp.copy(packed, self.array, place, start, count)
            place += count
        self.array, self.used = packed, total


def contiguous(pieces: list[tuple[int, np.ndarray]]) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (start, values) with pieces that follow each other, in this order, joined."""
    first = 0
    for i in range(1, len(pieces) + 1):
        start, values = pieces[i - 1]
        if i == len(pieces) or pieces[i][0] != start + len(values):
            parts = [part for _, part in pieces[first:i]]
            yield pieces[first][0], np.ascontiguousarray(parts[0] if len(parts) == 1 else np.concatenate(parts))
            first = i


def used_slots(slots: np.ndarray) -> np.ndarray:
    """Return the distinct slots, ascending; most meshes have but one."""
    if len(slots) and not slots.any():
        return np.zeros(1, slots.dtype)
    return np.unique(slots)


class GeometryStore:
    """Buffers of positions, triangles, corners, UV maps and attributes."""

    def __init__(self, device: str):
        self.device = device
        self.remember = False
        """Whether positions that an edit overwrites are kept in `replaced`, for motion (engine/motion.py)"""
        self.clear()

    def clear(self) -> None:
        """Forget all meshes."""
        self.ranges: dict[Key, MeshRange] = {}
        self.uv_names: list[str] = [""]
        self.attribute_names: list[str] = [""]
        self.positions = _Buffer(wp.vec3, self.device)
        self.triangles = _Buffer(wp.vec3i, self.device)
        self.slots = _Buffer(wp.int32, self.device)
        self.corners = _Buffer(wp.vec4, self.device)
        self.uvs = _Buffer(wp.vec2, self.device)
        self.attributes = _Buffer(wp.vec4, self.device)
        self.rows = 0
        self.replaced: dict[Key, tuple[int, int, wp.array | None]] = {}
        """First vertex, vertices, and their positions before the first of several edits; None where vertices came or
        went"""
        self._tables: tuple[wp.array, wp.array] | None = None

    @property
    def wasted(self) -> float:
        """Return the share of triangles that no mesh uses any more."""
        live = sum(r.triangle_count for r in self.ranges.values())
        return 1.0 - live / max(self.triangles.used, 1)

    def put(self, meshes: dict[Key, MeshData]) -> None:
        """Upload meshes, in place of those sent before under the same keys where they fit there."""
        normals: list[tuple[int, np.ndarray]] = []
        for key, mesh in meshes.items():
            self._place(key, mesh)
            normals.append((self.ranges[key].triangle_start, mesh.corner_normals))
        self._flush()
        for first, values in contiguous(normals):
            inputs = [self.positions.array, self.triangles.array, self.slots.array,
                      wp.array(values.reshape(-1, 3), dtype=wp.vec3, device=self.device)]
            launch_bands(write_corners, first, len(values), [first, *inputs], [self.corners.array])

    def _flush(self) -> None:
        for buffer in (self.positions, self.triangles, self.slots, self.corners, self.uvs, self.attributes):
            buffer.flush()

    def _place(self, key: Key, mesh: MeshData) -> None:
        """Find room for a mesh and let all but its corners go there."""
        self._tables = None
        old = self.ranges.get(key)
        uv_count = 3 * len(mesh.triangles) * len(mesh.uv_maps)
        attribute_count = 3 * len(mesh.triangles) * len(mesh.attributes)
        fits = (
            old is not None
            and len(mesh.positions) <= old.vertex_count
            and len(mesh.triangles) == old.triangle_count
            and uv_count <= old.uv_count
            and attribute_count <= old.attribute_count
        )
        if old is not None and fits:
            starts = (old.vertex_start, old.triangle_start, old.uv_start, old.attribute_start)
            row = old.row
            self._keep_positions(key, old, len(mesh.positions))
        else:
            self.slots.reserve(len(mesh.triangles))
            self.corners.reserve(6 * len(mesh.triangles))
            starts = (
                self.positions.reserve(len(mesh.positions)),
                self.triangles.reserve(len(mesh.triangles)),
                self.uvs.reserve(uv_count),
                self.attributes.reserve(attribute_count),
            )
            row = old.row if old is not None else self.rows
            self.rows = max(self.rows, row + 1)
        self._write(mesh, *starts)
        for name in mesh.uv_maps:
            if name not in self.uv_names:
                self.uv_names.append(name)
        for name in mesh.attributes:
            if name not in self.attribute_names:
                self.attribute_names.append(name)
        self.ranges[key] = self._range(mesh, row, starts, uv_count, attribute_count)

    def _keep_positions(self, key: Key, old: MeshRange, count: int) -> None:
        if self.remember and key not in self.replaced and old.vertex_count > 0:
            start, end = old.vertex_start, old.vertex_start + old.vertex_count
            kept = wp.clone(self.positions.array[start:end]) if count == old.vertex_count else None
            self.replaced[key] = (start, old.vertex_count, kept)

    def _write(self, mesh: MeshData, vertex: int, triangle: int, uv: int, attribute: int) -> None:
        self.positions.write(vertex, mesh.positions)
        self.triangles.write(triangle, mesh.triangles + np.int32(vertex))
        self.slots.write(triangle, mesh.material_slots)
        for i, values in enumerate(mesh.uv_maps.values()):
            self.uvs.write(uv + i * 3 * len(mesh.triangles), values.reshape(-1, 2))
        for i, values in enumerate(mesh.attributes.values()):
            self.attributes.write(attribute + i * 3 * len(mesh.triangles), values.reshape(-1, 4))

    @staticmethod
    def _range(mesh: MeshData, row: int, starts: tuple, uv_count: int, attribute_count: int) -> MeshRange:
        low = mesh.positions.min(0).astype(np.float64) if len(mesh.positions) else np.zeros(3)
        high = mesh.positions.max(0).astype(np.float64) if len(mesh.positions) else np.zeros(3)
        generated = mesh.generated or (low.astype(np.float32), np.maximum(high - low, 1e-12).astype(np.float32))
        return MeshRange(
            row=row, vertex_start=starts[0], vertex_count=len(mesh.positions), triangle_start=starts[1],
            triangle_count=len(mesh.triangles), uv_start=starts[2], uv_count=uv_count, attribute_start=starts[3],
            attribute_count=attribute_count, uv_names=tuple(mesh.uv_maps), attribute_names=tuple(mesh.attributes),
            low=low, high=high, local_triangles=mesh.triangles, slots=mesh.material_slots,
            used_slots=used_slots(mesh.material_slots), generated=generated, volume=mesh.volume)

    def keep_only(self, keys: set[Key]) -> None:
        """Forget all other meshes; their room is won back by `compact`."""
        self.ranges = {key: r for key, r in self.ranges.items() if key in keys}

    def compact(self) -> bool:
        """Move meshes together where more room than WASTE_LIMIT lies idle; return whether they have moved."""
        if self.wasted <= WASTE_LIMIT:
            return False
        old = list(self.ranges.items())
        self.positions.pack([(r.vertex_start, r.vertex_count) for _, r in old])
        self.slots.pack([(r.triangle_start, r.triangle_count) for _, r in old])
        self.corners.pack([(6 * r.triangle_start, 6 * r.triangle_count) for _, r in old])
        self.uvs.pack([(r.uv_start, r.uv_count) for _, r in old])
        self.attributes.pack([(r.attribute_start, r.attribute_count) for _, r in old])
        self.triangles.pack([(r.triangle_start, r.triangle_count) for _, r in old])
        vertex = triangle = uv = attribute = 0
        for row, (key, r) in enumerate(old):
            first, count, kept = self.replaced.pop(key, (-1, 0, None))
            if first == r.vertex_start and count == r.vertex_count:
                self.replaced[key] = vertex, count, kept
            self.ranges[key] = replace(
                r, row=row, vertex_start=vertex, triangle_start=triangle, uv_start=uv, attribute_start=attribute)
            # They name vertices among all.
            self.triangles.write(triangle, r.local_triangles + np.int32(vertex))
            vertex, triangle = vertex + r.vertex_count, triangle + r.triangle_count
            uv, attribute = uv + r.uv_count, attribute + r.attribute_count
        self.triangles.flush()
        self.replaced = {key: moved for key, moved in self.replaced.items() if key in self.ranges}
        self.rows, self._tables = len(old), None
        return True

    def uv_id(self, name: str) -> int:
        """Return the id of a UV map by name: 0 (the empty name) is each mesh's active render map; -1 unknown."""
        return self.uv_names.index(name) if name in self.uv_names else -1

    def attribute_id(self, name: str) -> int:
        """Return the id of an attribute by name: 0 (the empty name) is each mesh's first one; -1 unknown."""
        return self.attribute_names.index(name) if name in self.attribute_names else -1

    def tables(self) -> tuple[wp.array, wp.array]:
        """Return the offset tables of UV maps [row, uv id] and attributes [row, attribute id]."""
        if self._tables is None:
            uv = np.full((max(self.rows, 1), len(self.uv_names)), -1, np.int32)
            attribute = np.full((max(self.rows, 1), len(self.attribute_names)), -1, np.int32)
            for r in self.ranges.values():
                for i, name in enumerate(r.uv_names):
                    uv[r.row, self.uv_names.index(name)] = r.uv_start + i * 3 * r.triangle_count
                if r.uv_names:
                    uv[r.row, 0] = r.uv_start
                for i, name in enumerate(r.attribute_names):
                    column = self.attribute_names.index(name)
                    attribute[r.row, column] = r.attribute_start + i * 3 * r.triangle_count
                if r.attribute_names and not r.attribute_names[0].startswith("."):
                    attribute[r.row, 0] = r.attribute_start
            self._tables = (
                wp.array(uv, dtype=wp.int32, device=self.device),
                wp.array(attribute, dtype=wp.int32, device=self.device))
        return self._tables
