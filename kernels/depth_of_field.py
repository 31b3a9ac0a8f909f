# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of field of a frame: slight blur at full resolution, wide blur from half resolution, and their mean at rest.

The order is that of depth: what is blurred as widely as the pixel, over it what is a little out of focus in front of
it, over that what is far in front of the focus.
"""

from __future__ import annotations

import warp as wp

from .debug_colors import signed_color
from .defocus import (
    COARSE_FROM,
    COARSE_TO,
    SHARP,
    TILE_LEVEL,
    WIDE_TO,
    Pyramid,
    circle_radius,
    disk_area,
    disk_share,
    level_columns,
    wide_share,
)
from .defocus_gather import Front, gather_disks, gather_front
from .defocus_layers import shown_color
from .packed_halves import unpack_halves, unpack_pair
from .packing import rgba
from .view import View
from .wide_loads import load_float, load_uint, load_word
from .wide_stores import store_vec4

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Variance of a disk's soft edge (5/48 of a square pixel) times 4, the square of SHARP: disks are made smaller by it.
EDGE_SPREAD = wp.constant(0.41667)

# Difference of two radii [px] from which light is in front of a pixel's, and where it is so entirely.
FRONT_FROM = wp.constant(0.1)
FRONT_TO = wp.constant(0.6)

# What a texel of level 0 counts whose radius differs: (1 + (difference / (LIKE * radius + 0.5))^2)^-2.
LIKE = wp.constant(0.25)

# What a texel of four weighs at least: it may be the only one that has what is wanted.
LEAST_WEIGHT = wp.constant(1.0e-4)


@wp.struct
class Blurred:
    """What is blurred at half resolution, one entry a texel of level 0; see defocus_gather.py."""

    behind: wp.array[wp.uint64]
    radius: wp.array[float]
    near: wp.array[wp.uint64]
    cover: wp.array[wp.uint32]
    filled: wp.array[wp.uint64]
    tiles: wp.array[wp.vec2]


@wp.struct
class Slight:
    """What a pixel gathers at full resolution."""

    own: wp.vec4
    """Sum of light as far away as the pixel's or further"""
    weight: float
    front: wp.vec4
    """Light in front of it, times the share that it covers"""
    cover: float


@wp.struct
class Corner:
    """The four texels of level 0 around a pixel."""

    x: int
    y: int
    """The first one's, perhaps -1"""
    u: float
    v: float
    """How far the pixel is towards the others, 0..1"""


@wp.func
def slight_radius(radius: float) -> float:
    """Return the radius of a disk [px] without what its soft edge spreads by itself."""
    return wp.sqrt(wp.max(radius * radius - EDGE_SPREAD, 0.0))


@wp.func
def gather_slight(
    view: View, lens: wp.array[float], mean: wp.array[wp.vec4], current: wp.array[wp.uint64], depth: wp.array[float],
    pyramid: Pyramid, x: int, y: int, radius: float, reach: float,
) -> Slight:
    """Gather what is blurred by WIDE_TO pixels at most around a pixel of some signed radius, within a reach [px]."""
    s = Slight()
    s.own = wp.vec4(0.0, 0.0, 0.0, 0.0)
    s.front = wp.vec4(0.0, 0.0, 0.0, 0.0)
    n = int(slight_radius(wp.min(reach, WIDE_TO)) + 0.5)
    wide = wide_share(radius)
    for j in range(wp.max(y - n, 0), wp.min(y + n, pyramid.height - 1) + 1):
        for i in range(wp.max(x - n, 0), wp.min(x + n, pyramid.width - 1) + 1):
            q = j * pyramid.width + i
            r = circle_radius(lens, load_float(depth, q), pyramid.largest)
            before = wp.clamp((radius - r - FRONT_FROM) / (FRONT_TO - FRONT_FROM), 0.0, 1.0)
            size = wp.abs(r)
            share = float(1.0)
            if r >= radius:
                # Light from further behind is hidden but for where the pixel's own is blurred away.
                size = wp.min(size, wp.abs(radius))
            else:
                share = 1.0 - wide_share(r)
                # What the pixel is itself comes from half resolution.
                before += wide * (1.0 - before)
            if share > 0.0 and (wide < 1.0 or before > 0.0):
                size = slight_radius(size)
                dx = float(x - i)
                dy = float(y - j)
                if r < 0.0:
                    dx = -dx
                    dy = -dy
                w = share * disk_share(lens, size, dx, dy) / disk_area(lens, size)
                if w > 0.0:
                    c = shown_color(view, mean, current, q)
                    s.own += (w * (1.0 - before)) * c
                    s.weight += w * (1.0 - before)
                    s.front += (w * before) * c
                    s.cover += w * before
    if s.cover > 1.0:
        s.front = s.front / s.cover
        s.cover = 1.0
    return s


@wp.func
def corner_weight(corner: Corner, k: int) -> float:
    """Return the bilinear weight of one of the four texels."""
    u = wp.where(k % 2 == 1, corner.u, 1.0 - corner.u)
    v = wp.where(k // 2 == 1, corner.v, 1.0 - corner.v)
    return u * v


@wp.func
def corner_texel(corner: Corner, pyramid: Pyramid, k: int) -> int:
    """Return the index of one of the four texels; the edge repeats."""
    return (wp.clamp(corner.y + k // 2, 0, pyramid.rows - 1) * pyramid.columns
            + wp.clamp(corner.x + k % 2, 0, pyramid.columns - 1))


@wp.func
def light_behind(
    lens: wp.array[float], pyramid: Pyramid, blurred: Blurred, corner: Corner, x: int, y: int, radius: float,
    color: wp.vec4,
) -> wp.vec4:
    """Return the wide blur of a pixel behind the focus; `color` stands in where there is none.

    Of what half resolution has blurred, texels count that are blurred as the pixel is.
    """
    result = color
    if radius > COARSE_FROM:
        total = wp.vec4(0.0, 0.0, 0.0, 0.0)
        weights = float(0.0)
        for k in range(4):
            texel = corner_texel(corner, pyramid, k)
            found = load_float(blurred.radius, texel)
            if found > 0.0:
                d = (found - radius) / (LIKE * radius + 0.5)
                like = 1.0 / (1.0 + d * d)
                w = (corner_weight(corner, k) + LEAST_WEIGHT) * like * like
                total += w * unpack_halves(load_word(blurred.behind, texel))
                weights += w
        if weights > 0.0:
            result = total / weights
    if radius < COARSE_TO:
        fine = gather_disks(lens, pyramid, float(x) + 0.5, float(y) + 0.5, radius, wp.uint32(0), 0.0)
        if fine[0] >= 0.0:
            result = wp.lerp(fine, result, wp.max(radius - COARSE_FROM, 0.0) / (COARSE_TO - COARSE_FROM))
    return result


@wp.func
def light_in_front(
    lens: wp.array[float], pyramid: Pyramid, blurred: Blurred, corner: Corner, x: int, y: int, reach: float,
    filling: bool, color: wp.vec4,
) -> Front:
    """Return what is far in front of the focus, from within a reach [px]; `color` fills where nothing else does."""
    f = Front()
    if reach > COARSE_FROM:
        fills = wp.vec4(0.0, 0.0, 0.0, 0.0)
        weights = float(0.0)
        for k in range(4):
            texel = corner_texel(corner, pyramid, k)
            w = corner_weight(corner, k)
            cover = unpack_pair(load_uint(blurred.cover, texel))
            f.near += w * unpack_halves(load_word(blurred.near, texel))
            f.cover += w * cover[0]
            if filling and cover[1] > 0.0:
                fills += (w + LEAST_WEIGHT) * unpack_halves(load_word(blurred.filled, texel))
                weights += w + LEAST_WEIGHT
        f.filled = color
        if weights > 0.0:
            f.filled = fills / weights
    if reach < COARSE_TO:
        fine = gather_front(lens, pyramid, float(x) + 0.5, float(y) + 0.5, reach, 0, 0.0, filling)
        share = wp.max(reach - COARSE_FROM, 0.0) / (COARSE_TO - COARSE_FROM)
        f.near = wp.lerp(fine.near, f.near, share)
        f.cover = wp.lerp(fine.cover, f.cover, share)
        f.filled = wp.lerp(fine.filled, f.filled, share)
    f.cover = wp.min(f.cover, 1.0)
    return f


@wp.kernel
def blur_frame(
    first: int,
    # In:
    views: wp.array[View],
    lens: wp.array[float],
    mean: wp.array[wp.vec4],
    current: wp.array[wp.uint64],
    samples: wp.array[wp.uint16],
    depth: wp.array[float],
    pyramid: Pyramid,
    blurred: Blurred,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Write the picture: in motion the mean so far, blurred; at rest the mean of the frames, each blurred by itself.

    Edges of what is in focus are then as smooth as without blur: a frame's depth is that of single points. Reads 36
    bytes a pixel in focus, writes 16.
    """
    pixel = first + wp.tid()
    view = views[0]
    x = pixel % pyramid.width
    y = pixel // pyramid.width
    radius = circle_radius(lens, load_float(depth, pixel), pyramid.largest)
    tile = blurred.tiles[
        (y >> (TILE_LEVEL + 1)) * level_columns(pyramid, TILE_LEVEL) + (x >> (TILE_LEVEL + 1))]
    color = shown_color(view, mean, current, pixel)
    result = color
    corner = Corner()
    corner.x = (x - 1) >> 1
    corner.y = (y - 1) >> 1
    corner.u = 0.75 - 0.5 * float(x & 1)
    corner.v = 0.75 - 0.5 * float(y & 1)
    share = wide_share(radius)
    slight = Slight()
    if tile[1] > SHARP:
        slight = gather_slight(view, lens, mean, current, depth, pyramid, x, y, radius, tile[1])
        if slight.weight > 0.0:
            result = slight.own / slight.weight
    front = Front()
    if tile[0] > 0.0:
        front = light_in_front(
            lens, pyramid, blurred, corner, x, y, tile[0], share > 0.0 and radius < 0.0, color)
    if share > 0.0:
        wide = front.filled
        if radius > 0.0:
            wide = light_behind(lens, pyramid, blurred, corner, x, y, radius, color)
        result += share * (wide - result)
    if slight.cover > 0.0:
        result = slight.front + (1.0 - slight.cover) * result
    if tile[0] > 0.0:
        result = front.near + (1.0 - front.cover) * result
    if view.rest > 0:
        before = picture_out[pixel]
        result = before + (result - before) / float(samples[pixel])
    store_vec4(picture_out, pixel, result)


@wp.kernel
def show_radius(
    first: int,
    # In:
    lens: wp.array[float],
    depth: wp.array[float],
    largest: float,
    white: float,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw the signed radius of the circles of confusion, darkest at `white` [px]."""
    pixel = first + wp.tid()
    picture_out[pixel] = rgba(signed_color(-circle_radius(lens, depth[pixel], largest) / white), 1.0)
