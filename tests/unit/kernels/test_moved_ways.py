# SPDX-License-Identifier: GPL-3.0-or-later
"""Test which rays are said to go through where things have moved."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels.moved_ways import WAY_SAMPLES, WAY_SAMPLES_MIN, WAYS, crosses_way, way_cap, way_share
from burnish.kernels.probe_blend import UPDATES_MAX, WAY_UPDATES, WAY_UPDATES_MIN, updates_through_ways
from burnish.kernels.probe_rays import ProbeRays
from burnish.kernels.probe_types import CELLS, NO_CELL, ProbeUpdates

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

COUNT = 4000
STEPS = 800
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
def average(
    # In:
    through: wp.array2d[int],
    # Out:
    share_out: wp.array[float],
    mean_out: wp.array2d[float],
    length_out: wp.array2d[float],
):
    """Average samples as cells do: 0 through a box, 1 beside it, one a frame; before all were 1."""
    i = wp.tid()
    mean = float(1.0)
    known = float(64.0)
    for frame in range(through.shape[1]):
        before = wp.min(known, way_cap(share_out[i]))
        mean = mean + (1.0 - float(through[i, frame]) - mean) / (before + 1.0)
        known = before + 1.0
        share_out[i] = way_share(share_out[i], through[i, frame], 1)
        mean_out[i, frame] = mean
        length_out[i, frame] = known


@wp.kernel
def count_updates(
    # In:
    ways: wp.array[wp.vec3],
    updates: ProbeUpdates,
    rays: ProbeRays,
    # Out:
    count_out: wp.array[float],
):
    update = wp.tid()
    count_out[update] = updates_through_ways(ways, updates, rays, update, 0, 1)


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


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
def test_means_are_short(share):
    """Remember as many samples as a share says, and take those through boxes for little less than they are."""
    frames = 150
    through = np.random.default_rng(7).random((COUNT, frames)) < share
    shares = wp.zeros(COUNT, dtype=float, device=DEVICE)
    mean, length = (wp.zeros((COUNT, frames), dtype=float, device=DEVICE) for _ in range(2))
    wp.launch(average, COUNT, [wp.array(through.astype(np.int32), dtype=int, device=DEVICE)], [shares, mean, length],
              device=DEVICE)
    late = mean.numpy()[:, 100:].mean()
    assert late == pytest.approx(1.0 - share, rel=0.05, abs=1e-3)
    most = max(float(WAY_SAMPLES) / share, float(WAY_SAMPLES_MIN)) + 1.0 if share > 0.0 else np.inf
    assert 0.8 * min(most, 60.0) < length.numpy()[:, 100:].mean() < 1.7 * most
    if share == 1.0:
        # Most of what was before is gone soon.
        assert mean.numpy()[:, 8].mean() < 0.2


def test_probes_remember_by_the_share_of_their_rays():
    """Let as many updates count as the rays through boxes allow, weighed by what each stands for; without any all."""
    rng, count, cells = np.random.default_rng(3), 40, int(CELLS)
    direction = rng.normal(size=(count * cells, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.zeros_like(direction)
    ways = np.zeros((3, 3))
    ways[:] = (1.0, 0.0, 0.0), (0.2, -0.4, -0.4), (1.0, 0.4, 0.4)
    updates, rays = ProbeUpdates(), ProbeRays()
    cell = rng.integers(0, cells, count * cells)
    cell[rng.random(len(cell)) < 0.2] = int(NO_CELL)
    expected = rng.uniform(0.5, 2.0, count * cells)
    answers = np.full((count * cells, 4), 5.0)
    # Rays that end before the box.
    answers[::7, 3] = 0.1
    updates.cell = wp.array(cell.astype(np.uint8), dtype=wp.uint8, device=DEVICE)
    updates.expected = wp.array(expected, dtype=float, device=DEVICE)
    rays.origin, rays.direction = (wp.array(v, dtype=wp.vec3, device=DEVICE) for v in (origin, direction))
    rays.radiance = wp.array(answers, dtype=wp.vec4, device=DEVICE)
    found = wp.zeros(count, dtype=float, device=DEVICE)
    weight = np.where(cell == int(NO_CELL), 0.0, 1.0 / expected.reshape(count, cells)[
        np.arange(count).repeat(cells), np.minimum(cell, cells - 1)]).reshape(count, cells)
    through = crossing(ways, origin, direction, 5.0).reshape(count, cells) & (answers[:, 3] > 0.3).reshape(count, cells)
    wp.launch(count_updates, count, [wp.array(ways, dtype=wp.vec3, device=DEVICE), updates, rays], [found],
              device=DEVICE)
    due = float(WAY_UPDATES) * weight.sum(1) / (weight * through).sum(1)
    np.testing.assert_allclose(found.numpy(), np.maximum(due, float(WAY_UPDATES_MIN)), rtol=1e-4)
    assert float(WAY_UPDATES_MIN) < np.median(due) < 20.0
    wp.launch(count_updates, count, [wp.zeros(3, dtype=wp.vec3, device=DEVICE), updates, rays], [found], device=DEVICE)
    assert (found.numpy() == float(UPDATES_MAX)).all()
