# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene on the device: applies SceneDeltas, keeps every part that did not change, hands out one kernel struct."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels import types
from .device import device_errors
from .emitters import EmitterTable, find_emitters
from .environment import build_environment, no_environment
from .geometry_store import GeometryStore, MeshRange
from .homes import HomeTable
from .instance_plan import InstancePlan
from .instance_rows import filtered_groups, instance_bounds, instance_rows, moved_rows, scene_origin, write_places
from .lamp_tables import LampTables
from .lamps import lamp_power
from .light_linking import is_linked, same_links
from .light_table import SUN, build_lights
from .materials import MaterialTable, default_material, materials_in_use
from .media import SceneMedia, scene_media
from .object_properties import ObjectProperties
from .opacity_maps import OpacityMaps
from .report import Report
from .scene import InstanceTable, Key, LightData, MaterialData, SceneDelta, WorldData
from .settings import PerformanceSettings
from .staging import RowWriter, overwrite
from .structures import Structures
from .tables import albedo_tables, film_table
from .textures import TextureStore
from .volumes import SceneVolumes

__all__ = ["DeviceScene", "SceneChanges"]

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class SceneChanges:
    """What the last delta meant for the light in the scene."""

    replaced: bool = True
    """A new scene: nothing known about the one before holds"""
    moved: bool = True
    """Objects moved, deformed, came, went or look different"""
    lit: bool = True
    """Lamps, the world, materials or what emits have changed"""
    followed: bool = False
    """Nothing but lamps and objects that had moved before have moved"""


# Factor by which the scene may outgrow its radius, or twice as much shrink, before that follows: the cache's cells are
# measured by it, and recorded frames end where it changes.
GROWTH_LIMIT = 1.25


class DeviceScene:
    """Everything a ray can meet, on one device."""

    def __init__(self, device: str):
        self.device = device
        self.report = Report()
        self.times: dict[str, float] = {}
        self.store, self.structures = GeometryStore(device), Structures(device)
        self.textures = TextureStore(device)
        self.opacity_maps = OpacityMaps(device)
        self.material_table = MaterialTable(device)
        self.properties = ObjectProperties(device)
        self.materials: dict[Key, MaterialData] = {}
        self.table: InstanceTable | None = None
        self.plan: InstancePlan | None = None
        self.rows: np.ndarray = np.zeros(0, types.Instance.numpy_dtype())
        """Of all instances; where some only moved it stays the same array, see `take_moved_rows`"""
        self._moved_rows = np.zeros(0, np.int64)
        self._row_writer = RowWriter(types.Instance, device)
        self.homes = HomeTable(device)
        self.emitting = np.zeros(0, bool)
        """By set of materials, whether any may emit light"""
        self.instances = wp.zeros(1, dtype=types.Instance, device=device)
        self.instance_materials = wp.zeros(1, dtype=int, device=device)
        self.lights: list[LightData] = []
        self.lamps, self.lamp_tables = np.zeros(0, types.Light.numpy_dtype()), LampTables(device)
        self.world: WorldData | None = None
        self.origin, self.radius = np.zeros(3), 1.0
        self.triangle_count = 0
        """Of all instances together"""
        self.luminance = (0.2126729, 0.7151522, 0.0721750)
        self.emitters = EmitterTable.empty(device)
        self.environment = no_environment(device)
        self.world_texels = wp.zeros(1, dtype=wp.vec3, device=device)
        """The world's radiance by texels of its table, see build_environment"""
        self.environment_power = 0.0
        self.local_power = 0.0
        """Of all lamps with a place and all emissive triangles [W]"""
        self.power = 0.0
        """Of all light that reaches the scene, suns and the world included [W]"""
        self.environment_built = False
        self.light_struct = build_lights(self.lamps, self.emitters, 0.0, 1.0, device)
        self.scene = types.Scene()
        self.tables = albedo_tables(device)
        self.names: tuple[int, int] = (0, 0)
        self.changes = SceneChanges()
        self.volumes = SceneVolumes(device)
        self.media: SceneMedia | None = None
        """None where nothing drawn has a medium, nor the world"""

    def apply(self, delta: SceneDelta, settings: PerformanceSettings, progress: Progress | None = None) -> None:
        """Bring the device up to date with a delta.

        Raises:
            OutOfDeviceMemory: It does not fit; the scene before stays as it was as far as memory allows.
        """
        tell = progress or (lambda what, share: None)
        self.times = {}
        with device_errors("the scene"):
            self._apply(delta, settings, tell)
            if self.media is not None or not self.changes.followed:
                self.media = scene_media(self, bool(delta.images) or delta.full)

    def _apply(self, delta: SceneDelta, settings: PerformanceSettings, tell: Progress) -> None:
        if self._follow(delta):
            return
        if delta.full:
            self._forget()
        self.luminance = delta.luminance_weights
        self.tables.film = film_table(delta.from_xyz, self.device)
        rebuild = delta.full or self.plan is None
        tell("Textures", 0.0)
        with self._timed("textures"):
            if delta.images or delta.full:
                self.textures.update(delta.images, settings, self.report, delta.loading)
        tell("Geometry", 0.2)
        changed_meshes = set(delta.meshes)
        with self._timed("upload"):
            rebuild = rebuild or not self.store.ranges.keys() >= delta.meshes.keys()
            self.store.put(delta.meshes)
        if delta.world is not None:
            self.world = delta.world
        moved, relinked = np.zeros(0, np.int64), False
        if delta.instances is not None:
            relinked = not same_links(delta.instances, self.table)
            rebuild, moved = self._compare_instances(delta.instances, rebuild)
            if rebuild:
                self.homes.forget()
            self.homes.note(self.rows, moved)
            self.table = delta.instances
        self.table = self.table or InstanceTable.empty()
        if rebuild:
            self.store.keep_only(set(self.table.mesh_keys))
        rebuild = self.store.compact() or rebuild
        self._measure_bounds()
        materials_changed = self._update_materials(delta)
        filters_changed = self._plan_instances()
        rebuild = rebuild or filters_changed
        geometry_changed = rebuild or len(moved) > 0 or bool(changed_meshes)
        edited = np.flatnonzero(np.isin(self.table.mesh_index, [  # also those of which nothing is left to draw
            i for i, key in enumerate(self.table.mesh_keys) if key in changed_meshes]))
        tell("Structures", 0.5)
        with self._timed("structures"):
            if rebuild:
                self._write_instances()
                self.structures.build(self.plan, self.store, self.instances, settings.instancing_threshold)
            elif geometry_changed:
                self.structures.leave_flat(np.union1d(moved, edited).astype(np.int64))
                self.structures.update_instances(self.plan, self.store, changed_meshes)
            # Always: _plan_instances has filled the rows anew, without the structures' ids.
            self.structures.fill(self.rows, self.plan, self.store)
            self._write_instances()
            self._update_opacity(settings.opacity_maps, bool(delta.images))
        emission_moved = rebuild or self._any_emits(moved) or self._any_emits(edited)
        tell("Lights", 0.9)
        self._assemble()
        self._update_lights(delta, emission_moved, materials_changed, relinked)
        self.changes = SceneChanges(
            replaced=delta.full, moved=geometry_changed or delta.instances is not None,
            lit=materials_changed or delta.lights is not None or relinked
            or (emission_moved and len(self.emitters.power) > 0))
        tell("Ready", 1.0)

    def _follow(self, delta: SceneDelta) -> bool:
        """Apply a delta by which nothing but lamps and instances that had moved before have moved; False for others.

        That is what each step of a drag is, and most frames of an animation: only what lies elsewhere is touched.
        """
        table = delta.instances
        if (delta.full or delta.meshes or delta.materials or delta.images or delta.world is not None or table is None
                or self.plan is None or not table.moved_from(self.table)):
            return False
        with self._timed("structures"):
            moved = moved_rows(table.transforms, self.table.transforms)
            transforms = table.transforms[moved]
            ranges = [self.store.ranges[table.mesh_keys[i]] for i in table.mesh_index[moved].tolist()]
            drawn, center, half = instance_bounds(np.arange(len(moved)), transforms, ranges)
            if not (drawn & self.drawn[moved]).all():
                return False
            self.low[moved], self.high[moved] = center - half - self.origin, center + half - self.origin
            if not self.structures.follow(self.plan, moved):
                return False
            self._outgrow(self.low[moved], self.high[moved])
            self.table = table
            self.homes.note(self.rows, moved)
            write_places(self.rows, table.transforms, self.origin, moved)
            self._row_writer.write(self.instances, self.rows, moved)
            self.structures.place(self.instances)
            self._moved_rows = np.union1d(self._moved_rows, moved) if len(self._moved_rows) else moved
        emission_moved = self._any_emits(moved)
        self._update_lights(delta, emission_moved, False)
        lit = delta.lights is not None or (emission_moved and len(self.emitters.power) > 0)
        self.changes = SceneChanges(replaced=False, moved=True, lit=lit, followed=True)
        return True

    def take_moved_rows(self) -> np.ndarray:
        """Return, ascending, the rows of instances that have moved since the last call or since `rows` was made."""
        moved, self._moved_rows = self._moved_rows, np.zeros(0, np.int64)
        return moved

    def _update_lights(
        self, delta: SceneDelta, emission_moved: bool, materials_changed: bool, relinked: bool = False,
    ) -> None:
        """Find all that gives light, where it may have changed."""
        with self._timed("lights"):
            if delta.lights is not None:
                self.lights = delta.lights
            if emission_moved or materials_changed or delta.images:
                self.emitters = find_emitters(
                    self.scene, self.plan, self.table, self.store, self.materials, self.device)
                self._assemble()
            if delta.world is not None or delta.images or not self.environment_built:
                self.world_texels = build_environment(self.scene, self.world, self.device, self._assemble_with)
                self.environment_built = True
            if emission_moved or materials_changed or delta.images or delta.lights is not None or relinked:
                self._choose_lights(bool(delta.images) or delta.full)

    def use_opacity_maps(self, enabled: bool) -> None:
        """Make the opacity maps or take them away where nothing else changes."""
        if self.plan is not None:
            self._update_opacity(enabled, False)
            self._assemble()

    def _update_opacity(self, enabled: bool, renewed: bool) -> None:
        self.opacity_maps.update(self, self._assemble, enabled, renewed)
        # Maps may have moved triangles.
        self.structures.place(self.instances)

    def _any_emits(self, chosen: np.ndarray) -> bool:
        """Return whether any of the chosen instances may emit light."""
        return bool(self.emitting[self.table.material_set_index[chosen]].any())

    def _forget(self) -> None:
        self.store.clear()
        self.structures.clear()
        self.textures.clear()
        self.materials, self.lights, self.report = {}, [], Report()
        self.table = self.plan = None

    @contextlib.contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.times[name] = self.times.get(name, 0.0) + time.perf_counter() - start

    # -- materials ----------------------------------------------------------------------------------------------

    def _update_materials(self, delta: SceneDelta) -> bool:
        """Rebuild the programs where materials, the world or the names that they use changed."""
        self.materials.update(delta.materials)
        self.materials.setdefault(None, default_material())
        names = (len(self.store.uv_names), len(self.store.attribute_names))
        said = self.properties.update(self.table.property_names, self.table.properties)
        changed = said or bool(delta.materials or delta.images or delta.full or delta.world or names != self.names)
        if changed:
            self.names = names
            self.material_table.build(
                self.materials, None if self.world is None else self.world.program, self.textures.index,
                self.store.uv_id, self.properties.resolver(self.store.attribute_id), tuple(self.origin),
                None if self.world is None else self.world.aovs)
        return changed

    # -- instances ----------------------------------------------------------------------------------------------

    def _compare_instances(self, table: InstanceTable, rebuild: bool) -> tuple[bool, np.ndarray]:
        """Return whether everything must be rebuilt, and which instances moved."""
        old = self.table
        if rebuild or old is None or table.object_keys != old.object_keys:
            return True, np.zeros(0, np.int64)
        if [table.mesh_keys[i] for i in table.mesh_index] != [old.mesh_keys[i] for i in old.mesh_index]:
            return True, np.zeros(0, np.int64)
        return False, moved_rows(table.transforms, old.transforms)

    def _measure_bounds(self) -> None:
        """Find the bounds of all drawn instances and, for a new scene, its origin."""
        drawn, center, half = instance_bounds(self.table.mesh_index, self.table.transforms, self._ranges())
        if self.plan is None:
            self.origin = scene_origin(center[drawn], half[drawn])
        self.drawn, self.low, self.high = drawn, center - half - self.origin, center + half - self.origin
        self._corners = np.full(3, np.inf), np.full(3, -np.inf)
        if drawn.any():
            self._outgrow(self.low[drawn], self.high[drawn])
            radius = self._half_diagonal()
            if self.plan is None or radius < 0.5 * self.radius:
                self.radius = radius

    def _outgrow(self, low: np.ndarray, high: np.ndarray) -> None:
        """Take in bounds of instances: the scene's radius follows where they lie far beyond those known."""
        if len(low):
            self._corners = np.minimum(self._corners[0], low.min(0)), np.maximum(self._corners[1], high.max(0))
        radius = self._half_diagonal()
        if radius > GROWTH_LIMIT * self.radius:
            self.radius = radius

    def _half_diagonal(self) -> float:
        return float(max(0.5 * np.linalg.norm(self._corners[1] - self._corners[0]), 1e-30))

    def _ranges(self) -> list[MeshRange]:
        return [self.store.ranges[key] for key in self.table.mesh_keys]

    def _plan_instances(self) -> bool:
        """Fill the instance rows and the plan; return whether the choice of filtered triangles changed."""
        table, old = self.table, self.plan
        groups, materials, group_index = filtered_groups(table, self.materials)
        ranges = self._ranges()
        self.material_table.note_used(materials_in_use(table, [r.used_slots for r in ranges], self.drawn))
        self.plan = InstancePlan(
            mesh_keys=table.mesh_keys, mesh_index=np.where(self.drawn, table.mesh_index, -1), filtered_slots=groups,
            materials=materials, group_index=group_index, low=self.low, high=self.high,
            scattering=self.material_table.scattering(table))
        self.rows, self._moved_rows = instance_rows(table, ranges, self.origin), np.zeros(0, np.int64)
        counts = np.array([r.triangle_count for r in ranges], np.int64)
        self.triangle_count = int(counts[table.mesh_index[self.drawn]].sum())
        self.emitting = np.array([
            any((self.materials.get(key) or self.materials[None]).has_emission for key in keys)
            for keys in table.material_sets], bool)
        rows = [self.material_table.index(key) for keys in table.material_sets for key in keys] or [0]
        self.instance_materials = overwrite(self.instance_materials, np.array(rows, np.int32))
        return old is None or not self.plan.filters_as(old, by_material=self.structures.levels.filtered is not None)

    def _write_instances(self) -> None:
        if len(self.rows):
            self.instances = overwrite(self.instances, self.rows)

    # -- lights and the struct ----------------------------------------------------------------------------------

    def _choose_lights(self, images_changed: bool) -> None:
        """Decide by what chances lights are sampled."""
        self.lamps = self.lamp_tables.rows(self, stale=images_changed)
        power = lamp_power(self.lamps, self.radius)
        self.local_power = float(power[self.lamps["kind"] != SUN].sum() + self.emitters.power.sum())
        self.power = float(power.sum() + self.emitters.power.sum() + self.environment_power * np.pi * self.radius**2)
        sampled_power = self.environment_power if self.world is not None and self.world.sampling else 0.0
        self.light_struct = build_lights(
            self.lamps, self.emitters, sampled_power, self.radius, self.device, tables=self.lamp_tables.array,
            linked=is_linked(self.lights, self.table, self.emitting))
        self._assemble()

    def _assemble_with(self, environment: types.Environment, power: float) -> types.Scene:
        self.environment = environment
        self.environment_power = power
        return self._assemble()

    def _assemble(self) -> types.Scene:
        geometry = types.Geometry()
        store = self.store
        self.structures.write(geometry)
        geometry.instances = self.instances
        geometry.triangles = store.triangles.array
        geometry.slots = store.slots.array
        geometry.positions = store.positions.array
        geometry.corners = store.corners.array
        geometry.uvs = store.uvs.array
        geometry.attributes = store.attributes.array
        geometry.uv_offsets, geometry.attribute_offsets = store.tables()
        scene = types.Scene()
        scene.geometry = geometry
        materials = self.material_table.struct()
        materials.instance_materials = self.instance_materials
        self.properties.write(materials)
        scene.materials = materials
        scene.textures = self.textures.struct()
        scene.tables = self.tables
        scene.environment = self.environment
        scene.lights = self.light_struct
        scene.luminance = wp.vec3(*self.luminance)
        self.scene = scene
        return scene

    @property
    def has_light_programs(self) -> bool:
        """Return whether a light's radiance is a program: a textured emitter, a world that varies."""
        return self.emitters.textured or self.scene.environment.constant == 0

    @property
    def has_hit_programs(self) -> bool:
        """Return the same for lights as rays' hits are lit by them: they take the world's light from its texels."""
        return self.emitters.textured or (self.scene.environment.constant == 0 and len(self.world_texels) == 1)
