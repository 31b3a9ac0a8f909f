# SPDX-License-Identifier: GPL-3.0-or-later
"""Opacity micromaps of the triangles that need a test per hit: made on the device, renewed when due.

Rays then decide most hits on leaves and grilles while they traverse the structure (kernels/wide_bvh.py). Near the
outlines they look the mask's image up themselves where it has 8 bits (kernels/opacity_answers.py), and know how much
passes where that is the same everywhere; else the material's program runs. Where no triangle is left to programs,
passes leave out what runs them (structures.decides_layers). Instances in object space share their mesh's maps; meshes
that were edited have none. Scenes without masked materials neither keep nor launch anything.
"""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ..kernels import opacity_answers
from ..kernels import opacity_maps as kernels
from ..kernels.opacity_pieces import AlphaMask
from ..kernels.types import Scene
from ..kernels.wide_bvh import TRIANGLE_WORDS
from .alpha_masks import MaskedBy, find_mask
from .device import launch_bands
from .flat_structure import FlatStructure
from .instance_rows import stops_all
from .opacity_answers import Answers, plan_answers
from .wide_bvh import WideBvh

if TYPE_CHECKING:
    from .device_scene import DeviceScene

__all__ = ["OpacityMaps"]

WORDS_MAX = 1 << 24
"""Room for all maps, 64 MiB: where finer ones would need more, all get coarser. At the coarsest each has one word"""

FINE_TEXELS = {"cuda": 4.0, "cpu": 16.0}
"""Longest edge of the parts whose state is known [texel]: of 4, Sponza's leaves are unknown on 21 % of their surface
instead of 47 %, but those maps take a processor longer than they save in a hundred frames"""

TEXELS_MAX = {"cuda": float(1 << 31), "cpu": float(1 << 26)}
"""Texels that all triangles with maps may cover; the largest go without. A processor takes a second or two for them"""

LAST = np.iinfo(np.int32).max
"""Begin of a block that never comes: wp.lower_bound finds the last element where all are smaller"""

_mask_of = functools.lru_cache(maxsize=1024)(find_mask)


@dataclass
class _Plan:
    """What maps are made for."""

    masks: dict[Hashable, tuple[MaskedBy, int, int]]
    """By material key: the mask, its texture and its UV map"""
    chosen: np.ndarray
    """int, the instances that have maps"""
    groups: np.ndarray
    """int64, for each of them: mesh and set of materials as one number"""

    def equals(self, other: _Plan | None) -> bool:
        """Return whether maps made for the other are these."""
        return (other is not None and self.masks == other.masks and np.array_equal(self.chosen, other.chosen)
                and np.array_equal(self.groups, other.groups))


class OpacityMaps:
    """Keeps the maps in a scene's structures up to date."""

    def __init__(self, device: str) -> None:
        """Start without any."""
        self.device = device
        self._maps: list[_Maps] = []

    @property
    def bytes(self) -> int:
        """Return the device memory of the maps."""
        return sum(maps.bytes for maps in self._maps)

    def update(self, source: DeviceScene, scene: Callable[[], Scene], enabled: bool, renewed: bool) -> None:
        """Make the maps of a scene where they are not there yet, or take them away.

        Args:
            source: The scene; its textures, materials and structures are up to date.
            scene: Returns what kernels read of it.
            enabled: PerformanceSettings.opacity_maps.
            renewed: Whether images have changed.
        """
        known, self._maps = self._maps, []
        for flat, among in source.structures.masked():
            maps = next((maps for maps in known if maps.wide() is flat.wide), None)
            if maps is None:
                maps = _Maps(flat.wide, self.device)
            if maps.faces() is not flat.faces:
                maps.faces, maps.members = weakref.ref(flat.faces), np.zeros(len(source.rows), bool)
                maps.members[among] = True
            self._maps.append(maps)
            maps.update(flat, source, scene, enabled, renewed)
        # Maps tell of the finest level. Where shading read a coarser one, half transparent, light would be lost that
        # rays which the map has stopped stand for: a sixth of it on leaves far off.
        source.textures.arrays.look_up_finest(set().union(*(maps.textures for maps in self._maps)))


class _Maps:
    """Keeps the maps in one structure up to date."""

    def __init__(self, wide: WideBvh, device: str) -> None:
        """Start without any.

        Args:
            wide: The structure; its memory may be needed for the next one.
            device: Where it is.
        """
        self.wide, self.device, self.bytes = weakref.ref(wide), device, 0
        self.faces: Callable[[], wp.array | None] = lambda: None
        """Returns the structure's, which tell of the members"""
        self.members = np.zeros(0, bool)
        """[N], the instances whose triangles it has"""
        self._plan: _Plan | None = None
        """What the maps in the structure are for, None without any"""

    @property
    def textures(self) -> set[int]:
        """Return the masks' images."""
        masks = self._plan.masks.values() if self._plan is not None else ()
        return {texture for _, texture, _ in masks if texture >= 0}

    def update(
        self, flat: FlatStructure, source: DeviceScene, scene: Callable[[], Scene], enabled: bool, renewed: bool,
    ) -> None:
        """Do as OpacityMaps.update for the structure."""
        plan = self._choose(source) if enabled else None
        if plan is None and self._plan is not None:
            bases = np.full(len(source.rows), -1, np.int32)
            none = wp.zeros(1, dtype=int, device=self.device)
            self._reserve(flat.wide, TRIANGLE_WORDS * len(flat.faces))
            masks = [none, wp.zeros(1, dtype=AlphaMask, device=self.device)]
            self._mark(flat, scene(), bases, [*masks, none, none, none, none, 0])
            self.bytes = 0
        elif plan is not None and (renewed or not plan.equals(self._plan)):
            self._make(flat, source, scene(), plan)
        self._plan = plan

    def _choose(self, source: DeviceScene) -> _Plan | None:
        """Return for what there should be maps, None for nothing."""
        table, masks = source.table, {}
        for key in {key for keys in table.material_sets for key in keys}:
            data = source.materials.get(key)
            # Emission may shine from where all light passes, and media begin there.
            known = data is not None and not data.has_emission and not data.medium
            found = _mask_of(data.program) if known else None
            if found is not None:
                texture = -1 if found.image is None else source.textures.index(found.image)
                uv_map = -1 if found.uv_map is None else source.store.uv_id(found.uv_map)
                if found.image is None or texture >= 0:
                    masks[key] = found, texture, uv_map
        if not masks:
            return None
        masked = np.array([any(key in masks for key in keys) for keys in table.material_sets], bool)
        # Objects that some rays don't see are no obstacle to those.
        seen = stops_all(table)
        chosen = np.flatnonzero(masked[table.material_set_index] & seen & self.members & (source.plan.mesh_index >= 0))
        sets = len(table.material_sets)
        groups = source.plan.mesh_index[chosen].astype(np.int64) * sets + table.material_set_index[chosen]
        return _Plan(masks, chosen, groups) if len(chosen) else None

    def _make(self, flat: FlatStructure, source: DeviceScene, scene: Scene, plan: _Plan) -> None:
        """Make all maps and answers."""
        table, device = source.table, self.device
        groups, examples, members = np.unique(plan.groups, return_index=True, return_inverse=True)
        meshes = (groups // len(table.material_sets)).tolist()
        counts = np.array([source.store.ranges[source.plan.mesh_keys[mesh]].triangle_count for mesh in meshes])
        ends = np.cumsum(counts)
        starts, count = (ends - counts).astype(np.int32), int(ends[-1])
        bases = np.full(len(source.rows), -1, np.int32)
        bases[plan.chosen] = starts[members]
        words = TRIANGLE_WORDS * len(flat.faces)
        answers = plan_answers([(mask, texture) for mask, texture, _ in plan.masks.values()],
                               scene.textures.infos.numpy(), words)
        records, rows = self._records(source, plan, answers)
        masks = [wp.array(rows, dtype=int, device=device), wp.array(records, dtype=AlphaMask, device=device)]
        about = [
            scene, wp.array([*starts.tolist(), LAST], dtype=int, device=device),
            wp.array(plan.chosen[examples].astype(np.int32), dtype=int, device=device), *masks]
        levels, states, answered, word_ends, kept_ends = (wp.empty(count, dtype=int, device=device) for _ in range(5))
        texels = wp.empty(count, dtype=float, device=device)
        kind = "cuda" if wp.get_device(device).is_cuda else "cpu"
        launch_bands(kernels.choose_levels, 0, count, [*about, FINE_TEXELS[kind]], [levels, texels, states, answered])
        most, limit, total = _fit(levels.numpy(), texels.numpy(), TEXELS_MAX[kind])
        launch_bands(kernels.limit_levels, 0, count, [texels, most, limit], [levels, word_ends])
        wp.utils.array_scan(word_ends, word_ends, inclusive=True)
        maps = wp.empty(max(total, 1), dtype=wp.uint32, device=device)
        if total:
            launch_bands(kernels.fill_maps, 0, total, [*about, levels, word_ends], [maps])
        launch_bands(kernels.judge_maps, 0, count, [levels, word_ends, maps, answered], [states, kept_ends])
        wp.utils.array_scan(kept_ends, kept_ends, inclusive=True)
        kept = int(kept_ends[count - 1:].numpy()[0])
        # What is the same all over each triangle needs no look-ups.
        more = len(answers.words) if kept else 0
        self._reserve(flat.wide, words, more + kept)
        if kept:
            self._place_answers(flat.wide, scene, masks[1], answers, words)
            launch_bands(
                kernels.place_maps, 0, kept,
                [*about, levels, states, answered, word_ends, kept_ends, maps, words + more], [flat.wide.triangles])
        self._mark(flat, scene, bases, [*masks, levels, states, answered, kept_ends, words + more])
        self.bytes = 4 * (more + kept)

    def _place_answers(
        self, wide: WideBvh, scene: Scene, masks: wp.array, answers: Answers, offset: int,
    ) -> None:
        """Write what rays read of the masks' images, from word `offset` on."""
        if answers.images:
            wp.copy(wide.triangles, wp.array(answers.words, dtype=wp.uint32, device=self.device), dest_offset=offset)
        for row, first, count in answers.images:
            launch_bands(opacity_answers.fill_answers, 0, count, [scene, masks, row, first], [wide.triangles])

    def _mark(self, flat: FlatStructure, scene: Scene, bases: np.ndarray, known: list) -> None:
        """Write into the structure's triangles what is known of them."""
        count = len(flat.faces)
        undecided = wp.empty(count, dtype=int, device=self.device)
        bases = wp.array(bases, dtype=int, device=self.device)
        launch_bands(
            kernels.mark_triangles, 0, count, [scene, flat.faces, bases, *known], [flat.wide.triangles, undecided])
        wp.utils.array_scan(undecided, undecided, inclusive=True)
        flat.decided = int(undecided[count - 1:].numpy()[0]) == 0

    def _reserve(self, wide: WideBvh, words: int, more: int = 0) -> None:
        """Make room behind the triangles; where it is there already, recorded frames go on."""
        old = wide.triangles
        if len(old) != words + more:
            wide.triangles = wp.empty(words + more, dtype=wp.uint32, device=self.device)
            wp.copy(wide.triangles, old, count=words)

    @staticmethod
    def _records(source: DeviceScene, plan: _Plan, answers: Answers) -> tuple[np.ndarray, np.ndarray]:
        """Return the masks as kernels read them, and the mask of each material, -1 for none."""
        rows = np.full(len(source.material_table.indices), -1, np.int32)
        records = np.zeros(len(plan.masks), AlphaMask.numpy_dtype())
        for i, (key, (mask, texture, uv_map)) in enumerate(plan.masks.items()):
            rows[source.material_table.index(key)] = i
            records[i]["texture"], records[i]["uv_map"] = texture, uv_map
            records[i]["answers"] = answers.places[i]
            records[i]["passing"] = mask.passing[0] if mask.image is None and mask.passing else -1.0
            for name in ("extension", "associate", "channel", "u", "v", "clear", "solid"):
                records[i][name] = getattr(mask, name)
        return records, rows


def _fit(levels: np.ndarray, texels: np.ndarray, budget: float) -> tuple[float, int, int]:
    """Return what maps there are time and room for.

    Args:
        levels: Of the map that each triangle asks for; 0 is none.
        texels: How many it covers.
        budget: How many all may cover.

    Returns:
        Texels beyond which a triangle has no map, the highest level, and the words that all need.
    """
    ordered = np.sort(texels[levels > 0].astype(np.float64))
    allowed = int(np.searchsorted(np.cumsum(ordered), budget, "right"))
    most = float(ordered[allowed - 1]) if allowed else -1.0
    counts = np.bincount(levels[texels <= most], minlength=int(kernels.MAX_LEVEL) + 1)
    lowest = int(kernels.MIN_LEVEL)
    asked = np.arange(lowest, len(counts))
    for limit in reversed(asked.tolist()):
        total = int((counts[lowest:].astype(np.int64) << 2 * (np.minimum(asked, limit) - lowest)).sum())
        if total <= WORDS_MAX:
            break
    return most, limit, total
