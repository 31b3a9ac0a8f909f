# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog as real-time frames draw it: which of a scene's media it is, and how far it matters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ..kernels.fog import Fog
from ..kernels.media import NO_MEDIUM, Media
from .history import copy_struct

if TYPE_CHECKING:
    from .media import MediumData

__all__ = ["FogData", "fog_data", "fog_struct"]

ENDLESS_RADII = 4.0
"""Radii of what is lit, or lights, to which the grids of an endless medium reach"""

SIGHT_DEPTH = 12.0
"""Optical depth beyond which nothing is seen"""

SMALL_SHARE = 0.5
"""Of the scene's radius, up to which a fog is small: one grid serves for all of it"""

SMALL_GRID, NESTED_GRIDS = (32, 1), (16, 4)
"""Cells along a side, and grids"""

MOST_CELLS = max(side ** 3 * levels for side, levels in (SMALL_GRID, NESTED_GRIDS))

DENSE = 0.35
"""Times that light is scattered over the width of the finest cells from which on frames lose too much of it"""

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
    width: float
    """Of its widest grid [m]"""
    side: int
    levels: int
    """Cells along a side, and grids"""
    sight: float
    """How far one sees at most [m]"""
    even: bool
    """Whether it scatters light alike in all directions"""
    traced: bool
    """Whether frames don't draw it: it varies in space, or light goes about in it in steps too short for its cells"""

    @property
    def cells(self) -> int:
        """Return how many cells there are."""
        return self.side ** 3 * self.levels


def fog_data(
    media: Media, bare: list[int], world: MediumData | None, low: np.ndarray, high: np.ndarray,
    lit: tuple[tuple[float, ...], float], scene_radius: float, mediums: list[MediumData], before: FogData | None,
    *, varies: bool,
) -> FogData:
    """Return a scene's fog.

    Args:
        media: All media of the scene.
        bare: Materials that have a medium and no surface.
        world: The world's medium.
        low: Of boundaries that are drawn [m], [n, 3].
        high: The same.
        lit: Middle and radius [m] of what light comes from or falls on.
        scene_radius: Half of the diagonal of all that is drawn [m].
        mediums: All that is in `media`, the world's included.
        before: What this scene had before, if its media are the same.
        varies: Whether media of the scene vary in space: frames don't draw that.
    """
    walls = bool(len(low))
    middle, radius = np.asarray(lit[0], np.float64), _stepped(ENDLESS_RADII * lit[1])
    width, (side, levels) = 2.0 * radius, NESTED_GRIDS
    if world:
        # In steps as well.
        middle = np.round(middle / (0.25 * radius)) * (0.25 * radius)
    else:
        box = low.min(0).astype(np.float64), high.max(0).astype(np.float64)
        middle, radius = 0.5 * (box[0] + box[1]), _stepped(0.5 * float(np.linalg.norm(box[1] - box[0])))
        width = _stepped(float((box[1] - box[0]).max()))
        if radius <= SMALL_SHARE * scene_radius:
            side, levels = SMALL_GRID
        # Places are looked up up to half a cell beside them, and grids begin at whole cells.
        width *= side / (side - 2)
    fog = copy_struct(media)
    fog.middle, fog.reach = wp.vec3(), float(media.reach > 0.0)
    fog.low = fog.high = wp.vec3()
    if walls:
        unit = 0.125 * radius
        fog.low = wp.vec3(*(np.floor(low.min(0) / unit) * unit))
        fog.high = wp.vec3(*(np.ceil(high.max(0) / unit) * unit))
    if before is not None:
        fog.of_material = before.media.of_material
    else:
        rows = np.full(len(media.of_material), int(NO_MEDIUM), np.int32)
        rows[bare] = media.of_material.numpy()[bare]
        fog.of_material = wp.array(rows, dtype=int, device=media.of_material.device)
    least = min(world.extinction) if world else 0.0
    sight = SIGHT_DEPTH / least if least > 0.0 else 1e17
    phases = [phase for medium in mediums for phase in medium.phases]
    # What goes straight on is hardly scattered.
    steps = [max(phase.scattering) * (1.0 - max(phase.anisotropy, 0.0)) for phase in phases]
    cell = width / (side << (levels - 1))
    return FogData(
        fog, walls, tuple(float(x) for x in middle), radius, width, side, levels, sight,
        even=all(phase.anisotropy == 0.0 for phase in phases),
        traced=varies or max(steps, default=0.0) * cell > DENSE)


def _stepped(size: float) -> float:
    """Return the next larger size of some [m]."""
    return 2.0 ** (math.ceil(math.log2(min(max(size, LEAST_SIZE), MOST_SIZE)) * STEPS) / STEPS)


def fog_struct(data: FogData) -> Fog:
    """Return what kernels are told of a fog, without its grids."""
    fog = Fog()
    fog.media, fog.walls = data.media, int(data.walls)
    fog.side, fog.levels = data.side, data.levels
    fog.middle, fog.radius, fog.reach = wp.vec3(*data.middle), data.radius, data.sight
    fog.cell = data.width / (data.side << (data.levels - 1))
    return fog
