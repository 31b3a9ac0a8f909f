# SPDX-License-Identifier: GPL-3.0-or-later
"""The one policy for meshes that can't be traced: what is dropped, what is repaired, and how often.

Triangles with a missing, non-finite or absurdly far corner and triangles without area are dropped; broken
normals become the face normal; broken texture coordinates and attributes become zero. A kernel, once it is
built, tells whether there is anything wrong, and NumPy what, in blocks that fit the processor's cache; the same object
is returned where nothing was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ..kernels.mesh_checks import find_defects
from .device import host_array, is_loaded, launch
from .report import Report, ReportKind
from .scene import MeshData

__all__ = [
    "COORDINATE_LIMIT", "SanitizeCounts", "has_defects", "report_counts", "sanitize_mesh", "sanitize_meshes"]

COORDINATE_LIMIT = 1e9
"""Largest coordinate drawn [m]: beyond it float32 resolves no less than 64 m"""

SMALL_TRIANGLES = 1 << 13
"""Triangles up to which a mesh is small"""

_BLOCK = 1 << 14
# Kernels read slots beside positions, as float32, which holds the numbers up to here (Blender's limit is 32,767).
_SLOT_MAX = (1 << 24) - 1
# A shading normal is unit length; this only tells a zero vector from one that Blender rounded.
_NORMAL_LENGTH_SQUARED_MIN = 1e-6


@dataclass(frozen=True)
class SanitizeCounts:
    """How much of a mesh was dropped (triangles) or repaired (corners)."""

    bad_indices: int = 0
    """Triangles that name a vertex that does not exist"""
    non_finite: int = 0
    """Triangles with a NaN or infinite coordinate"""
    too_far: int = 0
    """Triangles beyond COORDINATE_LIMIT"""
    degenerate: int = 0
    """Triangles without area"""
    normals: int = 0
    """Corners whose normal was zero or not finite"""
    coordinates: int = 0
    """Corners with a texture coordinate or attribute that was not finite"""

    @property
    def dropped(self) -> int:
        """Triangles dropped, for any reason."""
        return self.bad_indices + self.non_finite + self.too_far + self.degenerate


def sanitize_mesh(mesh: MeshData) -> tuple[MeshData, SanitizeCounts]:
    """Return the drawable part of `mesh` and the counts of what was wrong; the argument stays as it is.

    Slots below 0 become the first, those beyond any object's the last. Vertices are kept even where no triangle uses
    them any more, but those that aren't finite become the origin, so that bounds made from them are finite.
    """
    quick = is_loaded(find_defects, "cpu")
    if quick and not (has_defects(mesh) or _repair_arrays(mesh.uv_maps)[1] or _repair_arrays(mesh.attributes)[1]):
        return mesh, SanitizeCounts()
    triangles, positions = mesh.triangles, mesh.positions
    keep, counts = _classify_triangles(positions, triangles)
    if keep is not None:
        mesh = _take_triangles(mesh, keep)
    if not _all_near(positions):
        mesh = replace(mesh, positions=_finite_positions(positions))
    if len(mesh.material_slots) and (mesh.material_slots.min() < 0 or mesh.material_slots.max() > _SLOT_MAX):
        mesh = replace(mesh, material_slots=np.clip(mesh.material_slots, 0, _SLOT_MAX))
    normals, normal_count = _repair_normals(mesh)
    uv_maps, uv_count = _repair_arrays(mesh.uv_maps)
    attributes, attribute_count = _repair_arrays(mesh.attributes)
    if normal_count or uv_count or attribute_count:
        mesh = replace(mesh, corner_normals=normals, uv_maps=uv_maps, attributes=attributes)
    return mesh, replace(counts, normals=normal_count, coordinates=uv_count + attribute_count)


def sanitize_meshes(meshes: Sequence[MeshData]) -> list[tuple[MeshData, SanitizeCounts]]:
    """Return what `sanitize_mesh` does of each, after one look at all small ones together.

    Of these the call takes longer than the look; large ones would be copied for it.
    """
    small = [mesh for mesh in meshes if len(mesh.triangles) <= SMALL_TRIANGLES]
    good = len(small) > 1 and is_loaded(find_defects, "cpu") and not _any_has_defects(small)
    return [(mesh, SanitizeCounts()) if good and len(mesh.triangles) <= SMALL_TRIANGLES else sanitize_mesh(mesh)
            for mesh in meshes]


def _any_has_defects(meshes: Sequence[MeshData]) -> bool:
    """Tell whether anything may be wrong with any of the meshes."""
    counts = [len(mesh.positions) for mesh in meshes]
    for mesh, count in zip(meshes, counts, strict=True):
        # In the joined mesh another's vertices would take the place of missing ones.
        if len(mesh.triangles) and mesh.triangles.view(np.uint32).max() >= count:
            return True
    starts = np.repeat(np.cumsum([0, *counts[:-1]], dtype=np.int32), [len(mesh.triangles) for mesh in meshes])
    joined = MeshData(
        name="", positions=np.concatenate([mesh.positions for mesh in meshes]),
        triangles=np.concatenate([mesh.triangles for mesh in meshes]) + starts[:, None],
        material_slots=np.concatenate([mesh.material_slots for mesh in meshes]),
        corner_normals=np.concatenate([mesh.corner_normals for mesh in meshes]), uv_maps={}, attributes={})
    if has_defects(joined):
        return True
    flat = [values.reshape(-1) for mesh in meshes for values in (*mesh.uv_maps.values(), *mesh.attributes.values())]
    return bool(flat) and not _all_finite(np.concatenate(flat))


def _all_near(positions: np.ndarray) -> bool:
    """Tell whether all coordinates are within the limit, those of vertices that no triangle has, too."""
    # NaN makes the comparisons false, infinity too.
    return not len(positions) or bool(
        positions.max() <= COORDINATE_LIMIT and positions.min() >= -COORDINATE_LIMIT)


def has_defects(mesh: MeshData) -> bool:
    """Tell whether anything may be wrong with vertices, triangles, slots or normals, without saying what."""
    if not _all_near(mesh.positions):
        return True
    if not len(mesh.triangles) or not len(mesh.positions):
        return len(mesh.triangles) > 0
    found = np.zeros(1, np.int32)
    arrays = [(mesh.positions, wp.vec3), (mesh.triangles, wp.vec3i), (mesh.material_slots, int),
              (mesh.corner_normals.reshape(-1, 3), wp.vec3)]
    launch(find_defects, len(mesh.triangles), [
        *(host_array(np.ascontiguousarray(values), kind) for values, kind in arrays),
        COORDINATE_LIMIT, _SLOT_MAX, _NORMAL_LENGTH_SQUARED_MIN], [host_array(found, int)], "cpu")
    return bool(found[0])


def report_counts(report: Report, owner: str, counts: SanitizeCounts) -> None:
    """Add one entry per kind of defect in `counts`, named after `owner` (such as `object 'Floor'`).

    Triangles without area are common and never seen: they are counted for the whole scene.
    """
    if counts.degenerate:
        report.add(ReportKind.INFO, "", "triangles without area were left out", counts.degenerate)
    entries = (
        (ReportKind.SKIPPED, counts.bad_indices,
         "triangles naming vertices that don't exist were left out; run Mesh > Clean Up"),
        (ReportKind.SKIPPED, counts.non_finite, "triangles with NaN or infinite coordinates were left out"),
        (ReportKind.SKIPPED, counts.too_far, "triangles more than 1e9 m from the object's origin were left out"),
        (ReportKind.APPROXIMATED, counts.normals, "broken corner normals were replaced by face normals"),
        (ReportKind.APPROXIMATED, counts.coordinates, "broken texture coordinates or attributes were set to zero"),
    )
    for kind, count, message in entries:
        if count:
            report.add(kind, owner, message, count)


def _classify_triangles(positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray | None, SanitizeCounts]:
    """Return the mask of triangles to keep (None: all) and how many fail which test, each counted once."""
    count = len(triangles)
    if count == 0:
        return None, SanitizeCounts()
    if not len(positions):
        return np.zeros(count, bool), SanitizeCounts(bad_indices=count)
    in_range = finite = near = None
    usable = triangles
    # One comparison catches both ends: a negative index is a huge unsigned one.
    unsigned = triangles.view(np.uint32)
    if unsigned.max() >= len(positions):
        in_range = (unsigned < len(positions)).all(axis=1)
        usable = np.where(in_range[:, None], triangles, 0)
    if not _all_near(positions):
        vertex_finite = np.isfinite(positions).all(axis=1)
        vertex_near = ~(np.abs(positions) > COORDINATE_LIMIT).any(axis=1)
        finite = vertex_finite[usable].all(axis=1)
        near = vertex_near[usable].all(axis=1)
    has_area = _triangles_with_area(positions, usable)
    keep = np.ones(count, bool)
    failed = []
    for passed in (in_range, finite, near, has_area):
        before = int(np.count_nonzero(keep))
        if passed is not None:
            keep &= passed
        failed.append(before - int(np.count_nonzero(keep)))
    counts = SanitizeCounts(*failed)
    return (keep if counts.dropped else None), counts


def _triangles_with_area(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return bool [T]: the cross product of two edges is not exactly zero (and not NaN) in float32."""
    result = np.empty(len(triangles), bool)
    # Overflow and NaN are expected here: such triangles fail other tests.
    with np.errstate(all="ignore"):
        for start in range(0, len(triangles), _BLOCK):
            corners = positions.take(triangles[start:start + _BLOCK], axis=0)
            a = corners[:, 1] - corners[:, 0]
            b = corners[:, 2] - corners[:, 0]
            x = a[:, 1] * b[:, 2] != a[:, 2] * b[:, 1]
            x |= a[:, 2] * b[:, 0] != a[:, 0] * b[:, 2]
            x |= a[:, 0] * b[:, 1] != a[:, 1] * b[:, 0]
            result[start:start + _BLOCK] = x
    return result


def _take_triangles(mesh: MeshData, keep: np.ndarray) -> MeshData:
    """Return `mesh` with only the triangles where `keep` is true."""
    return replace(
        mesh,
        triangles=np.ascontiguousarray(mesh.triangles[keep]),
        material_slots=np.ascontiguousarray(mesh.material_slots[keep]),
        corner_normals=np.ascontiguousarray(mesh.corner_normals[keep]),
        uv_maps={name: np.ascontiguousarray(values[keep]) for name, values in mesh.uv_maps.items()},
        attributes={name: np.ascontiguousarray(values[keep]) for name, values in mesh.attributes.items()},
    )


def _finite_positions(positions: np.ndarray) -> np.ndarray:
    """Return a copy whose rows beyond the limit or not finite are the origin."""
    good = (np.abs(positions) <= COORDINATE_LIMIT).all(axis=1)
    return np.where(good[:, None], positions, np.float32(0.0))


def _repair_normals(mesh: MeshData) -> tuple[np.ndarray, int]:
    """Return corner normals with the face normal in place of zero or non-finite ones, and how many those were."""
    normals = mesh.corner_normals
    bad_corners = []
    with np.errstate(all="ignore"):
        for start in range(0, len(normals), _BLOCK):
            block = normals[start:start + _BLOCK]
            squared = np.einsum("tci,tci->tc", block, block)
            if not (squared.min() > _NORMAL_LENGTH_SQUARED_MIN and squared.max() < np.inf):
                good = (squared > _NORMAL_LENGTH_SQUARED_MIN) & (squared < np.inf)
                bad = np.argwhere(~good)
                bad[:, 0] += start
                bad_corners.append(bad)
    if not bad_corners:
        return normals, 0
    triangle, corner = np.concatenate(bad_corners).T
    faces = mesh.positions[mesh.triangles[triangle]].astype(np.float64)
    face_normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    face_normals /= np.linalg.norm(face_normals, axis=1, keepdims=True)
    normals = normals.copy()
    normals[triangle, corner] = face_normals
    return normals, len(triangle)


def _all_finite(flat: np.ndarray) -> bool:
    """Tell whether all of [N] values are finite; of some very large ones, not."""
    with np.errstate(all="ignore"):
        return bool(np.isfinite(np.dot(flat, flat)))  # a sum is finite only if every term is


def _repair_arrays(arrays: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], int]:
    """Return the [T, 3, C] arrays with zeros in place of non-finite corners, and how many corners those were."""
    repaired, count = {}, 0
    for name, values in arrays.items():
        if not _all_finite(values.reshape(-1)):
            good = np.isfinite(values).all(axis=-1)
            count += int(good.size - np.count_nonzero(good))
            values = np.where(good[..., None], values, np.float32(0.0))
        repaired[name] = values
    return repaired, count
