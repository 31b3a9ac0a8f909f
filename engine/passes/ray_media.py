# SPDX-License-Identifier: GPL-3.0-or-later
"""Media along the rays of reflections and refraction, in scenes with objects that have any."""

from __future__ import annotations

import warp as wp

from ...kernels import reflection_chain, reflection_media
from ...kernels.gbuffer import GBuffer
from ...kernels.media import Media
from ...kernels.paths import Paths
from ...kernels.types import Scene
from ..frame_graph import FrameGraph
from ..work_list import WorkList
from .media import make_media_paths

__all__ = ["RayMedia", "last_of"]


class RayMedia:
    """What rays are in, and what that takes from their light."""

    def __init__(self, media: Media, scene: Scene, count: int, device: str):
        """Make room for `count` rays."""
        self.media, self.scene = media, scene
        self.kept = make_media_paths(count, device)
        self.count = count

    def record_start(
        self, graph: FrameGraph, views: wp.array, options: object, gbuffer: GBuffer, samples: object, rays: object,
        paths: Paths,
    ) -> None:
        """Record what rays are in that have just been set up."""
        graph.launch(
            reflection_media.start_in_media, self.count,
            [views, self.scene, self.media, options, gbuffer, samples, rays, paths], [self.kept])

    def record_dimming(self, graph: FrameGraph, paths: Paths, vertices: object, work: WorkList) -> None:
        """Record what media take from the rays of a list on their way to what they meet."""
        graph.launch_listed(
            reflection_media.dim_segments, [self.scene, self.media], work, [paths, vertices, self.kept])

    def record_crossing(self, graph: FrameGraph, paths: Paths, work: WorkList) -> None:
        """Record what the rays of a list are in that have been sent on."""
        graph.launch_listed(reflection_media.cross_boundaries, [self.scene, self.media, paths], work, [self.kept])


def last_of(surfaces: int, segments: int, further: bool) -> int:
    """Return how a segment ends, LAST* or 0; see reflection_chain.last_of.

    Args:
        surfaces: Its number, from 1 on.
        segments: How many there are but in glass.
        further: Whether those in glass have launches of their own.
    """
    if further:
        return int(reflection_chain.last_of(surfaces, segments))
    return 0 if surfaces < segments else int(reflection_chain.LAST)
