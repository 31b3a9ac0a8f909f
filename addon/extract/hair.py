# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated hair curves to MeshData: tubes with the curves' attributes. Main thread only; keeps nothing of bpy."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from ...engine.hair import SIDES, Strands, Tubes, fit_to_limit, make_tubes, needed_steps
from ...engine.hair_info import hair_attributes
from ...engine.report import Report, ReportKind
from ...engine.scene import MeshData
from .mesh import ATTRIBUTE_LIMIT, ATTRIBUTE_TYPES, read_vec4

__all__ = ["STEPS", "TRIANGLE_LIMIT", "extract_curves", "thinned", "tube_mesh"]

TRIANGLE_LIMIT = 16_000_000
"""Of one object's hair"""

STEPS = 4
"""Most pieces between two points, Cycles' two subdivisions"""

_RADIUS = 0.005  # Cycles' for curves without the attribute, in metres
_POLY = 1  # value of the attribute `curve_type`


def extract_curves(curves: bpy.types.Curves, owner: str, report: Report,
                   derived: frozenset[str] = frozenset()) -> MeshData:
    """Return tubes around all curves, with the first slot's material as in Cycles.

    Args:
        curves: Evaluated hair curves.
        owner: Name for messages, such as `object 'Hair'`.
        report: Takes what was left out.
        derived: Attributes of engine/hair_info.py that it shall have.
    """
    total, count = len(curves.points), len(curves.curves)
    offsets = np.zeros(count + 1, np.int32)
    points, radii = np.zeros(3 * total, np.float32), np.full(total, _RADIUS, np.float32)
    if count:
        curves.curve_offset_data.foreach_get("value", offsets)
        curves.attributes["position"].data.foreach_get("vector", points)
    radius = curves.attributes.get("radius")
    if radius is not None and radius.data_type == 'FLOAT' and len(radius.data) == total:
        radius.data.foreach_get("value", radii)
    counts = np.diff(offsets).astype(np.int64)
    steps, every = thinned(counts, owner, report)
    drawn = np.where(np.arange(count) % every == 0, counts, 0)
    kept = np.repeat(drawn > 0, counts)
    strands = Strands(points.reshape(-1, 3)[kept], radii[kept], drawn)
    tubes = make_tubes(strands, 1 if _are_straight(curves) else needed_steps(strands, steps))
    uv_maps, attributes = _read_attributes(curves, tubes, kept, owner, report)
    attributes |= hair_attributes(derived, strands, tubes, np.arange(count))
    return tube_mesh(curves.name, tubes, np.zeros(count, np.int32), uv_maps, attributes)


def thinned(counts: np.ndarray, owner: str, report: Report) -> tuple[int, int]:
    """Return how many pieces there may be between two points, and that every how many-th strand is drawn.

    Args:
        counts: int64 [C], points of each strand.
        owner: Name for messages.
        report: Is told where strands are left out.
    """
    steps, every = fit_to_limit(counts, STEPS, TRIANGLE_LIMIT)
    if every > 1:
        report.add(ReportKind.SKIPPED, owner, f"has too much hair: one strand in {every} is drawn")
    return steps, every


def tube_mesh(name: str, tubes: Tubes, slots: np.ndarray, uv_maps: dict[str, np.ndarray],
              attributes: dict[str, np.ndarray]) -> MeshData:
    """Return tubes as a mesh whose Generated coordinates are those of the object.

    Args:
        name: Of the mesh.
        tubes: Around C strands.
        slots: int32 [C], material slot of each strand.
        uv_maps: As in MeshData.
        attributes: As in MeshData.
    """
    strand = tubes.strand[::SIDES]
    material_slots = slots[strand[tubes.triangles[:, 0] // SIDES]] if len(tubes.triangles) else np.zeros(0, np.int32)
    return MeshData(
        name=name, positions=tubes.positions, triangles=tubes.triangles, material_slots=material_slots,
        corner_normals=tubes.normals[tubes.triangles], uv_maps=uv_maps, attributes=attributes,
        generated=(np.full(3, 0.5, np.float32), np.full(3, 0.5, np.float32)))


def _are_straight(curves: bpy.types.Curves) -> bool:
    """Return whether pieces between points are straight, which as in Cycles the first curve says of all."""
    kind = curves.attributes.get("curve_type")
    return kind is not None and len(kind.data) > 0 and kind.data[0].value == _POLY


def _chosen(attributes: Iterable[bpy.types.Attribute], sizes: dict[str, int]) -> list[bpy.types.Attribute]:
    return [attribute for attribute in attributes
            if attribute.name != "position" and not attribute.name.startswith('.')
            and attribute.data_type in ATTRIBUTE_TYPES and len(attribute.data) == sizes.get(attribute.domain)]


def _read_attributes(curves: bpy.types.Curves, tubes: Tubes, kept: np.ndarray, owner: str, report: Report,
                     ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return UV maps (the first attribute of two numbers, as in Cycles) and attributes at the triangles' corners."""
    uv_maps: dict[str, np.ndarray] = {}
    attributes: dict[str, np.ndarray] = {}
    chosen = _chosen(curves.attributes, {'POINT': len(curves.points), 'CURVE': len(curves.curves)})
    if len(chosen) > ATTRIBUTE_LIMIT:
        names = ", ".join(f"'{attribute.name}'" for attribute in chosen[ATTRIBUTE_LIMIT:])
        report.add(ReportKind.SKIPPED, owner, f"attributes beyond the first {ATTRIBUTE_LIMIT} were left out: {names}")
    for attribute in chosen[:ATTRIBUTE_LIMIT] if len(tubes.triangles) else ():
        values = read_vec4(attribute)
        of_vertices = values[tubes.strand] if attribute.domain == 'CURVE' else tubes.of_points(values[kept])
        corners = of_vertices[tubes.triangles]
        if attribute.data_type == 'FLOAT2' and not uv_maps:
            uv_maps[attribute.name] = np.ascontiguousarray(corners[..., :2])
        else:
            attributes[attribute.name] = corners
    return uv_maps, attributes
