# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair of particle systems: which strands are drawn, when they are read again, and pictures against Cycles."""

from __future__ import annotations

import numpy as np
import pytest

FURRY = r'''
def furry(name, count=3, **options):
    """Make a square of two materials with hair of its second one."""
    item = link(name, quad_mesh(name))
    item.data.materials.append(material("Skin")); item.data.materials.append(material("Fur"))
    item.modifiers.new("Hair", 'PARTICLE_SYSTEM')
    settings = item.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length, settings.material = 'HAIR', count, 0.5, 2
    settings.root_radius, settings.radius_scale, settings.use_close_tip = 1.0, 0.02, False
    for key, value in options.items():
        setattr(settings, key, value)
    return item
def meshes(delta, name):
    """Return the meshes of an object's instances: its own first."""
    table = delta.instances
    return [delta.meshes[table.mesh_keys[table.mesh_index[row]]] for row, found in enumerate(names(table))
            if found == name]
'''
SIDES = 6


def test_strands(run_extraction):
    """Strands stand on the emitter, taper from root to tip, and have the material that the settings name."""
    result = run_extraction(FURRY + r'''
item = furry("Cat")
uv = item.data.uv_layers.new(name="Map")
uv.data.foreach_set("uv", [value for loop in item.data.loops
                           for value in item.data.vertices[loop.vertex_index].co[:2]])
paint = item.data.color_attributes.new("Paint", 'BYTE_COLOR', 'CORNER')
for corner in paint.data:
    corner.color = (0.25, 0.5, 0.75, 1.0)
item.location = (5, 6, 7); item.rotation_euler = (0.3, 0.2, 0.1); item.scale = (1, 2, 1)
delta, report, _ = extract_all()
own, hair = meshes(delta, "Cat")
roots = hair.positions.reshape(-1, 3, 6, 3)[:, 0].mean(1)
corners = hair.positions[hair.triangles]
at_root = np.abs(corners[..., 2]) < 1e-5
finish(names=names(delta.instances), shape=hair.positions.shape, slots=np.unique(hair.material_slots).tolist(),
       low=hair.positions.min(0).tolist(), high=hair.positions.max(0).tolist(),
       uv=float(np.abs(hair.uv_maps["Map"] - roots[hair.triangles // 18][..., :2]).max()),
       paint=hair.attributes["Paint"].reshape(-1, 4)[[0, -1]].tolist(), told=report.text(),
       keys=[len(set(delta.instances.object_keys)), len(set(delta.instances.mesh_index.tolist()))],
       attributes=sorted(hair.attributes), normals=float(np.abs(np.linalg.norm(hair.corner_normals, axis=2) - 1).max()))
''')
    assert result["names"] == ["Cat", "Cat"] and result["keys"] == [2, 2] and result["told"] == ""
    # Three strands of two pieces, which are what straight ones need.
    assert result["shape"] == [3 * 3 * SIDES, 3] and result["slots"] == [1]
    # The world's half of a metre is one in the direction that the object stretches by less.
    assert result["low"][2] == pytest.approx(0, abs=0.011) and 0.4 < result["high"][2] < 0.52
    assert result["uv"] < 1e-3, "the square's UV are its coordinates"
    assert result["attributes"] == ["Paint"]
    np.testing.assert_allclose(result["paint"], [[0.25, 0.5, 0.75, 1.0]] * 2, atol=0.004)
    assert result["normals"] < 1e-4


def test_children_and_steps(run_extraction):
    """Children stand in for their parents, a viewport shows the share of them that is asked for."""
    result = run_extraction(FURRY + r'''
view = {"brownian_factor": 0.5, "display_step": 3}
many = {"rendered_child_count": 50, "child_percent": 4, "child_type": 'SIMPLE'}
furry("Bare"); furry("Bent", **view); furry("Children", **many)
furry("Half", display_percentage=50, **many); furry("None left", display_percentage=1, **many)
furry("Interpolated", **(many | {"child_type": 'INTERPOLATED'})); furry("Hidden", render_type='NONE')
furry("No system").modifiers[0].show_viewport = False
furry("Two", count=2).modifiers.new("More", 'PARTICLE_SYSTEM').particle_system.settings = \
    bpy.data.objects["Bent"].particle_systems[0].settings
delta, report, _ = extract_all()
def strands(name):
    return [len(mesh.positions) // 6 for mesh in meshes(delta, name)[1:]]
finish(rings={item.name: strands(item.name) for item in bpy.data.objects})
''')
    rings = result["rings"]
    assert rings["Hidden"] == rings["No system"] == []
    assert rings["Bare"] == [3 * 3] and rings["Children"] == [12 * 3] and rings["Half"] == [6 * 3]
    assert rings["None left"] == [3 * 3], "without children the parents are drawn"
    assert rings["Interpolated"] == [12 * 3]
    pieces = (rings["Bent"][0] // 3 - 1) // 8
    assert pieces in (1, 2, 4) and rings["Bent"] == [3 * (8 * pieces + 1)]
    assert rings["Two"] == [2 * (2 * pieces + 1) + rings["Bent"][0]], "both systems' hair is one mesh"


def test_who_shows_hair(run_extraction):
    """Hair is drawn without its emitter, on instances of it, and not while it is edited or the layer has none."""
    result = run_extraction(FURRY + r'''
item = furry("Cat"); item.show_instancer_for_viewport = False
group = bpy.data.collections.new("Group"); group.objects.link(item)
for place in (3, 6):
    holder = link("Holder", None); holder.instance_type = 'COLLECTION'; holder.instance_collection = group
    holder.location.x = place
def shown():
    delta, report, _ = extract_all()
    table = delta.instances
    return [] if table is None else [names(table), sorted(table.transforms[:, 0, 3].tolist()), len(delta.meshes),
                                     len(set(table.object_keys)), len(set(table.random_id.tolist()))]
alone = shown()
item.show_instancer_for_viewport = True
both = shown()
bpy.context.view_layer.use_strand = False
without = shown()
bpy.context.view_layer.use_strand = True
for holder in [holder for holder in bpy.data.objects if holder.type == 'EMPTY']:
    bpy.data.objects.remove(holder)
bpy.context.view_layer.objects.active = item
bpy.ops.object.mode_set(mode='PARTICLE_EDIT')
edited = shown()
finish(alone=alone, both=both, without=without, edited=edited)
''')
    assert result["alone"] == [["Cat"] * 3, [0.0, 3.0, 6.0], 1, 3, 3]
    assert result["both"] == [["Cat"] * 6, [0.0, 0.0, 3.0, 3.0, 6.0, 6.0], 2, 6, 3]
    assert result["without"] == [["Cat"] * 3, [0.0, 3.0, 6.0], 1, 3, 3]
    assert result["edited"][0] == ["Cat"]


def test_what_is_read_again(run_extraction):
    """Hair is read again when its settings or its emitter change, and not when something else does."""
    result = run_extraction(FURRY + r'''
item = furry("Cat"); other = link("Other", quad_mesh("Other")); settings = item.particle_systems[0].settings
viewport = Viewport(); bpy.context.view_layer.update()
def widest():
    found = meshes(viewport.delta, "Cat")
    return float(found[1].positions.reshape(-1, 6, 3)[0].std()) if len(found) > 1 else 0.0
first = viewport.after(lambda: setattr(settings, "radius_scale", 0.02))
moved = viewport.after(lambda: setattr(other, "location", (3, 0, 0)))
wide = viewport.after(lambda: setattr(settings, "radius_scale", 0.04)); hair = list(viewport.delta.meshes.values())
more = viewport.after(lambda: setattr(settings, "count", 5)); grown = list(viewport.delta.meshes.values())
gone = viewport.after(lambda: setattr(settings, "render_type", 'NONE'))
left = len(viewport.extractor._table.mesh_index)
back = viewport.after(lambda: setattr(settings, "render_type", 'PATH'))
bent = viewport.after(lambda: setattr(item.data.vertices[0], "co", (0, 0, 1)) or item.data.update())
finish(first=first, moved=moved, wide=wide, more=more, gone=gone, left=left, back=back, bent=bent,
       sizes=[max(len(mesh.positions) for mesh in found) for found in (hair, grown)])
''')
    assert result["moved"]["meshes"] == 0 and result["moved"]["instances"]
    assert result["wide"]["meshes"] in (1, 2) and result["more"]["meshes"] in (1, 2)
    assert result["sizes"] == [3 * 3 * SIDES, 5 * 3 * SIDES]
    assert result["gone"]["instances"] and result["left"] == 2
    assert result["back"]["meshes"] >= 1 and result["bent"]["meshes"] == 2


def test_attributes_for_hair_info(run_extraction):
    """Hair has what the Hair Info node reads where a material asks for it, and then its emitter has not."""
    result = run_extraction(FURRY + r'''
item = furry("Cat"); viewport = Viewport(); fur = item.data.materials[1]; link("Other", quad_mesh("Other"))
before = viewport.after(lambda: setattr(item.particle_systems[0].settings, "count", 4))
plain = [sorted(mesh.attributes) for mesh in meshes(viewport.delta, "Cat")]
def ask():
    info = fur.node_tree.nodes.new("ShaderNodeHairInfo"); shader = fur.node_tree.nodes["Principled BSDF"]
    fur.node_tree.links.new(info.outputs["Random"], shader.inputs["Roughness"])
    fur.node_tree.links.new(info.outputs["Tangent Normal"], shader.inputs["Base Color"])
after = viewport.after(ask)
asked = [sorted(mesh.attributes) for mesh in viewport.delta.meshes.values()]
again = viewport.after(lambda: setattr(bpy.data.objects["Other"], "location", (1, 2, 3)))
finish(plain=plain, asked=asked, again=again, told=viewport.report.text())
''')
    assert result["plain"] == [[], []]
    assert sorted(result["asked"]) == [[], [".hair", ".strand"]]
    assert result["again"]["meshes"] == 0 and result["told"] == ""


def test_positions_for_motion(run_extraction):
    """Places in other frames are those of the vertices that are drawn, of hair and of meshes."""
    result = run_extraction(FURRY + r'''
from burnish.addon.extract.geometry import read_geometry, read_positions
from burnish.addon.extract.instances import gather_instances
furry("Cat", brownian_factor=0.2)
hair = bpy.data.hair_curves.new("Hair"); hair.add_curves([3, 2])
hair.attributes["position"].data.foreach_set("vector", [0, 0, 0, 0, 1, 1, 0, 0, 2, 5, 0, 0, 5, 0, 1])
link("Hair", hair)
gathered = gather_instances(bpy.context.evaluated_depsgraph_get(), space=None, report=Report())
def same(source):
    return bool((read_positions(source) == read_geometry(source, Report()).positions).all())
finish(same=[[source.name, source.hair, same(source)] for source in gathered.sources])
''')
    assert result["same"] == [["Cat", "", True], ["Cat", "VIEWPORT", True], ["Hair", "", True]]


def test_color_of_principled_hair(run_extraction):
    """Melanin and absorption make the albedo that Chiang et al. give; strands differ where a random share is asked."""
    result = run_extraction(r'''
from burnish.addon.extract.material import make_graph
from burnish.addon.extract.node_hair import hair_color
from burnish.kernels import node_codes as codes
BY_NAME = {"ADD": np.add, "SUBTRACT": np.subtract, "MULTIPLY": np.multiply, "DIVIDE": np.divide, "MAXIMUM": np.maximum,
           "LOGARITHM": lambda a, base: np.log(a) / np.log(base), "EXPONENT": lambda a, _: np.exp(a),
           "SQRT": lambda a, _: np.sqrt(a)}
MATH = {int(getattr(codes, "MATH_" + name)): function for name, function in BY_NAME.items()}
def worked_out(build, value):
    """Return what a value of numbers comes to."""
    if value.constant is not None:
        return np.array(value.constant[:3])
    a, b, c = [worked_out(build, build.values[index]) for index in (*value.args, *value.args[:1] * 2)[:3]]
    if value.op == codes.OP_MATH:
        return MATH[value.sub](a, b)
    assert value.op == codes.OP_VECTOR and value.sub == codes.VECTOR_COMBINE
    return np.array([a[0], b[0], c[0]])
def color(parametrization, **inputs):
    made = material("Hair"); tree = made.node_tree; tree.nodes.clear()
    node = tree.nodes.new("ShaderNodeBsdfHairPrincipled"); node.parametrization = parametrization
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    inlined = bpy.types.InlineShaderNodes.from_material(made)
    graph = make_graph(inlined.node_tree, None, Report(), "material", hair=True)
    found = hair_color(graph, next(node for node in inlined.node_tree.nodes if "HairPrincipled" in node.bl_idname))
    attributes = graph.builder.attributes
    return [None if attributes else worked_out(graph.builder, found).tolist(), attributes]
finish(plain=color('COLOR', Color=(0.7, 0.4, 0.2, 1)), melanin=color('MELANIN', Melanin=0.5, Melanin_Redness=0.25),
       absorption=color('ABSORPTION', Absorption_Coefficient=(0.1, 0.4, 0.9)),
       tint=color('MELANIN', Melanin=0.0, Tint=(0.7, 0.4, 0.2, 1)), random=color('MELANIN', Random_Color=0.5))
''')
    # The polynomial of a radial roughness of 0.3; without melanin the tint alone is the colour.
    scale = np.polyval([0.245, 5.574, -10.73, 2.532, -0.215, 5.969], 0.3)
    amount = -np.log(0.5)
    sigma = amount * (0.75 * np.array([0.506, 0.841, 1.653]) + 0.25 * np.array([0.343, 0.733, 1.924]))
    assert result["plain"][0][:3] == pytest.approx([0.7, 0.4, 0.2])
    assert result["melanin"][0][:3] == pytest.approx(np.exp(-scale * np.sqrt(sigma)).tolist(), rel=1e-4)
    assert result["absorption"][0][:3] == pytest.approx(np.exp(-scale * np.sqrt([0.1, 0.4, 0.9])).tolist(), rel=1e-4)
    assert result["tint"][0][:3] == pytest.approx([0.7, 0.4, 0.2], rel=1e-4)
    assert result["random"] == [None, [".hair"]]


def test_hair_of_objects(run_extraction):
    """Hair drawn as objects or a collection makes instances and no strands."""
    result = run_extraction(FURRY + r'''
leaf = link("Leaf", quad_mesh("Leaf", 0.1))
group = bpy.data.collections.new("Group"); group.objects.link(leaf)
furry("Tree", render_type='OBJECT', instance_object=leaf)
furry("Bush", render_type='COLLECTION', instance_collection=group)
delta, report, _ = extract_all()
finish(names=names(delta.instances), told=report.text())
''')
    assert sorted(result["names"]) == ["Bush"] + ["Leaf"] * 7 + ["Tree"] and result["told"] == ""


@pytest.mark.slow
def test_many_strands_are_read_in_time(run_extraction):
    """10,000 strands of ten children each, 900,000 points, are read in seconds: about 5 on two cores."""
    result = run_extraction(FURRY + r'''
import time
item = furry("Cat", count=10_000, child_type='INTERPOLATED', child_percent=10, display_step=3)
bpy.context.evaluated_depsgraph_get()
start = time.perf_counter(); delta, report, _ = extract_all()
finish(seconds=time.perf_counter() - start, rings=len(meshes(delta, "Cat")[1].positions) // 6)
''')
    assert result["rings"] >= 100_000 * 3 and result["seconds"] < 30
