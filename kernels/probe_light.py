# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: from maps of radiance to harmonics of diffuse light (GI-1.0, sections 3.8 and 3.9).

Updated probes are smoothed over their neighbours (into a copy: the histories stay sharp) and projected to spherical
harmonics of irradiance / pi about their normals.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import to_frame
from .packing import from_half, rgb, rgba, to_half, unpack_normal
from .probe_blend import UNCOUNTED, counted_radiance
from .probe_gather import neighbour_tile, related_probe
from .probe_map import band_weight, cell_center, cell_of, to_local
from .probe_rays import ProbeRays
from .probe_spawn import is_flight, probe_cell
from .probe_types import BANDS, CELLS, FAR, NO_CELL, ProbeGrid, ProbePool, ProbeTiles, ProbeUpdates
from .view import View, project
from .wide_loads import load_vec4h, load_view
from .wide_stores import store_vec4h

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Cosine between a direction and that in which a neighbour's point is seen: three times the published 0.02 pi, which
# few neighbours of near surfaces meet.
SMOOTH_COSINE = wp.constant(0.9823)

# Updates after which the neighbours weigh half: the noise has gone, the blur would stay.
SMOOTH_UPDATES = wp.constant(8.0)

# Most updates that what the cells of the probes around miss counts for in a new one.
TAKEN_UPDATES = wp.constant(0.25)


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
    view = load_view(views)
    position = pool.position[slot]
    width = probe_cell(view, project(view.camera, position)[2])
    tile = neighbour_tile(grid, updates_out.tile[update], (i % 3 - 1) * grid.side, (i // 3 - 1) * grid.side)
    updates_out.neighbor[index] = related_probe(
        pool, tiles, tile, position, unpack_normal(pool.normal[slot]), width)


@wp.kernel
def smooth_probes(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    pool: ProbePool,
    # Out:
    updates_out: ProbeUpdates,
):
    """Average a cell with the neighbours' cells of the same direction where they see the same point.

    The nearer of the two distances judges, so an occluder near either side stops it. A neighbour on one side alone
    carries the light's gradient in: it weighs little, and nothing in motion, where what comes into view has neighbours
    on one side, which have such themselves.
    """
    index = first + wp.tid()
    update = index // CELLS
    slot = updates_out.slot[update]
    if slot < 0:
        return
    own = from_half(load_vec4h(pool.radiance, slot * CELLS + index % CELLS))
    total = rgb(own)
    weight = float(1.0)
    if grid.filtered == 1:
        position = pool.position[slot]
        direction = to_frame(unpack_normal(pool.normal[slot]), cell_center(index % CELLS))
        share = SMOOTH_UPDATES / (SMOOTH_UPDATES + pool.count[slot])
        alone = wp.where(is_flight(views[0]), 0.0, share * share * share)
        i = int(0)
        while i < 9:
            other = updates_out.neighbor[update * 9 + i]
            w = wp.where(updates_out.neighbor[update * 9 + 8 - i] >= 0, share, alone)
            if other >= 0 and w > 0.0:
                local = to_local(unpack_normal(pool.normal[other]), direction)
                if local[2] > 0.0:
                    value = from_half(load_vec4h(pool.radiance, other * CELLS + cell_of(local)))
                    near = wp.min(value[3], own[3])
                    seen = pool.position[other] + direction * near - position
                    if near >= FAR or wp.dot(seen, direction) > SMOOTH_COSINE * wp.length(seen):
                        total = total + rgb(value) * w
                        weight = weight + w
            i = i + 1
    store_vec4h(updates_out.filtered, index, to_half(rgba(total / weight, own[3])))


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
    k = int(0)
    while k < 16:
        # Without branches, so that four rays wait for memory together.
        for i in range(4):
            index = update * CELLS + 4 * k + i
            cell = int(updates.cell[index])
            known = wp.min(cell, CELLS - 1)
            before = from_half(load_vec4h(updates.previous, update * CELLS + known))
            counts = wp.where(cell == NO_CELL, UNCOUNTED, before[3])
            exact = band_weight(to_local(normal, rays.direction[index]), band)
            factor = (exact - weights[known * BANDS + band]) / updates.expected[update * CELLS + known]
            total = total + (counted_radiance(rays, index) - rgb(before)) * wp.where(counts > 0.0, factor, 0.0)
        k = k + 1
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
    k = int(0)
    while k < 8:
        for i in range(8):
            cell = 8 * k + i
            value = from_half(load_vec4h(updates.filtered, update * CELLS + cell))
            total = total + rgb(value) * weights[cell * BANDS + band]
            nearest = wp.min(nearest, value[3])
        k = k + 1
    if band == 0:
        pool_out.clear[slot] = nearest
    if grid.exact == 1:
        residual = pool_out.residual[slot * BANDS + band]
        # Before anything is known about the cells, what they miss is not either.
        age = wp.min(residual[3], updates.count[update])
        if updates.fresh[update] == 1:
            # A few steps aside it is much the same, and without it light near the horizon would be too bright.
            residual = updates.residual[update * BANDS + band]
            age = wp.min(residual[3], TAKEN_UPDATES)
        mean = rgb(residual)
        if age <= 0.0:
            mean = wp.vec3(0.0, 0.0, 0.0)
        if updates.count[update] > 0.0:
            mean = wp.lerp(mean, missed_by_cells(updates, rays, weights, update, band), 1.0 / (age + 1.0))
            age = age + 1.0
        pool_out.residual[slot * BANDS + band] = rgba(mean, age)
        # In full from the first update on: noisy as it is, without it a wall beside a window would be too bright.
        total = total + mean
    pool_out.irradiance[slot * BANDS + band] = rgba(total, 0.0)
