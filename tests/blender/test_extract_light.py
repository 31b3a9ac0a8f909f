# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps: every field that Cycles reads, in Blender's units."""

from __future__ import annotations

import pytest


def test_lamps(run_extraction):
    """Copy kind, shape, strength, flags and place of all lamps, instanced ones too; leave portals out."""
    result = run_extraction(r'''
def lamp(name, kind, **values):
    light = bpy.data.lights.new(name, kind)
    for key, value in values.items():
        setattr(light, key, value)
    return link(name, light)
point = lamp("Point", 'POINT', energy=10, color=(1, 0.5, 0.25), exposure=2, shadow_soft_size=0.3,
             use_soft_falloff=False)
point.location = (1, 2, 3)
lamp("Warm", 'POINT', energy=2, use_temperature=True, temperature=3000, normalize=False, use_shadow=False)
lamp("Sun", 'SUN', energy=3, angle=0.1)
lamp("Spot", 'SPOT', spot_size=1.2, spot_blend=0.4, shadow_soft_size=0.0)
lamp("Square", 'AREA', shape='SQUARE', size=2, size_y=5, spread=1.0)
lamp("Ellipse", 'AREA', shape='ELLIPSE', size=2, size_y=5)
dim = lamp("Dim", 'POINT'); dim.visible_glossy = False
dim.data.cycles.use_multiple_importance_sampling = False
portal = lamp("Portal", 'AREA'); portal.data.cycles.is_portal = True
group = bpy.data.collections.new("Group"); group.objects.link(point)
holder = link("Holder", None); holder.instance_type = 'COLLECTION'; holder.instance_collection = group
holder.location.x = 10
delta, report, _ = extract_all()
lights = {}
for light in delta.lights:
    lights.setdefault(light.name, []).append({
        key: (list(value) if isinstance(value, tuple) else value.tolist() if isinstance(value, np.ndarray) else value)
        for key, value in vars(light).items() if key != "program"})
finish(lights=lights, text=report.text(), warm=list(bpy.data.lights["Warm"].temperature_color))
''')
    lights = result["lights"]
    assert set(lights) == {"Point", "Warm", "Sun", "Spot", "Square", "Ellipse", "Dim"}
    point, instanced = sorted(lights["Point"], key=lambda light: light["transform"][0][3])
    assert point["color"] == pytest.approx([40.0, 20.0, 10.0]) and point["kind"] == "POINT"
    assert point["radius"] == pytest.approx(0.3) and not point["soft_falloff"] and point["normalize"]
    assert [row[3] for row in point["transform"]] == [1.0, 2.0, 3.0, 1.0]
    assert instanced["transform"][0][3] == 11.0
    warm, = lights["Warm"]
    assert warm["color"] == pytest.approx([2.0 * value for value in result["warm"][:3]])
    assert not warm["normalize"] and not warm["cast_shadow"]
    assert lights["Sun"][0]["angle"] == pytest.approx(0.1)
    assert [lights["Spot"][0][key] for key in ("spot_size", "spot_blend", "radius")] == pytest.approx([1.2, 0.4, 0.0])
    square, ellipse = lights["Square"][0], lights["Ellipse"][0]
    assert (square["shape"], square["size_x"], square["size_y"]) == ("SQUARE", 2.0, 2.0)
    assert square["spread"] == pytest.approx(1.0)
    assert (ellipse["shape"], ellipse["size_x"], ellipse["size_y"]) == ("ELLIPSE", 2.0, 5.0)
    # Blender hides new lamps from the camera.
    assert lights["Dim"][0]["visibility"] == 63 - 4 - 1 and not lights["Dim"][0]["use_mis"]
    assert "light 'Portal': is a light portal" in result["text"]


def test_node_factor_and_updates(run_extraction):
    """Multiply by the constant factor of a lamp's nodes, and notice when it changes."""
    result = run_extraction(r'''
light = bpy.data.lights.new("Lamp", 'POINT'); light.energy, light.color = 10, (1, 1, 1)
light.use_nodes = True
emission = next(node for node in light.node_tree.nodes if node.type == 'EMISSION')
emission.inputs['Strength'].default_value = 3
emission.inputs['Color'].default_value = (1, 0.5, 0, 1)
link("Lamp", light)
view = Viewport()
view.after(lambda: None)
first = view.delta.lights[0].color
changed = view.after(lambda: setattr(emission.inputs['Strength'], "default_value", 6))
finish(first=first, changed=changed, second=view.delta.lights[0].color)
''')
    assert result["first"] == pytest.approx([30.0, 15.0, 0.0])
    assert result["changed"]["lights"] and result["second"] == pytest.approx([60.0, 30.0, 0.0])


def test_program_and_updates(run_extraction):
    """Send a lamp whose tree varies with its program and image, and again when the tree changes."""
    result = run_extraction(r'''
light = bpy.data.lights.new("Lamp", 'SPOT'); light.energy, light.color = 10, (1, 1, 1)
light.use_nodes = True
nodes, links = light.node_tree.nodes, light.node_tree.links
emission = next(node for node in nodes if node.type == 'EMISSION')
emission.inputs['Strength'].default_value = 3
gobo = nodes.new("ShaderNodeTexImage")
gobo.image = bpy.data.images.new("gobo", 4, 4)
mapping = nodes.new("ShaderNodeMapping")
links.new(nodes.new("ShaderNodeTexCoord").outputs["UV"], mapping.inputs["Vector"])
links.new(mapping.outputs["Vector"], gobo.inputs["Vector"])
links.new(gobo.outputs["Color"], emission.inputs["Color"])
item = link("Lamp", light)
view = Viewport()
view.after(lambda: None)
first = view.delta.lights[0]
images = len(view.delta.images)
def turn():
    mapping.inputs["Scale"].default_value[0] = 2.0
changed = view.after(turn)
second = view.delta.lights[0]
moved = view.after(lambda: setattr(item, "location", (1, 0, 0)))
third = view.delta.lights[0]
constant = view.after(lambda: links.remove(emission.inputs["Color"].links[0]))
finish(color=first.color, images=images, changed=changed, differs=first.program != second.program,
       kept=second.program == third.program, last=view.delta.lights[0].program is None, text=view.report.text()
       if hasattr(view, "report") else "")
''')
    assert result["color"] == pytest.approx([10.0] * 3) and result["images"] == 1
    assert result["changed"]["lights"] and result["differs"] and result["kept"] and result["last"]
    assert "light" not in result["text"]
