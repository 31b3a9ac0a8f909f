# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume objects (OpenVDB) and smoke domains: their grids on one lattice of cells, and the box that these fill.

Grids are read through OpenVDB's Python module, which Blender brings along. Main thread only; keeps nothing of bpy.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import sys
import tempfile
from collections.abc import Hashable
from types import ModuleType
from typing import Any

import bpy
import numpy as np

from ...engine.report import Report, ReportKind
from ...engine.scene import MeshData
from ...engine.volume_data import VolumeData

__all__ = ["extract_volume", "gas_domain", "volume_version"]

CELLS_MAX = 1 << 24
"""Of a lattice; larger ones are made coarser by whole factors"""

ALPHA_MIN = 1e-6
"""Colours of smoke are times how much of it there is, as far as that is more"""


def gas_domain(owner: bpy.types.Object) -> Any:
    """Return the settings of an object that is a smoke domain, else None."""
    for modifier in owner.modifiers:
        if modifier.type == 'FLUID' and modifier.fluid_type == 'DOMAIN':
            settings = modifier.domain_settings
            if settings is not None and settings.domain_type == 'GAS':
                return settings
    return None


def volume_version(owner: bpy.types.Object, data: bpy.types.ID, frame: float) -> Hashable:
    """Return what the grids of a volume object or smoke domain depend on, None for other objects."""
    if isinstance(data, bpy.types.Volume):
        still = not (data.is_sequence or owner.modifiers)
        return ("volume", data.session_uid, data.filepath, data.render.space, None if still else frame)
    return ("gas", data.session_uid, frame) if gas_domain(owner) is not None else None


@functools.cache
def openvdb() -> ModuleType | None:
    """Return OpenVDB's module, None where there is none."""
    try:
        return importlib.import_module("openvdb")
    except ImportError:
        # Where Blender is a module of Python its other modules aren't found.
        version = f"python{sys.version_info[0]}.{sys.version_info[1]}"
        folder = os.path.join(bpy.utils.resource_path('LOCAL'), "python", "lib", version, "site-packages")
        names = [name for name in os.listdir(folder) if name.startswith("openvdb.")] if os.path.isdir(folder) else []
        for name in names:
            spec = importlib.util.spec_from_file_location("openvdb", os.path.join(folder, name))
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            return module
        return None


def extract_volume(owner: bpy.types.Object, data: bpy.types.ID, name: str, report: Report) -> MeshData:
    """Return the box of a volume object's grids or a smoke domain's, without triangles where there is nothing in it.

    Args:
        owner: Evaluated object.
        data: Its evaluated volume, or the domain's mesh.
        name: Of the object, for messages.
        report: Receives what can't be read.
    """
    said = f"object '{name}'"
    try:
        settings = None if isinstance(data, bpy.types.Volume) else gas_domain(owner)
        found = read_file(owner, data, said, report) if settings is None else read_domain(settings, data)
    except (OSError, RuntimeError, ValueError, TypeError, AttributeError) as error:
        report.add(ReportKind.ERROR, said, f"has grids that can't be read ({error}); it is not drawn")
        found = None
    return box_mesh(name, *found) if found is not None else empty_mesh(name)


def empty_mesh(name: str) -> MeshData:
    """Return a mesh of nothing."""
    return MeshData(
        name=name, positions=np.zeros((0, 3), np.float32), triangles=np.zeros((0, 3), np.int32),
        material_slots=np.zeros(0, np.int32), corner_normals=np.zeros((0, 3, 3), np.float32))


def box_mesh(name: str, volume: VolumeData, generated: tuple[np.ndarray, np.ndarray]) -> MeshData:
    """Return the box of a volume's cells; `generated`: middle and half sides of what Generated coordinates are over."""
    corners = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], float) * volume.cells
    positions = corners @ volume.to_object[:3, :3].T + volume.to_object[:3, 3]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))], np.int32)
    if np.linalg.det(volume.to_object[:3, :3]) < 0.0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    sides = positions[triangles]
    normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return MeshData(
        name=name, positions=positions.astype(np.float32), triangles=triangles,
        material_slots=np.zeros(len(triangles), np.int32),
        corner_normals=np.repeat(normals[:, None], 3, 1).astype(np.float32),
        generated=(generated[0].astype(np.float32), np.maximum(generated[1], 1e-12).astype(np.float32)),
        volume=volume)


def read_domain(settings: Any, mesh: bpy.types.Mesh) -> tuple[VolumeData, tuple[np.ndarray, np.ndarray]] | None:
    """Return the grids of a smoke domain, which lie over the mesh's texture space; None before anything is computed."""
    resolution = np.array(settings.domain_resolution, int)
    fine = resolution * (settings.noise_scale if settings.use_noise else 1)
    grids: dict[str, np.ndarray] = {}
    for name, cells, channels in (("density", fine, 1), ("color", fine, 4), ("flame", fine, 1),
                                  ("temperature", fine, 1), ("heat", resolution, 1)):
        values = getattr(settings, name + "_grid")
        count = int(cells.prod()) * channels
        if count == 0 or len(values) != count:
            continue
        flat = np.empty(count, np.float32)
        values.foreach_get(flat)
        grid = flat.reshape(*cells[::-1], channels)
        if (cells != fine).any():
            factor = int(fine[0] // cells[0])
            grid = grid.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2)
        grids[name] = as_colors(grid)
    middle, half = (np.array(each, float) for each in (mesh.texspace_location, mesh.texspace_size))
    if not grids or not (half > 0.0).all():
        return None
    to_object = np.diag([*(2.0 * half / fine), 1.0])
    to_object[:3, 3] = middle - half
    return VolumeData(grids=grids, to_object=to_object, cells=tuple(fine.tolist())), (middle, half)


def as_colors(grid: np.ndarray) -> np.ndarray:
    """Return [z, y, x, 1, 3 or 4] as what attributes are: float32 [z, y, x, 4]."""
    out = np.ones((*grid.shape[:3], 4), np.float32)
    if grid.shape[3] == 4:
        alpha = grid[..., 3:]
        out[..., :3] = np.where(alpha > ALPHA_MIN, grid[..., :3] / np.maximum(alpha, ALPHA_MIN), grid[..., :3])
    else:
        out[..., :3] = grid
    return out


def read_file(
    owner: bpy.types.Object, data: bpy.types.Volume, said: str, report: Report,
) -> tuple[VolumeData, tuple[np.ndarray, np.ndarray]] | None:
    """Return the grids of a volume's file, or of what modifiers make of it; None where it has none."""
    vdb = openvdb()
    if vdb is None:
        report.add(ReportKind.SKIPPED, said, "is a volume, which needs Blender's OpenVDB module to be read")
        return None
    if not data.grids.load():
        report.add(ReportKind.MISSING, said, f"has no grids: {data.grids.error_message}")
        return None
    path = data.grids.frame_filepath or bpy.path.abspath(data.filepath)
    if owner.modifiers or not os.path.isfile(path):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "volume.vdb")
            data.grids.save(filepath=path)
            found = vdb.readAll(path)[0]
    else:
        found = vdb.readAll(path)[0]
    kinds = ("FloatGrid", "DoubleGrid", "Int32Grid", "BoolGrid", "Vec3SGrid", "Vec3DGrid")
    filled = [grid for grid in found if type(grid).__name__ in kinds and not grid.empty()]
    if not filled:
        return None
    first = next((grid for grid in filled if grid.name == "density"), filled[0])
    return on_lattice(first, filled, data.render.space == 'OBJECT')


def index_matrix(grid: Any) -> np.ndarray:
    """Return the matrix from a grid's voxels to object space: float64 [4, 4]."""
    origin = np.array(grid.transform.indexToWorld((0, 0, 0)))
    matrix = np.eye(4)
    matrix[:3, 3] = origin
    for axis in range(3):
        matrix[:3, axis] = np.array(grid.transform.indexToWorld(tuple(int(axis == c) for c in range(3)))) - origin
    return matrix


def on_lattice(first: Any, grids: list, scaled: bool) -> tuple[VolumeData, tuple[np.ndarray, np.ndarray]]:
    """Return grids on the lattice of the first, over all that any of them has."""
    matrix = index_matrix(first)
    low, high, leaves_low, leaves_high = (np.full(3, value) for value in (np.inf, -np.inf, np.inf, -np.inf))
    for grid in grids:
        change = np.linalg.inv(matrix) @ index_matrix(grid)
        for box, leaf in ((grid.evalActiveVoxelBoundingBox(), False), (grid.evalLeafBoundingBox(), True)):
            corners = np.array([(x, y, z) for x in (box[0][0], box[1][0]) for y in (box[0][1], box[1][1])
                                for z in (box[0][2], box[1][2])], float) @ change[:3, :3].T + change[:3, 3]
            if leaf:
                leaves_low, leaves_high = np.minimum(leaves_low, corners.min(0)), np.maximum(
                    leaves_high, corners.max(0))
            else:
                low, high = np.minimum(low, corners.min(0)), np.maximum(high, corners.max(0))
    # One more on each side: values fall off to the background there.
    low, high = np.floor(low).astype(int) - 1, np.ceil(high).astype(int) + 1
    factor = 1
    while np.prod(-(-(high - low + 1) // factor)) > CELLS_MAX:
        factor += 1
    cells = -(-(high - low + 1) // factor)
    to_object = matrix.copy()
    to_object[:3, :3] *= factor
    to_object[:3, 3] = matrix[:3, :3] @ (low - 0.5) + matrix[:3, 3]
    held = {grid.name: as_colors(dense(grid, matrix, low, cells * factor, factor)) for grid in grids}
    ends = np.array([leaves_low - 0.5, leaves_high + 0.5]) @ matrix[:3, :3].T + matrix[:3, 3]
    volume = VolumeData(grids=held, to_object=to_object, cells=tuple(cells.tolist()), scaled=scaled)
    return volume, (ends.mean(0), np.abs(ends[1] - ends[0]) * 0.5)


def dense(grid: Any, matrix: np.ndarray, low: np.ndarray, count: np.ndarray, factor: int) -> np.ndarray:
    """Return a grid's values in voxels of another's from `low` on, means of factor^3: float32 [z, y, x, 1 or 3]."""
    channels = 3 if type(grid).__name__.startswith("Vec3") else 1
    own = index_matrix(grid)
    change = np.linalg.inv(own) @ matrix
    if np.abs(change - np.eye(4)).max() < 1e-4:
        values = copied(grid, low, count, channels)
    else:
        values = resampled(grid, change, low, count, channels)
    if factor > 1:
        x, y, z = (count // factor).tolist()
        values = values.reshape(x, factor, y, factor, z, factor, channels).mean((1, 3, 5), dtype=np.float32)
    return np.ascontiguousarray(values.transpose(2, 1, 0, 3))


def copied(grid: Any, low: np.ndarray, count: np.ndarray, channels: int) -> np.ndarray:
    """Return a grid's own voxels from `low` on: float32 [x, y, z, channels]."""
    shape = tuple(count.tolist()) + ((3,) if channels == 3 else ())
    values = np.zeros(shape, {"BoolGrid": bool, "Int32Grid": np.int32, "DoubleGrid": np.float64,
                              "Vec3DGrid": np.float64}.get(type(grid).__name__, np.float32))
    grid.copyToArray(values, ijk=tuple(low.tolist()))
    return values.astype(np.float32).reshape(*count.tolist(), channels)


def resampled(grid: Any, change: np.ndarray, low: np.ndarray, count: np.ndarray, channels: int) -> np.ndarray:
    """Return a grid's values where another one has its voxels: float32 [x, y, z, channels]."""
    box = np.array(grid.evalActiveVoxelBoundingBox())
    first = box[0] - 1
    own = copied(grid, first, box[1] - box[0] + 3, channels)
    out = np.zeros((*count.tolist(), channels), np.float32)
    y, z = np.meshgrid(np.arange(count[1]) + low[1], np.arange(count[2]) + low[2], indexing="ij")
    limit = np.array(own.shape[:3]) - 1
    for i in range(count[0]):
        points = np.stack([np.full(y.shape, float(low[0] + i)), y, z], -1) @ change[:3, :3].T + change[:3, 3] - first
        inside = ((points >= 0.0) & (points <= limit)).all(-1, keepdims=True)
        points = np.clip(points, 0.0, limit)
        base = np.minimum(points.astype(int), np.maximum(limit - 1, 0))
        share = points - base
        total = np.zeros((*y.shape, channels))
        for corner in np.ndindex(2, 2, 2):
            at = np.minimum(base + corner, limit)
            weight = np.where(corner, share, 1.0 - share).prod(-1, keepdims=True)
            total += weight * own[at[..., 0], at[..., 1], at[..., 2]]
        out[i] = np.where(inside, total, 0.0)
    return out
