# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of all lamps whose node trees vary, as kernels look them up (lamp_tables.py there)."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ..kernels import lamp_tables as layout
from .lamp_bake import BakedLamp, bake, distance_grid
from .lamp_needs import find_needs, lamp_axes, table_key, tell_needs
from .lamps import drawn_lamps, lamp_rows
from .report import ReportKind
from .scene import LightData

if TYPE_CHECKING:
    from .device_scene import DeviceScene

__all__ = ["LampTables"]

WIDTH_MAX, WIDTH_MAX_PROCESSOR = 1024, 512
"""Texels across a picture, at most; on a processor it takes the time of an edit"""

WIDTH_LEAST = 64

TEXELS_MAX = 1 << 24
"""Of all tables together: where there are more, they are coarser"""

PRODUCT_TOLERANCE = 0.05
"""Error of a factor of distance times one of direction from which it is named in the report"""

ROWS = int(layout.HEADER_ROWS)
PAGE = int(layout.TABLE_PAGES)


@dataclass(eq=False)
class LampTables:
    """The tables of one scene's lamps on one device."""

    device: str
    array: wp.array = None
    """Lights.tables"""
    baked: dict[Hashable, BakedLamp] = field(default_factory=dict)
    _starts: dict[Hashable, tuple[int, int]] = field(default_factory=dict)
    """By key, the pages at which pictures and distances begin"""
    _layout: tuple = ()
    """What `array` holds"""

    def __post_init__(self) -> None:
        """Start without tables."""
        self.array = wp.zeros(1, dtype=wp.vec4, device=self.device)

    def rows(self, scene: DeviceScene, *, stale: bool) -> np.ndarray:
        """Return a scene's lamps as lamps.lamp_array does, with the means and tables of those that have programs.

        Args:
            scene: Its lights and images are read.
            stale: Whether images may have changed.
        """
        drawn = drawn_lamps(scene.lights, scene.origin, scene.report)
        rows, lights = lamp_rows(drawn), [light for light, _ in drawn]
        chosen = [row for row, light in enumerate(lights) if light.program is not None]
        if stale or not chosen:
            self.baked, self._layout = {}, ()
        if not chosen:
            return rows
        needs = {row: find_needs(lights[row]) for row in chosen}
        keys = {row: table_key(lights[row], needs[row]) for row in chosen}
        width = WIDTH_MAX if wp.get_device(self.device).is_cuda else WIDTH_MAX_PROCESSOR
        while 2 * len(set(keys.values())) * width * width > TEXELS_MAX and width > WIDTH_LEAST:
            width //= 2
        kept: dict[Hashable, BakedLamp] = {}
        users = []
        for row in chosen:
            light, key = lights[row], (width, keys[row])
            if key not in kept:
                kept[key] = self.baked.get(key) or bake(
                    light, rows[row], needs[row], scene.scene, scene.textures.index, width, self.device)
            baked = kept[key]
            tell_needs(light, needs[row], scene.report)
            if baked.product_error > PRODUCT_TOLERANCE:
                scene.report.add(
                    ReportKind.APPROXIMATED, f"light '{light.name}'",
                    "has a node tree of distance and direction together; the product of both alone is drawn")
            with np.errstate(over="ignore"):
                rows[row]["radiance"] *= baked.mean * distance_factor(baked, scene.radius)
            if not np.isfinite(rows[row]["radiance"]).all():
                scene.report.add(ReportKind.ERROR, f"light '{light.name}'", "strength is not finite; left out")
                rows[row]["radiance"] = 0.0
            elif baked.texels is not None or baked.distances is not None:
                users.append((row, key))
        self.baked = kept
        if users:
            self._place(users, lights, rows, scene.radius)
        return rows

    def _place(
        self, users: list[tuple[int, Hashable]], lights: list[LightData], rows: np.ndarray, radius: float,
    ) -> None:
        """Put headers and tables on the device; where the tables stay, only the headers change."""
        head = -(-len(users) * ROWS // PAGE)
        order = (head, radius, *dict.fromkeys(key for _, key in users))
        if order != self._layout:
            self._fill(head, order[2:], radius)
            self._layout = order
        headers = np.zeros((len(users) * ROWS, 4), np.float32)
        for number, (row, key) in enumerate(users):
            headers[number * ROWS:(number + 1) * ROWS] = header_of(
                lights[row], rows[row], self.baked[key], self._starts[key])
            rows[row]["flags"] |= number + 1 << int(layout.LAMP_TABLE_SHIFT)
        wp.copy(self.array, wp.array(headers, dtype=wp.vec4, device="cpu"), count=len(headers))

    def _fill(self, head: int, keys: tuple[Hashable, ...], radius: float) -> None:
        """Put tables on the device after `head` pages of headers."""
        parts, used = [np.zeros((head * PAGE, 4), np.float32)], head
        for key in keys:
            starts = []
            for part in (picture_rows(self.baked[key]), distance_rows(self.baked[key], radius)):
                starts.append(used if part is not None else 0)
                if part is not None:
                    pages = -(-len(part) // PAGE)
                    parts.append(np.pad(part, ((0, pages * PAGE - len(part)), (0, 4 - part.shape[1]))))
                    used += pages
            self._starts[key] = tuple(starts)
        self.array = wp.array(np.concatenate(parts), dtype=wp.vec4, device=self.device)


def picture_rows(baked: BakedLamp) -> np.ndarray:
    """Return a table's texels as rows: float32 [n, 3]."""
    return np.ones((1, 3), np.float32) if baked.texels is None else baked.texels.reshape(-1, 3)


def distance_rows(baked: BakedLamp, radius: float) -> np.ndarray | None:
    """Return a table's logarithms of factors of distance, 0 at the scene's radius [m]: float32 [n, 3]."""
    if baked.distances is None:
        return None
    return (baked.distances - np.log2(np.maximum(distance_factor(baked, radius), 1e-30))).astype(np.float32)


def distance_factor(baked: BakedLamp, radius: float) -> np.ndarray:
    """Return the factor of a distance [m]: float64 [3]."""
    if baked.distances is None:
        return np.ones(3)
    at, grid = np.log2(max(radius, 1e-30)), np.log2(distance_grid())
    return np.array([2.0 ** np.interp(at, grid, baked.distances[:, channel]) for channel in range(3)])


def header_of(light: LightData, row: np.void, baked: BakedLamp, starts: tuple[int, int]) -> np.ndarray:
    """Return a lamp's header: float32 [HEADER_ROWS, 4]."""
    header = np.zeros((ROWS, 4), np.float32)
    header[:3, :3] = lamp_axes(light)
    if baked.kind == layout.TABLE_PLACE:
        for axis, edge in enumerate((row["axis_u"], row["axis_v"])):
            edge = np.asarray(edge, np.float64)
            header[axis, :3] = 2.0 * edge / max(float(edge @ edge), 1e-30)
    pictures, height, width = (1, 1, 1) if baked.texels is None else baked.texels.shape[:3]
    header[:3, 3] = width, height, baked.scale
    header[3] = *starts, baked.kind, pictures
    return header
