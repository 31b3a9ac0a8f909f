# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of the path tracer's light groups: which group everything that emits is in, and the sums on the film.

Only where passes ask for groups: other renders launch none of these kernels and have none of these buffers.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ...kernels import light_groups
from ...kernels.light_groups import GroupLight, GroupTables
from ...kernels.paths import Options, Paths
from ...kernels.types import Scene
from ..device import launch
from ..lamps import drawn_lamps
from ..pass_names import GROUP_PREFIX
from ..report import Report
from .wavefront import Step

if TYPE_CHECKING:
    from ..device_scene import DeviceScene

__all__ = ["GroupFilm", "SceneGroups", "make_group_light"]


class SceneGroups:
    """The groups of a scene's lamps, objects and world on the device."""

    def __init__(self, scene: DeviceScene, names: tuple[str, ...]):
        """Number everything that emits by its group's place in `names`."""
        self._made_for = self._sources(scene)
        none, numbers = int(light_groups.NO_GROUP), {name: number for number, name in enumerate(names)}
        lamps = [numbers.get(light.light_group, none) for light, _ in drawn_lamps(scene.lights, scene.origin, Report())]
        table = scene.table
        instances = np.full(max(len(scene.rows), 1), none, np.int32)
        if table is not None and table.light_group_index is not None and len(table.light_group_index):
            # The last entry is for index -1: no group.
            by_name = np.array([*(numbers.get(name, none) for name in table.light_groups), none], np.int32)
            instances = by_name[table.light_group_index]
        self.tables = GroupTables()
        self.tables.lamps = wp.array(np.array(lamps or [none], np.int32), dtype=int, device=scene.device)
        self.tables.instances = wp.array(instances, dtype=int, device=scene.device)
        self.tables.world = none if scene.world is None else numbers.get(scene.world.light_group, none)

    def fits(self, scene: DeviceScene) -> bool:
        """Tell whether the scene is still the one that this was made for."""
        return all(a is b for a, b in zip(self._made_for, self._sources(scene), strict=True))

    @staticmethod
    def _sources(scene: DeviceScene) -> tuple[object, ...]:
        return scene.table, scene.rows, scene.lights, scene.world

    def steps_before_misses(self, paths: Paths, light: GroupLight, scene: Scene, options: Options) -> list[Step]:
        """Return what adds the lamps that rays meet."""
        return [Step(light_groups.add_lamps_met, [scene, options, self.tables, paths], changes=False, outputs=[light])]

    def steps_after_shading(self, paths: Paths, light: GroupLight, scene: Scene, rounds: wp.array) -> list[Step]:
        """Return what adds the surfaces and the world that rays meet."""
        return [Step(light_groups.add_surface_met, [scene, self.tables, paths, rounds], changes=False, outputs=[light])]

    def steps_before_exit_shadows(
        self, paths: Paths, light: GroupLight, scene: Scene, rounds: wp.array,
    ) -> list[Step]:
        """Return what notes where the shadow rays of paths that come out of surfaces go to."""
        return [Step(light_groups.note_exit_lights, [scene, self.tables, paths, rounds], "exits", changes=False,
                     outputs=[light])]

    @staticmethod
    def steps_after_shadows(paths: Paths, light: GroupLight, over: str = "living") -> list[Step]:
        """Return what adds the light of the shadow rays of a list of paths."""
        return [Step(light_groups.add_shadow_light_met, [paths], over, changes=False, outputs=[light])]


def make_group_light(groups: int, count: int, device: str) -> GroupLight:
    """Allocate what is kept of `count` paths for a number of groups."""
    light = GroupLight()
    light.light = wp.zeros((groups, count), dtype=wp.vec3, device=device)
    light.known = wp.zeros(count, dtype=wp.vec3, device=device)
    light.shadow_group = wp.zeros(count, dtype=int, device=device)
    return light


class GroupFilm:
    """Sums of the light groups that are asked for, one entry a pixel."""

    def __init__(self, passes: Iterable[str], pixel_count: int, device: str):
        """Make empty sums for those of `passes` that are of groups."""
        self.device, self.pixel_count = device, pixel_count
        self.names = tuple(name.removeprefix(GROUP_PREFIX) for name in passes if name.startswith(GROUP_PREFIX))
        self._sums = [wp.zeros(pixel_count, dtype=wp.vec4, device=device) for _ in self.names]

    @property
    def path_bytes(self) -> int:
        """Return the memory that one path takes."""
        return 12 * len(self.names) + 16 if self.names else 0

    def clear(self) -> None:
        """Forget all samples."""
        for total in self._sums:
            total.zero_()

    def add(self, paths: Paths, light: GroupLight, exposure: float, first: int, count: int, samples: int) -> None:
        """Add the finished paths of `count` pixels from `first` on, `samples` each."""
        for group, total in enumerate(self._sums):
            launch(light_groups.accumulate_group, count,
                   [paths, light, group, exposure, first, count, samples], [total], self.device)

    def read(self, name: str) -> wp.array:
        """Return a group's pass on the device: vec3 [pixels], exposed.

        Raises:
            KeyError: It was not asked for.
        """
        group = name.removeprefix(GROUP_PREFIX)
        if group not in self.names or not name.startswith(GROUP_PREFIX):
            raise KeyError(name)
        picture = wp.empty(self.pixel_count, dtype=wp.vec3, device=self.device)
        launch(light_groups.resolve_group, self.pixel_count, [0, self._sums[self.names.index(group)]], [picture],
               self.device)
        return picture
