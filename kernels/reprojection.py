# SPDX-License-Identifier: GPL-3.0-or-later
"""Where each pixel's surface was in the frame before, and how passes read their history there."""

from __future__ import annotations

import warp as wp


@wp.struct
class Reprojection:
    """One entry a pixel, made by reproject.py."""

    position: wp.array[wp.vec2]
    """Film-local position [px] in the frame before of this pixel's centre, jitter left out: the pixel (i, j) has its
    centre at (i + 0.5, j + 0.5)"""
    taps: wp.array[wp.uint8]
    """Bits 0..3: which of the 2x2 pixels around `position` show the same surface, in the order (0, 0), (1, 0),
    (0, 1), (1, 1) from floor(position - 0.5); none: the surface has just come into view. MOVED, VEILED"""


# Reprojection.taps of a surface that has moved itself, since the frame before.
MOVED = wp.constant(wp.uint8(1 << 4))

# The same where the pixel shows one of several surfaces by chance (SURFACE_VEILED) and lay in the picture: it may have
# shown another one, of which its mean colour is a part too.
VEILED = wp.constant(wp.uint8(1 << 5))


@wp.func
def known_taps(reprojection: Reprojection, pixel: int) -> wp.uint8:
    """Return the bits of the taps that show a pixel's surface."""
    return reprojection.taps[pixel] & (MOVED - wp.uint8(1))


@wp.func
def has_moved(taps: wp.uint8) -> bool:
    """Return whether a pixel's surface has moved itself, by its entry of Reprojection.taps."""
    return (taps & MOVED) != wp.uint8(0)


@wp.func
def has_tap(taps: wp.uint8, tap: int) -> bool:
    """Return whether tap 0..3 shows the same surface."""
    return ((int(taps) >> tap) & 1) == 1


@wp.func
def tap_weight(position: wp.vec2, tap: int) -> float:
    """Return the bilinear weight of tap 0..3; the four sum to 1."""
    x = position[0] - 0.5 - wp.floor(position[0] - 0.5)
    y = position[1] - 0.5 - wp.floor(position[1] - 0.5)
    if (tap & 1) == 0:
        x = 1.0 - x
    if (tap & 2) == 0:
        y = 1.0 - y
    return x * y


@wp.func
def tap_pixel(position: wp.vec2, tap: int, width: int) -> int:
    """Return the pixel of tap 0..3 in the frame before; only valid for taps whose bit is set."""
    i = int(wp.floor(position[0] - 0.5)) + (tap & 1)
    j = int(wp.floor(position[1] - 0.5)) + (tap >> 1)
    return j * width + i
