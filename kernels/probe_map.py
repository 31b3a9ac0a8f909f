# SPDX-License-Identifier: GPL-3.0-or-later
"""The probes' map of directions: the hemisphere in 8 x 8 cells of equal solid angle, and its spherical harmonics.

The map is Clarberg's equal-area square of the hemisphere, turned by 45 degrees (GI-1.0, section 3). Local directions
have z along the probe's normal, in the frame of `orthonormal_tangent`. Sums over cells use each cell's exact integral
of the basis: centres alone are 3 % off (sum of cosines 3.24 instead of pi).
"""

from __future__ import annotations

import warp as wp

from .geometry_math import TWO_PI, orthonormal_tangent, safe_sqrt
from .packing import sign_not_zero
from .probe_types import BANDS, CELLS, TILE

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

QUARTER_PI = wp.constant(0.78539816339745)

# Clamped cosine over pi, for l = 1 and 2 (for l = 0 it is 1).
COSINE_1 = wp.constant(0.66666667)
COSINE_2 = wp.constant(0.25)

# Cosine at which the correction along the normal has faded: the first zero of the harmonics of l = 4 (31 degrees).
CORRECTION_COSINE = wp.constant(0.861)

Bands = wp.types.vector(length=10, dtype=wp.float32)


@wp.func
def square_to_hemisphere(u: wp.vec2) -> wp.vec3:
    """Map the unit square to the hemisphere about +z, equal areas to equal solid angles."""
    x = 2.0 * u[0] - 1.0
    y = 2.0 * u[1] - 1.0
    a = 0.5 * (x + y)
    b = 0.5 * (x - y)
    r = wp.abs(a) + wp.abs(b)
    if r == 0.0:
        return wp.vec3(0.0, 0.0, 1.0)
    phi = QUARTER_PI * ((wp.abs(b) - wp.abs(a)) / r + 1.0)
    sin_theta = r * safe_sqrt(2.0 - r * r)
    return wp.vec3(
        sign_not_zero(a) * sin_theta * wp.cos(phi), sign_not_zero(b) * sin_theta * wp.sin(phi), 1.0 - r * r)


@wp.func
def hemisphere_to_square(d: wp.vec3) -> wp.vec2:
    """Invert square_to_hemisphere (unit vectors with z >= 0; z < 0 is taken as 0)."""
    # 1 - z would cancel near the pole.
    r = wp.sqrt((d[0] * d[0] + d[1] * d[1]) / (1.0 + wp.max(d[2], 0.0)))
    phi = wp.atan2(wp.abs(d[1]), wp.abs(d[0])) / (2.0 * QUARTER_PI)
    a = sign_not_zero(d[0]) * r * (1.0 - phi)
    b = sign_not_zero(d[1]) * r * phi
    return wp.vec2(0.5 + 0.5 * (a + b), 0.5 + 0.5 * (a - b))


@wp.func
def cell_of(local: wp.vec3) -> int:
    """Return the cell of a local direction."""
    u = hemisphere_to_square(local)
    x = wp.clamp(int(u[0] * 8.0), 0, TILE - 1)
    y = wp.clamp(int(u[1] * 8.0), 0, TILE - 1)
    return y * TILE + x


@wp.func
def cell_direction(cell: int, u: wp.vec2) -> wp.vec3:
    """Return a point of a cell as a local direction; uniform in solid angle for uniform u, (0.5, 0.5) the centre."""
    return square_to_hemisphere(wp.vec2(
        (float(cell % TILE) + u[0]) * 0.125, (float(cell // TILE) + u[1]) * 0.125))


@wp.func
def cell_center(cell: int) -> wp.vec3:
    """Return the middle of a cell as a local direction."""
    return cell_direction(cell, wp.vec2(0.5, 0.5))


@wp.func
def to_local(n: wp.vec3, d: wp.vec3) -> wp.vec3:
    """Turn a direction into the frame about n: the inverse of geometry_math.to_frame."""
    t = orthonormal_tangent(n)
    return wp.vec3(wp.dot(t, d), wp.dot(wp.cross(n, t), d), wp.dot(n, d))


@wp.func
def band_basis(d: wp.vec3) -> Bands:
    """Return the nine real spherical harmonics up to l = 2, and the tenth function: 1 along z, fading around it.

    Harmonics alone are up to 6 % off for a small light (Ramamoorthi and Hanrahan 2001). The tenth coefficient makes
    the irradiance along the probe's own normal exact; it is 0 for a white sky.
    """
    x = d[0]
    y = d[1]
    z = d[2]
    return Bands(
        0.28209479, 0.48860251 * y, 0.48860251 * z, 0.48860251 * x, 1.09254843 * x * y, 1.09254843 * y * z,
        0.31539157 * (3.0 * z * z - 1.0), 1.09254843 * x * z, 0.54627422 * (x * x - y * y),
        wp.max(z - CORRECTION_COSINE, 0.0) / (1.0 - CORRECTION_COSINE))


@wp.func
def cosine_factor(band: int) -> float:
    """Return by what a coefficient of radiance becomes one of irradiance / pi."""
    if band == 0:
        return 1.0
    if band < 4:
        return COSINE_1
    return COSINE_2


@wp.func
def band_weights(d: wp.vec3) -> Bands:
    """Return what radiance 1 in the solid angle of a cell around d adds to each band of irradiance / pi."""
    basis = band_basis(d)
    up = band_basis(wp.vec3(0.0, 0.0, 1.0))
    along = float(0.0)
    weights = Bands(0.0)
    for band in range(BANDS - 1):
        weights[band] = basis[band] * cosine_factor(band) * (TWO_PI / float(CELLS))
        along = along + weights[band] * up[band]
    # What the harmonics miss along the normal.
    weights[BANDS - 1] = d[2] * (2.0 / float(CELLS)) - along
    return weights


@wp.func
def band_weight(d: wp.vec3, band: int) -> float:
    """Return one of band_weights, without an array that would lie in memory."""
    weights = band_weights(d)
    weight = weights[0]
    for k in range(1, BANDS):
        weight = wp.where(band == k, weights[k], weight)
    return weight


@wp.kernel
def integrate_cells(
    # In:
    steps: int,
    exact: int,
    # Out:
    weights_out: wp.array[float],
    cosines_out: wp.array[float],
):
    """Tabulate what a cell of radiance 1 adds to the bands of irradiance / pi, and the cells' mean cosines.

    `weights_out` is [cell * 10 + band]: the mean of band_weights over the cell. With `exact` 0 it is the published
    estimate: the harmonics at the centre over 8.
    """
    cell = wp.tid()
    total = Bands(0.0)
    cosine = float(0.0)
    step = 1.0 / float(steps)
    i = int(0)
    while i < steps * steps:
        d = cell_direction(cell, wp.vec2((float(i % steps) + 0.5) * step, (float(i // steps) + 0.5) * step))
        total = total + band_weights(d)
        cosine = cosine + d[2]
        i = i + 1
    cosines_out[cell] = cosine * step * step
    center = band_basis(cell_center(cell))
    for band in range(BANDS):
        weight = total[band] * step * step
        if exact == 0:
            weight = wp.where(band < BANDS - 1, 0.125 * center[band] * cosine_factor(band), 0.0)
        weights_out[cell * BANDS + band] = weight
