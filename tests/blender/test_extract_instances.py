# SPDX-License-Identifier: GPL-3.0-or-later
"""Extraction of placements: what is drawn, where, with which materials and flags."""

from __future__ import annotations

import pytest


def test_every_kind_of_geometry(run_extraction):
    """Draw all that becomes a mesh, with its materials, and name what does not."""
    result = run_extraction(r'''
red, blue = material("Red"), material("Blue")
def with_material(data):
    data.materials.append(red)
    return data
link("Mesh", with_material(quad_mesh("Mesh")))
curve = bpy.data.curves.new("Curve", 'CURVE'); curve.dimensions = '3D'; curve.bevel_depth = 0.1
curve.splines.new('POLY').points.add(1); curve.splines[0].points[1].co = (1, 0, 0, 1)
link("Curve", with_material(curve))
link("Empty Curve", bpy.data.curves.new("Empty Curve", 'CURVE'))
text = bpy.data.curves.new("Text", 'FONT'); text.body = "Hi"; link("Text", with_material(text))
ball = bpy.data.metaballs.new("Ball"); ball.elements.new(); link("Ball", with_material(ball))
bpy.ops.surface.primitive_nurbs_surface_sphere_add(); bpy.context.object.name = "Surface"
link("Hair", bpy.data.hair_curves.new("Hair")); link("Points", bpy.data.pointclouds.new("Points"))
link("Smoke", bpy.data.volumes.new("Smoke")); link("Pencil", bpy.data.grease_pencils.new("Pencil"))
link("Probe", bpy.data.lightprobes.new("Probe", 'SPHERE')); link("Empty", None)
furry = link("Furry", quad_mesh("Furry")); furry.modifiers.new("Hair", 'PARTICLE_SYSTEM')
furry.particle_systems[0].settings.type = 'HAIR'
delta, report, _ = extract_all()
table = delta.instances
finish(names=names(table), sets=[[key if key is None else delta.materials[key].name for key in table.material_sets[i]]
                                 for i in table.material_set_index],
       sizes=[len(delta.meshes[table.mesh_keys[i]].triangles) for i in table.mesh_index],
       told={entry.owner: [entry.kind.name, entry.message] for entry in report.entries()})
''')
    drawn = dict(zip(result["names"], result["sets"], strict=True))
    assert set(drawn) == {"Mesh", "Curve", "Text", "Ball", "Surface", "Furry"}
    assert all(drawn[name] == ["Red"] for name in ("Mesh", "Curve", "Text", "Ball"))
    assert drawn["Surface"] == drawn["Furry"] == [None]
    assert all(size > 0 for size in result["sizes"])
    told = result["told"]
    assert {"object 'Points'", "object 'Smoke'", "object 'Pencil'"} <= set(told)
    assert all("not drawn" in told[f"object '{name}'"][1] for name in ("Points", "Smoke", "Pencil"))
    assert told["object 'Probe'"][0] == "INFO"


def test_instancers(run_extraction):
    """Draw collection, vertex, particle and geometry-node instances with their own matrices, keys and ids."""
    result = run_extraction(r'''
leaf = link("Leaf", quad_mesh("Leaf")); leaf.hide_render = False
group = bpy.data.collections.new("Group"); group.objects.link(leaf)
inner = bpy.data.objects.new("Inner", None); inner.instance_type = 'COLLECTION'; inner.instance_collection = group
inner.location.y = 2
outer = bpy.data.collections.new("Outer"); outer.objects.link(inner)
holder = link("Holder", None); holder.instance_type = 'COLLECTION'; holder.instance_collection = outer
holder.location.x = 10
dots = link("Dots", quad_mesh("Dots")); dots.instance_type = 'VERTS'; child = link("Child", quad_mesh("Child"))
child.parent = dots
emitter = link("Emitter", quad_mesh("Emitter")); emitter.modifiers.new("Particles", 'PARTICLE_SYSTEM')
settings = emitter.particle_systems[0].settings
settings.count, settings.frame_end, settings.render_type, settings.instance_object = 3, 1, 'OBJECT', leaf
emitter.show_instancer_for_viewport = False
bpy.context.scene.frame_set(3)
instance_grid("Grid", 3)
delta, report, extractor = extract_all()
table = delta.instances
found = names(table)
holder_leaf = [row for row, key in enumerate(table.object_keys) if isinstance(key, tuple)
               and key[0] == holder.session_uid][0]
grid_rows = [row for row, name in enumerate(found) if name == "Grid"]
again, _, _ = extract_all()
finish(counts={name: found.count(name) for name in set(found)}, unique=len(set(table.object_keys)), total=len(found),
       holder=table.transforms[holder_leaf, :3, 3].tolist(), randoms=len(set(table.random_id.tolist())),
       grid_meshes=len({int(table.mesh_index[row]) for row in grid_rows}),
       grid_places=sorted(table.transforms[grid_rows, :2, 3].round(3).tolist()),
       same_keys=again.instances.object_keys == table.object_keys)
''')
    assert result["counts"] == {"Leaf": 1 + 1 + 3, "Dots": 1, "Child": 4 + 1, "Grid": 9}
    assert result["unique"] == result["total"] and result["same_keys"]
    assert result["holder"] == [10.0, 2.0, 0.0]
    assert result["randoms"] == result["total"]
    assert result["grid_meshes"] == 1
    assert result["grid_places"] == [[x, y] for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.0, 0.5)]


def test_flags_and_materials(run_extraction):
    """Pass on ray visibility, holdouts, overrides, slot links, colours and indices as Cycles does."""
    result = run_extraction(r'''
from burnish.addon.extract.object_hash import object_random_id
red, blue = material("Red"), material("Blue")
shared = quad_mesh("Shared"); shared.materials.append(red); shared.materials.append(None)
shared.polygons[0].material_index = 7
plain = link("Plain", shared)
linked = link("Linked", shared); linked.material_slots[0].link = 'OBJECT'; linked.material_slots[0].material = blue
dim = link("Dim", shared); dim.visible_camera = dim.visible_shadow = False
dim.color = (0.25, 0.5, 0.75, 1); dim.pass_index = 9
hidden = link("Hidden", shared)
for name in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
    setattr(hidden, "visible_" + name, False)
hole = link("Hole", shared); hole.is_holdout = True
group = bpy.data.collections.new("Blockers"); hole.light_linking.blocker_collection = group
catcher = link("Catcher", shared); catcher.is_shadow_catcher = True
cut = bpy.data.collections.new("Cut"); bpy.context.scene.collection.children.link(cut); link("In Cut", shared, cut)
far = bpy.data.collections.new("Far"); bpy.context.scene.collection.children.link(far); link("In Far", shared, far)
layers = bpy.context.view_layer.layer_collection.children
layers["Cut"].holdout = True; layers["Far"].indirect_only = True
inside = bpy.data.collections.new("Inside"); inside.objects.link(plain)
dull = link("Dull", None); dull.instance_type = 'COLLECTION'; dull.instance_collection = inside
dull.visible_glossy = False
delta, report, extractor = extract_all()
table = delta.instances
def row(name, instanced=False):
    return [i for i, found in enumerate(names(table)) if found == name
            and isinstance(table.object_keys[i], tuple) == instanced][0]
def material_names(index):
    return [key and delta.materials[key].name for key in table.material_sets[table.material_set_index[index]]]
flags = {name: int(table.visibility[row(name)]) for name in
         ("Plain", "Dim", "Hole", "Catcher", "In Cut", "In Far")}
bpy.context.view_layer.material_override = blue
override, _, _ = extract_all(extractor)
finish(flags=flags, instanced=int(table.visibility[row("Plain", True)]), names=names(table),
       plain=material_names(row("Plain")), linked=material_names(row("Linked")),
       meshes=len(delta.meshes), slots=next(iter(delta.meshes.values())).material_slots.tolist(),
       color=table.color[row("Dim")].tolist(), index=int(table.pass_index[row("Dim")]),
       hashes=[object_random_id("Cube") / 0xFFFFFFFF, object_random_id("Würfel") / 0xFFFFFFFF],
       own=int(table.random_id[row("Plain")]) == object_random_id("Plain"), messages=report.text(),
       override=[len(set(override.instances.material_sets)), len(override.instances.material_sets[0])])
''')
    everything, camera, glossy, shadow, holdout, catcher = 63, 1, 4, 16, 64, 128
    assert result["flags"] == {
        "Plain": everything, "Dim": everything - camera - shadow, "Hole": everything | holdout,
        "Catcher": everything | catcher, "In Cut": everything | holdout, "In Far": everything - camera}
    assert result["instanced"] == everything - glossy
    assert "Hidden" not in result["names"]
    assert result["plain"] == ["Red", None] and result["linked"] == ["Blue", None]
    assert result["meshes"] == 1 and result["slots"] == [1, 1], "a slot beyond the last is the last"
    assert result["color"] == [0.25, 0.5, 0.75, 1.0] and result["index"] == 9
    # As Cycles 5.2.3 renders Object Info's Random for objects of these names.
    assert result["hashes"] == pytest.approx([0.31314194, 0.57020688], abs=1e-6) and result["own"]
    assert result["messages"] == ""
    assert result["override"] == [1, 2]


def test_viewport_visibility_and_empty_scenes(run_extraction):
    """Hide what a viewport hides, and hand over empty tables where there is nothing."""
    result = run_extraction(r'''
link("Item", quad_mesh("Item")); link("Lamp", bpy.data.lights.new("Lamp", 'SUN'))
space = next(area.spaces[0] for screen in bpy.data.screens for area in screen.areas if area.type == 'VIEW_3D')
shown, _, extractor = extract_all(space=space)
space.show_object_viewport_mesh = False
hidden, _, _ = extract_all(extractor, space=space)
bpy.ops.wm.read_factory_settings(use_empty=True)
empty, report, _ = extract_all()
def shapes(table):
    return [list(array.shape) for array in (table.transforms, table.mesh_index, table.visibility, table.color,
                                            table.random_id)]
finish(shown=names(shown.instances), hidden=shapes(hidden.instances), lights=hidden.lights is None,
       empty=shapes(empty.instances), nothing=[empty.full, empty.lights, len(empty.meshes), report.text()])
''')
    nothing = [[0, 4, 4], [0], [0], [0, 4], [0]]
    assert result["shown"] == ["Item"] and result["hidden"] == nothing and result["lights"]
    assert result["empty"] == nothing and result["nothing"] == [True, [], 0, ""]


def test_odd_transforms(run_extraction):
    """Keep mirrored and sheared transforms, leave out singular ones and say so."""
    result = run_extraction(r'''
mesh = quad_mesh("Mesh")
mirrored = link("Mirrored", mesh); mirrored.scale = (-1, 1, 1)
flat = link("Flat", mesh); flat.scale = (1, 1, 0)
thin = link("Thin", mesh); thin.scale = (1, 1, 1e-4); thin.rotation_euler = (0.3, 0.4, 0.5)
parent = link("Parent", None); parent.scale = (1, 3, 1)
sheared = link("Sheared", mesh); sheared.parent = parent; sheared.rotation_euler = (0, 0, 0.7)
delta, report, _ = extract_all()
table = delta.instances
finish(names=names(table), text=report.text(),
       determinants=np.linalg.det(table.transforms[:, :3, :3]).round(6).tolist(),
       bottom=table.transforms[:, 3].tolist())
''')
    found = dict(zip(result["names"], result["determinants"], strict=True))
    assert found == {"Mirrored": -1.0, "Thin": pytest.approx(1e-4, rel=1e-3),
                     "Sheared": pytest.approx(3.0)}
    assert "object 'Flat': has a scale of zero" in result["text"]
    assert all(row == [0.0, 0.0, 0.0, 1.0] for row in result["bottom"])


def test_large_instance_counts_are_quick(run_extraction):
    """Walk over 10,000 instances within a second of processor time (0.05 s measured; 90,000 take 0.4 s)."""
    result = run_extraction(r'''
import time
grid = instance_grid("Grid", 100)
view = Viewport()
view.after(lambda: None)
def move():
    grid.location.x = 1
start = time.process_time()
moved = view.after(move)
finish(seconds=time.process_time() - start, moved=moved, count=len(view.delta.instances.mesh_index))
''')
    assert result["count"] == 10_000 and result["moved"]["instances"]
    assert result["moved"]["meshes"] <= 1, "geometry nodes may be evaluated again, but only the cube is sent"
    assert result["seconds"] < 1.0


def test_hair_curves(run_extraction):
    """Curves become tubes with their radii, UV and attributes."""
    result = run_extraction(r'''
hair = bpy.data.hair_curves.new("Hair"); hair.add_curves([3, 2])
hair.attributes["position"].data.foreach_set("vector", [0, 0, 0, 0, 0, 1, 0, 0, 2, 5, 0, 0, 5, 0, 1])
radius = hair.attributes.get("radius") or hair.attributes.new("radius", 'FLOAT', 'POINT')
radius.data.foreach_set("value", [0.1, 0.1, 0.1, 0.2, 0.2])
hair.attributes.new("surface_uv", 'FLOAT2', 'CURVE').data.foreach_set("vector", [0.25, 0.5, 0.75, 1.0])
hair.attributes.new("shade", 'FLOAT', 'POINT').data.foreach_set("value", [0, 1, 2, 7, 7])
link("Hair", hair); link("Bald", bpy.data.hair_curves.new("Bald"))
sizes = {}
for kind in ('CATMULL_ROM', 'POLY'):
    bent = bpy.data.hair_curves.new(kind); bent.add_curves([3]); bent.set_types(type=kind); link(kind, bent)
    bent.attributes["position"].data.foreach_set("vector", [0, 0, 0, 0, 0, 1, 0, 1, 1])
    delta, _, _ = extract_all()
    sizes[kind] = len(delta.meshes[delta.instances.mesh_keys[-1]].triangles)
    bpy.data.objects.remove(bpy.data.objects[kind])
delta, report, _ = extract_all()
mesh = delta.meshes[delta.instances.mesh_keys[delta.instances.mesh_index[names(delta.instances).index("Hair")]]]
corners = mesh.positions[mesh.triangles]
finish(names=names(delta.instances), triangles=len(mesh.triangles), low=mesh.positions.min(0).tolist(),
       high=mesh.positions.max(0).tolist(),
       uv=sorted(set(map(tuple, mesh.uv_maps["surface_uv"].reshape(-1, 2).tolist()))),
       # Next to their ends, which count twice, the curves run up to 0.07 slower or faster than the attributes.
       error=float(abs(mesh.attributes["shade"][..., 0] - corners[..., 2])[corners[..., 0] < 2].max()),
       told=[entry.message for entry in report.entries()], sizes=sizes)
''')
    assert result["sizes"] == {"CATMULL_ROM": 2 * 4 * 12, "POLY": 2 * 12}, "polygons are straight between points"
    assert result["names"] == ["Hair"] and not result["told"]
    assert result["triangles"] == (2 + 1) * 12, "what is straight needs no pieces between points"
    assert 0.09 < -result["low"][0] < 0.105 and 5.18 < result["high"][0] < 5.21 and abs(result["high"][2] - 2) < 1e-5
    assert result["uv"] == [[0.25, 0.5], [0.75, 1.0]] and result["error"] < 0.075
