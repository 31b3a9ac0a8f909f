# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the grid of a medium that varies in space, as fine as it asks for."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from ..kernels import types
from ..kernels.volume_bake import VolumeTable, bake_volume, bound_blocks
from ..kernels.volume_grids import BLOCK, WIDE, Field, VolumeGrid
from .device import launch_bands
from .materials import single_program
from .object_properties import PROPERTY_PREFIX
from .program import Program
from .volume_program import OPTIONAL_PREFIX, FieldData, VaryingData

__all__ = ["BakedGrid", "Box", "Oven", "bake_boxes", "channels_of", "field_rows"]

COEFFICIENT_MAX = 1e20
"""As of media.py"""
ANISOTROPY_MAX = 0.999

CELLS_FIRST = 32
"""Along each side of the coarsest grid"""

TOLERANCE = 1e-3
"""Mean error of a grid, of its mean, with which it is fine enough"""

SLAB = 1 << 18
"""Cells whose attributes are on the device at once"""


@dataclass(frozen=True)
class Box:
    """A box of cells."""

    low: tuple[float, float, float]
    size: tuple[float, float, float]
    """Corner and sides, in the space that grids are looked up in before `to_cells`: an object's, or the scene's"""
    cells: tuple[int, int, int]
    octaves: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The world's, as of kernels.volume_grids.VolumeGrid; `low` is the middle then, `size` the distance of 1 from it"""

    @property
    def count(self) -> int:
        """Return the number of cells."""
        return self.cells[0] * self.cells[1] * self.cells[2]

    @property
    def blocks(self) -> tuple[int, int, int]:
        """Return the number of blocks along each side."""
        return tuple(-(-n // int(BLOCK)) for n in self.cells)

    def to_cells(self) -> np.ndarray:
        """Return the matrix from the box's space to cells, or distances from the middle: float64 [4, 4]."""
        scale = (1.0 if any(self.octaves) else np.array(self.cells)) / np.maximum(np.array(self.size), 1e-30)
        matrix = np.diag([*scale, 1.0])
        matrix[:3, 3] = -scale * np.array(self.low)
        return matrix

    def finer(self, factor: int) -> Box:
        """Return the same box of more cells."""
        return Box(self.low, self.size, tuple(n * factor for n in self.cells))


def box_of(low: np.ndarray, high: np.ndarray, cells: int) -> Box:
    """Return the box of some bounds (float64 [3] each) with so many cells along each side: flat ones hold fog too."""
    size = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-20))
    return Box(tuple(low.tolist()), tuple(size.tolist()), (cells,) * 3)


def channels_of(varying: VaryingData) -> list[tuple[Program, bool, bool]]:
    """Return the programs that are tabled: each with whether it has three channels, and whether it may be below 0."""
    found: list[tuple[Program, bool, bool]] = []
    for number, part in enumerate(varying.fields):
        key = part.program, part.wide, number >= 3 and number % 2 == 1
        if part.program is not None and key not in found:
            found.append(key)
    return found


def field_rows(varying: VaryingData) -> list[tuple]:
    """Return the rows of a medium's coefficients: (color, channel, wide) each."""
    starts, place = {}, 0
    for key in channels_of(varying):
        starts[key] = place
        place += 3 if key[1] else 1
    rows = []
    for number, part in enumerate(varying.fields):
        signed = number >= 3 and number % 2 == 1
        channel = -1 if part.program is None else starts[part.program, part.wide, signed]
        rows.append((limited(part, signed), channel, int(part.wide)))
    return rows


def limited(part: FieldData, signed: bool) -> np.ndarray:
    """Return a coefficient's colour within what kernels can take."""
    limit = ANISOTROPY_MAX if signed and part.program is None else COEFFICIENT_MAX
    return np.clip(np.nan_to_num(np.asarray(part.color, np.float64)), -limit, limit)


@dataclass(eq=False)
class BakedGrid:
    """Values of one box."""

    box: Box
    values: wp.array
    """float [channels * cells]"""
    bounds: wp.array
    """vec2; of blocks, wide blocks and all, as of kernels.volume_grids.Volumes"""
    thickness: float = 0.0
    """The largest extinction of a block where there is something, in the mean by as much as there is [1/m]"""


@dataclass(eq=False)
class Oven:
    """Runs a medium's programs over boxes."""

    varying: VaryingData
    scene: types.Scene
    """Whose images the programs read"""
    image_index: Callable[[Hashable], int]
    origin: tuple[float, float, float]
    device: str
    row: np.ndarray | None = None
    """The object's row of kernels.types.Instance; None: the world"""
    to_point: np.ndarray = field(default_factory=lambda: np.eye(4))
    """float64 [4, 4], from the boxes' space to the programs' points"""
    properties: dict[str, np.ndarray] = field(default_factory=dict)
    """float32 [4], the object's properties by name"""
    grids: dict[str, np.ndarray] = field(default_factory=dict)
    """float32 [z, y, x, 4] by name: what attributes are, in boxes of as many cells"""
    pass_index: int = 0
    """Of the material"""

    def __post_init__(self) -> None:
        """Put the programs and the object on the device."""
        programs = channels_of(self.varying)
        names = {name for program, _, _ in programs for name in program.attributes}
        self._properties = sorted(name for name in names if name.startswith(PROPERTY_PREFIX))
        self._attributes = sorted(
            name for name in names - set(self._properties)
            if name.startswith(OPTIONAL_PREFIX) or name in self.grids)
        self._programs = []
        for program, wide, signed in programs:
            lone = types.Scene()
            lone.materials, start = single_program(program, self.image_index, self.origin, self.device, self._number)
            self._programs.append((lone, start, wide, signed))
        count = 3 * SLAB * max(-(-len(self._attributes) // 3), 1) + 2 if self._attributes else 1
        self._attribute_arrays = wp.zeros(count, dtype=wp.vec4, device=self.device)
        for lone, *_ in self._programs:
            self._furnish(lone)

    def _number(self, name: str) -> int:
        for names in (self._properties, self._attributes):
            if name in names:
                return names.index(name)
        return -1

    def _furnish(self, lone: types.Scene) -> None:
        """Give a scene the object, and what its programs read."""
        geometry = types.Geometry()
        row = np.zeros(1, types.Instance.numpy_dtype())
        if self.row is not None:
            row[0] = self.row
        row["mesh"] = row["triangle_offset"] = 0
        geometry.instances = wp.array(row, dtype=types.Instance, device=self.device)
        # Three attributes lie side by side: corners of "triangles" of which the first alone counts.
        numbers = [[3 * SLAB * (n // 3) + n % 3 for n in range(max(len(self._attributes), 1))]]
        geometry.attribute_offsets = wp.array(np.array(numbers, np.int32), dtype=int, device=self.device)
        geometry.attributes = self._attribute_arrays
        lone.geometry = geometry
        lone.textures, lone.luminance = self.scene.textures, self.scene.luminance
        values = np.array([self.properties.get(name, np.zeros(4)) for name in self._properties] or [np.zeros(4)])
        lone.materials.properties = wp.array(values.astype(np.float32), dtype=wp.vec4, device=self.device)
        material = np.zeros(1, types.Material.numpy_dtype())
        material["pass_index"] = self.pass_index
        lone.materials.materials = wp.array(material, dtype=types.Material, device=self.device)

    def _load_attributes(self, first: int, count: int) -> None:
        """Put the attributes of some cells on the device."""
        if not self._attributes:
            return
        held = np.zeros((-(-len(self._attributes) // 3), SLAB, 3, 4), np.float32)
        for number, name in enumerate(self._attributes):
            grid = self.grids.get(name.removeprefix(OPTIONAL_PREFIX))
            part = 1.0 if grid is None else grid.reshape(-1, 4)[first:first + count]
            held[number // 3, :count, number % 3] = part
        flat = np.concatenate([held.reshape(-1, 4), np.zeros((2, 4), np.float32)])
        self._attribute_arrays.assign(flat)

    def bake(self, box: Box) -> BakedGrid:
        """Return the grid of a box."""
        channels = sum(3 if wide else 1 for _, _, wide, _ in self._programs)
        values = wp.zeros(max(channels, 1) * box.count, dtype=float, device=self.device)
        to_point = self.to_point @ np.linalg.inv(box.to_cells())
        slab = SLAB if self._attributes else box.count
        for first in range(0, box.count, slab):
            count = min(slab, box.count - first)
            self._load_attributes(first, count)
            offset = 0
            for lone, start, wide, signed in self._programs:
                table = VolumeTable()
                table.to_point = wp.mat44(*to_point.astype(np.float32).ravel().tolist())
                table.octaves = wp.vec3(*box.octaves)
                table.x, table.y, table.z = box.cells
                table.instance = -1 if self.row is None else 0
                table.start, table.offset, table.channels = start, offset, 3 if wide else 1
                table.low, table.high = (-ANISOTROPY_MAX, ANISOTROPY_MAX) if signed else (0.0, COEFFICIENT_MAX)
                table.attributes = first
                launch_bands(bake_volume, first, count, [lone, table], [values])
                offset += table.channels * box.count
        grid = VolumeGrid()
        grid.x, grid.y, grid.z = box.cells
        grid.blocks_x, grid.blocks_y, grid.blocks_z = box.blocks
        rows = np.zeros(len(self.varying.fields), Field.numpy_dtype())
        for row, (color, channel, wide) in zip(rows, field_rows(self.varying), strict=True):
            row["color"], row["channel"], row["wide"] = color, channel, wide
        fields = wp.array(rows, dtype=Field, device=self.device)
        blocks = int(np.prod(box.blocks))
        bounds = wp.zeros(blocks, dtype=wp.vec2, device=self.device)
        launch_bands(bound_blocks, 0, blocks, [grid, fields, values], [bounds])
        held = bounds.numpy()
        extinction = held[:, 0].astype(np.float64)
        return BakedGrid(
            box, values, wp.array(with_wide(held, box.blocks), dtype=wp.vec2, device=self.device),
            float((extinction * extinction).sum() / max(extinction.sum(), 1e-300)))


def with_wide(bounds: np.ndarray, blocks: tuple[int, int, int]) -> np.ndarray:
    """Return blocks' bounds [n, 2] with those of wide blocks and of all behind them."""
    x, y, z = blocks
    ratio = int(WIDE) // int(BLOCK)
    sides = [-(-count // ratio) for count in (z, y, x)]
    padded = np.zeros([ratio * side for side in sides] + [2], np.float32)
    padded[:z, :y, :x] = bounds.reshape(z, y, x, 2)
    wide = padded.reshape(sides[0], ratio, sides[1], ratio, sides[2], ratio, 2).max((1, 3, 5)).reshape(-1, 2)
    return np.concatenate([bounds, wide, bounds.max(0, keepdims=True)])


def bake_boxes(oven: Oven, low: np.ndarray, high: np.ndarray, cells_max: int) -> BakedGrid:
    """Return the grid of some bounds, as fine as the medium asks for; arguments as of box_of."""
    box = box_of(low, high, min(CELLS_FIRST, cells_max))
    coarse = oven.bake(box)
    cells = max(box.cells)
    if 2 * cells > cells_max:
        return coarse
    fine = oven.bake(box.finer(2))
    if 4 * cells > cells_max or is_fine(coarse, fine):
        return fine
    return oven.bake(box.finer(cells_max // cells))


def is_fine(coarse: BakedGrid, fine: BakedGrid) -> bool:
    """Return whether a grid of half as many cells along each side comes to nearly the same."""
    x, y, z = coarse.box.cells
    before = coarse.values.numpy().reshape(-1, z, y, x).astype(np.float64)
    after = fine.values.numpy().reshape(-1, 2 * z, 2 * y, 2 * x).astype(np.float64)
    error = np.abs(doubled(before) - after).mean((1, 2, 3))
    return bool((error <= TOLERANCE * np.abs(after).mean((1, 2, 3))).all())


def doubled(values: np.ndarray) -> np.ndarray:
    """Return grids [n, z, y, x] twice as fine, as a trilinear look-up has them."""
    for axis in (1, 2, 3):
        moved = np.moveaxis(values, axis, 0)
        before, after = np.concatenate([moved[:1], moved[:-1]]), np.concatenate([moved[1:], moved[-1:]])
        both = np.stack([0.75 * moved + 0.25 * before, 0.75 * moved + 0.25 * after], 1)
        values = np.moveaxis(both.reshape(-1, *moved.shape[1:]), 0, axis)
    return values


def concatenated(arrays: Sequence[wp.array], dtype: type, device: str) -> wp.array:
    """Return arrays one after the other; a single one as it is."""
    if len(arrays) == 1:
        return arrays[0]
    total = wp.zeros(max(sum(len(each) for each in arrays), 1), dtype=dtype, device=device)
    place = 0
    for each in arrays:
        wp.copy(total, each, dest_offset=place, count=len(each))
        place += len(each)
    return total
