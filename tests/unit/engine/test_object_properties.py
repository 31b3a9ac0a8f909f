# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of objects that programs read: their names, and their values by instance in pictures and after edits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from burnish.engine.materials import attribute_names
from burnish.engine.object_properties import ObjectProperties, property_name, property_names, split_name
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData, SceneDelta
from burnish.engine.session import Session

from tests import scenes

OWN, MAKERS = property_name("glow", instancer=False), property_name("a:b", instancer=True)


def test_names_tell_whose_they_are() -> None:
    """Keep a property's name, colons included, and whose it is; keep them out of the meshes' attributes."""
    assert split_name(OWN) == ("glow", False) and split_name(MAKERS) == ("a:b", True)
    assert property_names(["Col", OWN, MAKERS, OWN]) == (MAKERS, OWN)
    builder = ProgramBuilder()
    builder.emit(builder.object_property(OWN), builder.attribute("Col"), 1.0)
    program = builder.finish()
    assert attribute_names([program]) == ["Col"] and property_names(program.attributes) == (OWN,)


def test_unknown_names_have_no_number(device: str) -> None:
    """Number what a table has, and leave all other names to the meshes."""
    properties = ObjectProperties(device)
    values = np.ones((2, 3, 4), np.float32)
    assert properties.update((MAKERS, OWN), values) and not properties.update((MAKERS, OWN), values.copy())
    number = properties.resolver(lambda name: 7)
    assert [number(name) for name in (OWN, MAKERS, property_name("other", instancer=True), "Col")] == [1, 0, -1, 7]
    assert properties.update((), None) and not properties.update((), None)


def shining() -> MaterialData:
    """Return a material that emits the property."""
    builder = ProgramBuilder()
    builder.emit(builder.object_property(OWN), 1.0, 1.0)
    return MaterialData(name="shining", program=builder.finish(), has_emission=True)


def test_each_instance_shows_its_own(device: str) -> None:
    """Show each instance's value with one material, the new ones after an edit, and black for what no object has."""
    objects = [("quad", scenes.place(x=x), "shining") for x in (-0.5, 0.5)]
    made = scenes.delta({"quad": scenes.quad(0.4)}, objects, {"shining": shining()})
    values = np.array([[[0.25, 0.5, 0.75, 1.0], [2.0, 1.0, 0.5, 1.0]]], np.float32)
    made.instances = replace(made.instances, property_names=(OWN,), properties=values)
    session = Session(scenes.SETTINGS)

    def shown() -> np.ndarray:
        session.configure(scenes.SETTINGS, scenes.camera_above(half=1.0), 8, 8)
        session.step(1)
        return session.read()[4, [2, 5], :3]

    session.update(made)
    np.testing.assert_allclose(shown(), values[0, :, :3], rtol=1e-5)
    brighter = replace(made.instances, properties=2.0 * values)
    session.update(SceneDelta(instances=brighter))
    np.testing.assert_allclose(shown(), 2.0 * values[0, :, :3], rtol=1e-5)
    session.update(SceneDelta(instances=replace(brighter, property_names=(), properties=None)))
    np.testing.assert_allclose(shown(), 0.0)
    session.close()
