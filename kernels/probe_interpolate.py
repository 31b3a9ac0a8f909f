# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: the light of each pixel between them (GI-1.0, section 3.10), diffuse and from rough reflections.

A probe sees nothing below its own plane, so for a pixel whose normal leans away its harmonics fall short of a white sky
by (1 + cos) / 2; dividing by the interpolated same makes every white sky exact. The light of a reflection lobe is the
same sum with other factors (lobe_moments.py).
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, Surface, has_surface, load_material, load_surface, plane_distance, view_direction
from .geometry_math import luminance
from .interpolation_turns import InterpolatedBefore, kept_light, known_pixel
from .list_order import first_dealt
from .lobe_moments import lobe_bands
from .normals import valid_specular_normal
from .packed_halves import unpack_pairs
from .packing import rgb, to_half, unpack_normal
from .probe_gather import in_tiles
from .probe_map import CORRECTION_COSINE, cell_of, to_local
from .probe_records import RECORD, RECORD_BANDS, RECORD_CENTER, RECORD_NORMAL, WorldBands, world_basis
from .probe_spawn import LAYER_SHARE, SEPARATION, probe_cell, surface_distance
from .probe_types import CELLS, TILE, ProbeGrid, ProbePool, ProbeTiles
from .view import View, film_centre
from .wide_loads import load_piece, load_view
from .wide_stores import store_vec4h

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Reach [px] of probes in the 3 x 3 tiles around a pixel: as far as all of them are sure to be seen, so that nothing
# jumps at the tiles' borders.
REACH = wp.constant(8.5)
WIDE_REACH = wp.constant(20.0)
WIDEST = wp.constant(3)
"""Tiles to each side in which a pixel without any fitting probe looks for one"""
WIDE_SIDE = wp.constant(7)
"""Tiles from side to side"""

# Least share of a white sky that the interpolated harmonics are taken to hold: bounds the normalisation.
LEAST_SHARE = wp.constant(0.25)

# Weight below which the sums have no more precision: such pixels look farther.
LEAST_WEIGHT = wp.constant(1.0e-4)

# Cosine between its normal and that of a probe that a pixel takes light from where no other is near: a wall's probe
# knows half of what arrives at a sliver of the ceiling, and the harmonics are divided by the share that it sees.
FARTHEST_COSINE = wp.constant(-0.5)

# Confidence that marks a pixel for fill_gaps.
UNFILLED = wp.constant(-1.0)

# How fast probes lose weight across the surface, from LAYER_SHARE on, and what is left of it: where there is nothing
# else, they count.
LAYER_STEEP = wp.constant(10.0)
LAYER_LEAST = wp.constant(0.01)

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
    """The same for the reflection lobe"""


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
    centre = film_centre(view, grid.width, pixel)
    p.x = centre[0]
    p.y = centre[1]
    p.cell = probe_cell(view, s.depth)
    return p


@wp.func
def place_of(
    view: View, grid: ProbeGrid, gbuffer: GBuffer, moments: wp.array[wp.uint64], s: Surface, pixel: int,
) -> Place:
    """Return what a pixel asks for."""
    p = bare_place(view, grid, s, pixel)
    p.diffuse = world_basis(s.normal)
    p.lobe = p.diffuse
    if gbuffer.specular[pixel] != wp.uint32(0):
        m = load_material(gbuffer, pixel)
        wo = view_direction(view, s)
        # Where the shading normal leans so far that it mirrors the surface itself, the horizon is seen.
        n = valid_specular_normal(s.geometric_normal, wo, s.normal)
        p.lobe = lobe_bands(moments, n, wo, m.roughness, luminance(m.f0, grid.luminance), m.f90)
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
def record_weight(
    records: wp.array[wp.uint64], base: int, film: wp.vec4ui, pool: ProbePool, p: Place, reach: float,
) -> wp.vec4:
    """Return how well a recorded probe fits a pixel: near on the screen, on the same plane, with nothing between.

    In detail:
        base: First piece of the record.
        film: That piece.
        returns: Weight; the probe's normal, valid where the weight is above 0.
    """
    none = wp.vec4(0.0, 0.0, 0.0, 0.0)
    w = wp.max(1.0 - wp.abs(wp.cast(film[0], float) - p.x) / reach, 0.0)
    w = w * wp.max(1.0 - wp.abs(wp.cast(film[1], float) - p.y) / reach, 0.0)
    if w == 0.0:
        return none
    place = load_piece(records, base + RECORD_CENTER)
    rest = load_piece(records, base + RECORD_NORMAL)
    center = wp.vec3(wp.cast(place[0], float), wp.cast(place[1], float), wp.cast(place[2], float))
    n = wp.vec3(wp.cast(place[3], float), wp.cast(rest[0], float), wp.cast(rest[1], float))
    plane = wp.max(1.0 - plane_distance(p.surface, center) / p.cell, 0.0)
    cosine = wp.max(wp.dot(p.surface.geometric_normal, n), 0.0)
    if plane * cosine == 0.0:
        return none
    offset = p.surface.position - center
    distance = wp.length(offset)
    if SEPARATION * distance > wp.cast(film[2], float) and distance >= 1.0e-9:
        if hidden(pool, int(film[3]), n, offset, distance):
            return none
    layer = surface_distance(p.surface.geometric_normal, n, offset) / (LAYER_SHARE * p.cell)
    layer = layer * layer
    w = w * wp.max(1.0 / (1.0 + layer * layer * LAYER_STEEP), LAYER_LEAST)
    c2 = cosine * cosine
    c4 = c2 * c2
    return wp.vec4(w * plane * plane * c4 * c4, n[0], n[1], n[2])


@wp.func
def record_normal(records: wp.array[wp.uint64], base: int) -> wp.vec3:
    """Return the normal of a recorded probe."""
    rest = load_piece(records, base + RECORD_NORMAL)
    return wp.vec3(
        wp.cast(load_piece(records, base + RECORD_CENTER)[3], float), wp.cast(rest[0], float), wp.cast(rest[1], float))


@wp.func
def add_record(
    records: wp.array[wp.uint64], base: int, grid: ProbeGrid, p: Place, weight: float, n: wp.vec3, total: Blend,
) -> Blend:
    """Add a recorded probe, whose normal is n, to weighted sums."""
    cosine = wp.dot(p.surface.normal, n)
    piece = load_piece(records, base + RECORD_BANDS)
    mean = unpack_pairs(piece[0], piece[1])
    c = unpack_pairs(piece[2], piece[3])
    last = load_piece(records, base + RECORD_BANDS + 4)
    w = weight * mean[3]
    correction = wp.max(cosine - CORRECTION_COSINE, 0.0) / (1.0 - CORRECTION_COSINE)
    light = rgb(unpack_pairs(last[2], last[3])) * correction + rgb(mean)
    light = light + rgb(c) * p.diffuse[1]
    specular = luminance(rgb(mean), grid.luminance) * p.lobe[0] + c[3] * p.lobe[1]
    for k in range(1, 4):
        piece = load_piece(records, base + RECORD_BANDS + k)
        c = unpack_pairs(piece[0], piece[1])
        light = light + rgb(c) * p.diffuse[2 * k]
        specular = specular + c[3] * p.lobe[2 * k]
        c = unpack_pairs(piece[2], piece[3])
        light = light + rgb(c) * p.diffuse[2 * k + 1]
        specular = specular + c[3] * p.lobe[2 * k + 1]
    c = unpack_pairs(last[0], last[1])
    light = light + rgb(c) * p.diffuse[8]
    specular = specular + c[3] * p.lobe[8]
    share = float(1.0)
    specular_share = float(1.0)
    if grid.exact == 1:
        share = wp.max(0.5 + 0.5 * cosine, LEAST_SHARE)
        lobe = p.lobe[1] * n[0] + p.lobe[2] * n[1] + p.lobe[3] * n[2]
        specular_share = wp.max(0.5 * p.lobe[0] + 0.5 * lobe, LEAST_SHARE)
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
    column = tile % grid.tile_columns
    row = tile // grid.tile_columns
    i = -radius
    j = -radius
    while j <= radius:
        if in_tiles(grid, column + i, row + j):
            base = ((row + j) * grid.tile_columns + column + i) * (2 * RECORD)
            # Both are read before either is judged: they wait for memory together.
            film = load_piece(records, base)
            other = load_piece(records, base + RECORD)
            found = record_weight(records, base, film, pool, p, reach)
            second = record_weight(records, base + RECORD, other, pool, p, reach)
            if second[0] > found[0]:
                base = base + RECORD
                found = second
            if found[0] > 0.0:
                total = add_record(
                    records, base, grid, p, found[0], wp.vec3(found[1], found[2], found[3]), total)
        i = i + 1
        if i > radius:
            i = -radius
            j = j + 1
    return total


@wp.func
def nearest_tile(grid: ProbeGrid, pool: ProbePool, tiles: ProbeTiles, s: Surface, tile: int, cell: float) -> int:
    """Return the tile of the probe that fits best in the wider surroundings, however badly; -1: none."""
    best = int(-1)
    least = float(1.0e30)
    column = tile % grid.tile_columns
    row = tile // grid.tile_columns - WIDEST
    last = row + 2 * WIDEST
    while row <= last:
        # Without branches, so that a row's probes wait for memory together.
        for i in range(WIDE_SIDE):
            across = column + i - WIDEST
            there = in_tiles(grid, across, row)
            other = wp.where(there, row * grid.tile_columns + across, tile)
            slot = tiles.probe[other]
            known = wp.max(slot, 0)
            offset = pool.position[known] - s.position
            cosine = wp.dot(s.geometric_normal, unpack_normal(pool.normal[known]))
            # Off the plane counts more than along it: behind an edge lies another room.
            badness = wp.length(offset) + 4.0 * wp.abs(wp.dot(s.geometric_normal, offset)) + 8.0 * cell * (
                1.0 - cosine)
            better = there and slot >= 0 and cosine > FARTHEST_COSINE and badness < least
            least = wp.where(better, badness, least)
            best = wp.where(better, other, best)
        row = row + 1
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


@wp.kernel(cuda_max_registers=64)
def interpolate_probes(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    records: wp.array[wp.uint64],
    pool: ProbePool,
    moments: wp.array[wp.uint64],
    before: InterpolatedBefore,
    listing: int,
    # Out:
    irradiance_out: wp.array[wp.vec4h],
    ratio_out: wp.array[wp.float16],
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Interpolate the light of a pixel: exposed irradiance / pi at the shading normal, and that of reflections by it.

    64 threads a tile, so that a warp asks for the same probes. Confidence is 1 where probes of the same surface are
    near; where there are none it is UNFILLED, for fill_gaps, and KEPT where a pixel leaves its turn out. With `listing`
    the former are appended to a list (CUDA only: in one launch).
    """
    index = first + wp.tid()
    tile = index // CELLS
    px = tile % grid.tile_columns * TILE + index % TILE
    py = tile // grid.tile_columns * TILE + index % CELLS // TILE
    if px >= grid.width or py >= grid.height:
        return
    pixel = py * grid.width + px
    view = load_view(views)
    found = known_pixel(view, grid, before, tile, pixel)
    if found >= 0:
        store_vec4h(irradiance_out, pixel, kept_light(before, found))
        ratio_out[pixel] = before.ratio[found]
        return
    s = load_surface(view, gbuffer, grid.width, pixel)
    if not has_surface(s):
        irradiance_out[pixel] = wp.vec4h(wp.float16(0.0), wp.float16(0.0), wp.float16(0.0), wp.float16(0.0))
        ratio_out[pixel] = wp.float16(1.0)
        return
    p = place_of(view, grid, gbuffer, moments, s, pixel)
    total = blend_around(grid, records, pool, p, tile, 1, REACH)
    unfilled = total.share < LEAST_WEIGHT
    store_vec4h(irradiance_out, pixel, diffuse_light(total, wp.where(unfilled, UNFILLED, 1.0)))
    ratio_out[pixel] = specular_ratio(total, grid.luminance)
    if unfilled and listing == 1:
        queue_out[wp.atomic_add(count_out, 0, 1)] = pixel


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
    i = first_dealt(wp.tid(), stride)
    while i < count[0]:
        pixel = queue[i]
        i = i + stride
        if float(irradiance_out[pixel][3]) == UNFILLED:
            view = load_view(views)
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
                    base = nearest * (2 * RECORD)
                    total = add_record(records, base, grid, p, 1.0, record_normal(records, base), total)
            irradiance_out[pixel] = diffuse_light(total, confidence)
            ratio_out[pixel] = specular_ratio(total, grid.luminance)
