# SPDX-License-Identifier: GPL-3.0-or-later
"""Means over up to 1024 frames in eight bytes a colour, and how they are read at a moved place.

A half-float has 11 significant bits: from some 500 samples on, the mean's change is lost in rounding. Light is never
negative and its exponents are few, so 21 bits hold 6 of exponent and 16 significant ones.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .packing import HALF_MAX
from .reprojection import has_tap, tap_pixel, tap_weight

# Brings 2^-47..2^16 down to where the exponent of float32 has its two upper bits 0, and back.
PACK_SCALE = wp.constant(2.0**-79)
UNPACK_SCALE = wp.constant(2.0**79)
# Codes below have an exponent of 0: too small to be kept.
SMALLEST_CODE = wp.constant(wp.uint32(1 << 15))
COMPONENT_MASK = wp.constant(wp.uint64(0x1FFFFF))

# Weight of all valid taps together below which a place has no history.
TAP_MINIMUM = wp.constant(1.0e-3)
# Reprojection.taps of a place whose four taps all show the surface.
ALL_TAPS = wp.constant(15)
# Distance from a pixel's centre [px] below which one tap is read.
ON_CENTRE = wp.constant(1.0e-3)
# How far beyond its taps' range an interpolation may go, as a share of that range.
RANGE_MARGIN = wp.constant(0.1)
# Frames after an edit of the light in which what was before is dropped.
EDIT_FRAMES = wp.constant(12)
# Relative unevenness of depth that is no edge.
FLAT = wp.constant(1.0e-4)


@wp.func
def pack_component(x: float) -> wp.uint64:
    """Round a number in 0..HALF_MAX to 21 bits; NaN becomes 0."""
    if not (x > 0.0):
        return wp.uint64(0)
    code = (wp.cast(wp.min(x, HALF_MAX) * PACK_SCALE, wp.uint32) + wp.uint32(128)) >> wp.uint32(8)
    return wp.uint64(wp.where(code < SMALLEST_CODE, wp.uint32(0), code))


@wp.func
def unpack_component(code: wp.uint32) -> float:
    """Return the number of pack_component."""
    return wp.cast(code << wp.uint32(8), wp.float32) * UNPACK_SCALE


@wp.func
def pack_mean(c: wp.vec3) -> wp.uint64:
    """Round a colour to 21 bits a component (relative error at most 2^-16)."""
    return (
        pack_component(c[0]) | (pack_component(c[1]) << wp.uint64(21)) | (pack_component(c[2]) << wp.uint64(42)))


@wp.func
def unpack_mean(packed: wp.uint64) -> wp.vec3:
    """Return the colour of pack_mean."""
    return wp.vec3(
        unpack_component(wp.uint32(packed & COMPONENT_MASK)),
        unpack_component(wp.uint32((packed >> wp.uint64(21)) & COMPONENT_MASK)),
        unpack_component(wp.uint32((packed >> wp.uint64(42)) & COMPONENT_MASK)))


@wp.func
def usable_weight(position: wp.vec2, taps: wp.uint8, tap: int) -> float:
    """Return the bilinear weight of a tap, 0 where it shows another surface."""
    if not has_tap(taps, tap):
        return 0.0
    return tap_weight(position, tap)


@wp.func
def gather_bilinear(image: wp.array[wp.uint64], position: wp.vec2, weights: wp.vec4, width: int) -> wp.vec3:
    """Return the mean of the taps by weights that sum to 1 (taps of weight 0 are not read)."""
    sum = wp.vec3(0.0, 0.0, 0.0)
    for tap in range(4):
        if weights[tap] > 0.0:
            sum += unpack_mean(image[tap_pixel(position, tap, width)]) * weights[tap]
    return sum


@wp.func
def cubic_weight(f: float, tap: int) -> float:
    """Return the Catmull-Rom weight of tap 0..3 (-1, 0, 1, 2) at a fraction f behind tap 1."""
    if tap == 0:
        return f * (-0.5 + f * (1.0 - 0.5 * f))
    if tap == 1:
        return 1.0 + f * f * (-2.5 + 1.5 * f)
    if tap == 2:
        return f * (0.5 + f * (2.0 - 1.5 * f))
    return f * f * (-0.5 + 0.5 * f)


@wp.func
def near_column(left: int, tap: int, width: int) -> int:
    """Return column 0..3 (-1, 0, 1, 2) from `left`, within the picture."""
    return wp.clamp(left - 1 + tap, 0, width - 1)


@wp.func
def gather_cubic(image: wp.array[wp.uint64], position: wp.vec2, width: int, height: int, wide: bool) -> wp.vec3:
    """Return the Catmull-Rom interpolation between pixels: bilinear taps would blur the light anew in every frame.

    Of the 4x4 pixels the corners are left out: cubic along rows plus cubic along columns minus bilinear, which is
    exact but for terms of fourth order. The result is limited to the range of the inner 2x2, which keeps out what
    other surfaces there are around them; where there are none (`wide`), to a little more than the range of all, so
    that peaks don't wear off in motion.
    """
    left = int(wp.floor(position[0] - 0.5))
    low = int(wp.floor(position[1] - 0.5))
    fx = position[0] - 0.5 - float(left)
    fy = position[1] - 0.5 - float(low)
    linear_x = wp.vec4(0.0, 1.0 - fx, fx, 0.0)
    linear_y = wp.vec4(0.0, 1.0 - fy, fy, 0.0)
    least = wp.vec3(HALF_MAX, HALF_MAX, HALF_MAX)
    most = wp.vec3(0.0, 0.0, 0.0)
    outer_least = least
    outer_most = most
    sum = wp.vec3(0.0, 0.0, 0.0)
    for j in range(4):
        row = near_column(low, j, height) * width
        cubic_y = cubic_weight(fy, j)
        for i in range(4):
            if i % 3 != 0 or j % 3 != 0:
                c = unpack_mean(image[row + near_column(left, i, width)])
                sum += c * (cubic_weight(fx, i) * linear_y[j] + linear_x[i] * (cubic_y - linear_y[j]))
                if i % 3 != 0 and j % 3 != 0:
                    least = wp.min(least, c)
                    most = wp.max(most, c)
                else:
                    outer_least = wp.min(outer_least, c)
                    outer_most = wp.max(outer_most, c)
    if wide:
        least = wp.min(least, outer_least)
        most = wp.max(most, outer_most)
        margin = (most - least) * RANGE_MARGIN
        least = wp.max(least - margin, wp.vec3(0.0, 0.0, 0.0))
        most += margin
    return wp.min(wp.max(sum, least), most)


@wp.func
def surrounded(gbuffer: GBuffer, position: wp.vec2, width: int, height: int) -> bool:
    """Return whether the pixels that gather_cubic reads show the same smooth surface as the inner 2x2, by depths."""
    left = int(wp.floor(position[0] - 0.5))
    low = int(wp.floor(position[1] - 0.5))
    if left < 1 or low < 1 or left + 2 >= width or low + 2 >= height:
        return False
    corner = low * width + left
    depth = gbuffer.depth[corner]
    across = gbuffer.depth[corner + 1] - depth
    up = gbuffer.depth[corner + width] - depth
    # Depth is linear on a plane but for perspective, which bends it by far less than its step.
    tolerance = 0.5 * (wp.abs(across) + wp.abs(up)) + FLAT * depth
    worst = float(0.0)
    # All are read before any is judged: they wait for memory together.
    for j in range(4):
        for i in range(4):
            if (i % 3 == 0) != (j % 3 == 0):
                found = gbuffer.depth[corner + (j - 1) * width + i - 1]
                worst = wp.max(worst, wp.abs(found - depth - float(i - 1) * across - float(j - 1) * up))
    return worst <= tolerance


@wp.func
def off_centre(position: wp.vec2) -> bool:
    """Return whether a place lies between pixels' centres."""
    x = position[0] - 0.5
    y = position[1] - 0.5
    return wp.abs(x - wp.round(x)) + wp.abs(y - wp.round(y)) > ON_CENTRE


@wp.func
def nearest_tap(position: wp.vec2) -> int:
    """Return the tap that a place on a pixel's centre falls on."""
    right = wp.where(position[0] - 0.5 - wp.floor(position[0] - 0.5) > 0.5, 1, 0)
    above = wp.where(position[1] - 0.5 - wp.floor(position[1] - 0.5) > 0.5, 2, 0)
    return right + above


@wp.func
def gather_mean(
    image: wp.array[wp.uint64], position: wp.vec2, weights: wp.vec4, sharp: bool, wide: bool, width: int, height: int,
) -> wp.vec3:
    """Return a mean at a place between pixels: cubic if `sharp`, else of the taps that have a weight."""
    if sharp:
        return gather_cubic(image, position, width, height, wide)
    return gather_bilinear(image, position, weights, width)


@wp.func
def history_cap(rest: int, light_age: int, cap: float) -> float:
    """Return how many frames a mean may be made of: short after an edit of the light, rising at rest.

    At rest it rises by one a frame from `cap` to 1024, so that the mean becomes the plain average of all its frames.
    """
    limit = wp.min(cap + float(wp.min(rest, 1024)), 1024.0)
    if light_age < EDIT_FRAMES:
        # Halves what is left of the old light in every frame; a cap of 1 would show the bare noise.
        limit = wp.min(limit, 2.0)
    return limit
