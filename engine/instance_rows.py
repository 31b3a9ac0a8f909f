# SPDX-License-Identifier: GPL-3.0-or-later
"""Instances as the kernels read them: one row of numbers each, made of the table and of what their meshes are."""

from __future__ import annotations

import numpy as np

from ..kernels import types
from .geometry_store import MeshRange
from .light_linking import emitted_visibility, received_bits
from .scene import InstanceTable, Key, MaterialData
from .structures import RAY_KINDS

__all__ = ["filtered_groups", "instance_bounds", "instance_rows", "inverses", "moved_rows", "scene_origin", "stops_all",
           "write_places"]

LEAST_SCALE = 1e-25
"""Of what is smaller along all axes nothing is drawn: float32 doesn't hold the way into its object space"""

LEAST_HEIGHT = 1e-6
"""What is flat has so much of its size along its lost axes on the way into its object space"""

FARTHEST = np.finfo(np.float32).max

ROW_TYPE = np.dtype(types.Instance.numpy_dtype())
"""Asked for once: Warp works it out anew each time"""


def moved_rows(transforms: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return, ascending, which transforms differ: float64 [N, 4, 4] each."""
    # Sixteen truth values are two words: few of thousands differ, and NumPy takes long to join short rows.
    words = (transforms != others).reshape(-1, 16).view(np.uint64)
    return np.flatnonzero(words[:, 0] | words[:, 1])


def instance_bounds(
    mesh_index: np.ndarray, transforms: np.ndarray, ranges: list[MeshRange],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return bool [N], which instances have anything finite to draw, and the centres and half sizes of their bounds.

    Those are float64 [N, 3], in world space, zero for instances that are not drawn.

    Args:
        mesh_index: int [N], the instances' meshes.
        transforms: float64 [N, 4, 4], object to world.
        ranges: Of the meshes.
    """
    pick = mesh_index
    drawn = np.array([r.triangle_count > 0 for r in ranges], bool)[pick] if ranges else np.zeros(0, bool)
    low = np.array([r.low for r in ranges]).reshape(-1, 3)[pick]
    high = np.array([r.high for r in ranges]).reshape(-1, 3)[pick]
    linear = transforms[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        center = np.einsum("nij,nj->ni", linear, 0.5 * (low + high)) + transforms[:, :3, 3]
        sizes = np.abs(linear)
        half = np.einsum("nij,nj->ni", sizes, 0.5 * (high - low))
        # False for NaN too.
        drawn &= (sizes > LEAST_SCALE).any((1, 2))
    drawn &= np.isfinite(center).all(1) & np.isfinite(half).all(1)
    if drawn.all():
        return drawn, center, half
    return drawn, np.where(drawn[:, None], center, 0.0), np.where(drawn[:, None], half, 0.0)


def scene_origin(center: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return float64 [3], where a scene's origin is: for far-away scenes the median, where most of it is.

    float32 keeps what matters there.

    Args:
        center: float64 [N, 3], of the drawn instances' bounds.
        half: float64 [N, 3], their half sizes.
    """
    if len(center):
        middle = np.sort(center, axis=0)[(len(center) - 1) // 2]
        size = max(np.linalg.norm((center + half).max(0) - (center - half).min(0)), 1e-30)
        if np.abs(middle).max() > 16.0 * size:
            # A power of two, as the cache's cells are: moved and scaled scenes have the same cells.
            step = 2.0 ** (np.ceil(np.log2(size)) + 1.0)
            return step * np.round(middle / step)
    return np.zeros(3)


def stops_all(table: InstanceTable) -> np.ndarray:
    """Return bool [N], which instances all kinds of rays see, and shadow rays of all lights."""
    seen = (table.visibility & RAY_KINDS) == RAY_KINDS
    return seen if table.spared is None else seen & ~table.spared


def filtered_groups(
    table: InstanceTable, materials: dict[Key, MaterialData],
) -> tuple[list[tuple[bool, ...]], list[tuple[Key, ...]], np.ndarray]:
    """Return groups of instances: which slots are filtered, their materials, and int64 [N], each instance's group.

    Where some rays or lights pass instances, all slots are filtered whatever their materials, of which none are told.
    """
    transparent = [
        tuple(materials.get(key, materials[None]).has_transparency for key in keys) for keys in table.material_sets]
    partial = ~stops_all(table)
    combined = table.material_set_index * 2 + partial
    values, group_index = np.unique(combined, return_inverse=True)
    groups = []
    for value in values.tolist():
        slots = transparent[value // 2]
        groups.append(tuple(True for _ in slots) if value % 2 else slots)
    shared = [() if value % 2 else tuple(table.material_sets[value // 2]) for value in values.tolist()]
    return groups, shared, group_index.astype(np.int64)


def instance_rows(table: InstanceTable, ranges: list[MeshRange], origin: np.ndarray) -> np.ndarray:
    """Return all instances as kernels.types.Instance [N], without the structures' ids.

    Args:
        table: All instances.
        ranges: Of the table's meshes.
        origin: float64 [3], the scene's origin, subtracted from all places.
    """
    rows = np.zeros(len(table.mesh_index), ROW_TYPE)
    write_places(rows, table.transforms, origin, slice(None))
    pick = table.mesh_index
    if ranges:
        rows["mesh"] = np.array([r.row for r in ranges], np.int32)[pick]
        rows["triangle_offset"] = np.array([r.triangle_start for r in ranges], np.int32)[pick]
        rows["generated_location"] = np.array([r.generated[0] for r in ranges], np.float32)[pick]
        rows["generated_size"] = np.array([r.generated[1] for r in ranges], np.float32)[pick]
    lengths = np.array([len(keys) for keys in table.material_sets], np.int32)
    offsets = np.concatenate([[0], np.cumsum(lengths)])[:-1].astype(np.int32)
    rows["material_offset"] = offsets[table.material_set_index]
    rows["material_count"] = lengths[table.material_set_index]
    rows["visibility"] = emitted_visibility(table.visibility, table.linked_to, table.blocked_by)
    rows["receives"] = received_bits(table)
    rows["object_id"] = table.object_name_index
    rows["pass_index"] = table.pass_index
    rows["random"] = table.random_id.astype(np.float64) * (1.0 / 0xFFFFFFFF)
    rows["color"] = table.color
    return rows


def write_places(rows: np.ndarray, transforms: np.ndarray, origin: np.ndarray, chosen: np.ndarray | slice) -> None:
    """Write the transforms (float64 [N, 4, 4]) of the `chosen` instances into their rows."""
    matrices = transforms[chosen].copy()
    matrices[:, :3, 3] -= origin
    near = (np.abs(matrices) <= FARTHEST).reshape(-1, 16).all(1)
    if not near.all():
        matrices[~near] = np.eye(4)
    determinant = np.linalg.det(matrices[:, :3, :3])
    flat, safe = determinant == 0, matrices
    if flat.any():
        safe = matrices.copy()
        safe[flat] = np.eye(4)
    with np.errstate(over="ignore"):
        inverse = inverses(safe).astype(np.float32)
    flat = np.flatnonzero(flat | ~np.isfinite(inverse).reshape(-1, 16).all(1))
    if len(flat):
        inverse[flat] = _inverse_of_flat(matrices[flat])
    rows["to_world"][chosen] = matrices
    rows["to_object"][chosen] = inverse
    rows["flipped"][chosen] = determinant < 0


def inverses(matrices: np.ndarray) -> np.ndarray:
    """Return inverses of transforms, float64 [N, 4, 4]; of those that have none, as if they were a little higher."""
    try:
        return np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return _inverse_of_flat(matrices)
        return np.concatenate([inverses(matrices[i : i + 1]) for i in range(len(matrices))])


def _inverse_of_flat(matrices: np.ndarray) -> np.ndarray:
    """Return the inverses of transforms that have none, or too large a one, if they were a little higher.

    Of what is not drawn that is the identity.

    Args:
        matrices: float64 [N, 4, 4].
    """
    u, sizes, v = np.linalg.svd(matrices[:, :3, :3])
    made = np.tile(np.eye(4), (len(matrices), 1, 1))
    drawn = sizes[:, 0] > LEAST_SCALE
    sizes = np.where(drawn[:, None], np.maximum(sizes, LEAST_HEIGHT * sizes[:, :1]), 1.0)
    linear = np.einsum("nji,nj,nkj->nik", v, 1.0 / sizes, u)
    made[drawn, :3, :3] = linear[drawn]
    made[drawn, :3, 3] = -np.einsum("nij,nj->ni", linear, matrices[:, :3, 3])[drawn]
    return made
