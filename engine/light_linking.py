# SPDX-License-Identifier: GPL-3.0-or-later
"""Light and shadow linking: sets of objects that lights are for, or that cast their shadows: numbers and bits.

Blender's rules (its manual, "Light Linking", and depsgraph_light_linking.cc): a set names objects that it includes or
excludes. Where it includes any, its lights are for those alone; where it only excludes, for all others. Kernels test
one bit, see kernels/light_linking.py. Sets that say the same have one number: Blender makes one for each light.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..kernels.light_linking import BLOCK_SHIFT
from ..kernels.types import LINK_SHIFT
from .scene import InstanceTable, LightData

__all__ = ["RECEIVER_SETS", "ReceiverSets", "emitted_visibility", "is_linked", "number_sets", "received_bits",
           "same_links"]

RECEIVER_SETS = 31
"""Most different sets in a scene: bits of a word, but for the lowest"""

EVERYTHING = 0xFFFFFFFF
"""All bits: what objects receive where nothing is linked"""


@dataclass(frozen=True)
class ReceiverSets:
    """The sets of a scene, numbered from 1."""

    numbers: Mapping[Hashable, int]
    """Number by the keys that number_sets was given; 0: for everything"""
    left_out: tuple[Hashable, ...]
    """Keys of the sets for which there was no number"""
    named: Mapping[Hashable, int]
    """What objects receive that any set includes or excludes, by their keys: bit k for lights of set k, and bit 0"""
    others: int
    """What all others receive"""

    def bits(self, key: Hashable) -> int:
        """Return what an object receives."""
        return self.named.get(key, self.others)


def number_sets(sets: Mapping[Hashable, Mapping[Hashable, bool]], limit: int = RECEIVER_SETS) -> ReceiverSets:
    """Give sets numbers in their order; those beyond `limit` and empty ones are for everything.

    Args:
        sets: By any key, whether each includes (True) or excludes objects, by the objects' keys.
        limit: Most numbers.
    """
    known: dict[frozenset, int] = {}
    numbers, left_out = {}, []
    for key, members in sets.items():
        content = frozenset(members.items())
        if content and content not in known:
            if len(known) == limit:
                left_out.append(key)
            else:
                known[content] = len(known) + 1
        numbers[key] = known.get(content, 0)
    # One that is not named is lit by the sets that only exclude.
    others = 1 | sum(1 << number for content, number in known.items() if not any(lit for _, lit in content))
    named = {name: others for content in known for name, _ in content}
    for content, number in known.items():
        for name, lit in content:
            named[name] = named[name] | (1 << number) if lit else named[name] & ~(1 << number)
    return ReceiverSets(numbers, tuple(left_out), named, others)


def emitted_visibility(visibility: np.ndarray | int, linked_to: np.ndarray | int | None,
                       blocked_by: np.ndarray | int | None = None) -> np.ndarray | int:
    """Return visibility as lights and instances on the device have it: with the numbers of the sets."""
    if linked_to is not None:
        visibility = visibility | (linked_to << int(LINK_SHIFT))
    return visibility if blocked_by is None else visibility | (blocked_by << int(BLOCK_SHIFT))


def received_bits(table: InstanceTable) -> np.ndarray:
    """Return Instance.receives of all instances, int32 [N]."""
    receives = table.receives
    if receives is None:
        receives = np.full(len(table.mesh_index), EVERYTHING, np.uint32)
    return receives.astype(np.uint32).view(np.int32)


def is_linked(lights: Iterable[LightData], table: InstanceTable | None, emitting: np.ndarray) -> bool:
    """Return whether any light is for some objects alone, or some alone cast its shadows.

    `emitting`: bool by set of materials, which may shine.
    """
    if any(light.linked_to or light.blocked_by for light in lights):
        return True
    if table is None:
        return False
    return any(bool((emitting[table.material_set_index] & (numbers != 0)).any())
               for numbers in (table.linked_to, table.blocked_by) if numbers is not None)


def same_links(table: InstanceTable, other: InstanceTable | None) -> bool:
    """Return whether objects that are in both tables receive and emit for the same sets in both."""
    if other is None or (table.receives is None and other.receives is None):
        return other is not None
    if all(getattr(table, name) is getattr(other, name) for name in ("receives", "linked_to", "blocked_by")):
        return True
    before = _links_by_object(other)
    return all(before.get(key, links) == links for key, links in _links_by_object(table).items())


def _links_by_object(table: InstanceTable) -> dict[Hashable, tuple[int, int, int]]:
    none = np.zeros(len(table.mesh_index), np.int32)
    numbers = [none if each is None else each for each in (table.linked_to, table.blocked_by)]
    links = zip(received_bits(table).tolist(), *(each.tolist() for each in numbers), strict=True)
    return dict(zip(table.object_keys, links, strict=True))
