# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps whose node trees vary: kernels find what the program says, wherever such a lamp is sampled or met."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from burnish.engine import lamp_tables
from burnish.engine.device_scene import DeviceScene
from burnish.engine.lamps import lamp_array
from burnish.engine.program import ProgramBuilder
from burnish.engine.report import Report
from burnish.engine.settings import PerformanceSettings
from burnish.kernels.lamp_tables import draw_lamp, meet_lamp
from burnish.kernels.types import Lights

from tests import scenes

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

COUNT = 4096
PLACE = np.array([0.3, -0.2, 1.5])


@wp.kernel
def look(
    lights: Lights, positions: wp.array[wp.vec3], u: wp.array[wp.vec2],
    drawn: wp.array[wp.vec3], met: wp.array[wp.vec3], along: wp.array[wp.vec4],
):
    """Draw and meet the first lamp from each position."""
    i = wp.tid()
    s = draw_lamp(lights, 0, positions[i], u[i])
    if s.kind >= 0:
        drawn[i] = s.radiance
        along[i] = wp.vec4(s.wi[0], s.wi[1], s.wi[2], s.distance)
        met[i] = meet_lamp(lights, 0, positions[i], s.wi, 1.0e18).radiance


def build(color) -> object:
    """Compile what `color` makes of a builder."""
    builder = ProgramBuilder()
    builder.emit(color(builder), 1.0, 1.0)
    return builder.finish()


def smooth(builder, value):
    """Return 0.6 + 0.4 of a vector: a colour that changes with it."""
    return builder.vector("MULTIPLY_ADD", value, 0.4, 0.6)


def turned(scale=(1.0, 1.0, 1.0)) -> np.ndarray:
    """Return a transform that turns, stretches and moves."""
    a, b = 0.7, 2.1
    x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    z = np.array([[math.cos(b), -math.sin(b), 0], [math.sin(b), math.cos(b), 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = z @ x * np.asarray(scale)
    matrix[:3, 3] = PLACE
    return matrix


def seen(light, device):
    """Return what is drawn and met of a lamp over what it would be without its program, and where: [n, 3] each.

    Then directions from the lamp [n, 3], distances [n], points on the lamp from its centre [n, 3].
    """
    scene = DeviceScene(device)
    scene.apply(scenes.delta({"a": scenes.quad(2.0)}, [("a", np.eye(4), "m")], {"m": scenes.material(color=0.5)},
                             [light]), PerformanceSettings())
    rng = np.random.default_rng(1)
    out = rng.normal(size=(COUNT, 3))
    positions = PLACE + out / np.linalg.norm(out, axis=1)[:, None] * rng.uniform(0.9, 3.0, COUNT)[:, None]
    at = wp.array(positions.astype(np.float32), dtype=wp.vec3, device=device)
    u = wp.array(rng.random((COUNT, 2), np.float32), dtype=wp.vec2, device=device)
    found = []
    for lights in (scene.light_struct, without_tables(scene, light)):
        drawn, met = (wp.zeros(COUNT, dtype=wp.vec3, device=device) for _ in range(2))
        along = wp.zeros(COUNT, dtype=wp.vec4, device=device)
        wp.launch(look, COUNT, [lights, at, u, drawn, met, along], device=device)
        found.append((drawn.numpy().astype(float), met.numpy().astype(float), along.numpy().astype(float)))
    (drawn, met, along), (plain, plain_met, _) = found
    lit = plain[:, 0] > 1e-6
    assert lit.sum() > 100
    direction, distance = along[lit, :3], along[lit, 3]
    point = positions[lit] + direction * distance[:, None] - PLACE
    met = met[lit] / plain_met[lit] if (plain_met[lit] > 0.0).all() else None
    return drawn[lit] / plain[lit], met, -direction, distance, point


def without_tables(scene, light) -> Lights:
    """Return the lights as they would be without the lamp's program."""
    from burnish.engine.emitters import EmitterTable
    from burnish.engine.light_table import build_lights

    rows = lamp_array([replace(light, program=None)], scene.origin, Report())
    return build_lights(rows, EmitterTable.empty(scene.device), 0.0, 1.0, scene.device)


def to_object(matrix, directions):
    """Return normals in the lamp's space, as Cycles has them."""
    local = directions @ matrix[:3, :3]
    return local / np.linalg.norm(local, axis=1)[:, None]


@pytest.mark.parametrize(("kind", "fields"), [
    ("POINT", {"radius": 0.0}), ("POINT", {"radius": 0.1}), ("SPOT", {"radius": 0.05, "spot_size": 1.5}),
    ("SPOT", {"radius": 0.0, "spot_size": 3.1}),
])
def test_direction(kind, fields, device):
    """Colour light by the direction in which it leaves, in the lamp's own space, if it is stretched too."""
    light = scenes.lamp(kind, 50.0, turned((1.0, 0.7, 1.2)), **fields)
    light.program = build(lambda b: smooth(b, b.input("OBJECT_NORMAL")))
    drawn, met, out, _, _ = seen(light, device)
    expected = 0.6 + 0.4 * to_object(light.transform, out)
    np.testing.assert_allclose(drawn, expected, atol=0.004)
    if met is not None:
        np.testing.assert_allclose(met, drawn, rtol=1e-3)


def test_normal_of_sphere(device):
    """Colour a sphere by its normals, not by the direction of light."""
    light = scenes.lamp("POINT", 50.0, turned(), radius=0.4, soft_falloff=False)
    light.program = build(lambda b: smooth(b, b.input("NORMAL")))
    drawn, met, _, _, point = seen(light, device)
    np.testing.assert_allclose(drawn, 0.6 + 0.4 * point / 0.4, atol=0.004)
    np.testing.assert_allclose(met, drawn, atol=0.002)


@pytest.mark.parametrize("shape", ["RECTANGLE", "ELLIPSE"])
def test_place_on_area(shape, device):
    """Colour an area lamp by the coordinates of its UV map."""
    light = scenes.lamp("AREA", 50.0, turned((1.0, 2.0, 1.0)), shape=shape, size_x=0.8, size_y=0.3)
    light.program = build(lambda b: b.input("PARAMETRIC"))
    drawn, met, _, _, point = seen(light, device)
    local = point @ np.linalg.inv(light.transform[:3, :3]).T
    np.testing.assert_allclose(drawn[:, 0], local[:, 0] / 0.8 + 0.5, atol=0.006)
    np.testing.assert_allclose(drawn[:, 1], local[:, 1] / 0.3 + 0.5, atol=0.006)
    np.testing.assert_allclose(met, drawn, atol=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("power", [1.0, 2.0])
def test_distance(power, device):
    """Multiply by powers of the distance, exactly, and by the direction's colour at the same time."""
    light = scenes.lamp("POINT", 50.0, turned(), radius=0.05)
    light.program = build(lambda b: b.vector(
        "MULTIPLY", smooth(b, b.input("OBJECT_NORMAL")), b.math("POWER", b.input("RAY_LENGTH"), power)))
    drawn, _, out, distance, _ = seen(light, device)
    expected = (0.6 + 0.4 * to_object(light.transform, out)) * distance[:, None] ** power
    np.testing.assert_allclose(drawn, expected, rtol=0.01)


@pytest.mark.slow
def test_lamps_share_tables(monkeypatch, device):
    """Make a program's table once for all lamps alike, however they are turned, and not again where they move."""
    made = []
    plain = lamp_tables.bake
    monkeypatch.setattr(lamp_tables, "bake", lambda *args: made.append(args) or plain(*args))
    program = build(lambda b: smooth(b, b.space("NORMAL_TO_OBJECT", b.input("INCOMING"))))
    lights = [scenes.lamp("POINT", 5.0, matrix, program=program) for matrix in (np.eye(4), turned())]
    scene = DeviceScene(device)
    delta = scenes.delta({"a": scenes.quad()}, [("a", np.eye(4), "m")], {"m": scenes.material(color=0.5)}, lights)
    scene.apply(delta, PerformanceSettings())
    assert len(made) == 1 and (scene.lamps["flags"] >> 8 == [1, 2]).all()
    array = scene.lamp_tables.array
    again = type(delta)(lights=[lights[0], replace(lights[1], transform=turned((1.0, 1.0, 1.0)) @ turned())])
    scene.apply(again, PerformanceSettings())
    assert len(made) == 1 and scene.lamp_tables.array is array
    other = build(lambda b: smooth(b, b.input("INCOMING")))
    for count, matrix in ((2, np.eye(4)), (3, turned())):
        scene.apply(type(delta)(lights=[scenes.lamp("POINT", 5.0, matrix, program=other)]), PerformanceSettings())
        assert len(made) == count


def test_scenes_without_programs_pay_nothing(monkeypatch, device):
    """Launch nothing and keep no table where no lamp has a program, nor after the last one has lost it."""
    launched = []
    plain = wp.launch
    monkeypatch.setattr(wp, "launch", lambda kernel, *args, **named: launched.append(kernel.key) or plain(
        kernel, *args, **named))
    program = build(lambda b: b.input("OBJECT_NORMAL"))
    counts = []
    for chosen in (None, program, None):
        launched.clear()
        scene = DeviceScene(device)
        lights = [scenes.lamp("POINT", 5.0, np.eye(4), program=chosen)]
        scene.apply(scenes.delta({"a": scenes.quad()}, [("a", np.eye(4), "m")], {"m": scenes.material(color=0.5)},
                                 lights), PerformanceSettings())
        counts.append(launched.count("bake_lamp"))
        assert (scene.lamps["flags"][0] >> 8 > 0) == (chosen is not None)
    assert counts[0] == counts[2] == 0 and counts[1] > 0
    assert len(scene.lamp_tables.array) == 1
