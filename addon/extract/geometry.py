# SPDX-License-Identifier: GPL-3.0-or-later
"""What a source of instances looks like, of whatever kind: its MeshData. Main thread only; keeps nothing of bpy."""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor

import bpy
import numpy as np

from ...engine.report import Report
from ...engine.sanitize import SanitizeCounts, report_counts, sanitize_meshes
from ...engine.scene import MeshData
from ...engine.stored_mesh import StoredMesh
from .hair import extract_curves
from .instances import Gathered, Source
from .mesh import extract_mesh
from .particle_hair import extract_particle_hair
from .volume_object import extract_volume

__all__ = ["materials_of_hair", "read_clean", "read_geometry", "read_positions"]

THREADS_MAX = 2
"""Threads that make meshes ready at most: they keep up with what reads them, and more wait for Python's lock"""
BATCH = 1 << 17
"""Corners of faces from which on meshes are handed to a thread: small ones one by one wait for that lock, too"""


def _copy_geometry(source: Source, report: Report, derived: frozenset[str]) -> MeshData | StoredMesh:
    """Return copies of all that Blender knows of a source; arguments as of `read_geometry`."""
    owner, slot_count = f"object '{source.name}'", len(source.material_set)
    if source.hair:
        return extract_particle_hair(source.owner, source.data, source.hair, owner, slot_count, report, derived)
    if source.volume is not None:
        return extract_volume(source.owner, source.data, source.name, report)
    if isinstance(source.data, bpy.types.Curves):
        return extract_curves(source.data, owner, report, derived)
    if not source.data.is_editmode:
        return extract_mesh(source.data, owner, slot_count, report, derived)
    # In edit mode the evaluated mesh has no arrays of its own.
    try:
        return extract_mesh(source.owner.to_mesh(), owner, slot_count, report, derived)
    finally:
        source.owner.to_mesh_clear()


def _by_triangles(geometry: MeshData | StoredMesh) -> MeshData:
    return geometry.by_triangles() if isinstance(geometry, StoredMesh) else geometry


def _corner_count(geometry: MeshData | StoredMesh) -> int:
    return len(geometry.corner_vertices) if isinstance(geometry, StoredMesh) else 3 * len(geometry.triangles)


def _clean(batch: dict[int, MeshData | StoredMesh]) -> dict[int, tuple[MeshData, SanitizeCounts]]:
    """Make meshes ready, by key."""
    return dict(zip(batch, sanitize_meshes([_by_triangles(geometry) for geometry in batch.values()]), strict=True))


def read_geometry(source: Source, report: Report, derived: frozenset[str] = frozenset()) -> MeshData:
    """Return the mesh, the tubes of hair or the box of a volume, as they are (engine/sanitize.py).

    Args:
        source: Not a lamp.
        report: Takes what was left out.
        derived: Attributes to work out (engine/mesh_features.py).
    """
    return _by_triangles(_copy_geometry(source, report, derived))


def read_clean(sources: dict[int, Source], reports: dict[int, Report], derived: dict[int, frozenset[str]],
               step: Callable[[str, float], None]) -> dict[int, MeshData]:
    """Return what sources look like, by key, fit to be drawn: copied here, made ready in threads meanwhile.

    Args:
        sources: By key.
        reports: By key; take what was left out or repaired.
        derived: By key, as of `read_geometry`.
        step: Called before each with a text and the share done; may raise.
    """
    with ThreadPoolExecutor(min(os.cpu_count() or 1, THREADS_MAX), thread_name_prefix="burnish meshes") as pool:
        cleaning, batch, corners = [], {}, 0
        for number, (key, source) in enumerate(sources.items()):
            step(f"Reading mesh '{source.name}'", number / len(sources))
            batch[key] = _copy_geometry(source, reports[key], derived[key])
            corners += _corner_count(batch[key])
            if corners >= BATCH or number == len(sources) - 1:
                cleaning.append(pool.submit(_clean, batch))
                batch, corners = {}, 0
        cleaned = {key: found for job in cleaning for key, found in job.result().items()}
    for key, (_, found) in cleaned.items():
        report_counts(reports[key], f"object '{sources[key].name}'", found)
    return {key: data for key, (data, _) in cleaned.items()}


def materials_of_hair(gathered: Gathered) -> frozenset[Hashable]:
    """Return the keys of the materials that hair has."""
    return frozenset(key for source in gathered.sources if source.hair or isinstance(source.data, bpy.types.Curves)
                     for key in source.material_set)


def read_positions(source: Source) -> np.ndarray | None:
    """Return float32 [V, 3], the vertices that `read_geometry` finds, None where they aren't followed."""
    if source.hair or isinstance(source.data, bpy.types.Curves):
        return read_geometry(source, Report()).positions
    if source.volume is not None or source.data.is_editmode:
        return None
    attribute = source.data.attributes.get("position")
    if attribute is None:
        return None
    values = np.empty(3 * len(source.data.vertices), np.float32)
    attribute.data.foreach_get("vector", values)
    return values.reshape(-1, 3)
