# SPDX-License-Identifier: GPL-3.0-or-later
"""Acceleration structures: what is flattened into one wide BVH, what lies as instances under a wp.Bvh.

Flattening gives the fastest rays and costs memory per instance; it is done while it multiplies the unique triangles
by less than a setting. An instance that moves or deforms leaves the flattened structure (its triangles are taken out
there and the boxes above them shrink) and gets a wp.Mesh of its own, so that moving it again costs its own triangles
only; it rejoins at the next full build. Triangles that need a test per hit lie in structures of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels.flatten import flatten_vertices
from ..kernels.types import FlatTriangles, Geometry, Scene
from .geometry_store import GeometryStore, MeshRange
from .scene import Key, Visibility
from .staging import RowWriter
from .wide_bvh import WideBvh, build_wide

__all__ = ["RAY_KINDS", "FlatStructure", "InstancePlan", "Structures", "decides_layers", "is_flat"]

# Below this many flattened triangles two levels are not worth their slower rays.
ALWAYS_FLATTEN = 1 << 20

# Kinds of rays whose visibility a triangle structure must answer.
RAY_KINDS = int(
    Visibility.CAMERA | Visibility.DIFFUSE | Visibility.GLOSSY | Visibility.TRANSMISSION | Visibility.SHADOW)


def is_flat(scene: Scene) -> bool:
    """Return whether all of a scene's triangles are flattened: kernels of flat_tracing.py are enough then."""
    return int(scene.geometry.instance_bvh) == 0


def decides_layers(scene: Scene) -> bool:
    """Return whether rays decide by themselves which transparent layers stop them, for kernels of decided_layers.py."""
    return is_flat(scene) and int(scene.geometry.flat_filtered.decided) == 1


@dataclass
class InstancePlan:
    """What the structures must know of all N instances."""

    mesh_keys: list[Key]
    """M distinct meshes"""
    mesh_index: np.ndarray
    """int [N], -1 for instances that are not drawn"""
    filtered_slots: list[tuple[bool, ...]]
    """Per instance group: which material slots need a test per hit"""
    group_index: np.ndarray
    """int [N], index into filtered_slots"""
    low: np.ndarray
    high: np.ndarray
    """float64 [N, 3], bounds in world space"""
    scattering: np.ndarray
    """bool [N]: which instances scatter light below their surface"""


@dataclass
class _LocalMesh:
    """Object-space structures of one mesh under one choice of filtered slots."""

    opaque: wp.Mesh | None
    filtered: wp.Mesh | None
    opaque_faces: np.ndarray
    filtered_faces: np.ndarray
    """int32, triangles (global) per face"""
    first_opaque: int = 0
    first_filtered: int = 0


class FlatStructure:
    """Triangles of flattened instances in world space."""

    def __init__(self, device: str):
        self.device = device
        self.wide: WideBvh | None = None
        """None without triangles"""
        self.faces = wp.zeros(1, dtype=wp.vec2i, device=device)
        """(instance, triangle) per face"""
        self.decided = False
        """Whether rays decide by themselves which triangles stop them, FlatTriangles.decided"""
        self._nothing = wp.empty(0, dtype=wp.uint32, device=device)

    def build(
        self, points: wp.array, indices: list[np.ndarray], faces: list[np.ndarray], *, splitting: bool = True,
    ) -> None:
        """Build over triangles: indices into world-space points and (instance, triangle) of each, in parts."""
        if sum(len(part) for part in indices) == 0:
            return
        self.wide = build_wide(
            points, wp.array(np.concatenate(indices).ravel(), dtype=int, device=self.device), splitting=splitting)
        self.faces = wp.array(np.concatenate(faces), dtype=wp.vec2i, device=self.device)

    def struct(self) -> FlatTriangles:
        """Return it as kernels take it."""
        flat = FlatTriangles()
        flat.nodes = self._nothing if self.wide is None else self.wide.nodes
        flat.triangles = self._nothing if self.wide is None else self.wide.triangles
        flat.faces = self.faces
        flat.decided = int(self.decided)
        return flat


class Structures:
    """Builds and keeps the acceleration structures of one device."""

    def __init__(self, device: str):
        self.device = device
        self._writer = RowWriter(wp.vec3, device)
        self.clear()

    def clear(self) -> None:
        """Drop everything."""
        self.opaque = FlatStructure(self.device)
        self.filtered = FlatStructure(self.device)
        self.bvh: wp.Bvh | None = None
        self.bvh_instances = wp.zeros(1, dtype=wp.int32, device=self.device)
        self.mesh_faces = wp.zeros(1, dtype=wp.int32, device=self.device)
        self.local: dict[tuple, _LocalMesh] = {}
        self.walks: dict[Key, wp.Mesh] = {}
        """All triangles, in object space, of the meshes below whose surface light is scattered"""
        self.flat: set[int] = set()
        """The instances that are flattened"""
        self.instanced = np.zeros(0, bool)
        self._built_for: tuple[list[_LocalMesh], np.ndarray] = ([], np.zeros(0, np.int64))
        self._bounds: tuple[np.ndarray, np.ndarray] = (np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
        """Of the instances under `bvh`, as it has them"""
        self.description = "empty"

    def _static_builder(self) -> str:
        return "cubql" if wp.get_device(self.device).is_cuda and wp.is_cubql_available() else "sah"

    def build(self, plan: InstancePlan, store: GeometryStore, instances: wp.array, threshold: float) -> None:
        """Build everything anew: choose which instances are flattened, then both levels.

        Args:
            plan: All instances.
            store: The meshes.
            instances: Device array of kernels.types.Instance (transforms).
            threshold: PerformanceSettings.instancing_threshold.
        """
        self.local.clear()
        self.walks.clear()
        ranges = [store.ranges[key] for key in plan.mesh_keys]
        drawn = plan.mesh_index >= 0
        counts = np.array([r.triangle_count for r in ranges], np.int64)
        uses = np.bincount(plan.mesh_index[drawn], minlength=len(ranges))
        unique = int(counts[uses > 0].sum())
        flattened = int((counts * uses).sum())
        two_levels = flattened > ALWAYS_FLATTEN and flattened > threshold * max(unique, 1)
        self.instanced = drawn & (uses[plan.mesh_index] > 1) if two_levels else np.zeros(len(drawn), bool)
        self._build_flat(plan, ranges, instances, store, np.flatnonzero(drawn & ~self.instanced))
        self._build_instances(plan, store)
        in_levels = int(self.instanced.sum())
        flat = int(counts[plan.mesh_index[drawn & ~self.instanced]].sum())
        self.description = f"{flat:,} flattened triangles"
        if in_levels:
            self.description += f", {in_levels:,} instances of {len(self.local):,} meshes in two levels"

    def _build_flat(
        self, plan: InstancePlan, ranges: list[MeshRange], instances: wp.array, store: GeometryStore,
        chosen: np.ndarray,
    ) -> None:
        # Before there are new ones: both may not fit side by side.
        self.opaque, self.filtered, self.flat = FlatStructure(self.device), FlatStructure(self.device), set()
        vertex_instance, vertex_source = [], []
        opaque_index, opaque_face, filtered_index, filtered_face = [], [], [], []
        vertex = 0
        for i in chosen.tolist():
            r = ranges[plan.mesh_index[i]]
            if r.triangle_count == 0:
                continue
            self.flat.add(i)
            vertex_instance.append(np.full(r.vertex_count, i, np.int32))
            vertex_source.append(np.arange(r.vertex_start, r.vertex_start + r.vertex_count, dtype=np.int32))
            is_filtered = _filtered_triangles(r, plan.filtered_slots[plan.group_index[i]])
            triangle = np.arange(r.triangle_start, r.triangle_start + r.triangle_count, dtype=np.int32)
            faces = np.stack([np.full(r.triangle_count, i, np.int32), triangle], 1)
            indices = r.local_triangles + np.int32(vertex)
            if is_filtered is None:
                opaque_index.append(indices)
                opaque_face.append(faces)
            else:
                opaque_index.append(indices[~is_filtered])
                opaque_face.append(faces[~is_filtered])
                filtered_index.append(indices[is_filtered])
                filtered_face.append(faces[is_filtered])
            vertex += r.vertex_count
        if vertex == 0:
            return
        points = wp.zeros(vertex, dtype=wp.vec3, device=self.device)
        wp.launch(flatten_vertices, vertex, [
            instances, store.positions.array,
            wp.array(np.concatenate(vertex_instance), dtype=int, device=self.device),
            wp.array(np.concatenate(vertex_source), dtype=int, device=self.device), 0], [points], device=self.device)
        self.opaque.build(points, opaque_index, opaque_face)
        # A layer is met once, by which its search goes on.
        self.filtered.build(points, filtered_index, filtered_face, splitting=False)

    def _local_mesh(self, plan: InstancePlan, instance: int, store: GeometryStore, moving: bool) -> _LocalMesh:
        key = plan.mesh_keys[plan.mesh_index[instance]]
        slots = plan.filtered_slots[plan.group_index[instance]]
        local = self.local.get((key, slots))
        if local is None:
            r = store.ranges[key]
            is_filtered = _filtered_triangles(r, slots)
            if is_filtered is None:
                is_filtered = np.zeros(r.triangle_count, bool)
            triangle = np.arange(r.triangle_start, r.triangle_start + r.triangle_count, dtype=np.int32)
            points = wp.clone(store.positions.array[r.vertex_start:r.vertex_start + r.vertex_count])
            builder = "lbvh" if moving and wp.get_device(self.device).is_cuda else self._static_builder()
            local = _LocalMesh(
                self._object_mesh(points, r.local_triangles[~is_filtered], builder),
                self._object_mesh(points, r.local_triangles[is_filtered], builder),
                triangle[~is_filtered], triangle[is_filtered])
            self.local[(key, slots)] = local
        return local

    def _object_mesh(self, points: wp.array, triangles: np.ndarray, builder: str) -> wp.Mesh | None:
        if len(triangles) == 0:
            return None
        indices = wp.array(np.ascontiguousarray(triangles).ravel(), dtype=int, device=self.device)
        return wp.Mesh(points, indices, bvh_constructor=builder, bvh_leaf_size=1)

    def _build_instances(self, plan: InstancePlan, store: GeometryStore, moving: bool = False) -> None:
        """Build the object-space meshes that are missing and the structure over the instances."""
        chosen = self._under_bvh(plan)
        if len(chosen) == 0:
            self.bvh = None
            return
        used = {}
        for i in chosen.tolist():
            key = (plan.mesh_keys[plan.mesh_index[i]], plan.filtered_slots[plan.group_index[i]])
            if key not in used:
                used[key] = self._local_mesh(plan, i, store, moving)
        self.local = used
        first = 0
        for local in used.values():
            local.first_opaque = first
            local.first_filtered = first + len(local.opaque_faces)
            first = local.first_filtered + len(local.filtered_faces)
        bounds = _outer_bounds(plan, chosen)
        if moving and self._refit(used, chosen, bounds):
            return
        faces = [part for local in used.values() for part in (local.opaque_faces, local.filtered_faces)]
        self.mesh_faces = wp.array(np.concatenate(faces), dtype=int, device=self.device)
        self.bvh_instances = wp.array(chosen.astype(np.int32), dtype=int, device=self.device)
        low = wp.array(bounds[0], dtype=wp.vec3, device=self.device)
        high = wp.array(bounds[1], dtype=wp.vec3, device=self.device)
        self._built_for, self._bounds = (list(used.values()), chosen), bounds
        self.bvh = wp.Bvh(low, high, constructor="sah" if len(chosen) < 4096 or self.device == "cpu" else "lbvh")

    def _under_bvh(self, plan: InstancePlan) -> np.ndarray:
        """Return, ascending, the instances that are not flattened."""
        return np.flatnonzero(self.instanced & (plan.mesh_index >= 0))

    def _refit(self, used: dict, chosen: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> bool:
        """Rebuild the structure over the instances in place if it has the same ones; return whether it had.

        Ids stay as they are, so a recorded frame goes on using it.
        """
        meshes, instances = self._built_for
        same = (self.bvh is not None and len(meshes) == len(used) and np.array_equal(instances, chosen)
                and all(a is b for a, b in zip(meshes, used.values(), strict=True)))
        if same:
            self._bounds = bounds
            self._rebuild(np.arange(len(chosen)))
        return same

    def _rebuild(self, places: np.ndarray) -> None:
        """Rebuild the structure over the instances for other bounds of some (ascending places in it)."""
        for array, bounds in zip((self.bvh.lowers, self.bvh.uppers), self._bounds, strict=True):
            self._writer.write(array, bounds, places)
        self.bvh.rebuild()

    def follow(self, plan: InstancePlan, moved: np.ndarray) -> bool:
        """Follow instances (ascending) that have moved before to where they are; False where some have not.

        No instance may have another mesh, or come or go. What kernels read of the structures stays the same.
        """
        if self.bvh is None or not self.instanced[moved].all():
            return False
        places = np.searchsorted(self._built_for[1], moved)
        for bounds, new in zip(self._bounds, _outer_bounds(plan, moved), strict=True):
            bounds[places] = new
        self._rebuild(places)
        return True

    def leave_flat(self, moved: np.ndarray) -> None:
        """Take instances out of the flattened structure (not yet into the other)."""
        leaving = self.flat.intersection(moved.tolist())
        if leaving:
            marks = np.zeros(len(self.instanced), np.int32)
            marks[list(leaving)] = 1
            marks = wp.array(marks, dtype=int, device=self.device)
            for part in (self.opaque, self.filtered):
                if part.wide is not None:
                    part.wide.take_out(part.faces, marks)
            self.flat -= leaving
        self.instanced[moved] = True

    def update_instances(self, plan: InstancePlan, store: GeometryStore, changed_meshes: set[Key]) -> None:
        """Rebuild the upper level after instances moved or meshes changed."""
        self.local = {key: local for key, local in self.local.items() if key[0] not in changed_meshes}
        self.walks = {key: mesh for key, mesh in self.walks.items() if key not in changed_meshes}
        self._build_instances(plan, store, moving=True)
        count = int(self.instanced.sum())
        self.description = f"{len(self.flat):,} objects flattened, {count:,} moving or instanced in two levels"

    def write(self, geometry: Geometry) -> None:
        """Write the structures into the kernels' struct."""
        geometry.flat = self.opaque.struct()
        geometry.flat_filtered = self.filtered.struct()
        geometry.instance_bvh = self.bvh.id if self.bvh is not None else 0
        geometry.bvh_instances = self.bvh_instances
        geometry.mesh_faces = self.mesh_faces

    def _make_walks(self, plan: InstancePlan, store: GeometryStore) -> np.ndarray:
        """Build the meshes for walks below surfaces that are missing; return, ascending, the instances with them."""
        chosen = np.flatnonzero(plan.scattering & (plan.mesh_index >= 0))
        before, self.walks = self.walks, {}
        for mesh in np.unique(plan.mesh_index[chosen]).tolist():
            key = plan.mesh_keys[mesh]
            r = store.ranges[key]
            points = store.positions.array[r.vertex_start:r.vertex_start + r.vertex_count]
            self.walks[key] = before.get(key) or self._object_mesh(
                wp.clone(points), r.local_triangles, self._static_builder())
        return chosen

    def fill(self, rows: np.ndarray, plan: InstancePlan, store: GeometryStore) -> None:
        """Write the structures' ids into the structured array of instances."""
        rows["walk_mesh"] = 0
        for i in self._make_walks(plan, store).tolist():
            rows["walk_mesh"][i] = self.walks[plan.mesh_keys[plan.mesh_index[i]]].id
        rows["opaque_bvh"] = 0
        rows["filtered_bvh"] = 0
        for i in self._under_bvh(plan).tolist():
            local = self.local[(plan.mesh_keys[plan.mesh_index[i]], plan.filtered_slots[plan.group_index[i]])]
            rows["opaque_bvh"][i] = local.opaque.id if local.opaque is not None else 0
            rows["filtered_bvh"][i] = local.filtered.id if local.filtered is not None else 0
            rows["opaque_faces"][i] = local.first_opaque
            rows["filtered_faces"][i] = local.first_filtered

    @property
    def has_filtered(self) -> bool:
        """Return whether any triangle needs a test per hit."""
        return self.filtered.wide is not None or any(local.filtered is not None for local in self.local.values())


def _outer_bounds(plan: InstancePlan, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of some instances, rounded outwards: float32 of a float64 bound may lie inside it."""
    low, high = plan.low[chosen], plan.high[chosen]
    grow = 4e-7 * np.maximum(np.abs(low), np.abs(high)) + 1e-30
    return (low - grow).astype(np.float32), (high + grow).astype(np.float32)


def _filtered_triangles(r: MeshRange, filtered_slots: tuple[bool, ...]) -> np.ndarray | None:
    """Return which triangles of a mesh need a test per hit, None where none does."""
    if not any(filtered_slots):
        return None
    return np.asarray(filtered_slots, bool)[np.minimum(r.slots, len(filtered_slots) - 1)]
