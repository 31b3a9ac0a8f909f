# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that only moved: places are read, in bulk where there are instances, and nothing else is read again.

A walk over all instances takes 30 us an object, and while one object is dragged through a scene each step would wait
for it. After a walk the objects that the update named are remembered as they looked; while updates name those alone,
and they look the same, the walk would find what it found before, at other places. An update names all objects whose
places have been evaluated anew, so that without instances no others need be asked where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...engine.instance_rows import moved_rows
from ...engine.object_properties import split_name
from ...engine.scene import InstanceTable, LightData
from .instances import Gathered, placeable, ray_visibility, read_transforms, uppermost
from .linking import links_of
from .properties import property_of

__all__ = ["Moves"]


@dataclass(eq=False)
class _Walked:
    """What the last walk found, of C instances in the graph and N visible ones."""

    count: int
    drawn: np.ndarray
    """int64 [N], which of the graph's each visible one is"""
    of_mesh: np.ndarray
    """bool [N], which have a mesh to draw"""
    kept: np.ndarray
    """bool [N], which are in the table"""
    table: InstanceTable
    lamps: dict[int, LightData | None]
    """By their numbers among the visible instances; None for what can't light anything"""
    transforms: np.ndarray
    """float64 [N, 4, 4]"""
    row_of: dict[int, int] | None
    """By an object's session_uid, which visible instance it is; None where there are instances of objects, or hair"""


class Moves:
    """Knows what the last walk over the instances found, and follows it to other places. Keeps nothing of bpy."""

    def __init__(self) -> None:
        self._looks: dict[int, tuple] = {}
        self._walked: _Walked | None = None

    @property
    def table(self) -> InstanceTable:
        """Of all instances where they are now; the same as long as none lies elsewhere, and then all but transforms."""
        return self._walked.table

    @property
    def lights(self) -> list[LightData]:
        """Return the objects' lamps where they are now."""
        return [lamp for lamp in self._walked.lamps.values() if lamp is not None]

    def note(self, depsgraph: bpy.types.Depsgraph, objects: list[bpy.types.Object], gathered: Gathered,
             of_mesh: np.ndarray, kept: np.ndarray, table: InstanceTable, lamps: dict[int, LightData | None]) -> None:
        """Remember a walk, and how the objects looked that the update named."""
        self._looks = _looks(depsgraph, objects, table.property_names)
        self._walked = _Walked(
            gathered.count, gathered.drawn, of_mesh, kept, table, lamps, gathered.transforms, _rows_of(gathered))

    def read(self, depsgraph: bpy.types.Depsgraph, objects: list[bpy.types.Object]) -> bool:
        """Follow `objects`, those that an update named, to where they are; False where only a walk can tell."""
        walked = self._walked
        if walked is None:
            return False
        looks = _looks(depsgraph, objects, walked.table.property_names)
        if any(self._looks.get(uid) != look for uid, look in looks.items()):
            return False
        if walked.row_of is None:
            transforms = read_transforms(depsgraph, walked.count, walked.drawn)
        else:
            transforms = _read_named(objects, walked)
        if transforms is None:
            return False
        moved = moved_rows(transforms, walked.transforms)
        near, good = placeable(transforms[moved])
        if not np.array_equal(walked.of_mesh[moved] & near & good, walked.kept[moved]):
            return False
        lamps = dict(walked.lamps)
        for index in lamps.keys() & set(moved.tolist()):
            if lamps[index] is None or not np.isfinite(transforms[index]).all():
                return False
            lamps[index] = replace(lamps[index], transform=transforms[index].copy())
        table = walked.table
        if walked.kept[moved].any():
            table = replace(table, transforms=np.ascontiguousarray(transforms[walked.kept]))
        self._walked = replace(walked, table=table, lamps=lamps, transforms=transforms)
        return True


def _rows_of(gathered: Gathered) -> dict[int, int] | None:
    """Return _Walked.row_of."""
    if any(placement.parent_uid is not None for placement in gathered.placements) or any(
            source.hair for source in gathered.sources):
        return None
    rows = {gathered.sources[source].uid: row for row, source in enumerate(gathered.source_of[gathered.rows].tolist())}
    return rows if len(rows) == len(gathered.rows) else None


def _read_named(objects: list[bpy.types.Object], walked: _Walked) -> np.ndarray:
    """Return the transforms of all visible instances, those of the objects read anew."""
    transforms = walked.transforms.copy()
    for item in objects:
        row = walked.row_of.get(item.original.session_uid)
        if row is not None:
            transforms[row] = item.matrix_world
    return transforms


def _looks(depsgraph: bpy.types.Depsgraph, objects: list[bpy.types.Object], properties: tuple[str, ...],
           ) -> dict[int, tuple]:
    view_layer = depsgraph.view_layer_eval
    return {item.original.session_uid: _look_of(item, view_layer, properties) for item in objects}


def _look_of(item: bpy.types.Object, view_layer: bpy.types.ViewLayer, properties: tuple[str, ...]) -> tuple:
    """Return all that a walk reads of an evaluated object but its place."""
    return (
        item.name, item.mode, uppermost(item).name, item.type, 0 if item.data is None else item.data.as_pointer(),
        item.hide_viewport, item.hide_render, item.instance_type, item.show_instancer_for_viewport,
        len(item.particle_systems), ray_visibility(item), item.holdout_get(view_layer=view_layer),
        item.indirect_only_get(view_layer=view_layer), item.is_shadow_catcher, item.pass_index, tuple(item.color),
        item.lightgroup, links_of(item),
        tuple(property_of((item,), split_name(name)[0]) for name in properties),
        tuple(0 if slot.material is None else slot.material.original.session_uid for slot in item.material_slots))
