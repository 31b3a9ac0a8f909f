# SPDX-License-Identifier: GPL-3.0-or-later
"""The upper levels of a binary BVH are mended: the tree stays one, and its boxes become smaller."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine import tree_reinsertion
from burnish.engine.binary_tree import BinaryTree
from burnish.engine.tree_reinsertion import mend_upper_levels
from burnish.engine.wide_bvh import _cluster


def clustered(count: int, device: str) -> BinaryTree:
    """Return a tree of small boxes on the walls of a room, some of them long."""
    rng = np.random.default_rng(3)
    low = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
    low[np.arange(count), rng.integers(0, 3, count)] = 1.0
    size = (0.01 * rng.random((count, 3))).astype(np.float32)
    size[: count // 10, 0] = 1.5
    return _cluster(wp.array(low, dtype=wp.vec3, device=device), wp.array(low + size, dtype=wp.vec3, device=device),
                    16, 128)


def boxes(tree: BinaryTree) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return children, lower and upper corners."""
    return tree.children.numpy(), tree.lower.numpy(), tree.upper.numpy()


def area(tree: BinaryTree) -> float:
    """Return half the surface of all boxes."""
    _, lower, upper = boxes(tree)
    x, y, z = (upper.astype(np.float64) - lower).T
    return float((x * y + y * z + z * x).sum())


def check_tree(tree: BinaryTree, count: int) -> None:
    """Check that each item is a leaf once, that boxes are those of the children, and that those come first."""
    children, lower, upper = boxes(tree)
    leaves = children[:, 0] < 0
    assert sorted((-1 - children[leaves, 0]).tolist()) == list(range(count))
    pairs = children[~leaves]
    assert sorted(pairs.ravel().tolist()) == list(range(2 * count - 2))
    assert np.array_equal(lower[~leaves], lower[pairs].min(1)) and np.array_equal(upper[~leaves], upper[pairs].max(1))
    batch = np.repeat(np.arange(len(tree.batches)), [size for _, size in tree.batches])
    assert len(batch) == 2 * count - 1
    assert [first for first, _ in tree.batches] == np.cumsum([0] + [size for _, size in tree.batches])[:-1].tolist()
    assert (batch[pairs] < batch[~leaves, None]).all()


@pytest.mark.parametrize("count", [3, 40, 1500, 20000])
def test_tree_stays_one_and_gets_smaller(count, device):
    """Keep all items and the root's box, with smaller boxes below."""
    before = clustered(count, device)
    after = mend_upper_levels(before)
    check_tree(after, count)
    assert np.array_equal(boxes(after)[1][-1], boxes(before)[1][-1])
    assert area(after) <= area(before)
    if count > 100:
        assert area(after) < 0.97 * area(before)


def test_same_tree_each_time(device):
    """Make the same tree of the same boxes."""
    first, second = (mend_upper_levels(clustered(3000, device)) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(boxes(first), boxes(second), strict=True))


def test_equal_boxes(device):
    """Many nodes are as large as the smallest one that is mended: parents are among them first."""
    count = 5000
    low = wp.zeros(count, dtype=wp.vec3, device=device)
    tree = _cluster(low, wp.ones(count, dtype=wp.vec3, device=device), 16, 128)
    check_tree(mend_upper_levels(tree), count)


@pytest.mark.parametrize("count", [1, 2])
def test_nothing_to_mend(count, device):
    """Leave trees of a node or none alone."""
    tree = clustered(count, device)
    assert mend_upper_levels(tree) is tree


def test_boxes_without_end(device):
    """Leave trees alone whose boxes are not finite."""
    tree = clustered(100, device)
    upper = tree.upper.numpy()
    upper[-1] = np.inf
    tree.upper = wp.array(upper, dtype=wp.vec3, device=device)
    assert mend_upper_levels(tree) is tree


def test_few_nodes_are_enough(device, monkeypatch):
    """A sixteenth of the nodes brings most of what all of them do."""
    tree = clustered(16000, device)
    before, few = area(tree), area(mend_upper_levels(tree))
    monkeypatch.setattr(tree_reinsertion, "UPPER_NODES", 16000)
    assert before - few > 0.3 * (before - area(mend_upper_levels(tree)))
