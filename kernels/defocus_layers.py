# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture at half resolution in two layers, its levels of detail, and how far blur in front of the focus reaches.

What is far in front of the focus is kept apart from all else, since it blurs over anything (Jimenez, "Next Generation
Post Processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014). Colours are weighed by the share of a texel that
their layer covers, so that no light is lost or made. Where a texel holds what is blurred little beside what is blurred
much, its mean would be spread far: the former is left out.
"""

from __future__ import annotations

import warp as wp

from .defocus import (
    TILE_LEVEL,
    WIDE_FROM,
    WIDE_TO,
    Pyramid,
    circle_radius,
    level_columns,
    level_rows,
    level_start,
    octave,
    wide_share,
)
from .packed_halves import pack_halves, pack_pair, unpack_halves, unpack_pair
from .packing import HALF_MAX
from .view import View
from .wide_loads import load_float, load_vec4

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Share of the largest radius in a texel that another one needs to be fully counted there.
LIKE_RADIUS = wp.constant(0.3)

# Exposed radiance that parts of a texel count as having beside their own in the mean of their radii.
LEAST_LIGHT = wp.constant(1.0e-3)


@wp.func
def like_weight(radius: float, light: float, largest: float, largest_light: float) -> float:
    """Return the weight of a part of a texel by how nearly it is blurred as the most blurred part is.

    What is blurred at half resolution keeps all of it where it is much brighter: the mean radius is its own, then.
    """
    w = wp.min((radius + 1.0) / (LIKE_RADIUS * largest + 1.0), 1.0)
    square = light / (light + largest_light)
    square *= square
    return wp.max(w * w, wide_share(radius) * square * square)


@wp.func
def light_of(color: wp.vec4) -> float:
    """Return a color's brightness, that of the dark not quite 0."""
    return wp.max(color[0], 0.0) + wp.max(color[1], 0.0) + wp.max(color[2], 0.0) + 1.0e-6


@wp.func
def add_spread(spread: wp.vec3, color: wp.vec4, radius: float, share: float) -> wp.vec3:
    """Add a part of a texel, its color weighed by its share, to sums of weighed radii, their weights and shares.

    The mean radius is that of the light: a bulb before the night sky is as wide as it is by itself.
    """
    w = wp.max(color[0], 0.0) + wp.max(color[1], 0.0) + wp.max(color[2], 0.0) + LEAST_LIGHT * share
    return spread + wp.vec3(w * radius, w, share)


@wp.func
def pack_mean_spread(spread: wp.vec3) -> wp.uint32:
    """Pack the mean radius and the share of add_spread's sums."""
    return pack_pair(spread[0] / wp.max(spread[1], 1.0e-20), spread[2])


@wp.struct
class Layer:
    """What the parts of a texel come to in one of the two layers."""

    largest: float
    """Radius [px] of the most blurred part"""
    light: float
    """That part's brightness"""
    color: wp.vec4
    """Sum of weighed colours"""
    spread: wp.vec3
    """Sums of add_spread"""


@wp.func
def with_radius(layer: Layer, radius: float, light: float) -> Layer:
    """Take note of a part's radius [px] and brightness; comes before all add_part."""
    result = layer
    if radius > layer.largest:
        result.largest = radius
        result.light = light
    return result


@wp.func
def add_part(layer: Layer, part: float, color: wp.vec4, light: float, radius: float, share: float) -> Layer:
    """Add a part of a texel, so much of it: its colour, brightness and radius [px], and the share that it covers."""
    result = layer
    w = part * like_weight(radius, light, layer.largest, layer.light)
    result.color += w * color
    result.spread = add_spread(layer.spread, w * color, radius, w * share)
    return result


@wp.func
def store_texel(
    pyramid: Pyramid, texel: int, near: Layer, behind: Layer, reach: wp.vec2, octaves: wp.uint32,
):
    """Write a texel of any level."""
    pyramid.near[texel] = pack_halves(near.color)
    pyramid.near_spread[texel] = pack_mean_spread(near.spread)
    pyramid.behind[texel] = pack_halves(behind.color)
    pyramid.behind_spread[texel] = pack_mean_spread(behind.spread)
    pyramid.reach[texel] = reach
    pyramid.octaves[texel] = octaves


@wp.func
def shown_color(view: View, mean: wp.array[wp.vec4], current: wp.array[wp.uint64], pixel: int) -> wp.vec4:
    """Return the colour that a frame blurs: at rest its own, which is of the very points that its depth is of."""
    c = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if view.rest > 0:
        c = unpack_halves(current[pixel])
    else:
        c = load_vec4(mean, pixel)
    if not wp.isfinite(c[0] + c[1] + c[2] + c[3]):
        c = wp.vec4(0.0, 0.0, 0.0, 1.0)
    return wp.vec4(wp.min(c[0], HALF_MAX), wp.min(c[1], HALF_MAX), wp.min(c[2], HALF_MAX), c[3])


@wp.kernel
def split_layers(
    first: int,
    # In:
    views: wp.array[View],
    lens: wp.array[float],
    mean: wp.array[wp.vec4],
    current: wp.array[wp.uint64],
    depth: wp.array[float],
    # Out:
    pyramid_out: Pyramid,
):
    """Write level 0: 80 bytes read (or 48) and 32 written a texel of 2 x 2 pixels."""
    texel = first + wp.tid()
    x = texel % pyramid_out.columns * 2
    y = texel // pyramid_out.columns * 2
    view = views[0]
    near = Layer()
    behind = Layer()
    octaves = wp.uint32(0)
    reach = wp.vec2(0.0, 0.0)
    for k in range(4):
        px = x + k % 2
        py = y + k // 2
        if px < pyramid_out.width and py < pyramid_out.height:
            r = circle_radius(lens, load_float(depth, py * pyramid_out.width + px), pyramid_out.largest)
            light = light_of(shown_color(view, mean, current, py * pyramid_out.width + px))
            if r < -WIDE_FROM:
                near = with_radius(near, -r, light)
            behind = with_radius(behind, r, light)
            if r > WIDE_FROM:
                octaves = octaves | (wp.uint32(1) << wp.uint32(octave(r)))
            if wp.abs(r) < WIDE_TO:
                reach[1] = wp.max(reach[1], wp.abs(r))
    reach[0] = near.largest
    for k in range(4):
        px = x + k % 2
        py = y + k // 2
        if px < pyramid_out.width and py < pyramid_out.height:
            pixel = py * pyramid_out.width + px
            r = circle_radius(lens, load_float(depth, pixel), pyramid_out.largest)
            share = float(0.0)
            if r < 0.0:
                share = wide_share(r)
            c = shown_color(view, mean, current, pixel)
            light = light_of(c)
            near = add_part(near, 0.25 * share, c, light, -r, 1.0)
            behind = add_part(behind, 0.25 * (1.0 - share), c, light, wp.max(r, 0.0), 1.0)
    store_texel(pyramid_out, texel, near, behind, reach, octaves)


@wp.kernel
def coarsen_layers(
    first: int,
    # In:
    level: int,
    # Out:
    pyramid_out: Pyramid,
):
    """Write a level from the one before it."""
    index = first + wp.tid()
    columns = level_columns(pyramid_out, level)
    finer_columns = level_columns(pyramid_out, level - 1)
    finer_rows = level_rows(pyramid_out, level - 1)
    finer = level_start(pyramid_out, level - 1)
    x = index % columns * 2
    y = index // columns * 2
    near = Layer()
    behind = Layer()
    octaves = wp.uint32(0)
    reach = wp.vec2(0.0, 0.0)
    for k in range(4):
        if x + k % 2 < finer_columns and y + k // 2 < finer_rows:
            child = finer + (y + k // 2) * finer_columns + x + k % 2
            near = with_radius(
                near, unpack_pair(pyramid_out.near_spread[child])[0], light_of(unpack_halves(pyramid_out.near[child])))
            behind = with_radius(
                behind, unpack_pair(pyramid_out.behind_spread[child])[0],
                light_of(unpack_halves(pyramid_out.behind[child])))
            octaves = octaves | pyramid_out.octaves[child]
            r = pyramid_out.reach[child]
            reach = wp.vec2(wp.max(reach[0], r[0]), wp.max(reach[1], r[1]))
    for k in range(4):
        if x + k % 2 < finer_columns and y + k // 2 < finer_rows:
            child = finer + (y + k // 2) * finer_columns + x + k % 2
            s = unpack_pair(pyramid_out.near_spread[child])
            c = unpack_halves(pyramid_out.near[child])
            near = add_part(near, 0.25, c, light_of(c), s[0], s[1])
            s = unpack_pair(pyramid_out.behind_spread[child])
            c = unpack_halves(pyramid_out.behind[child])
            behind = add_part(behind, 0.25, c, light_of(c), s[0], s[1])
    store_texel(pyramid_out, level_start(pyramid_out, level) + index, near, behind, reach, octaves)


@wp.func
def gap(low: int, side: int, other: int, other_side: int) -> float:
    """Return the distance between two stretches, given by their lower ends and lengths; 0 where they meet."""
    return float(wp.max(wp.max(other - (low + side), low - (other + other_side)), 0))


@wp.kernel
def find_reach(
    first: int,
    # In:
    pyramid: Pyramid,
    # Out:
    tiles_out: wp.array[wp.vec2],
    octaves_out: wp.array[wp.uint32],
):
    """Write for each tile how far to look for what is in front of the focus, at half and at full resolution [px].

    And which octaves of radii are around behind it.

    A texel of level i is 2^(i + 1) pixels wide, and so large are radii at most that are looked for in a tile's 3 x 3
    surroundings at this level; larger ones are found at coarser levels.
    """
    tile = first + wp.tid()
    columns = level_columns(pyramid, TILE_LEVEL)
    x = tile % columns
    y = tile // columns
    side = 2 << TILE_LEVEL
    found = wp.vec2(0.0, 0.0)
    octaves = wp.uint32(0)
    start = level_start(pyramid, TILE_LEVEL)
    for level in range(TILE_LEVEL, pyramid.levels + 1):
        across = level_columns(pyramid, level)
        rows = level_rows(pyramid, level)
        wide = 2 << level
        shift = level - TILE_LEVEL
        for k in range(9):
            i = (x >> shift) + k % 3 - 1
            j = (y >> shift) + k // 3 - 1
            if i >= 0 and j >= 0 and i < across and j < rows:
                r = pyramid.reach[start + j * across + i]
                dx = gap(x * side, side, i * wide, wide)
                dy = gap(y * side, side, j * wide, wide)
                # Edges are soft by up to two samples.
                if r[0] > found[0] and wp.sqrt(dx * dx + dy * dy) < 1.25 * r[0] + 2.0:
                    found[0] = r[0]
                bits = pyramid.octaves[start + j * across + i]
                # Radii of octave i are as wide as texels of level i at most.
                octaves = octaves | (bits & (wp.uint32(1) << wp.uint32(level)))
                if level == TILE_LEVEL:
                    octaves = octaves | (bits & wp.uint32(7))
                    found[1] = wp.max(found[1], r[1])
        start += across * rows
    tiles_out[tile] = found
    octaves_out[tile] = octaves
