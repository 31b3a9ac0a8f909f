# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog as real-time frames draw it: which of a scene's media it is, and how far it matters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ..kernels.fog import Fog, FogGrid
from ..kernels.media import NO_MEDIUM, Media
from ..kernels.volume_grids import Volumes
from .history import copy_struct

if TYPE_CHECKING:
    from .media import MediumData

__all__ = ["Bodies", "FogData", "GridPlace", "fog_data", "fog_struct"]

ENDLESS_RADII = 4.0
"""Radii of what is lit, or lights, to which the grids of an endless medium reach"""

SIGHT_DEPTH = 12.0
"""Optical depth beyond which nothing is seen"""

SMALL_SHARE = 0.5
"""Of the scene's radius, up to which a fog is small: one grid serves for all of it"""

COARSE = 0.35
"""Times that light is turned round over the width of the widest nested cells from which on one grid serves for all fog:
it needs fine cells wherever it is, not about the camera alone"""

OWN_DEPTH = 1.0
"""The same over the width of that grid's cells, from which on a body may have a grid of its own"""

OWN_SHARE = 0.7
"""Of the width of all fog, up to which a body may have its own"""

OWN_MOST = 3

SMALL_GRID, NESTED_GRIDS = (32, 1), (16, 4)
"""Cells along a side, and grids"""

DENSE = 4.0
"""Times that light is turned round over the width of its cells from which on frames show too little of a fog"""

SWEEPS_DEEP, SWEEPS_LEAST, SWEEPS_MOST = 4.0, 16, 128
"""Sweeps for each time that light is scattered from the middle of fog to its edge, and how many there are at least and
at most"""

LEAST_SIZE, MOST_SIZE = 1e-9, 1e12
"""[m]; those of hostile scenes may be any"""

STEPS = 4
"""Sizes of grids from one to twice as much: things that move a little don't ask for other records of the frame"""


@dataclass(frozen=True)
class FogData:
    """The fog of a scene on the device."""

    media: Media
    """The world's medium, and those within boundaries without a surface"""
    walls: bool
    """Whether there are boundaries"""
    middle: tuple[float, float, float]
    radius: float
    """Sphere that holds it, or so much of an endless one as matters [m]"""
    grids: tuple[GridPlace, ...]
    """Those of bodies before all others, the finest of these first"""
    rows: wp.array
    """The same on the device, FogGrid [n]"""
    side: int
    """Cells along a side of each"""
    own: int
    """How many are of bodies"""
    sight: float
    """How far one sees at most [m]"""
    sweeps: int
    """Times that light goes on from cell to cell within a frame while it spreads. All but the last scatter it alike in
    all directions: over the same rays again and again it would else grow more than over their mean"""
    traced: bool
    """Whether frames don't draw it: light goes about in it in steps too short for its cells"""
    volumes: Volumes | None = None
    """What of it varies in space; None: nothing does"""

    @property
    def cells(self) -> int:
        """Return how many cells there are."""
        return self.side ** 3 * len(self.grids)


@dataclass(frozen=True)
class GridPlace:
    """A grid of cells; fields as of kernels.fog.FogGrid."""

    middle: tuple[float, float, float]
    cell: float
    room: float = 0.0


@dataclass(frozen=True)
class Bodies:
    """What fog there is within boundaries."""

    low: np.ndarray
    high: np.ndarray
    """float [n, 3]; of each [m]"""
    thickness: np.ndarray
    """float [n, 2], as `MediumData.thickness` has it"""

    def __bool__(self) -> bool:
        return bool(len(self.low))

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the box of all: float64 [3] each."""
        return self.low.min(0).astype(np.float64), self.high.max(0).astype(np.float64)

    @property
    def radii(self) -> np.ndarray:
        """Return half of the diagonal of each [m]: float64 [n]."""
        return 0.5 * np.linalg.norm(self.high.astype(np.float64) - self.low, axis=1)

    @property
    def widths(self) -> np.ndarray:
        """Return the longest side of each [m]: float64 [n]."""
        return (self.high.astype(np.float64) - self.low).max(1)


def fog_data(
    media: Media, bare: list[int], world: MediumData | None, bodies: Bodies, lit: tuple[tuple[float, ...], float],
    scene_radius: float, about: tuple[float, float], before: FogData | None, volumes: Volumes | None,
) -> FogData:
    """Return a scene's fog.

    Args:
        media: All media of the scene.
        bare: Materials that have a medium and no surface.
        world: The world's medium.
        bodies: Boundaries that are drawn.
        lit: Middle and radius [m] of what light comes from or falls on.
        scene_radius: Half of the diagonal of all that is drawn [m].
        about: Thickness of the world's medium.
        before: What this scene had before, if its media are the same.
        volumes: What of the scene's media varies in space; None: nothing does.
    """
    middle, radius = np.asarray(lit[0], np.float64), _stepped(ENDLESS_RADII * lit[1])
    width, (side, levels) = 2.0 * radius, NESTED_GRIDS
    turned = bodies.thickness[:, 1]
    if world:
        # In steps as well.
        middle = np.round(middle / (0.25 * radius)) * (0.25 * radius)
    else:
        low, high = bodies.box
        middle, radius = 0.5 * (low + high), _stepped(0.5 * float(np.linalg.norm(high - low)))
        width = _stepped(float((high - low).max()))
        if radius <= SMALL_SHARE * scene_radius or turned.max() * width / side > COARSE:
            side, levels = SMALL_GRID
        width *= _widened(side)
    cell = width / (side << (levels - 1))
    own = own_grids(bodies, side, width, cell)
    nested = [cell * (1 << level) for level in range(levels)]
    grids = *own.values(), *(GridPlace(_triple(middle), each, 0.5 * side * (nested[-1] - each)) for each in nested)
    cells = np.array([own[body].cell if body in own else cell for body in range(len(turned))])
    fog = copy_struct(media)
    fog.middle, fog.reach = wp.vec3(), float(media.reach > 0.0)
    fog.low = fog.high = wp.vec3()
    if bodies:
        unit = 0.125 * radius
        fog.low = wp.vec3(*(np.floor(bodies.box[0] / unit) * unit))
        fog.high = wp.vec3(*(np.ceil(bodies.box[1] / unit) * unit))
    if before is not None:
        fog.of_material = before.media.of_material
    else:
        rows = np.full(len(media.of_material), int(NO_MEDIUM), np.int32)
        rows[bare] = media.of_material.numpy()[bare]
        fog.of_material = wp.array(rows, dtype=int, device=media.of_material.device)
    least = min(world.extinction) if world and world.varying is None else 0.0
    sight = SIGHT_DEPTH / least if least > 0.0 else 1e17
    about = np.nan_to_num(np.array(about))
    deepest = max([about[0] * radius, *(bodies.thickness[:, 0] * bodies.radii)])
    return FogData(
        fog, bool(bodies), _triple(middle), radius, grids, _rows(grids, before, fog.of_material.device), side,
        len(own), sight,
        sweeps=min(max(int(SWEEPS_DEEP * min(deepest, SWEEPS_MOST)), SWEEPS_LEAST), SWEEPS_MOST),
        traced=max([about[1] * cell, *(turned * cells)]) > DENSE, volumes=volumes)


def own_grids(bodies: Bodies, side: int, width: float, cell: float) -> dict[int, GridPlace]:
    """Return the grids of bodies that are too thick for cells of width `cell`: the thickest's, finest first.

    Args:
        bodies: All of them.
        side: Cells along a side of a grid.
        width: Of all fog [m].
        cell: [m].
    """
    thick = np.flatnonzero((bodies.thickness[:, 1] * cell > OWN_DEPTH) & (bodies.widths < OWN_SHARE * width))
    chosen = thick[np.argsort(-bodies.thickness[thick, 1], kind="stable")[:OWN_MOST]]
    middles = 0.5 * (bodies.low.astype(np.float64) + bodies.high)
    found = {int(body): GridPlace(
        _triple(middles[body]), _stepped(float(bodies.widths[body])) * _widened(side) / side) for body in chosen}
    return dict(sorted(found.items(), key=lambda item: item[1].cell))


def _widened(side: int) -> float:
    """Return how much wider a grid is than what it holds.

    Places are looked up up to half a cell beside them, and grids begin at whole cells.
    """
    return side / (side - 2)


def _triple(place: np.ndarray) -> tuple[float, float, float]:
    return tuple(float(x) for x in place)


def _rows(grids: tuple[GridPlace, ...], before: FogData | None, device: wp.Device) -> wp.array:
    """Return grids on the device, where they were before if there are as many: frames have recorded that place."""
    rows = np.zeros(len(grids), FogGrid.numpy_dtype())
    for row, grid in zip(rows, grids, strict=True):
        row["middle"], row["cell"], row["room"] = grid.middle, grid.cell, grid.room
    if before is None or len(before.rows) != len(rows):
        return wp.array(rows, dtype=FogGrid, device=device)
    if before.grids != grids:
        before.rows.assign(rows)
    return before.rows


def _stepped(size: float) -> float:
    """Return the next larger size of some [m]."""
    return 2.0 ** (math.ceil(math.log2(min(max(size, LEAST_SIZE), MOST_SIZE)) * STEPS) / STEPS)


def fog_struct(data: FogData) -> Fog:
    """Return what kernels are told of a fog, without its grids."""
    fog = Fog()
    fog.media, fog.walls = data.media, int(data.walls)
    if data.volumes is not None:
        fog.volumes, fog.varying = data.volumes, 1
    fog.grids, fog.side, fog.levels, fog.own = data.rows, data.side, len(data.grids), data.own
    fog.middle, fog.radius, fog.reach = wp.vec3(*data.middle), data.radius, data.sight
    return fog
