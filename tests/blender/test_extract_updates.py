# SPDX-License-Identifier: GPL-3.0-or-later
"""Extraction after edits: only what changed is read and sent."""

from __future__ import annotations

SCENE = r'''
import mathutils
shared = quad_mesh("Shared")
paint = material("Paint"); other = material("Other")
shared.materials.append(paint)
a, b = link("A", shared), link("B", shared)
b.location.x = 3
c = link("C", quad_mesh("Own")); c.modifiers.new("Smooth", 'SUBSURF')
camera = link("Camera", bpy.data.cameras.new("Camera")); bpy.context.scene.camera = camera
lamp = link("Lamp", bpy.data.lights.new("Lamp", 'POINT'))
world = bpy.data.worlds.new("World"); world.use_nodes = True; bpy.context.scene.world = world
view = Viewport()
'''


def test_edits_send_only_what_changed(run_extraction):
    """Send everything once and then only what an edit touched."""
    result = run_extraction(SCENE + r'''
def edit_mesh():
    shared.vertices[0].co.x = -1.0
    shared.update()
def edit_modified_mesh():
    c.data.vertices[0].co.x = -1.0
    c.data.update()
def edit_material():
    paint.node_tree.nodes['Principled BSDF'].inputs['Roughness'].default_value = 0.25
def edit_world():
    world.node_tree.nodes['Background'].inputs['Strength'].default_value = 3.0
finish(
    first=view.after(lambda: None),
    camera=view.after(lambda: setattr(camera.location, "x", 2)),
    lens=view.after(lambda: setattr(camera.data, "lens", 20)),
    move=view.after(lambda: setattr(a.location, "x", 1)),
    moved=view.delta.instances.transforms[:, 0, 3].tolist(), moved_names=names(view.delta.instances),
    select=view.after(lambda: b.select_set(True)),
    mesh=view.after(edit_mesh), mesh_name=[mesh.name for mesh in view.delta.meshes.values()],
    modified=view.after(edit_modified_mesh),
    material=view.after(edit_material), material_reads=view.extractor.counts.materials,
    world=view.after(edit_world),
    lamp=view.after(lambda: setattr(lamp.data, "energy", 7)),
    lamp_move=view.after(lambda: setattr(lamp.location, "x", 7)),
    color=view.after(lambda: setattr(a, "color", (1, 0, 0, 1))),
    hide=view.after(lambda: a.hide_set(True)),
    show=view.after(lambda: a.hide_set(False)),
)
''')
    nothing = {"full": False, "meshes": 0, "instances": False, "materials": 0, "lights": False, "world": False}

    def sent(step: str) -> dict:
        return {key: value for key, value in result[step].items() if key != "walked"}

    assert sent("first") == {"full": True, "meshes": 2, "instances": True, "materials": 1, "lights": True,
                             "world": True}
    assert sent("camera") == sent("lens") == nothing
    assert result["camera"]["walked"] == result["lens"]["walked"] == 0
    assert sent("move") == nothing | {"instances": True}
    assert dict(zip(result["moved_names"], result["moved"], strict=True)) == {"A": 1.0, "B": 3.0, "C": 0.0}
    assert sent("select") == nothing
    assert sent("mesh") == nothing | {"meshes": 1} and result["mesh_name"] == ["Shared"]
    assert sent("modified") == nothing | {"meshes": 1}
    assert sent("material") == nothing | {"materials": 1} and result["material_reads"] == 1
    assert sent("world") == nothing | {"world": True} and result["world"]["walked"] == 0
    assert sent("lamp") == sent("lamp_move") == nothing | {"lights": True}
    assert sent("color") == nothing | {"instances": True}
    assert sent("hide") == sent("show") == nothing | {"instances": True}


def test_keys_survive_edits(run_extraction):
    """Keep mesh and object keys over edits, so that a session can replace instead of add."""
    result = run_extraction(SCENE + r'''
view.after(lambda: None)
first = view.delta.instances
def edit():
    shared.vertices[0].co.x = -1.0
    shared.update()
view.after(edit)
edited = sorted(view.delta.meshes)
view.after(lambda: bpy.data.objects.remove(a))
left = view.delta.instances
view.after(edit)
finish(keys=[first.mesh_keys[index] for index in first.mesh_index], edited=edited,
       left=[left.mesh_keys[index] for index in left.mesh_index], names=names(left),
       kept=[key in first.object_keys for key in left.object_keys], after=sorted(view.delta.meshes))
''')
    shared, again, own = result["keys"]
    assert shared == again != own
    assert result["edited"] == result["after"] == [shared]
    assert result["names"] == ["B", "C"] and result["left"] == [shared, own] and result["kept"] == [True, True]


def test_shared_mesh_splits_when_one_user_is_modified(run_extraction):
    """Send another mesh when a modifier makes one of two users of a mesh differ."""
    result = run_extraction(SCENE + r'''
view.after(lambda: None)
view.after(lambda: a.modifiers.new("Smooth", 'SUBSURF'))
table = view.extractor._table
finish(keys=[table.mesh_keys[index] for index in table.mesh_index], names=names(table),
       sizes={key: len(mesh.triangles) for key, mesh in view.delta.meshes.items()})
''')
    of = dict(zip(result["names"], result["keys"], strict=True))
    assert len(set(result["keys"])) == 3
    assert result["sizes"][str(of["A"])] == 8 and result["sizes"].get(str(of["B"]), 2) == 2


def test_undo_and_file_load(run_extraction, tmp_path):
    """Show the scene as it is after undo, and start afresh after loading a file."""
    result = run_extraction(SCENE + f"path = {str(tmp_path / 'scene.blend')!r}\n" + r'''
bpy.context.preferences.edit.use_global_undo = True
bpy.ops.wm.save_as_mainfile(filepath=path)
bpy.ops.ed.undo_push(message="start")
view.after(lambda: None)
view.after(lambda: setattr(bpy.data.objects["A"].location, "x", 5))
bpy.ops.ed.undo_push(message="move")
moved = float(view.extractor._table.transforms[0, 0, 3])
view.extractor.refresh()
undone = view.after(bpy.ops.ed.undo)
back = float(view.extractor._table.transforms[0, 0, 3])
def load():
    bpy.ops.wm.open_mainfile(filepath=path)
    bpy.app.handlers.depsgraph_update_post.append(view.update)
    bpy.data.objects["A"].location.y = 1
loaded = view.after(load)
finish(moved=moved, back=back, undone=undone, loaded=loaded)
''')
    assert result["moved"] == 5.0 and result["back"] == 0.0
    assert result["undone"]["instances"] and not result["undone"]["full"]
    assert result["loaded"]["full"] and result["loaded"]["meshes"] == 2


def test_cancel_starts_afresh(run_extraction):
    """Raise ExtractionCancelled when told to, and read everything again afterwards."""
    result = run_extraction(SCENE + r'''
bpy.app.handlers.depsgraph_update_post.clear()
extractor, asked, told = SceneExtractor(), [], []
def cancelled():
    asked.append(None)
    return len(asked) > 3
try:
    extract_all(extractor, cancelled=cancelled)
    raised = False
except ExtractionCancelled:
    raised = True
delta, _, _ = extract_all(extractor, progress=lambda text, fraction: told.append((text, fraction)))
again, _, _ = extract_all(extractor)
finish(raised=raised, full=delta.full, meshes=len(delta.meshes), told=told,
       again=[again.full, len(again.meshes), again.instances is None, len(again.materials)])
''')
    assert result["raised"] and result["full"] and result["meshes"] == 2
    assert result["again"] == [False, 0, True, 0]
    assert any("Reading mesh 'A'" in text for text, _ in result["told"])
    assert all(0.0 <= fraction <= 1.0 for _, fraction in result["told"])


def test_node_groups_and_images(run_extraction):
    """Notice an edit inside a node group, an assigned image and new pixels in it."""
    result = run_extraction(SCENE + r'''
group = bpy.data.node_groups.new("Group", 'ShaderNodeTree')
group.interface.new_socket("Value", in_out='OUTPUT', socket_type='NodeSocketFloat')
value, output = group.nodes.new('ShaderNodeValue'), group.nodes.new('NodeGroupOutput')
group.links.new(value.outputs[0], output.inputs[0])
nodes, links = paint.node_tree.nodes, paint.node_tree.links
user = nodes.new('ShaderNodeGroup'); user.node_tree = group
links.new(user.outputs[0], nodes['Principled BSDF'].inputs['Roughness'])
view.after(lambda: None)
edited = view.after(lambda: setattr(value.outputs[0], "default_value", 0.3))
image = bpy.data.images.new("Image", 4, 4)
texture = nodes.new('ShaderNodeTexImage'); texture.image = image
links.new(texture.outputs[0], nodes['Principled BSDF'].inputs['Base Color'])
assigned = [view.after(lambda: None), len(view.delta.images)]
def repaint():
    image.pixels[0:4] = [1, 0, 0, 1]
    image.update()
    image.update_tag()
painted = [view.after(repaint), len(view.delta.images)]
finish(edited=edited, assigned=assigned, painted=painted)
''')
    assert result["edited"]["materials"] == 1 and result["edited"]["meshes"] == 0
    assert result["assigned"][0]["materials"] == 1 and result["assigned"][1] == 1
    assert result["painted"][1] == 1 and result["painted"][0]["materials"] == 0
