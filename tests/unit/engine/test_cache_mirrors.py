# SPDX-License-Identifier: GPL-3.0-or-later
"""Test light that comes over mirrors: rays of probes, cells and final gather go on there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from burnish.engine.scene import LightKind
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, DenoiserSettings, Integrator, SamplingSettings

from tests import glossy_scenes, scenes
from tests.glossy_scenes import glossy, metal
from tests.light_scenes import look_at, slab

SIZE = (64, 40)
KERNELS = {"append_mirrored", "evaluate_mirrored_lean", "meet_mirrored_lamps"}


def open_session(delta, camera, integrator=Integrator.REALTIME, *, follow=True, gather=True, size=SIZE):
    """Open a session of frames alone, or of Reference."""
    settings = dataclasses.replace(
        scenes.SETTINGS, sampling=SamplingSettings(integrator=integrator),
        cache=CacheSettings(capacity=16, follow_mirrors=follow),
        denoiser=DenoiserSettings(path_traced_rest=False, rest_gather=gather))
    session = Session(settings)
    session.update(delta)
    session.configure(settings, camera, *size)
    return session


def picture(session, count):
    """Return the picture after so many frames or samples, and close the session."""
    session.step(count)
    pixels = session.read()[..., :3].astype(np.float64)
    session.close()
    return pixels


def lit_floor(lamp, material):
    """Make a matte floor before an upright plate, at which a lamp shines, and look at the floor before the plate."""
    plate = slab((-1.5, 1.0, 0.0), (1.5, 1.05, 2.0))
    delta = scenes.delta(
        {"floor": scenes.quad(6.0), "plate": plate}, [("floor", np.eye(4), "floor"), ("plate", np.eye(4), "plate")],
        {"floor": scenes.material(color=0.5), "plate": material}, [lamp], background=0.02)
    return delta, look_at((0.0, -3.5, 2.5), (0.0, 0.2, 0.0), SIZE, 0.6)


def panel_before(size, power):
    """Return a square lamp before the plate, 2 m high, that shines at it alone: the floor sees its back."""
    across = np.eye(4)
    # Down its own z axis, turned to the plate: along y.
    across[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    across[:3, 3] = (0.0, -0.6, 1.2)
    return scenes.lamp(LightKind.AREA, power, across, shape="SQUARE", size_x=size, size_y=size)


@pytest.fixture(scope="module")
def mirror_room():
    """Return a room with a mirror, its picture, and the one without light over the mirror."""
    room = glossy_scenes.moving_mirror(SIZE)
    return (room, picture(open_session(room.delta, room.camera, Integrator.REFERENCE), 256),
            picture(open_session(room.delta, room.camera, follow=False, gather=False), 48))


@pytest.mark.parametrize("gather", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_mirror_lights_the_floor_before_it(gather, mirror_room):
    """Bring what a mirror shows to the floor before it, the ceiling's lamp too, by probes and by final gather."""
    room, truth, without = mirror_room
    found = {False: without, True: picture(open_session(room.delta, room.camera, gather=gather), 48)}
    floor = np.zeros(SIZE[::-1], bool)
    floor[4:12, 4:40] = True
    lit, off = (found[follow][floor].mean() / truth[floor].mean() for follow in (True, False))
    assert 0.9 < lit < 1.05 and off < 0.84, (lit, off)

    def error(pixels):
        return float(np.sqrt(((pixels - truth) ** 2).mean()))

    assert error(found[True]) < 0.8 * error(found[False])


@pytest.mark.slow
def test_half_a_mirror_keeps_its_light():
    """Neither lose nor win light where a plate reflects half sharply and half evenly, and rays choose by chance."""
    half = glossy(color=(0.45, 0.45, 0.45), metallic=0.5, roughness=0.05)
    box = glossy_scenes.stage(
        SIZE, {"plate": slab((-2.0, 1.6, 0.1), (2.0, 1.65, 2.3))}, [("plate", np.eye(4), "half")], {"half": half})
    truth = picture(open_session(box.delta, box.camera, Integrator.REFERENCE), 384)
    found = picture(open_session(box.delta, box.camera), 32)
    assert found.mean() == pytest.approx(truth.mean(), rel=0.025)


def test_small_lamps_over_mirrors_make_no_sparks():
    """Limit what a ray brings of a lamp of a centimetre: one in thousands meets it."""
    delta, camera = lit_floor(panel_before(0.01, 60.0), metal(0.0, color=(0.9, 0.9, 0.9)))
    off, lit = (picture(open_session(delta, camera, follow=follow), 8)[4:18, 16:48] for follow in (False, True))
    assert lit.max() < 2.0 * off.max() and np.isfinite(lit).all()


def test_scenes_without_mirrors_have_no_such_rays():
    """Launch nothing where no surface is smooth enough, or it is switched off, and count rays where one is."""
    for roughness, follow, expected in ((0.1, True, True), (0.1, False, False), (0.3, True, False)):
        delta, camera = lit_floor(panel_before(0.8, 60.0), metal(roughness))
        session = open_session(delta, camera, follow=follow)
        session.step(2)
        launched = {kernel for graph in session.pipeline._graphs.values() for _, kernel in graph[0].launch_list()}
        assert bool(launched & KERNELS) == expected
        assert (session.counts()["cache rays over mirrors"] > 100) == expected
        assert (len(session.pipeline.cache.rays.mirrors.struct.state) > 0) == expected
        session.close()
