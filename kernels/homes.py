# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things that move were at home: cells of the radiance cache keep to them there.

A cell is a place. What moves would come to new ones in every frame, which know nothing yet; so the cells of what has
ever moved are those of the place where it was before, its home, apart from all others there.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import normalize_or, transform_normal, transform_point
from .sampling import hash32
from .types import Instance

NOWHERE = wp.constant(-1)

# Bit of a cell's key that only cells of what has moved have (hash_grid.cell_key).
MOVER_BIT = wp.constant(wp.uint64(1 << 10))
# Bits that a key's three indices end with, above those that wider cells leave out: what tells movers apart.
APART_BITS = wp.constant(wp.uint64(0x1FF))


@wp.struct
class Home:
    """Where one of the instances was before it first moved."""

    to_world: wp.mat44
    to_object: wp.mat44
    serial: int
    """No other has had it, so that none finds another's cells"""


@wp.struct
class Homes:
    """Homes of all that has moved."""

    of: wp.array[int]
    """Per instance: its row of `rows`, NOWHERE where it has not moved; empty where nothing has"""
    rows: wp.array[Home]
    instances: wp.array[Instance]


@wp.struct
class CellPlace:
    """A point of a surface, as cells are found by it."""

    position: wp.vec3
    """[m]; how large its cells are"""
    home: wp.vec3
    """Where it was at home [m]: which cell it lies in"""
    normal: wp.vec3
    """Geometric, on the side that is seen, at home"""
    mover: wp.uint64
    """What keys of its cells differ by from those of what stands still; 0: it does"""


@wp.func
def mover_bits(serial: int) -> wp.uint64:
    """Return what the keys of a mover's cells differ by from all others."""
    bits = wp.uint64(hash32(wp.uint32(serial)))
    apart = (bits & APART_BITS) << wp.uint64(53)
    apart = apart | (((bits >> wp.uint64(9)) & APART_BITS) << wp.uint64(36))
    apart = apart | (((bits >> wp.uint64(18)) & APART_BITS) << wp.uint64(19))
    return apart | MOVER_BIT


@wp.func
def still_place(position: wp.vec3, normal: wp.vec3) -> CellPlace:
    """Return the place of a point of what stands still."""
    place = CellPlace()
    place.position = position
    place.home = position
    place.normal = normal
    place.mover = wp.uint64(0)
    return place


@wp.func
def home_row(of: wp.array[int], instance: int) -> int:
    """Return an instance's row of homes (Homes.of), NOWHERE for one that has not moved or is none."""
    if instance >= 0 and instance < of.shape[0]:
        return of[instance]
    return NOWHERE


@wp.func
def cell_place(homes: Homes, instance: int, position: wp.vec3, normal: wp.vec3) -> CellPlace:
    """Return the place of a point.

    Args:
        homes: Of all that has moved.
        instance: Whose surface it is; one that is none stands still.
        position: Of the point [m].
        normal: Geometric, unit, on the side that is seen.
    """
    place = still_place(position, normal)
    row = home_row(homes.of, instance)
    if row != NOWHERE:
        home = homes.rows[row]
        place.home = transform_point(home.to_world, transform_point(homes.instances[instance].to_object, position))
        local = normalize_or(transform_normal(homes.instances[instance].to_world, normal), normal)
        place.normal = normalize_or(transform_normal(home.to_object, local), normal)
        place.mover = mover_bits(home.serial)
    return place
