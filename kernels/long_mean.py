# SPDX-License-Identifier: GPL-3.0-or-later
"""Means over up to 1024 frames in eight bytes a colour, and how they are read at a moved place.

A half-float has 11 significant bits: from some 500 samples on, the mean's change is lost in rounding. Light is never
negative and its exponents are few, so 21 bits hold 6 of exponent and 16 significant ones.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .packing import HALF_MAX, unpack_normal
from .reprojection import has_tap, tap_pixel, tap_weight

MANTISSA_BITS = wp.constant(wp.uint32(15))
# Biased exponent of float32 that becomes 0 (no number): the smallest kept is 2^-47, the largest below 2^16.
EXPONENT_ZERO = wp.constant(wp.uint32(79))
COMPONENT_MASK = wp.constant(wp.uint64(0x1FFFFF))

# Weight of all valid taps together below which a place has no history.
TAP_MINIMUM = wp.constant(1.0e-3)
# Reprojection.taps of a place whose four taps all show the surface.
ALL_TAPS = wp.constant(15)
# Distance from a pixel's centre [px] below which one tap is read.
ON_CENTRE = wp.constant(1.0e-3)
# How far beyond its taps' range an interpolation may go, as a share of that range.
RANGE_MARGIN = wp.constant(0.1)
# Relative unevenness of depth that is no edge.
FLAT = wp.constant(1.0e-4)


@wp.func
def pack_component(x: float) -> wp.uint64:
    """Round a number in 0..HALF_MAX to 21 bits; NaN becomes 0."""
    if not (x > 0.0):
        return wp.uint64(0)
    bits = (wp.cast(wp.min(x, HALF_MAX), wp.uint32) + wp.uint32(128)) >> wp.uint32(8)
    zero = EXPONENT_ZERO << MANTISSA_BITS
    if bits < zero + (wp.uint32(1) << MANTISSA_BITS):
        return wp.uint64(0)
    return wp.uint64(bits - zero)


@wp.func
def unpack_component(packed: wp.uint64) -> float:
    """Return the number of pack_component."""
    if packed == wp.uint64(0):
        return 0.0
    return wp.cast((wp.uint32(packed) + (EXPONENT_ZERO << MANTISSA_BITS)) << wp.uint32(8), wp.float32)


@wp.func
def pack_mean(c: wp.vec3) -> wp.uint64:
    """Round a colour to 21 bits a component (relative error at most 2^-16)."""
    return (
        pack_component(c[0]) | (pack_component(c[1]) << wp.uint64(21)) | (pack_component(c[2]) << wp.uint64(42)))


@wp.func
def unpack_mean(packed: wp.uint64) -> wp.vec3:
    """Return the colour of pack_mean."""
    return wp.vec3(
        unpack_component(packed & COMPONENT_MASK), unpack_component((packed >> wp.uint64(21)) & COMPONENT_MASK),
        unpack_component((packed >> wp.uint64(42)) & COMPONENT_MASK))


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
def gather_cubic(image: wp.array[wp.uint64], position: wp.vec2, width: int, height: int, wide: bool) -> wp.vec3:
    """Return the Catmull-Rom interpolation of 4x4 pixels: bilinear taps would blur the light anew in every frame.

    Its result is limited to the range of the inner 2x2, which keeps out what other surfaces there are around them;
    where there are none (`wide`), to a little more than the range of all, so that peaks don't wear off in motion.
    """
    left = int(wp.floor(position[0] - 0.5))
    low = int(wp.floor(position[1] - 0.5))
    fx = position[0] - 0.5 - float(left)
    fy = position[1] - 0.5 - float(low)
    least = wp.vec3(HALF_MAX, HALF_MAX, HALF_MAX)
    most = wp.vec3(0.0, 0.0, 0.0)
    sum = wp.vec3(0.0, 0.0, 0.0)
    j = int(0)
    while j < 4:
        row = wp.clamp(low - 1 + j, 0, height - 1) * width
        wy = cubic_weight(fy, j)
        for i in range(4):
            c = unpack_mean(image[row + wp.clamp(left - 1 + i, 0, width - 1)])
            sum += c * (wy * cubic_weight(fx, i))
            if wide or (i > 0 and i < 3 and j > 0 and j < 3):
                least = wp.min(least, c)
                most = wp.max(most, c)
        j += 1
    if wide:
        margin = (most - least) * RANGE_MARGIN
        least = wp.max(least - margin, wp.vec3(0.0, 0.0, 0.0))
        most += margin
    return wp.min(wp.max(sum, least), most)


@wp.func
def surrounded(gbuffer: GBuffer, position: wp.vec2, width: int, height: int) -> bool:
    """Return whether the 4x4 pixels around a place in a G-buffer show the same smooth surface as the inner 2x2."""
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
    packed = gbuffer.geometric_normal[corner]
    normal = unpack_normal(packed)
    index = int(0)
    while index < 16:
        i = index % 4 - 1
        j = index // 4 - 1
        index += 1
        q = corner + j * width + i
        if wp.abs(gbuffer.depth[q] - depth - float(i) * across - float(j) * up) > tolerance:
            return False
        other = gbuffer.geometric_normal[q]
        if other != packed and wp.dot(normal, unpack_normal(other)) < 0.95:
            return False
    return True


@wp.func
def off_centre(position: wp.vec2) -> bool:
    """Return whether a place lies between pixels' centres."""
    x = position[0] - 0.5
    y = position[1] - 0.5
    return wp.abs(x - wp.round(x)) + wp.abs(y - wp.round(y)) > ON_CENTRE


@wp.func
def gather_sharpness(gbuffer: GBuffer, position: wp.vec2, complete: bool, width: int, height: int) -> int:
    """Return how means are read at a place in the frame before: 0 bilinear, 1 cubic within the inner taps, 2 cubic.

    In detail:
        gbuffer: Of the frame before.
        complete: Whether all four taps show the surface and have a mean.
    """
    if not complete or not off_centre(position):
        return 0
    return wp.where(surrounded(gbuffer, position, width, height), 2, 1)


@wp.func
def gather_mean(
    image: wp.array[wp.uint64], position: wp.vec2, weights: wp.vec4, sharpness: int, width: int, height: int,
) -> wp.vec3:
    """Return a mean at a place between pixels; sharpness 0..2 as gather_sharpness gives it."""
    if sharpness > 0:
        return gather_cubic(image, position, width, height, sharpness == 2)
    return gather_bilinear(image, position, weights, width)


@wp.func
def history_cap(rest: int, light_age: int, cap: float) -> float:
    """Return how many frames a mean may be made of: short after an edit of the light, rising at rest.

    At rest it rises by one a frame from `cap` to 1024, so that the mean becomes the plain average of all its frames.
    """
    limit = wp.min(cap + float(wp.min(rest, 1024)), 1024.0)
    if light_age < 12:
        # Halves what is left of the old light in every frame; a cap of 1 would show the bare noise.
        limit = wp.min(limit, 2.0)
    return limit
