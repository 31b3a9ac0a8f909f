# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of all media of a scene that vary in space, made where they change, as the path tracer's kernels read them."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ..kernels.volume_grids import Field, VolumeGrid, Volumes
from .instance_rows import inverses
from .volume_bake import BakedGrid, Box, Oven, bake_boxes, concatenated, field_rows
from .volume_data import VolumeData
from .volume_program import VaryingData

if TYPE_CHECKING:
    from .device_scene import DeviceScene
    from .media import MediumData

__all__ = ["SceneVolumes"]

CELLS_MAX = {False: 128, True: 256}
"""Along each side of an object's grid, on a processor and on CUDA"""

VALUES_MAX = {False: 1 << 25, True: 1 << 27}
"""Of all objects' grids together, which get coarser for it [floats]"""

WORLD_CELLS = (128, 128, 512)
"""Of the world's box"""

WORLD_SCALE = (1.0 / 64.0, 1.0 / 64.0, 1.0 / 4096.0)
"""Of the scene's radius, the distance from the middle within which the world's cells are about alike"""

WORLD_SIZE = 4096.0
"""Of the scene's radius, half the sides of the world's box"""


@dataclass(frozen=True)
class _Body:
    """An object with a medium that varies."""

    instance: int
    medium: int
    """Row of the scene's media"""
    material: int
    varying: VaryingData
    density: float
    """Factor on what is tabled"""


class SceneVolumes:
    """The grids of one scene; those that nothing has changed are kept."""

    def __init__(self, device: str) -> None:
        self.device = device
        self.cuda = wp.get_device(device).is_cuda
        self._baked: dict[Hashable, BakedGrid] = {}
        self._joined: tuple[list[BakedGrid], wp.array, wp.array] | None = None
        self._rows: dict[str, tuple[np.ndarray, wp.array]] = {}
        self.thickness: dict[int | None, tuple[float, float]] = {}
        """By material, None for the world, as `MediumData.thickness` has it, of the thickest of its grids"""

    def update(
        self, source: DeviceScene, places: Mapping[int, tuple[int, MediumData]], world: MediumData | None,
        images_changed: bool,
    ) -> Volumes | None:
        """Return what varies, None where nothing does.

        Args:
            source: The scene.
            places: Row of the scene's media, and medium, by material.
            world: The world's.
            images_changed: Forget what has been made of images.
        """
        bodies = self._bodies(source, places)
        outside = world.varying if world is not None else None
        if not bodies and outside is None:
            self._baked.clear()
            self._joined = None
            self.thickness = {}
            return None
        if images_changed:
            self._baked = {key: grids for key, grids in self._baked.items() if not any(
                part.program is not None and part.program.images for part in key[0].fields)}
        before, self._baked, self.thickness = self._baked, {}, {}
        chosen = []
        cells = self._cells(bodies)
        for body in bodies:
            key = self._key(source, body, cells)
            if key not in self._baked:
                self._baked[key] = before.get(key) or self._bake(source, body, cells)
            chosen.append(self._baked[key])
            here = places[body.material][1].thickness_of(chosen[-1].thickness * body.density)
            self.thickness[body.material] = max(here, self.thickness.get(body.material, here))
        if outside is not None:
            key = (outside, "world", source.radius, tuple(source.origin), self._middle(source))
            self._baked[key] = before.get(key) or self._bake_world(source, outside)
            chosen.append(self._baked[key])
            self.thickness[None] = world.thickness_of(chosen[-1].thickness)
        return self._struct(source, bodies, chosen, outside, places)

    def _bodies(self, source: DeviceScene, places: Mapping[int, tuple[int, MediumData]]) -> list[_Body]:
        """Return all drawn objects with media that vary."""
        table, found = source.table, []
        varying = {material: medium for material, (_, medium) in places.items()
                   if medium.varying is not None or medium.in_grids is not None}
        if not varying:
            return found
        by_set = [[source.material_table.index(key) for key in keys] for keys in table.material_sets]
        with_any = np.array([any(material in varying for material in materials) for materials in by_set], bool)
        for instance in np.flatnonzero(source.drawn & with_any[table.material_set_index]).tolist():
            volume = self._volume(source, instance)
            for material in dict.fromkeys(by_set[table.material_set_index[instance]]):
                if material not in varying:
                    continue
                row, medium = places[material]
                data = medium.varying if volume is None else medium.in_grids
                if data is not None:
                    density = 1.0 if volume is None else volume.density(table.transforms[instance])
                    found.append(_Body(instance, row, material, data, density))
        return found

    def _volume(self, source: DeviceScene, instance: int) -> VolumeData | None:
        """Return the grids of an instance that is a volume object, else None."""
        return source.store.ranges[source.table.mesh_keys[source.table.mesh_index[instance]]].volume

    def _cells(self, bodies: list[_Body]) -> int:
        """Return how many cells there are along each side of objects' grids."""
        cells = CELLS_MAX[self.cuda]
        channels = sum(len(body.varying.fields) for body in bodies)
        while cells > 8 and channels * cells**3 > VALUES_MAX[self.cuda]:
            cells //= 2
        return cells

    def _key(self, source: DeviceScene, body: _Body, cells: int) -> Hashable:
        """Return what an object's grid depends on."""
        table, instance = source.table, body.instance
        mesh = source.store.ranges[table.mesh_keys[table.mesh_index[instance]]]
        generated = tuple(np.concatenate(mesh.generated).tolist())
        place: tuple = ()
        if body.varying.placed:
            properties = None if table.properties is None else table.properties[:, instance].tobytes()
            place = (table.transforms[instance].tobytes(), tuple(source.origin), int(table.pass_index[instance]),
                     int(table.random_id[instance]), table.color[instance].tobytes(), properties, body.material)
        return (body.varying, id(mesh.volume) if mesh.volume is not None else None, mesh.low.tobytes(),
                mesh.high.tobytes(), generated, cells, place)

    def _bake(self, source: DeviceScene, body: _Body, cells: int) -> BakedGrid:
        """Return the grid of an object."""
        table, instance = source.table, body.instance
        mesh = source.store.ranges[table.mesh_keys[table.mesh_index[instance]]]
        matrix = table.transforms[instance].copy()
        matrix[:3, 3] -= source.origin
        properties = {} if table.properties is None else dict(
            zip(table.property_names, table.properties[:, instance], strict=True))
        keys = table.material_sets[table.material_set_index[instance]]
        own = next(source.materials[key] for key in keys if source.material_table.index(key) == body.material)
        oven = Oven(
            body.varying, source.scene, source.textures.index, tuple(source.origin), self.device, source.rows[instance],
            matrix, properties, {} if mesh.volume is None else mesh.volume.grids, own.pass_index)
        if mesh.volume is not None:
            oven.to_point = matrix @ mesh.volume.to_object
            return oven.bake(Box(*mesh.volume.box))
        return bake_boxes(oven, mesh.low, mesh.high, cells)

    def _middle(self, source: DeviceScene) -> tuple[float, ...]:
        """Return where the world's cells are smallest: amid what is drawn, as low as its lowest, where fog lies."""
        if not source.drawn.any():
            return (0.0, 0.0, 0.0)
        low, high = source.low[source.drawn].min(0), source.high[source.drawn].max(0)
        return (*(0.5 * (low + high))[:2].tolist(), float(low[2]))

    def _bake_world(self, source: DeviceScene, varying: VaryingData) -> BakedGrid:
        """Return the world's grid."""
        # Its programs' points have no instance: they are where they say.
        to_point = np.eye(4)
        to_point[:3, 3] = source.origin
        oven = Oven(varying, source.scene, source.textures.index, tuple(source.origin), self.device,
                    to_point=to_point)
        octaves = tuple(0.5 * n / math.log2(1.0 + WORLD_SIZE / scale)
                        for n, scale in zip(WORLD_CELLS, WORLD_SCALE, strict=True))
        size = tuple(source.radius * scale for scale in WORLD_SCALE)
        return oven.bake(Box(self._middle(source), size, WORLD_CELLS, octaves))

    def _struct(
        self, source: DeviceScene, bodies: list[_Body], chosen: list[BakedGrid], outside: VaryingData | None,
        places: Mapping[int, tuple[int, MediumData]],
    ) -> Volumes:
        """Return everything on the device; `chosen`: the bodies' grids, and the world's if it varies."""
        distinct = list({id(grid): grid for grid in chosen}.values())
        if self._joined is None or [id(grid) for grid in self._joined[0]] != [id(grid) for grid in distinct]:
            self._joined = (distinct, concatenated([grid.values for grid in distinct], float, self.device),
                            concatenated([grid.bounds for grid in distinct], wp.vec2, self.device))
        value_starts, block_starts, values, blocks = {}, {}, 0, 0
        for grid in distinct:
            value_starts[id(grid)], block_starts[id(grid)] = values, blocks
            values, blocks = values + len(grid.values), blocks + len(grid.bounds)
        fields: list[tuple] = []
        starts: dict[VaryingData, int] = {}
        rows = np.zeros(len(chosen), VolumeGrid.numpy_dtype())
        count = len(source.table.mesh_index)
        media = 1 + max((row for row, _ in places.values()), default=-1) + (1 if outside is not None else 0)
        in_media = np.full(media, -1, np.int32)
        for medium in dict.fromkeys(body.medium for body in bodies):
            in_media[medium] = int((in_media >= 0).sum()) * count
        grid_of = np.full(max(int((in_media >= 0).sum()) * count, 1), -1, np.int32)
        entries = [(body.varying, self._to_scene(source, body.instance), body.density) for body in bodies]
        entries += [(outside, np.eye(4), 1.0)] if outside is not None else []
        for number, (grid, (varying, to_box, density)) in enumerate(zip(chosen, entries, strict=True)):
            if varying not in starts:
                starts[varying] = len(fields)
                fields.extend(field_rows(varying))
            row = rows[number]
            row["to_cells"] = grid.box.to_cells() @ to_box
            row["x"], row["y"], row["z"] = grid.box.cells
            row["blocks_x"], row["blocks_y"], row["blocks_z"] = grid.box.blocks
            row["values"], row["blocks"] = value_starts[id(grid)], block_starts[id(grid)]
            row["octaves"] = grid.box.octaves
            row["fields"], row["phases"], row["density"] = starts[varying], len(varying.phases), density
            if number < len(bodies):
                grid_of[in_media[bodies[number].medium] + bodies[number].instance] = number
        out = Volumes()
        out.places, out.grid_of = self._held("places", in_media, int), self._held("grid_of", grid_of, int)
        out.grids = self._held("grids", rows, VolumeGrid)
        held = np.zeros(max(len(fields), 1), Field.numpy_dtype())
        for row, (color, channel, wide) in zip(held, fields, strict=False):
            row["color"], row["channel"], row["wide"] = color, channel, wide
        out.fields = self._held("fields", held, Field)
        out.values, out.bounds = self._joined[1], self._joined[2]
        out.world = len(bodies) if outside is not None else -1
        return out

    def _held(self, name: str, rows: np.ndarray, dtype: type) -> wp.array:
        """Return rows on the device, where they were before if there are as many: frames have recorded that place."""
        before = self._rows.get(name)
        if before is not None and len(before[0]) == len(rows):
            if before[0].tobytes() != rows.tobytes():
                before[1].assign(rows)
            self._rows[name] = rows.copy(), before[1]
        else:
            self._rows[name] = rows.copy(), wp.array(rows, dtype=dtype, device=self.device)
        return self._rows[name][1]

    def _to_scene(self, source: DeviceScene, instance: int) -> np.ndarray:
        """Return the matrix from scene coordinates to what an object's box is in: float64 [4, 4]."""
        matrix = source.table.transforms[instance].copy()
        matrix[:3, 3] -= source.origin
        volume = self._volume(source, instance)
        return inverses((matrix if volume is None else matrix @ volume.to_object)[None])[0]
