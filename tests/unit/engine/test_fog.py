# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog in real-time frames: closed forms, what is lit through it, path tracing; scenes without any pay nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.fog import NESTED_GRIDS, SMALL_GRID
from burnish.engine.media import MediumData, PhaseData
from burnish.engine.session import Session
from burnish.engine.settings import DenoiserSettings, Integrator

from tests import scenes

FOG_KERNELS = {"place_fog_samples", "dim_shadow_rays", "dim_cache_rays", "dim_fog_segments", "add_fog_light",
               "open_cells", "link_cells", "spread_fog", "blend_froxels", "smooth_froxels", "lay_fog"}
SETTINGS = dataclasses.replace(
    scenes.SETTINGS, sampling=dataclasses.replace(scenes.SETTINGS.sampling, integrator=Integrator.REALTIME),
    denoiser=DenoiserSettings(path_traced_rest=False))
FLOOR = {"others": [("floor", scenes.place(z=-1.5), "white")], "materials": {"white": scenes.material(color=0.8)},
         "meshes": {"floor": scenes.quad(3.0)}}


def cloud(density, anisotropy=0.0, albedo=1.0, emission=0.0):
    """Return a grey medium."""
    return MediumData(extinction=(density,) * 3, emission=(emission,) * 3,
                      phases=(PhaseData((density * albedo,) * 3, anisotropy),) if albedo > 0.0 else ())


def fog_box(medium, background=0.0, lights=(), others=(), materials=None, meshes=None):
    """Make a cube of side 2 that is nothing but a medium."""
    bare = dataclasses.replace(scenes.transparent(1.0), medium=medium, bare=True)
    return scenes.delta({"box": scenes.box(1.0), **(meshes or {})}, [("box", np.eye(4), "fog"), *others],
                        {"fog": bare, **(materials or {})}, lights, background)


def foggy(delta, medium):
    """Fill a scene's world with a medium."""
    return dataclasses.replace(delta, world=dataclasses.replace(delta.world, medium=medium))


def drawn(delta, count=8, camera=None, passes=("Combined",), size=(16, 16)):
    """Draw frames of what lies below the camera; return the session."""
    session = Session(SETTINGS)
    session.update(delta)
    session.configure(SETTINGS, camera or scenes.camera_above(half=0.5), *size, passes=passes)
    session.step(count)
    return session


def seen(delta, count=8, **options):
    """Return the mean color of frames, which must be frames."""
    session = drawn(delta, count, **options)
    assert session.settings.sampling.integrator == Integrator.REALTIME
    picture = session.read()[..., :3]
    assert np.isfinite(picture).all() and picture.min() >= 0.0
    return picture.mean((0, 1), dtype=np.float64)


def test_absorption_is_the_exponential_of_the_way():
    """Show the world through 2 m of fog, and through the half of it in front of a camera amid it."""
    extinction = np.array([0.1, 0.5, 2.0])
    delta = fog_box(MediumData(extinction=tuple(extinction)), background=1.0)
    assert seen(delta, 1) == pytest.approx(np.exp(-2.0 * extinction), rel=2e-3)
    amid = scenes.camera_above(height=0.0, half=0.2)
    assert seen(delta, 1, camera=amid) == pytest.approx(np.exp(-0.999 * extinction), rel=2e-3)


def test_endless_fog_hides_the_world_and_shines():
    """See nothing of a world behind an endless medium, and of its emission all that gets through."""
    plain = scenes.delta({"floor": scenes.quad(0.01, z=-50.0)}, [("floor", np.eye(4), "black")],
                         {"black": scenes.material(color=0.0)}, background=1.0)
    assert seen(foggy(plain, cloud(0.2, albedo=0.0)), 1) == pytest.approx([0.0] * 3, abs=1e-4)
    assert seen(foggy(plain, cloud(0.2, albedo=0.0, emission=0.1)), 1) == pytest.approx([0.5] * 3, rel=2e-3)


def test_emission_grows_with_the_way():
    """Add what fog in a box emits, dimmed by itself."""
    medium = MediumData(extinction=(0.0, 1.0, 3.0), emission=(0.25, 0.5, 0.5))
    expected = [0.5, 0.5 * (1.0 - np.exp(-2.0)), 0.5 * (1.0 - np.exp(-6.0)) / 3.0]
    assert seen(fog_box(medium), 1) == pytest.approx(expected, rel=2e-3)


@pytest.mark.slow
def test_scattering_once_is_the_integral():
    """Scatter a sun's light in thin fog: its depth times the phase function, which prefers straight on."""
    density, irradiance, found = 1e-3, 50.0, []
    for transform in (np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])):
        found.append(seen(fog_box(cloud(density, 0.5), lights=[scenes.lamp("SUN", irradiance, transform)]))[0])
    back, on = (2.0 * density * irradiance * 0.25 / np.pi * 0.75 / (1.25 - cosine) ** 1.5 for cosine in (-1.0, 1.0))
    assert found == pytest.approx([back, on], rel=0.02)


@pytest.mark.slow
def test_light_of_a_near_lamp_is_the_integral():
    """Scatter a lamp's light towards the camera along rays that pass it at 0.2 m; little is scattered twice."""
    extinction, scattering, apart = 0.5, 0.01, 0.2
    lamp = scenes.lamp("POINT", 100.0, scenes.place(x=apart))
    medium = MediumData(extinction=(extinction,) * 3, phases=(PhaseData((scattering,) * 3),))
    found = seen(fog_box(medium, lights=[lamp]), 12, camera=scenes.camera_above(half=0.01))
    z = np.linspace(-1.0, 1.0, 20001)
    distance = np.hypot(z, apart)
    # A lamp of 100 W has a radiant intensity of 100 / (4 pi) W/sr.
    light = 100.0 / (4.0 * np.pi) / distance**2 * np.exp(-extinction * (distance + 1.0 - z))
    assert found == pytest.approx([np.trapezoid(light, z) * scattering * 0.25 / np.pi] * 3, rel=0.04)


@pytest.mark.slow
def test_white_fog_is_not_seen_in_a_white_world():
    """Return all light where nothing is absorbed, from the first frame on, also where it is scattered ten times."""
    assert seen(fog_box(cloud(1.0), background=1.0), 2) == pytest.approx([1.0] * 3, rel=0.01)
    assert seen(fog_box(cloud(5.0), background=1.0), 8) == pytest.approx([1.0] * 3, rel=0.03)


@pytest.mark.slow
def test_white_fog_that_scatters_on_is_hardly_seen_in_a_white_world():
    """Return nearly all light after some frames: means over directions are noisy."""
    assert seen(fog_box(cloud(1.0, 0.7), background=1.0), 24) == pytest.approx([1.0] * 3, rel=0.05)


def test_surfaces_are_lit_through_fog():
    """Light a floor by a sun through a box of fog, and see it through that: 2 m each time."""
    sun = scenes.lamp("SUN", 1.0)
    extinction = np.array([0.1, 0.5, 1.0])
    expected = seen(fog_box(MediumData(), lights=[sun], **FLOOR), 4) * np.exp(-4.0 * extinction)
    assert expected.min() > 1e-3
    assert seen(fog_box(MediumData(extinction=tuple(extinction)), lights=[sun], **FLOOR), 4) == pytest.approx(
        expected, rel=0.01)


def test_mirrors_show_fog():
    """Show the world in a mirror below fog as dark as 4 m of that make it."""
    mirror = scenes.material("GLOSSY", color=1.0, roughness=0.0)
    extinction = np.array([0.1, 0.5, 1.0])
    parts = {"others": [("floor", scenes.place(z=-1.5), "mirror")], "materials": {"mirror": mirror},
             "meshes": {"floor": scenes.quad(3.0)}}
    delta = fog_box(MediumData(extinction=tuple(extinction)), background=1.0, **parts)
    assert seen(delta, 4) == pytest.approx(np.exp(-4.0 * extinction), rel=0.01)


def test_moved_fog_is_drawn_where_it_is():
    """Follow a box of fog out of the picture and back."""
    delta = fog_box(cloud(1.0, albedo=0.0), background=1.0)
    session = drawn(delta, 2)
    for x, expected in ((5.0, 1.0), (0.0, np.exp(-2.0))):
        session.update(dataclasses.replace(
            delta, full=False, meshes={}, materials={}, lights=None, world=None,
            instances=dataclasses.replace(delta.instances, transforms=scenes.place(x=x)[None])))
        session.step(8)
        assert session.read()[..., :3].mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
def test_frames_follow_a_moved_camera():
    """Draw the same fog after a flight as at rest."""
    lamp = scenes.lamp("POINT", 50.0, scenes.place(x=0.5))
    delta = fog_box(cloud(0.5), lights=[lamp], **FLOOR)
    session = drawn(delta, 1)
    for step in range(12):
        camera = scenes.camera_above(height=3.0, half=0.5 + 0.02 * (11 - step))
        session.configure(SETTINGS, camera, 16, 16)
        session.step(1)
    assert session.read()[..., :3].mean() == pytest.approx(seen(delta, 24).mean(), rel=0.05)


def test_dense_fog_and_light_passes_are_path_traced():
    """Leave to path tracing what frames would get wrong."""
    assert drawn(fog_box(cloud(80.0)), 1).settings.sampling.integrator == Integrator.REFERENCE
    # What goes straight on counts for little, and what only absorbs for nothing.
    for medium in (cloud(10.0), cloud(80.0, 0.95), cloud(80.0, albedo=0.0)):
        assert drawn(fog_box(medium), 1).settings.sampling.integrator == Integrator.REALTIME
    thin = drawn(fog_box(cloud(0.1)), 1, passes=("Combined", "Diffuse Direct"))
    assert thin.settings.sampling.integrator == Integrator.REFERENCE


def test_other_frames_launch_nothing_for_fog():
    """Draw scenes without fog by the launches that they had, also after there was some."""
    plain = scenes.delta({"box": scenes.box(1.0)}, [("box", np.eye(4), "white")], {"white": scenes.material(color=0.8)},
                         [scenes.lamp("POINT", 100.0, scenes.place(z=3.0))], 0.5)
    session = drawn(plain, 1)
    expected = session.pipeline.launches()
    assert not FOG_KERNELS & {kernel for _, kernel in expected}
    assert session.pipeline.skipped["fog"]
    session.update(foggy(plain, cloud(0.1)))
    session.step(1)
    # There is no mirror here.
    assert {kernel for _, kernel in session.pipeline.launches()} >= FOG_KERNELS - {"dim_fog_segments"}
    session.update(plain)
    session.step(1)
    assert session.pipeline.launches() == expected


def test_grids_fit_the_fog():
    """Have one fine grid for little fog in a large scene, and nested ones for what is about all of it."""
    far = {"others": [("floor", scenes.place(z=-1.5, scale=20.0), "white")],
           "materials": {"white": scenes.material(color=0.8)}, "meshes": {"floor": scenes.quad(3.0)}}
    fog = drawn(fog_box(cloud(0.1), **far), 1)._scene.media.fog
    assert (fog.side, len(fog.grids)) == SMALL_GRID and 2.0 < 32 * fog.grids[0].cell < 2.8 and fog.cells == 32**3
    fog = drawn(fog_box(cloud(0.1)), 1)._scene.media.fog
    assert (fog.side, len(fog.grids)) == NESTED_GRIDS and fog.walls and not fog.own


@pytest.mark.slow
@pytest.mark.parametrize("medium", [cloud(0.1), cloud(0.3, 0.6, 0.8)], ids=["white", "forward"])
def test_frames_have_the_energy_of_path_tracing(medium):
    """Draw a lamp and a ball over a floor in endless fog: within 5 % of path tracing in pixels that are not sparks."""
    plain = scenes.delta(
        {"floor": scenes.quad(4.0, z=-1.0), "ball": scenes.sphere(0.6, 16)},
        [("floor", np.eye(4), "white"), ("ball", scenes.place(x=0.5), "white")],
        {"white": scenes.material(color=0.6)}, [scenes.lamp("POINT", 100.0, scenes.place(x=-1.5, z=1.0), radius=0.1)])
    camera = scenes.camera_above(height=4.0, half=1.2)
    frames = drawn(foggy(plain, medium), 32, camera=camera, size=(24, 24)).read()[..., :3]
    truth = scenes.render(foggy(plain, medium), camera, (24, 24), 1024)[..., :3]
    kept = truth.max(-1) < np.percentile(truth.max(-1), 98.0)
    assert frames[kept].mean() == pytest.approx(truth[kept].mean(), rel=0.05)
