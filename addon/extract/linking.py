# SPDX-License-Identifier: GPL-3.0-or-later
"""Light and shadow linking: which objects lamps and emissive meshes of a walk are for, and which cast their shadows.

Follows Blender's depsgraph_light_linking.cc and Cycles' light_linking.cpp: what belongs to a child collection has that
child's state, of several states the last counts, and an instance goes by its instancer if any set names that. Main
thread only; keeps nothing of bpy.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np

from ...engine.light_linking import RECEIVER_SETS, ReceiverSets, number_sets
from ...engine.report import Report, ReportKind

__all__ = ["Linking", "links_of"]


class Linking:
    """The receiver and blocker collections of one walk: read object by object, then numbered."""

    def __init__(self) -> None:
        self._members: dict[int, dict[int, bool]] = {}
        self._owners: dict[int, list[str]] = {}
        self._sets: ReceiverSets = number_sets({})

    def read(self, item: bpy.types.Object) -> tuple[int | None, int | None]:
        """Return keys of the sets of what an object's light is for and of what casts its shadows; None: everything."""
        linking = item.original.light_linking
        if linking is None:
            return None, None
        return self._key(linking.receiver_collection, item), self._key(linking.blocker_collection, item)

    def _key(self, collection: bpy.types.Collection | None, item: bpy.types.Object) -> int | None:
        if collection is None:
            return None
        key = collection.session_uid
        if key not in self._members:
            self._members[key] = _members(collection)
        self._owners.setdefault(key, []).append(item.name)
        return key

    def finish(self, report: Report) -> None:
        """Number the sets, when all objects are read."""
        self._sets = number_sets(self._members)
        for key in self._sets.left_out:
            for name in dict.fromkeys(self._owners[key]):
                report.add(
                    ReportKind.APPROXIMATED, f"object '{name}'",
                    f"lights everything, or everything casts its shadows: light linking knows {RECEIVER_SETS} "
                    "different sets in a scene")

    def number(self, key: int | None) -> int:
        """Return the number of the set that `read` has returned the key of, 0 for everything."""
        return 0 if key is None else self._sets.numbers[key]

    def numbers(self, keys: tuple[int | None, int | None]) -> tuple[int, int]:
        """Return the same of both keys."""
        return self.number(keys[0]), self.number(keys[1])

    def columns(self, sources: list[Any], placements: list[Any], rows: np.ndarray) -> dict[str, np.ndarray | None]:
        """Return the columns of an InstanceTable; `rows`: int [N], the instances' placements."""
        if not self._sets.named:
            return {}
        linked_to, blocked_by, receives = [], [], []
        for placement in placements:
            source = sources[placement.source]
            linked_to.append(self.number(source.links[0]))
            blocked_by.append(self.number(source.links[1]))
            key = placement.parent_uid if placement.parent_uid in self._sets.named else source.uid
            receives.append(self._sets.bits(key))
        columns = {"linked_to": np.array(linked_to, np.int32)[rows], "receives": np.array(receives, np.uint32)[rows]}
        blocking = {self.number(source.links[1]) for source in sources} - {0}
        if blocking:
            bits = sum(1 << number for number in blocking)
            columns["blocked_by"] = np.array(blocked_by, np.int32)[rows]
            columns["spared"] = (columns["receives"] & bits) != bits
        return columns


def links_of(item: bpy.types.Object) -> tuple[int, int]:
    """Return the session_uid of an object's receiver and blocker collections, 0 for none."""
    linking = item.original.light_linking
    if linking is None:
        return 0, 0
    receiver, blocker = linking.receiver_collection, linking.blocker_collection
    return (0 if receiver is None else receiver.session_uid), (0 if blocker is None else blocker.session_uid)


def _members(collection: bpy.types.Collection) -> dict[int, bool]:
    """Return whether a collection includes (True) or excludes its objects, by their session_uid."""
    members = {}
    for child, settings in zip(collection.children, collection.collection_children, strict=True):
        members |= dict.fromkeys(_objects(child), settings.light_linking.link_state == 'INCLUDE')
    for item, settings in zip(collection.objects, collection.collection_objects, strict=True):
        members[item.session_uid] = settings.light_linking.link_state == 'INCLUDE'
    return members


def _objects(collection: bpy.types.Collection) -> Iterable[int]:
    """Yield the session_uid of all objects in a collection and in those within it."""
    for child in collection.children:
        yield from _objects(child)
    for item in collection.objects:
        yield item.session_uid
