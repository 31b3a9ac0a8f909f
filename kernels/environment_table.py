# SPDX-License-Identifier: GPL-3.0-or-later
"""The world as a light: directions drawn from a table over an equirectangular grid, with their pdf.

The radiance itself comes from the world's program and the table only guides, but for rays that see the world blurred
anyway: those of the cache and of rough reflections take a texel's mean. Row 0 is the top (+z).
"""

from __future__ import annotations

import warp as wp

from .geometry_math import PI, TWO_PI, safe_sqrt
from .sampling import BELOW_ONE
from .types import Environment
from .wide_loads import load_float


@wp.func
def equirect_direction(x: float, y: float) -> wp.vec3:
    """Return the unit direction at (x, y) in [0, 1]^2; y = 0 is +z, x = 0.5 is -x."""
    phi = TWO_PI * x
    theta = PI * y
    s = wp.sin(theta)
    return wp.vec3(s * wp.cos(phi), s * wp.sin(phi), wp.cos(theta))


@wp.struct
class DrawnDirection:
    """A direction drawn from the world's table."""

    direction: wp.vec3
    pdf: float
    """[1/sr]"""


@wp.func
def row_and_column(environment: Environment, direction: wp.vec3) -> wp.vec2i:
    """Return row and column of the texel of a table that has some in which a direction lies."""
    x = wp.atan2(direction[1], direction[0]) / TWO_PI
    if x < 0.0:
        x = x + 1.0
    y = wp.acos(wp.clamp(direction[2], -1.0, 1.0)) / PI
    i = wp.clamp(int(x * float(environment.width)), 0, environment.width - 1)
    j = wp.clamp(int(y * float(environment.height)), 0, environment.height - 1)
    return wp.vec2i(j, i)


@wp.func
def texel_of(environment: Environment, direction: wp.vec3) -> int:
    """Return the number of that texel."""
    place = row_and_column(environment, direction)
    return place[0] * environment.width + place[1]


@wp.func
def has_texels(world: wp.array[wp.vec3]) -> bool:
    """Return whether the world's radiance is known by texels (DeviceScene.world_texels)."""
    return world.shape[0] > 1


@wp.func
def sum_before(sums: wp.array[float], first: int, place: int) -> float:
    """Return the running sum, from `first` on, before a place."""
    below = float(0.0)
    if place > 0:
        below = sums[first + place - 1]
    return below


@wp.func
def step_of(sums: wp.array[float], first: int, place: int) -> float:
    """Return by how much running sums from `first` on grow at a place."""
    return sums[first + place] - sum_before(sums, first, place)


@wp.func
def texel_pdf(environment: Environment, row: int, column: int, z: float) -> float:
    """Return the pdf [1/sr] with which sample_environment draws a direction of a texel, `z` up.

    Of the sums themselves: what is drawn is exactly what the pdf says, and they are at hand where a direction was drawn
    by them, while a table of probabilities would be one more load to wait for.
    """
    chance = step_of(environment.rows, 0, row) * step_of(environment.columns, row * environment.width, column)
    texels = float(environment.width * environment.height)
    return chance * texels / (TWO_PI * PI * wp.max(safe_sqrt(1.0 - z * z), 1.0e-6))


@wp.func
def environment_pdf(environment: Environment, direction: wp.vec3) -> float:
    """Return the pdf [1/sr] with which sample_environment draws `direction`."""
    if environment.width == 0:
        return 1.0 / (4.0 * PI)
    place = row_and_column(environment, direction)
    return texel_pdf(environment, place[0], place[1], direction[2])


@wp.func
def first_above(sums: wp.array[float], first: int, count: int, u: float) -> int:
    """Return which of `count` running sums from `first` on is the first above u, the last one if none is."""
    low = int(0)
    high = int(count - 1)
    # Quarters, not halves: each step waits for its loads, however many they are.
    while low < high:
        span = high - low
        middle = low + span // 2
        before = low + span // 4
        behind = low + (3 * span) // 4
        above_before = load_float(sums, first + before) > u
        above_middle = load_float(sums, first + middle) > u
        above_behind = load_float(sums, first + behind) > u
        if above_middle:
            low = wp.where(above_before, low, before + 1)
            high = wp.where(above_before, before, middle)
        else:
            low = wp.where(above_behind, middle + 1, behind + 1)
            high = wp.where(above_behind, behind, high)
    return low


@wp.func
def rest_of(sums: wp.array[float], first: int, place: int, u: float) -> float:
    """Return where u lies between the running sums before and at a place, in [0, 1)."""
    below = sum_before(sums, first, place)
    return wp.clamp((u - below) / wp.max(sums[first + place] - below, 1.0e-30), 0.0, BELOW_ONE)


@wp.func
def sample_environment(environment: Environment, u: wp.vec2) -> DrawnDirection:
    """Draw a direction from the table (uniform over the sphere where there is none).

    The sums are inverted, row first, and what is left of the numbers is the place in the texel: the map keeps the
    strata of its numbers, as an alias table would not (Pharr, Jakob and Humphreys 2023, section A.5.6).
    """
    drawn = DrawnDirection()
    if environment.width == 0:
        z = 1.0 - 2.0 * u[0]
        r = safe_sqrt(1.0 - z * z)
        drawn.direction = wp.vec3(r * wp.cos(TWO_PI * u[1]), r * wp.sin(TWO_PI * u[1]), z)
        drawn.pdf = 1.0 / (4.0 * PI)
        return drawn
    row = first_above(environment.rows, 0, environment.height, u[0])
    first = row * environment.width
    column = first_above(environment.columns, first, environment.width, u[1])
    x = (float(column) + rest_of(environment.columns, first, column, u[1])) / float(environment.width)
    y = (float(row) + rest_of(environment.rows, 0, row, u[0])) / float(environment.height)
    drawn.direction = equirect_direction(x, y)
    drawn.pdf = texel_pdf(environment, row, column, drawn.direction[2])
    return drawn
