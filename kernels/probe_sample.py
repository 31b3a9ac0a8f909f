# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: the 64 rays of each updated probe (GI-1.0, section 3.5).

Half of the rays are spread over the cells, one in each cell of a checkerboard's colour drawn at random; the other half
goes where light came from before, by stratified draws from the cells' luminance times cosine. A cell's `expected`
number of rays is known, and the blend weighs by it, so guiding changes the noise and not the mean (the published blend
has none of this, and loses or gains up to half of the energy). Rays into the reflection are for the radiance cache:
they lie unevenly in their cells, so the probe doesn't count them.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, load_material, load_surface, view_direction
from .geometry_math import sqr, to_frame
from .ggx import sample_ggx_reflection
from .packing import unpack_normal
from .probe_map import cell_direction, to_local
from .probe_rays import ProbeRays
from .probe_types import CELLS, NO_CELL, TILE, ProbeGrid, ProbePool, ProbeUpdates
from .sampling import hash_combine, hashed_unit, sample_pair
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Rays that are spread evenly when the others are guided.
EVEN = wp.constant(32)

RAY_LENGTH = wp.constant(1.0e17)

# Narrower lobes than this can't be drawn in float32.
LEAST_ALPHA = wp.constant(1.0e-3)

# Dimensions of a probe's random sequences: cells, guided rays, their strata, reflections, the checkerboard's colour.
DIMENSION_GUIDED = wp.constant(64)
DIMENSION_STRATUM = wp.constant(128)
DIMENSION_SPECULAR = wp.constant(192)
DIMENSION_PARITY = wp.constant(256)


@wp.func
def is_guided(grid: ProbeGrid, updates: ProbeUpdates, update: int) -> bool:
    """Return whether enough is known to send rays where light came from."""
    return grid.guided == 1 and updates.count[update] > 0.0 and 2 * updates.covered[update] > CELLS


@wp.func
def even_cell(ray: int, parity: int) -> int:
    """Return the cell of ray 0..31 on one colour of a checkerboard."""
    y = ray // 4
    return y * TILE + 2 * (ray % 4) + ((y + parity) & 1)


@wp.func
def guided_cell(updates: ProbeUpdates, update: int, total: float, u: float) -> int:
    """Return the cell at a share u of the sum of all guides."""
    if total <= 0.0:
        return wp.min(int(u * float(CELLS)), CELLS - 1)
    target = u * total
    running = float(0.0)
    chosen = int(-1)
    last = int(0)
    cell = int(0)
    while chosen < 0 and cell < CELLS:
        guide = updates.guide[update * CELLS + cell]
        running = running + guide
        if guide > 0.0:
            last = cell
            if running > target:
                chosen = cell
        cell = cell + 1
    # Rounding may leave the target just above the sum.
    if chosen < 0:
        chosen = last
    return chosen


@wp.func
def guide_total(updates: ProbeUpdates, update: int) -> float:
    """Return the sum of all guides, in the order in which guided_cell adds."""
    total = float(0.0)
    for cell in range(CELLS):
        total = total + updates.guide[update * CELLS + cell]
    return total


@wp.func
def reflected_direction(
    view: View, gbuffer: GBuffer, grid: ProbeGrid, pixel: int, normal: wp.vec3, u: wp.vec2,
) -> wp.vec3:
    """Return a direction of the reflection at a pixel; zero where it lies below the surface."""
    s = load_surface(view, gbuffer, grid.width, pixel)
    alpha = wp.max(sqr(load_material(gbuffer, pixel).roughness), LEAST_ALPHA)
    wo = to_local(s.normal, view_direction(view, s))
    none = wp.vec3(0.0, 0.0, 0.0)
    if wo[2] <= 0.0:
        return none
    direction = to_frame(s.normal, sample_ggx_reflection(wo, alpha, alpha, u))
    if wp.dot(direction, normal) <= 0.0 or wp.dot(direction, s.normal) <= 0.0:
        return none
    return wp.normalize(direction)


@wp.kernel
def make_rays(
    first: int,
    # In:
    grid: ProbeGrid,
    views: wp.array[View],
    gbuffer: GBuffer,
    pool: ProbePool,
    # Out:
    updates_out: ProbeUpdates,
    rays_out: ProbeRays,
):
    """Make one ray, and find how many rays the cell of the same index may expect."""
    index = first + wp.tid()
    update = index // CELLS
    ray = index % CELLS
    slot = updates_out.slot[update]
    rays_out.probe[index] = slot
    rays_out.t_max[index] = 0.0
    updates_out.cell[index] = wp.uint8(NO_CELL)
    if slot < 0:
        return
    # Incremented when the update was committed.
    turn = pool.updates[slot] - 1
    seed = hash_combine(wp.uint32(slot), wp.uint32(grid.slots))
    normal = unpack_normal(updates_out.normal[update])
    specular = updates_out.specular[update]
    cell = int(0)
    dimension = int(0)
    if is_guided(grid, updates_out, update):
        # A sequence that fills its gaps from update to update depends on what the history holds, and weights that
        # depend on the history too would turn that into a bias: every update is independent.
        seed = hash_combine(seed, wp.uint32(turn))
        turn = 0
        guided = EVEN - specular
        total = guide_total(updates_out, update)
        share = 1.0 / float(CELLS)
        if total > 0.0:
            share = updates_out.guide[index] / total
        updates_out.expected[index] = 0.5 + float(guided) * share
        if ray < EVEN:
            parity = int(hash_combine(seed, wp.uint32(DIMENSION_PARITY)) & wp.uint32(1))
            cell = even_cell(ray, parity)
            dimension = cell
        else:
            stratum = hashed_unit(seed, wp.uint32(DIMENSION_STRATUM + ray))
            cell = guided_cell(updates_out, update, total, (float(ray - EVEN) + stratum) / float(wp.max(guided, 1)))
            # One sequence for all: those of a cell follow each other, so they are spread well over it.
            dimension = DIMENSION_GUIDED
            turn = ray
    else:
        if updates_out.covered[update] < CELLS or updates_out.count[update] <= 0.0:
            # No cell may stay empty.
            specular = 0
        updates_out.expected[index] = 1.0 - float(specular) / float(CELLS)
        shift = int(hashed_unit(seed, wp.uint32(DIMENSION_PARITY + turn)) * float(CELLS))
        cell = (ray + shift) % CELLS
        dimension = cell
    u = sample_pair(seed, wp.uint32(turn), dimension)
    direction = to_frame(normal, cell_direction(cell, u))
    if ray >= CELLS - specular:
        u = sample_pair(seed, wp.uint32(turn), DIMENSION_SPECULAR + ray)
        direction = reflected_direction(views[0], gbuffer, grid, updates_out.pixel[update], normal, u)
        if wp.length_sq(direction) == 0.0:
            return
    else:
        updates_out.cell[index] = wp.uint8(cell)
    rays_out.origin[index] = updates_out.position[update] + normal * updates_out.error[update]
    rays_out.direction[index] = direction
    rays_out.t_max[index] = RAY_LENGTH
