# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of light candidates: chances, packing and replay."""

import numpy as np
import pytest
import warp as wp
from burnish.engine.device_scene import DeviceScene
from burnish.engine.environment_split import split_environment
from burnish.kernels.direct_emitters import EMITTER_WORDS, bake_emitters
from burnish.kernels.environment_split import EnvironmentSplit
from burnish.kernels.light_candidate import (
    candidate_index,
    candidate_kind,
    candidate_place,
    choose,
    light_classes,
    make_candidate,
    replay,
)
from burnish.kernels.types import Scene

from tests import scenes
from tests.direct_frames import local_power, sunny_world

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

COUNT = 1 << 16


@wp.kernel
def pack(
    # In:
    u: wp.array[wp.vec2],
    # Out:
    ids_out: wp.array[wp.vec2i],
    places_out: wp.array[wp.vec2],
):
    """Pack and unpack candidates."""
    i = wp.tid()
    c = make_candidate(1 + i % 3, i * 1000, u[i])
    ids_out[i] = wp.vec2i(candidate_kind(c), candidate_index(c))
    places_out[i] = candidate_place(c)


@wp.kernel
def draw(
    # In:
    scene: Scene,
    split: EnvironmentSplit,
    emitters: wp.array[wp.uint64],
    position: wp.vec3,
    random: wp.array2d[float],
    # Out:
    lights_out: wp.array[wp.uint32],
    values_out: wp.array[wp.vec3],
):
    """Draw candidates: their light, its chance, 1 / (pdf chance), and radiance / (pdf chance) up to 90 degrees."""
    i = wp.tid()
    choice = choose(
        scene, split, light_classes(scene.lights, split), position, wp.vec2(random[i, 0], random[i, 1]),
        wp.vec2(random[i, 2], random[i, 3]))
    lights_out[i] = choice.candidate.light
    if choice.chance > 0.0:
        s = replay(scene, split, emitters, position, choice.candidate)
        if s.kind >= 0:
            density = s.pdf * choice.chance
            values_out[i] = wp.vec3(choice.chance, 1.0 / density, s.radiance[1] * wp.max(s.wi[2], 0.0) / density)


def drawn(delta, device, position=(0.0, 0.0, 0.0)):
    """Return lights, values of many candidates, and the scene's split."""
    scene = DeviceScene(device)
    scene.apply(delta, scenes.SETTINGS.performance)
    split = split_environment(scene.scene, device)
    random = np.random.default_rng(2).random((COUNT, 4), np.float32)
    count = len(scene.emitters.power)
    emitters = wp.zeros(max(count, 1) * int(EMITTER_WORDS), dtype=wp.uint64, device=device)
    if count:
        wp.launch(bake_emitters, count, [0, scene.scene, local_power(scene)], [emitters], device=device)
    lights = wp.zeros(COUNT, dtype=wp.uint32, device=device)
    values = wp.zeros(COUNT, dtype=wp.vec3, device=device)
    wp.launch(draw, COUNT, [scene.scene, split, emitters, wp.vec3(*position), wp.array2d(random, device=device)],
              [lights, values], device=device)
    return lights.numpy(), values.numpy().astype(np.float64), split


def test_packing(device):
    """Keep kind and index, and both numbers to half a step of 65536, inside (0, 1)."""
    u = np.random.default_rng(1).random((4096, 2), np.float32)
    u[0], u[1] = 0.0, np.float32(1.0 - 2.0**-24)
    ids = wp.zeros(4096, dtype=wp.vec2i, device=device)
    places = wp.zeros(4096, dtype=wp.vec2, device=device)
    wp.launch(pack, 4096, [wp.array(u, dtype=wp.vec2, device=device)], [ids, places], device=device)
    np.testing.assert_array_equal(ids.numpy(), np.stack([1 + np.arange(4096) % 3, np.arange(4096) * 1000], 1))
    np.testing.assert_allclose(places.numpy(), u, atol=0.51 / 65536)
    assert 0 < places.numpy().min() and places.numpy().max() < 1


@pytest.mark.parametrize("background", [0.0, sunny_world()], ids=["lamps", "with world"])
def test_chances_are_frequencies(device, background):
    """Draw every light as often as the chance says that comes with it."""
    lamps = [scenes.lamp("POINT", 10.0, scenes.place(z=2.0)), scenes.lamp("POINT", 50.0, scenes.place(x=3.0, z=1.0)),
             scenes.lamp("SUN", 2.0), scenes.lamp("SUN", 5.0, angle=0.1)]
    lights, values, _ = drawn(scenes.delta({}, [], {}, lamps, background), device)
    for light in np.unique(lights)[:8]:
        mine = lights == light
        chance = values[mine, 0][0]
        np.testing.assert_allclose(mine.mean(), chance, atol=4 * np.sqrt(chance / COUNT))
    suns = {int(light) & 0xFFFF for light in np.unique(lights) if light >> 30 == 1}
    assert suns == {0, 1, 2, 3}


def test_irradiance_of_candidates(device):
    """Integrate candidates to the irradiance of a sun, a sphere and a world's patch together."""
    lamps = [scenes.lamp("SUN", 3.0, scenes.place(z=1.0), angle=0.4),
             scenes.lamp("POINT", 100.0, scenes.place(z=2.0), radius=0.5, soft_falloff=False)]
    world = sunny_world(color=(1.0, 1.0, 1.0))
    lights, values, split = drawn(scenes.delta({}, [], {}, lamps, world), device)
    sphere = 100.0 / (4 * np.pi**2 * 0.25) * np.pi * (0.5 / 2.0) ** 2
    cosine = 0.9 / np.linalg.norm([0.3, 0.2, 0.9])
    np.testing.assert_allclose(values[:, 2].mean(), 3.0 + sphere + split.power * cosine, rtol=0.02)


def exact_irradiance(corners):
    """Return the irradiance at the origin, facing z, from a polygon of radiance 1 above it (Lambert 1760)."""
    v = np.asarray(corners, np.float64)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    total = 0.0
    for p, q in zip(v, np.roll(v, -1, 0), strict=True):
        normal = np.cross(p, q)
        total += 0.5 * np.arctan2(np.linalg.norm(normal), p @ q) * normal[2] / np.linalg.norm(normal)
    return abs(total)


@pytest.mark.parametrize("height", [0.01, 0.1, 2.0])
def test_long_emitters_are_no_sparks_close_by(device, height):
    """Give the irradiance of a bar six metres long, by samples none of which is worth more than the bar around it."""
    corners = np.array([(-3, 0, height), (3, 0, height), (3, 0.04, height), (-3, 0.04, height)], np.float32)
    bar = scenes.mesh(corners, [(0, 1, 2), (0, 2, 3)])
    _, values, _ = drawn(
        scenes.delta({"bar": bar}, [("bar", scenes.place(), "bar")], {"bar": scenes.emitter(5.0)}), device)
    expected = 5.0 * exact_irradiance(corners)
    np.testing.assert_allclose(values[:, 2].mean(), expected, rtol=0.02)
    # By area a point 1 cm away would be worth some hundred times the mean.
    assert values[:, 2].max() < 10.0 * expected


def test_nothing_is_drawn_without_lights(device):
    """Return no candidate where nothing emits."""
    lights, values, _ = drawn(scenes.delta({}, [], {}), device)
    assert not lights.any() and not values.any()
