# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of debug views: numbers, signed numbers and identities as scene-linear colours in 0..1."""

from __future__ import annotations

import warp as wp


@wp.func
def ramp_node(i: int) -> wp.vec3:
    """Return a node of the heat ramp: equal steps of CIE lightness, from black over blue, red and yellow to white."""
    c = wp.vec3(0.0, 0.0, 0.0)
    if i == 1:
        c = wp.vec3(0.020, 0.008, 0.280)
    if i == 2:
        c = wp.vec3(0.300, 0.012, 0.560)
    if i == 3:
        c = wp.vec3(0.800, 0.075, 0.170)
    if i == 4:
        c = wp.vec3(0.950, 0.330, 0.020)
    if i == 5:
        c = wp.vec3(0.950, 0.780, 0.120)
    if i >= 6:
        c = wp.vec3(1.0, 1.0, 1.0)
    return c


@wp.func
def heat(x: float) -> wp.vec3:
    """Return the colour of a number in 0..1 (clamped; NaN as 0): the larger the lighter."""
    clamped = float(0.0)
    # A comparison with NaN is false.
    if x > 0.0:
        clamped = wp.min(x, 1.0) * 6.0
    i = wp.min(int(clamped), 5)
    return wp.lerp(ramp_node(i), ramp_node(i + 1), clamped - float(i))


@wp.func
def signed_color(x: float) -> wp.vec3:
    """Return the colour of a number in -1..1: blue below, red above, white at 0; darker outwards."""
    c = wp.vec3(1.0, 1.0, 1.0)
    if x > 0.0:
        c = wp.lerp(c, wp.vec3(0.55, 0.01, 0.02), wp.min(x, 1.0))
    if x < 0.0:
        c = wp.lerp(c, wp.vec3(0.01, 0.06, 0.55), wp.min(-x, 1.0))
    return c


@wp.func
def hash_color(id: int) -> wp.vec3:
    """Return a saturated colour for an identity, neighbours far apart; negative identities (nothing) are black."""
    if id < 0:
        return wp.vec3(0.0, 0.0, 0.0)
    # Two rounds of multiply and xor-shift: enough for colours.
    h = wp.uint32(id) * wp.uint32(747796405) + wp.uint32(1013904223)
    h = (h ^ (h >> wp.uint32(16))) * wp.uint32(73244475)
    h = (h ^ (h >> wp.uint32(15))) * wp.uint32(73244475)
    h = h ^ (h >> wp.uint32(16))
    hue = float(h & wp.uint32(4095)) / 4096.0 * 6.0
    low = 0.02 + 0.2 * float((h >> wp.uint32(12)) & wp.uint32(255)) / 255.0
    high = 0.3 + 0.7 * float((h >> wp.uint32(20)) & wp.uint32(255)) / 255.0
    r = wp.clamp(wp.abs(hue - 3.0) - 1.0, 0.0, 1.0)
    g = wp.clamp(2.0 - wp.abs(hue - 2.0), 0.0, 1.0)
    b = wp.clamp(2.0 - wp.abs(hue - 4.0), 0.0, 1.0)
    return wp.vec3(wp.lerp(low, high, r), wp.lerp(low, high, g), wp.lerp(low, high, b))
