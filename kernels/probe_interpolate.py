# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: the light of each pixel between them (GI-1.0, section 3.10), diffuse and from rough reflections.

A probe sees nothing below its own plane, so for a pixel whose normal leans away its harmonics fall short of a white sky
by (1 + cos) / 2; dividing by the interpolated same makes every white sky exact. The light of a reflection lobe is the
same sum with other factors for each band (lobe_moments.py).
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, Surface, has_surface, load_material, load_surface, plane_distance, view_direction
from .geometry_math import luminance
from .lobe_moments import reflection_lobe
from .packed_halves import unpack_halves
from .packing import rgb, to_half, unpack_floats, unpack_normal
from .probe_gather import neighbour_tile
from .probe_map import CORRECTION_COSINE, COSINE_1, COSINE_2, cell_of, to_local
from .probe_records import RECORD, RECORD_BANDS, WorldBands, world_basis
from .probe_spawn import SEPARATION, probe_cell
from .probe_types import CELLS, TILE, ProbeGrid, ProbePool, ProbeTiles
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Reach [px] of probes in the 3 x 3 tiles around a pixel: as far as all of them are sure to be seen, so that nothing
# jumps at the tiles' borders.
REACH = wp.constant(8.5)
WIDE_REACH = wp.constant(20.0)
WIDEST = wp.constant(3)
"""Tiles to each side in which a pixel without any fitting probe looks for one"""

# Least share of a white sky that the interpolated harmonics are taken to hold: bounds the normalisation.
LEAST_SHARE = wp.constant(0.25)

# Weight below which the sums have no more precision: such pixels look farther.
LEAST_WEIGHT = wp.constant(1.0e-4)

# Confidence that marks a pixel for fill_gaps.
UNFILLED = wp.constant(-1.0)

RATIO_MAX = wp.constant(8.0)


@wp.struct
class Place:
    """What a pixel asks the probes for."""

    surface: Surface
    x: float
    """On the full film [px]"""
    y: float
    cell: float
    """Width of a tile at the surface [m]"""
    diffuse: WorldBands
    """Basis at the shading normal"""
    lobe: WorldBands
    """Basis along the reflection lobe's axis, with its moments"""
    lobe_mean: wp.vec3


@wp.struct
class Blend:
    """Weighted sums over probes."""

    light: wp.vec3
    """Exposed irradiance / pi"""
    share: float
    """What a white sky gives for it"""
    specular: float
    """Luminance of the exposed light that arrives along the lobe"""
    specular_share: float


@wp.func
def bare_place(view: View, grid: ProbeGrid, s: Surface, pixel: int) -> Place:
    """Return where a pixel lies: what `record_weight` needs."""
    p = Place()
    p.surface = s
    p.x = float(view.camera.crop_x + pixel % grid.width) + 0.5
    p.y = float(view.camera.crop_y + pixel // grid.width) + 0.5
    p.cell = probe_cell(view, s.depth)
    return p


@wp.func
def place_of(
    view: View, grid: ProbeGrid, gbuffer: GBuffer, moments: wp.array[wp.uint64], s: Surface, pixel: int,
) -> Place:
    """Return what a pixel asks for."""
    p = bare_place(view, grid, s, pixel)
    p.diffuse = world_basis(s.normal, 1.0, 1.0)
    p.lobe = p.diffuse
    p.lobe_mean = s.normal * COSINE_1
    if gbuffer.specular[pixel] != wp.uint32(0):
        m = load_material(gbuffer, pixel)
        lobe = reflection_lobe(
            moments, s.normal, view_direction(view, s), m.roughness, luminance(m.f0, grid.luminance), m.f90)
        # Where the shading normal leans so far that it mirrors the surface itself, the horizon is seen.
        axis = wp.normalize(lobe.axis - s.geometric_normal * wp.min(wp.dot(lobe.axis, s.geometric_normal), 0.0))
        p.lobe = world_basis(axis, lobe.first / COSINE_1, lobe.second / COSINE_2)
        p.lobe_mean = axis * lobe.first
    return p


@wp.func
def empty_blend() -> Blend:
    """Return sums over nothing."""
    b = Blend()
    b.light = wp.vec3(0.0, 0.0, 0.0)
    b.share = 0.0
    b.specular = 0.0
    b.specular_share = 0.0
    return b


@wp.func
def hidden(pool: ProbePool, slot: int, n: wp.vec3, offset: wp.vec3, distance: float) -> bool:
    """Return whether the probe sees something before a point at an offset (probe_spawn.separated, beyond `clear`)."""
    seen = float(pool.radiance[slot * CELLS + cell_of(to_local(n, offset / distance))][3])
    return seen < SEPARATION * distance


@wp.func
def record_weight(records: wp.array[wp.uint64], base: int, pool: ProbePool, p: Place, reach: float) -> float:
    """Return how well a recorded probe fits a pixel: near on the screen, on the same plane, with nothing between."""
    film = unpack_floats(records[base])
    w = wp.max(1.0 - wp.abs(film[0] - p.x) / reach, 0.0) * wp.max(1.0 - wp.abs(film[1] - p.y) / reach, 0.0)
    if w == 0.0:
        return 0.0
    xy = unpack_floats(records[base + 1])
    zc = unpack_floats(records[base + 2])
    facing = records[base + 3]
    center = wp.vec3(xy[0], xy[1], zc[0])
    n = unpack_normal(wp.uint32(facing & wp.uint64(0xFFFFFFFF)))
    plane = wp.max(1.0 - plane_distance(p.surface, center) / p.cell, 0.0)
    cosine = wp.max(wp.dot(p.surface.geometric_normal, n), 0.0)
    if plane * cosine == 0.0:
        return 0.0
    offset = p.surface.position - center
    distance = wp.length(offset)
    if SEPARATION * distance > zc[1] and distance >= 1.0e-9:
        if hidden(pool, int(facing >> wp.uint64(32)), n, offset, distance):
            return 0.0
    c2 = cosine * cosine
    c4 = c2 * c2
    return w * plane * plane * c4 * c4


@wp.func
def add_record(
    records: wp.array[wp.uint64], base: int, grid: ProbeGrid, p: Place, weight: float, total: Blend,
) -> Blend:
    """Add a recorded probe to weighted sums."""
    n = unpack_normal(wp.uint32(records[base + 3] & wp.uint64(0xFFFFFFFF)))
    cosine = wp.dot(p.surface.normal, n)
    mean = unpack_halves(records[base + RECORD_BANDS])
    w = weight * mean[3]
    correction = wp.max(cosine - CORRECTION_COSINE, 0.0) / (1.0 - CORRECTION_COSINE)
    light = rgb(unpack_halves(records[base + RECORD_BANDS + 9])) * correction + rgb(mean)
    specular = luminance(rgb(mean), grid.luminance)
    for k in range(1, 9):
        c = unpack_halves(records[base + RECORD_BANDS + k])
        light = light + rgb(c) * p.diffuse[k]
        specular = specular + c[3] * p.lobe[k]
    share = float(1.0)
    specular_share = float(1.0)
    if grid.exact == 1:
        share = wp.max(0.5 + 0.5 * cosine, LEAST_SHARE)
        specular_share = wp.max(0.5 + 0.75 * wp.dot(p.lobe_mean, n), LEAST_SHARE)
    b = Blend()
    b.light = total.light + light * w
    b.share = total.share + share * w
    b.specular = total.specular + specular * w
    b.specular_share = total.specular_share + specular_share * w
    return b


@wp.func
def blend_around(
    grid: ProbeGrid, records: wp.array[wp.uint64], pool: ProbePool, p: Place, tile: int, radius: int, reach: float,
) -> Blend:
    """Return weighted sums over the fitting probes of the tiles around one."""
    total = empty_blend()
    side = 2 * radius + 1
    i = int(0)
    while i < side * side:
        other = neighbour_tile(grid, tile, i % side - radius, i // side - radius)
        i = i + 1
        if other >= 0:
            base = other * (2 * RECORD)
            w = record_weight(records, base, pool, p, reach)
            if w == 0.0:
                base = base + RECORD
                w = record_weight(records, base, pool, p, reach)
            if w > 0.0:
                total = add_record(records, base, grid, p, w, total)
    return total


@wp.func
def nearest_tile(grid: ProbeGrid, pool: ProbePool, tiles: ProbeTiles, s: Surface, tile: int, cell: float) -> int:
    """Return the tile of the probe that fits best in the wider surroundings, however badly; -1: none."""
    best = int(-1)
    least = float(1.0e30)
    side = 2 * WIDEST + 1
    i = int(0)
    while i < side * side:
        other = neighbour_tile(grid, tile, i % side - WIDEST, i // side - WIDEST)
        i = i + 1
        if other >= 0:
            slot = tiles.probe[other]
            if slot >= 0:
                offset = pool.position[slot] - s.position
                cosine = wp.dot(s.geometric_normal, unpack_normal(pool.normal[slot]))
                # Off the plane counts more than along it: behind an edge lies another room.
                badness = wp.length(offset) + 4.0 * wp.abs(wp.dot(s.geometric_normal, offset)) + 8.0 * cell * (
                    1.0 - cosine)
                if cosine > 0.0 and badness < least:
                    least = badness
                    best = other
    return best


@wp.func
def diffuse_light(b: Blend, confidence: float) -> wp.vec4h:
    """Return exposed irradiance / pi, never negative, and its confidence."""
    scale = float(0.0)
    if b.share > 0.0:
        scale = 1.0 / b.share
    return to_half(wp.vec4(
        wp.max(b.light[0] * scale, 0.0), wp.max(b.light[1] * scale, 0.0), wp.max(b.light[2] * scale, 0.0),
        confidence))


@wp.func
def specular_ratio(b: Blend, weights: wp.vec3) -> wp.float16:
    """Return the light of the reflection lobe by the diffuse light, 0..8; 1 where there is none of both."""
    light = luminance(b.light, weights) * b.specular_share
    specular = wp.max(b.specular, 0.0) * b.share
    if not light > 1.0e-12:
        return wp.float16(1.0)
    return wp.float16(wp.min(specular / light, RATIO_MAX))


@wp.kernel(cuda_max_registers=72)
def interpolate_probes(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    records: wp.array[wp.uint64],
    pool: ProbePool,
    moments: wp.array[wp.uint64],
    # Out:
    irradiance_out: wp.array[wp.vec4h],
    ratio_out: wp.array[wp.float16],
):
    """Interpolate the light of a pixel: exposed irradiance / pi at the shading normal, and that of reflections by it.

    64 threads a tile, so that a warp asks for the same probes. Confidence is 1 where probes of the same surface are
    near; where there are none it is UNFILLED, for fill_gaps.
    """
    index = first + wp.tid()
    tile = index // CELLS
    px = tile % grid.tile_columns * TILE + index % TILE
    py = tile // grid.tile_columns * TILE + index % CELLS // TILE
    if px >= grid.width or py >= grid.height:
        return
    pixel = py * grid.width + px
    view = views[0]
    s = load_surface(view, gbuffer, grid.width, pixel)
    if not has_surface(s):
        irradiance_out[pixel] = wp.vec4h(wp.float16(0.0), wp.float16(0.0), wp.float16(0.0), wp.float16(0.0))
        ratio_out[pixel] = wp.float16(1.0)
        return
    p = place_of(view, grid, gbuffer, moments, s, pixel)
    total = blend_around(grid, records, pool, p, tile, 1, REACH)
    irradiance_out[pixel] = diffuse_light(total, wp.where(total.share < LEAST_WEIGHT, UNFILLED, 1.0))
    ratio_out[pixel] = specular_ratio(total, grid.luminance)


@wp.kernel
def fill_gaps(
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    records: wp.array[wp.uint64],
    tiles: ProbeTiles,
    pool: ProbePool,
    moments: wp.array[wp.uint64],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    irradiance_out: wp.array[wp.vec4h],
    ratio_out: wp.array[wp.float16],
):
    """Give listed pixels that interpolate_probes left out the light of probes farther off.

    Confidence is 0.5 where they are on the same surface, 0 where the value comes from another one or there is none.
    """
    i = wp.tid()
    while i < count[0]:
        pixel = queue[i]
        i = i + stride
        if float(irradiance_out[pixel][3]) < 0.0:
            view = views[0]
            s = load_surface(view, gbuffer, grid.width, pixel)
            p = place_of(view, grid, gbuffer, moments, s, pixel)
            tile = (pixel // grid.width // TILE) * grid.tile_columns + pixel % grid.width // TILE
            confidence = float(0.5)
            total = blend_around(grid, records, pool, p, tile, 2, WIDE_REACH)
            if total.share < LEAST_WEIGHT:
                confidence = 0.0
                nearest = nearest_tile(grid, pool, tiles, s, tile, p.cell)
                total = empty_blend()
                if nearest >= 0:
                    total = add_record(records, nearest * (2 * RECORD), grid, p, 1.0, total)
            irradiance_out[pixel] = diffuse_light(total, confidence)
            ratio_out[pixel] = specular_ratio(total, grid.luminance)
