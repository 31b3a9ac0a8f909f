# SPDX-License-Identifier: GPL-3.0-or-later
"""A binary tree over all lights that have a place, by which near and strong ones are chosen more often.

After Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting" (2018), without
orientation cones and splitting. The lights are sorted along a Morton curve and paired up level by level, so a
light's place in the order is also its way down the tree, and building takes a few operations on whole arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["LightTree", "build_light_tree"]


@dataclass
class LightTree:
    """Nodes as a heap: node 1 is the root, node k has the children 2 k and 2 k + 1; L leaves, a power of two."""

    low: np.ndarray
    """float32 [2 L, 4]: lower bounds; the least squared distance that counts"""
    high: np.ndarray
    """float32 [2 L, 4]: upper bounds; the share of all power, 0 for padding"""
    entries: np.ndarray
    """int32 [L]: light per leaf, -1 for padding"""
    places: np.ndarray
    """int32 [N]: leaf per light"""
    levels: int
    """log2(L)"""


def _spread_bits(values: np.ndarray) -> np.ndarray:
    """Put two zero bits between the lowest 20 bits of each value."""
    x = values.astype(np.uint64) & np.uint64(0xFFFFF)
    for shift, mask in (
        (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x


def build_light_tree(low: np.ndarray, high: np.ndarray, power: np.ndarray) -> LightTree:
    """Build the tree.

    Args:
        low: float [N, 3], lower bounds of the lights, relative to the scene's origin.
        high: float [N, 3], upper bounds.
        power: float [N], finite, not negative [W].
    """
    # Of triangles too far away for float32.
    low, high = (np.clip(np.nan_to_num(np.asarray(bounds, np.float64)), -1e30, 1e30) for bounds in (low, high))
    count = len(power)
    levels = max(int(np.ceil(np.log2(max(count, 1)))), 0)
    leaves = 1 << levels
    center = 0.5 * (np.asarray(low, np.float64) + high)
    # Cubes: lights in a plane would else be sorted by rounding errors across it first. Rounded to the nearest, so that
    # lights in the midst of each other stay in their order however the scene is scaled.
    offset = center - center.min(0, initial=np.inf)
    cells = np.minimum(np.rint(offset / offset.max(initial=1e-30) * (1 << 20)), (1 << 20) - 1)
    code = sum(_spread_bits(cells[:, axis]) << np.uint64(axis) for axis in range(3))
    order = np.argsort(code, kind="stable")
    bounds_low = np.full((2 * leaves, 3), np.inf)
    bounds_high = np.full((2 * leaves, 3), -np.inf)
    total = np.zeros(2 * leaves)
    bounds_low[leaves : leaves + count] = np.asarray(low)[order]
    bounds_high[leaves : leaves + count] = np.asarray(high)[order]
    total[leaves : leaves + count] = np.asarray(power)[order]
    inside = np.zeros(2 * leaves)
    inside[leaves : leaves + count] = 1.0
    for level in range(levels - 1, -1, -1):
        nodes = slice(1 << level, 2 << level)
        children = slice(2 << level, 4 << level)
        bounds_low[nodes] = bounds_low[children].reshape(-1, 2, 3).min(1)
        bounds_high[nodes] = bounds_high[children].reshape(-1, 2, 3).max(1)
        total[nodes] = total[children].reshape(-1, 2).sum(1)
        inside[nodes] = inside[children].reshape(-1, 2).sum(1)
    empty = ~np.isfinite(bounds_low).all(1)
    bounds_low[empty] = bounds_high[empty] = 0.0
    # Among n lights in a ball of radius r the nearest is about r / n^(1/3) away.
    nearest = 0.25 * ((bounds_high - bounds_low) ** 2).sum(1) / np.maximum(inside, 1.0) ** (2.0 / 3.0)
    nearest = np.minimum(nearest, np.finfo(np.float32).max)
    share = total / (total[1] if total[1] > 0 else 1.0)
    entries = np.full(leaves, -1, np.int32)
    entries[:count] = order
    places = np.empty(count, np.int32)
    places[order] = np.arange(count, dtype=np.int32)
    return LightTree(
        np.concatenate([bounds_low, nearest[:, None]], 1).astype(np.float32),
        np.concatenate([bounds_high, share[:, None]], 1).astype(np.float32), entries, places, levels)
