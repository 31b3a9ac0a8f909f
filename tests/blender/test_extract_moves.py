# SPDX-License-Identifier: GPL-3.0-or-later
"""Extraction while objects only move: instances aren't walked over again, and come out as if they were."""

from __future__ import annotations

SCENE = r'''
shared = quad_mesh("Shared")
shared.materials.append(material("Paint"))
a, b = link("A", shared), link("B", shared)
b.parent = a
lamp = link("Lamp", bpy.data.lights.new("Lamp", 'POINT')); lamp.parent = b
kept = bpy.data.collections.new("Kept")
link("Inner", shared, kept); link("Inner lamp", bpy.data.lights.new("Inner lamp", 'POINT'), kept)
empty = link("Empty", None); empty.instance_type = 'COLLECTION'; empty.instance_collection = kept
empty.location.z = 2
view = Viewport()
view.after(lambda: None)

def places():
    """Return what was sent last, and what a fresh extractor makes of the same scene, in a comparable form."""
    def plain(table, lights):
        return (names(table), table.transforms.tolist(), table.pass_index.tolist(), table.visibility.tolist(),
                [light.transform.tolist() for light in lights])
    fresh, _, _ = extract_all()
    extractor = view.extractor
    return plain(extractor._table, extractor._lights) == plain(fresh.instances, fresh.lights)

def driven(path, expression):
    """Let the empty's place drive a property of B."""
    driver = b.driver_add(path).driver
    variable = driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = empty, "location.x"
    driver.expression = expression.replace("x", variable.name)
'''


def test_moves_spare_the_walk(run_extraction):
    """Walk once for an object that begins to move, then read places alone: its children's, lamps', instances'."""
    result = run_extraction(SCENE + r'''
steps = []
for item in (a, a, a, empty, empty, a):
    def move():
        item.location.x += 1.0
    sent = view.after(move)
    steps.append((sent["walked"], sent["instances"], sent["lights"], places(), sent["meshes"] + sent["materials"]))
again = view.after(lambda: setattr(a.location, "x", a.location.x))
finish(steps=steps, again=[again["walked"], again["instances"], again["lights"]])
''')
    walked, instances, lights, same, others = zip(*result["steps"], strict=True)
    assert [count > 0 for count in walked] == [True, False, False, True, False, True]
    assert all(instances) and all(lights) and all(same) and not any(others)
    assert result["again"] == [0, False, False]


def test_more_than_a_move_is_walked(run_extraction):
    """Walk wherever an object looks different, appears, goes or can't be drawn where it is."""
    result = run_extraction(SCENE + r'''
def push():
    empty.location.x += 1.0
def moved(action=lambda: None):
    """Push twice, then again with the action; return whether that was walked and came out right."""
    view.after(push); spared = view.after(push)
    def both():
        push(); action()
    sent = view.after(both)
    return spared["walked"], sent["walked"] > 0, places()
def reported():
    return [entry.message for entry in view.report.entries() if "scale" in entry.message]
driven("pass_index", "int(x) % 5"); passes = moved()
b.driver_remove("pass_index")
driven("hide_viewport", "x > 9.5"); shown = moved()
empty.location.x = 7.0; hidden = moved()
b.driver_remove("hide_viewport"); b.hide_viewport = False
colored = moved(lambda: setattr(b, "color", (1, 0, 0, 1)))
modified = moved(lambda: b.modifiers.new("Smooth", 'SUBSURF'))
edited = moved(lambda: setattr(lamp.data, "energy", 7))
added = moved(lambda: link("New", shared))
empty.scale.x = 1.0
flattened = moved(lambda: setattr(empty.scale, "x", 0.0)), reported()
restored = moved(lambda: setattr(empty.scale, "x", 1.0)), reported()
finish(passes=passes, shown=shown, hidden=hidden, colored=colored, modified=modified, edited=edited, added=added,
       flattened=flattened, restored=restored)
''')
    # A driver that changes what is moved along with it leaves no step to spare.
    assert result["passes"][0] > 0 and result["passes"][1:] == [True, True]
    assert result["shown"] == [0, False, True]
    for name in ("hidden", "colored", "modified", "edited", "added"):
        assert result[name] == [0, True, True], name
    assert result["flattened"][0] == [0, True, True] and len(result["flattened"][1]) == 1
    assert result["restored"][0][1:] == [True, True] and result["restored"][1] == []
