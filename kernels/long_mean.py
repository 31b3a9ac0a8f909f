# SPDX-License-Identifier: GPL-3.0-or-later
"""Means over up to 1024 frames in eight bytes a colour, and how they are read at a moved place.

A half-float has 11 significant bits: from some 500 samples on, the mean's change is lost in rounding. Light is never
negative and its exponents are few, so 21 bits hold 6 of exponent and 16 significant ones.

A mean counts for the frames that it is of times the share of the place that is known (bilinear weights of the taps that
show the surface). A pixel at the picture's edge, or beside something nearer, reads its own mean again while surfaces
pass below it by a part of a pixel a frame: were that taken for what is known of all of the place, it would show the
light of where they have been for as many frames as a mean is of, and hand it on.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer
from .packing import HALF_MAX
from .reprojection import Reprojection, has_moved, has_tap, known_taps, tap_pixel
from .wide_loads import load_four_floats, load_two_floats, load_two_words, load_word

# Brings 2^-47..2^16 down to where the exponent of float32 has its two upper bits 0, and back.
PACK_SCALE = wp.constant(2.0**-79)
UNPACK_SCALE = wp.constant(2.0**79)
# Codes below have an exponent of 0: too small to be kept.
SMALLEST_CODE = wp.constant(wp.uint32(1 << 15))
# Where a code lies in the bits of a float.
COMPONENT_BITS = wp.constant(wp.uint32(0x1FFFFF00))
LOW_WORD = wp.constant(wp.uint64(0xFFFFFFFF))

# Weight of all valid taps together below which a place has no history.
TAP_MINIMUM = wp.constant(1.0e-3)
# Reprojection.taps of a place whose four taps all show the surface.
ALL_TAPS = wp.constant(15)
# Distance from a pixel's centre [px] below which one tap is read.
ON_CENTRE = wp.constant(1.0e-3)
# How far beyond its taps' range an interpolation may go, as a share of that range.
RANGE_MARGIN = wp.constant(0.1)
# Sharpness of cubics: Catmull-Rom, which keeps 0.88 of a wave of 4 pixels in a frame and 0.28 after ten, so that noise
# wears off with detail; and one that keeps 0.92 of it and makes 1.01 of one of 8 pixels, for means with sharp edges.
SMOOTH = wp.constant(0.5)
SHARP = wp.constant(0.6)
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
def pack_mean(c: wp.vec3) -> wp.uint64:
    """Round a colour to 21 bits a component (relative error at most 2^-16)."""
    return (
        pack_component(c[0]) | (pack_component(c[1]) << wp.uint64(21)) | (pack_component(c[2]) << wp.uint64(42)))


@wp.func
def unpack_scaled(packed: wp.uint64) -> wp.vec3:
    """Return the colour of pack_mean times PACK_SCALE: sums and ranges of colours need the factor only once."""
    low = wp.uint32(packed & LOW_WORD)
    high = wp.uint32(packed >> wp.uint64(32))
    return wp.vec3(
        wp.cast((low << wp.uint32(8)) & COMPONENT_BITS, wp.float32),
        wp.cast(wp.uint32((packed >> wp.uint64(13)) & LOW_WORD) & COMPONENT_BITS, wp.float32),
        wp.cast((high >> wp.uint32(2)) & COMPONENT_BITS, wp.float32))


@wp.func
def unpack_mean(packed: wp.uint64) -> wp.vec3:
    """Return the colour of pack_mean."""
    return unpack_scaled(packed) * UNPACK_SCALE


@wp.struct
class Between:
    """A place between four pixels; see Reprojection.taps for their order."""

    left: int
    """Column of the first"""
    low: int
    """Row of the first"""
    corner: int
    """Index of the first; of pixels off the picture it means nothing"""
    x: float
    """Way from the first to the next column, 0..1"""
    y: float


@wp.func
def place_between(position: wp.vec2, width: int) -> Between:
    """Return between which pixels a position lies (Reprojection.position)."""
    out = Between()
    left = wp.floor(position[0] - 0.5)
    low = wp.floor(position[1] - 0.5)
    out.left = int(left)
    out.low = int(low)
    out.corner = out.low * width + out.left
    out.x = position[0] - 0.5 - left
    out.y = position[1] - 0.5 - low
    return out


@wp.func
def tap_weights(place: Between) -> wp.vec4:
    """Return the bilinear weights of the four pixels."""
    x = 1.0 - place.x
    y = 1.0 - place.y
    return wp.vec4(x * y, place.x * y, x * place.y, place.x * place.y)


@wp.func
def valid_tap(place: Between, taps: wp.uint8, tap: int, width: int, pixel: int) -> int:
    """Return the pixel of a tap, or another one that can be read where the tap shows something else."""
    return wp.where(has_tap(taps, tap), place.corner + (tap & 1) + (tap >> 1) * width, pixel)


@wp.func
def gather_bilinear(image: wp.array[wp.uint64], place: Between, weights: wp.vec4, width: int) -> wp.vec3:
    """Return the mean of the taps by weights that sum to 1 (taps of weight 0 are not read)."""
    sum = wp.vec3(0.0, 0.0, 0.0)
    for tap in range(4):
        if weights[tap] > 0.0:
            sum += unpack_mean(image[place.corner + (tap & 1) + (tap >> 1) * width]) * weights[tap]
    return sum


@wp.func
def cubic_weights(f: float, sharpness: float) -> wp.vec4:
    """Return the weights of taps at -1, 0, 1, 2 at a fraction f; `sharpness` as in gather_cubic.

    Planes stay as they are, whatever the sharpness: nothing drifts in motion.
    """
    g = 1.0 - f
    before = -sharpness * f * g * g
    after = -sharpness * f * f * g
    return wp.vec4(before, g - 2.0 * before + after, f + before - 2.0 * after, after)


@wp.func
def gather_cubic(
    image: wp.array[wp.uint64], place: Between, width: int, height: int, wide: bool, sharpness: float,
) -> wp.vec3:
    """Return a cubic interpolation between pixels: bilinear taps would blur the light anew in every frame.

    `sharpness` is SMOOTH or SHARP: twice the share of the cubic term that is added to linear interpolation.

    Of the 4x4 pixels the corners are left out: cubic along rows plus cubic along columns minus bilinear, which is
    exact but for terms of fourth order. The result is limited to the range of the inner 2x2, which must all be in the
    picture; that keeps out what other surfaces there are around them; where there are none (`wide`), to a little more
    than the range of all, so that peaks don't wear off in motion.
    """
    x = place.x
    y = place.y
    cubic_x = cubic_weights(x, sharpness)
    cubic_y = cubic_weights(y, sharpness)
    # Of the 2x2, and the differences from linear to cubic along columns.
    down = 1.0 - y
    more_low = cubic_y[1] - down
    more_high = cubic_y[2] - y
    corner = place.corner
    above = corner + width
    # The edge pixel repeats.
    before = wp.where(place.left > 0, -1, 0)
    after = wp.where(place.left + 2 < width, 2, 1)
    under = wp.where(place.low > 0, corner - width, corner)
    over = wp.where(place.low + 2 < height, above + width, above)
    # All are read before any is used: they wait for memory together.
    words = load_two_words(image, under)
    under_left = unpack_scaled(words[0])
    under_right = unpack_scaled(words[1])
    words = load_two_words(image, corner)
    low_left = unpack_scaled(words[0])
    low_right = unpack_scaled(words[1])
    low_before = unpack_scaled(load_word(image, corner + before))
    low_after = unpack_scaled(load_word(image, corner + after))
    words = load_two_words(image, above)
    high_left = unpack_scaled(words[0])
    high_right = unpack_scaled(words[1])
    high_before = unpack_scaled(load_word(image, above + before))
    high_after = unpack_scaled(load_word(image, above + after))
    words = load_two_words(image, over)
    over_left = unpack_scaled(words[0])
    over_right = unpack_scaled(words[1])
    sum = under_left * ((1.0 - x) * cubic_y[0]) + under_right * (x * cubic_y[0])
    sum += low_before * (cubic_x[0] * down)
    sum += low_left * (cubic_x[1] * down + (1.0 - x) * more_low)
    sum += low_right * (cubic_x[2] * down + x * more_low)
    sum += low_after * (cubic_x[3] * down)
    sum += high_before * (cubic_x[0] * y)
    sum += high_left * (cubic_x[1] * y + (1.0 - x) * more_high)
    sum += high_right * (cubic_x[2] * y + x * more_high)
    sum += high_after * (cubic_x[3] * y)
    sum += over_left * ((1.0 - x) * cubic_y[3])
    sum += over_right * (x * cubic_y[3])
    least = wp.min(wp.min(low_left, low_right), wp.min(high_left, high_right))
    most = wp.max(wp.max(low_left, low_right), wp.max(high_left, high_right))
    if wide:
        least = wp.min(least, wp.min(wp.min(under_left, under_right), wp.min(over_left, over_right)))
        least = wp.min(least, wp.min(wp.min(low_before, low_after), wp.min(high_before, high_after)))
        most = wp.max(most, wp.max(wp.max(under_left, under_right), wp.max(over_left, over_right)))
        most = wp.max(most, wp.max(wp.max(low_before, low_after), wp.max(high_before, high_after)))
        margin = (most - least) * RANGE_MARGIN
        least = wp.max(least - margin, wp.vec3(0.0, 0.0, 0.0))
        most += margin
    return wp.min(wp.max(sum, least), most) * UNPACK_SCALE


@wp.func
def surrounded(gbuffer: GBuffer, place: Between, width: int, height: int) -> bool:
    """Return whether the pixels that gather_cubic reads show the same smooth surface as the inner 2x2, by depths."""
    if place.left < 1 or place.low < 1 or place.left + 2 >= width or place.low + 2 >= height:
        return False
    # All are read before any is judged: they wait for memory together.
    row = load_four_floats(gbuffer.depth, place.corner - 1)
    above = load_four_floats(gbuffer.depth, place.corner + width - 1)
    under = load_two_floats(gbuffer.depth, place.corner - width)
    over = load_two_floats(gbuffer.depth, place.corner + 2 * width)
    depth = row[1]
    across = row[2] - depth
    up = above[1] - depth
    # Depth is linear on a plane but for perspective, which bends it by far less than its step.
    tolerance = 0.5 * (wp.abs(across) + wp.abs(up)) + FLAT * depth
    worst = wp.max(wp.abs(under[0] - depth + up), wp.abs(under[1] - depth - across + up))
    worst = wp.max(worst, wp.max(wp.abs(row[0] - depth + across), wp.abs(row[3] - depth - 2.0 * across)))
    worst = wp.max(worst, wp.max(
        wp.abs(above[0] - depth + across - up), wp.abs(above[3] - depth - 2.0 * across - up)))
    worst = wp.max(worst, wp.max(
        wp.abs(over[0] - depth - 2.0 * up), wp.abs(over[1] - depth - across - 2.0 * up)))
    return worst <= tolerance


@wp.func
def off_centre(position: wp.vec2) -> bool:
    """Return whether a place lies between pixels' centres."""
    x = position[0] - 0.5
    y = position[1] - 0.5
    return wp.abs(x - wp.round(x)) + wp.abs(y - wp.round(y)) > ON_CENTRE


@wp.func
def only_camera_moved(position: wp.vec2, taps: wp.uint8) -> bool:
    """Return whether a pixel's surface was elsewhere in the frame before, by the camera's movement alone.

    Of Reprojection, for one pixel; not so where nothing has moved.
    """
    return not has_moved(taps) and off_centre(position)


@wp.func
def nearest_tap(position: wp.vec2) -> int:
    """Return the tap that a place on a pixel's centre falls on."""
    right = wp.where(position[0] - 0.5 - wp.floor(position[0] - 0.5) > 0.5, 1, 0)
    above = wp.where(position[1] - 0.5 - wp.floor(position[1] - 0.5) > 0.5, 2, 0)
    return right + above


@wp.func
def pixel_before(reprojection: Reprojection, pixel: int, width: int) -> int:
    """Return the pixel of the frame before where a pixel's surface was; -1 unless all four around show it."""
    if int(known_taps(reprojection, pixel)) != ALL_TAPS:
        return -1
    position = reprojection.position[pixel]
    return tap_pixel(position, nearest_tap(position), width)


@wp.func
def gather_mean(
    image: wp.array[wp.uint64], place: Between, weights: wp.vec4, complete: bool, wide: bool, sharpness: float,
    width: int, height: int,
) -> wp.vec3:
    """Return a mean at a place between pixels: cubic if all taps count, else of the taps that have a weight."""
    if complete:
        return gather_cubic(image, place, width, height, wide, sharpness)
    return gather_bilinear(image, place, weights, width)


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
