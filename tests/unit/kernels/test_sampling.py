# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the random numbers and warps: stratification, uniformity, agreement with their pdfs."""

import numpy as np
import pytest
import warp as wp
from burnish.kernels import sampling

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False})

COUNT = 1024


@wp.kernel
def draw_pairs(seed: int, dimension: int, out: wp.array[wp.vec2]):
    i = wp.tid()
    out[i] = sampling.sample_pair(sampling.pixel_seed_of(3, 5, seed), wp.uint32(i), dimension)


@wp.kernel
def warp_points(points: wp.array[wp.vec2], disk: wp.array[wp.vec2], cosine: wp.array[wp.vec3],
                cone: wp.array[wp.vec3], triangle: wp.array[wp.vec2], one_minus_cos: float):
    i = wp.tid()
    disk[i] = sampling.sample_disk(points[i])
    cosine[i] = sampling.sample_cosine(points[i])
    cone[i] = sampling.sample_cone(wp.normalize(wp.vec3(1.0, 2.0, -0.5)), one_minus_cos, points[i])
    triangle[i] = sampling.sample_triangle(points[i])


def pairs(count, seed=7, dimension=0):
    out = wp.zeros(count, dtype=wp.vec2, device=DEVICE)
    wp.launch(draw_pairs, count, [seed, dimension, out], device=DEVICE)
    return out.numpy()


@pytest.mark.parametrize("dimension", range(6))
def test_pairs_are_nets(dimension):
    """Find exactly one of the first 2^m points in every elementary interval."""
    points = pairs(COUNT, dimension=dimension)
    for count in (16, 256, COUNT):
        bits = int(np.log2(count))
        for split in range(bits + 1):
            columns, rows = 2**split, 2 ** (bits - split)
            cell = np.floor(points[:count, 0] * columns) * rows + np.floor(points[:count, 1] * rows)
            assert (np.bincount(cell.astype(int), minlength=count) == 1).all()


def test_dimensions_are_uncorrelated():
    """Correlate pairs of different dimensions and seeds no more than chance allows."""
    streams = [pairs(4096, seed, dimension)[:, axis] for seed in (0, 1) for dimension in (0, 1, 2) for axis in (0, 1)]
    correlation = np.corrcoef(streams) - np.eye(len(streams))
    assert np.abs(correlation).max() < 5 / np.sqrt(4096)


def test_same_seed_same_numbers():
    """Repeat a sequence exactly, and change it with the seed."""
    assert (pairs(64, 3) == pairs(64, 3)).all()
    assert (pairs(64, 3) != pairs(64, 4)).any()


def test_warps_keep_their_densities():
    """Compare moments of warped points with those of the densities they stand for."""
    count = 1 << 16
    points = wp.array(pairs(count), dtype=wp.vec2, device=DEVICE)
    disk = wp.zeros(count, dtype=wp.vec2, device=DEVICE)
    triangle = wp.zeros(count, dtype=wp.vec2, device=DEVICE)
    cosine = wp.zeros(count, dtype=wp.vec3, device=DEVICE)
    cone = wp.zeros(count, dtype=wp.vec3, device=DEVICE)
    wp.launch(warp_points, count, [points, disk, cosine, cone, triangle, 0.3], device=DEVICE)
    radius = np.linalg.norm(disk.numpy(), axis=1)
    assert radius.max() <= 1.0 + 1e-6
    np.testing.assert_allclose((radius**2).mean(), 0.5, atol=1e-3)
    z = cosine.numpy()[:, 2]
    np.testing.assert_allclose([z.mean(), (z**2).mean()], [2 / 3, 0.5], atol=1e-3)
    axis = np.array([1, 2, -0.5]) / np.linalg.norm([1, 2, -0.5])
    along = cone.numpy() @ axis
    assert along.min() >= 0.7 - 1e-5
    np.testing.assert_allclose(along.mean(), 0.85, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(cone.numpy(), axis=1), 1.0, atol=1e-5)
    b = triangle.numpy()
    assert b.min() >= 0 and b.sum(1).max() <= 1 + 1e-6
    np.testing.assert_allclose(b.mean(0), 1 / 3, atol=1e-3)
    np.testing.assert_allclose((b**2).mean(0), 1 / 6, atol=1e-3)


@wp.kernel
def both_ways(seed: wp.uint32, dimension: int, pairs: wp.array[wp.vec2], numbers: wp.array[float]):
    i = wp.tid()
    pairs[i] = sampling.sample_pair(seed, wp.uint32(i), dimension)
    numbers[i] = sampling.sample_number(seed, wp.uint32(i), dimension)


def test_number_is_the_first_of_a_pair(device):
    """Make one number of a sequence without its partner, stratified like the pair."""
    pairs, numbers = wp.zeros(64, dtype=wp.vec2, device=device), wp.zeros(64, dtype=float, device=device)
    wp.launch(both_ways, 64, [wp.uint32(12345), 7, pairs, numbers], device=device)
    np.testing.assert_array_equal(pairs.numpy()[:, 0], numbers.numpy())
    assert sorted((numbers.numpy() * 64).astype(int)) == list(range(64))
