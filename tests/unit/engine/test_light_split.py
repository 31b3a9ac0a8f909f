# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's light passes: they make up the picture, which stays bit for bit what it is without them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.passes.composite import LIGHT_PASSES
from burnish.engine.scene import Visibility
from burnish.engine.session import Session
from burnish.engine.settings import LightPathSettings

from tests import scenes

ALL = ("Combined", "Emission", "Environment", *LIGHT_PASSES)
LOBES = ("Diffuse", "Glossy", "Transmission")

MATERIALS = {
    "floor": scenes.material("PRINCIPLED", color=(0.8, 0.4, 0.2), roughness=0.3, specular_level=0.5, ior=1.5),
    "metal": scenes.material("PRINCIPLED", color=(0.9, 0.7, 0.3), metallic=1.0, roughness=0.0, ior=1.5),
    "bronze": scenes.material("PRINCIPLED", color=(0.9, 0.5, 0.2), metallic=1.0, roughness=0.2, ior=1.5),
    "glass": scenes.material("GLASS", color=(0.9, 1.0, 0.95), roughness=0.0, ior=1.45),
    "frosted": scenes.material("PRINCIPLED", color=(0.5, 0.9, 0.8), transmission=1.0, roughness=0.4, ior=1.45),
    "leaf": scenes.material("TRANSLUCENT", color=(0.2, 0.7, 0.1)),
    "velvet": scenes.material("PRINCIPLED", color=(0.3, 0.1, 0.5), sheen=0.8, sheen_roughness=0.4, sheen_tint=1.0,
                              coat=0.6, coat_roughness=0.2, coat_ior=1.5, coat_tint=1.0, roughness=0.6, ior=1.5,
                              specular_level=0.5),
    "lit": scenes.material(color=0.5, emission=(3.0, 2.0, 1.0)),
    "veil": scenes.transparent(0.6, color=(0.7, 0.2, 0.2)),
}


def still_life():
    """Return balls of all kinds of surface on a glossy floor, a pane, a veil, two lamps, a mesh light and a sky."""
    meshes = {"floor": scenes.quad(3.0), "ball": scenes.sphere(0.4, 12), "veil": scenes.quad(0.6)}
    names = ("metal", "glass", "frosted", "leaf", "velvet", "lit")
    objects = [("floor", np.eye(4), "floor")]
    objects += [("ball", scenes.place(x=i % 3 - 1.0, y=i // 3 - 0.5, z=0.45), name) for i, name in enumerate(names)]
    objects.append(("ball", scenes.place(x=-1.2, y=-1.3, z=0.45), "bronze"))
    objects.append(("veil", scenes.place(x=-0.6, y=0.6, z=1.2), "veil"))
    # Of one surface: the lit ball behind it is met after one scattering.
    objects.append(("veil", scenes.place(x=1.0, y=0.5, z=1.0), "frosted"))
    lamps = [scenes.lamp("AREA", 40.0, scenes.place(x=0.5, z=2.0), shape="SQUARE", size_x=0.5,
                         visibility=int(Visibility.ALL & ~Visibility.GLOSSY)),
             scenes.lamp("POINT", 20.0, scenes.place(x=-1.5, z=1.0), radius=0.1)]
    return scenes.delta(meshes, objects, MATERIALS, lamps, 0.3)


def shot(delta, passes, samples=4, size=(48, 32), film=(), camera=None, **paths):
    """Render a delta; return the session."""
    settings = dataclasses.replace(
        scenes.SETTINGS, light_paths=LightPathSettings(**paths),
        film=dataclasses.replace(scenes.SETTINGS.film, **dict(film)))
    session = Session(settings)
    session.update(delta)
    session.configure(settings, camera or scenes.camera_above(half=1.7), *size, passes=passes)
    session.step(samples)
    return session


def composited(session):
    """Return what a compositor makes of the passes."""
    total = session.read("Emission") + session.read("Environment")
    for lobe in LOBES:
        direct, indirect, color = (session.read(f"{lobe} {part}") for part in ("Direct", "Indirect", "Color"))
        total = total + (direct + indirect) * color
    return total


@pytest.mark.parametrize("paths", [{}, {"clamp_direct": 0.7, "clamp_indirect": 0.3}, {"max_bounces": 2}],
                         ids=["free", "clamped", "short"])
def test_passes_make_up_the_picture(paths):
    """Get Combined within rounding from the passes; and the same bits of it as without them."""
    delta = still_life()
    session = shot(delta, ALL, film={"exposure": 1.7}, **paths)
    combined = session.read()
    np.testing.assert_allclose(composited(session), combined[..., :3], rtol=2e-5, atol=2e-5)
    for lobe in LOBES:
        for part in ("Direct", "Indirect", "Color"):
            picture = session.read(f"{lobe} {part}")
            assert np.isfinite(picture).all() and picture.min() >= 0.0 and picture.max() > 0.01, (lobe, part)
    plain = shot(delta, ("Combined",), film={"exposure": 1.7}, **paths)
    np.testing.assert_array_equal(combined, plain.read())


def test_no_buffers_unless_asked_for():
    """Keep nothing of paths and no sums without light passes, and only those of the lobes that are asked for."""
    session = shot(still_life(), ("Combined", "Depth"), samples=1, size=(8, 8))
    assert not session._film.light and all(slot.light is None for slot in session._pass.slots)
    with pytest.raises(KeyError):
        session.read("Diffuse Direct")
    session = shot(still_life(), ("Combined", "Glossy Color"), samples=1, size=(8, 8))
    assert session._pass.slots[0].light.groups is None and session.read("Glossy Color").max() > 0.0
    with pytest.raises(KeyError):
        session.read("Diffuse Direct")


def test_a_matte_floor_under_a_sun():
    """Find all light diffuse and direct, its albedo the colour, weakened by a veil that is no scattering."""
    meshes = {"plane": scenes.quad(20.0)}
    objects = [("plane", np.eye(4), "grey"), ("plane", scenes.place(z=1.0), "veil")]
    materials = {"grey": scenes.material(color=(0.5, 0.25, 0.1)), "veil": scenes.transparent(0.5, color=0.0)}
    camera = scenes.camera_above(half=0.1)
    session = shot(scenes.delta(meshes, objects, materials, [scenes.lamp("SUN", np.pi)]), ALL, 512, (8, 8),
                   camera=camera)
    color = session.read("Diffuse Color").mean((0, 1))
    # The veil is black: half of the samples see no colour and half of the light arrives at the others.
    np.testing.assert_allclose(color, [0.25, 0.125, 0.05], rtol=0.02)
    np.testing.assert_allclose(session.read("Diffuse Direct").mean((0, 1)), 0.5, rtol=0.02)
    for name in set(LIGHT_PASSES) - {"Diffuse Color", "Diffuse Direct"}:
        assert session.read(name).max() < 1e-6, name


def test_direct_light_is_that_after_one_scattering():
    """Tell the light of each order apart in a closed white box: albedo ** k of its emission after k scatterings."""
    meshes = {"box": scenes.box(1.0, inward=True)}
    box = scenes.material(color=0.5, emission=1.0)
    camera = scenes.camera_above(height=0.0, half=0.1)
    session = shot(scenes.delta(meshes, [("box", np.eye(4), "box")], {"box": box}), ALL, 1024, (8, 8), camera=camera)
    np.testing.assert_allclose(session.read("Emission"), 1.0, rtol=1e-5)
    np.testing.assert_allclose(session.read("Diffuse Color"), 0.5, rtol=1e-5)
    # The lit walls shine with 1; what they reflect of each other adds 0.5 + 0.25 + ... of that.
    np.testing.assert_allclose(session.read("Diffuse Direct").mean(), 1.0, rtol=0.02)
    np.testing.assert_allclose(session.read("Diffuse Indirect").mean(), 1.0, rtol=0.02)


@pytest.mark.parametrize("off", [Visibility.GLOSSY, Visibility.DIFFUSE], ids=["not glossy", "not diffuse"])
def test_lamps_switched_off_for_a_lobe(off):
    """Count no light of a lamp for the lobe for which it is switched off, though the surface has that lobe."""
    # Without extent: a lamp that paths meet is shared by the lobes' values, whichever its ray was drawn from, as in
    # Cycles.
    lamp = scenes.lamp("POINT", 50.0, scenes.place(x=0.3, z=1.5),
                       visibility=int(Visibility.ALL & ~off & ~Visibility.CAMERA))
    floor = scenes.material("PRINCIPLED", color=(0.8, 0.4, 0.2), roughness=0.3, specular_level=0.5, ior=1.5,
                            specular_tint=1.0)
    session = shot(scenes.delta({"floor": scenes.quad(3.0)}, [("floor", np.eye(4), "floor")], {"floor": floor}, [lamp]),
                   ALL, 16, (16, 16))
    lit, dark = ("Diffuse", "Glossy") if off == Visibility.GLOSSY else ("Glossy", "Diffuse")
    assert session.read(f"{lit} Direct").max() > 0.1 and session.read(f"{dark} Direct").max() < 1e-6
    np.testing.assert_allclose(composited(session), session.read()[..., :3], rtol=2e-5, atol=2e-5)


def test_lamps_in_view_count_as_emission():
    """Show a lamp that the camera sees in the Emission pass, and the world in Environment, both exposed."""
    lamp = scenes.lamp("POINT", 50.0, scenes.place(z=1.0), radius=0.3)
    floor = scenes.material(color=0.5)
    session = shot(scenes.delta({"floor": scenes.quad(0.6)}, [("floor", np.eye(4), "floor")], {"floor": floor}, [lamp],
                                0.25), ("Combined", "Emission", "Environment"), 16, (16, 16), film={"exposure": 2.0},
                   camera=scenes.camera_above(half=1.0))
    emission, environment, combined = (session.read(name)[..., :3] for name in ("Emission", "Environment", "Combined"))
    np.testing.assert_allclose(emission[8, 8], combined[8, 8], rtol=0.1)
    assert emission[8, 8].min() > 1.0 and emission[0].max() == 0.0
    np.testing.assert_allclose(environment[0], 0.5, rtol=1e-5)
