# SPDX-License-Identifier: GPL-3.0-or-later
"""Circles of confusion: how far a thin lens spreads the light of what is out of focus, and in which shape.

A point at depth d is seen through the lens point l of a perspective camera at its place for the pinhole plus
l (1 / f - 1 / d) on the plane at distance 1, f the focus distance; of an orthographic one plus l (d / f - 1): see
camera.camera_ray. So light in front of the focus spreads over the lens's shape turned by 180 degrees. The radius is
that of the circle around the shape, in pixels, negative in front of the focus. What the lens is in a frame stands in a
small array: a distance by the shape's measure is at most the radius where a point's light arrives.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import PI, TWO_PI
from .types import FrameData
from .view import SKY_DEPTH, View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Entries of the table of the shape, one for each direction, a power of two; and in each quarter turn.
DIRECTIONS = wp.constant(512)
QUARTER = wp.constant(128.0)

# What follows them: radius = LENS_NEAR + LENS_SLOPE * depth, or / depth where LENS_FLAT is 0; the shape's share of the
# circle around it; how many times as long as it is a way may be by the shape's measure.
LENS_NEAR = wp.constant(512)
LENS_SLOPE = wp.constant(513)
LENS_FLAT = wp.constant(514)
LENS_AREA = wp.constant(515)
LENS_LONGEST = wp.constant(516)
LENS_WORDS = wp.constant(517)

# Radii [px] from which on blur goes over from full to half resolution, and where it has.
WIDE_FROM = wp.constant(2.5)
WIDE_TO = wp.constant(3.5)

# Most times as long as it is that a way is by the shape's measure.
LONGEST = wp.constant(1.0e6)

# Radius [px] up to which blur is none: at full resolution the edge of a disk is as soft.
SHARP = wp.constant(0.6455)

# Radii [px] up to which a pixel gathers from half resolution itself, and from which its texels have done so.
COARSE_FROM = wp.constant(6.0)
COARSE_TO = wp.constant(7.0)

# Widest search at half resolution, in texels of the level of detail that is searched.
SEARCH = wp.constant(8.0)

# Level whose texels are tiles, of 16 x 16 pixels.
TILE_LEVEL = wp.constant(3)


@wp.struct
class Pyramid:
    """Half-resolution pictures of two layers with levels of detail, one after another, each half the one before."""

    near: wp.array[wp.uint64]
    """pack_halves of the exposed colour and alpha of what is far in front of the focus, times the share it covers"""
    near_spread: wp.array[wp.uint32]
    """Halves: its radius [px], positive, and the share"""
    behind: wp.array[wp.uint64]
    """The same of all else"""
    behind_spread: wp.array[wp.uint32]
    """Its radius behind the focus; 0 in front of it"""
    reach: wp.array[wp.vec2]
    """Largest radius [px] in front of the focus that is blurred at half resolution, and at full resolution"""
    octaves: wp.array[wp.uint32]
    """Bit i: something behind the focus has a radius from 2^i to 2^(i + 1) pixels"""
    width: int
    height: int
    """Of the picture [px]"""
    columns: int
    rows: int
    """Of level 0: half of it, rounded up"""
    levels: int
    """The coarsest one's number"""
    largest: float
    """Radii are clamped to it [px]"""


@wp.func
def level_columns(p: Pyramid, level: int) -> int:
    """Return how many texels a row of a level has."""
    return (p.columns + (1 << level) - 1) >> level


@wp.func
def level_rows(p: Pyramid, level: int) -> int:
    """Return how many rows a level has."""
    return (p.rows + (1 << level) - 1) >> level


@wp.func
def level_start(p: Pyramid, level: int) -> int:
    """Return the index of a level's first texel."""
    start = int(0)
    for i in range(level):
        start += level_columns(p, i) * level_rows(p, i)
    return start


@wp.func
def wide_share(radius: float) -> float:
    """Return the share of a pixel's light that is blurred at half resolution."""
    return wp.clamp((wp.abs(radius) - WIDE_FROM) / (WIDE_TO - WIDE_FROM), 0.0, 1.0)


@wp.func
def circle_radius(lens: wp.array[float], depth: float, largest: float) -> float:
    """Return the radius of the circle of confusion [px] at a depth [m]; negative in front of the focus."""
    d = SKY_DEPTH
    # False for NaN: nothing is as far as the sky.
    if depth < SKY_DEPTH:
        d = wp.max(depth, 1.0e-6)
    if lens[LENS_FLAT] == 0.0:
        d = 1.0 / d
    radius = lens[LENS_NEAR] + lens[LENS_SLOPE] * d
    if not wp.isfinite(radius):
        radius = 0.0
    return wp.clamp(radius, -largest, largest)


@wp.func
def disk_share(lens: wp.array[float], radius: float, x: float, y: float) -> float:
    """Return the share of a sample that lies within a disk of the lens's shape around it, its edge as wide as a sample.

    Args:
        lens: From describe_lens.
        radius: In steps between samples.
        x: From the sample to where its light arrives, in the same.
        y: The same upwards; both turned round in front of the focus.
    """
    distance = wp.sqrt(x * x + y * y)
    # Most samples of wide disks are far inside, whatever the shape.
    if distance * lens[LENS_LONGEST] <= radius - 0.5:
        return 1.0
    # An angle from 0 to 4 without trigonometry.
    t = y / wp.max(wp.abs(x) + wp.abs(y), 1.0e-20)
    angle = t
    if x < 0.0:
        angle = 2.0 - t
    elif y < 0.0:
        angle = 4.0 + t
    index = int(angle * QUARTER) & (DIRECTIONS - 1)
    return wp.clamp(radius + 0.5 - distance * lens[index], 0.0, 1.0)


@wp.func
def octave(radius: float) -> int:
    """Return the whole part of a radius's logarithm to base 2."""
    return int(wp.floor(wp.log2(wp.max(radius, 1.0))))


@wp.func
def table_direction(index: int) -> wp.vec2:
    """Return the unit vector in the middle of an entry of the shape's table."""
    a = (float(index) + 0.5) / QUARTER
    d = wp.vec2(1.0 - a, a)
    if a >= 3.0:
        d = wp.vec2(a - 3.0, a - 4.0)
    elif a >= 2.0:
        d = wp.vec2(a - 3.0, 2.0 - a)
    elif a >= 1.0:
        d = wp.vec2(1.0 - a, 2.0 - a)
    return wp.normalize(d)


@wp.func
def shape_distance(frame: FrameData, d: wp.vec2) -> float:
    """Return a point's distance from the middle of camera.sample_aperture's disk or polygon: 1 at its edge."""
    if frame.aperture_blades < 3:
        return wp.length(d)
    sector = TWO_PI / float(frame.aperture_blades)
    angle = wp.atan2(d[1], d[0]) - frame.aperture_rotation
    angle -= sector * wp.floor(angle / sector + 0.5)
    return wp.length(d) * wp.cos(angle) / wp.cos(0.5 * sector)


@wp.kernel
def describe_lens(
    first: int,
    # In:
    views: wp.array[View],
    # Out:
    lens_out: wp.array[float],
):
    """Write what the lens is in this frame."""
    index = first + wp.tid()
    frame = views[0].camera
    # Pixels for a way of 1 on the lens, for a unit of depth's measure.
    across = frame.aperture_radius * float(frame.width) / (frame.window[1] - frame.window[0])
    up = frame.aperture_radius * float(frame.height) / (frame.window[3] - frame.window[2])
    ratio = frame.aperture_ratio
    scale = wp.max(wp.abs(across) / ratio, wp.abs(up))
    value = float(0.0)
    if index < DIRECTIONS:
        d = table_direction(index)
        value = shape_distance(frame, wp.vec2(d[0] * ratio * scale / across, d[1] * scale / up))
        # A picture without a width, say: any shape will do where there are no numbers.
        if not (value >= 1.0e-3 and value < LONGEST):
            value = 1.0
    elif index == LENS_NEAR:
        value = wp.where(frame.orthographic == 1, -scale, scale / frame.focus_distance)
    elif index == LENS_SLOPE:
        value = wp.where(frame.orthographic == 1, scale / frame.focus_distance, -scale)
    elif index == LENS_FLAT:
        value = float(frame.orthographic)
    elif index == LENS_LONGEST:
        value = wp.max(scale * ratio / wp.abs(across), scale / wp.abs(up))
        if frame.aperture_blades >= 3:
            value /= wp.cos(PI / float(frame.aperture_blades))
        if not (value >= 1.0):
            value = LONGEST
        # The table is of directions between those of samples.
        value *= 1.02
    else:
        value = wp.abs(across) / ratio * wp.abs(up) / (scale * scale)
        if frame.aperture_blades >= 3:
            sector = TWO_PI / float(frame.aperture_blades)
            value *= wp.sin(sector) / sector
        if not (value > 0.0 and value <= 1.0):
            value = 1.0
    lens_out[index] = value


@wp.func
def disk_area(lens: wp.array[float], radius: float) -> float:
    """Return the sum of disk_share over a grid of steps of 1, for a radius in those."""
    return wp.max(wp.min(radius + 0.5, 1.0), PI * lens[LENS_AREA] * (radius * radius + 1.0 / 12.0))
