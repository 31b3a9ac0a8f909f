# SPDX-License-Identifier: GPL-3.0-or-later
"""What an update of the dependency graph touched, and what is the same as before.

`depsgraph.updates` decides which data-blocks are read again; meshes are told apart by the session_uid of their
*evaluated* data, which Blender renews with every evaluation, so a mesh is never missed and never read twice.
Results are compared with the previous ones, so that selecting an object restarts no picture.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, fields

import bpy
import numpy as np

from ...engine.scene import InstanceTable, LightData
from .instances import Source

__all__ = ["Changes", "MeshKeys", "read_changes", "same_fields", "same_lights", "same_table"]


@dataclass(eq=False)
class Changes:
    """What has to be read again."""

    everything: bool = False
    """Materials, lamps, world and instances; evaluated meshes read before stay valid"""
    instances: bool = False
    """Placement, visibility or kind of any object may have changed"""
    geometry: set[int] = field(default_factory=set)
    """session_uid of objects whose geometry was evaluated again"""
    materials: set[int] = field(default_factory=set)
    lights: set[int] = field(default_factory=set)
    """session_uid of lamps whose data changed"""
    world: bool = False
    images: set[int] = field(default_factory=set)
    objects: list[bpy.types.Object] = field(default_factory=list)
    """Those that `instances` is for, evaluated; only valid during the extraction"""
    arranged: bool = False
    """Something else than single objects changed that may add, hide or reorder instances"""

    @property
    def only_objects(self) -> bool:
        """Whether nothing but objects changed, and of none of them its geometry."""
        return bool(self.objects) and not (self.everything or self.arranged or self.geometry or self.materials
                                           or self.lights or self.world or self.images)

    def __bool__(self) -> bool:
        return bool(self.everything or self.instances or self.materials or self.world or self.images)


# Kinds of data-block that can't change the picture by themselves: what uses them is listed on its own.
_IGNORED = (bpy.types.NodeTree, bpy.types.Camera, bpy.types.WindowManager, bpy.types.Screen, bpy.types.WorkSpace,
            bpy.types.Brush, bpy.types.Text, bpy.types.Action)


def read_changes(depsgraph: bpy.types.Depsgraph) -> Changes:
    """Return what the last evaluation changed; only meaningful inside `view_update` and depsgraph handlers."""
    changes = Changes()
    for update in depsgraph.updates:
        item = update.id
        uid = item.original.session_uid
        if isinstance(item, bpy.types.Object):
            if update.is_updated_geometry:
                changes.geometry.add(uid)
            # A camera that moves changes nothing in the scene; its visibility flags would be shading.
            if item.type != 'CAMERA' or item.is_instancer or update.is_updated_shading:
                changes.instances = True
                changes.objects.append(item)
        elif isinstance(item, bpy.types.Material):
            changes.materials.add(uid)
        elif isinstance(item, bpy.types.World):
            changes.world = True
        elif isinstance(item, bpy.types.Image):
            changes.images.add(uid)
        elif isinstance(item, bpy.types.Light):
            changes.lights.add(uid)
            changes.instances = True
        elif not isinstance(item, _IGNORED):
            changes.instances = changes.arranged = True
    return changes


class MeshKeys:
    """Gives evaluated meshes keys that survive their evaluation."""

    def __init__(self) -> None:
        self._by_version: dict[Hashable, int] = {}
        self._by_slot: dict[tuple[int, int], int] = {}
        self._next = 0

    def assign(self, sources: list[Source]) -> tuple[list[int | None], dict[int, Source]]:
        """Return the key of each source (None for lamps) and, by key, the sources whose evaluated mesh is new."""
        versions, slots = self.describe(sources)
        by_version = {version: self._by_version[version] for version in slots if version in self._by_version}
        taken = set(by_version.values())
        new = {}
        for index, version in enumerate(versions):
            if version is None or version in by_version:
                continue
            key = self._by_slot.get(slots[version])
            if key is None or key in taken:
                key = self._next
                self._next += 1
            taken.add(key)
            by_version[version] = key
            new[key] = sources[index]
        self._by_version = by_version
        self._by_slot = {slot: by_version[version] for version, slot in slots.items()}
        return [None if version is None else by_version[version] for version in versions], new

    @property
    def by_slot(self) -> dict[tuple[int, int], int]:
        """Return the keys by the slots of `describe`."""
        return self._by_slot

    @staticmethod
    def describe(sources: list[Source]) -> tuple[list[Hashable | None], dict[Hashable, tuple[int, int]]]:
        """Return each source's version and, by version, its slot: (first owner, how many meshes it had before)."""
        versions: list[Hashable | None] = []
        slots: dict[Hashable, tuple[int, int]] = {}
        counts: dict[int, int] = {}
        for source in sources:
            if source.is_light:
                versions.append(None)
                continue
            # An evaluated mesh without a number of its own is told apart by its address.
            version = source.volume or source.data.session_uid or ("address", source.data.as_pointer())
            if source.hair:
                # All that changes hair has its emitter evaluated again.
                version = ("hair", source.hair, version)
            versions.append(version)
            if version not in slots:
                ordinal = counts.get(source.uid, 0)
                counts[source.uid] = ordinal + 1
                slots[version] = (source.uid, ordinal)
        return versions, slots


def same_table(table: InstanceTable, previous: InstanceTable) -> bool:
    """Tell whether both describe the same instances."""
    if table.moved_from(previous):
        return _same(table.transforms, previous.transforms)
    return all(_same(getattr(table, item.name), getattr(previous, item.name)) for item in fields(InstanceTable))


def same_lights(lights: list[LightData], previous: list[LightData] | None) -> bool:
    """Tell whether both lists hold the same lamps in the same order."""
    return previous is not None and len(lights) == len(previous) and all(
        light is other or same_fields(light, other) for light, other in zip(lights, previous, strict=True))


def same_fields(value: object, other: object) -> bool:
    """Tell whether two dataclass values of one class hold the same; selecting a node tags its material too."""
    return all(_same(getattr(value, item.name), getattr(other, item.name)) for item in fields(value))


def _same(value: object, other: object) -> bool:
    if isinstance(value, np.ndarray) and isinstance(other, np.ndarray):
        return value.shape == other.shape and bool((value == other).all())
    if isinstance(value, np.ndarray) or isinstance(other, np.ndarray):
        return False
    if isinstance(value, LightData):
        return isinstance(other, LightData) and same_fields(value, other)
    return value == other
