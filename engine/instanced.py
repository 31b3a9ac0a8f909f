# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of instances that are not flattened, and the levels over them: instance_level.py builds both.

A mesh has a tree of its opaque triangles and one of those that need a test per hit; of the latter each set of materials
has its own, for the opacity maps (opacity_maps.py). Trees of edited meshes are built to be edited again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import types
from .flat_structure import FlatStructure
from .geometry_store import GeometryStore, MeshRange
from .instance_level import InstanceLevel, MeshTree, ObjectTrees
from .instance_plan import InstancePlan, filtered_triangles, outer_bounds
from .scene import Key

__all__ = ["InstancedMeshes"]

Use = tuple[Key, tuple[bool, ...], tuple[Key, ...]]
"""A mesh, which of its slots need a test, and where any does the slots' materials"""


@dataclass
class _Part:
    """A mesh's triangles of one kind."""

    faces: np.ndarray
    """int32 [T], triangles within the mesh"""
    tree: MeshTree | None = None
    built: ObjectTrees | None = None
    """Those that it is among"""

    def corners(self, r: MeshRange) -> np.ndarray:
        """Return int32 [T, 3], indices into all positions."""
        return r.local_triangles[self.faces] + np.int32(r.vertex_start)


@dataclass
class _LocalMesh:
    """One mesh under one choice of what needs a test."""

    opaque: _Part
    filtered: _Part
    edited: bool

    @property
    def parts(self) -> tuple[_Part, _Part]:
        """Return both."""
        return self.opaque, self.filtered


class InstancedMeshes:
    """Object-space trees, and the levels of instances over them, on one device."""

    def __init__(self, device: str):
        self.device = device
        self.opaque: InstanceLevel | None = None
        self.filtered: InstanceLevel | None = None
        """Over the instances that have triangles of the kind"""
        self.local: dict[Use, _LocalMesh] = {}
        self.masked: list[tuple[FlatStructure, np.ndarray]] = []
        """See Structures.masked"""
        self._mesh_faces = wp.zeros(1, dtype=wp.int32, device=device)
        none = np.zeros(0, np.int64)
        self._built_for: tuple[list[_LocalMesh], np.ndarray, np.ndarray] = [], none, none
        """The meshes of the levels, their instances, and which mesh each is of"""

    def update(self, plan: InstancePlan, chosen: np.ndarray, store: GeometryStore, edited: set[Key]) -> None:
        """Build what is missing, in place where instances or vertices have only moved.

        Args:
            plan: All instances.
            chosen: int, ascending: those that are not flattened.
            store: The meshes.
            edited: Those that have changed since the last time.

        Raises:
            InvalidScene: A mesh has too many triangles.
        """
        self._follow_edits(store, edited)
        used, local_of = _used_meshes(plan, chosen)
        self.local = {use: self.local[use] for use in used if use in self.local}
        for again in (False, True):
            missing = [use for use in used if use not in self.local and (use[0] in edited) == again]
            self._build_trees(missing, store, again)
        meshes = [self.local[use] for use in used]
        low, high = outer_bounds(plan, chosen)
        triangles = [store.ranges[use[0]].triangle_start + part.faces for use, local in zip(used, meshes, strict=True)
                     for part in local.parts]
        faces = np.concatenate([*triangles, np.zeros(1, np.int32)]).astype(np.int32)
        before, self._built_for = self._built_for, (meshes, chosen, local_of)
        if (len(before[0]) == len(meshes) and all(a is b for a, b in zip(before[0], meshes, strict=True))
                and all(map(np.array_equal, before[1:], (chosen, local_of))) and self._move(chosen, low, high)):
            # All stays where it is, so a recorded frame goes on using it.
            if edited:
                self._mesh_faces.assign(faces)
            return
        self._mesh_faces = wp.array(faces, dtype=int, device=self.device)
        starts = np.concatenate([[0], np.cumsum([len(part) for part in triangles])]).astype(np.int64)
        levels = []
        for kind in range(2):
            parts = [local.parts[kind] for local in meshes]
            has = np.array([part.tree is not None for part in parts], bool)[local_of]
            trees = [part.tree and (part.tree, int(start)) for part, start in zip(parts, starts[kind::2], strict=False)]
            levels.append(InstanceLevel(
                chosen[has], low[has], high[has], local_of[has], trees, self.device) if has.any() else None)
        self.opaque, self.filtered = levels
        self._find_masked(store, used, chosen, local_of)

    def _build_trees(self, missing: list[Use], store: GeometryStore, edited: bool) -> None:
        for use in missing:
            r = store.ranges[use[0]]
            is_filtered = filtered_triangles(r, use[1])
            if is_filtered is None:
                is_filtered = np.zeros(r.triangle_count, bool)
            self.local[use] = _LocalMesh(
                *(_Part(np.flatnonzero(kind).astype(np.int32)) for kind in (~is_filtered, is_filtered)), edited)
        for kind in range(2):
            parts = {use: self.local[use].parts[kind] for use in missing if len(self.local[use].parts[kind].faces)}
            if parts:
                # A layer is met once, by which its search goes on; and maps lie where splits are told.
                built = ObjectTrees(
                    store.positions.array, [part.corners(store.ranges[use[0]]) for use, part in parts.items()],
                    deforming=edited, opaque=kind == 0)
                for part, tree in zip(parts.values(), built.trees, strict=True):
                    part.tree, part.built = tree, built

    def _follow_edits(self, store: GeometryStore, edited: set[Key]) -> None:
        """Fit trees to edited meshes where that is possible, drop them where it is not."""
        kept, dropped = {}, set()
        for use, local in self.local.items():
            if use[0] in edited:
                r = store.ranges.get(use[0])
                same = r is not None and local.edited and self._has_same_faces(use, r)
                kept.update({id(part.built): part.built for part in local.parts if part.built} if same else {})
                dropped.update(set() if same and r.triangle_count else {use})
        for built in kept.values():
            among = [(use, part) for use, local in self.local.items() for part in local.parts if part.built is built]
            known = all(use[0] in edited and use not in dropped for use, _ in among)
            if not (known and built.follow(
                    store.positions.array, [part.corners(store.ranges[use[0]]) for use, part in among])):
                dropped.update(use for use, _ in among if use[0] in edited)
        for use in dropped:
            del self.local[use]

    def _has_same_faces(self, use: Use, r: MeshRange) -> bool:
        filtered = filtered_triangles(r, use[1])
        expected = np.zeros(0, np.int64) if filtered is None else np.flatnonzero(filtered)
        opaque, filtered = (part.faces for part in self.local[use].parts)
        return len(opaque) + len(filtered) == r.triangle_count and np.array_equal(filtered, expected)

    def _find_masked(
        self, store: GeometryStore, used: list[Use], chosen: np.ndarray, local_of: np.ndarray,
    ) -> None:
        """Find the structures that may have opacity maps; edited meshes may have other UV maps and have none."""
        known = {id(flat.wide): (flat, among) for flat, among in self.masked}
        examples = chosen[np.unique(local_of, return_index=True)[1]]
        among: dict[int, list[tuple[int, _Part, int, int]]] = {}
        for use, example in zip(used, examples.tolist(), strict=True):
            part = self.local[use].filtered
            if part.tree is not None and not self.local[use].edited:
                among.setdefault(id(part.tree.wide), []).append(
                    (part.tree.faces, part, example, store.ranges[use[0]].triangle_start))
        self.masked = []
        for key, members in among.items():
            flat, before = known.get(key) or (FlatStructure(self.device), None)
            if before is not None and np.isin(before, chosen).all():
                # Each is of its mesh still: what is known of the triangles stays.
                self.masked.append((flat, before))
                continue
            flat.wide = wide = members[0][1].tree.wide
            # Of meshes that are gone something else is told, which nobody asks for.
            faces = np.tile(np.array([members[0][2], members[0][3]], np.int32), (wide.references, 1))
            for first, part, example, start in members:
                faces[first : first + len(part.faces)] = np.stack(
                    [np.full(len(part.faces), example), start + part.faces], 1)
            flat.faces = wp.array(faces, dtype=wp.vec2i, device=self.device)
            self.masked.append((flat, np.array([example for _, _, example, _ in members], np.int64)))

    @property
    def decided(self) -> bool:
        """Return whether rays decide by themselves which of their triangles stop them."""
        return all(flat.decided for flat, _ in self.masked) and not any(
            local.edited and local.filtered.tree is not None for local in self.local.values())

    def _levels(self) -> list[InstanceLevel]:
        return [level for level in (self.opaque, self.filtered) if level is not None]

    def _move(self, moved: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
        """Follow instances (ascending) to other bounds, in place; return whether all levels could."""
        for level in self._levels():
            mine = level.holds(moved)
            if mine.any() and not level.move(moved[mine], low[mine], high[mine]):
                return False
        return True

    def follow(self, moved: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
        """Follow instances (ascending), none of them flattened, to other bounds; False where that can't be done."""
        return bool(self._levels()) and self._move(moved, low, high)

    def place(self, instances: wp.array) -> None:
        """Take over the transforms of kernels.types.Instance [N], and where trees lie."""
        for level in self._levels():
            level.write_records(instances)

    def write(self, geometry: types.Geometry) -> None:
        """Write what kernels read of it into their struct."""
        geometry.instanced, geometry.instanced_filtered = (
            types.InstanceLevel() if level is None else level.struct() for level in (self.opaque, self.filtered))
        geometry.instanced_filtered.decided = int(self.decided)
        geometry.mesh_faces = self._mesh_faces


def _used_meshes(plan: InstancePlan, chosen: np.ndarray) -> tuple[list[Use], np.ndarray]:
    """Return the distinct uses of meshes by instances, and which of them each is, int [len(chosen)]."""
    of_groups = plan.tested()
    numbers = {each: i for i, each in enumerate(dict.fromkeys(of_groups))}
    number_of = np.array([numbers[each] for each in of_groups], np.int64)
    pairs = plan.mesh_index[chosen] * len(numbers) + number_of[plan.group_index[chosen]]
    distinct, local_of = np.unique(pairs, return_inverse=True)
    each = list(numbers)
    return [(plan.mesh_keys[pair // len(each)], *each[pair % len(each)]) for pair in distinct.tolist()], local_of
