# SPDX-License-Identifier: GPL-3.0-or-later
"""The 8-wide BVH: the same hits as Warp's own structure, boxes that hold their triangles, no gaps between triangles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from burnish.engine import wide_bvh
from burnish.engine.wide_bvh import WideBvh, build_wide
from burnish.kernels.wide_bvh import any_wide, closest_wide

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

FAR = 1e30


@wp.kernel
def follow(
    # In:
    nodes: wp.array[wp.uint32],
    triangles: wp.array[wp.uint32],
    mesh: wp.uint64,
    origin: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    t_max: float,
    # Out:
    wide_out: wp.array[wp.vec4],
    mesh_out: wp.array[wp.vec4],
    blocked_out: wp.array[int],
):
    """Follow rays through both structures."""
    i = wp.tid()
    wide_out[i] = closest_wide(nodes, triangles, origin[i], direction[i], t_max)
    blocked_out[i] = int(any_wide(nodes, triangles, origin[i], direction[i], t_max))
    query = wp.mesh_query_ray(mesh, origin[i], direction[i], t_max)
    mesh_out[i] = wp.vec4(t_max, 0.0, 0.0, wp.cast(-1, float))
    if query.result:
        mesh_out[i] = wp.vec4(query.t, query.u, query.v, wp.cast(query.face, float))


class Both:
    """Triangles [N, 3, 3] in both structures."""

    def __init__(self, corners: np.ndarray, device: str):
        self.device, self.corners = device, np.asarray(corners, np.float32)
        self.points = wp.array(self.corners.reshape(-1, 3), dtype=wp.vec3, device=device)
        self.indices = wp.array(np.arange(3 * len(corners)), dtype=int, device=device)
        self.mesh = wp.Mesh(self.points, self.indices, bvh_constructor="sah", bvh_leaf_size=1)
        self.wide: WideBvh = build_wide(self.points, self.indices)

    def follow(self, origin: np.ndarray, direction: np.ndarray, t_max: float = FAR) -> tuple[np.ndarray, ...]:
        """Return t, weights and faces of the wide structure, the same of wp.Mesh, and what any_wide says."""
        count = len(origin)
        rays = [wp.array(np.asarray(v, np.float32), dtype=wp.vec3, device=self.device) for v in (origin, direction)]
        outputs = [wp.zeros(count, dtype=kind, device=self.device) for kind in (wp.vec4, wp.vec4, int)]
        wp.launch(follow, count, [self.wide.nodes, self.wide.triangles, self.mesh.id, *rays, t_max], outputs,
                  device=self.device)
        wide, mesh, blocked = (output.numpy() for output in outputs)
        return (wide[:, :3], np.ascontiguousarray(wide[:, 3]).view(np.int32), mesh[:, :3],
                np.ascontiguousarray(mesh[:, 3]).view(np.int32), blocked == 1)


def soup(count: int, seed: int = 0, offset: float = 0.0) -> np.ndarray:
    """Return random triangles, a tenth of them large slivers."""
    rng = np.random.default_rng(seed)
    size = np.where(rng.random((count, 1, 1)) < 0.1, 4.0, 0.2)
    return rng.random((count, 1, 3)) * 10 + rng.normal(size=(count, 3, 3)) * size * rng.random((count, 1, 3)) + offset


def slivers(count: int, seed: int = 0, offset: float = 0.0) -> np.ndarray:
    """Return long thin triangles in all directions, a tenth of them without width."""
    rng = np.random.default_rng(seed)
    first = rng.random((count, 3)) * 10
    along = rng.normal(size=(count, 3)) * rng.random((count, 1)) * 4
    width = np.where(rng.random((count, 1)) < 0.1, 0.0, 0.05)
    return np.stack([first, first + along, first + 0.6 * along + width * rng.normal(size=(count, 3))], 1) + offset


def directions(count: int, seed: int = 1) -> np.ndarray:
    """Return random unit vectors, some of them along axes and coordinate planes."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors[::7, 0] = 0.0
    vectors[::11, 1:] = 0.0
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


def faces_of(wide: WideBvh) -> np.ndarray:
    """Return the faces in the order of the leaves."""
    return wide.triangles.numpy().reshape(-1, 12)[:, 3].astype(np.int64)


def decoded(wide: WideBvh) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Return, for every leaf, its references and the box that its parent keeps; nodes are reached from the root."""
    words = wide.nodes.numpy().reshape(-1, 20)
    found, waiting = [], [0]
    while waiting:
        node = words[waiting.pop()]
        origin = node[:3].copy().view(np.float32).astype(np.float64)
        exponents = node[3:4].copy().view(np.uint8)
        spacing = np.exp2(exponents[:3].astype(float) - 127)
        meta = node[6:8].copy().view(np.uint8)
        planes = node[8:20].copy().view(np.uint8).reshape(6, 8)
        child = int(node[4])
        for slot in range(8):
            if exponents[3] >> slot & 1:
                # 0: nothing is left of it.
                assert meta[slot] in (0, 0x20 + 24 + slot)
                if meta[slot]:
                    waiting.append(child)
                child += 1
            elif meta[slot]:
                low, high = (origin + planes[rows, slot] * spacing for rows in (slice(0, 3), slice(3, 6)))
                first = int(node[5]) + int(meta[slot] & 31)
                found += [(first + k, low, high) for k in range(3) if meta[slot] >> (5 + k) & 1]
    return found


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (5000.0, 1.0), (1e4, 1.0), (0.0, 1e-3), (0.0, 1e3)])
def test_closest_hits_are_those_of_warp(device: str, offset: float, scale: float) -> None:
    """Find the same faces at the same places, near the origin and far from it, in small and large scenes."""
    both = Both(soup(3000) * scale + offset, device)
    origin = (np.random.default_rng(2).random((6000, 3)) * 14 - 2) * scale + offset
    wide, face, mesh, mesh_face, blocked = both.follow(origin, directions(6000))
    assert 0.5 < (mesh_face >= 0).mean() < 1.0
    same = face == mesh_face
    assert same.mean() > (0.995 if offset else 0.9999)
    # Where faces differ, both lie at the same distance but for rounding.
    np.testing.assert_allclose(wide[:, 0], mesh[:, 0], rtol=1e-3, atol=2e-2 if offset else 1e-4 * scale)
    np.testing.assert_allclose(wide[same], mesh[same], rtol=1e-3, atol=0.2 if offset else 2e-3)
    np.testing.assert_array_equal(blocked, face >= 0)


def test_of_equally_near_triangles_the_first_is_hit(device: str) -> None:
    """Hit the lowest face of several in one place, whatever the order of the tree."""
    rng = np.random.default_rng(5)
    several = np.tile(soup(400), (4, 1, 1))
    both = Both(several, device)
    origin = rng.random((2000, 3)) * 10
    _, face, _, mesh_face, _ = both.follow(origin, directions(2000))
    assert (face >= 0).mean() > 0.2
    assert (face < 400).all()
    np.testing.assert_array_equal(face, np.where(mesh_face >= 0, mesh_face % 400, -1))
    shuffled = np.concatenate([soup(400)[rng.permutation(400)], several])
    _, found, _, _, _ = Both(shuffled, device).follow(origin, directions(2000))
    assert (found < 400).all()


def test_distance_limits_both_queries(device: str) -> None:
    """Ignore what lies beyond t_max."""
    both = Both(soup(2000), device)
    origin, direction = np.random.default_rng(2).random((4000, 3)) * 10, directions(4000)
    distance = both.follow(origin, direction)[0][:, 0]
    limit = float(np.median(distance[distance < FAR]))
    wide, face, _, _, blocked = both.follow(origin, direction, limit)
    np.testing.assert_array_equal(face >= 0, distance < limit)
    np.testing.assert_array_equal(blocked, distance < limit)
    assert (wide[face < 0, 0] == np.float32(limit)).all()


@pytest.fixture
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Split triangles whether it pays or not."""
    monkeypatch.setattr(wide_bvh, "SPLIT_AREA", 1.0)


def check_boxes(both: Both, kept: np.ndarray) -> None:
    """Check that leaves name the triangles `kept`, no reference twice, and that their boxes hold all of each."""
    leaves, faces = decoded(both.wide), faces_of(both.wide)
    references = [reference for reference, _, _ in leaves]
    assert len(set(references)) == len(references)
    owner = faces[references]
    np.testing.assert_array_equal(np.unique(owner), kept)
    low, high = (np.array([leaf[k] for leaf in leaves]) for k in (1, 2))
    # Corners, edges and the inside: some box holds each point.
    v, u = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9))
    u, v = u[u + v <= 1], v[u + v <= 1]
    for face in kept.tolist():
        a, b, c = both.corners[face].astype(np.float64)
        points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
        boxes = np.flatnonzero(owner == face)
        inside = (points[:, None] > low[boxes]) & (points[:, None] < high[boxes])
        assert inside.all(2).any(1).all()


@pytest.mark.usefixtures("eager")
@pytest.mark.parametrize("offset", [0.0, 5000.0])
@pytest.mark.parametrize("make", [soup, slivers])
def test_boxes_hold_their_triangles(device: str, make: Callable[..., np.ndarray], offset: float) -> None:
    """Keep every reference in exactly one leaf, and each triangle within the boxes of its references."""
    check_boxes(Both(make(1500, offset=offset), device), np.arange(1500))


@pytest.mark.slow
@pytest.mark.usefixtures("eager")
@pytest.mark.parametrize("offset", [0.0, 5000.0])
@pytest.mark.parametrize("make", [soup, slivers])
def test_splitting_changes_no_hit(
    device: str, make: Callable[..., np.ndarray], offset: float, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Find bit for bit what is found without splitting, with a bounded number of references."""
    count = 3000
    split = Both(make(count, offset=offset), device)
    references = len(faces_of(split.wide))
    assert count < references <= count * (1 + wide_bvh.SPLIT_SHARE)
    monkeypatch.setattr(wide_bvh, "SPLIT_SHARE", 0.0)
    usual = Both(make(count, offset=offset), device)
    assert len(faces_of(usual.wide)) == count
    rng = np.random.default_rng(2)
    # Half of them towards points of triangles, over whose edges and the planes between parts they may not slip.
    origin, direction = rng.random((20000, 3)) * 14 - 2 + offset, directions(20000)
    weights = rng.dirichlet((0.3, 0.3, 0.3), 10000)
    targets = np.einsum("nk,nkc->nc", weights, split.corners[rng.integers(0, count, 10000)].astype(np.float64))
    direction[:10000] = targets - origin[:10000]
    found, face, _, _, blocked = split.follow(origin, direction)
    expected, expected_face, _, _, expected_blocked = usual.follow(origin, direction)
    assert 0.3 < (face >= 0).mean() < 1.0
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(face, expected_face)
    np.testing.assert_array_equal(blocked, expected_blocked)


def test_splitting_shrinks_boxes(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give slanted slivers smaller boxes: more than half of their area goes, by at most 30 % more references."""
    def area(both: Both) -> float:
        low, high = (np.array([leaf[k] for leaf in decoded(both.wide)]) for k in (1, 2))
        x, y, z = (high - low).T
        return float((x * y + y * z + z * x).sum())

    monkeypatch.setattr(wide_bvh, "SPLIT_SHARE", 0.3)
    few = np.concatenate([slivers(200, seed=3), soup(2000) * 0.01])
    split = area(Both(few, device))
    monkeypatch.setattr(wide_bvh, "SPLIT_SHARE", 0.0)
    assert split < 0.5 * area(Both(few, device))


def test_triangles_are_split_where_it_pays(device: str) -> None:
    """Leave a soup of round triangles whole, and one with some slivers, but not slivers."""
    for made, references in ((soup(1500), 1500), (np.concatenate([soup(1500), slivers(50)]), 1550)):
        both = Both(made, device)
        assert len(faces_of(both.wide)) == references and not both.wide.split
    both = Both(slivers(1500), device)
    assert len(faces_of(both.wide)) > 1500 and both.wide.split


@pytest.mark.usefixtures("eager")
def test_equal_triangles_are_split_within_the_budget(device: str) -> None:
    """Split some of many equal slats: none is not an answer to a budget too small for all."""
    slat = np.array([[[0.0, 0.0, 0.0], [3.0, 3.0, 3.0], [3.0, 3.1, 3.0]]])
    both = Both(slat + np.arange(1000)[:, None, None] * np.array([0.01, 0.0, 0.0]), device)
    assert 1100 < len(faces_of(both.wide)) <= 1300


def test_no_ray_slips_between_triangles(device: str) -> None:
    """Hit a closed surface from within along every vertex, edge and many points of edges."""
    side = 24
    u, v = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1), indexing="ij")
    a, b, c, d = (np.stack([u, v], -1)[s] for s in (np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:]))
    flat = np.concatenate([np.stack(t, 2).reshape(-1, 3, 2) for t in ((a, b, c), (a, c, d))])
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            faces.append(np.insert(flat, axis, sign, axis=2))
    cube = np.concatenate(faces)
    sphere = (cube / np.linalg.norm(cube, axis=2, keepdims=True)).astype(np.float32)
    share = np.linspace(0, 1, 9)[:, None, None]
    for corners in (cube.astype(np.float32), sphere):
        both = Both(corners + np.float32(3.7), device)
        targets = np.concatenate([
            ((1 - share) * corners[:, k] + share * corners[:, (k + 1) % 3]).reshape(-1, 3) for k in range(3)])
        for origin in ((0.0, 0.0, 0.0), (0.31, -0.17, 0.43)):
            direction = targets - np.float32(origin)
            start = np.broadcast_to(np.float32(origin) + np.float32(3.7), direction.shape)
            _, face, _, _, blocked = both.follow(start, direction)
            assert (face >= 0).all() and blocked.all()


@pytest.mark.parametrize("corners", [
    soup(1), soup(2), soup(9), np.repeat(soup(1), 300, axis=0), np.zeros((5, 3, 3)),
    np.insert(soup(200)[:, :, :2], 2, 1.0, axis=2),
], ids=["one", "two", "nine", "same", "points", "flat"])
def test_odd_meshes(device: str, corners: np.ndarray) -> None:
    """Build over few, equal, collapsed and coplanar triangles."""
    both = Both(corners, device)
    middle = corners.mean(1)
    origin = np.repeat(middle, 20, axis=0) + directions(20 * len(corners)) * 3
    wide, face, mesh, mesh_face, blocked = both.follow(origin, np.repeat(middle, 20, axis=0) - origin)
    np.testing.assert_array_equal(face >= 0, mesh_face >= 0)
    np.testing.assert_allclose(wide[:, 0], mesh[:, 0], rtol=1e-3)
    np.testing.assert_array_equal(blocked, face >= 0)


def test_triangles_that_are_not_finite_are_never_hit(device: str) -> None:
    """Build over broken triangles and find all others."""
    corners = soup(600).astype(np.float32)
    corners[::5, 1, 2] = np.nan
    corners[1::5, 0, 0] = np.inf
    corners[2::5] *= np.float32(1e25)
    both = Both(corners, device)
    assert sorted(set(faces_of(both.wide).tolist())) == list(range(600))
    alone = Both(corners[np.arange(600) % 5 > 2], device)
    origin, direction = np.random.default_rng(2).random((3000, 3)) * 10, directions(3000)
    wide, face, _, _, blocked = both.follow(origin, direction)
    expected, _, _, _, _ = alone.follow(origin, direction)
    assert (face >= 0).any() and (face[face >= 0] % 5 > 2).all()
    np.testing.assert_array_equal(wide[:, 0], expected[:, 0])
    np.testing.assert_array_equal(blocked, face >= 0)


@pytest.mark.usefixtures("eager")
@pytest.mark.parametrize("gone", [0.3, 0.9, 1.0])
@pytest.mark.parametrize("make", [soup, slivers])
def test_taken_out_triangles_are_gone(device: str, make: Callable[..., np.ndarray], gone: float) -> None:
    """Hit nothing of instances that left, all of the others, and shrink the boxes to these."""
    both = Both(make(2000), device)
    parts = len(decoded(both.wide))
    size = np.mean([(high - low).max() for _, low, high in decoded(both.wide)])
    origin, direction = np.random.default_rng(2).random((3000, 3)) * 10, directions(3000)
    rng = np.random.default_rng(6)
    owner = rng.integers(0, 50, 2000)
    faces = wp.array(np.stack([owner, np.arange(2000)], 1).astype(np.int32), dtype=wp.vec2i, device=device)
    before = both.follow(origin, direction)[1]
    leaving = np.zeros(50, np.int32)
    # In two steps: the second one finds boxes that were shrunk already.
    for share in (0.5 * gone, gone):
        leaving[: int(50 * share)] = 1
        both.wide.take_out(faces, wp.array(leaving, dtype=int, device=device))
    kept = leaving[owner] == 0
    assert (~kept[before[before >= 0]]).any()
    wide, face, _, _, blocked = both.follow(origin, direction)
    np.testing.assert_array_equal(blocked, face >= 0)
    left = decoded(both.wide)
    assert len(left) < parts
    if not kept.any():
        assert (face < 0).all() and not left
        return
    alone = Both(both.corners[kept], device)
    expected, expected_face, _, _, _ = alone.follow(origin, direction)
    np.testing.assert_array_equal(wide[:, 0], expected[:, 0])
    np.testing.assert_array_equal(face, np.where(expected_face >= 0, np.flatnonzero(kept)[expected_face], -1))
    check_boxes(both, np.flatnonzero(kept))
    # As tight as a leaf's grid is: parts of triangles don't grow to the whole.
    assert np.mean([(high - low).max() for _, low, high in left]) < 1.1 * size


def test_chains_of_growing_triangles_stay_shallow(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Build, in few rounds, over triangles each of which holds the one before, where neighbors never agree."""
    size = 1.01 ** np.arange(1500)[:, None, None]
    corners = np.array([[[1.0, 0.0, 0.1], [-0.5, 0.9, 0.0], [-0.5, -0.9, 0.0]]]) * size
    rounds = []
    find = wide_bvh.cluster_tree.find_neighbors
    launch = wp.launch
    monkeypatch.setattr(wp, "launch", lambda kernel, *rest, **more: (
        rounds.append(kernel) if kernel is find else None, launch(kernel, *rest, **more))[1])
    both = Both(corners, device)
    assert len(rounds) < wide_bvh.PATIENCE + 60
    assert len(both.wide.levels) <= wide_bvh.MAX_DEPTH
    _, face, _, mesh_face, _ = both.follow(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1e5]]),
                                           np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    np.testing.assert_array_equal(face, mesh_face)


@pytest.mark.parametrize("too_deep", [1, 2])
def test_trees_too_deep_are_built_otherwise(device: str, too_deep: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fall back to less patience, then to the tree of neighbors along the curve, with the same hits."""
    origin, direction = np.random.default_rng(2).random((1000, 3)) * 10, directions(1000)
    usual = Both(soup(1000), device)
    expected = usual.follow(origin, direction)[1]
    collapse, calls = wide_bvh._collapse, []

    def deep(tree: object, count: int) -> tuple:
        nodes, items, levels = collapse(tree, count)
        calls.append(len(levels))
        return nodes, items, levels if len(calls) > too_deep else [(0, 1)] * (wide_bvh.MAX_DEPTH + 1)

    monkeypatch.setattr(wide_bvh, "_collapse", deep)
    np.testing.assert_array_equal(Both(soup(1000), device).follow(origin, direction)[1], expected)
    assert len(calls) == too_deep + 1
