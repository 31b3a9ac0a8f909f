# SPDX-License-Identifier: GPL-3.0-or-later
"""engine/hair.py: tubes around strands."""

from __future__ import annotations

import numpy as np
import pytest
from burnish.engine.hair import SIDES, Strands, fit_to_limit, make_tubes, needed_steps, spared_points, tapered
from burnish.engine.hair_info import along_strands, hair_attributes
from burnish.engine.mesh_features import HAIR, STRAND


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


def arcs(count: int, length: int, angle: float) -> np.ndarray:
    """Return float32 [count, length, 3], arcs of a circle of a metre."""
    angles = np.linspace(0, angle, length)
    return np.tile(np.stack([np.cos(angles), np.sin(angles), 0 * angles], -1).astype(np.float32), (count, 1, 1))


def test_pieces_follow_the_bends():
    """Straight strands need no pieces between points, bent ones more the more they bend between two points."""
    def steps(points: np.ndarray) -> int:
        count, length = points.shape[:2]
        radii = np.full(count * length, 1e-4, np.float32)
        return needed_steps(Strands(points.reshape(-1, 3), radii, np.full(count, length)), 8)
    assert steps(straight(3, 4, 0.1).points.reshape(3, 4, 3)) == 1
    assert [steps(arcs(3, 9, angle)) for angle in (0.2, 1.2, 4.0)] == [1, 2, 4]
    lone = Strands(np.concatenate([arcs(1, 9, 4.0)[0], np.ones((1, 3))]), np.full(10, 1e-4), np.array([9, 0, 1]))
    assert needed_steps(lone, 8) == 4, "strands of a single point don't count"
    assert needed_steps(Strands(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int64)), 4) == 1


def test_points_are_spared_where_strands_are_straight():
    """Points are left out as long as neither places nor radii show it, and two pieces stay."""
    radii = np.full((5, 9), 1e-4)
    line = straight(5, 9, 0.1).points.reshape(5, 9, 3)
    assert spared_points(line, radii) == 4
    assert spared_points(arcs(5, 9, 0.05), radii) == 4 and spared_points(arcs(5, 9, 2.0), radii) == 1
    closed = radii.copy()
    closed[:, -1] = 0
    assert spared_points(line, closed) == 1, "a closed tip would make the whole strand thinner"
    assert spared_points(line, radii * np.linspace(1, 0, 9)) == 4
    assert spared_points(line[:, :8], radii[:, :8]) == 1, "seven pieces don't halve"


def test_closed_tips_have_no_empty_triangles():
    """A ring without radius gives one triangle a side, points in one place give none."""
    strands = straight(1, 4, 0.1)
    strands.radii[-1] = 0
    strands.points[1] = strands.points[0]
    tubes = make_tubes(strands, 1)
    assert len(tubes.triangles) == SIDES * (0 + 2 + 1)
    corners = tubes.positions[tubes.triangles]
    assert (np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0).all()


def test_tapered():
    """A shape of 0 is a cone, more of it thicker, less thinner; ends stay."""
    share = np.array([0.0, 0.5, 1.0])
    assert tapered(0.0, 1.0, 0.2, share) == pytest.approx([1.0, 0.6, 0.2])
    assert tapered(0.5, 1.0, 0.2, share) == pytest.approx([1.0, 0.8 * 0.25 + 0.2, 0.2])
    assert tapered(-0.5, 1.0, 0.2, share) == pytest.approx([1.0, 0.8 * 0.5 ** 0.5 + 0.2, 0.2])
    assert np.isfinite(tapered(1.0, 1.0, 0.2, share)).all()


def test_hair_info():
    """Intercept is the share of the length, Thickness the diameter, Random Cycles' hash of the strand's number."""
    points = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 4], [5, 0, 0], [5, 2, 0]], np.float32)
    counts = np.array([3, 0, 2])
    intercept, lengths = along_strands(points, counts)
    assert intercept == pytest.approx([0, 0.25, 1, 0, 1]) and lengths == pytest.approx([4, 0, 2])
    strands = Strands(points, np.array([0.1, 0.2, 0.1, 0.3, 0.3], np.float32), counts)
    tubes = make_tubes(strands, 1)
    assert hair_attributes(frozenset(), strands, tubes, np.arange(3)) == {}
    found = hair_attributes(frozenset({HAIR, STRAND}), strands, tubes, np.arange(3))
    facts, directions = found[HAIR].reshape(-1, 4), found[STRAND].reshape(-1, 4)
    at = tubes.positions[tubes.triangles].reshape(-1, 3)
    first = at[:, 0] < 2
    np.testing.assert_allclose(facts[first, 0], np.interp(at[first, 2], [0, 1, 4], [0, 0.25, 1]), atol=1e-6)
    np.testing.assert_allclose(facts[first, 2], np.interp(at[first, 2], [0, 1, 4], [0.2, 0.4, 0.2]), atol=1e-6)
    assert set(facts[first, 1]) == {4.0} and set(facts[~first, 1]) == {2.0}
    assert len(set(facts[first, 3])) == len(set(facts[~first, 3])) == 1 and facts[first, 3][0] != facts[~first, 3][0]
    np.testing.assert_allclose(directions[first], np.tile([0, 0, 1, 1], (first.sum(), 1)), atol=1e-6)
    np.testing.assert_allclose(directions[~first], np.tile([0, 1, 0, 1], ((~first).sum(), 1)), atol=1e-6)
