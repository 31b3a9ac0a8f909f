# SPDX-License-Identifier: GPL-3.0-or-later
"""engine/hair.py: tubes around strands."""

from __future__ import annotations

import numpy as np
from burnish.engine.hair import SIDES, Strands, fit_to_limit, make_tubes


def straight(count: int, length: int, radius: float) -> Strands:
    """Return `count` strands along z, a metre apart."""
    points = np.zeros((count, length, 3), np.float32)
    points[..., 0] = np.arange(count)[:, None]
    points[..., 2] = np.arange(length)
    return Strands(points.reshape(-1, 3), np.full(count * length, radius, np.float32), np.full(count, length))


def test_mean_width_is_the_diameter():
    """Seen from all sides on average, a tube is as wide as its strand."""
    tubes = make_tubes(straight(1, 2, 0.1), 1)
    ring = tubes.positions[:SIDES, :2]
    angles = np.linspace(0, np.pi, 1000, endpoint=False)
    along = ring @ np.stack([np.cos(angles), np.sin(angles)])
    np.testing.assert_allclose((along.max(0) - along.min(0)).mean(), 0.2, rtol=1e-3)


def test_faces_and_normals_point_outwards():
    """Triangles turn to the outside, where the normals point, also around bent strands."""
    angle = np.linspace(0, 3, 9)
    points = np.stack([np.cos(angle), np.sin(angle), 0.3 * angle], -1).astype(np.float32)
    tubes = make_tubes(Strands(points, np.full(9, 0.02, np.float32), np.array([9])), 4)
    corners = tubes.positions[tubes.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((across[:, None] * tubes.normals[tubes.triangles]).sum(-1) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(tubes.normals, axis=1), 1, rtol=1e-5)
    assert len(tubes.triangles) == 8 * 4 * 2 * SIDES


def test_strands_of_different_lengths_stay_apart():
    """Short strands among long ones shift nothing; those of a single point or none aren't drawn."""
    points = np.zeros((10, 3), np.float32)
    points[:, 2] = np.arange(10)
    counts = np.array([2, 1, 0, 4, 3])
    tubes = make_tubes(Strands(points, np.full(10, 0.01, np.float32), counts), 2)
    assert set(tubes.strand) == {0, 3, 4}
    for strand, low, high in ((0, 0, 1), (3, 3, 6), (4, 7, 9)):
        heights = tubes.positions[tubes.strand == strand, 2]
        np.testing.assert_allclose((heights.min(), heights.max()), (low, high), atol=1e-5)
    assert (tubes.strand[tubes.triangles] == tubes.strand[tubes.triangles][:, :1]).all()
    # Ends count twice, which makes the curve slower next to them: it is an eighth of half a piece late at most.
    exact = tubes.fraction == 0
    np.testing.assert_allclose(tubes.of_points(points[:, 2])[exact], tubes.positions[exact, 2], atol=1e-5)
    np.testing.assert_allclose(tubes.of_points(points[:, 2]), tubes.positions[:, 2], atol=1 / 16 + 1e-5)


def test_no_strands():
    """Hair without strands is an empty mesh."""
    tubes = make_tubes(Strands(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int64)), 4)
    assert len(tubes.positions) == len(tubes.triangles) == 0


def test_limit():
    """Pieces are given up before strands."""
    counts = np.full(100, 3)
    assert fit_to_limit(counts, 4, 10 ** 6) == (4, 1)
    assert fit_to_limit(counts, 4, 100 * 2 * 2 * SIDES) == (1, 1)
    assert fit_to_limit(counts, 4, 100 * SIDES) == (1, 4)
