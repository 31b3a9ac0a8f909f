# SPDX-License-Identifier: GPL-3.0-or-later
"""Cellular patterns and Gabor noise: against a plain search in NumPy, bounds, and what no input may break.

Whether they yield Cycles' values is tested in tests/blender/test_material.py.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import warp as wp
from burnish.kernels import node_codes as codes
from burnish.kernels.node_gabor import gabor
from burnish.kernels.node_voronoi import voronoi

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

COUNT = 300
F1, F2, EDGE, RADIUS = codes.VORONOI_F1, codes.VORONOI_F2, codes.VORONOI_EDGE, codes.VORONOI_RADIUS


@wp.kernel
def evaluate_patterns(
    subs: wp.array[int], places: wp.array[wp.vec4], b: wp.vec4, c: wp.vec4,
    voronoi_out: wp.array[wp.vec4], gabor_out: wp.array[wp.vec4],
):
    """Evaluate both patterns at each place."""
    i = wp.tid()
    voronoi_out[i] = voronoi(codes.PROCEDURAL_VORONOI | subs[i], places[i], b, c)
    gabor_out[i] = gabor(codes.PROCEDURAL_GABOR | (subs[i] & codes.GABOR_3D), places[i], b, c)


def evaluate(device: str, sub: int, places: np.ndarray, b=(0.0, 0.5, 2.0), c=(1.0, 0.0, 0.5)) -> tuple:
    """Return voronoi [n, 4] and gabor [n, 4] at places [n, 4]."""
    count = len(places)
    outputs = [wp.zeros(count, dtype=wp.vec4, device=device) for _ in range(2)]
    wp.launch(evaluate_patterns, count, device=device, outputs=outputs, inputs=[
        wp.array(np.full(count, sub), dtype=int, device=device),
        wp.array(places.astype(np.float32), dtype=wp.vec4, device=device), wp.vec4(*b, 0.0), wp.vec4(*c, 0.0)])
    return tuple(output.numpy() for output in outputs)


def random_places(dimensions: int, seed: int = 1) -> np.ndarray:
    """Return places, 0 in the components that are not used."""
    places = np.random.default_rng(seed).uniform(-20.0, 20.0, (COUNT, 4))
    places[:, dimensions:] = 0.0
    return places.astype(np.float32)


def cell_randoms(cell: tuple[int, ...]) -> list[float]:
    """Return the numbers of a cell: PCG in three or four dimensions after Jarzynski and Olano, with signed shifts."""
    v = [(x * 1664525 + 1013904223) & 0xFFFFFFFF for x in cell]
    last = len(v) - 1

    def mix() -> None:
        pairs = [(1, 2), (2, 0), (0, 1)] if last == 2 else [(1, 3), (2, 0), (0, 1), (1, 2)]
        for i, (j, k) in enumerate(pairs):
            v[i] = (v[i] + v[j] * v[k]) & 0xFFFFFFFF

    mix()
    v = [x ^ ((x >> 16) | (0xFFFF0000 if x & 0x80000000 else 0)) for x in v]
    mix()
    return [(x & 0x7FFFFFFF) / 0x80000000 for x in v]


@pytest.mark.parametrize("dimensions", [3, 4])
def test_nearest_points(device: str, dimensions: int):
    """Find the nearest and the second point of 3^n cells, their distances, colors and the nearest border."""
    places = random_places(dimensions)[:40]
    sub = dimensions - 1
    first, second = (evaluate(device, sub | feature | codes.VORONOI_COLOR, places)[0] for feature in (F1, F2))
    position = evaluate(device, sub | codes.VORONOI_POSITION, places)[0]
    edge = evaluate(device, sub | EDGE, places)[0][:, 3]
    for i, place in enumerate(places.astype(float)):
        corner = np.floor(place[:dimensions]).astype(int)
        cells = [tuple((corner + offset).tolist()) for offset in itertools.product((-1, 0, 1), repeat=dimensions)]
        randoms = np.array([cell_randoms(cell) for cell in cells])
        points = np.array(cells) + randoms
        distances = np.linalg.norm(points - place[:dimensions], axis=1)
        order = np.argsort(distances)
        assert first[i, 3] == pytest.approx(distances[order[0]], abs=1e-4)
        assert second[i, 3] == pytest.approx(distances[order[1]], abs=1e-4)
        np.testing.assert_allclose(position[i, :dimensions], points[order[0]], atol=1e-4)
        np.testing.assert_allclose(first[i, :3], randoms[order[0], :3], atol=1e-6)
        apart = points[order[1:]] - points[order[0]]
        halfway = (points[order[1:]] + points[order[0]]) / 2.0 - place[:dimensions]
        borders = (halfway * apart).sum(1) / np.linalg.norm(apart, axis=1)
        assert edge[i] == pytest.approx(borders.min(), abs=2e-4)


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
@pytest.mark.parametrize("metric", ["EUCLIDEAN", "MANHATTAN", "CHEBYCHEV", "MINKOWSKI"])
def test_bounds(device: str, dimensions: int, metric: str):
    """Keep the order of the distances, whatever the metric, and normalized patterns within 0..1."""
    sub, places = (dimensions - 1) | getattr(codes, "VORONOI_" + metric), random_places(dimensions)
    first, second = (evaluate(device, sub | feature, places)[0][:, 3] for feature in (F1, F2))
    smooth = evaluate(device, sub, places, c=(1.0, 0.7, 0.5))[0][:, 3]
    assert (0.0 <= first).all() and (first <= second).all() and (first < second).mean() > 0.99
    assert (smooth <= first + 1e-5).all() and (smooth < first - 1e-3).any()
    for feature in (F1, F2):
        options = codes.VORONOI_NORMALIZE | codes.VORONOI_COLOR
        pattern = evaluate(device, sub | feature | options, places, b=(2.5, 0.6, 2.2))[0]
        assert pattern.min() >= 0.0 and pattern.max() <= 1.0 and pattern[:, 3].std() > 0.01


def test_radius(device: str):
    """Yield half the distance from the nearest point to its own nearest neighbor: the same all over a cell."""
    places = random_places(3)
    radius = evaluate(device, 2 | RADIUS, places)[0][:, 3]
    centers = evaluate(device, 2 | codes.VORONOI_POSITION, places)[0]
    neighbors = evaluate(device, 2 | F2, centers)[0][:, 3]
    np.testing.assert_allclose(radius, 0.5 * neighbors, atol=1e-4)


def test_octaves(device: str):
    """Add octaves by roughness, the last one partly; no randomness leaves the lattice."""
    places, sub = random_places(2), 1 | codes.VORONOI_COLOR
    octaves = [evaluate(device, sub, places * scale)[0] for scale in (1.0, 2.5, 6.25)]
    found = evaluate(device, sub, places, b=(1.25, 0.4, 2.5))[0]
    expected = octaves[0] + 0.4 * octaves[1] + 0.25 * 0.16 * octaves[2]
    # Rounding decides which of two cells is nearer where their distances are equal.
    assert (np.abs(found - expected).max(1) > 2e-3).sum() <= 2
    lattice = evaluate(device, 1, places, c=(0.0, 0.0, 0.5))[0][:, 3]
    offset = places[:, :2] - np.round(places[:, :2])
    np.testing.assert_allclose(lattice, np.linalg.norm(offset, axis=1), atol=1e-5)


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
def test_edges(device: str, dimensions: int):
    """Keep normalized distances to borders within 0..1, near 0 where two points are as near."""
    places, sub = random_places(dimensions), (dimensions - 1)
    edges = evaluate(device, sub | EDGE | codes.VORONOI_NORMALIZE, places, b=(2.5, 0.6, 2.2))[0][:, 3]
    assert edges.min() >= 0.0 and edges.max() <= 1.0 and edges.std() > 0.05
    first, second, edge = (evaluate(device, sub | feature, places)[0][:, 3] for feature in (F1, F2, EDGE))
    gap = second - first
    # The plane halfway is no nearer than half the gap: distances to two points differ by no more than a step twice.
    assert (edge >= 0.5 * gap - 1e-4).all() and edge[gap < 0.02].mean() < edge[gap > 0.2].mean()


@pytest.mark.parametrize(
    "sub", [0, 1, 2, 3, 2 | F2 | codes.VORONOI_COLOR, 1 | EDGE, 3 | RADIUS, 2 | codes.VORONOI_POSITION])
def test_odd_input(device: str, sub: int):
    """Yield finite numbers for exponents, scales and places without a meaning."""
    places = random_places(4)[:4]
    places[1], places[2], places[3] = 3.0e9, np.nan, np.inf
    for exponent in (0.0, 1.0e-3, -1.0):
        for b in ((15.0, 1.0, 0.0), (np.nan, np.nan, np.nan), (2.5, 0.5, 1.0e30)):
            for c in ((1.0, 0.0, exponent), (np.nan, np.nan, exponent)):
                found = evaluate(device, sub | codes.VORONOI_MINKOWSKI | codes.VORONOI_NORMALIZE, places, b, c)
                assert np.isfinite(found[0]).all()


@pytest.mark.parametrize("dimensions", [2, 3])
def test_gabor_waves(device: str, dimensions: int):
    """Center the noise, and vary along the direction at the frequency but hardly across it without isotropy."""
    sub, places = (codes.GABOR_3D if dimensions == 3 else codes.GABOR_2D), random_places(dimensions, seed=2)
    value, phase, intensity = evaluate(device, sub, places, (3.0, 1.0, 0.0), (1.0, 0.0, 0.0))[1].T[:3]
    assert value.mean() == pytest.approx(0.5, abs=0.02) and 0.05 < value.std() < 0.2
    assert value.min() > 0.0 and value.max() < 1.0
    np.testing.assert_allclose(0.5 - 0.5 * intensity * np.sin(phase * 2.0 * np.pi), value, atol=1e-4)

    def change(axis: int) -> float:
        moved = places.copy()
        moved[:, axis] += 1.0 / 6.0
        return float(np.abs(evaluate(device, sub, moved, (3.0, 1.0, 0.0), (1.0, 0.0, 0.0))[1][:, 0] - value).mean())

    assert change(0) > 2.0 * change(1)
