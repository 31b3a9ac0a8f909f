# SPDX-License-Identifier: GPL-3.0-or-later
"""Acceleration structures: what is flattened into one wide BVH, what lies as instances under another.

Flattening gives the fastest rays and costs memory per instance; it is done while it multiplies the unique triangles
by less than a setting. An instance that moves or deforms leaves the flattened structure (its triangles are taken out
there and the boxes above them shrink) and gets a tree of its own (instance_level.py), so that moving it again costs a
few boxes only; it rejoins at the next full build. Triangles that need a test per hit lie in structures of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp

from ..kernels import types
from ..kernels.flatten import flatten_vertices
from ..kernels.types import FlatTriangles, Geometry, Scene
from .geometry_store import GeometryStore, MeshRange
from .instance_level import InstanceLevel, MeshTree, ObjectTrees
from .scene import Key, Visibility
from .wide_bvh import WideBvh, build_wide

__all__ = ["RAY_KINDS", "FlatStructure", "InstancePlan", "Structures", "decides_layers", "is_flat"]

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
    """Object-space trees of one mesh under one choice of filtered slots."""

    opaque: MeshTree | None
    filtered: MeshTree | None
    opaque_faces: np.ndarray
    filtered_faces: np.ndarray
    """int32, triangles within the mesh per face"""
    built: ObjectTrees | None
    """Those that they are among"""

    def parts(self, r: MeshRange) -> list[np.ndarray]:
        """Return the triangles of its trees as int32 [T, 3], indices into all positions."""
        chosen = [faces for faces in (self.opaque_faces, self.filtered_faces) if len(faces)]
        return [r.local_triangles[faces] + np.int32(r.vertex_start) for faces in chosen]


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
        self.clear()

    def clear(self) -> None:
        """Drop everything."""
        self.opaque = FlatStructure(self.device)
        self.filtered = FlatStructure(self.device)
        self.level: InstanceLevel | None = None
        self.level_filtered: InstanceLevel | None = None
        """Over those that are not flattened and have triangles of the kind"""
        self.mesh_faces = wp.zeros(1, dtype=wp.int32, device=self.device)
        self.local: dict[tuple, _LocalMesh] = {}
        self.walks: dict[Key, wp.Mesh] = {}
        """All triangles, in object space, of the meshes below whose surface light is scattered"""
        self.flat: set[int] = set()
        """The instances that are flattened"""
        self.instanced = np.zeros(0, bool)
        self._built_for: tuple[list[_LocalMesh], np.ndarray, np.ndarray] = ([], *(np.zeros(0, np.int64),) * 2)
        """The meshes of the levels, their instances, and which mesh each is of"""
        self.description = "empty"

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
        self._build_instances(plan, store, set())
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

    def _used_meshes(self, plan: InstancePlan, chosen: np.ndarray) -> tuple[list[tuple], np.ndarray]:
        """Return the distinct (mesh, filtered slots) of instances, and which of them each has, int [len(chosen)]."""
        numbers = {slots: i for i, slots in enumerate(dict.fromkeys(plan.filtered_slots))}
        slots_of = np.array([numbers[slots] for slots in plan.filtered_slots], np.int64)
        pairs = plan.mesh_index[chosen] * len(numbers) + slots_of[plan.group_index[chosen]]
        distinct, local_of = np.unique(pairs, return_inverse=True)
        slots = list(numbers)
        return [(plan.mesh_keys[pair // len(slots)], slots[pair % len(slots)]) for pair in distinct.tolist()], local_of

    def _build_trees(self, used: list[tuple], store: GeometryStore, edited: set[Key]) -> None:
        """Build the trees of meshes that are missing; those that were edited together, to be edited again."""
        for deforming in (False, True):
            missing = [pair for pair in used if pair not in self.local and (pair[0] in edited) == deforming]
            parts = []
            for key, slots in missing:
                r = store.ranges[key]
                is_filtered = _filtered_triangles(r, slots)
                if is_filtered is None:
                    is_filtered = np.zeros(r.triangle_count, bool)
                local = _LocalMesh(None, None, np.flatnonzero(~is_filtered).astype(np.int32),
                                   np.flatnonzero(is_filtered).astype(np.int32), None)
                self.local[key, slots] = local
                parts += local.parts(r)
            if not parts:
                continue
            built = ObjectTrees(store.positions.array, parts, deforming=deforming)
            trees = iter(built.trees)
            for pair in missing:
                local = self.local[pair]
                local.built = built
                local.opaque = next(trees) if len(local.opaque_faces) else None
                local.filtered = next(trees) if len(local.filtered_faces) else None

    def _follow_edits(self, store: GeometryStore, edited: set[Key]) -> None:
        """Fit trees to edited meshes where that is possible, drop them where it is not."""
        for built in {id(local.built): local.built for pair, local in self.local.items() if pair[0] in edited}.values():
            pairs = [pair for pair, local in self.local.items() if local.built is built]
            known = built is not None and all(
                pair[0] in edited and self._has_same_faces(pair, store.ranges[pair[0]]) for pair in pairs)
            parts = [part for pair in pairs for part in self.local[pair].parts(store.ranges[pair[0]])] if known else []
            if not (known and built.follow(store.positions.array, parts)):
                for pair in pairs:
                    if pair[0] in edited:
                        del self.local[pair]

    def _has_same_faces(self, pair: tuple, r: MeshRange) -> bool:
        local, is_filtered = self.local[pair], _filtered_triangles(r, pair[1])
        filtered = np.zeros(0, np.int64) if is_filtered is None else np.flatnonzero(is_filtered)
        return (len(local.opaque_faces) + len(local.filtered_faces) == r.triangle_count
                and np.array_equal(local.filtered_faces, filtered))

    def _build_instances(self, plan: InstancePlan, store: GeometryStore, edited: set[Key]) -> None:
        """Build the object-space trees that are missing and the levels over the instances."""
        chosen = self._under_levels(plan)
        used, local_of = self._used_meshes(plan, chosen)
        self.local = {pair: self.local[pair] for pair in used if pair in self.local}
        self._build_trees(used, store, edited)
        meshes = [self.local[pair] for pair in used]
        low, high = _outer_bounds(plan, chosen)
        triangles = [store.ranges[key].triangle_start + faces for (key, _), local in zip(used, meshes, strict=True)
                     for faces in (local.opaque_faces, local.filtered_faces)]
        faces = np.concatenate([*triangles, np.zeros(1, np.int32)]).astype(np.int32)
        before, self._built_for = self._built_for, (meshes, chosen, local_of)
        if (len(before[0]) == len(meshes) and all(a is b for a, b in zip(before[0], meshes, strict=True))
                and all(map(np.array_equal, before[1:], (chosen, local_of))) and self._move(chosen, low, high)):
            # All stays where it is, so a recorded frame goes on using it.
            if edited:
                self.mesh_faces.assign(faces)
            return
        self.mesh_faces = wp.array(faces, dtype=int, device=self.device)
        starts = np.concatenate([[0], np.cumsum([len(part) for part in triangles])])[:-1].astype(np.int64)
        build = partial(self._build_level, chosen, low, high, local_of)
        self.level = build([local.opaque for local in meshes], starts[0::2])
        self.level_filtered = build([local.filtered for local in meshes], starts[1::2])

    def _build_level(
        self, chosen: np.ndarray, low: np.ndarray, high: np.ndarray, local_of: np.ndarray,
        trees: list[MeshTree | None], first: np.ndarray,
    ) -> InstanceLevel | None:
        has = np.array([tree is not None for tree in trees], bool)[local_of]
        if not has.any():
            return None
        rows = [(0,) * 6 if tree is None else tree.row(int(start)) for tree, start in zip(trees, first, strict=True)]
        return InstanceLevel(chosen[has], low[has], high[has], local_of[has], np.array(rows, np.int64), self.device)

    def _under_levels(self, plan: InstancePlan) -> np.ndarray:
        """Return, ascending, the instances that are not flattened."""
        return np.flatnonzero(self.instanced & (plan.mesh_index >= 0))

    def _levels(self) -> list[InstanceLevel]:
        return [level for level in (self.level, self.level_filtered) if level is not None]

    def _move(self, moved: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
        """Follow instances (ascending) to other bounds, in place; return whether all levels could."""
        for level in self._levels():
            mine = np.isin(moved, level.chosen, assume_unique=True)
            if mine.any() and not level.move(moved[mine], low[mine], high[mine]):
                return False
        return True

    def follow(self, plan: InstancePlan, moved: np.ndarray) -> bool:
        """Follow instances (ascending) that have moved before to where they are; False where that can't be done.

        No instance may have another mesh, or come or go. What kernels read of the structures stays the same.
        """
        return bool(self._levels()) and bool(self.instanced[moved].all()) and self._move(
            moved, *_outer_bounds(plan, moved))

    def place(self, instances: wp.array) -> None:
        """Take over the transforms of kernels.types.Instance [N] where they may have changed."""
        for level in self._levels():
            level.write_records(instances)

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
        self._follow_edits(store, changed_meshes)
        self.walks = {key: mesh for key, mesh in self.walks.items() if key not in changed_meshes}
        self._build_instances(plan, store, changed_meshes)
        count = int(self.instanced.sum())
        self.description = f"{len(self.flat):,} objects flattened, {count:,} moving or instanced in two levels"

    def write(self, geometry: Geometry) -> None:
        """Write the structures into the kernels' struct."""
        geometry.flat = self.opaque.struct()
        geometry.flat_filtered = self.filtered.struct()
        geometry.instanced, geometry.instanced_filtered = (
            types.InstanceLevel() if level is None else level.struct() for level in (self.level, self.level_filtered))
        geometry.mesh_faces = self.mesh_faces

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
        return self.filtered.wide is not None or self.level_filtered is not None


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
