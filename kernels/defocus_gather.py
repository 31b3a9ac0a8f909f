# SPDX-License-Identifier: GPL-3.0-or-later
"""Wide blur at half resolution: each texel gathers the light of those whose disks it lies in (scatter as gather).

A disk of r texels shows a texel's light by 1 / its area at each place (Jimenez 2014). All texels within the radius
are gathered, once each, at the level of detail where it is SEARCH at most: points of light become even disks, whatever
their size. Rows end where the circle does.
"""

from __future__ import annotations

import warp as wp

from .defocus import (
    COARSE_FROM,
    SEARCH,
    TILE_LEVEL,
    WIDE_FROM,
    Pyramid,
    circle_radius,
    disk_area,
    disk_share,
    level_columns,
    level_rows,
    level_start,
    octave,
    wide_share,
)
from .packed_halves import pack_halves, pack_pair, unpack_halves, unpack_pair
from .wide_loads import load_float, load_uint, load_word

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Variance of what comes on top of a disk, in squares of a texel of the level: that a texel is the mean over its square
# (1/12) and that a disk's edge is soft (5/48), each times 4; and in texels of level 0, the interpolation at full
# resolution (1/6, times 4).
LEVEL_SPREAD = wp.constant(0.75)
UPSCALE_SPREAD = wp.constant(0.6667)

# Light is in front of a texel's where its radius is below a half of the texel's, and with it from this share on.
IN_FRONT = wp.constant(0.5)
TOGETHER = wp.constant(0.8)


@wp.func
def search_level(radius: float, levels: int) -> int:
    """Return the level at which a radius [px] is SEARCH texels at most."""
    level = int(0)
    texels = 0.5 * radius
    while texels > SEARCH and level < levels:
        texels = 0.5 * texels
        level += 1
    return level


@wp.func
def own_radius(radius: float, scale: float, upscaled: float) -> float:
    """Return a disk's radius in texels of a level without what the level spreads by itself.

    `scale` is how many texels are a pixel, `upscaled` 1 where the result is interpolated and else 0.
    """
    r = radius * scale
    return wp.sqrt(wp.max(r * r - LEVEL_SPREAD - upscaled * UPSCALE_SPREAD * 4.0 * scale * scale, 0.25))


@wp.struct
class Disks:
    """Light behind the focus that arrives at a place."""

    front: wp.vec4
    """From well in front of what is seen there, times the share that it covers"""
    cover: float
    with_it: wp.vec4
    """From as far away, or further"""
    weight: float


@wp.func
def add_disks(
    disks: Disks, lens: wp.array[float], pyramid: Pyramid, px: float, py: float, radius: float, low: float,
    high: float, upscaled: float,
) -> Disks:
    """Add what has a radius from `low` to below `high` [px], where what is seen at a place [px] has another one."""
    d = disks
    widest = wp.min(radius, high)
    level = search_level(widest, pyramid.levels)
    # Texels of the level in a pixel.
    scale = 0.5 / float(1 << level)
    start = level_start(pyramid, level)
    columns = level_columns(pyramid, level)
    rows = level_rows(pyramid, level)
    x = px * scale - 0.5
    y = py * scale - 0.5
    across = own_radius(widest, scale, upscaled) + 0.5
    for j in range(wp.max(int(wp.ceil(y - across)), 0), wp.min(int(wp.floor(y + across)), rows - 1) + 1):
        dy = float(j) - y
        half = wp.sqrt(wp.max(across * across - dy * dy, 0.0))
        for i in range(wp.max(int(wp.ceil(x - half)), 0), wp.min(int(wp.floor(x + half)), columns - 1) + 1):
            place = start + j * columns + i
            s = unpack_pair(load_uint(pyramid.behind_spread, place))
            share = wide_share(s[0])
            if share * s[1] > 0.0 and s[0] >= low and s[0] < high:
                r = own_radius(wp.min(s[0], radius), scale, upscaled)
                w = share * disk_share(lens, r, x - float(i), -dy) / disk_area(lens, r)
                if w > 0.0:
                    before = wp.clamp((TOGETHER - s[0] / radius) / (TOGETHER - IN_FRONT), 0.0, 1.0)
                    c = unpack_halves(load_word(pyramid.behind, place))
                    d.front += (w * before) * c
                    d.cover += w * before * s[1]
                    d.with_it += (w * (1.0 - before)) * c
                    d.weight += w * (1.0 - before) * s[1]
    return d


@wp.func
def gather_disks(
    lens: wp.array[float], pyramid: Pyramid, px: float, py: float, radius: float, octaves: wp.uint32, upscaled: float,
) -> wp.vec4:
    """Return the light behind the focus that arrives at a place [px] where what is seen is blurred by a radius [px].

    Light from further behind is hidden by what is seen there but for where that is blurred away: it counts within
    the same radius. Light from in front is over it; where its disks are much smaller, and `octaves` has their bits,
    it is gathered at finer levels. Negative where there is none.
    """
    d = Disks()
    split = octave(TOGETHER * radius)
    low = float(1 << split)
    if octaves == wp.uint32(0):
        low = 0.0
    d = add_disks(d, lens, pyramid, px, py, radius, low, 1.0e6, upscaled)
    for i in range(1, split):
        if (octaves >> wp.uint32(i)) & wp.uint32(1) == wp.uint32(1):
            d = add_disks(d, lens, pyramid, px, py, radius, float(1 << i), float(2 << i), upscaled)
    result = wp.vec4(-1.0, 0.0, 0.0, 0.0)
    if d.cover > 1.0:
        d.front = d.front / d.cover
        d.cover = 1.0
    if d.weight > 0.0:
        result = d.front + d.with_it * ((1.0 - d.cover) / d.weight)
    elif d.cover > 0.0:
        result = d.front / d.cover
    return result


@wp.kernel
def gather_behind(
    first: int,
    # In:
    lens: wp.array[float],
    depth: wp.array[float],
    pyramid: Pyramid,
    octaves: wp.array[wp.uint32],
    # Out:
    blurred_out: wp.array[wp.uint64],
    radius_out: wp.array[float],
):
    """Blur what is far behind the focus, by the widest of a texel's pixels, whose radius [px] is written; 0: nothing.

    The texel's mean radius may be that of a bulb before them.
    """
    texel = first + wp.tid()
    x = texel % pyramid.columns * 2
    y = texel // pyramid.columns * 2
    radius = float(0.0)
    for k in range(4):
        if x + k % 2 < pyramid.width and y + k // 2 < pyramid.height:
            d = load_float(depth, (y + k // 2) * pyramid.width + x + k % 2)
            radius = wp.max(radius, circle_radius(lens, d, pyramid.largest))
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if radius > COARSE_FROM:
        tile = (y >> (TILE_LEVEL + 1)) * level_columns(pyramid, TILE_LEVEL) + (x >> (TILE_LEVEL + 1))
        result = gather_disks(lens, pyramid, float(x + 1), float(y + 1), radius, octaves[tile], 1.0)
        if result[0] < 0.0:
            radius = 0.0
    else:
        radius = 0.0
    blurred_out[texel] = pack_halves(result)
    radius_out[texel] = radius


@wp.struct
class Front:
    """What is far in front of the focus at a place, and what may be behind it."""

    near: wp.vec4
    """Its light, times the share that it covers"""
    cover: float
    filled: wp.vec4
    """Mean of what is seen around, the nearest by far the most; where nothing is in reach, the light in front itself"""


@wp.func
def gather_front(
    lens: wp.array[float], pyramid: Pyramid, px: float, py: float, radius: float, level: int, upscaled: float,
    filling: bool,
) -> Front:
    """Return the light in front of the focus that arrives at a place [px] from within a radius [px].

    `filling`: whether `filled` is wanted. Beyond the picture's edge what is in front goes on.
    """
    scale = 0.5 / float(1 << level)
    start = level_start(pyramid, level)
    columns = level_columns(pyramid, level)
    rows = level_rows(pyramid, level)
    x = px * scale - 0.5
    y = py * scale - 0.5
    across = wp.max(own_radius(radius, scale, upscaled), 1.0) + 0.5
    f = Front()
    f.near = wp.vec4(0.0, 0.0, 0.0, 0.0)
    f.filled = wp.vec4(0.0, 0.0, 0.0, 0.0)
    fill_weight = float(0.0)
    fill_radius = float(0.0)
    for j in range(int(wp.ceil(y - across)), int(wp.floor(y + across)) + 1):
        dy = float(j) - y
        half = wp.sqrt(wp.max(across * across - dy * dy, 0.0))
        row = start + wp.clamp(j, 0, rows - 1) * columns
        for i in range(int(wp.ceil(x - half)), int(wp.floor(x + half)) + 1):
            place = row + wp.clamp(i, 0, columns - 1)
            dx = float(i) - x
            s = unpack_pair(load_uint(pyramid.near_spread, place))
            if s[1] > 0.0:
                r = own_radius(s[0], scale, upscaled)
                w = disk_share(lens, r, dx, dy) / disk_area(lens, r)
                if w > 0.0:
                    f.near += w * unpack_halves(load_word(pyramid.near, place))
                    f.cover += w * s[1]
            if filling:
                s = unpack_pair(load_uint(pyramid.behind_spread, place))
                if s[1] > 0.0:
                    square = dx * dx + dy * dy + 0.25
                    w = 1.0 / (square * square)
                    f.filled += w * unpack_halves(load_word(pyramid.behind, place))
                    fill_weight += w * s[1]
                    fill_radius += w * s[1] * s[0]
    if f.cover > 1.0:
        f.near = f.near / f.cover
        f.cover = 1.0
    if fill_weight > 0.0:
        f.filled = f.filled / fill_weight
        # What is far behind the focus is as blurred there as beside it.
        fill_radius = fill_radius / fill_weight
        if fill_radius > WIDE_FROM:
            disks = gather_disks(lens, pyramid, px, py, fill_radius, wp.uint32(0), upscaled)
            if disks[0] >= 0.0:
                f.filled = wp.lerp(f.filled, disks, wide_share(fill_radius))
    else:
        f.filled = f.near / wp.max(f.cover, 1.0e-6)
    return f


@wp.kernel
def gather_near(
    first: int,
    # In:
    lens: wp.array[float],
    pyramid: Pyramid,
    tiles: wp.array[wp.vec2],
    # Out:
    near_out: wp.array[wp.uint64],
    cover_out: wp.array[wp.uint32],
    filled_out: wp.array[wp.uint64],
):
    """Blur what is far in front of the focus; nothing where pixels do so themselves."""
    texel = first + wp.tid()
    x = texel % pyramid.columns
    y = texel // pyramid.columns
    radius = tiles[(y >> TILE_LEVEL) * level_columns(pyramid, TILE_LEVEL) + (x >> TILE_LEVEL)][0]
    f = Front()
    has_fill = float(0.0)
    if radius > COARSE_FROM:
        filling = unpack_pair(load_uint(pyramid.near_spread, texel))[1] > 0.0
        f = gather_front(
            lens, pyramid, float(2 * x + 1), float(2 * y + 1), radius, search_level(radius, pyramid.levels), 1.0,
            filling)
        has_fill = wp.where(filling, 1.0, 0.0)
    near_out[texel] = pack_halves(f.near)
    cover_out[texel] = pack_pair(f.cover, has_fill)
    filled_out[texel] = pack_halves(f.filled)
