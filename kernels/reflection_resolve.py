# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that puts together what reflection rays bring, once the radiance cache is up to date."""

from __future__ import annotations

import warp as wp

from .cache_rays import Vertices, cell_seed, hit_place
from .geometry_math import PI, is_finite3, max_component, mean_component
from .hash_grid import (
    COARSE_LEVELS,
    NO_CELL,
    HashGrid,
    cell_key,
    cell_level,
    cell_size,
    coarse_key,
    find_key,
    find_lit_cell,
    indirect_light,
    indirect_of,
    is_lit,
    jittered,
    known_indirect,
    wide_key,
)
from .homes import CellPlace
from .packed_halves import pack_halves
from .packing import HALF_MAX, rgb, rgba
from .paths import Paths
from .reflection_rays import FOUND_CELL, FOUND_DIRECT, FOUND_OWN, ReflectionRays, ray_count
from .reflection_types import LOBE_REFLECTION, PLACE_STEADY, ReflectionOptions, ReflectionSamples
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Samples in a cell from which on its mean stands in for a hit's own light.
CELL_SAMPLES = wp.constant(8.0)
# Samples of indirect light from which on a cell is shown as it is: far brighter than the coarse cell about it, or not.
SPARK_SAMPLES = wp.constant(16.0)
ENOUGH_SAMPLES = wp.constant(4.0)
# Density [1/sr] of a ray's widest lobe from which on it shows single cells: up to a roughness of about 0.17.
SHARP_DENSITY = wp.constant(100.0)
# Share of a sample's light that is emitted where its ray ends, from which on it is no chance.
STEADY_SHARE = wp.constant(0.75)
# Frames at rest over which hits of sharp reflections go over from their cells' means to their own light.
OWN_START = wp.constant(8.0)
OWN_END = wp.constant(48.0)


@wp.func
def lobe_width(pdf: float, t: float) -> float:
    """Return how wide [m] a lobe is at a distance: 2 t sqrt(0.5 a^2 / (1 - a^2)), the a of a GGX lobe of that peak.

    Along the normal such a lobe has the density 1 / (4 pi a^2).
    """
    a2 = 1.0 / (4.0 * PI * wp.max(pdf, 1.0e-3))
    return 2.0 * t * wp.sqrt(0.5 * a2 / wp.max(1.0 - a2, 0.1))


@wp.func
def exact_cell(grid: HashGrid, view: View, place: CellPlace, direction: wp.vec3) -> int:
    """Return the cell of a point without any chance in it, NO_CELL where it knows nothing."""
    level = cell_level(grid, view, place.position, wp.uint32(0))
    cell = find_key(grid, cell_key(grid, level, place, direction))
    if not is_lit(grid, cell):
        cell = NO_CELL
    return cell


@wp.struct
class HitLight:
    """Irradiance / pi at a hit."""

    direct: wp.vec3
    indirect: wp.vec3


@wp.func
def steadied(light: wp.vec4, around: wp.vec4) -> wp.vec4:
    """Return a cell's light with the more of a wider one's, the fewer samples it has and the brighter it is for them.

    Of a dark cell less is taken: shadows stay. That keeps sparks out at the cost of some of their light.
    """
    if around[3] <= light[3]:
        return light
    own = mean_component(rgb(light))
    wide = mean_component(rgb(around))
    above = wp.clamp((own - wide) / wp.max(own + wide, 1.0e-20), 0.0, 1.0)
    enough = wp.lerp(ENOUGH_SAMPLES, SPARK_SAMPLES, above)
    return wp.lerp(around, light, wp.min(light[3] / enough, 1.0))


@wp.func
def steady_indirect(
    grid: HashGrid, view: View, cell: int, place: CellPlace, direction: wp.vec3, seed: wp.uint32, jitter: int,
) -> wp.vec3:
    """Return the indirect light that a sharp lobe shows: that of a cell, steadied by the wider ones about it.

    A mirror shows each cell by itself, and cells that mirrors alone look at have few samples; probes and wide lobes
    average over many cells.
    """
    light = known_indirect(grid, view, cell, place, direction, seed)
    if light[3] >= SPARK_SAMPLES:
        return rgb(light)
    aside = place
    if jitter == 1:
        aside = jittered(place, cell_size(cell_level(grid, view, place.position, seed) + COARSE_LEVELS), seed)
    key = coarse_key(grid, view, aside, direction, seed)
    around = indirect_of(grid, find_key(grid, key))
    if around[3] < ENOUGH_SAMPLES:
        around = steadied(around, indirect_of(grid, find_key(grid, wide_key(grid, key))))
    return rgb(steadied(light, around))


@wp.func
def hit_light(
    view: View, grid: HashGrid, paths: Paths, vertices: Vertices, rays: ReflectionRays, slot: int, own_light: int,
    jitter: int,
) -> HitLight:
    """Return irradiance / pi at a ray's hit.

    One shadow ray is noise that sharp reflections show while the camera moves, so until it has rested for a while they
    show cells too, but not where the ray is so short that the cell would be seen beside what it lights.
    """
    place = hit_place(grid, paths, vertices, slot)
    direction = paths.direction[slot]
    seed = cell_seed(slot, view.frame)
    size = cell_size(cell_level(grid, view, place.position, seed))
    length = vertices.emission[slot][3]
    # A lobe narrower than a cell would show it.
    wide = lobe_width(paths.pdf[slot], length) > size
    if rays.found[slot] == FOUND_DIRECT:
        only = HitLight()
        only.direct = rgb(paths.radiance[slot])
        only.indirect = wp.vec3(0.0, 0.0, 0.0)
        return only
    own = wp.clamp((float(view.rest) - OWN_START) / (OWN_END - OWN_START), 0.0, 1.0)
    if wide:
        own = float(0.0)
    cell = int(NO_CELL)
    if (own < 1.0 and paths.t[slot] > size) or own_light == 0:
        if jitter == 1:
            cell = find_lit_cell(grid, view, place, direction, seed)
        else:
            cell = exact_cell(grid, view, place, direction)
    direct = rgb(paths.radiance[slot])
    rays.found[slot] = FOUND_OWN
    if own_light == 0:
        direct = wp.vec3(0.0, 0.0, 0.0)
        own = float(0.0)
    known = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if cell != NO_CELL:
        known = grid.direct[cell]
        if not wide and own_light == 1 and known[3] < CELL_SAMPLES:
            cell = NO_CELL
    if cell != NO_CELL:
        direct = wp.lerp(rgb(known), direct, own)
        if own < 0.5:
            rays.found[slot] = FOUND_CELL
    else:
        cell = vertices.cell[slot]
    light = HitLight()
    light.direct = direct
    if wide or paths.pdf[slot] < SHARP_DENSITY:
        light.indirect = indirect_light(grid, view, cell, place, direction, seed)
    else:
        light.indirect = steady_indirect(grid, view, cell, place, direction, seed, jitter)
    return light


@wp.func
def is_steady(
    options: ReflectionOptions, paths: Paths, vertices: Vertices, samples: ReflectionSamples, slot: int, block: int,
    found: wp.vec3,
) -> bool:
    """Return whether what a ray has found is emitted by what it has met first, so that only its lobe makes it chance.

    Which way rays go on from there, over mirrors and through glass, is drawn too.
    """
    if options.lobe != LOBE_REFLECTION:
        return False
    # Rays that have gone on have the density of their last direction.
    emitted = max_component(rgb(vertices.emission[slot]))
    return samples.pdf[block] == paths.pdf[slot] and emitted > STEADY_SHARE * max_component(found)


@wp.func
def store_sample(
    view: View, options: ReflectionOptions, paths: Paths, vertices: Vertices, rays: ReflectionRays,
    samples: ReflectionSamples, slot: int, found: wp.vec3,
):
    """Write the sample of a ray that has found that light."""
    block = rays.block[slot]
    if is_steady(options, paths, vertices, samples, slot, block, found):
        samples.place[block] = samples.place[block] | PLACE_STEADY
    light = found * view.exposure
    if not is_finite3(light):
        light = wp.vec3(0.0, 0.0, 0.0)
    light = wp.vec3(wp.clamp(light[0], 0.0, HALF_MAX), wp.clamp(light[1], 0.0, HALF_MAX),
                    wp.clamp(light[2], 0.0, HALF_MAX))
    samples.radiance[block] = pack_halves(rgba(light, vertices.emission[slot][3]))


@wp.kernel
def resolve_reflections(
    # In:
    first: int,
    views: wp.array[View],
    options: ReflectionOptions,
    grid: HashGrid,
    own_light: int,
    jitter: int,
    paths: Paths,
    vertices: Vertices,
    # Out:
    rays_out: ReflectionRays,
    samples_out: ReflectionSamples,
):
    """Write the samples of all rays: demodulated, exposed, with the length of the way.

    `own_light` 1: the hits have traced shadow rays. `jitter` 1: look up cells half a cell aside, to hide their borders.
    """
    slot = first + wp.tid()
    if slot >= ray_count(rays_out, options.columns * options.rows):
        return
    view = views[0]
    light = rgb(vertices.emission[slot])
    reflectance = rgb(vertices.reflectance[slot])
    if max_component(reflectance) > 0.0:
        arriving = hit_light(view, grid, paths, vertices, rays_out, slot, own_light, jitter)
        light = light + wp.cw_mul(
            paths.throughput[slot], wp.cw_mul(reflectance, arriving.direct + arriving.indirect))
    store_sample(view, options, paths, vertices, rays_out, samples_out, slot, light)
