# SPDX-License-Identifier: GPL-3.0-or-later
"""What rays bring from the cache: to the cells that bounce rays start from, and to the probes."""

from __future__ import annotations

import warp as wp

from .cache_highlights import highlight_light
from .cache_rays import IDLE, SWEEP_FRAMES, UNWATCHED, Vertices, cell_seed, hit_place, is_near
from .geometry_math import is_finite3, max_component
from .hash_grid import NO_CELL, HashGrid, find_lit_cell, indirect_light, indirect_of, is_lit, known_indirect
from .packing import rgb
from .paths import Paths
from .probe_rays import ProbeRays
from .view import View, settling_frames

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# The loop from cell to cell must lose something, or light grows without end between surfaces of albedo 1. What comes
# straight from lights is in no loop: leaves that give 1.48 of what they get do so once.
FEEDBACK_MAX = wp.constant(0.999)
# Reflectance from which a surface is meant to give more than it gets (leaves that sum shaders up); below it is rounding
# of tables. In the loop it does so with light up to GAIN_LIGHT, exposed: a room of such walls has an end.
GAIN_MIN = wp.constant(1.05)
GAIN_LIGHT = wp.constant(64.0)


@wp.func
def lossy_light(vertices: Vertices, slot: int, light: wp.vec3) -> wp.vec3:
    """Return what a bounce ray's hit gives of the cache's own light, always less than it gets."""
    return wp.cw_mul(wp.min(rgb(vertices.reflectance[slot]), wp.vec3(FEEDBACK_MAX, FEEDBACK_MAX, FEEDBACK_MAX)), light)


@wp.func
def bounced_light(view: View, vertices: Vertices, slot: int, light: wp.vec3) -> wp.vec3:
    """Return what a bounce ray's hit gives of the cache's own light."""
    result = lossy_light(vertices, slot, light)
    reflectance = rgb(vertices.reflectance[slot])
    if max_component(reflectance) > GAIN_MIN:
        limit = GAIN_LIGHT / wp.max(view.exposure, 1.0e-20)
        gain = wp.max(reflectance - wp.vec3(FEEDBACK_MAX, FEEDBACK_MAX, FEEDBACK_MAX), wp.vec3(0.0, 0.0, 0.0))
        result = result + wp.cw_mul(gain, wp.min(light, wp.vec3(limit, limit, limit)))
    return result


@wp.kernel
def gather_bounces(
    first: int,
    # In:
    views: wp.array[View],
    grid: HashGrid,
    paths: Paths,
    count: int,
    all_bounces: int,
    # Out:
    vertices_out: Vertices,
):
    """Find what each bounce ray brings to its source: the light of the cell that it hit, as of the frame before.

    `all_bounces` 0: the cell's direct light alone.
    """
    bounce = first + wp.tid()
    slot = count + bounce
    arrived = wp.vec3(0.0, 0.0, 0.0)
    carried = wp.vec3(0.0, 0.0, 0.0)
    emission = vertices_out.emission[slot]
    if emission[3] != IDLE:
        reflectance = rgb(vertices_out.reflectance[slot])
        direct = rgb(paths.radiance[slot])
        cell = vertices_out.cell[slot]
        view = views[0]
        if cell != NO_CELL:
            known = grid.direct[cell]
            if known[3] > 0.0 and view.light_age > 0:
                samples = wp.where(paths.radiance[slot][3] == UNWATCHED, 0.0, 1.0)
                direct = (rgb(known) * known[3] + direct) / (known[3] + samples)
        if all_bounces == 1 and max_component(reflectance) > 0.0:
            light = known_indirect(
                grid, view, cell, hit_place(grid, paths, vertices_out, slot), paths.direction[slot],
                cell_seed(slot, view.frame))
            source = vertices_out.source[bounce]
            if not light[3] > 0.0 and source != NO_CELL and settling_frames(view) >= SWEEP_FRAMES:
                # One ray of a thousand meets cells so seldom met that nothing is known. Black would be lost in every
                # bounce: 2 % of the light at albedo 0.95. The source's own light stands for the mean of the known.
                light = indirect_of(grid, source)
            carried = bounced_light(view, vertices_out, slot, rgb(light))
        arrived = rgb(emission) + wp.cw_mul(reflectance, direct)
        arrived = arrived + highlight_light(vertices_out, slot, rgb(paths.radiance[slot]), direct)
    if not (is_finite3(arrived) and is_finite3(carried)):
        arrived = wp.vec3(0.0, 0.0, 0.0)
        carried = wp.vec3(0.0, 0.0, 0.0)
    vertices_out.arrived[bounce] = arrived
    vertices_out.carried[bounce] = carried


@wp.func
def cached_light(
    grid: HashGrid, view: View, paths: Paths, vertices: Vertices, slot: int, direction: wp.vec3, cone_test: int,
) -> wp.vec3:
    """Return the light that a probe ray's hit reflects, filtered by the cache but for highlights.

    It is that of the hit's own cell, not jittered as for reflections: a probe's rays hide the cells' borders, and light
    leaks less far. Hits nearer than a cell take their own direct light: a cell is too coarse to tell on which side of a
    contact the light ends, and whether a wall is in between. So do hits for which there is no cell.
    """
    place = hit_place(grid, paths, vertices, slot)
    seed = cell_seed(slot, view.frame)
    cell = vertices.cell[slot]
    if not is_lit(grid, cell):
        cell = find_lit_cell(grid, view, place, direction, seed)
    direct = rgb(paths.radiance[slot])
    if cell != NO_CELL and not (cone_test == 1 and is_near(grid, view, vertices, slot)):
        direct = rgb(grid.direct[cell])
    arriving = direct + indirect_light(grid, view, cell, place, direction, seed)
    return wp.cw_mul(rgb(vertices.reflectance[slot]), arriving) + highlight_light(
        vertices, slot, rgb(paths.radiance[slot]), direct)


@wp.kernel
def resolve_rays(
    first: int,
    # In:
    views: wp.array[View],
    grid: HashGrid,
    paths: Paths,
    vertices: Vertices,
    cone_test: int,
    # Out:
    rays_out: ProbeRays,
):
    """Answer the probes: the radiance that arrives along each ray, exposed, and the distance of its hit."""
    slot = first + wp.tid()
    view = views[0]
    emission = vertices.emission[slot]
    if emission[3] == IDLE:
        rays_out.radiance[slot] = wp.vec4(0.0, 0.0, 0.0, 0.0)
        return
    radiance = rgb(emission)
    reflectance = rgb(vertices.reflectance[slot])
    if wp.max(reflectance[0], wp.max(reflectance[1], reflectance[2])) > 0.0:
        radiance = radiance + cached_light(grid, view, paths, vertices, slot, paths.direction[slot], cone_test)
    radiance = radiance * view.exposure
    if not is_finite3(radiance):
        radiance = wp.vec3(0.0, 0.0, 0.0)
    rays_out.radiance[slot] = wp.vec4(radiance[0], radiance[1], radiance[2], emission[3])
