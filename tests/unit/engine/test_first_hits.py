# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of the first surfaces against what is known exactly: mist, Cryptomatte, shader AOVs, occlusion."""

import json
from dataclasses import replace

import numpy as np
import pytest
from burnish.engine import cryptomatte
from burnish.engine.pass_names import COLOR_AOV, OCCLUSION, SHADOW, VALUE_AOV
from burnish.engine.program import ProgramBuilder
from burnish.engine.scene import FrameMotion, MistData, Visibility
from burnish.engine.session import Session
from burnish.engine.settings import CacheSettings, Integrator, SamplingSettings

from tests import scenes

MATTES = ("CryptoObject00", "CryptoObject01")
REALTIME = replace(
    scenes.SETTINGS, sampling=SamplingSettings(integrator=Integrator.REALTIME), cache=CacheSettings(capacity=12))
INTEGRATORS = pytest.mark.parametrize("settings", [scenes.SETTINGS, REALTIME], ids=["reference", "realtime"])


def render(delta, passes, *, camera=None, size=(8, 8), settings=scenes.SETTINGS, samples=4):
    """Render and return the passes by name, and the session."""
    session = Session(settings)
    session.update(delta)
    session.configure(settings, camera or scenes.camera_above(), *size, passes=("Combined", *passes))
    session.step(samples)
    return {name: session.read(name) for name in passes}, session


def misty(mist, *, objects=None, materials=None):
    """Make a scene with mist; a floor without `objects`."""
    objects = objects or [("floor", scenes.place(), "floor")]
    delta = scenes.delta({"floor": scenes.quad(3.0), "veil": scenes.quad(3.0)}, objects,
                         {"floor": scenes.material(color=0.5), **(materials or {})}, background=0.5)
    delta.world = replace(delta.world, mist=mist)
    return delta


@pytest.mark.parametrize("name", ["", "a", "ab", "abc", "abcd", "hello, world", "Bäll", "Box"])
def test_hashes(name):
    """Hash names as MurmurHash3 does: published values, and what Cycles writes."""
    known = {"": 0, "a": 0x3C2569B2, "ab": 0x9BBFD75F, "abc": 0xB3DD93FA, "abcd": 0x43ED676A,
             "hello, world": 0x149BBB7F, "Bäll": 0xECF610FC, "Box": 0x803B1009}
    assert cryptomatte.murmur_hash(name) == known[name]


def test_ids_are_normal_numbers():
    """Keep exponents away from 0 and 255, and all other bits of the hash."""
    names = [f"object {number}" for number in range(4000)] + ["Box"]
    hashes = np.array([cryptomatte.murmur_hash(name) for name in names], np.uint32)
    ids = cryptomatte.matte_ids(names)
    exponents = (ids.view(np.uint32) >> 23) & 0xFF
    raw = (hashes >> 23) & 0xFF
    assert exponents.min() >= 1 and exponents.max() <= 254 and np.isfinite(ids).all()
    odd = (raw == 0) | (raw == 255)
    assert odd.sum() > 10 and np.array_equal(ids.view(np.uint32)[~odd], hashes[~odd])
    assert ids.view(np.uint32)[-1] == 0x80BB1009


@INTEGRATORS
def test_mist_by_distance(settings):
    """Find ((d - start) / depth) ** falloff, by the distance to an orthographic camera's plane, with both."""
    for falloff in (0.5, 1.0, 2.0):
        mist = MistData(start=1.0, depth=5.0, falloff=falloff)
        found, _ = render(misty(mist), ("Mist",), settings=settings)
        np.testing.assert_allclose(found["Mist"], (2.0 / 5.0) ** falloff, rtol=1e-4)


def test_mist_of_a_perspective_camera():
    """Measure the distance to the camera's place, not along its axis, and find only mist without a surface."""
    camera = scenes.camera_above(half=6.0, orthographic=False)
    found, _ = render(misty(MistData(depth=10.0)), ("Mist",), camera=camera, size=(64, 64), samples=64)
    x = (np.arange(64) + 0.5) / 64 * 12.0 - 6.0
    inside = np.abs(x) < 2.8
    expected = np.sqrt(9.0 + x[inside, None] ** 2 + x[None, inside] ** 2) / 10.0
    np.testing.assert_allclose(found["Mist"][np.ix_(inside, inside)][..., 0], expected, rtol=2e-3)
    assert (found["Mist"][0] == 1.0).all()


def test_layers_count_by_what_they_let_through():
    """Weigh a half transparent veil and the floor behind it, in mist, coverage and values."""
    veil = scenes.transparent(0.25, color=0.5)
    delta = misty(MistData(depth=4.0), objects=[
        ("floor", scenes.place(), "floor"), ("veil", scenes.place(z=1.0), "veil")], materials={"veil": veil})
    names = delta.instances.object_names
    found, session = render(delta, ("Mist", *MATTES))
    np.testing.assert_allclose(found["Mist"], 1.0 - 0.75 * (1.0 - 0.5) - 0.25 * (1.0 - 0.75), rtol=1e-5)
    ids = cryptomatte.matte_ids([names[1], names[0]])
    first = found["CryptoObject00"]
    assert (first[..., 0] == ids[0]).all() and (first[..., 2] == ids[1]).all()
    np.testing.assert_allclose(first[..., 1], 0.75, rtol=1e-5)
    np.testing.assert_allclose(first[..., 3], 0.25, rtol=1e-5)
    assert (found["CryptoObject01"] == 0.0).all()
    hashes = json.loads(session.first_hits.manifests["CryptoObject"])
    assert hashes == {name: f"{cryptomatte.murmur_hash(name):08x}" for name in names}


def test_coverage_of_an_edge():
    """Share a pixel between things by the pixel filter, the largest first, whatever was met first."""
    delta = scenes.delta({"floor": scenes.quad(3.0), "half": scenes.quad(0.5)},
                         [("floor", scenes.place(), "a"), ("half", scenes.place(x=0.75, z=0.1), "b")],
                         {"a": scenes.material(color=0.5), "b": scenes.material(color=0.5)})
    found, _ = render(delta, MATTES, camera=scenes.camera_above(half=0.5), size=(2, 2), samples=64)
    first = found["CryptoObject00"]
    ids = cryptomatte.matte_ids(delta.instances.object_names)
    # The left half of the picture is all floor; of the right half's width a half.
    assert (first[:, 0, 0] == ids[0]).all() and (first[:, 0, 1] == 1.0).all() and (first[:, 0, 3] == 0.0).all()
    assert np.abs(first[:, 1, 1::2] - 0.5).max() < 0.02
    assert (first[..., 1] >= first[..., 3]).all()
    np.testing.assert_allclose(first[..., 1] + first[..., 3], 1.0, rtol=1e-5)


def test_what_the_camera_does_not_see():
    """Give no coverage to holdouts and to what camera rays pass."""
    for visibility, seen in ((Visibility.ALL | Visibility.HOLDOUT, 0.0), (Visibility.ALL & ~Visibility.CAMERA, 1.0)):
        delta = misty(MistData(), objects=[
            ("floor", scenes.place(), "floor"), ("veil", scenes.place(z=1.0), "floor", int(visibility))])
        found, _ = render(delta, MATTES)
        assert (found["CryptoObject00"][..., 1] == seen).all()
        expected = cryptomatte.matte_ids(delta.instances.object_names[:1])[0] if seen else 0.0
        assert (found["CryptoObject00"][..., 0] == expected).all()


def test_more_things_than_slots():
    """Add what finds no slot to the last one."""
    tiles = [("tile", scenes.place(x=0.25 * column - 0.375, y=0.25 * row - 0.375), "a")
             for row in range(4) for column in range(4)]
    delta = scenes.delta({"tile": scenes.quad(0.125)}, tiles, {"a": scenes.material(color=0.5)})
    found, _ = render(delta, ("CryptoObject00", "CryptoMaterial00"), size=(1, 1), samples=64)
    coverage = found["CryptoObject00"][0, 0, 1::2]
    assert coverage.sum() == pytest.approx(1.0, abs=1e-4) and coverage.min() < 0.1
    assert found["CryptoMaterial00"][0, 0, 1] == pytest.approx(1.0, abs=1e-4)


def value_program(value):
    """Make the program of an AOV Output node."""
    builder = ProgramBuilder()
    builder.emit(builder.constant(value) if not callable(value) else value(builder), 1.0, 1.0)
    return builder.finish()


@INTEGRATORS
def test_shader_values(settings):
    """Read colours, positions, negative and great numbers where a material has them, also behind a thin veil."""
    place, number = COLOR_AOV + "place", VALUE_AOV + "number"
    floor = replace(scenes.material(color=0.5), aovs={
        place: value_program(lambda builder: builder.input("POSITION")), number: value_program(-2.0)})
    veil = replace(scenes.transparent(0.75, color=0.5), aovs={number: value_program(1e6)})
    objects = [("floor", scenes.place(), "floor"), ("veil", scenes.place(x=3.0, z=1.0), "veil")]
    delta = misty(MistData(), objects=objects,
                  materials={"floor": floor, "veil": veil})
    found, _ = render(delta, (place, number, COLOR_AOV + "nowhere"), settings=settings)
    left, right = found[number][:, :4, 0], found[number][:, 4:, 0]
    assert (left == -2.0).all()
    # Of alpha 0.25 the veil hides nothing: both count, the floor by what reaches it.
    np.testing.assert_allclose(right, 1e6 - 1.5, rtol=1e-6)
    x = (np.arange(8) + 0.5) / 8 - 0.5
    np.testing.assert_allclose(found[place][:, :4, 0], np.tile(x[:4], (8, 1)), atol=0.02)
    np.testing.assert_allclose(found[place][:, :4, 1], np.tile(x[:, None], (1, 4)), atol=0.02)
    assert (found[place][:, :4, 3] == 1.0).all() and np.allclose(found[place][:, 4:, 3], 0.75)
    assert not found[COLOR_AOV + "nowhere"].any()


def test_the_world_has_values():
    """Read the world's value where nothing is met, through a veil by its transparency."""
    sky = COLOR_AOV + "sky"
    delta = misty(MistData(), objects=[("veil", scenes.place(x=3.0), "veil")],
                  materials={"veil": scenes.transparent(0.75, color=0.5)})
    delta.world = replace(delta.world, aovs={sky: value_program((1.0, 2.0, 3.0))})
    found, _ = render(delta, (sky,))
    np.testing.assert_allclose(found[sky][:, :4], np.broadcast_to([1.0, 2.0, 3.0, 1.0], (8, 4, 4)), rtol=1e-5)
    np.testing.assert_allclose(found[sky][:, 4:], 0.75 * np.broadcast_to([1.0, 2.0, 3.0, 1.0], (8, 4, 4)), rtol=1e-5)


@INTEGRATORS
def test_occlusion(settings):
    """Find the cosine-weighted share of the sky that a disk above leaves, and none within a shorter distance."""
    disk = scenes.sphere(1.0, 48)
    disk.positions[:, 2] *= 1e-3
    ceiling = ("disk", scenes.place(z=1.0), "floor", int(Visibility.ALL & ~Visibility.CAMERA))
    delta = scenes.delta({"floor": scenes.quad(3.0), "disk": disk}, [("floor", scenes.place(), "floor"), ceiling],
                         {"floor": scenes.material(color=0.1)}, background=0.3)
    camera = scenes.camera_above(half=0.02)
    for distance, expected in ((10.0, 0.5), (0.9, 1.0)):
        delta.world = replace(delta.world, occlusion_distance=distance)
        found, _ = render(delta, (OCCLUSION,), camera=camera, settings=settings, samples=64)
        # A disk of radius and height 1 covers sin(45 degrees) ** 2 of a cosine lobe.
        assert found[OCCLUSION].mean() == pytest.approx(expected, abs=0.01)


def tilted(angle):
    """Return the place of a sun that shines down, turned about x."""
    turned = scenes.place()
    turned[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turned


def lit_floor(lights, kind="DIFFUSE", *objects, background=0.3, **arguments):
    """Return a floor under lamps and a sky."""
    floor = scenes.quad(3.0)
    return scenes.delta({"floor": floor}, [("floor", scenes.place(), "floor"), *objects],
                        {"floor": scenes.material(kind, **arguments), "lid": scenes.material(color=0.5),
                         "veil": scenes.transparent(0.25, color=0.5)},
                        lights=lights, background=background)


@pytest.mark.slow
@INTEGRATORS
def test_shadow(settings):
    """Find how much of two suns' light arrives below a lid that hides the one above: the world doesn't count."""
    suns = [scenes.lamp("SUN", 3.0, tilted(0.0)), scenes.lamp("SUN", 1.0, tilted(1.2))]
    hidden = int(Visibility.ALL & ~Visibility.CAMERA)
    lid = ("floor", scenes.place(z=1.0) @ np.diag([0.1, 0.1, 1.0, 1.0]), "lid", hidden)
    camera = scenes.camera_above(half=0.02)
    for objects, expected in (((), 1.0), ((lid,), np.cos(1.2) / (3.0 + np.cos(1.2))),
                              (((*lid[:2], "veil", hidden),), (0.75 + np.cos(1.2)) / (3.0 + np.cos(1.2)))):
        found, _ = render(lit_floor(suns, "DIFFUSE", *objects, color=0.5), (SHADOW,), camera=camera,
                          settings=settings, samples=256)
        assert found[SHADOW].shape[2] == 3 and np.array_equal(found[SHADOW][..., 0], found[SHADOW][..., 2])
        # What the veil lets through is chance.
        assert found[SHADOW].mean() == pytest.approx(expected, abs=0.01 if objects else 1e-6)


def test_shadow_where_nothing_shines_or_is():
    """Give 1 to the background and 0 to what no lamp lights."""
    lamp = scenes.lamp("SUN", 3.0, tilted(0.0))
    wide = scenes.camera_above(half=6.0)
    found, _ = render(lit_floor([lamp], color=0.5), (SHADOW,), camera=wide, samples=16)
    assert np.array_equal(np.unique(found[SHADOW]), [1.0])
    for lights in ([], [scenes.lamp("SUN", 3.0, tilted(3.0))]):
        found, _ = render(lit_floor(lights, color=0.5), (SHADOW,), camera=wide, samples=16)
        assert found[SHADOW][4, 4].max() == 0.0 and found[SHADOW][0, 0].min() == 1.0


def test_samples_go_on():
    """Add samples to those that were read already."""
    delta = misty(MistData(), objects=[("floor", scenes.place(), "floor"), ("veil", scenes.place(x=3.125), "floor")])
    found, session = render(delta, ("CryptoObject00", "Mist"))
    session.step(60)
    assert session.first_hits.launches == 1
    again, _ = render(delta, ("CryptoObject00", "Mist"), samples=64)
    np.testing.assert_array_equal(session.read("CryptoObject00"), again["CryptoObject00"])
    assert session.first_hits.launches == 4
    assert not np.array_equal(found["CryptoObject00"], again["CryptoObject00"])


def moved(camera, delta, **places):
    """Make another frame with instances elsewhere, by their number, and vertices elsewhere, by `positions`."""
    transforms = delta.instances.transforms.copy()
    positions = places.pop("positions", {})
    for number, transform in places.items():
        transforms[int(number[1:])] = transform
    return FrameMotion(camera=camera, object_keys=list(delta.instances.object_keys), transforms=transforms,
                       positions=positions)


@INTEGRATORS
def test_motion(settings):
    """Find motion on the film from the frame before and to the one after: of objects, vertices and the camera."""
    delta = scenes.delta(
        {"left": scenes.quad(0.25), "right": scenes.quad(0.25)},
        [("left", scenes.place(x=-0.25), "a"), ("right", scenes.place(x=0.25), "a")],
        {"a": scenes.material(color=0.5)})
    camera = scenes.camera_above(half=0.5)
    session = Session(settings)
    session.update(delta)
    # A unit is 8 pixels. Before, the left was 1/8 to the left and the right's vertices 1/4 up; after, the camera is
    # 1/8 to the right.
    lifted = delta.meshes["right"].positions + np.array([0.0, 0.25, 0.0], np.float32)
    before = moved(camera, delta, i0=scenes.place(x=-0.375), positions={"right": lifted})
    after = moved(replace(camera, transform=tuple(scenes.place(x=0.125, z=3.0).ravel())), delta)
    session.first_hits.motion = before, after
    session.configure(settings, camera, 8, 8, passes=("Combined", "Vector"))
    session.step(1)
    found = session.read("Vector")
    np.testing.assert_allclose(found[2:6, :4], np.broadcast_to([-1.0, 0.0, 1.0, 0.0], (4, 4, 4)), atol=1e-4)
    np.testing.assert_allclose(found[2:6, 4:], np.broadcast_to([0.0, 2.0, 1.0, 0.0], (4, 4, 4)), atol=1e-4)
    assert not found[:2].any() and not found[6:].any()


def test_motion_of_what_is_not_there_in_the_other_frame():
    """Take things that are new, and meshes with other vertices, for still; keep what is behind the camera finite."""
    delta = misty(MistData())
    camera = scenes.camera_above(half=0.5, orthographic=False)
    session = Session(scenes.SETTINGS)
    session.update(delta)
    before = FrameMotion(camera=camera, object_keys=["another"], transforms=np.eye(4)[None] + 1.0,
                         positions={"floor": np.ones((3, 3), np.float32), "unknown": np.ones((4, 3), np.float32)})
    after = FrameMotion(camera=replace(camera, transform=tuple(scenes.place(z=-1.0).ravel())), object_keys=[],
                        transforms=np.zeros((0, 4, 4)))
    session.first_hits.motion = before, after
    session.configure(scenes.SETTINGS, camera, 8, 8, passes=("Combined", "Vector"))
    session.step(1)
    found = session.read("Vector")
    np.testing.assert_allclose(found[..., :2], 0.0, atol=1e-4)
    assert np.isfinite(found).all() and np.abs(found[..., 2:]).max() <= 1.001e6


@INTEGRATORS
def test_nothing_is_done_for_passes_that_nobody_reads(settings):
    """Allocate and launch nothing without these passes, and only what is asked for with them."""
    delta = misty(MistData())
    _, session = render(delta, ("Depth",), settings=settings)
    assert session.first_hits.arrays == [] and session.first_hits.launches == 0
    with pytest.raises(KeyError):
        session.read("Mist")
    _, session = render(delta, ("Mist",), settings=settings)
    assert sorted(len(array) for array in session.first_hits.arrays) == [0] * 6 + [64]
    assert session.first_hits.launches == 1 and session._film.film.normal.shape == (1,)
    session.update(delta)
    assert session.first_hits.arrays == []
