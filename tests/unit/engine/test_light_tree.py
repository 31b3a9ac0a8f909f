# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the light tree: its chances sum to one, choosing follows them, and near lights win."""

import numpy as np
import pytest
import warp as wp
from burnish.engine.light_tree import build_light_tree
from burnish.kernels import light_tree, types

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False})


@wp.kernel
def chances(tree: types.LightTree, position: wp.vec3, normal: wp.vec3, out: wp.array[float]):
    i = wp.tid()
    out[i] = light_tree.chance_by_tree(tree, i, position, normal)


@wp.kernel
def choices(tree: types.LightTree, position: wp.vec3, normal: wp.vec3, u: wp.array[wp.vec2], entry: wp.array[int],
            chance: wp.array[float], left: wp.array[float]):
    i = wp.tid()
    chosen = light_tree.choose_by_tree(tree, position, normal, u[i])
    entry[i] = chosen.entry
    chance[i] = chosen.chance
    left[i] = chosen.left


ANYWHERE = wp.vec3(0.0, 0.0, 0.0)
"""A receiver without a back"""
UP = wp.vec3(0.0, 0.0, 1.0)


def make(count, seed=0, equal=False):
    generator = np.random.default_rng(seed)
    center = generator.uniform(-5, 5, (count, 3))
    half = generator.uniform(0, 0.2, (count, 1))
    power = np.ones(count) if equal else generator.exponential(size=count) ** 3
    tree = build_light_tree(center - half, center + half, power)
    struct = types.LightTree()
    struct.low = wp.array(tree.low, dtype=wp.vec4, device=DEVICE)
    struct.high = wp.array(tree.high, dtype=wp.vec4, device=DEVICE)
    struct.entries = wp.array(tree.entries, dtype=int, device=DEVICE)
    struct.places = wp.array(tree.places, dtype=int, device=DEVICE)
    struct.levels = tree.levels
    return struct, center, power


@pytest.mark.parametrize("normal", [ANYWHERE, UP], ids=["anywhere", "up"])
@pytest.mark.parametrize("count", [1, 2, 3, 17, 1000])
def test_chances_sum_to_one(count, normal):
    """Distribute a chance of exactly one over the lights, seen from anywhere."""
    tree, _, _ = make(count)
    for position in ((0, 0, -6), (4, -3, -2), (100, 0, -30)):
        out = wp.zeros(count, dtype=float, device=DEVICE)
        wp.launch(chances, count, [tree, wp.vec3(*map(float, position)), normal, out], device=DEVICE)
        np.testing.assert_allclose(out.numpy().sum(dtype=np.float64), 1.0, rtol=1e-5)


@pytest.mark.parametrize("normal", [ANYWHERE, UP], ids=["anywhere", "up"])
@pytest.mark.parametrize("count", [5, 300])
def test_choices_follow_the_chances(count, normal):
    """Choose each light as often as its chance says, report that chance, and leave a uniform number."""
    tree, _, _ = make(count, 1)
    draws = 1 << 18
    u = np.random.default_rng(2).random((draws, 2), np.float32)
    entry = wp.zeros(draws, dtype=int, device=DEVICE)
    chance = wp.zeros(draws, dtype=float, device=DEVICE)
    out = wp.zeros(count, dtype=float, device=DEVICE)
    left = wp.zeros(draws, dtype=float, device=DEVICE)
    position = wp.vec3(1.0, 2.0, -1.0)
    wp.launch(choices, draws, [tree, position, normal, wp.array(u, dtype=wp.vec2, device=DEVICE), entry, chance, left],
              device=DEVICE)
    wp.launch(chances, count, [tree, position, normal, out], device=DEVICE)
    assert np.abs(np.histogram(left.numpy(), 16, (0.0, 1.0))[0] / (draws / 16) - 1.0).max() < 0.05
    assert entry.numpy().min() >= 0
    np.testing.assert_allclose(chance.numpy(), out.numpy()[entry.numpy()], rtol=1e-4)
    seen = np.bincount(entry.numpy(), minlength=count)
    expected = out.numpy() * draws
    tested = expected > 5
    chi2 = ((seen - expected)[tested] ** 2 / expected[tested]).sum()
    assert chi2 < tested.sum() + 6 * np.sqrt(2 * tested.sum())


def test_near_lights_win():
    """Give a light next to the receiver several times the chance of an average one among a thousand."""
    tree, center, _ = make(1000, equal=True)
    out = wp.zeros(1000, dtype=float, device=DEVICE)
    ratios = []
    for near in range(0, 1000, 20):
        wp.launch(chances, 1000, [tree, wp.vec3(*map(float, center[near] + 0.01)), ANYWHERE, out], device=DEVICE)
        ratios.append(out.numpy()[near] * 1000)
    assert np.median(ratios) > 8 and np.mean(np.array(ratios) > 1) > 0.9


def test_lights_behind_a_surface_are_not_chosen():
    """Give no chance to lights wholly below a receiver's horizon, and more to those overhead than to grazing ones."""
    center = np.array([(0.0, 0.0, 5.0), (5.0, 0.0, 0.5), (0.0, 0.0, -5.0), (1.0, 1.0, -0.5)])
    tree = build_light_tree(center - 0.1, center + 0.1, np.ones(4))
    struct = types.LightTree()
    struct.low, struct.high = (wp.array(x, dtype=wp.vec4, device=DEVICE) for x in (tree.low, tree.high))
    struct.entries, struct.places = (wp.array(x, dtype=int, device=DEVICE) for x in (tree.entries, tree.places))
    struct.levels = tree.levels
    out = wp.zeros(4, dtype=float, device=DEVICE)
    wp.launch(chances, 4, [struct, wp.vec3(0.0, 0.0, 0.0), UP, out], device=DEVICE)
    overhead, grazing, *behind = out.numpy()
    assert behind == [0.0, 0.0] and overhead > 3.0 * grazing > 0.0
    wp.launch(chances, 4, [struct, wp.vec3(0.0, 0.0, 0.0), ANYWHERE, out], device=DEVICE)
    assert out.numpy().min() > 0.0


@pytest.mark.parametrize("scale", [1e-3, 0.1, 3.0, 1e3])
def test_lights_in_a_plane_are_sorted_along_it(scale):
    """Sort lamps under a ceiling by where they are on it, not by the rounding of their heights, at any scale."""
    x, y = np.meshgrid(np.arange(8.0), np.arange(8.0))
    noise = np.random.default_rng(2).uniform(-1e-7, 1e-7, 64)
    center = np.stack([x.ravel(), y.ravel(), 2.5 + noise], 1)
    tree = build_light_tree(center - 0.1, center + 0.1, np.ones(64))
    # Of four lights, the nodes two levels above the leaves: squares of two by two.
    sides = (tree.high - tree.low)[16:32, :2]
    np.testing.assert_allclose(sides, 1.2, rtol=1e-5)
    scaled = (center * scale).astype(np.float32).astype(np.float64)
    other = build_light_tree(scaled - 0.1 * scale, scaled + 0.1 * scale, np.ones(64))
    np.testing.assert_array_equal(other.entries, tree.entries)
