# SPDX-License-Identifier: GPL-3.0-or-later
"""Dependency graph to SceneDelta: everything once, then only what changed.

Owns what was sent last (plain data, keyed by session_uid), so that each extraction can leave out what is the same.
Main thread only; nothing of bpy survives a call.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import bpy
import numpy as np

from ...engine.image_loading import ImageLoading
from ...engine.mesh_features import derived_names
from ...engine.object_properties import property_names
from ...engine.report import Report
from ...engine.scene import InstanceTable, LightData, MaterialData, SceneDelta, WorldData
from ...engine.settings import PerformanceSettings
from ..passes import aov_source
from .callbacks import Callbacks, Progress
from .changes import Changes, MeshKeys, read_changes, same_fields, same_lights, same_table
from .geometry import materials_of_hair, read_clean
from .image import ImageCollector, working_space
from .instances import ExtractionCancelled, Gathered, Source, build_table, gather_instances, kept_rows
from .light import extract_light
from .material import from_xyz, luminance_weights
from .moves import Moves
from .properties import LayerProperties

__all__ = ["ExtractionCancelled", "ExtractionCounts", "SceneExtractor"]

@dataclass
class ExtractionCounts:
    """How many data-blocks the last extraction read or sent."""

    meshes: int = 0
    """Read and sent"""
    materials: int = 0
    """Read; those that turned out the same were not sent"""
    images: int = 0
    """Sent"""
    instances: int = 0
    """Walked over; 0 where the walk was spared"""
    lights: int = 0
    """Sent"""
    worlds: int = 0
    """Read"""


class SceneExtractor:
    """Reads one scene again and again; one per session."""

    def __init__(self) -> None:
        self.counts = ExtractionCounts()
        self.reset()

    def reset(self) -> None:
        """Forget what was sent: the next extraction is full."""
        self._identity: tuple | None = None
        self._view: tuple[str, int] | None = None
        self._refresh = False
        self._frame: float | None = None
        self._mesh_keys = MeshKeys()
        self._empty_meshes: set[int] = set()
        self._mesh_reports: dict[int, Report] = {}
        self._derived: dict[int, frozenset[str]] = {}
        """What was worked out of each mesh (engine/mesh_features.py)"""
        self._table: InstanceTable | None = None
        self._lights: list[LightData] | None = None
        self._object_lights: list[LightData] = []
        self._light_shaders: dict[int, tuple[tuple, Report]] = {}
        self._materials: dict[Hashable, tuple[MaterialData, Report]] = {}
        self._on_hair: frozenset[Hashable] = frozenset()
        self._world: WorldData | None = None
        self._world_uid: int | None = None
        self._world_report = Report()
        self._images: ImageCollector | None = None
        self._walk_report = Report()
        self._merged: Report | None = None
        """All reports together, until something is read again"""
        self._moves = Moves()
        self._layer = LayerProperties()

    def refresh(self) -> None:
        """Read everything again next time, but keep meshes that weren't evaluated again (after undo)."""
        self._refresh = True

    def materials(self) -> list[MaterialData]:
        """Return all materials of the scene as of the last extraction, changed then or not."""
        return [data for data, _ in self._materials.values()]

    @property
    def world(self) -> WorldData | None:
        """Return the world as of the last extraction."""
        return self._world

    def linked_materials(self) -> list[MaterialData]:
        """Return the materials, as of the last extraction, of objects that light some objects alone."""
        table = self._table
        if table is None or table.linked_to is None:
            return []
        sets = np.unique(table.material_set_index[table.linked_to != 0]).tolist()
        keys = dict.fromkeys(key for index in sets for key in table.material_sets[index])
        return [self._materials[key][0] for key in keys if key in self._materials]

    @property
    def has_catchers(self) -> bool:
        """Whether there are shadow catchers, as of the last extraction."""
        return self._table is not None and self._table.has_catchers

    def mesh_keys(self) -> dict[tuple[int, int], int]:
        """Return the meshes' keys as of the last extraction by MeshKeys' slots."""
        return self._mesh_keys.by_slot

    def extract(self, depsgraph: bpy.types.Depsgraph, *, viewport: bool, report: Report,
                progress: Progress | None = None, cancelled: Callable[[], bool] | None = None,
                space: bpy.types.SpaceView3D | None = None,
                performance: PerformanceSettings | None = None) -> SceneDelta:
        """Return what changed since the last call; everything on the first.

        Args:
            depsgraph: Evaluated dependency graph.
            viewport: Trust `depsgraph.updates` (right inside `view_update` and after each `RenderEngine.frame_set`);
                else all but unchanged meshes is read again, and what came out the same is not sent.
            report: Takes the entries about everything that is now in the scene, changed or not: pass a fresh one.
            progress: Called with a text and a fraction.
            cancelled: Asked often; True ends the extraction.
            space: Viewport whose local view and collection visibility apply.
            performance: Limits of images, which are then read in the background while meshes are read here.

        Raises:
            ExtractionCancelled: `cancelled` returned True. The next extraction is full.
        """
        self.counts = ExtractionCounts()
        start = time.perf_counter()
        full = self._begin(depsgraph, space)
        changes = self._changes(depsgraph, full or not viewport)
        working = self._identity[-1]
        delta = SceneDelta(full=full, luminance_weights=luminance_weights(working), from_xyz=from_xyz(working))
        callbacks = Callbacks(progress, cancelled)
        try:
            self._extract_changed(delta, depsgraph, changes, space, callbacks, performance)
        except BaseException:
            if delta.loading is not None:
                delta.loading.stop()
            self.reset()
            raise
        self._merge_reports(report)
        delta.extra["extract_seconds"] = time.perf_counter() - start
        return delta

    def _begin(self, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None) -> bool:
        """Return whether another scene than before is to be read; forgets the old one then."""
        # A loaded file gives every data-block another session_uid.
        identity = (depsgraph.scene.session_uid, depsgraph.mode, working_space())
        full = identity != self._identity
        if full:
            self.reset()
            self._identity = identity
        view = (depsgraph.view_layer.name, space.as_pointer() if space is not None else 0)
        self._refresh |= view != self._view
        self._view = view
        return full

    def _changes(self, depsgraph: bpy.types.Depsgraph, everything: bool) -> Changes:
        changes = Changes(everything=True) if everything or self._refresh else read_changes(depsgraph)
        frame = depsgraph.scene.frame_current_final
        if frame != self._frame and any(image.source in {'SEQUENCE', 'MOVIE'} for image in bpy.data.images):
            changes.everything = True
        self._frame = frame
        self._refresh = False
        return changes

    def _extract_changed(self, delta: SceneDelta, depsgraph: bpy.types.Depsgraph, changes: Changes,
                         space: bpy.types.SpaceView3D | None, callbacks: Callbacks,
                         performance: PerformanceSettings | None) -> None:
        if not changes:
            return
        callbacks.step("Reading the scene", 0.0)
        changes.everything |= self._layer.begin(depsgraph)
        same_world = _world_of(depsgraph)[1] == self._world_uid
        if changes.only_objects and same_world and self._moves.read(depsgraph, changes.objects):
            self._extract_moves(delta)
            return
        self._merged = None
        self._aovs = _asked_aovs(depsgraph)
        images = self._begin_images(depsgraph, delta.full)
        walk = changes.everything or changes.instances or changes.materials or changes.images
        if walk:
            self._walk_report = Report()
            gathered = gather_instances(depsgraph, space=space, report=self._walk_report,
                                        cancelled=callbacks.cancelled)
            self.counts.instances = len(gathered.rows)
            self._extract_materials(delta, gathered, changes, images, callbacks)
        self._extract_world(delta, depsgraph, changes, images)
        if performance is not None and (started := images.started):
            delta.loading = ImageLoading(started, performance)
        if walk:
            of_mesh, kept = self._extract_meshes(delta, gathered, changes, callbacks)
            lamps = self._extract_lights(gathered, changes, images)
            self._moves.note(depsgraph, changes.objects, gathered, of_mesh, kept, self._table, lamps)
        self._hand_over_lights(delta)
        self._layer.end()
        callbacks.step("Reading images", 1.0)
        delta.images = images.images
        self.counts.images = len(delta.images)

    def _extract_moves(self, delta: SceneDelta) -> None:
        """Send what lies elsewhere where nothing else has changed."""
        if self._moves.table is not self._table:
            delta.instances = self._table = self._moves.table
        self._object_lights = self._moves.lights
        self._hand_over_lights(delta)
        self._layer.end()

    def _begin_images(self, depsgraph: bpy.types.Depsgraph, full: bool) -> ImageCollector:
        if self._images is None:
            self._images = ImageCollector(depsgraph)
        # Outside a viewport nothing tells that pixels were painted; a scene makes the collector look.
        self._images.begin(depsgraph if depsgraph.mode == 'VIEWPORT' else depsgraph.scene, full=full)
        return self._images

    def _extract_meshes(self, delta: SceneDelta, gathered: Gathered, changes: Changes,
                        callbacks: Callbacks) -> tuple[np.ndarray, np.ndarray]:
        """Read new and changed meshes, then make the table of their instances; returns `kept_rows` of them."""
        keys, new = self._mesh_keys.assign(gathered.sources)
        for key, source in zip(keys, gathered.sources, strict=True):
            # Edit mode and sculpting may change a mesh without evaluating it anew.
            if key is not None and source.uid in changes.geometry:
                new.setdefault(key, source)
        wanted = self._wanted_attributes(keys, gathered.sources)
        none: frozenset[str] = frozenset()
        for key, source in zip(keys, gathered.sources, strict=True):
            if wanted.get(key, none) - self._derived.get(key, none):
                new.setdefault(key, source)
        self._derived = {key: wanted.get(key, none) | (none if key in new else self._derived.get(key, none))
                         for key in set(keys) - {None}}
        self._mesh_reports |= {key: Report() for key in new}
        for key, data in read_clean(new, self._mesh_reports, self._derived, callbacks.step).items():
            self._empty_meshes.discard(key)
            if len(data.triangles):
                delta.meshes[key] = data
            else:
                self._empty_meshes.add(key)
        self.counts.meshes = len(new)
        self._mesh_reports = {key: self._mesh_reports[key] for key in set(keys) - {None}}
        filled = [None if key in self._empty_meshes else key for key in keys]
        of_mesh, kept = kept_rows(gathered, filled, self._walk_report)
        self._hand_over_table(delta, build_table(gathered, filled, kept, self._asked_properties()))
        return of_mesh, kept

    def _asked_properties(self) -> tuple[str, ...]:
        """Return the properties of objects that any material reads."""
        return property_names(name for data, _ in self._materials.values() for name in _attributes_of(data))

    def _wanted_attributes(self, keys: list[int | None], sources: list[Source]) -> dict[int, frozenset[str]]:
        """Return, by mesh, the attributes that materials on it want to be worked out, where they want any."""
        asking = {}
        for material, (data, _) in self._materials.items():
            names = derived_names(_attributes_of(data))
            if names:
                asking[material] = names
        wanted: dict[int, frozenset[str]] = {}
        for key, source in zip(keys, sources, strict=True) if asking else ():
            for material in source.material_set:
                if key is not None and material in asking:
                    wanted[key] = wanted.get(key, frozenset()) | asking[material]
        return wanted

    def _hand_over_table(self, delta: SceneDelta, table: InstanceTable) -> None:
        if self._table is None or not same_table(table, self._table):
            delta.instances = table
        self._table = table

    def _extract_lights(self, gathered: Gathered, changes: Changes,
                        images: ImageCollector) -> dict[int, LightData | None]:
        """Read all lamps; returns them by their numbers among the instances, None for what can't light anything."""
        lamps = {}
        if changes.everything or changes.images:
            self._light_shaders.clear()
        is_light = np.array([source.is_light for source in gathered.sources], bool)
        for index in np.flatnonzero(is_light[gathered.source_of[gathered.rows]]).tolist():
            placement = gathered.placements[gathered.rows[index]]
            source = gathered.sources[placement.source]
            lamps[index] = extract_light(
                source.data, gathered.transforms[index].copy(), placement.visibility,
                self._light_shader(source.data, changes, images), f"light '{source.name}'", self._walk_report,
                source.light_group, gathered.linking.numbers(source.links))
        self._object_lights = [light for light in lamps.values() if light is not None]
        return lamps

    def _hand_over_lights(self, delta: SceneDelta) -> None:
        """Send the lamps and the sun of the world's sky, where any of them changed."""
        sun = self._world.sun if self._world is not None else None
        lights = self._object_lights + ([sun] if sun is not None else [])
        if not same_lights(lights, self._lights):
            delta.lights = lights
            self.counts.lights = len(lights)
        self._lights = lights

    def _light_shader(self, light: bpy.types.Light, changes: Changes, images: ImageCollector) -> tuple:
        """Return what extract_light_shader says of a lamp's node tree, read once per change of the lamp."""
        from .material import extract_light_shader

        uid = light.original.session_uid
        if uid in changes.lights:
            changes.lights.discard(uid)
            self._light_shaders.pop(uid, None)
        if uid not in self._light_shaders:
            light_report = Report()
            self._light_shaders[uid] = (extract_light_shader(light, images, light_report, self._layer), light_report)
        return self._light_shaders[uid][0]

    def _extract_materials(self, delta: SceneDelta, gathered: Gathered, changes: Changes, images: ImageCollector,
                           callbacks: Callbacks) -> None:
        from .material import extract_material

        everything = changes.everything or bool(changes.images)
        kept, on_hair = {}, materials_of_hair(gathered)
        for number, (key, material) in enumerate(gathered.materials.items()):
            old = self._materials.get(key)
            same_use = (key in on_hair) == (key in self._on_hair)
            if old is not None and same_use and not everything and key not in changes.materials:
                kept[key] = old
                continue
            callbacks.step(f"Reading material '{material.name}'", number / len(gathered.materials))
            material_report = Report()
            data = extract_material(material, images, material_report, self._aovs, self._layer, key in on_hair)
            self.counts.materials += 1
            if old is None or not same_fields(data, old[0]):
                delta.materials[key] = data
            kept[key] = (data, material_report)
        self._materials, self._on_hair = kept, on_hair

    def _extract_world(self, delta: SceneDelta, depsgraph: bpy.types.Depsgraph, changes: Changes,
                       images: ImageCollector) -> None:
        from .material import extract_world

        world, uid = _world_of(depsgraph)
        if not (changes.everything or changes.world or changes.images or uid != self._world_uid):
            return
        self._world_report = Report()
        data = extract_world(world, images, self._world_report, self._aovs, self._layer)
        if self._world is None or not same_fields(data, self._world):
            delta.world = data
        self._world, self._world_uid = data, uid
        self.counts.worlds = 1

    def _merge_reports(self, report: Report) -> None:
        """Hand over what is true of the scene now, also where it was not read again."""
        if self._merged is None:
            self._merged = self._merge_parts()
        report.merge(self._merged)

    def _merge_parts(self) -> Report:
        parts = [self._walk_report, *self._mesh_reports.values(), self._world_report]
        if self._images is not None:
            parts.append(self._images.report)
        parts += [part for _, part in self._light_shaders.values()] + [part for _, part in self._materials.values()]
        merged = Report()
        for part in parts:
            # Of a thousand meshes and materials few have anything to say.
            if part.counts:
                merged.merge(part)
        return merged


def _world_of(depsgraph: bpy.types.Depsgraph) -> tuple[bpy.types.World | None, int]:
    """Return the world with its session_uid, 0 without one."""
    world = depsgraph.view_layer_eval.world_override or depsgraph.scene_eval.world
    return world, world.original.session_uid if world is not None else 0


def _asked_aovs(depsgraph: bpy.types.Depsgraph) -> tuple[str, ...]:
    """Return the shader AOVs that a final render's view layer asks for, by the engine's names of their passes."""
    asked = depsgraph.view_layer_eval.aovs if depsgraph.mode == 'RENDER' else ()
    return tuple(aov_source(aov) for aov in asked if aov.is_valid)


def _attributes_of(data: MaterialData) -> list[str]:
    """Return what any program of a material reads."""
    media = data.medium.programs if data.medium is not None else ()
    programs = filter(None, (data.program, data.exact, data.hair, *data.aovs.values(), *media))
    return [name for program in programs for name in program.attributes]
