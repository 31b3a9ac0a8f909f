# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes: triangles, normals, UV maps, attributes and texture space, compared with Blender's own."""

from __future__ import annotations

import pytest


def test_geometry_matches_blender(run_extraction):
    """Match Blender's loop triangles, corner normals and UVs on a mesh of triangles, quads and an n-gon."""
    result = run_extraction(r'''
import bmesh
def check(item):
    """Return the largest differences from Blender's own triangles."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    delta, _, _ = extract_all()
    table = delta.instances
    found = delta.meshes[table.mesh_keys[table.mesh_index[names(table).index(item.name)]]]
    mesh = item.evaluated_get(depsgraph).data
    mesh.calc_loop_triangles()
    loops = [loop for triangle in mesh.loop_triangles for loop in triangle.loops]
    places = np.array([mesh.vertices[mesh.loops[loop].vertex_index].co for loop in loops])
    normals = np.array([mesh.corner_normals[loop].vector for loop in loops])
    uvs = {layer.name: np.array([layer.uv[loop].vector for loop in loops]) for layer in mesh.uv_layers}
    slots = [mesh.polygons[triangle.polygon_index].material_index for triangle in mesh.loop_triangles]
    return {
        "triangles": len(found.triangles), "expected": len(mesh.loop_triangles),
        "positions": float(abs(found.positions[found.triangles].reshape(-1, 3) - places).max()),
        "normals": float(abs(found.corner_normals.reshape(-1, 3) - normals).max()),
        "uvs": [float(abs(found.uv_maps[name].reshape(-1, 2) - uvs[name]).max()) for name in uvs],
        "uv_names": list(found.uv_maps), "slots": found.material_slots.tolist() == slots,
        "types": [str(array.dtype) for array in (found.positions, found.triangles, found.corner_normals,
                                                 found.material_slots, *found.uv_maps.values())],
        "layout": all(array.flags.c_contiguous and array.flags.owndata or array.base is not None
                      for array in (found.positions, found.triangles, found.corner_normals)),
        "generated": [found.generated[0].tolist(), found.generated[1].tolist()],
        "texture_space": [list(mesh.texspace_location), list(mesh.texspace_size)],
    }
mesh = bpy.data.meshes.new("Mixed")
build = bmesh.new()
bmesh.ops.create_cone(build, cap_ends=True, segments=7, radius1=1, radius2=0.3, depth=2)
bmesh.ops.create_icosphere(build, subdivisions=2, radius=0.5)
build.to_mesh(mesh)
for face in mesh.polygons:
    face.use_smooth = face.index % 3 != 0
    face.material_index = face.index % 2
mesh.materials.append(material("One")); mesh.materials.append(material("Two"))
for name in ("First", "Second", "Third"):
    layer = mesh.uv_layers.new(name=name)
    layer.uv.foreach_set("vector", np.random.default_rng(len(name)).random(2 * len(mesh.loops), np.float32))
mesh.uv_layers["Second"].active_render = True
item = link("Mixed", mesh)
mixed = check(item)
build = bmesh.new(); bmesh.ops.create_icosphere(build, subdivisions=2, radius=1)
only = bpy.data.meshes.new("Only"); build.to_mesh(only)
only.set_sharp_from_angle(angle=0.1)
triangles_only = check(link("Only", only))
item.modifiers.new("Smooth", 'SUBSURF')
finish(mixed=mixed, triangles_only=triangles_only, modified=check(item))
''')
    for name in ("mixed", "triangles_only", "modified"):
        found = result[name]
        assert found["triangles"] == found["expected"] > 0
        assert found["positions"] == 0.0 and found["slots"] and found["layout"]
        assert found["normals"] < 1e-6 and all(error == 0.0 for error in found["uvs"])
        assert found["types"][:4] == ["float32", "int32", "float32", "int32"]
        assert found["generated"] == found["texture_space"]
    assert result["mixed"]["uv_names"] == ["Second", "First", "Third"]


def test_corners_without_a_normal_are_those_of_cycles(run_extraction):
    """Take up as the normal of corners whose faces cancel each other out, as Cycles' packed normals do."""
    result = run_extraction(r'''
mesh = bpy.data.meshes.new("Folded")
mesh.from_pydata([(0, 0, 0), (0, 1, 0), (0, 0, 1), (0, -1, 0)], [], [(0, 1, 2), (2, 1, 0), (0, 2, 3)])
for face in mesh.polygons:
    face.use_smooth = True
item = link("Folded", mesh)
delta, _, _ = extract_all()
found = delta.meshes[delta.instances.mesh_keys[0]]
finish(zero=[tuple(each.vector) for each in mesh.corner_normals].count((0.0, 0.0, 0.0)),
       up=int((found.corner_normals == np.float32((0, 0, 1))).all(2).sum()))
''')
    assert result["zero"] == result["up"] == 2


def test_attributes(run_extraction):
    """Widen attributes of every type and domain to four numbers a corner, colours first, and limit their number."""
    result = run_extraction(r'''
mesh = bpy.data.meshes.new("Mesh")
mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
def add(name, kind, domain, values, key="value"):
    attribute = mesh.attributes.new(name, kind, domain)
    attribute.data.foreach_set(key, values)
add("weight", 'FLOAT', 'POINT', [0.0, 1.0, 2.0, 3.0])
add("number", 'INT', 'FACE', [7])
add("flag", 'BOOLEAN', 'POINT', [True, False, True, False])
add("flat", 'FLOAT2', 'POINT', np.arange(8.0), "vector")  # on corners it would be a UV map
add("arrow", 'FLOAT_VECTOR', 'FACE', [1.0, 2.0, 3.0], "vector")
add("edge", 'FLOAT', 'EDGE', [1.0] * 4)
mesh.color_attributes.new("Tint", 'FLOAT_COLOR', 'POINT').data.foreach_set("color", np.arange(16.0))
mesh.color_attributes.new("Paint", 'BYTE_COLOR', 'CORNER').data.foreach_set("color", [0.5, 0.25, 1.0, 0.5] * 4)
mesh.color_attributes.render_color_index = 1
link("Item", mesh)
delta, _, _ = extract_all()
found, = delta.meshes.values()
for number in range(20):
    add(f"extra {number}", 'FLOAT', 'POINT', [1.0] * 4)
full, report, _ = extract_all()
limited, = full.meshes.values()
values = {name: found.attributes[name].tolist() for name in
          ("weight", "number", "flag", "flat", "arrow", "Tint", "Paint") if name in found.attributes}
finish(values=values, triangles=found.triangles.tolist(), names=list(found.attributes),
       limited=list(limited.attributes), text=report.text(),
       shapes=sorted({str(array.shape) for array in found.attributes.values()}))
''')
    triangles, values = result["triangles"], result["values"]
    corners = [index for triangle in triangles for index in triangle]

    def flat(name: str) -> list[list[float]]:
        return [corner for triangle in values[name] for corner in triangle]

    assert result["shapes"] == ["(2, 3, 4)"]
    assert flat("weight") == [[float(index)] * 3 + [1.0] for index in corners]
    assert flat("number") == [[7.0, 7.0, 7.0, 1.0]] * 6
    assert flat("flag") == [[1.0 - index % 2] * 3 + [1.0] for index in corners]
    assert flat("flat") == [[2.0 * index, 2.0 * index + 1.0, 0.0, 1.0] for index in corners]
    assert flat("arrow") == [[1.0, 2.0, 3.0, 1.0]] * 6
    assert flat("Tint") == [[4.0 * index + channel for channel in range(4)] for index in corners]
    assert flat("Paint")[0] == pytest.approx([0.5, 0.25, 1.0, 0.5], abs=0.01)
    assert result["names"][:2] == ["Paint", "Tint"], "the colour attribute active for rendering comes first"
    assert len(result["names"]) == 7 and "edge" not in result["names"]
    assert len(result["limited"]) == 2 + 16 and result["limited"][:2] == ["Paint", "Tint"]
    assert "attributes beyond the first 16 were left out" in result["text"]


def test_edit_mode_and_shared_data(run_extraction):
    """Read a mesh in edit mode with its UVs, and one mesh once for all its users."""
    result = run_extraction(r'''
mesh = quad_mesh("Mesh"); mesh.uv_layers.new(name="Map")
item = link("Item", mesh); link("Twin", mesh)
bpy.context.view_layer.objects.active = item
item.select_set(True)
bpy.ops.object.mode_set(mode='EDIT')
editing, _, extractor = extract_all()
counts = extractor.counts.meshes
bpy.ops.mesh.subdivide()
edited, _, _ = extract_all(extractor)
bpy.ops.object.mode_set(mode='OBJECT')
left, _, _ = extract_all(extractor)
after, _, _ = extract_all()
def describe(delta):
    return [[len(data.triangles), list(data.uv_maps)] for data in delta.meshes.values()]
finish(editing=describe(editing), counts=counts, edited=describe(edited), after=describe(after),
       instances=len(after.instances.mesh_index))
''')
    assert result["editing"] == [[2, ["Map"]]] * result["counts"]
    assert [8, ["Map"]] in result["edited"], "an edit shows before edit mode is left"
    assert result["after"] == [[8, ["Map"]]] and result["instances"] == 2


def test_corners_are_copied_as_they_lie_in_memory(run_extraction):
    """Copy the corners of many triangles at once; leave it where they lie otherwise, or are others, in memory."""
    result = run_extraction(r'''
import bmesh, types
from burnish.addon.extract.mesh import _copy_corners
mesh = bpy.data.meshes.new("Grid")
build = bmesh.new(); bmesh.ops.create_grid(build, x_segments=9, y_segments=7, size=1); build.to_mesh(mesh)
mesh.calc_loop_triangles()
expected = np.empty(3 * len(mesh.loop_triangles), np.int32)
mesh.loop_triangles.foreach_get("loops", expected)
found = _copy_corners(mesh.loop_triangles)
others = list(mesh.loop_triangles)
others[1], others[2] = others[2], others[1]
wrong = [types.SimpleNamespace(as_pointer=each.as_pointer, loops=(0, 0, 0)) for each in mesh.loop_triangles]
finish(same=found is not None and found.tolist() == expected.tolist(), count=len(expected),
       elsewhere=_copy_corners(others) is None, wrong=_copy_corners(wrong) is None)
''')
    assert result["same"] and result["count"] == 3 * 2 * 63
    assert result["elsewhere"] and result["wrong"]
