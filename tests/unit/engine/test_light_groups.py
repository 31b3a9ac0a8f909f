# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's light groups: each holds its lights' share of the picture, and together they make it up."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import MaterialData, SceneDelta, Visibility
from burnish.engine.session import Session
from burnish.engine.settings import LightPathSettings
from burnish.engine.stress import scenes as made

from tests import scenes

GROUPS = ("key", "fill", "sun", "glow", "sky")
PASSES = tuple(f"Combined_{name}" for name in GROUPS)
CAMERA = scenes.camera_above(half=1.7)


def uneven_glow():
    """Return a material whose emission is a program: brighter on one side."""
    builder = ProgramBuilder()
    along = builder.component(builder.input("GENERATED"), 0)
    builder.emit((4.0, 2.0, 1.0), builder.math("MULTIPLY_ADD", along, 1.0, 0.5), 1.0)
    builder.closure("DIFFUSE", 1.0, color=0.5)
    return MaterialData(name="uneven", program=builder.finish(), has_emission=True)


def studio(*lit, glow=None, world=None):
    """Return a scene in which the lights of the groups in `lit` shine, all without any."""
    lit = lit or GROUPS
    emission = (4.0, 2.0, 1.0) if "glow" in lit else 0.0
    materials = {
        "floor": scenes.material("PRINCIPLED", color=(0.8, 0.4, 0.2), roughness=0.3, specular_level=0.5, ior=1.5,
                                 specular_tint=1.0),
        "glass": scenes.material("GLASS", color=(0.9, 1.0, 0.95), roughness=0.1, ior=1.45),
        "leaf": scenes.material("TRANSLUCENT", color=(0.2, 0.7, 0.1)),
        "metal": scenes.material("PRINCIPLED", color=(0.9, 0.7, 0.3), metallic=1.0, roughness=0.0, ior=1.5),
        "glow": glow if glow and "glow" in lit else scenes.material(color=0.5, emission=emission),
        "veil": scenes.transparent(0.6, color=(0.7, 0.2, 0.2)),
    }
    meshes = {"floor": scenes.quad(3.0), "ball": scenes.sphere(0.4, 12), "veil": scenes.quad(0.6)}
    objects = [("floor", np.eye(4), "floor"), ("veil", scenes.place(x=-0.6, y=0.6, z=1.2), "veil")]
    objects += [("ball", scenes.place(x=i % 2 - 0.7, y=i // 2 - 0.5, z=0.45), name)
                for i, name in enumerate(("metal", "glass", "leaf", "glow"))]
    lamps = {
        "key": scenes.lamp("AREA", 40.0, scenes.place(x=0.5, z=2.0), shape="SQUARE", size_x=0.5, light_group="key",
                           visibility=int(Visibility.ALL & ~Visibility.GLOSSY)),
        "fill": scenes.lamp("POINT", 20.0, scenes.place(x=-1.5, z=1.0), radius=0.1, light_group="fill"),
        "sun": scenes.lamp("SUN", 0.5, angle=0.1, light_group="sun"),
    }
    # A lamp without power is left out, and a sun comes last: numbers must follow.
    lights = [scenes.lamp("POINT", 0.0), *(lamps[name] for name in ("sun", "key", "fill") if name in lit)]
    sky = (world or scenes.world(0.3)) if "sky" in lit else scenes.world(0.0)
    sky.light_group = "sky"
    delta = scenes.delta(meshes, objects, materials, lights, sky)
    index = np.full(len(objects), -1, np.int32)
    index[-1] = 0
    delta.instances.light_groups, delta.instances.light_group_index = ["glow"], index
    return delta


def shot(delta, passes=(), samples=4, size=(48, 32), **paths):
    """Render a delta; return the session."""
    settings = dataclasses.replace(
        scenes.SETTINGS, light_paths=LightPathSettings(**paths),
        film=dataclasses.replace(scenes.SETTINGS.film, exposure=1.5))
    session = Session(settings)
    session.update(delta)
    session.configure(settings, CAMERA, *size, passes=("Combined", *passes))
    session.step(samples)
    return session


def ramp_sky():
    """Return a world that varies: brighter above."""
    def build(builder):
        up = builder.component(builder.input("POSITION"), 2)
        builder.emit((0.5, 0.7, 1.0), builder.math("MULTIPLY_ADD", up, 0.2, 0.3), 1.0)

    return made.world(build=build)


@pytest.mark.parametrize("programs", [False, True], ids=["even", "programs"])
@pytest.mark.parametrize("paths", [{}, {"clamp_direct": 0.7, "clamp_indirect": 0.3}], ids=["free", "clamped"])
def test_groups_make_up_the_picture(paths, programs):
    """Get Combined within rounding as the sum of the groups that hold all light; and its bits as without them."""
    delta = studio(glow=uneven_glow(), world=ramp_sky()) if programs else studio()
    session = shot(delta, (*PASSES, "Diffuse Direct"), **paths)
    combined = session.read()
    total = sum(session.read(name) for name in PASSES)
    np.testing.assert_allclose(total, combined[..., :3], rtol=1e-4, atol=1e-5)
    plain = shot(delta, **paths)
    assert all(slot.light is None for slot in plain._pass.slots)
    np.testing.assert_array_equal(combined, plain.read())


@pytest.mark.parametrize("name", GROUPS)
def test_each_group_is_its_lights(name):
    """Match pictures with the lights of the group alone, by the mean of blocks."""
    programs = {"glow": uneven_glow(), "world": ramp_sky()} if name in ("glow", "sky") else {}
    together = shot(studio(**programs), PASSES, 48).read(f"Combined_{name}")
    alone = shot(studio(name, **programs), (), 48).read()[..., :3]
    a, b = (picture.reshape(4, 8, 6, 8, 3).mean((1, 3)) for picture in (together, alone))
    assert alone.max() > 0.1
    np.testing.assert_allclose(a.mean(), b.mean(), rtol=0.05)
    off = np.abs(a - b) / (np.maximum(a, b) + 0.02)
    assert np.median(off) < 0.05 and np.percentile(off, 90) < 0.3, np.percentile(off, (50, 90, 100))


def test_what_is_in_no_group_is_in_none():
    """Leave lights without a group, or of one that is not asked for, out; take edits in."""
    delta = studio()
    session = shot(delta, ("Combined_key", "Combined_nobody"), 2)
    assert session.read("Combined_nobody").max() == 0.0
    key, combined = session.read("Combined_key"), session.read()[..., :3]
    assert 0.0 < key.mean() < 0.8 * combined.mean() and (key <= combined + 1e-5).all()
    for light in delta.lights:
        light.light_group = "nobody"
    session.update(SceneDelta(lights=list(delta.lights)))
    session.step(2)
    assert session.read("Combined_key").max() == 0.0 and session.read("Combined_nobody").mean() > key.mean()
    with pytest.raises(KeyError):
        session.read("Combined_sky")


def test_holdouts_hide_groups():
    """Show no light of any group where a holdout is seen, not even of a lamp in front of it."""
    delta = studio()
    delta.instances.visibility[0] |= int(Visibility.HOLDOUT)
    session = shot(delta, PASSES, 2)
    combined = session.read()
    assert (combined[..., 3] >= 0.0).all() and (combined[..., :3].max(-1) == 0.0).mean() > 0.2
    total = sum(session.read(name) for name in PASSES)
    np.testing.assert_allclose(total, combined[..., :3], rtol=1e-4, atol=1e-5)
