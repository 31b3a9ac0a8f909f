# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking read from Blender's collections: numbers, bits, reports, and edits that a viewport must notice."""

from __future__ import annotations

SCENE = r'''
def collection(name, include=(), exclude=()):
    made = bpy.data.collections.new(name)
    for state, things in (('INCLUDE', include), ('EXCLUDE', exclude)):
        for thing in things:
            is_object = isinstance(thing, bpy.types.Object)
            of = made.objects if is_object else made.children
            of.link(thing)
            settings = made.collection_objects if is_object else made.collection_children
            settings[list(of).index(thing)].light_linking.link_state = state
    return made

def linked(table):
    """Return numbers and bits by object; None where the table has none."""
    if table.receives is None:
        return None
    return {name: [int(table.linked_to[i]), int(table.receives[i])] for i, name in enumerate(names(table))}

def lamps(delta):
    return {light.name: light.linked_to for light in delta.lights}

mesh = quad_mesh("Mesh")
a, b, c = link("A", mesh), link("B", mesh), link("C", mesh)
lamp = link("Lamp", bpy.data.lights.new("Lamp", 'POINT'))
sun = link("Sun", bpy.data.lights.new("Sun", 'SUN'))
'''


def test_sets_of_lamps_and_meshes(run_extraction):
    """Number the sets of lamps and meshes, once each, and give every object the bits of those that light it."""
    result = run_extraction(SCENE + r'''
plain, _, _ = extract_all()
lamp.light_linking.receiver_collection = collection("Only A", include=(a,))
sun.light_linking.receiver_collection = collection("Not B", exclude=(b,))
c.light_linking.receiver_collection = collection("A again", include=(a,))
glow = material("Glow"); glow.cycles.emission_sampling = 'NONE'
glow.node_tree.nodes['Principled BSDF'].inputs['Emission Strength'].default_value = 2.0
c.data = mesh.copy(); c.data.materials.append(glow)
delta, report, extractor = extract_all()
finish(plain=[linked(plain.instances), lamps(plain)], linked=linked(delta.instances), lamps=lamps(delta),
       text=report.text(), materials=[[data.name, data.has_emission, data.emission_sampling]
                                      for data in extractor.linked_materials()])
''')
    assert result["plain"] == [None, {"Lamp": 0, "Sun": 0}]
    numbers = result["lamps"]
    assert sorted(numbers.values()) == [1, 2]
    only, but = 1 << numbers["Lamp"], 1 << numbers["Sun"]
    assert result["linked"] == {"A": [0, 1 | only | but], "B": [0, 1], "C": [numbers["Lamp"], 1 | but]}
    assert result["text"] == ""
    assert result["materials"] == [["Glow", True, False]], "what real-time frames can't link"


def test_instances_go_by_their_instancer(run_extraction):
    """Light instances by what is said of their instancer, if anything, else of themselves."""
    result = run_extraction(SCENE + r'''
inside = bpy.data.collections.new("Inside"); leaf = link("Leaf", mesh, inside)
for name in ("Named", "Other"):
    holder = link(name, None); holder.instance_type, holder.instance_collection = 'COLLECTION', inside
inside.objects.link(lamp)
lamp.light_linking.receiver_collection = collection("Set", include=(leaf,))
sun.light_linking.receiver_collection = collection("Other set", include=(bpy.data.objects["Named"], b))
delta, report, _ = extract_all()
table = delta.instances
uids = {item.session_uid: item.name for item in bpy.data.objects}
finish(bits={uids[key[0]] if isinstance(key, tuple) else uids[key]: int(table.receives[i])
             for i, key in enumerate(table.object_keys)}, lamps=[[l.name, l.linked_to] for l in delta.lights])
''')
    numbers = dict(result["lamps"])
    assert len(result["lamps"]) == 4 and all([name, numbers[name]] in result["lamps"] for name in numbers)
    leaf, named = 1 << numbers["Lamp"], 1 << numbers["Sun"]
    assert leaf != named
    assert result["bits"] == {"A": 1, "B": 1 | named, "C": 1, "Named": 1 | named, "Other": 1 | leaf}


def test_what_is_left_out_is_named(run_extraction):
    """Name lamps beyond the 31st set, of receivers or of what casts shadows."""
    result = run_extraction(SCENE + r'''
for i in range(33):
    target = link(f"Target {i:02}", mesh)
    light = link(f"Light {i:02}", bpy.data.lights.new(f"Light {i:02}", 'POINT'))
    light.light_linking.receiver_collection = collection(f"For {i:02}", include=(target,))
a.light_linking.blocker_collection = collection("Blockers", include=(b,))
delta, report, _ = extract_all()
table = delta.instances
finish(lamps=lamps(delta), text=report.text().splitlines(), blocked=dict(zip(names(table), table.blocked_by.tolist())),
       spared=sorted(name for name, spared in zip(names(table), table.spared.tolist()) if spared))
''')
    left_out = {name for name, number in result["lamps"].items() if number == 0} - {"Lamp", "Sun"}
    # One number is that of what casts A's shadows.
    assert len(left_out) == 3 and sorted(result["lamps"].values())[:5] == [0] * 5
    assert sorted([*result["lamps"].values(), result["blocked"]["A"]])[5:] == list(range(1, 32))
    assert result["blocked"]["A"] > 0 and result["blocked"]["B"] == 0
    assert result["spared"] == sorted({"A", "C", *(name for name in result["spared"] if name.startswith("Target"))})
    assert result["text"] == sorted(
        f"approximated: object '{name}': lights everything, or everything casts its shadows: light linking knows 31 "
        "different sets in a scene" for name in left_out)


def test_edits_of_links_are_noticed(run_extraction):
    """Send the lamps or the instances anew after every edit of a link, and nothing where nothing is different."""
    result = run_extraction(SCENE + r'''
receivers, inner = collection("Receivers"), collection("Inner")
view = Viewport()
steps = {}
def after(name, action):
    sent = view.after(action)
    table = view.extractor._table
    steps[name] = [sent and [sent["instances"], sent["lights"], sent["meshes"], sent["full"]],
                   linked(table), {light.name: light.linked_to for light in view.extractor._lights}["Lamp"]]
def state(settings, value):
    return lambda: setattr(settings[0].light_linking, "link_state", value)
after("first", lambda: None)
after("empty", lambda: setattr(lamp.light_linking, "receiver_collection", receivers))
after("added", lambda: receivers.objects.link(a))
after("select", lambda: b.select_set(True))
after("excluded", state(receivers.collection_objects, 'EXCLUDE'))
after("child", lambda: receivers.children.link(inner))
after("in child", lambda: inner.objects.link(b))
after("child excluded", state(receivers.collection_children, 'EXCLUDE'))
after("moved", lambda: setattr(lamp.location, "x", 1.0))
after("moved on", lambda: setattr(lamp.location, "x", 2.0))
after("removed", lambda: receivers.objects.unlink(a))
after("other lamp", lambda: setattr(sun.light_linking, "receiver_collection", receivers))
after("off", lambda: setattr(lamp.light_linking, "receiver_collection", None))
finish(**steps)
''')
    sent = {name: step[0] and [bool(value) for value in step[0]] for name, step in result.items()}
    bits = {name: step[1] and {key: value[1] for key, value in step[1].items()} for name, step in result.items()}
    numbers = {name: step[2] for name, step in result.items()}
    assert sent.pop("first") == [True, True, True, True]
    instances, lights, both, nothing = ([True, False, False, False], [False, True, False, False],
                                        [True, True, False, False], [False, False, False, False])
    assert sent == {
        "empty": nothing, "added": both, "select": nothing, "excluded": instances, "child": nothing,
        "in child": instances, "child excluded": instances, "moved": lights, "moved on": lights, "removed": instances,
        "other lamp": lights, "off": lights}
    assert bits["empty"] is None and bits["added"] == {"A": 3, "B": 1, "C": 1}
    assert bits["excluded"] == {"A": 1, "B": 3, "C": 3}
    assert bits["in child"] == {"A": 1, "B": 3, "C": 1}
    assert bits["child excluded"] == bits["moved on"] == {"A": 1, "B": 1, "C": 3}
    assert bits["removed"] == bits["off"] == {"A": 3, "B": 1, "C": 3}
    assert [numbers[name] for name in ("empty", "added", "moved on", "other lamp", "off")] == [0, 1, 1, 1, 0]
