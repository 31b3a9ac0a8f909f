# SPDX-License-Identifier: GPL-3.0-or-later
"""A binary tree of boxes, from which the wide BVH is made."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

__all__ = ["BinaryTree"]


@dataclass
class BinaryTree:
    """Binary trees, the root of a single one the last node: children, or (-1 - item, 1) for leaves, and boxes."""

    children: wp.array
    lower: wp.array
    upper: wp.array
    batches: list[tuple[int, int]]
    """First node and count, the leaves' first, children in batches before those of their parents"""
    roots: wp.array | None = None
    """int, of several trees"""
