# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated Blender mesh to StoredMesh: copies of positions, triangles, normals, UV maps and attributes.

Reads attributes instead of RNA properties wherever there is one: `attributes['position']` takes 0.9 ms where
`vertices.foreach_get('co')` takes 16.7 ms for 980,000 triangles. Main thread only; keeps nothing of bpy.
"""

from __future__ import annotations

import ctypes

import bpy
import numpy as np

from ...engine.mesh_features import ISLAND, POINTINESS
from ...engine.report import Report, ReportKind
from ...engine.stored_mesh import CORNER, FACE, POINT, StoredMesh

__all__ = ["ATTRIBUTE_LIMIT", "ATTRIBUTE_TYPES", "extract_mesh", "read_vec4"]

ATTRIBUTE_LIMIT = 16
"""Generic attributes read per mesh; colour attributes always come along"""

MANY_TRIANGLES = 200
"""From which on reading their corners one by one takes longer than _copy_corners"""

# Python property and number of components per attribute type that a shader can read.
ATTRIBUTE_TYPES = {
    'FLOAT': ('value', 1),
    'INT': ('value', 1),
    'INT8': ('value', 1),
    'BOOLEAN': ('value', 1),
    'FLOAT2': ('vector', 2),
    'INT16_2D': ('value', 2),
    'INT32_2D': ('value', 2),
    'FLOAT_VECTOR': ('vector', 3),
    'FLOAT_COLOR': ('color', 4),
    'BYTE_COLOR': ('color', 4),
    'QUATERNION': ('value', 4),
}
_COLOR_TYPES = {'FLOAT_COLOR', 'BYTE_COLOR'}
_INTEGER_TYPES = {'INT', 'INT8', 'INT16_2D', 'INT32_2D'}
# Geometry itself, which has fields of its own in MeshData.
_GEOMETRY_NAMES = {'position', 'material_index', 'sharp_face', 'custom_normal'}


def extract_mesh(mesh: bpy.types.Mesh, owner: str, slot_count: int, report: Report,
                 derived: frozenset[str] = frozenset()) -> StoredMesh:
    """Copy an evaluated mesh as it is.

    Args:
        mesh: Evaluated mesh, not in edit mode.
        owner: Name for messages, such as `object 'Floor'`.
        slot_count: Material slots of the instance; indices are clamped to them as Blender does.
        report: Takes what was left out.
        derived: Attributes of engine/mesh_features.py that it shall have.

    Returns:
        A mesh that may have no triangles at all.
    """
    if not len(mesh.loops) or not len(mesh.vertices):
        return _empty_mesh(mesh.name)  # which may lack even the attributes read below
    corner_vertices = _read(mesh.attributes['.corner_vert'].data, 'value', np.int32, len(mesh.loops))
    intact = bool(corner_vertices.view(np.uint32).max() < len(mesh.vertices))
    if not intact and len(mesh.loops) != 3 * len(mesh.polygons):
        # Blender itself would read beyond the vertices while it splits the polygons.
        report.add(ReportKind.SKIPPED, owner, "names vertices that don't exist and was left out; run Mesh > Clean Up")
        return _empty_mesh(mesh.name)
    corners, faces = _read_triangles(mesh)
    stored = StoredMesh(
        name=mesh.name,
        positions=_read(mesh.attributes['position'].data, 'vector', np.float32, len(mesh.vertices), 3),
        corner_vertices=corner_vertices, corners=corners, faces=faces,
        slots=_read_material_slots(mesh, slot_count),
        normals=_read(mesh.corner_normals, 'vector', np.float32, len(mesh.loops), 3) if intact else None,
        uv_maps=_read_uv_maps(mesh),
        attributes=_read_attributes(mesh, owner, report),
        generated=_read_texture_space(mesh),
    )
    if intact:
        _read_features(mesh, stored, derived & {ISLAND, POINTINESS})
    return stored


def _read(collection: bpy.types.bpy_prop_collection, name: str, dtype: type, count: int,
          components: int = 1) -> np.ndarray:
    """Return one property of all items, [count] or [count, components]."""
    values = np.empty(count * components, dtype)
    collection.foreach_get(name, values)
    return values if components == 1 else values.reshape(count, components)


def _empty_mesh(name: str) -> StoredMesh:
    return StoredMesh(name=name, positions=np.empty((0, 3), np.float32), corner_vertices=np.empty(0, np.int32),
                      corners=None, faces=None)


def _read_triangles(mesh: bpy.types.Mesh) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return the corners [3T] and the face [T] of each triangle; (None, None) where every face is a triangle."""
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    if count == len(mesh.polygons) and len(mesh.loops) == 3 * count:
        return None, None
    corners = _copy_corners(mesh.loop_triangles) if count >= MANY_TRIANGLES else None
    if corners is None:
        corners = _read(mesh.loop_triangles, 'loops', np.int32, 3 * count)
    faces = _read(mesh.loop_triangle_polygons, 'value', np.int32, count)
    return corners, faces


def _copy_corners(triangles: bpy.types.MeshLoopTriangles) -> np.ndarray | None:
    """Return the corners of triangles, int32 [3T], as Blender has them in memory; None where they lie otherwise there.

    `foreach_get` asks for each triangle by itself: 0.2 s for a million, as long as all else of a mesh. That three
    integers follow three is tried at both ends, as nothing promises it.
    """
    count, size = len(triangles), 3 * np.dtype(np.int32).itemsize
    tried = [triangles[index] for index in (0, 1, count - 1)]
    start, second, last = (triangle.as_pointer() for triangle in tried)
    if second - start != size or last - start != size * (count - 1) or size * count >= 1 << 31:
        return None
    corners = np.frombuffer(ctypes.string_at(start, size * count), np.int32)
    same = [tuple(triangle.loops) for triangle in tried] == [
        tuple(corners[3 * index:3 * index + 3].tolist()) for index in (0, 1, count - 1)]
    return corners if same else None


def _read_material_slots(mesh: bpy.types.Mesh, slot_count: int) -> np.ndarray | None:
    """Return int32 [F], None where all faces have the first slot."""
    attribute = mesh.attributes.get('material_index')
    if attribute is None or attribute.domain != FACE or attribute.data_type != 'INT' or slot_count < 2:
        return None
    slots = _read(attribute.data, 'value', np.int32, len(mesh.polygons))
    return np.clip(slots, 0, slot_count - 1, out=slots)


def _read_uv_maps(mesh: bpy.types.Mesh) -> dict[str, np.ndarray]:
    """Return float32 [L, 2] of all UV maps, the one active for rendering first."""
    # Sorting is stable: the others keep Blender's order.
    layers = sorted(mesh.uv_layers, key=lambda layer: not layer.active_render)
    maps, count = {}, len(mesh.loops)
    for layer in layers:
        attribute = mesh.attributes.get(layer.name)
        if attribute is not None and len(attribute.data) == count:
            maps[layer.name] = _read(attribute.data, 'vector', np.float32, count, 2)
    return maps


def _read_attributes(mesh: bpy.types.Mesh, owner: str, report: Report) -> dict[str, tuple[str, np.ndarray]]:
    """Return domain and values of colour attributes (the one active for rendering first), then of others.

    Of those up to ATTRIBUTE_LIMIT.
    """
    sizes = {POINT: len(mesh.vertices), CORNER: len(mesh.loops), FACE: len(mesh.polygons)}
    uv_names = {layer.name for layer in mesh.uv_layers}
    chosen = [attribute for attribute in mesh.attributes
              if attribute.name not in _GEOMETRY_NAMES and attribute.name not in uv_names
              and not attribute.name.startswith('.') and attribute.domain in sizes
              and attribute.data_type in ATTRIBUTE_TYPES]
    colors = [attribute for attribute in chosen if attribute.data_type in _COLOR_TYPES]
    active = mesh.color_attributes.render_color_index if colors else -1
    active_name = mesh.color_attributes[active].name if 0 <= active < len(mesh.color_attributes) else None
    colors.sort(key=lambda attribute: attribute.name != active_name)
    others = [attribute for attribute in chosen if attribute.data_type not in _COLOR_TYPES]
    if len(others) > ATTRIBUTE_LIMIT:
        names = ", ".join(f"'{attribute.name}'" for attribute in others[ATTRIBUTE_LIMIT:])
        report.add(ReportKind.SKIPPED, owner, f"attributes beyond the first {ATTRIBUTE_LIMIT} were left out: {names}")
    values = {}
    for attribute in colors + others[:ATTRIBUTE_LIMIT]:
        if len(attribute.data) == sizes[attribute.domain]:
            values[attribute.name] = attribute.domain, read_vec4(attribute)
    return values


def _read_features(mesh: bpy.types.Mesh, stored: StoredMesh, names: frozenset[str]) -> None:
    """Read what attributes are worked out from."""
    if names:
        stored.derived = names
        stored.edges = _read(mesh.attributes['.edge_verts'].data, 'value', np.int32, len(mesh.edges), 2)
    if POINTINESS in names:
        stored.vertex_normals = _read(mesh.vertex_normals, 'vector', np.float32, len(mesh.vertices), 3)


def read_vec4(attribute: bpy.types.Attribute) -> np.ndarray:
    """Return float32 [N, 4] as Cycles widens attributes: a number fills red, green and blue; alpha is 1."""
    name, components = ATTRIBUTE_TYPES[attribute.data_type]
    dtype = np.int32 if attribute.data_type in _INTEGER_TYPES else np.float32
    if attribute.data_type == 'BOOLEAN':
        dtype = np.bool_
    count = len(attribute.data)
    stored = _read(attribute.data, name, dtype, count, components).reshape(count, components)
    if components == 4:
        return stored.astype(np.float32, copy=False)
    values = np.zeros((count, 4), np.float32)
    values[:, :max(components, 1)] = stored
    if components == 1:
        values[:, 1:3] = stored
    values[:, 3] = 1.0
    return values


def _read_texture_space(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return location and size of the texture space, which Generated coordinates map to 0..1."""
    return np.array(mesh.texspace_location, np.float32), np.array(mesh.texspace_size, np.float32)
