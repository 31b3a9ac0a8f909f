# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer's passes of light: by the first surface's lobes (light_split.py) and by groups (light_groups.py).

What ReferencePass asks for both together: sums on the film, what batches of paths keep, and the steps that fill it in.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import warp as wp

from ...kernels.light_groups import GroupLight
from ...kernels.light_split import LightSplit
from ...kernels.paths import Options, Paths
from ...kernels.types import Scene
from ..pass_names import GROUP_PREFIX
from . import light_split
from .composite import LIGHT_PASSES
from .light_groups import GroupFilm, SceneGroups, make_group_light
from .light_split import SPLIT_BYTES, LobeFilm, make_split
from .media_light import VOLUME_PASSES, VolumeFilm
from .wavefront import Step

if TYPE_CHECKING:
    from ..device_scene import DeviceScene

__all__ = ["LightFilm", "PathLight", "is_light_pass"]


def is_light_pass(name: str) -> bool:
    """Tell whether a pass is one of light: by lobes, of volumes or of a group."""
    return name in LIGHT_PASSES or name in VOLUME_PASSES or name.startswith(GROUP_PREFIX)


class LightFilm:
    """Sums of the passes of light that are asked for; false for none."""

    def __init__(self, passes: Iterable[str], pixel_count: int, device: str):
        """Make empty sums for those of `passes` that are passes of light."""
        passes = tuple(passes)
        self.device = device
        self.lobes = LobeFilm(passes, pixel_count, device)
        self.volume = VolumeFilm(passes, pixel_count, device)
        self.groups = GroupFilm(passes, pixel_count, device)
        self.scene_groups: SceneGroups | None = None

    def __bool__(self) -> bool:
        return bool(self.splits or self.groups.names)

    @property
    def splits(self) -> bool:
        """Return whether paths' light is told apart by what they meet first."""
        return self.lobes.asked or self.volume.asked

    @property
    def path_bytes(self) -> int:
        """Return the memory that one path takes."""
        return (SPLIT_BYTES if self.splits else 0) + self.groups.path_bytes

    def prepare(self, scene: DeviceScene) -> None:
        """Take in the scene before samples are added."""
        names = self.groups.names
        if names and (self.scene_groups is None or not self.scene_groups.fits(scene)):
            self.scene_groups = SceneGroups(scene, names)

    def clear(self) -> None:
        """Forget all samples."""
        self.lobes.clear()
        self.volume.clear()
        self.groups.clear()

    def make_paths(self, paths: Paths, capacity: int) -> PathLight:
        """Return what a batch of up to `capacity` paths keeps."""
        names = self.groups.names
        return PathLight(
            self, paths, make_split(capacity, self.device) if self.splits else None,
            make_group_light(len(names), capacity, self.device) if names else None)

    def add(self, kept: PathLight, exposure: float, first: int, count: int, samples: int) -> None:
        """Add the finished paths of `count` pixels from `first` on, `samples` each."""
        self.lobes.add(kept.paths, kept.split, exposure, first, count, samples)
        self.groups.add(kept.paths, kept.groups, exposure, first, count, samples)

    def read(self, name: str) -> wp.array:
        """Return a pass on the device: vec3 [pixels], exposed.

        Raises:
            KeyError: It was not asked for.
        """
        film = self.volume if name in VOLUME_PASSES else self.lobes
        return self.groups.read(name) if name.startswith(GROUP_PREFIX) else film.read(name)


@dataclass
class PathLight:
    """What a batch of paths keeps for the passes of light."""

    film: LightFilm
    paths: Paths
    split: LightSplit | None
    groups: GroupLight | None

    def steps_before_misses(self, scene: Scene, options: Options) -> list[Step]:
        """Return what comes when hits are known."""
        if self.groups is None:
            return []
        return self.film.scene_groups.steps_before_misses(self.paths, self.groups, scene, options)

    def steps_before_shading(self, rounds: wp.array, evaluate: Step) -> list[Step]:
        """Return what comes when the world and the lamps that rays meet have been added; see light_split.py."""
        return [] if self.split is None else light_split.steps_before_shading(self.paths, self.split, rounds, evaluate)

    def steps_after_shading(self, scene: Scene, rounds: wp.array) -> list[Step]:
        """Return what comes when emission has been added and shadow rays are known."""
        steps = [] if self.split is None else light_split.steps_after_shading(self.paths, self.split, scene, rounds)
        if self.groups is not None:
            steps += self.film.scene_groups.steps_after_shading(self.paths, self.groups, scene, rounds)
        return steps

    def steps_before_exit_shadows(self, scene: Scene, rounds: wp.array) -> list[Step]:
        """Return what comes when the shadow rays of paths that come out of surfaces are known."""
        if self.groups is None:
            return []
        return self.film.scene_groups.steps_before_exit_shadows(self.paths, self.groups, scene, rounds)

    def steps_after_exit_shadows(self, rounds: wp.array) -> list[Step]:
        """Return what comes when those have brought their light."""
        steps = [] if self.split is None else light_split.steps_after_exit_shadows(self.paths, self.split, rounds)
        if self.groups is not None:
            steps += self.film.scene_groups.steps_after_shadows(self.paths, self.groups, "exits")
        return steps

    def steps_after_shadows(self, rounds: wp.array) -> list[Step]:
        """Return what comes when shadow rays have brought their light."""
        steps = [] if self.split is None else light_split.steps_after_shadows(self.paths, self.split, rounds)
        if self.groups is not None:
            steps += self.film.scene_groups.steps_after_shadows(self.paths, self.groups)
        return steps
