# SPDX-License-Identifier: GPL-3.0-or-later
"""What the acceleration structures must know of all instances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .geometry_store import MeshRange
from .scene import Key

__all__ = ["InstancePlan", "filtered_triangles", "outer_bounds"]


@dataclass
class InstancePlan:
    """What the structures must know of all N instances."""

    mesh_keys: list[Key]
    """M distinct meshes"""
    mesh_index: np.ndarray
    """int [N], -1 for instances that are not drawn"""
    filtered_slots: list[tuple[bool, ...]]
    """Per instance group: which material slots need a test per hit"""
    materials: list[tuple[Key, ...]]
    """Per instance group: the slots' materials; none where all is tested, as some rays or lights pass"""
    group_index: np.ndarray
    """int [N], index into both"""
    low: np.ndarray
    high: np.ndarray
    """float64 [N, 3], bounds in world space"""
    scattering: np.ndarray
    """bool [N]: which instances scatter light below their surface"""

    def tested(self, *, by_material: bool = True) -> list[tuple[tuple[bool, ...], tuple[Key, ...]]]:
        """Return of each group which slots need a test and, where any does, their materials if they count."""
        return [(slots, materials if by_material and any(slots) else ())
                for slots, materials in zip(self.filtered_slots, self.materials, strict=True)]

    def filters_as(self, other: InstancePlan, *, by_material: bool) -> bool:
        """Return whether the same slots of all instances need a test, `by_material`: of the same materials."""
        mine, others = (plan.tested(by_material=by_material) for plan in (self, other))
        return len(self.group_index) == len(other.group_index) and (
            [mine[i] for i in self.group_index.tolist()] == [others[i] for i in other.group_index.tolist()])


def outer_bounds(plan: InstancePlan, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of some instances, rounded outwards: float32 of a float64 bound may lie inside it."""
    low, high = plan.low[chosen], plan.high[chosen]
    grow = 4e-7 * np.maximum(np.abs(low), np.abs(high)) + 1e-30
    return (low - grow).astype(np.float32), (high + grow).astype(np.float32)


def filtered_triangles(r: MeshRange, filtered_slots: tuple[bool, ...]) -> np.ndarray | None:
    """Return which triangles of a mesh need a test per hit, None where none does."""
    if not any(filtered_slots):
        return None
    return np.asarray(filtered_slots, bool)[np.minimum(r.slots, len(filtered_slots) - 1)]
