# SPDX-License-Identifier: GPL-3.0-or-later
"""Host side of participating media in the path tracer: the steps of a round in scenes with media.

They stand in for those that find hits and layers, and for those of shadow rays; surfaces are shaded as ever. A path
that a medium scatters has met something, as at a surface: that is a bounce.
"""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from ...kernels import (
    light_split,
    media_march,
    media_scatter,
    media_shadows,
    shadow_lights,
    tracing,
    volume_march,
    volume_scatter,
    volume_shadows,
)
from ...kernels.light_groups import GroupLight, GroupTables
from ...kernels.media import Media, MediaPaths
from ...kernels.paths import Options
from ...kernels.types import Scene
from ...kernels.volume_grids import Volumes
from ..device import launch
from ..history import copy_struct
from .path_light import PathLight
from .wavefront import HIT_LISTS, Step, Wavefront

__all__ = ["MEDIA_BYTES", "PathMedia", "fit_media", "make_media_paths"]

MEDIA_BYTES = 44
"""Of what is kept of one path, and its place in a list"""


@dataclass
class PathMedia:
    """What a batch of paths keeps of the media that they are in."""

    media: Media
    volumes: Volumes | None
    """What varies in space: then other kernels stand in"""
    kept: MediaPaths
    device: str

    @property
    def described(self) -> list:
        """Return what kernels are told of the media."""
        return [self.media] if self.volumes is None else [self.media, self.volumes]

    def start(self, slot: Wavefront, scene: Scene, count: int) -> None:
        """Find the media that the first `count` paths begin in."""
        launch(media_march.start_media, count, [scene, self.media, slot.paths], [self.kept], self.device)

    def hit_steps(self, scene: Scene, options: Options, light: PathLight | None) -> list[Step]:
        """Return what finds hits and lists the paths that are scattered before; with light groups tells lamps apart."""
        grouped = light is not None and light.groups is not None
        tables, groups = (light.film.scene_groups.tables, light.groups) if grouped else (GroupTables(), GroupLight())
        return [Step(tracing.trace_paths, [scene]),
                Step(media_march.march_media if self.volumes is None else volume_march.march_volumes,
                     [scene, options, *self.described, tables], fills=("scattered",), outputs=[self.kept, groups])]

    def miss_step(self, scene: Scene, options: Options) -> Step:
        """Return what adds the world, plays roulette and lists hits by what shades them."""
        return Step(media_scatter.shade_media_misses, [scene, options], fills=HIT_LISTS)

    def scatter_step(self, shading: list, rounds: wp.array) -> Step:
        """Return what lights scattered paths; comes after surfaces, which forget shadow rays of before."""
        kernel = media_scatter.scatter_paths if self.volumes is None else volume_scatter.scatter_in_volumes
        return Step(kernel, [*shading, *self.described, self.kept, rounds], over="scattered", fills=("next",))

    def finish_light(self, light: PathLight, exposure: float, first: int, count: int, samples: int) -> None:
        """Add what media have of the light of finished paths to the passes of volumes, and keep it out of surfaces'.

        The paths are those of `count` pixels from `first` on, `samples` each.
        """
        if light.split is not None:
            light.film.volume.add(light.paths, self.kept.first, light.split, exposure, first, count, samples)
            launch(light_split.leave_out_scattered, count * samples, [light.paths, self.kept.first], [light.split],
                   self.device)

    def shadow_steps(self, slot: Wavefront, scene: Scene, options: Options, over: str = "living") -> list[Step]:
        """Return what traces the shadow rays of the paths of a list and adds their light."""
        # None is done with when nothing opaque is in its way.
        waiting = copy_struct(options)
        waiting.filtered = 1
        weaken = media_shadows.weaken_in_media if self.volumes is None else volume_shadows.weaken_in_volumes
        steps = [Step(tracing.trace_shadows, [scene, waiting, slot.rounds], over),
                 Step(weaken, [scene, options, *self.described, slot.rounds], over, outputs=[self.kept])]
        if options.programs == 1:
            steps.append(Step(shadow_lights.shade_lights, [scene, options, slot.rounds], over))
        return steps


def make_media_paths(count: int, device: str) -> MediaPaths:
    """Allocate what is kept of `count` paths."""
    kept = MediaPaths()
    for name, dtype in (("objects", wp.vec4i), ("media", wp.vec4i), ("backfacing", int), ("first", int)):
        setattr(kept, name, wp.zeros(count, dtype=dtype, device=device))
    return kept


def fit_media(slot: Wavefront, media: Media | None, volumes: Volumes | None) -> None:
    """Make room beside the states of paths for a scene's media, or note that it has none."""
    if media is None:
        slot.media = None
    elif slot.media is None:
        slot.media = PathMedia(media, volumes, make_media_paths(slot.capacity, slot.device), slot.device)
    else:
        slot.media.media, slot.media.volumes = media, volumes
