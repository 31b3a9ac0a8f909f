# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: from maps of radiance to the diffuse light of each pixel (GI-1.0, sections 3.8 to 3.10).

Updated probes are smoothed over their neighbours (into a copy: the histories stay sharp), projected to spherical
harmonics of irradiance / pi about their normals, and interpolated at the pixels. A probe sees nothing below its own
plane, so for a pixel whose normal leans away its harmonics fall short of a white sky by (1 + cos) / 2; dividing by the
interpolated same makes every white sky exact.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, Surface, has_surface, load_surface, plane_distance
from .geometry_math import to_frame
from .packing import from_half, rgb, rgba, to_half, unpack_normal
from .probe_blend import counted_radiance
from .probe_gather import neighbour_tile, related_probe
from .probe_map import band_basis, band_weights, cell_center, cell_of, to_local
from .probe_rays import ProbeRays
from .probe_spawn import probe_cell, separated
from .probe_types import BANDS, CELLS, FAR, NO_CELL, TILE, ProbeGrid, ProbePool, ProbeTiles, ProbeUpdates
from .view import View, project

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Cosine between a direction and that in which a neighbour's point is seen: three times the published 0.02 pi, which
# few neighbours of near surfaces meet.
SMOOTH_COSINE = wp.constant(0.9823)

# Updates after which the neighbours weigh half: the noise has gone, the blur would stay.
SMOOTH_UPDATES = wp.constant(8.0)

# Updates after which what the cells miss is believed in full: a mean over fewer is more noise than knowledge.
RESIDUAL_UPDATES = wp.constant(4.0)

# Reach [px] of probes in the 3 x 3 tiles around a pixel: as far as all of them are sure to be seen, so that nothing
# jumps at the tiles' borders.
REACH = wp.constant(8.5)
WIDE_REACH = wp.constant(20.0)
WIDEST = wp.constant(6)
"""Tiles to each side in which a pixel without any fitting probe looks for one"""

# Least share of a white sky that the interpolated harmonics are taken to hold: bounds the normalisation.
LEAST_SHARE = wp.constant(0.25)


@wp.kernel
def find_neighbors(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    tiles: ProbeTiles,
    pool: ProbePool,
    # Out:
    updates_out: ProbeUpdates,
):
    """Find one of the probes one spawn tile apart that lie on the same surface as an update."""
    index = first + wp.tid()
    update = index // 9
    i = index % 9
    slot = updates_out.slot[update]
    updates_out.neighbor[index] = -1
    if slot < 0 or i == 4:
        return
    position = pool.position[slot]
    width = probe_cell(views[0], project(views[0].camera, position)[2])
    tile = neighbour_tile(grid, updates_out.tile[update], (i % 3 - 1) * grid.side, (i // 3 - 1) * grid.side)
    updates_out.neighbor[index] = related_probe(
        grid, pool, tiles, tile, position, unpack_normal(pool.normal[slot]), width)


@wp.kernel
def smooth_probes(
    first: int,
    # In:
    grid: ProbeGrid,
    pool: ProbePool,
    # Out:
    updates_out: ProbeUpdates,
):
    """Average a cell with the neighbours' cells of the same direction where they see the same point.

    The nearer of the two distances judges, so an occluder near either side stops it.
    """
    index = first + wp.tid()
    update = index // CELLS
    slot = updates_out.slot[update]
    if slot < 0:
        return
    own = from_half(pool.radiance[slot * CELLS + index % CELLS])
    total = rgb(own)
    weight = float(1.0)
    if grid.filtered == 1:
        position = pool.position[slot]
        direction = to_frame(unpack_normal(pool.normal[slot]), cell_center(index % CELLS))
        share = SMOOTH_UPDATES / (SMOOTH_UPDATES + pool.count[slot])
        i = int(0)
        while i < 9:
            other = updates_out.neighbor[update * 9 + i]
            if other >= 0:
                local = to_local(unpack_normal(pool.normal[other]), direction)
                if local[2] > 0.0:
                    value = from_half(pool.radiance[other * CELLS + cell_of(local)])
                    near = wp.min(value[3], own[3])
                    seen = pool.position[other] + direction * near - position
                    if near >= FAR or wp.dot(seen, direction) > SMOOTH_COSINE * wp.length(seen):
                        w = share
                        # On one side alone, a neighbour carries the light's gradient in.
                        if updates_out.neighbor[update * 9 + 8 - i] < 0:
                            w = share * share * share
                        total = total + rgb(value) * w
                        weight = weight + w
            i = i + 1
    updates_out.filtered[index] = to_half(rgba(total / weight, own[3]))


@wp.func
def missed_by_cells(
    updates: ProbeUpdates, rays: ProbeRays, weights: wp.array[float], update: int, band: int,
) -> wp.vec3:
    """Return what a probe's rays tell about light that varies inside cells, for one coefficient.

    A cell's mean times the cell's mean weight misses the covariance of the two: a small light in a cell of 18 degrees
    would err by a quarter at grazing angles. With the history as control variate a ray adds (radiance - history)
    (weight in its direction - mean weight): its mean is that covariance, whatever the history holds, and it is 0
    without noise where the light doesn't vary.
    """
    total = wp.vec3(0.0, 0.0, 0.0)
    normal = unpack_normal(updates.normal[update])
    for ray in range(CELLS):
        index = update * CELLS + ray
        cell = int(updates.cell[index])
        if cell != NO_CELL:
            before = from_half(updates.previous[update * CELLS + cell])
            if before[3] > 0.0:
                exact = band_weights(to_local(normal, rays.direction[index]))
                factor = (exact[band] - weights[cell * BANDS + band]) / updates.expected[update * CELLS + cell]
                total = total + (counted_radiance(rays, index) - rgb(before)) * factor
    return total


@wp.kernel
def project_bands(
    first: int,
    # In:
    grid: ProbeGrid,
    updates: ProbeUpdates,
    rays: ProbeRays,
    weights: wp.array[float],
    # Out:
    pool_out: ProbePool,
):
    """Sum one coefficient of irradiance / pi of an updated probe; `weights` as integrate_cells made them."""
    index = first + wp.tid()
    update = index // BANDS
    band = index % BANDS
    slot = updates.slot[update]
    if slot < 0:
        return
    total = wp.vec3(0.0, 0.0, 0.0)
    nearest = float(FAR)
    for cell in range(CELLS):
        value = from_half(updates.filtered[update * CELLS + cell])
        total = total + rgb(value) * weights[cell * BANDS + band]
        nearest = wp.min(nearest, value[3])
    if band == 0:
        pool_out.clear[slot] = nearest
    if grid.exact == 1:
        residual = pool_out.residual[slot * BANDS + band]
        mean = rgb(residual)
        # Nothing is known about it in a new place, or before anything is known about the cells.
        age = wp.min(residual[3], updates.count[update])
        if updates.fresh[update] == 1 or updates.count[update] <= 0.0:
            age = 0.0
            mean = wp.vec3(0.0, 0.0, 0.0)
        if updates.count[update] > 0.0:
            mean = wp.lerp(mean, missed_by_cells(updates, rays, weights, update, band), 1.0 / (age + 1.0))
            age = age + 1.0
        pool_out.residual[slot * BANDS + band] = rgba(mean, age)
        total = total + mean * wp.min(age / RESIDUAL_UPDATES, 1.0)
    pool_out.irradiance[slot * BANDS + band] = rgba(total, 0.0)


@wp.func
def probe_irradiance(pool: ProbePool, slot: int, n: wp.vec3) -> wp.vec3:
    """Return exposed irradiance / pi at a probe for a normal; may be slightly negative."""
    basis = band_basis(to_local(unpack_normal(pool.normal[slot]), n))
    total = wp.vec3(0.0, 0.0, 0.0)
    for band in range(BANDS):
        total = total + rgb(pool.irradiance[slot * BANDS + band]) * basis[band]
    return total


@wp.func
def surface_weight(pool: ProbePool, slot: int, s: Surface, cell: float) -> float:
    """Return how well a probe fits a surface: 1 on its plane with its normal, 0 off it or behind something."""
    plane = wp.max(1.0 - plane_distance(s, pool.center[slot]) / cell, 0.0)
    cosine = wp.max(wp.dot(s.geometric_normal, unpack_normal(pool.normal[slot])), 0.0)
    if plane * cosine == 0.0:
        return 0.0
    if separated(pool, slot, s.position):
        return 0.0
    c2 = cosine * cosine
    c4 = c2 * c2
    return plane * plane * c4 * c4


@wp.func
def screen_weight(view: View, position: wp.vec3, x: float, y: float, reach: float) -> float:
    """Return a tent over the distance on screen between a probe and the pixel centre (x, y) of the full film."""
    film = project(view.camera, position)
    return wp.max(1.0 - wp.abs(film[0] - x) / reach, 0.0) * wp.max(1.0 - wp.abs(film[1] - y) / reach, 0.0)


@wp.func
def add_probe(pool: ProbePool, slot: int, n: wp.vec3, exact: int, weight: float, total: wp.vec4) -> wp.vec4:
    """Add a probe's irradiance (rgb) and its share of a white sky (w) to weighted sums."""
    share = float(1.0)
    if exact == 1:
        share = wp.max(0.5 + 0.5 * wp.dot(n, unpack_normal(pool.normal[slot])), LEAST_SHARE)
    return total + rgba(probe_irradiance(pool, slot, n), share) * weight


@wp.func
def blend_around(
    view: View, grid: ProbeGrid, pool: ProbePool, tiles: ProbeTiles, s: Surface, pixel: int, n: wp.vec3, radius: int,
    reach: float,
) -> wp.vec4:
    """Return weighted sums over the fitting probes of the tiles around a pixel: irradiance / pi, share of the sky."""
    px = pixel % grid.width
    py = pixel // grid.width
    x = float(view.camera.crop_x + px) + 0.5
    y = float(view.camera.crop_y + py) + 0.5
    cell = probe_cell(view, s.depth)
    side = 2 * radius + 1
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    i = int(0)
    while i < side * side:
        tile = neighbour_tile(
            grid, (py // TILE) * grid.tile_columns + px // TILE, i % side - radius, i // side - radius)
        i = i + 1
        if tile >= 0:
            slot = tiles.probe[tile]
            if slot >= 0:
                w = screen_weight(view, pool.center[slot], x, y, reach)
                if w > 0.0:
                    w = w * surface_weight(pool, slot, s, cell)
                if w == 0.0:
                    slot = tiles.other[tile]
                    if slot >= 0:
                        w = screen_weight(view, pool.center[slot], x, y, reach)
                        if w > 0.0:
                            w = w * surface_weight(pool, slot, s, cell)
                if w > 0.0:
                    total = add_probe(pool, slot, n, grid.exact, w, total)
    return total


@wp.func
def nearest_probe(
    grid: ProbeGrid, pool: ProbePool, tiles: ProbeTiles, s: Surface, pixel: int, n: wp.vec3, cell: float,
) -> wp.vec4:
    """Return the sums for the probe that fits best in the wider surroundings, however badly; w = 0: none."""
    tile = (pixel // grid.width // TILE) * grid.tile_columns + pixel % grid.width // TILE
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
                    best = slot
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if best >= 0:
        total = add_probe(pool, best, n, grid.exact, 1.0, total)
    return total


@wp.kernel
def interpolate_probes(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    tiles: ProbeTiles,
    pool: ProbePool,
    # Out:
    irradiance_out: wp.array[wp.vec4h],
):
    """Interpolate the diffuse light of a pixel: exposed irradiance / pi at the shading normal, and confidence.

    Confidence is 1 where probes of the same surface are near, 0.5 where they are farther off, 0 where the value
    comes from another surface or there is none.
    """
    pixel = first + wp.tid()
    view = views[0]
    s = load_surface(view, gbuffer, grid.width, pixel)
    if not has_surface(s):
        irradiance_out[pixel] = wp.vec4h(wp.float16(0.0), wp.float16(0.0), wp.float16(0.0), wp.float16(0.0))
        return
    confidence = float(1.0)
    total = blend_around(view, grid, pool, tiles, s, pixel, s.normal, 1, REACH)
    # So little weight that the sums have no more precision, and far from any probe.
    if total[3] < 1.0e-4:
        confidence = 0.5
        total = blend_around(view, grid, pool, tiles, s, pixel, s.normal, 2, WIDE_REACH)
    if total[3] < 1.0e-4:
        confidence = 0.0
        total = nearest_probe(grid, pool, tiles, s, pixel, s.normal, probe_cell(view, s.depth))
    value = wp.vec3(0.0, 0.0, 0.0)
    if total[3] > 0.0:
        value = rgb(total) / total[3]
    irradiance_out[pixel] = to_half(wp.vec4(
        wp.max(value[0], 0.0), wp.max(value[1], 0.0), wp.max(value[2], 0.0), confidence))
