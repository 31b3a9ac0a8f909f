# SPDX-License-Identifier: GPL-3.0-or-later
"""Test which rays are said to go through where things have moved."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels.moved_ways import CROSSED_SAMPLES, CROSSED_SHARE, WAYS, after_crossing, crosses_way

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

COUNT = 4000
STEPS = 2000
"""Points along a ray that are looked at one by one"""


@wp.kernel
def tell_crossings(
    # In:
    ways: wp.array[wp.vec3], origin: wp.array[wp.vec3], direction: wp.array[wp.vec3], distance: float,
    # Out:
    crossing_out: wp.array[bool],
):
    i = wp.tid()
    crossing_out[i] = crosses_way(ways, origin[i], direction[i], distance)


@wp.kernel
def forget(
    # In:
    light: wp.array[wp.vec4],
    # Out:
    light_out: wp.array[wp.vec4],
):
    i = wp.tid()
    light_out[i] = after_crossing(light[i])


def crossing(ways, origin, direction, distance):
    """Ask the kernel."""
    rays = [wp.array(rows, dtype=wp.vec3, device=DEVICE) for rows in (ways, origin, direction)]
    found = wp.zeros(len(origin), dtype=bool, device=DEVICE)
    wp.launch(tell_crossings, len(origin), [*rays, distance], [found], device=DEVICE)
    return found.numpy()


def boxes(rng, count):
    """Return corners of boxes of all shapes."""
    a, b = rng.uniform(-1.0, 1.0, (2, count, 3))
    return np.minimum(a, b), np.maximum(a, b)


@pytest.mark.parametrize("count", [0, 1, 3, int(WAYS)])
def test_rays_through_boxes_are_told(count):
    """Agree with points tried along each ray: from inside, past boxes, short of them, and along an axis."""
    rng = np.random.default_rng(count)
    low, high = boxes(rng, int(WAYS))
    high = low + 0.5 * (high - low)
    ways = np.zeros((1 + 2 * int(WAYS), 3))
    ways[0, 0], ways[1::2], ways[2::2] = count, low, high
    origin, direction = rng.uniform(-1.0, 1.0, (COUNT, 3)), rng.normal(size=(COUNT, 3))
    direction[::5] = np.eye(3)[rng.integers(0, 3, len(direction[::5]))] * rng.choice([-1.0, 1.0], (COUNT // 5, 1))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    found = crossing(ways, origin, direction, 0.8)
    expected = np.zeros(COUNT, bool)
    for t in np.linspace(0.0, 0.8, STEPS):
        points = (origin + t * direction)[:, None]
        expected |= ((points >= low[:count]) & (points <= high[:count])).all(-1).any(-1)
    # A corner that a ray cuts by less than a step is not seen point by point.
    assert (found[expected]).all() and (found & ~expected).mean() < 0.003
    assert count == 0 or 0.01 < expected.mean() < 0.8


def test_no_array_is_no_box():
    """Take an empty array for no boxes, as frames without a tracker have."""
    origin = np.zeros((4, 3))
    assert not crossing(np.zeros((0, 3)), origin, np.eye(3)[[0, 1, 2, 0]], 1e18).any()


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_means_stay_near(share):
    """Forget without taking those samples for much more or less than they are: 0 through the box, 1 beside it."""
    rng = np.random.default_rng(7)
    held, means, lengths = np.full((COUNT, 4), 0.5, np.float32), [], []
    held[:, 3] = 64.0
    for frame in range(150):
        through = rng.random(COUNT) < share
        before = np.minimum(held[:, 3], 64.0)
        held[:, :3] += (np.where(through, 0.0, 1.0)[:, None] - held[:, :3]) / (before + 1.0)[:, None]
        held[:, 3] = before + 1.0
        less = wp.zeros(COUNT, dtype=wp.vec4, device=DEVICE)
        wp.launch(forget, COUNT, [wp.array(held, dtype=wp.vec4, device=DEVICE)], [less], device=DEVICE)
        held = np.where(through[:, None], less.numpy(), held)
        if frame >= 100:
            means.append(held[:, 0].mean())
            lengths.append(held[:, 3].mean())
    assert np.mean(means) == pytest.approx(1.0 - share, rel=0.045, abs=1e-3)
    assert np.mean(lengths) < 2.0 / (share * (1.0 - float(CROSSED_SHARE))) + float(CROSSED_SAMPLES)
