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
    drive(b.driver_add(path).driver, empty, expression)

def drive(driver, item, expression):
    """Let an object's place drive something."""
    variable = driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = item, "location.x"
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


def test_places_are_read_of_what_moves_alone(run_extraction):
    """Ask no object where it is but those that an update names, without instances, and have all that follows right."""
    result = run_extraction(SCENE + r'''
import sys
moves = sys.modules[SceneExtractor.__module__.rpartition(".")[0] + ".moves"]
bulk, read = [], moves.read_transforms
def counted(*arguments):
    bulk.append(1)
    return read(*arguments)
moves.read_transforms = counted
bpy.data.objects.remove(empty)
follower, aimed, held, mirrored = (link(name, shared) for name in ("Follower", "Aimed", "Held", "Mirrored"))
follower.constraints.new('COPY_LOCATION').target = a
aimed.constraints.new('TRACK_TO').target = b
aimed.location = (5, 1, 0)
drive(held.driver_add("location", 1).driver, a, "x")
drive(held.driver_add("hide_viewport").driver, a, "x > 5.0")
mirrored.parent, mirrored.scale.x = b, -1
hidden = link("Hidden", shared)
hidden.parent, hidden.hide_viewport = a, True
view.after(lambda: None)
steps = []
def step(action):
    before = len(bulk)
    sent = view.after(action)
    steps.append((sent["walked"] > 0, len(bulk) - before, sent["instances"], sent["lights"], places()))
def move(item, x):
    step(lambda: setattr(item.location, "x", x))
def both():
    a.location.x, aimed.location.y = 3.0, 2.0
def swap():
    follower.constraints[0].target = aimed
for x in (1.0, 2.0, -0.5, -0.5):
    move(a, x)
step(both)
move(a, 0.0)
step(swap)
move(aimed, -2.0)
move(aimed, -3.0)
for x in (1.0, 6.0, 7.0, 1.0, 2.0):
    move(a, x)
graph = bpy.context.evaluated_depsgraph_get()
finish(steps=steps, instanced=sum(item.is_instance for item in graph.object_instances))
''')
    walked, bulk, instances, lights, same = map(list, zip(*result["steps"], strict=True))
    assert result["instanced"] == 0 and all(same)
    # Another target of a constraint is more than a move, and so is what is hidden by one or shown.
    assert walked == [False] * 6 + [True] + [False] * 3 + [True, False, True, False] and not any(bulk)
    assert instances == [index != 3 for index in range(14)]
    assert lights == [index not in (3, 6, 7, 8) for index in range(14)]
