# SPDX-License-Identifier: GPL-3.0-or-later
"""Emissive triangles: which ones there are, how much each gives, and how a hit finds its entry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import types
from ..kernels.flatten import measure_emitters
from .device import launch
from .geometry_store import GeometryStore
from .instance_plan import InstancePlan
from .scene import InstanceTable, Key, MaterialData

__all__ = ["EmitterTable", "find_emitters"]

# Points at which a textured emitter's triangle is evaluated.
POINTS = 6


@dataclass
class EmitterTable:
    """Device arrays of kernels.types.Lights that concern triangles, and their power."""

    faces: wp.array
    offset: wp.array
    index: wp.array
    power: np.ndarray
    """float64 [E], both sides, [W]"""
    low: np.ndarray
    high: np.ndarray
    """float32 [E, 3], bounds relative to the scene's origin"""
    textured: bool
    """Whether any emission varies over its surface"""

    @staticmethod
    def empty(device: str, instance_count: int = 1) -> EmitterTable:
        """Return a table without emitters."""
        return EmitterTable(
            wp.zeros(1, dtype=wp.vec2i, device=device),
            wp.full(max(instance_count, 1), -1, dtype=int, device=device),
            wp.zeros(1, dtype=int, device=device), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), False)


def find_emitters(
    scene: types.Scene, plan: InstancePlan | None, table: InstanceTable | None, store: GeometryStore,
    materials: dict[Key, MaterialData], device: str,
) -> EmitterTable:
    """Collect the triangles of emissive materials that are sampled as lamps, and measure their power on the device.

    Args:
        scene: The scene so far; its instances, geometry and materials are read.
        plan: Which instances are drawn.
        table: Material sets and visibility.
        store: Triangles and slots per mesh.
        materials: Emission flags by key.
        device: Where to measure.
    """
    if plan is None or table is None or len(plan.mesh_index) == 0:
        return EmitterTable.empty(device)
    sampled, textured = [], False
    for keys in table.material_sets:
        flags = []
        for key in keys:
            material = materials.get(key) or materials[None]
            flags.append(material.has_emission and material.emission_sampling)
            textured |= flags[-1] and material.constant_emission is None
        sampled.append(np.array(flags, bool))
    shines = np.array([flags.any() for flags in sampled], bool)
    chosen = np.flatnonzero(shines[table.material_set_index] & (plan.mesh_index >= 0))
    if len(chosen) == 0:
        return EmitterTable.empty(device, len(plan.mesh_index))
    offset = np.full(len(plan.mesh_index), -1, np.int32)
    faces, index, entries, room = [], [], 0, 0
    for i in chosen.tolist():
        r = store.ranges[plan.mesh_keys[plan.mesh_index[i]]]
        flags = sampled[table.material_set_index[i]]
        emits = flags[np.minimum(r.slots, len(flags) - 1)]
        count = int(emits.sum())
        if count == 0:
            continue
        entry = np.full(r.triangle_count, -1, np.int32)
        entry[emits] = np.arange(entries, entries + count, dtype=np.int32)
        triangles = np.flatnonzero(emits).astype(np.int32) + np.int32(r.triangle_start)
        faces.append(np.stack([np.full(count, i, np.int32), triangles], 1))
        index.append(entry)
        offset[i] = room
        room += r.triangle_count
        entries += count
    if entries == 0:
        return EmitterTable.empty(device, len(plan.mesh_index))
    face_array = wp.array(np.concatenate(faces), dtype=wp.vec2i, device=device)
    power = wp.zeros(entries, dtype=float, device=device)
    low = wp.zeros(entries, dtype=wp.vec3, device=device)
    high = wp.zeros(entries, dtype=wp.vec3, device=device)
    launch(measure_emitters, entries, [scene, face_array, 0, POINTS], [power, low, high], device)
    watts = power.numpy().astype(np.float64)
    watts[~np.isfinite(watts)] = 0.0
    return EmitterTable(
        face_array, wp.array(offset, dtype=int, device=device),
        wp.array(np.concatenate(index), dtype=int, device=device), 2.0 * np.pi * watts,
        low.numpy().copy(), high.numpy().copy(), textured)
