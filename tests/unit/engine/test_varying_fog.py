# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog that varies in space in real-time frames: closed forms, path tracing, grids of bodies, rays past their boxes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.media import MediumData, PhaseData
from burnish.engine.session import Session
from burnish.engine.settings import Integrator
from burnish.engine.volume_bake import with_wide
from burnish.engine.volume_program import FieldData, VaryingData, VolumeBuilder

from tests import scenes
from tests.unit.engine.test_fog import FLOOR, SETTINGS, cloud, drawn, fog_box, foggy, seen
from tests.unit.engine.test_volumes import WHITE, gradient

SUN = scenes.lamp("SUN", 3.0)


def ball(density, albedo=1.0, anisotropy=0.0):
    """Return a medium that is densest in the middle of its box and nothing at its sides."""
    builder = VolumeBuilder(optional=False)
    place = builder.input("OBJECT")
    squares = [builder.math("MULTIPLY", axis, axis) for axis in (builder.component(place, c) for c in range(3))]
    away = builder.math("SQRT", builder.math("ADD", builder.math("ADD", *squares[:2]), squares[2]))
    share = builder.compiled(builder.math("MAXIMUM", builder.math("SUBTRACT", 1.0, away), 0.0))
    mean = 0.13 * density
    phase = FieldData((density * albedo,) * 3, share), FieldData((anisotropy,) * 3)
    return MediumData(
        extinction=(mean,) * 3, phases=(PhaseData((mean * albedo,) * 3, anisotropy),),
        varying=VaryingData(FieldData((density,) * 3, share), FieldData(), (phase,)))


def reference(delta, samples, camera=None, size=(16, 16)):
    """Return path-traced pixels of the same."""
    settings = dataclasses.replace(
        SETTINGS, sampling=dataclasses.replace(SETTINGS.sampling, integrator=Integrator.REFERENCE))
    session = Session(settings)
    session.update(delta)
    session.configure(settings, camera or scenes.camera_above(half=0.5), *size)
    session.step(samples)
    return session.read()[..., :3]


@pytest.mark.slow
def test_absorption_is_that_of_the_integral():
    """Show the world through a box whose density grows along the way, in a mirror too, and in endless fog."""
    expected = np.exp([-0.2 / 2.0, -1.0 / 2.0, -4.0 / 2.0])
    medium = gradient((0.1, 0.5, 2.0))
    assert seen(fog_box(medium, background=1.0), 4) == pytest.approx(expected, rel=0.01)
    delta = foggy(fog_box(medium, background=1.0), cloud(0.05, albedo=0.0))
    # The world's fog hides what is behind it without an end.
    assert seen(delta, 2) == pytest.approx([0.0] * 3, abs=1e-3)
    parts = {"others": [("floor", scenes.place(z=-1.5), "mirror")], "meshes": {"floor": scenes.quad(3.0)},
             "materials": {"mirror": scenes.material("GLOSSY", color=1.0, roughness=0.0)}}
    assert seen(fog_box(medium, background=1.0, **parts), 24) == pytest.approx(expected**2, rel=0.03, abs=2e-3)


def test_what_shines_is_that_of_the_integral():
    """Add what a medium emits, dimmed by itself."""
    medium = gradient(WHITE, emission=(0.5, 0.25, 0.0))
    share = 1.0 - np.exp(-1.0)
    assert seen(fog_box(medium), 8) == pytest.approx([0.5 * share, 0.25 * share, 0.0], rel=0.01)


@pytest.mark.slow
def test_surfaces_are_lit_through_it():
    """Light a floor by a sun through a box that gets denser, and see it through that."""
    expected = seen(fog_box(MediumData(), lights=[SUN], **FLOOR), 4) * np.exp([-0.4, -2.0, -4.0])
    found = seen(fog_box(gradient((0.2, 1.0, 2.0)), lights=[SUN], **FLOOR), 24)
    assert found == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize(("density", "anisotropy"), [
    pytest.param(3.0, 0.0, id="smoke", marks=pytest.mark.slow),
    pytest.param(20.0, 0.0, id="cloud", marks=pytest.mark.slow),
    pytest.param(20.0, 0.6, id="forward", marks=pytest.mark.slow),
])
def test_frames_have_the_energy_of_path_tracing(density, anisotropy):
    """Light a ball over a floor by sun and sky: after 24 frames within 8 % of path tracing."""
    delta = fog_box(ball(density, 0.98, anisotropy), background=0.3, lights=[SUN], **FLOOR)
    session = drawn(delta, 24)
    assert session.settings.sampling.integrator == Integrator.REALTIME
    assert session.read()[..., :3].mean() == pytest.approx(reference(delta, 192).mean(), rel=0.08)


@pytest.mark.slow
def test_thick_bodies_have_grids_of_their_own():
    """Give two clouds that lie apart fine cells each, one body none, and leave to path tracing what is too thick."""
    def apart(medium, count):
        bare = dataclasses.replace(scenes.transparent(1.0), medium=medium, bare=True)
        places = [("box", scenes.place(x=12.0 * i), "fog") for i in range(count)]
        return scenes.delta({"box": scenes.box(1.0)}, places, {"fog": bare}, [SUN], 0.3)

    fog = drawn(apart(ball(20.0), 2), 1)._scene.media.fog
    assert fog.own == 2 and len(fog.grids) == 3 and not fog.traced
    assert fog.grids[0].cell < 0.08 < 0.4 < fog.grids[2].cell
    assert [grid.middle[0] for grid in fog.grids[:2]] == [0.0, 12.0]
    # Where there are more, the others have the common grid.
    fog = drawn(apart(ball(20.0), 6), 1)._scene.media.fog
    assert fog.own == 3 and fog.traced
    assert drawn(apart(ball(20.0), 1), 1)._scene.media.fog.own == 0
    assert drawn(apart(ball(0.5), 2), 1)._scene.media.fog.own == 0
    # What is dense is asked again and again within a frame.
    thick, thin = (drawn(apart(ball(density), 1), 1)._scene.media.fog.sweeps for density in (20.0, 0.5))
    assert thick > thin


@pytest.mark.slow
def test_rays_walk_through_what_varies_alone():
    """Go through fog by steps where some varies: even fog has formulas, and no list of rays to walk."""
    kernels = {}
    for name, medium in (("even", cloud(1.0)), ("varying", ball(1.0))):
        session = drawn(fog_box(medium, background=0.3, lights=[SUN], **FLOOR), 1)
        session.timed = True
        session.step(1)
        kernels[name] = set(session.pipeline.kernel_times)
    assert {"dim_cache_rays", "add_fog_light"} <= kernels["even"]
    assert kernels["varying"] - kernels["even"] == {"walk_cache_rays"}
    # What they have found is asked for its light once the fog knows this frame's.
    ways = session.pipeline.cache.rays.ways.ways
    assert (ways.varies.numpy() == 1).any() and ways.weight.numpy().max() > 0.0


@pytest.mark.slow
def test_moved_fog_keeps_the_frame_that_was_recorded():
    """Move a body by the rows of its grids: nothing that a frame has recorded is elsewhere."""
    medium = ball(3.0)
    delta = fog_box(medium, background=0.3, lights=[SUN], **FLOOR)
    session = drawn(delta, 2)
    rows, places = session._scene.media.fog.rows.ptr, session._scene.media.fog.grids
    grids = session._scene.media.volumes.grids.ptr
    bare = dataclasses.replace(scenes.transparent(1.0), medium=medium, bare=True)
    session.update(scenes.delta({"box": scenes.box(1.0), **FLOOR["meshes"]}, [
        ("box", scenes.place(x=3.0), "fog"), *FLOOR["others"]], {"fog": bare, **FLOOR["materials"]}, [SUN], 0.3))
    session.step(1)
    fog = session._scene.media.fog
    assert fog.grids != places
    assert len(fog.rows) != len(places) or fog.rows.ptr == rows
    assert session._scene.media.volumes.grids.ptr == grids


def test_rays_past_the_box_of_a_body_are_in_nothing():
    """End what an open mesh holds at the sides of its box: here one of whose six sides is missing."""
    box = scenes.box(1.0)
    kept = (box.positions[box.triangles][:, :, 2] > -0.5).any(1)
    assert 0 < kept.sum() < len(kept)
    open_box = dataclasses.replace(box, **{
        name: getattr(box, name)[kept] for name in ("triangles", "material_slots", "corner_normals")})
    bare = dataclasses.replace(scenes.transparent(1.0), medium=gradient(WHITE), bare=True)
    delta = scenes.delta({"box": open_box}, [("box", np.eye(4), "fog")], {"fog": bare}, [], 1.0)
    for picture in (drawn(delta, 4).read(), reference(delta, 64)):
        assert picture[..., :3].mean() == pytest.approx(np.exp(-1.0), rel=0.03)


def test_wide_blocks_have_the_largest_of_their_blocks():
    """Bound wide blocks of a grid whose sides are no multiples, and all of it."""
    blocks = np.random.default_rng(1).random((3 * 5 * 9, 2), np.float32)
    found = with_wide(blocks, (9, 5, 3))
    assert len(found) == len(blocks) + 3 * 2 * 1 + 1
    table = blocks.reshape(3, 5, 9, 2)
    assert (found[len(blocks)] == table[:, :4, :4].max((0, 1, 2))).all()
    assert (found[len(blocks) + 5] == table[:, 4:, 8:].max((0, 1, 2))).all()
    assert (found[-1] == blocks.max(0)).all()
