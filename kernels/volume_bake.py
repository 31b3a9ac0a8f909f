# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels that table what fills an object or the world: a program's value in each cell, and bounds of blocks."""

from __future__ import annotations

import warp as wp

from .geometry_math import max_component, transform_point
from .nodes import run
from .types import Scene, ShadingPoint
from .volume_grids import BLOCK, FIELD_EMISSION, FIELD_EXTINCTION, Field, VolumeGrid, narrowed

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.struct
class VolumeTable:
    """What is tabled of one program."""

    to_point: wp.mat44
    """From cells, or distances from the middle, to where the program's points are"""
    octaves: wp.vec3
    """As of VolumeGrid"""
    x: int
    y: int
    z: int
    """Number of cells"""
    instance: int
    """0; -1: the world"""
    start: int
    """The program's first instruction"""
    offset: int
    """Place of its first value"""
    channels: int
    """1 or 3, one after the other"""
    low: float
    high: float
    """What values are limited to"""
    attributes: int
    """The cell whose attributes are those of the scene's triangle 0"""


@wp.func
def limited(table: VolumeTable, x: float) -> float:
    """Return a value within limits."""
    if not wp.isfinite(x):
        return 0.0
    return wp.clamp(x, table.low, table.high)


@wp.kernel
def bake_volume(
    # In:
    first: int,
    scene: Scene,
    table: VolumeTable,
    # Out:
    values_out: wp.array[float],
):
    """Fill cells with what a program emits at their middles.

    Args:
        first: Cell of the first thread.
        scene: Its only instance is the object, its programs are the volume's; attributes are those of cells.
        table: What is tabled.
        values_out: By channel, z, y, x, from the table's offset on.
    """
    index = first + wp.tid()
    i = index % table.x
    j = (index // table.x) % table.y
    k = index // (table.x * table.y)
    point = ShadingPoint()
    point.position = transform_point(table.to_point, wp.vec3(
        narrowed(float(i) + 0.5, table.x, table.octaves[0]), narrowed(float(j) + 0.5, table.y, table.octaves[1]),
        narrowed(float(k) + 0.5, table.z, table.octaves[2])))
    point.instance = table.instance
    point.triangle = index - table.attributes
    color = run(scene, point, table.start, 0.0).emission
    place = table.offset + index
    values_out[place] = limited(table, color[0])
    if table.channels == 3:
        count = table.x * table.y * table.z
        values_out[place + count] = limited(table, color[1])
        values_out[place + 2 * count] = limited(table, color[2])


@wp.func
def largest_in(grid: VolumeGrid, field: Field, values: wp.array[float], cell: int) -> float:
    """Return the largest channel of a coefficient in a cell."""
    if field.channel < 0:
        return max_component(field.color)
    count = grid.x * grid.y * grid.z
    place = grid.values + cell + field.channel * count
    first = values[place]
    if field.wide == 0:
        return first * max_component(field.color)
    return wp.max(first, wp.max(values[place + count], values[place + 2 * count]))


@wp.kernel
def bound_blocks(
    # In:
    first: int,
    grid: VolumeGrid,
    fields: wp.array[Field],
    values: wp.array[float],
    # Out:
    bounds_out: wp.array[wp.vec2],
):
    """Find the largest extinction and emission about each block of a grid, one thread a block.

    Cells beside it count: coefficients are interpolated.
    """
    block = first + wp.tid()
    i = block % grid.blocks_x
    j = (block // grid.blocks_x) % grid.blocks_y
    k = block // (grid.blocks_x * grid.blocks_y)
    extinction = fields[grid.fields + FIELD_EXTINCTION]
    emission = fields[grid.fields + FIELD_EMISSION]
    largest = wp.vec2(0.0, 0.0)
    z = wp.max(k * BLOCK - 1, 0)
    while z <= wp.min((k + 1) * BLOCK, grid.z - 1):
        y = wp.max(j * BLOCK - 1, 0)
        while y <= wp.min((j + 1) * BLOCK, grid.y - 1):
            x = wp.max(i * BLOCK - 1, 0)
            while x <= wp.min((i + 1) * BLOCK, grid.x - 1):
                cell = (z * grid.y + y) * grid.x + x
                largest = wp.max(largest, wp.vec2(
                    largest_in(grid, extinction, values, cell), largest_in(grid, emission, values, cell)))
                x = x + 1
            y = y + 1
        z = z + 1
    bounds_out[grid.blocks + block] = largest
