# SPDX-License-Identifier: GPL-3.0-or-later
"""Acceleration structures: what is flattened into one wide BVH, what lies as instances under another.

Flattening gives the fastest rays and costs memory per instance; it is done while it multiplies the unique triangles
by less than a setting. An instance that moves or deforms leaves the flattened structure (its triangles are taken out
there and the boxes above them shrink) and gets a tree of its own (instanced.py), so that moving it again costs a
few boxes only; it rejoins at the next full build. Triangles that need a test per hit lie in structures of their own.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ..kernels.flatten import flatten_vertices
from ..kernels.types import Geometry, InstanceLevel, Scene
from .device import launch
from .flat_structure import FlatStructure
from .geometry_store import GeometryStore, MeshRange
from .history import copy_struct
from .instance_plan import InstancePlan, filtered_triangles, outer_bounds
from .instanced import InstancedMeshes
from .scene import Key, Visibility

__all__ = ["RAY_KINDS", "Structures", "decides_layers", "has_layers", "is_flat", "without_opaque"]

# Below this many flattened triangles two levels are not worth their slower rays.
ALWAYS_FLATTEN = 1 << 20

# Kinds of rays whose visibility a triangle structure must answer.
RAY_KINDS = int(
    Visibility.CAMERA | Visibility.DIFFUSE | Visibility.GLOSSY | Visibility.TRANSMISSION | Visibility.SHADOW)


def is_flat(scene: Scene) -> bool:
    """Return whether all of a scene's triangles are flattened: kernels of flat_tracing.py are enough then."""
    geometry = scene.geometry
    return int(geometry.instanced.nodes) == 0 and int(geometry.instanced_filtered.nodes) == 0


def decides_layers(scene: Scene) -> bool:
    """Return whether rays decide by themselves which transparent layers stop them.

    For kernels of decided_layers.py, and of decided_instances.py where not all is flattened.
    """
    flat, level = scene.geometry.flat_filtered, scene.geometry.instanced_filtered
    if is_flat(scene):
        return int(flat.decided) == 1
    return (flat.nodes.shape[0] == 0 or int(flat.decided) == 1) and (int(level.nodes) == 0 or int(level.decided) == 1)


def has_layers(scene: Scene) -> bool:
    """Return whether any triangle needs a test per hit."""
    return scene.geometry.flat_filtered.nodes.shape[0] > 0 or int(scene.geometry.instanced_filtered.nodes) != 0


def without_opaque(scene: Scene) -> Scene:
    """Return a scene whose rays meet nothing but triangles that need a test per hit."""
    changed, geometry = copy_struct(scene), copy_struct(scene.geometry)
    geometry.flat, geometry.instanced = FlatStructure(str(geometry.instances.device)).struct(), InstanceLevel()
    # Structs hold copies of those in them.
    changed.geometry = geometry
    return changed


class Structures:
    """Builds and keeps the acceleration structures of one device."""

    def __init__(self, device: str):
        self.device = device
        self.clear()

    def clear(self) -> None:
        """Drop everything."""
        self.opaque = FlatStructure(self.device)
        self.filtered = FlatStructure(self.device)
        self.levels = InstancedMeshes(self.device)
        """Those that are not flattened"""
        self.walks: dict[Key, wp.Mesh] = {}
        """All triangles, in object space, of the meshes below whose surface light is scattered"""
        self.flat: set[int] = set()
        """The instances that are flattened"""
        self.instanced = np.zeros(0, bool)
        self.description = "empty"

    def build(self, plan: InstancePlan, store: GeometryStore, instances: wp.array, threshold: float) -> None:
        """Build everything anew: choose which instances are flattened, then both levels.

        Args:
            plan: All instances.
            store: The meshes.
            instances: Device array of kernels.types.Instance (transforms).
            threshold: PerformanceSettings.instancing_threshold.
        """
        self.levels = InstancedMeshes(self.device)
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
        self.levels.update(plan, self._under_levels(plan), store, set())
        in_levels = int(self.instanced.sum())
        flat = int(counts[plan.mesh_index[drawn & ~self.instanced]].sum())
        self.description = f"{flat:,} flattened triangles"
        if in_levels:
            self.description += f", {in_levels:,} instances of {len(self.levels.local):,} meshes in two levels"

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
            is_filtered = filtered_triangles(r, plan.filtered_slots[plan.group_index[i]])
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
        launch(flatten_vertices, vertex, [
            instances, store.positions.array,
            wp.array(np.concatenate(vertex_instance), dtype=int, device=self.device),
            wp.array(np.concatenate(vertex_source), dtype=int, device=self.device), 0], [points], self.device)
        self.opaque.build(points, opaque_index, opaque_face)
        # A layer is met once, by which its search goes on.
        self.filtered.build(points, filtered_index, filtered_face, opaque=False)

    def _under_levels(self, plan: InstancePlan) -> np.ndarray:
        """Return, ascending, the instances that are not flattened."""
        return np.flatnonzero(self.instanced & (plan.mesh_index >= 0))

    def follow(self, plan: InstancePlan, moved: np.ndarray) -> bool:
        """Follow instances (ascending) that have moved before to where they are; False where that can't be done.

        No instance may have another mesh, or come or go. What kernels read of the structures stays the same.
        """
        return bool(self.instanced[moved].all()) and self.levels.follow(moved, *outer_bounds(plan, moved))

    def place(self, instances: wp.array) -> None:
        """Take over the transforms of kernels.types.Instance [N] where they may have changed."""
        self.levels.place(instances)

    def masked(self) -> list[tuple[FlatStructure, np.ndarray]]:
        """Return the structures of triangles that need a test and may have opacity maps, and whose triangles they are.

        Those are instances (int); of those that share triangles in object space one.
        """
        flat = [(self.filtered, np.array(sorted(self.flat), np.int64))] if self.filtered.wide is not None else []
        return flat + self.levels.masked

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
        """Rebuild the levels over instances after those moved or meshes changed."""
        self.walks = {key: mesh for key, mesh in self.walks.items() if key not in changed_meshes}
        self.levels.update(plan, self._under_levels(plan), store, changed_meshes)
        count = int(self.instanced.sum())
        self.description = f"{len(self.flat):,} objects flattened, {count:,} moving or instanced in two levels"

    def write(self, geometry: Geometry) -> None:
        """Write the structures into the kernels' struct."""
        geometry.flat = self.opaque.struct()
        geometry.flat_filtered = self.filtered.struct()
        self.levels.write(geometry)

    def _make_walks(self, plan: InstancePlan, store: GeometryStore) -> np.ndarray:
        """Build the meshes for walks below surfaces that are missing; return, ascending, the instances with them."""
        chosen = np.flatnonzero(plan.scattering & (plan.mesh_index >= 0))
        before, self.walks = self.walks, {}
        for mesh in np.unique(plan.mesh_index[chosen]).tolist():
            key = plan.mesh_keys[mesh]
            self.walks[key] = before.get(key) or self._object_mesh(store, store.ranges[key])
        return chosen

    def _object_mesh(self, store: GeometryStore, r: MeshRange) -> wp.Mesh | None:
        if r.triangle_count == 0:
            return None
        cuda = wp.get_device(self.device).is_cuda
        return wp.Mesh(
            wp.clone(store.positions.array[r.vertex_start:r.vertex_start + r.vertex_count]),
            wp.array(np.ascontiguousarray(r.local_triangles).ravel(), dtype=int, device=self.device),
            bvh_constructor="cubql" if cuda and wp.is_cubql_available() else "sah", bvh_leaf_size=1)

    def fill(self, rows: np.ndarray, plan: InstancePlan, store: GeometryStore) -> None:
        """Write the structures' ids into the structured array of instances."""
        rows["walk_mesh"] = 0
        for i in self._make_walks(plan, store).tolist():
            rows["walk_mesh"][i] = self.walks[plan.mesh_keys[plan.mesh_index[i]]].id
        rows["instanced"] = 0
        rows["instanced"][self._under_levels(plan)] = 1

    @property
    def has_filtered(self) -> bool:
        """Return whether any triangle needs a test per hit."""
        return self.filtered.wide is not None or self.levels.filtered is not None
