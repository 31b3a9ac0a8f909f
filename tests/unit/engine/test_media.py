# SPDX-License-Identifier: GPL-3.0-or-later
"""Participating media in the path tracer: what passes, energy, nesting, passes; scenes without any pay nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine import media as engine_media
from burnish.engine.media import MediumData, PhaseData
from burnish.engine.passes import wavefront
from burnish.engine.passes.composite import LIGHT_PASSES
from burnish.engine.passes.media_light import VOLUME_PASSES
from burnish.engine.session import Session
from burnish.engine.settings import Integrator, LightPathSettings

from tests import scenes

PASSES = ("Combined", "Emission", "Environment", *LIGHT_PASSES)
MEDIA_KERNELS = {"start_media", "march_media", "shade_media_misses", "scatter_paths", "weaken_in_media"}


def absorber(*extinction):
    """Return a medium that scatters nothing."""
    return MediumData(extinction=extinction)


def cloud(density, anisotropy=0.0, albedo=(1.0, 1.0, 1.0)):
    """Return a medium of an albedo."""
    return MediumData(extinction=(density,) * 3,
                      phases=(PhaseData(tuple(density * a for a in albedo), anisotropy),))


def filled(medium, surface=None):
    """Make a material with a medium: without a surface, if none is given."""
    return dataclasses.replace(surface or scenes.transparent(1.0), medium=medium)


def boxes(*media, background=1.0, lights=(), distance=0.0, others=(), materials=None, meshes=None):
    """Make cubes of side 2 in the same place, or a distance apart in x, each with a medium, and other objects."""
    meshes = {"box": scenes.box(1.0), **(meshes or {})}
    materials = {i: medium if hasattr(medium, "program") else filled(medium) for i, medium in enumerate(media)} | (
        materials or {})
    objects = [("box", scenes.place(x=distance * i, scale=1.0 - 0.125 * i), i) for i in range(len(media))]
    return scenes.delta(meshes, [*objects, *others], materials, lights, background)


def shot(delta, samples=4, half=0.5, passes=("Combined",), camera=None, settings=scenes.SETTINGS, size=(8, 8)):
    """Render what lies below the camera; return the session."""
    session = Session(settings)
    session.update(delta)
    session.configure(settings, camera or scenes.camera_above(half=half), *size, passes=passes)
    session.step(samples)
    return session


def seen(delta, samples=4, **options):
    """Return the mean color."""
    picture = shot(delta, samples, **options).read()[..., :3]
    assert np.isfinite(picture).all() and picture.min() >= 0.0
    return picture.mean((0, 1), dtype=np.float64)


def test_absorption_is_the_exponential_of_the_way():
    """Show the world through 2 m of a medium; a second one within adds up, also in another place of the stack."""
    assert seen(boxes(absorber(0.1, 0.5, 2.0))) == pytest.approx(np.exp([-0.2, -1.0, -4.0]), rel=1e-4)
    both = boxes(absorber(0.1, 0.5, 2.0), absorber(0.4, 0.0, 0.2))
    assert seen(both) == pytest.approx(np.exp([-0.2 - 0.7, -1.0, -4.0 - 0.35]), rel=1e-4)


def test_cameras_begin_in_the_media_about_them():
    """Find both of two nested media from within, and neither of those left behind or ahead."""
    media = absorber(0.1, 0.5, 2.0), absorber(0.4, 0.0, 0.2)
    camera = scenes.camera_above(height=0.0, half=0.2)
    assert seen(boxes(*media), camera=camera) == pytest.approx(np.exp([-0.1 - 0.35, -0.5, -2.0 - 0.175]), rel=5e-3)
    apart = boxes(*media, distance=3.0)
    assert seen(apart, camera=camera) == pytest.approx(np.exp([-0.1, -0.5, -2.0]), rel=5e-3)


def test_emission_grows_with_the_way():
    """Add what a medium emits, dimmed by itself, also where nothing dims it."""
    medium = MediumData(extinction=(0.0, 1.0, 3.0), emission=(0.25, 0.5, 0.5))
    expected = [0.5, 0.5 * (1.0 - np.exp(-2.0)), 0.5 * (1.0 - np.exp(-6.0)) / 3.0]
    assert seen(boxes(medium, background=0.0)) == pytest.approx(expected, rel=1e-4)


def test_glass_has_the_colour_of_what_is_in_it():
    """Absorb within a refracting body, which rays enter and leave by their side of its surface."""
    clear = scenes.material("GLASS", color=1.0, ior=1.0001)
    assert seen(boxes(filled(absorber(0.1, 0.5, 2.0), clear)), 16) == pytest.approx(
        np.exp([-0.2, -1.0, -4.0]), rel=0.01)


def test_bodies_without_a_surface_stay_beside_coloured_glass():
    """Keep the medium of a body without a surface where glass has one too, which frames draw apart from it."""
    glass = filled(absorber(0.4, 0.0, 0.2), scenes.material("GLASS", color=1.0, ior=1.0001))
    bare = dataclasses.replace(filled(absorber(0.1, 0.5, 2.0)), bare=True)
    expected = pytest.approx(np.exp([-0.2, -1.0, -4.0]), rel=1e-4)
    assert seen(boxes(bare, glass, distance=3.0)) == expected
    assert seen(boxes(bare)) == expected


@pytest.mark.parametrize("height", [-1.5, -1.0], ids=["above", "on"])
def test_shadow_rays_are_dimmed(height):
    """Light a floor through a box above or on it: 2 m of its medium are in the way, and in that of the camera."""
    floor = ("floor", scenes.place(z=height), "white")
    sun = scenes.lamp("SUN", 1.0)
    more = {"others": [floor], "materials": {"white": scenes.material(color=0.8)},
            "meshes": {"floor": scenes.quad(3.0)}, "lights": [sun], "background": 0.0}
    # Light that the floor returns leaves the scene: no other comes back.
    expected = seen(boxes(absorber(0.0, 0.0, 0.0), **more)) * np.exp([-0.4, -2.0, -4.0])
    assert expected.min() > 1e-3
    assert seen(boxes(absorber(0.1, 0.5, 1.0), **more)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("anisotropy", [-0.9, 0.0, 0.8, 1.0])
def test_what_scatters_all_is_not_seen_in_an_even_world(anisotropy):
    """Return all light where nothing is absorbed: white clouds in a white room are white."""
    assert seen(boxes(cloud(3.0, anisotropy)), 128) == pytest.approx([1.0] * 3, rel=0.01)


@pytest.mark.slow
def test_scattering_once_is_the_integral():
    """Scatter a sun's light in a thin medium: its depth times the phase function, which prefers straight on."""
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    density, irradiance, found = 1e-3, 50.0, []
    for transform in (np.eye(4), turned):
        sun = scenes.lamp("SUN", irradiance, transform)
        found.append(seen(boxes(cloud(density, 0.5), lights=[sun], background=0.0), 4096, size=(4, 4))[0])
    # From behind the camera light turns back, from below it goes on into it.
    back, on = (2.0 * density * irradiance * 0.25 / np.pi * 0.75 / (1.25 - cosine) ** 1.5 for cosine in (-1.0, 1.0))
    assert found == pytest.approx([back, on], rel=0.05)


def test_light_of_a_near_lamp_is_the_integral():
    """Scatter a lamp's light towards the camera along a ray that passes it at 0.2 m; little is scattered twice."""
    extinction, scattering, apart = 0.5, 0.01, 0.2
    lamp = scenes.lamp("POINT", 100.0, scenes.place(x=apart))
    medium = MediumData(extinction=(extinction,) * 3, phases=(PhaseData((scattering,) * 3),))
    delta = boxes(medium, lights=[lamp], background=0.0)
    found = seen(delta, 1024, half=1e-3, size=(4, 4))
    depth = (np.arange(4000) + 0.5) / 2000.0
    away = np.hypot(depth - 1.0, apart)
    intensity = 100.0 / (4.0 * np.pi)
    expected = scattering * intensity / (4.0 * np.pi) * np.mean(np.exp(-extinction * (depth + away)) / away**2) * 2.0
    assert found == pytest.approx([expected] * 3, rel=0.02)


def test_the_worlds_medium_hides_the_world_and_suns():
    """Keep an endless medium black where nothing shines in it, and dim what is near by its distance."""
    def foggy(medium, **more):
        delta = boxes(**more)
        return dataclasses.replace(delta, world=dataclasses.replace(delta.world, medium=medium))

    sun = scenes.lamp("SUN", 10.0)
    assert seen(foggy(absorber(1e-3, 0.1, 0.0), lights=[sun])) == pytest.approx([0.0, 0.0, 1.0])
    shining = {"others": [("floor", np.eye(4), "light")], "meshes": {"floor": scenes.quad(3.0)},
               "materials": {"light": scenes.emitter(1.0)}}
    # The camera is 3 m away.
    assert seen(foggy(absorber(0.1, 0.5, 0.0), **shining)) == pytest.approx(np.exp([-0.3, -1.5, 0.0]), rel=1e-3)


@pytest.mark.slow
def test_few_paths_come_back_from_far_away(monkeypatch):
    """End most paths that fog has scattered far from all lights, for a fraction of the rounds and the same mean."""
    lamp = scenes.lamp("POINT", 20.0, scenes.place(x=0.3, z=1.0), radius=0.2)
    delta = scenes.delta({"floor": scenes.quad(1.0)}, [("floor", scenes.place(z=-0.5), "floor")],
                         {"floor": scenes.material(color=(0.6, 0.4, 0.3))}, [lamp], 0.0)
    foggy = dataclasses.replace(delta, world=dataclasses.replace(delta.world, medium=cloud(0.1)))

    def traced():
        lengths = []
        real = wavefront.Wavefront.loop

        def loop(self, *args):
            done = real(self, *args)
            lengths.append(int(self.rounds.numpy()[0]))
            return done

        with monkeypatch.context() as patch:
            patch.setattr(wavefront.Wavefront, "loop", loop)
            session = shot(foggy, 256)
        return session, session.read()[..., :3].mean(dtype=np.float64), max(lengths)

    session, mean, rounds = traced()
    assert session._scene.media.struct.reach == pytest.approx(session._scene.radius / 4.0)
    monkeypatch.setattr(engine_media, "light_reach", lambda source, media: ((0.0, 0.0, 0.0), 0.0))
    _, expected, most = traced()
    assert mean == pytest.approx(expected, rel=0.04)
    assert rounds < 0.6 * most, (rounds, most)


def test_alpha_is_what_media_hide():
    """Leave a transparent film as much of the world as passes."""
    film = dataclasses.replace(scenes.SETTINGS.film, transparent=True)
    settings = dataclasses.replace(scenes.SETTINGS, film=film)
    picture = shot(boxes(absorber(0.5, 0.5, 0.5)), settings=settings).read()
    assert picture[..., 3] == pytest.approx(1.0 - np.exp(-1.0), rel=1e-3)


@pytest.mark.parametrize("medium", [
    MediumData(), absorber(1e-30, 0.0, 1e30), cloud(1e-30), cloud(1e30, 0.5), cloud(5.0, 1.0), cloud(5.0, -1.0),
    cloud(2.0, 0.3, (3.0, 1.0, 0.0)), cloud(2.0, 0.0, (0.0, 1.0, 1.0)), cloud(np.inf), cloud(np.nan),
    MediumData(emission=(1e30, 0.0, 0.0)), MediumData(extinction=(1e30, 1e-30, 0.0), emission=(1.0, 1.0, 1.0)),
], ids=str)
def test_no_input_makes_a_bad_pixel(medium):
    """Stay finite in boxes, glass, open meshes and worlds."""
    lamp = scenes.lamp("POINT", 50.0, scenes.place(x=0.3, z=0.2), radius=0.2)
    glass = filled(medium, scenes.material("GLASS", color=1.0, ior=1.5))
    open_mesh = scenes.delta({"quad": scenes.quad(0.4)}, [("quad", np.eye(4), "open")], {"open": filled(medium)},
                             [lamp], 0.5)
    plain = boxes(lights=[lamp], background=0.5)
    foggy = dataclasses.replace(plain, world=dataclasses.replace(plain.world, medium=medium))
    for delta in (boxes(medium, lights=[lamp]), boxes(glass, lights=[lamp]), open_mesh, foggy):
        seen(delta, 2)


def lit_scene(medium, surface=None):
    """Return a body of a medium on a floor, lamps of two groups and a sky."""
    lamps = [scenes.lamp("AREA", 30.0, scenes.place(x=0.5, z=2.5), shape="SQUARE", size_x=0.5, light_group="key"),
             scenes.lamp("POINT", 10.0, scenes.place(x=-1.5, z=1.5), radius=0.1, light_group="fill")]
    return scenes.delta(
        {"box": scenes.box(0.5), "floor": scenes.quad(2.0)},
        [("box", scenes.place(z=0.6), "body"), ("floor", scenes.place(), "floor")],
        {"body": filled(medium, surface), "floor": scenes.material(color=(0.6, 0.4, 0.3))}, lamps, 0.3)


def test_light_passes_leave_media_to_the_picture():
    """Keep light that a medium scatters first out of surfaces' passes; without scattering passes make the picture."""
    thin = lit_scene(dataclasses.replace(absorber(0.5, 1.0, 2.0), emission=(0.1, 0.2, 0.3)))
    session = shot(thin, 4, 0.8, PASSES)

    def sum_of(session):
        lobes = [session.read(f"{lobe} {part}") * session.read(f"{lobe} Color")
                 for lobe in ("Diffuse", "Glossy", "Transmission") for part in ("Direct", "Indirect")]
        return session.read("Emission") + session.read("Environment") + sum(lobes)

    combined = session.read()
    np.testing.assert_allclose(sum_of(session), combined[..., :3], rtol=2e-5, atol=2e-5)
    np.testing.assert_array_equal(combined, shot(thin, 4, 0.8).read())
    # Nothing behind a thick cloud is seen: all light is the medium's.
    session = shot(lit_scene(cloud(1e4)), 4, 0.3, (*PASSES, *VOLUME_PASSES))
    direct, indirect = (session.read(name) for name in VOLUME_PASSES)
    assert direct.min() >= 0.0 and indirect.mean() > 0.05
    assert sum_of(session).max() < 1e-5
    np.testing.assert_allclose(direct + indirect, session.read()[..., :3], rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("passes", [VOLUME_PASSES, (*PASSES, *VOLUME_PASSES)], ids=["alone", "all"])
def test_volume_passes_complete_the_picture(passes):
    """Find in them what surfaces' passes lack: direct light is that after one scattering; none without a medium."""
    medium = cloud(0.7, 0.3, (0.9, 0.6, 0.3))
    session = shot(lit_scene(medium), 16, 0.8, ("Combined", *passes))
    volume = sum(session.read(name) for name in VOLUME_PASSES)
    np.testing.assert_array_equal(session.read(), shot(lit_scene(medium), 16, 0.8).read())
    if len(passes) > 2:
        total = volume + session.read("Emission") + session.read("Environment")
        for lobe in ("Diffuse", "Glossy", "Transmission"):
            light = session.read(f"{lobe} Direct") + session.read(f"{lobe} Indirect")
            total = total + light * session.read(f"{lobe} Color")
        np.testing.assert_allclose(total, session.read()[..., :3], rtol=2e-4, atol=2e-5)
    limited = dataclasses.replace(scenes.SETTINGS, light_paths=LightPathSettings(max_bounces=1))
    once = shot(lit_scene(medium), 256, 0.8, ("Combined", *VOLUME_PASSES), settings=limited)
    many = shot(lit_scene(medium), 256, 0.8, ("Combined", *VOLUME_PASSES))
    assert once.read("Volume Direct").mean() == pytest.approx(many.read("Volume Direct").mean(), rel=0.01)
    assert once.read("Volume Indirect").max() == 0.0 < many.read("Volume Indirect").mean()
    without = shot(lit_scene(MediumData()), 2, 0.8, ("Combined", *VOLUME_PASSES))
    assert all(without.read(name).max() == 0.0 for name in VOLUME_PASSES)


@pytest.mark.parametrize("medium", [cloud(2.0, 0.3), absorber(0.5, 1.0, 2.0)], ids=["scattering", "absorbing"])
def test_light_groups_make_up_the_picture(medium):
    """Give light that has gone through media to the group of the lamp that it comes from."""
    names = ("Combined_key", "Combined_fill")
    delta = dataclasses.replace(lit_scene(medium), world=scenes.world(0.0))
    session = shot(delta, 4, 0.8, ("Combined", *names))
    np.testing.assert_allclose(
        sum(session.read(name) for name in names), session.read()[..., :3], rtol=2e-5, atol=2e-5)
    only = dataclasses.replace(delta, lights=delta.lights[:1])
    key, alone = shot(delta, 64, 0.8, ("Combined", *names)).read(names[0]).mean(), seen(only, 64, half=0.8).mean()
    assert key == pytest.approx(alone, rel=0.05)


def test_other_scenes_pay_nothing(monkeypatch):
    """Record no kernel and keep nothing of paths without a medium on anything drawn."""
    def launches(delta):
        recorded = []
        real = wavefront.record

        def record(kernel, *args, **named):
            recorded.append(kernel.key)
            return real(kernel, *args, **named)

        with monkeypatch.context() as patch:
            patch.setattr(wavefront, "record", record)
            return recorded, shot(delta, 1)

    recorded, session = launches(boxes(cloud(1.0)))
    assert MEDIA_KERNELS - {"start_media"} <= set(recorded)
    assert not {"shade_misses", "weaken_shadow_rays"} & set(recorded)
    plain = boxes(scenes.transparent(1.0))
    unused = dataclasses.replace(plain, materials=plain.materials | {"other": filled(cloud(1.0))})
    empty = boxes(filled(MediumData()))
    for delta in (plain, unused, empty):
        recorded, session = launches(delta)
        assert recorded and not MEDIA_KERNELS & set(recorded)
        assert session._scene.media is None and all(slot.media is None for slot in session._pass.slots)


def frames_of(delta, count=8, half=0.7):
    """Draw real-time frames of what lies below the camera; return the session."""
    sampling = dataclasses.replace(scenes.SETTINGS.sampling, integrator=Integrator.REALTIME)
    settings = dataclasses.replace(scenes.SETTINGS, sampling=sampling)
    return shot(delta, count, half, camera=scenes.camera_above(half=half), settings=settings, size=(32, 32))


def drink(medium):
    """Return a ball of glass with a medium in it, and one of another within, in an even world."""
    glass = scenes.material("GLASS", color=1.0, ior=1.3)
    return scenes.delta(
        {"ball": scenes.sphere(1.0, 24)},
        [("ball", np.eye(4), "outer"), ("ball", scenes.place(z=0.1, scale=0.4), "inner")],
        {"outer": filled(medium, glass), "inner": filled(absorber(0.0, 1.0, 0.0), glass)}, background=1.0)


def test_frames_have_the_colour_of_what_is_in_glass():
    """Show a drink, and what is in it, in the first frames as path tracing does; no medium there would be white."""
    medium = dataclasses.replace(absorber(0.2, 0.5, 2.0), emission=(0.3, 0.0, 0.0))
    frames = frames_of(drink(medium)).read()[..., :3].mean((0, 1), dtype=np.float64)
    truth = seen(drink(medium), 64, half=0.7, size=(32, 32))
    assert truth[1] < 0.75 and truth[2] < 0.25
    assert frames == pytest.approx(truth, rel=0.04, abs=0.01)


@pytest.mark.parametrize("medium", [
    absorber(1e-30, 0.0, 1e30), cloud(np.inf), cloud(np.nan), cloud(2.0, 0.0, (3.0, 1.0, 0.0)),
    MediumData(emission=(1e30, 0.0, 0.0)),
], ids=str)
def test_no_input_makes_a_bad_pixel_in_frames(medium):
    """Stay finite in glass."""
    picture = frames_of(drink(medium), 2).read()
    assert np.isfinite(picture).all() and picture.min() >= 0.0


def test_boundaries_are_clear_in_frames():
    """Draw nothing of a mesh with a transparent surface about a volume."""
    delta = boxes(cloud(3.0), background=0.7)
    picture = frames_of(delta, 4).read()[..., :3]
    np.testing.assert_allclose(picture, 0.7, rtol=1e-3)


def test_other_frames_launch_nothing_for_media():
    """Leave rays of scenes without media to the kernels that they had."""
    kernels = {"start_in_media", "dim_segments", "cross_boundaries"}
    glass = scenes.material("GLASS", color=1.0, ior=1.3)
    ball = scenes.delta({"ball": scenes.sphere(1.0, 24)}, [("ball", np.eye(4), "glass")], {"glass": glass},
                        background=1.0)
    plain, filled_ball = frames_of(ball, 1), frames_of(drink(absorber(1.0, 1.0, 1.0)), 1)
    assert kernels <= {kernel for _, kernel in filled_ball.pipeline.launches()}
    expected = plain.pipeline.launches()
    assert not kernels & {kernel for _, kernel in expected}


def test_media_follow_moved_objects():
    """Find the camera in a body that has been moved about it, and not where the body was."""
    delta = boxes(absorber(0.5, 0.5, 0.5), distance=0.0)
    away, home = (dataclasses.replace(
        delta, full=False, meshes={}, materials={}, lights=None, world=None,
        instances=dataclasses.replace(delta.instances, transforms=scenes.place(x=x)[None])) for x in (5.0, 0.0))
    session = shot(delta, 1, camera=scenes.camera_above(height=0.0, half=0.2))
    for moved, expected in ((away, 1.0), (home, np.exp(-0.5)), (away, 1.0), (home, np.exp(-0.5))):
        session.update(moved)
        session.step(2)
        assert session.read()[..., :3].mean() == pytest.approx(expected, rel=5e-3)
