# SPDX-License-Identifier: GPL-3.0-or-later
"""Tubes in the 8-wide BVH: rays meet their triangles as they do one by one, whatever became of them since."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.hair import Strands, make_tubes
from burnish.engine.tube_items import find_tubes
from burnish.engine.wide_bvh import WideBvh, build_forest, build_wide
from burnish.kernels.wide_bvh import any_face_with_tubes, any_with_tubes, closest_wide, closest_with_tubes
from burnish.kernels.wide_bvh_edit import place_triangles

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

FAR = 1e30


@wp.kernel
def follow(
    # In:
    nodes: wp.array[wp.uint32],
    triangles: wp.array[wp.uint32],
    tubes: int,
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    # Out:
    found_out: wp.array[wp.vec4],
    blocked_out: wp.array[int],
    face_out: wp.array[int],
):
    """Follow rays."""
    i = wp.tid()
    if tubes == 1:
        found_out[i] = closest_with_tubes(nodes, triangles, origin[i], direction[i], 1.0e30)
        blocked_out[i] = int(any_with_tubes(nodes, triangles, origin[i], direction[i], 1.0e30))
        face_out[i] = any_face_with_tubes(nodes, triangles, origin[i], direction[i], 1.0e30)
    else:
        found_out[i] = closest_wide(nodes, triangles, origin[i], direction[i], 1.0e30)


def strands(count: int = 60, points: int = 6, *, wild: float = 0.15, tips: bool = True, seed: int = 1) -> Strands:
    """Make strands that bend, of radii that change, some of which end in a point."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-1, 1, (count, 1, 3))
    way = rng.normal(size=(count, 1, 3)) * np.linspace(0, 1, points)[:, None]
    radii = rng.uniform(0.004, 0.02, (count, 1)) * np.linspace(1.0, 0.4, points)
    if tips:
        radii[::2, -1] = 0.0
    made = start + way + rng.normal(0, wild / points, (count, points, 3)).cumsum(1)
    return Strands(made.reshape(-1, 3).astype(np.float32), radii.ravel().astype(np.float32), np.full(count, points))


def tubes(made: Strands | None = None, offset: float = 0.0, mirrored: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices [V, 3] and triangles [T, 3] of tubes and of a few triangles before, between and after them."""
    hair = make_tubes(made or strands(), 2)
    loose = np.random.default_rng(7).normal(size=(24, 3)).astype(np.float32)
    positions = np.concatenate([hair.positions, loose]) * np.float32([-1 if mirrored else 1, 1, 1])
    apart = np.arange(24, dtype=np.int32).reshape(-1, 3) + len(hair.positions)
    middle = 12 * (len(hair.triangles) // 24)
    triangles = np.concatenate([apart[:2], hair.triangles[:middle], apart[2:4], hair.triangles[middle:], apart[4:]])
    return positions + np.float32(offset), triangles.astype(np.int32)


def rays(positions: np.ndarray, triangles: np.ndarray, count: int = 20000) -> tuple[np.ndarray, np.ndarray]:
    """Return rays about the triangles: half of them towards points of some, a tenth from within tubes."""
    rng = np.random.default_rng(3)
    low, high = positions.min(0), positions.max(0)
    origin = rng.uniform(low - 0.5, high + 0.5, (count, 3))
    direction = rng.normal(size=(count, 3)) * rng.uniform(0.1, 3.0, (count, 1))
    corners = positions[triangles[rng.integers(0, len(triangles), count)]].astype(np.float64)
    targets = np.einsum("nk,nkc->nc", rng.dirichlet((0.3, 0.3, 0.3), count), corners)
    direction[::2] = (targets - origin)[::2]
    # Between a vertex and one across: about the axis.
    origin[::10] = corners[::10].mean(1)
    return origin.astype(np.float32), direction.astype(np.float32)


class Pair:
    """The same triangles with tubes as items and without."""

    def __init__(self, positions: np.ndarray, triangles: np.ndarray, device: str, **options: bool):
        self.device, self.triangles = device, triangles
        self.points = wp.array(positions, dtype=wp.vec3, device=device)
        self.indices = wp.array(triangles.ravel(), dtype=int, device=device)
        self.wide = build_wide(self.points, self.indices, **options)
        self.alone = build_wide(self.points, self.indices, opaque=False)

    def follow(self, wide: WideBvh, origin: np.ndarray, direction: np.ndarray) -> list[np.ndarray]:
        """Return what closest_wide does, whether rays are blocked, and the face that blocks."""
        count = len(origin)
        given = [wp.array(each, dtype=wp.vec3, device=self.device) for each in (origin, direction)]
        outputs = [wp.zeros(count, dtype=kind, device=self.device) for kind in (wp.vec4, int, int)]
        wp.launch(follow, count, [wide.nodes, wide.triangles, int(wide.tubes), *given], outputs, device=self.device)
        return [output.numpy() for output in outputs]

    def check(self, origin: np.ndarray, direction: np.ndarray, least: float = 0.3) -> None:
        """Demand the same hits, but in a thousandth, where crooked tubes are entered more than once.

        Faces at the same distance may take each other's place: of a tube that lies in a plane all are.
        """
        found, blocked, face = self.follow(self.wide, origin, direction)
        expected, _, _ = self.follow(self.alone, origin, direction)
        ours, theirs = (each[:, 3].view(np.int32) for each in (found, expected))
        assert (theirs >= 0).mean() > least
        np.testing.assert_array_equal(ours >= 0, theirs >= 0)
        same = ours == theirs
        assert (~np.isclose(found[:, 0], expected[:, 0], rtol=1e-5)).mean() < 1e-3
        np.testing.assert_array_equal(found[same], expected[same])
        np.testing.assert_array_equal(blocked == 1, theirs >= 0)
        np.testing.assert_array_equal(face >= 0, theirs >= 0)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("offset", [0.0, 300.0])
@pytest.mark.parametrize("wild", [0.0, 0.15, 0.6])
def test_hits_are_those_of_triangles(device: str, wild: float, offset: float, mirrored: bool) -> None:
    """Find what is found without tubes: straight, bent and crooked ones, far out, and in a mirror."""
    positions, triangles = tubes(strands(wild=wild), offset, mirrored)
    pair = Pair(positions, triangles, device)
    assert pair.wide.tubes and not pair.alone.tubes
    assert pair.wide.references < len(triangles) / 6
    pair.check(*rays(positions, triangles))


def test_rays_along_strands(device: str) -> None:
    """Find the same along the axes of straight tubes, in front of them and within."""
    made = strands(wild=0.0)
    positions, triangles = tubes(made)
    ends = made.points.reshape(60, 6, 3)
    way = np.repeat(ends[:, 5] - ends[:, 0], 50, axis=0)
    rng = np.random.default_rng(5)
    origin = np.repeat(ends[:, 0], 50, axis=0) + way * rng.uniform(-0.5, 0.5, (3000, 1)) + rng.normal(
        0, 0.006, (3000, 3))
    Pair(positions, triangles, device).check(
        origin.astype(np.float32), way + rng.normal(0, 0.01, (3000, 3)).astype(np.float32))


def test_what_counts_as_a_tube(device: str) -> None:
    """Find every piece of a strand, tips too, and none in other meshes, short pieces and what isn't finite."""
    made = strands(40, 5)
    hair = make_tubes(made, 1)
    def found(positions: np.ndarray, triangles: np.ndarray):
        return find_tubes(wp.array(positions, dtype=wp.vec3, device=device),
                          wp.array(triangles.ravel(), dtype=int, device=device))

    every = found(hair.positions, hair.triangles)
    # Half of the strands end in a point: six triangles instead of twelve.
    assert len(every.heads) == 160 and len(every.others) == 0
    assert sorted(set(every.faces.tolist())) == [6, 12] and every.faces.sum() == len(hair.triangles)
    wide = make_tubes(Strands(made.points, made.radii + 1.0, made.counts), 1)
    assert found(wide.positions, wide.triangles) is None
    turned = hair.triangles.copy()
    turned[:, [0, 1]] = turned[:, [1, 0]]
    assert found(hair.positions, turned) is None
    broken = hair.positions.copy()
    broken[: 6 * 5] = np.nan
    left = found(broken, hair.triangles)
    assert len(left.heads) == 156 and len(left.others) == len(hair.triangles) - left.faces.sum() > 0
    # Each listed twice: whatever is chosen, no triangle is in two.
    twice = np.repeat(hair.triangles[:12], 2, axis=0)
    assert found(hair.positions, np.concatenate([twice, hair.triangles])).faces.sum() <= len(hair.triangles)


def test_tubes_are_taken_out(device: str) -> None:
    """Leave nothing of instances that are gone, and all of the others."""
    positions, triangles = tubes()
    pair = Pair(positions, triangles, device)
    owner = np.arange(len(triangles)) // 12 % 3
    # A tube is of one instance.
    heads = find_tubes(pair.points, pair.indices)
    for head, size in zip(heads.heads, heads.faces, strict=True):
        owner[head : head + size] = owner[head]
    faces = wp.array(np.stack([owner, np.arange(len(triangles))], 1).astype(np.int32), dtype=wp.vec2i, device=device)
    leaving = wp.array(np.array([0, 1, 0], np.int32), dtype=int, device=device)
    for wide in (pair.wide, pair.alone):
        wide.take_out(faces, leaving)
    pair.check(*rays(positions, triangles), least=0.2)


@pytest.mark.parametrize("how", ["bent", "flat", "broken"])
def test_deformed_tubes(device: str, how: str) -> None:
    """Follow vertices that move: far, into a plane, and to where nothing is."""
    positions, triangles = tubes()
    pair = Pair(positions, triangles, device, deforming=True)
    rng = np.random.default_rng(8)
    moved = positions + rng.normal(0, 0.05, positions.shape).astype(np.float32)
    if how == "flat":
        moved[:, 2] = 0.3
    if how == "broken":
        moved = positions.copy()
        moved[::6 * 40] = np.nan
    points = wp.array(moved, dtype=wp.vec3, device=device)
    for wide in (pair.wide, pair.alone):
        wp.launch(place_triangles, wide.references, [points, pair.indices, wide.parts], [wide.triangles], device=device)
        wide.refit()
    origin, direction = rays(positions, triangles)
    if how != "broken":
        pair.check(origin, direction, least=0.2)
        return
    found, _, _ = pair.follow(pair.wide, origin, direction)
    expected, _, _ = pair.follow(pair.alone, origin, direction)
    ours, theirs = (each[:, 3].view(np.int32) for each in (found, expected))
    # A tube goes with any of its vertices, of triangles those that have it.
    assert np.isfinite(found[:, 0]).all() and (ours >= 0).mean() > 0.3
    assert ((ours == theirs) | (theirs >= 0)).mean() > 0.999 and (ours == theirs).mean() > 0.9


def test_forests_of_tubes(device: str) -> None:
    """Build trees for several meshes at once, with tubes and without."""
    parts = [tubes(strands(20, seed=seed)) for seed in (1, 2)]
    soup = np.random.default_rng(4).normal(size=(90, 3)).astype(np.float32)
    parts.insert(1, (soup, np.arange(90, dtype=np.int32).reshape(-1, 3)))
    starts = np.cumsum([0, *(len(positions) for positions, _ in parts)])
    points = wp.array(np.concatenate([positions for positions, _ in parts]), dtype=wp.vec3, device=device)
    indices = np.concatenate([triangles + start for (_, triangles), start in zip(parts, starts, strict=False)])
    indices = wp.array(indices.ravel().astype(np.int32), dtype=int, device=device)
    forest = build_forest(points, indices, np.array([len(triangles) for _, triangles in parts]))
    assert forest.tubes
    first = 0
    for root, (positions, triangles) in enumerate(parts):
        pair = Pair(positions, triangles, device)
        origin, direction = rays(positions, triangles, 4000)
        expected = pair.follow(pair.alone, origin, direction)[0]
        # The tree of a mesh begins at its root, which is put first.
        words = forest.nodes.numpy().reshape(-1, 20).copy()
        nodes = np.concatenate([words[root : root + 1], words])
        nodes[:, 4] += 1
        moved = WideBvh(wp.array(nodes.ravel(), dtype=wp.uint32, device=device), forest.triangles, [], 0,
                        forest.wholes, tubes=True)
        found = pair.follow(moved, origin, direction)[0]
        ours, theirs = (each[:, 3].view(np.int32) for each in (found, expected))
        np.testing.assert_array_equal(ours >= 0, theirs >= 0)
        same = (ours >= 0) & (ours - first == theirs)
        assert same.sum() > 0.998 * (theirs >= 0).sum() > 100
        np.testing.assert_array_equal(found[same, :3], expected[same, :3])
        first += len(triangles)
