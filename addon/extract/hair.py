# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated hair curves to MeshData: tubes with the curves' attributes. Main thread only; keeps nothing of bpy."""

from __future__ import annotations

import bpy
import numpy as np

from ...engine.hair import Strands, Tubes, fit_to_limit, make_tubes
from ...engine.report import Report, ReportKind
from ...engine.sanitize import report_counts, sanitize_mesh
from ...engine.scene import MeshData
from .mesh import ATTRIBUTE_LIMIT, ATTRIBUTE_TYPES, read_vec4

__all__ = ["TRIANGLE_LIMIT", "extract_curves"]

TRIANGLE_LIMIT = 16_000_000
"""Of one object's hair"""

_STEPS = 4  # pieces between two points, Cycles' two subdivisions
_RADIUS = 0.005  # Cycles' for curves without the attribute, in metres


def extract_curves(curves: bpy.types.Curves, owner: str, report: Report) -> MeshData:
    """Return tubes around all curves, with the first slot's material as in Cycles.

    Args:
        curves: Evaluated hair curves.
        owner: Name for messages, such as `object 'Hair'`.
        report: Takes what was left out or repaired.
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
    steps, every = fit_to_limit(counts, _STEPS, TRIANGLE_LIMIT)
    drawn = counts
    if every > 1:
        drawn = np.where(np.arange(count) % every == 0, counts, 0)
        report.add(ReportKind.SKIPPED, owner, f"has too much hair: one strand in {every} is drawn")
    kept = np.repeat(drawn > 0, counts)
    tubes = make_tubes(Strands(points.reshape(-1, 3)[kept], radii[kept], drawn), steps)
    uv_maps, attributes = _read_attributes(curves, tubes, kept, owner, report)
    data = MeshData(
        name=curves.name, positions=tubes.positions, triangles=tubes.triangles,
        material_slots=np.zeros(len(tubes.triangles), np.int32), corner_normals=tubes.normals[tubes.triangles],
        uv_maps=uv_maps, attributes=attributes)
    data, found = sanitize_mesh(data)
    report_counts(report, owner, found)
    return data


def _read_attributes(curves: bpy.types.Curves, tubes: Tubes, kept: np.ndarray, owner: str, report: Report,
                     ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return UV maps (the first attribute of two numbers, as in Cycles) and attributes at the triangles' corners."""
    uv_maps: dict[str, np.ndarray] = {}
    attributes: dict[str, np.ndarray] = {}
    sizes = {'POINT': len(curves.points), 'CURVE': len(curves.curves)}
    chosen = [attribute for attribute in curves.attributes
              if attribute.name != "position" and not attribute.name.startswith('.')
              and attribute.data_type in ATTRIBUTE_TYPES and len(attribute.data) == sizes.get(attribute.domain)]
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
