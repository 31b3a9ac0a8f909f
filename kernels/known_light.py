# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance cache knows of the light at a path's hit, so that the path may end there.

Paths beyond their second bounce bring a few hundredths of a room's light and most of its noise. Where the cache of
real-time frames knows that light, they can end (Ward, Rubinstein and Clear 1988 end rays so in their cache). What it
knows is a mean over a cell, a little off: so of later samples ever fewer end, and the limit is path tracing's.
"""

from __future__ import annotations

import warp as wp

from .hash_grid import NO_CELL, HashGrid, cell_level, cell_size, find_lit_cell, known_indirect
from .homes import cell_place
from .sampling import fraction, hash_combine
from .types import ShadingPoint
from .view import View

BOUNCES = wp.constant(2)
"""After which paths may end"""
WIDE = wp.constant(2.0)
"""Density [1/sr] up to which the last of them was wide: what a narrower one shows must be sharp"""
NEAR_CELLS = wp.constant(2.0)
"""Sizes of a cell from which on its mean stands for the light: close by it would leak into corners"""
GOLDEN = wp.constant(0.61803399)


@wp.struct
class KnownLight:
    """The cache as paths read it."""

    samples: int
    """Of which all paths may end in it, of later ones ever fewer; 0: none does, and the rest is empty"""
    views: wp.array[View]
    """[1] The newest frame's"""
    grid: HashGrid


@wp.func
def is_ending(known: KnownLight, index: wp.uint32) -> bool:
    """Tell whether a sample ends in the cache, in all pixels: of those about number n the share `samples` / n."""
    number = float(index)
    return known.samples > 0 and fraction(number * GOLDEN) * number < float(known.samples)


@wp.func
def may_end(known: KnownLight, index: wp.uint32, bounce: int, pdf: float) -> bool:
    """Tell whether a path may end in the cache where it is.

    Args:
        known: The cache.
        index: Number of the sample.
        bounce: Rays of the path but for the camera's.
        pdf: Density of the last one [1/sr]; 0 for a mirror's.
    """
    return bounce >= BOUNCES and pdf > 0.0 and pdf <= WIDE and is_ending(known, index)


@wp.func
def known_light(known: KnownLight, point: ShadingPoint, direction: wp.vec3, seed: wp.uint32) -> wp.vec4:
    """Return irradiance / pi at a hit [W/m2/sr]; w = 0 where the cache does not know it well enough.

    Args:
        known: The cache.
        point: The hit.
        direction: Of the ray that arrives.
        seed: Of the look-up.
    """
    nothing = wp.vec4(0.0, 0.0, 0.0, 0.0)
    view = known.views[0]
    level = cell_level(known.grid, view, point.position, seed)
    if point.ray_length < NEAR_CELLS * cell_size(level):
        return nothing
    place = cell_place(known.grid.homes, point.instance, point.position, point.geometric_normal)
    cell = find_lit_cell(known.grid, view, place, direction, seed)
    if cell == NO_CELL:
        return nothing
    direct = known.grid.direct[cell]
    indirect = known_indirect(known.grid, view, cell, place, direction, seed)
    if not indirect[3] > 0.0:
        return nothing
    return wp.vec4(direct[0] + indirect[0], direct[1] + indirect[1], direct[2] + indirect[2], 1.0)


@wp.func
def path_seed(seed: wp.uint32, index: wp.uint32, bounce: int) -> wp.uint32:
    """Return the seed of a path's look-up."""
    return hash_combine(hash_combine(seed, index), wp.uint32(bounce))
