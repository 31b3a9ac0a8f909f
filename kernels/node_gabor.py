# SPDX-License-Identifier: GPL-3.0-or-later
"""The node machine's Gabor noise: waves in random directions under Gaussians around random points.

The same numbers as Cycles 5.2's Gabor Texture: sparse convolution (Lagae et al. 2009) with a fixed number of impulses
a cell and random signs (Tavernier et al. 2019), kept as phasors for phase and intensity (Tricard et al. 2019).
"""

from __future__ import annotations

import warp as wp

from . import node_codes as codes
from .geometry_math import PI, TWO_PI, normalize_or
from .node_cells import as_floats, cell_offset, floor4, next_key, used
from .node_noise import hash_floats

__all__ = ["gabor"]

IMPULSES = wp.constant(8)
"""Waves a cell; a power of 2"""

HALF_RANGE_2D = wp.constant(6.0)
HALF_RANGE_3D = wp.constant(5.0453784915222870)
"""Six standard deviations of the noise: 6 * sqrt(IMPULSES / 2 * 1/4), and with 2 ** -2.5 for 1/4 in 3D"""


@wp.func
def impulse_random(dimensions: int, cell: wp.vec4, turn: int) -> float:
    """Return a number in 0..1 of a cell, whose last coordinate (z in 2D, w in 3D) is a seed.

    Further numbers of the same seed come from its coordinates in another order, `turn` 1 or 2.
    """
    if dimensions == 2:
        if turn == 0:
            return hash_floats(cell[0], cell[1], cell[2], 0.0, 3)
        return hash_floats(cell[2], cell[0], cell[1], 0.0, 3)
    v = cell
    if turn == 1:
        v = wp.vec4(cell[2], cell[0], cell[3], cell[1])
    if turn == 2:
        v = wp.vec4(cell[3], cell[2], cell[1], cell[0])
    return hash_floats(v[0], v[1], v[2], v[3], 4)


@wp.func
def seeded(dimensions: int, cell: wp.vec4, seed: int) -> wp.vec4:
    """Return a cell's coordinates followed by a seed."""
    if dimensions == 2:
        return wp.vec4(cell[0], cell[1], float(seed), 0.0)
    return wp.vec4(cell[0], cell[1], cell[2], float(seed))


@wp.func
def wave(dimensions: int, cell: wp.vec4, local: wp.vec4, impulse: int, frequency: float, angles: wp.vec3) -> wp.vec2:
    """Return the phasor of one impulse of a cell.

    Args:
        dimensions: 2 or 3.
        cell: The cell.
        local: The place, relative to the cell.
        impulse: Number of the impulse.
        frequency: Waves a cell.
        angles: Inclination and azimuth of the direction [rad], and the share that is random.
    """
    center = seeded(dimensions, cell, 3 * impulse + 1)
    x = local[0] - impulse_random(dimensions, center, 0)
    y = local[1] - impulse_random(dimensions, center, 1)
    z = float(0.0)
    if dimensions == 3:
        z = local[2] - impulse_random(dimensions, center, 2)
    square = x * x + y * y + z * z
    if square >= 1.0:
        return wp.vec2(0.0, 0.0)
    inclination = angles[0]
    azimuth = angles[1]
    if angles[2] > 0.0:
        turned = seeded(dimensions, cell, 3 * impulse)
        first = impulse_random(dimensions, turned, 0) * PI * angles[2]
        if dimensions == 2:
            azimuth += first - 0.5 * PI * angles[2]
        else:
            inclination += first
            azimuth += impulse_random(dimensions, turned, 1) * PI * angles[2]
    along = z * wp.cos(inclination) + wp.sin(inclination) * (x * wp.cos(azimuth) + y * wp.sin(azimuth))
    # A Hann window takes the Gaussian to 0 where it is cut off.
    height = wp.exp(-PI * square) * (0.5 + 0.5 * wp.cos(PI * square))
    if impulse_random(dimensions, seeded(dimensions, cell, 3 * impulse + 2), 0) < 0.5:
        height = -height
    phase = TWO_PI * frequency * along
    return wp.vec2(height * wp.cos(phase), height * wp.sin(phase))


@wp.func
def gabor(sub: int, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> wp.vec4:
    """Evaluate the Gabor Texture.

    Args:
        sub: codes.PROCEDURAL_GABOR and the code of the dimensions.
        a: Coordinate, scaled.
        b: frequency, anisotropy, direction in 2D [rad].
        c: Direction in 3D, of any length.

    Returns:
        value, phase and intensity, each 0..1 or nearly so.
    """
    dimensions = wp.where((sub & codes.GABOR_3D) != 0, 3, 2)
    frequency = wp.max(b[0], 0.001)
    angles = wp.vec3(0.5 * PI, b[2], 1.0 - wp.clamp(b[1], 0.0, 1.0))
    half_range = float(HALF_RANGE_2D)
    if dimensions == 3:
        half_range = HALF_RANGE_3D
        d = normalize_or(wp.vec3(c[0], c[1], c[2]), wp.vec3(0.0, 0.0, 1.0))
        angles[0] = wp.acos(d[2])
        angles[1] = wp.atan2(d[1], d[0])
    place = used(dimensions, a)
    corner = floor4(place)
    sum = wp.vec2(0.0, 0.0)
    key = int(0)
    n = int(0)
    while key < 1 << (3 * dimensions):
        offset = as_floats(cell_offset(dimensions, key, 1))
        sum += wave(dimensions, corner + offset, place - corner - offset, n & (IMPULSES - 1), frequency, angles)
        n += 1
        if (n & (IMPULSES - 1)) == 0:
            key = next_key(key, 1)
    value = 0.5 + 0.5 * sum[1] / half_range
    phase = (wp.atan2(sum[1], sum[0]) + PI) / TWO_PI
    return wp.vec4(value, phase, wp.length(sum) / half_range, 0.0)
