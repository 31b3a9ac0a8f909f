# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of light that goes on behind clear glass in real-time frames: how much, past what, and nowhere twice."""

from dataclasses import replace

import numpy as np
import pytest
from burnish.engine.clear_glass import clear_glass
from burnish.engine.media import MediumData
from burnish.engine.scene import SceneDelta
from burnish.engine.session import Session
from burnish.engine.settings import (
    CacheSettings,
    DenoiserSettings,
    DirectLightSettings,
    Integrator,
    SamplingSettings,
)
from burnish.engine.stress.scenes import box as slab

from tests import scenes
from tests.light_scenes import look_at

SIZE = (24, 16)
ALONE = replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=13),
    denoiser=DenoiserSettings(path_traced_rest=False))
"""Frames without path-traced samples"""
DARK = scenes.material(color=0.02)
"""Throws hardly any light back at what is above it"""
WHITE = scenes.material(color=0.7)
PANE = slab((-6.0, -6.0, 1.0), (6.0, 6.0, 1.05))
HERE = scenes.place()


def glass(color=1.0, ior=1.5, roughness=0.0, **arguments):
    """Make glass as the Glass BSDF."""
    return scenes.material("GLASS", color=color, ior=ior, roughness=roughness, **arguments)


def principled(color=1.0, **arguments):
    """Make glass as the Principled BSDF."""
    arguments = {"transmission": 1.0, "ior": 1.5, "roughness": 0.0, "specular_level": 0.5, **arguments}
    return scenes.material("PRINCIPLED", color=color, specular_tint=(1.0, 1.0, 1.0), **arguments)


def sun(tilt=0.0):
    """Make a sun of irradiance 1 on what faces it, `tilt` radians from straight above."""
    turned = scenes.place()
    turned[1, 1] = turned[2, 2] = np.cos(tilt)
    turned[1, 2], turned[2, 1] = -np.sin(tilt), np.sin(tilt)
    return scenes.lamp("SUN", 1.0, turned, angle=0.01)


def under(things, lights, materials=None, background=0.0):
    """Make a dark floor below things given as (mesh, material)."""
    meshes = {"floor": scenes.quad(20.0)} | {f"thing {i}": mesh for i, (mesh, _) in enumerate(things)}
    materials = {"floor": DARK} | {f"thing {i}": each for i, (_, each) in enumerate(things)}
    return scenes.delta(meshes, [(key, HERE, key) for key in meshes], materials, lights, background)


def seen(delta, settings=ALONE, frames=16, camera=None):
    """Return the mean of each channel in the middle of a picture of the floor from below the pane."""
    picture = scenes.render(delta, camera or scenes.camera_above(0.9), SIZE, frames, settings)
    assert np.isfinite(picture).all()
    return picture[4:-4, 4:-4, :3].mean((0, 1))


def passing(tilt, ior=1.5):
    """Return what a pane's two surfaces let through by Fresnel's equations, without what they throw back and forth."""
    bent = np.arcsin(np.sin(tilt) / ior)
    s = (np.cos(tilt) - ior * np.cos(bent)) / (np.cos(tilt) + ior * np.cos(bent))
    p = (ior * np.cos(tilt) - np.cos(bent)) / (ior * np.cos(tilt) + np.cos(bent))
    return (1.0 - 0.5 * (s * s + p * p)) ** 2


@pytest.mark.parametrize("tilt", [0.0, 1.0])
@pytest.mark.parametrize("count", [1, 3])
def test_sun_through_panes(tilt, count):
    """Light a floor by what panes let through of the sun."""
    panes = [(slab((-6.0, -6.0, 1.0 + i), (6.0, 6.0, 1.05 + i)), glass()) for i in range(count)]
    light = seen(under(panes, [sun(tilt)])) / seen(under([], [sun(tilt)]))
    assert light == pytest.approx(np.full(3, passing(tilt) ** count), rel=0.02)


def test_tints():
    """Colour the light as a slab of the Principled BSDF, and as two surfaces of the Glass BSDF."""
    color = np.array([0.2, 0.5, 0.9])
    open_sky = seen(under([], [sun()]))
    for material, factor in ((principled(tuple(color)), color), (glass(tuple(color)), color**2)):
        light = seen(under([(PANE, material)], [sun()])) / open_sky
        assert light == pytest.approx(passing(0.0) * factor, rel=0.03, abs=0.004)


@pytest.mark.parametrize(("material", "clear"), [
    (glass(), True), (principled(), True), (scenes.material("REFRACTION", color=0.9, ior=1.3), True),
    (glass(roughness=0.2), True), (glass(roughness=0.5), False), (principled(transmission=0.5), False),
    (principled(metallic=1.0), False), (principled(coat=1.0), False), (scenes.material("GLOSSY", color=1.0), False),
    (WHITE, False), (scenes.transparent(0.5, "GLASS", color=1.0), False), (scenes.emitter(1.0, 0.5), False),
    (replace(glass(), medium=MediumData()), False)])
def test_which_materials_are_clear(material, clear):
    """Tell clear glass from what spreads light, mixes with something, shines or is filled."""
    assert (clear_glass(material)[3] != 0.0) == clear


@pytest.mark.parametrize("material", [
    glass(roughness=0.2), principled(thin_wall=1.0), scenes.material("REFRACTION", color=1.0, ior=1.3)],
    ids=["rough", "thin wall", "refraction alone"])
def test_glass_that_paths_do_not_share(material):
    """Let light through glass in frames, too, where path tracing samples no lights behind it."""
    def direct(panes):
        _, session = scenes.render(
            under(panes, [sun()]), scenes.camera_above(0.9), SIZE, 8, ALONE, ("Combined", "Diffuse Direct"))
        return session.read("Diffuse Direct")[4:-4, 4:-4, :3].mean()

    assert 0.8 < direct([(PANE, material)]) / direct([]) < 1.05


@pytest.mark.parametrize("height", [0.95, 1.5], ids=["before the pane", "behind it"])
def test_other_things_cast_shadows(height):
    """Keep the shadow of something solid on either side of a pane."""
    solid = slab((-30.0, -30.0, height), (30.0, 30.0, height + 0.02))
    assert seen(under([(PANE, glass()), (solid, WHITE)], [sun()])).max() < 1.0e-4


@pytest.mark.parametrize("height", [0.95, 1.5], ids=["before the pane", "behind it"])
def test_curtains_and_panes(height):
    """Weaken light by a half transparent sheet and by the pane before or behind it."""
    sheet = slab((-6.0, -6.0, height), (6.0, 6.0, height + 0.01))
    veil = scenes.transparent(0.5, color=0.0)
    alone = seen(under([(sheet, veil)], [sun()]))
    both = seen(under([(PANE, glass()), (sheet, veil)], [sun()]))
    assert both / alone == pytest.approx(np.full(3, passing(0.0)), rel=0.02)


@pytest.mark.parametrize("on", [True, False])
def test_switched_off(on):
    """Stop direct light at glass where the setting says so, and not where it doesn't."""
    settings = replace(ALONE, direct_light=DirectLightSettings(clear_glass=on))
    _, session = scenes.render(
        under([(PANE, glass())], [sun()]), scenes.camera_above(0.9), SIZE, 8, settings, ("Combined", "Diffuse Direct"))
    assert (session.read("Diffuse Direct")[4:-4, 4:-4, :3].mean() > 0.2) == on


def room(pane):
    """Make a white room with one wall open to a bright sky, closed by a pane of a material where there is one."""
    walls = {
        "floor": slab((-1, -1, -0.1), (1, 1, 0)), "ceiling": slab((-1, -1, 2), (1, 1, 2.1)),
        "left": slab((-1.1, -1, 0), (-1, 1, 2)), "right": slab((1, -1, 0), (1.1, 1, 2)),
        "back": slab((-1, -1.1, 0), (1, -1, 2))}
    meshes, objects = dict(walls), [(key, HERE, "wall") for key in walls]
    materials = {"wall": WHITE}
    if pane is not None:
        meshes["pane"] = slab((-1, 0.95, 0), (1, 0.99, 2))
        objects.append(("pane", HERE, "pane"))
        materials["pane"] = pane
    return scenes.delta(meshes, objects, materials, [sun(1.0)], 1.0)


def pictures(delta, frames, settings=ALONE):
    """Return the means of pictures that look from the middle of a room to its back wall."""
    session = Session(settings)
    session.update(delta)
    session.configure(settings, look_at((0.0, 0.9, 1.0), (0.0, -1.0, 0.9), SIZE, 1.2), *SIZE)
    means = []
    for count in frames:
        session.step(count)
        means.append(session.read()[..., :3].mean())
    return np.array(means)


def test_room_behind_a_window():
    """Light a room through a pane that is nearly air as through a hole: at once, and at rest, where pixels gather."""
    through, opened = (pictures(room(pane), (4, 4, 24)) for pane in (glass(ior=1.0001), None))
    assert through / opened == pytest.approx(np.ones(3), rel=0.05)


def test_highlight_is_shown_once():
    """Show a lamp in a rough metal floor through a pane that is nearly air as without one."""
    metal = scenes.material("GLOSSY", color=0.9, roughness=0.25)
    lamp = scenes.lamp("AREA", 50.0, scenes.place(0.0, 0.0, 3.0), shape="SQUARE", size_x=0.7, size_y=0.7)

    def floor(panes):
        delta = under(panes, [lamp])
        return replace(delta, materials={**delta.materials, "floor": metal})

    camera = scenes.camera_above(0.9, 0.8, orthographic=False)
    through, opened = (seen(floor(panes), camera=camera, frames=32)
                       for panes in ([(PANE, glass(ior=1.0001))], []))
    assert through == pytest.approx(opened, rel=0.03)


def test_glass_that_moves():
    """Let light through a pane that has moved, which has left the flattened triangles, as through one that stood."""
    delta = under([(PANE, glass())], [sun()])
    moved = scenes.instances([("floor", HERE, "floor"), ("thing 0", scenes.place(z=0.3), "thing 0")])
    session = Session(ALONE)
    session.update(delta)
    session.configure(ALONE, scenes.camera_above(0.9), *SIZE)
    session.step(4)
    session.update(SceneDelta(instances=moved))
    session.step(16)
    light = session.read()[4:-4, 4:-4, :3].mean((0, 1)) / seen(under([], [sun()]))
    assert light == pytest.approx(np.full(3, passing(0.0)), rel=0.02)
