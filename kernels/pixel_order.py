# SPDX-License-Identifier: GPL-3.0-or-later
"""An order of a picture's pixels in which a warp's lie close together: blocks of 8 x 8, row by row in each. Functions.

Threads of a warp that follow neighbouring rays visit the same nodes, and run the same programs, for longer.
"""

from __future__ import annotations

import warp as wp

PIXEL_BLOCK = wp.constant(8)
"""Pixels a side"""


@wp.func
def place_in_blocks(index: int, width: int, count: int) -> int:
    """Return the pixel of thread `index` of as many threads as pixels: `count` of them in whole rows of `width`.

    Blocks of the last column and row are narrower.
    """
    strip = index // (PIXEL_BLOCK * width)
    rows = wp.min(count // width - strip * PIXEL_BLOCK, PIXEL_BLOCK)
    left = index - strip * PIXEL_BLOCK * width
    column = left // (PIXEL_BLOCK * rows)
    columns = wp.min(width - column * PIXEL_BLOCK, PIXEL_BLOCK)
    left = left - column * PIXEL_BLOCK * rows
    return (strip * PIXEL_BLOCK + left // columns) * width + column * PIXEL_BLOCK + left % columns


@wp.func
def pixel_in_blocks(index: int, width: int, height: int) -> int:
    """Return the pixel of a thread, -1 for those of the last column's and row's blocks that lie off the picture."""
    columns = (width + PIXEL_BLOCK - 1) // PIXEL_BLOCK
    block = index // (PIXEL_BLOCK * PIXEL_BLOCK)
    x = block % columns * PIXEL_BLOCK + index % PIXEL_BLOCK
    y = block // columns * PIXEL_BLOCK + index // PIXEL_BLOCK % PIXEL_BLOCK
    if x >= width or y >= height:
        return -1
    return y * width + x
