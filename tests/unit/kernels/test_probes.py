# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the screen probes' building blocks: the map of directions, its integrals, rounding, and patching."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.kernels import probe_blend, probe_map, probe_rays, probe_spawn, probe_turns
from burnish.kernels.geometry_math import to_frame

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

SIDE = 512
"""Points a side of the square that are mapped"""


@wp.kernel
def map_points(
    # In:
    side: int,
    # Out:
    direction_out: wp.array[wp.vec3], back_out: wp.array[wp.vec2], cell_out: wp.array[int],
):
    i = wp.tid()
    u = wp.vec2((float(i % side) + 0.5) / float(side), (float(i // side) + 0.5) / float(side))
    d = probe_map.square_to_hemisphere(u)
    direction_out[i] = d
    back_out[i] = probe_map.hemisphere_to_square(d) - u
    cell_out[i] = probe_map.cell_of(d)


@wp.kernel
def rotate_back(
    # In:
    normals: wp.array[wp.vec3], local: wp.array[wp.vec3],
    # Out:
    back_out: wp.array[wp.vec3],
):
    i = wp.tid()
    back_out[i] = probe_map.to_local(normals[i], to_frame(normals[i], local[i]))


@wp.kernel
def evaluate_bands(
    # In:
    normals: wp.array[wp.vec3], weights: wp.array[float], radiance: wp.array[float],
    # Out:
    irradiance_out: wp.array[float],
):
    i = wp.tid()
    basis = probe_map.band_basis(normals[i])
    total = float(0.0)
    for cell in range(64):
        for band in range(10):
            total = total + radiance[cell] * weights[cell * 10 + band] * basis[band]
    irradiance_out[i] = total


@wp.kernel
def round_halves(
    # In:
    value: float,
    # Out:
    half_out: wp.array[wp.float16],
):
    i = wp.tid()
    half_out[i] = probe_blend.dithered_half(value, probe_blend.hash32(wp.uint32(i)))


@wp.kernel
def mean_distances(
    # In:
    near: wp.array[float], far: wp.array[float], share: float,
    # Out:
    means_out: wp.array[float],
):
    i = wp.tid()
    means_out[i] = probe_rays.distance_of(wp.lerp(
        probe_rays.inverse_distance(near[i]), probe_rays.inverse_distance(far[i]), share))


@wp.kernel
def measure_layers(
    # In:
    first: wp.array[wp.vec3], second: wp.array[wp.vec3], offsets: wp.array[wp.vec3],
    # Out:
    distances_out: wp.array[float],
):
    """Write the distance across the surface between two points."""
    i = wp.tid()
    distances_out[i] = probe_spawn.surface_distance(first[i], second[i], offsets[i])


@wp.kernel
def serve(
    # In:
    free: int, empty: int, frame: int, empty_list: wp.array[int],
    # Out:
    tile_out: wp.array[int],
):
    i = wp.tid()
    tile_out[i] = probe_turns.served_tile(i, free, empty, frame, empty_list)


def run(kernel, count, inputs, outputs):
    """Launch on the processor and return the outputs as numpy arrays."""
    arrays = [wp.zeros(count, dtype=dtype, device=DEVICE) for dtype in outputs]
    wp.launch(kernel, count, inputs, arrays, device=DEVICE, block_dim=1)
    return [array.numpy() for array in arrays]


def integrals(exact=1):
    """Return the tables of the cells [64, 10] and [64]."""
    weights, cosines = wp.zeros(640, dtype=float, device=DEVICE), wp.zeros(64, dtype=float, device=DEVICE)
    wp.launch(probe_map.integrate_cells, 64, [64, exact], [weights, cosines], device=DEVICE, block_dim=1)
    return weights, cosines


def test_map_is_equal_area_and_bijective():
    """Map equal areas of the square to equal solid angles of the hemisphere, and back to the same point."""
    direction, back, cell = run(map_points, SIDE * SIDE, [SIDE], [wp.vec3, wp.vec2, int])
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=2e-6)
    assert direction[:, 2].min() >= 0.0
    np.testing.assert_allclose(back, 0.0, atol=2e-6)
    x, y = np.arange(SIDE * SIDE) % SIDE * 8 // SIDE, np.arange(SIDE * SIDE) // SIDE * 8 // SIDE
    np.testing.assert_array_equal(cell, y * 8 + x)
    # Uniform over the hemisphere: heights and azimuths are uniform, the mean of cos is 1/2 and of cos^2 1/3.
    np.testing.assert_allclose(np.sort(direction[:, 2]), np.linspace(0, 1, SIDE * SIDE), atol=0.005)
    azimuth = np.arctan2(direction[:, 1], direction[:, 0])
    np.testing.assert_allclose(np.sort(azimuth), np.linspace(-np.pi, np.pi, SIDE * SIDE), atol=0.03)
    np.testing.assert_allclose((direction[:, 2] ** 2).mean(), 1 / 3, rtol=1e-4)


def test_frames_agree():
    """Read a direction in the frame in which it was written."""
    rng = np.random.default_rng(1)
    n = rng.normal(size=(1000, 3))
    n[:3] = [[0, 0, 1], [0, 0, -1], [1, 0, 0]]
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    d = rng.normal(size=(1000, 3))
    back, = run(rotate_back, 1000, [wp.array(n, dtype=wp.vec3, device=DEVICE),
                                    wp.array(d, dtype=wp.vec3, device=DEVICE)], [wp.vec3])
    np.testing.assert_allclose(back, d, atol=1e-5)


@pytest.mark.parametrize("angle", [0.0, 20.0, 30.0, 45.0, 80.0])
def test_white_hemisphere(angle):
    """Give (1 + cos) / 2 for a white hemisphere at every angle to the probe's normal, so that dividing is exact."""
    weights, cosines = integrals()
    np.testing.assert_allclose(cosines.numpy().sum(), 32.0, rtol=1e-4)
    a = np.radians(angle)
    normals = wp.array([[np.sin(a), 0, np.cos(a)]], dtype=wp.vec3, device=DEVICE)
    value, = run(evaluate_bands, 1, [normals, weights, wp.array(np.ones(64), dtype=float, device=DEVICE)], [float])
    np.testing.assert_allclose(value, (1 + np.cos(a)) / 2, rtol=1e-3)


def test_one_cell_is_exact_along_the_normal():
    """Give each cell's own mean cosine along the probe's normal, which harmonics alone don't."""
    weights, cosines = integrals()
    up = wp.array([[0, 0, 1]], dtype=wp.vec3, device=DEVICE)
    for cell in range(64):
        light = np.zeros(64)
        light[cell] = 1.0
        value, = run(evaluate_bands, 1, [up, weights, wp.array(light, dtype=float, device=DEVICE)], [float])
        np.testing.assert_allclose(value, cosines.numpy()[cell] / 32, rtol=1e-3, atol=1e-6)


def test_published_weights_differ():
    """Show the published estimate's energy: 3.24 / 8 of what a white sky gives, times pi over 1."""
    weights, _ = integrals(exact=0)
    up = wp.array([[0, 0, 1]], dtype=wp.vec3, device=DEVICE)
    value, = run(evaluate_bands, 1, [up, weights, wp.array(np.ones(64), dtype=float, device=DEVICE)], [float])
    assert 1.25 < value[0] < 1.33


@pytest.mark.parametrize("value", [1.0003, 0.01234567, 777.3, 3.0e-4])
def test_rounding_has_no_bias(value):
    """Round to the neighbouring half-floats so that the mean is the value."""
    halves, = run(round_halves, 200000, [value], [wp.float16])
    assert len(np.unique(halves)) == 2
    spacing = float(np.spacing(np.float16(value)))
    assert np.abs(halves.astype(np.float64) - value).max() <= spacing
    np.testing.assert_allclose(halves.astype(np.float64).mean(), value, atol=0.01 * spacing)


@pytest.mark.parametrize(("free", "empty"), [(7, 3), (3, 7), (100, 1), (1, 100), (64, 64), (50000, 129000), (5, 0)])
def test_patching_is_a_bijection(free, empty):
    """Serve min(free, empty) tiles, none twice, whichever the frame."""
    tiles = wp.array(np.arange(max(empty, 1)), dtype=int, device=DEVICE)
    for frame in (0, 1, 12345):
        served, = run(serve, free, [free, empty, frame, tiles], [int])
        served = served[served >= 0]
        assert len(served) == min(free, empty)
        assert len(np.unique(served)) == len(served)


def test_distance_across_a_surface():
    """Give arcs none, however far they bend away from the tangent planes, and layers the distance between them."""
    angles = np.array([0.1, 0.3, 0.6])
    arc = np.stack([np.sin(angles), np.zeros(3), np.cos(angles)], 1)
    top = np.broadcast_to([0.0, 0.0, 1.0], (3, 3))
    offsets = (arc - top) * 5.0
    arrays = [wp.array(x.astype(np.float32), dtype=wp.vec3, device=DEVICE) for x in (top, arc, offsets)]
    (found,) = run(measure_layers, 3, arrays, [float])
    assert np.abs(offsets[2, 2]) > 0.8 and np.abs(found).max() < 1e-5
    layer = np.array([[0.7, -0.4, 0.12]] * 3)
    arrays = [wp.array(x.astype(np.float32), dtype=wp.vec3, device=DEVICE) for x in (top, top, layer)]
    (found,) = run(measure_layers, 3, arrays, [float])
    assert found == pytest.approx(np.full(3, 0.12), rel=1e-5)


@pytest.mark.parametrize("scale", [2.0**-10, 1.0, 2.0**10])
def test_distances_scale(scale):
    """Average distances alike at any scale, however near; the sky has none, and among nothing else stays the sky."""
    sky = float(probe_rays.MISS_DISTANCE)
    near = np.array([3.0e-3, 0.1, 4.0, 4.0]) * scale
    far = np.array([6.0e-3, 0.1, 12.0, sky / scale]) * scale
    ways = [wp.array(x, dtype=float, device=DEVICE) for x in (near, far)]
    means, = run(mean_distances, 4, [*ways, 0.25], [float])
    np.testing.assert_allclose(means, np.array([3.428571e-3, 0.1, 4.8, 4.0 / 0.75]) * scale, rtol=1e-5)
    skies = wp.array([sky], dtype=float, device=DEVICE)
    only, = run(mean_distances, 1, [skies, skies, 0.25], [float])
    assert only[0] == pytest.approx(sky)
