# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflections of rough surfaces, looked up in the screen probes (Eto et al. 2023, section 2.2).

A block's sample is one direction of its pixel's lobes; the light that arrives from there is what one of the probes
around, chosen by its weight, knows of the point seen, found through the distances that they store. Each probe's 8 x 8
cells are read bilinearly, so that their borders (18 degrees apart) don't show. The chances of the probes that know the
direction add up to 1 and the lobe's value over density and albedo has mean 1, so a white sky stays white.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, Surface, SurfaceMaterial, load_material, load_surface, view_direction
from .geometry_math import is_finite3
from .lobe_moments import fitted_albedo
from .packed_halves import pack_halves, unpack_halves, unpack_pairs
from .packing import from_half, pack_normal, rgb, rgba
from .probe_gather import REAIM_COSINE, UNKNOWN, neighbour_tile
from .probe_interpolate import REACH, Place, bare_place, record_weight
from .probe_map import cell_of, hemisphere_to_square, to_local
from .probe_rays import LEAST_DISTANCE, distance_of, inverse_distance
from .probe_records import RECORD, RECORD_BANDS, RECORD_CENTER
from .probe_types import CELLS, FAR, TILE, ProbeGrid, ProbePool
from .reflection_rays import sequence_index, sequence_seed
from .reflection_start import drawn_pdf
from .reflection_types import (
    PLACE_MASK,
    SAMPLE_FAR,
    SOURCE_COAT,
    SOURCE_PROBE,
    ReflectionOptions,
    ReflectionSamples,
    coat_alone,
    place_pixel,
    sampled_material,
)
from .sampling import STEP_X, STEP_Y, fraction, sample_pair
from .specular_lobes import SpecularLobes, lobes_pdf, lobes_value, sample_lobes, specular_lobes
from .view import View
from .wide_loads import load_piece, load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Dimensions of a pixel's random sequences, besides those of rays.
DIMENSION_LOOK_UP = wp.constant(96)
DIMENSION_LOOK_UP_LOBE = wp.constant(97)

# Directions in which the probes are asked for the light of a base under a coat.
BASE_LOOK_UPS = wp.constant(4)

# From this distance on, in distances from the probe, a point is seen in the same direction from both: 1 degree.
SAME_DIRECTION = wp.constant(57.0)

# Least albedo that values are divided by; darker channels show nothing.
ALBEDO_MIN = wp.constant(1.0e-4)

PDF_MIN = wp.constant(1.0e-6)


@wp.func
def cell_distance(maps: wp.array[wp.uint64], slot: int, local: wp.vec3) -> float:
    """Return the distance [m] of what a probe sees in a local direction, of its nearest cell."""
    return unpack_halves(maps[slot * CELLS + cell_of(local)])[3]


@wp.func
def cell_value(maps: wp.array[wp.uint64], cell: int) -> wp.vec4:
    """Return a cell's exposed radiance and inverse distance: parallax goes by that."""
    value = unpack_halves(maps[cell])
    return rgba(rgb(value), inverse_distance(value[3]))


@wp.func
def smooth_value(maps: wp.array[wp.uint64], slot: int, local: wp.vec3) -> wp.vec4:
    """Return exposed radiance and inverse distance in a local direction, bilinear between the cells' middles.

    Beyond the outermost middles, below the surface, nothing is known: clamping there keeps each cell's share of the
    hemisphere what it is.
    """
    u = hemisphere_to_square(local)
    x = wp.clamp(u[0] * float(TILE) - 0.5, 0.0, float(TILE - 1))
    y = wp.clamp(u[1] * float(TILE) - 0.5, 0.0, float(TILE - 1))
    i = wp.min(int(x), TILE - 2)
    j = wp.min(int(y), TILE - 2)
    cell = slot * CELLS + j * TILE + i
    low = wp.lerp(cell_value(maps, cell), cell_value(maps, cell + 1), x - float(i))
    high = wp.lerp(cell_value(maps, cell + TILE), cell_value(maps, cell + TILE + 1), x - float(i))
    return wp.lerp(low, high, y - float(j))


@wp.func
def aimed_value(maps: wp.array[wp.uint64], slot: int, offset: wp.vec3, local: wp.vec3) -> wp.vec4:
    """Return exposed radiance and distance that arrive from a direction at a place beside a probe.

    The point seen from there is found as in probe_gather.aimed_radiance; where that fails, the probe tells what it
    sees in the direction itself.

    Args:
        maps: Radiance of the pool, as words.
        slot: The probe.
        offset: Of the place from the probe [m], in the probe's frame.
        local: Direction in the probe's frame, above its surface.
    """
    aim = local
    far = cell_distance(maps, slot, local)
    if far < FAR and far < SAME_DIRECTION * wp.length(offset):
        step = int(0)
        while step < 2 and far < FAR:
            point = offset + local * far
            if point[2] <= 0.0:
                far = FAR
                aim = local
            else:
                aim = wp.normalize(point)
                far = cell_distance(maps, slot, aim)
                if far < FAR:
                    far = wp.length(aim * far - offset)
            step = step + 1
        if wp.dot(aim, local) < REAIM_COSINE:
            # The point at which the aim ended may still be the right one: near things have much parallax.
            seen = aim * cell_distance(maps, slot, aim) - offset
            if far >= FAR or wp.dot(seen, local) < REAIM_COSINE * wp.length(seen):
                aim = local
    value = smooth_value(maps, slot, aim)
    distance = distance_of(value[3])
    if distance < FAR:
        distance = wp.length(aim * distance - offset)
    return rgba(rgb(value), wp.max(distance, LEAST_DISTANCE))


@wp.func
def arriving_light(
    grid: ProbeGrid, records: wp.array[wp.uint64], pool: ProbePool, maps: wp.array[wp.uint64], p: Place, tile: int,
    direction: wp.vec3, pick: float,
) -> wp.vec4:
    """Return exposed radiance and distance that arrive at a pixel's surface from a direction; w < 0: no probe knows.

    Of the probes that know the direction one is asked, chosen with `pick` by its weight: its mean is that of all of
    them, and following the direction to the point seen costs far more than the weights.
    """
    weight = float(0.0)
    rest = pick
    chosen = int(-1)
    offset = wp.vec3(0.0, 0.0, 0.0)
    aim = wp.vec3(0.0, 0.0, 1.0)
    i = int(0)
    while i < 9:
        other = neighbour_tile(grid, tile, i % 3 - 1, i // 3 - 1)
        i = i + 1
        if other >= 0:
            base = other * (2 * RECORD)
            # Both are read before either is judged: they wait for memory together.
            film = load_piece(records, base)
            second = load_piece(records, base + RECORD)
            found = record_weight(records, base, film, pool, p, REACH)
            if found[0] == 0.0:
                base = base + RECORD
                film = second
                found = record_weight(records, base, film, pool, p, REACH)
            if found[0] > 0.0:
                n = wp.vec3(found[1], found[2], found[3])
                local = to_local(n, direction)
                if local[2] > 0.0:
                    place = load_piece(records, base + RECORD_CENTER)
                    center = wp.vec3(wp.cast(place[0], float), wp.cast(place[1], float), wp.cast(place[2], float))
                    bands = load_piece(records, base + RECORD_BANDS)
                    w = found[0] * unpack_pairs(bands[0], bands[1])[3]
                    weight = weight + w
                    # One number chooses among all: what it has left of its range goes on to the next.
                    share = w / weight
                    if rest < share:
                        rest = rest / share
                        chosen = int(film[3])
                        offset = to_local(n, p.surface.position - center)
                        aim = local
                    else:
                        rest = (rest - share) / (1.0 - share)
    if chosen < 0:
        return wp.vec4(0.0, 0.0, 0.0, UNKNOWN)
    return aimed_value(maps, chosen, offset, aim)


@wp.func
def demodulated(
    moments: wp.array[wp.uint64], whole: SurfaceMaterial, m: SurfaceMaterial, s: Surface, lobes: SpecularLobes,
    wi: wp.vec3,
) -> wp.vec3:
    """Return f cos / density / albedo: what light from a direction counts for; 0 where the surface absorbs it.

    `m` is what is drawn of the `whole` material, whose albedo it is (sampled_material).
    """
    none = wp.vec3(0.0, 0.0, 0.0)
    pdf = lobes_pdf(lobes, wi)
    if pdf <= 0.0 or wp.dot(wi, s.geometric_normal) <= 0.0:
        return none
    albedo = wp.max(fitted_albedo(moments, whole, lobes.local_o[2]), wp.vec3(ALBEDO_MIN, ALBEDO_MIN, ALBEDO_MIN))
    factor = wp.cw_div(lobes_value(m, lobes, wi) / pdf, albedo)
    if not is_finite3(factor):
        return none
    return factor


@wp.kernel(cuda_max_registers=96)
def look_up_probes(
    first: int,
    # In:
    options: ReflectionOptions,
    source: wp.array[wp.uint8],
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    records: wp.array[wp.uint64],
    pool: ProbePool,
    maps: wp.array[wp.uint64],
    irradiance: wp.array[wp.vec4h],
    ratio: wp.array[wp.float16],
    moments: wp.array[wp.uint64],
    # Out:
    samples_out: ReflectionSamples,
):
    """Fill the samples of blocks whose `source` is SOURCE_PROBE, add the base's light where it is SOURCE_COAT.

    All have a `place`.

    `maps` is the pool's radiance as words. Where no probe around knows the direction, the pixel's diffuse light times
    `ratio` (probe_interpolate.specular_ratio) stands for it, so that nothing gets black.
    """
    block = first + wp.tid()
    kind = source[block]
    if kind != SOURCE_PROBE and kind != SOURCE_COAT:
        return
    place = int(samples_out.place[block] & PLACE_MASK)
    pixel = place_pixel(options, block, place)
    view = load_view(views)
    s = load_surface(view, gbuffer, options.width, pixel)
    whole = load_material(gbuffer, pixel)
    tile = (pixel // options.width // TILE) * grid.tile_columns + pixel % options.width // TILE
    seed = sequence_seed(view, options.width, pixel)
    index = sequence_index(options.stride, view.frame, place)
    u = sample_pair(seed, index, DIMENSION_LOOK_UP)
    picks = sample_pair(seed, index, DIMENSION_LOOK_UP_LOBE)
    m = sampled_material(options, whole)
    share = float(1.0)
    # The sample itself comes first, then what the base under a coat adds to it.
    part = int(0)
    parts = wp.where(coat_alone(options, whole), 1 + BASE_LOOK_UPS, 1)
    sum = wp.vec4(0.0, 0.0, 0.0, SAMPLE_FAR)
    if kind == SOURCE_COAT:
        sum = unpack_halves(samples_out.radiance[block])
        part = 1
    while part < parts:
        if part > 0:
            m = whole
            m.coat = 0.0
            share = 1.0 / float(BASE_LOOK_UPS)
        lobes = specular_lobes(m, s, view_direction(view, s))
        step = float(part)
        pick = wp.vec2(fraction(picks[0] + step * STEP_X), fraction(picks[1] + step * STEP_Y))
        wi = sample_lobes(
            lobes, wp.vec2(fraction(u[0] + step / float(BASE_LOOK_UPS)), fraction(u[1] + step * STEP_X)), pick[0])
        factor = demodulated(moments, whole, m, s, lobes, wi)
        light = wp.vec4(0.0, 0.0, 0.0, SAMPLE_FAR)
        if wp.length_sq(factor) > 0.0:
            light = arriving_light(grid, records, pool, maps, bare_place(view, grid, s, pixel), tile, wi, pick[1])
            if light[3] < 0.0:
                light = rgba(rgb(from_half(irradiance[pixel])) * float(ratio[pixel]), SAMPLE_FAR)
        if part == 0:
            sum[3] = wp.min(light[3], SAMPLE_FAR)
            drawn = wp.max(drawn_pdf(lobes, wi), PDF_MIN)
            if not wp.isfinite(drawn):
                drawn = PDF_MIN
            samples_out.direction[block] = pack_normal(wi)
            # Above 0 for absorbed samples too: they count as black ones.
            samples_out.pdf[block] = drawn
        sum = rgba(rgb(sum) + wp.cw_mul(rgb(light), factor) * share, sum[3])
        part = part + 1
    samples_out.radiance[block] = pack_halves(sum)
