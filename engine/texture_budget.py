# SPDX-License-Identifier: GPL-3.0-or-later
"""How large each image may be: halves the largest until all fit the memory and the limits of the device arrays."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

from .texels import TEXEL_BYTES

__all__ = ["SIDE_MAX", "TEXELS_MAX", "TextureSize", "fit"]

SIDE_MAX = 65536
"""Longest side of a texture [px]"""
TEXELS_MAX = (1 << 31) - 1
"""Texels of one size in bytes: what a Warp array can index"""


@dataclass
class TextureSize:
    """What an image costs, and how often it is halved."""

    width: int
    height: int
    texel_bytes: int
    halvings: int = 0
    side: int = 0
    """Side that a limit of sides is about, of a picture made of several [px]; 0 for the longest"""

    def shape(self) -> tuple[int, int]:
        """Return width and height of what is kept [px]."""
        return max(self.width >> self.halvings, 1), max(self.height >> self.halvings, 1)

    def texels(self) -> int:
        """Return the texels of all levels that are kept."""
        width, height = self.shape()
        total = width * height
        while max(width, height) > 1:
            width, height = max(width // 2, 1), max(height // 2, 1)
            total += width * height
        return total

    def bytes(self) -> int:
        """Return the memory of all levels that are kept."""
        return self.texels() * self.texel_bytes


def _halve_largest(sizes: list[TextureSize], allowed: int) -> None:
    """Halve the costliest image until the sum is at most `allowed` bytes or all are single texels."""
    total = sum(size.bytes() for size in sizes)
    heap = [(-size.bytes(), i) for i, size in enumerate(sizes)]
    heapq.heapify(heap)
    while total > allowed and heap:
        cost, i = heapq.heappop(heap)
        if sizes[i].shape() == (1, 1):
            continue
        sizes[i].halvings += 1
        total += cost + sizes[i].bytes()
        heapq.heappush(heap, (-sizes[i].bytes(), i))


def fit(sizes: list[TextureSize], budget: int, side_limit: int = 0) -> None:
    """Raise `halvings` until every side, the sum of bytes and the texels of each format fit.

    Args:
        sizes: All images.
        budget: Bytes.
        side_limit: Longest side allowed [px]; 0 for SIDE_MAX.
    """
    limit = min(side_limit or SIDE_MAX, SIDE_MAX)
    for size in sizes:
        while max(size.shape()) > SIDE_MAX or (size.side >> size.halvings or max(size.shape())) > limit:
            size.halvings += 1
    _halve_largest(sizes, budget)
    for texel_bytes in sorted(set(TEXEL_BYTES.values())):
        alike = [size for size in sizes if size.texel_bytes == texel_bytes]
        _halve_largest(alike, TEXELS_MAX * texel_bytes)
