# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog on the ways of the rays that the radiance cache answers: what of their light gets through, and what fog adds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import warp as wp

from ...kernels import compaction, fog_rays
from ...kernels.cache_rays import Vertices
from ...kernels.fog import Fog
from ...kernels.paths import Paths
from ...kernels.probe_rays import ProbeRays
from ...kernels.types import Scene
from ..frame_graph import FrameGraph
from ..work_list import WorkList, make_work_list

__all__ = ["FogWays"]


@dataclass(frozen=True)
class FogWays:
    """Goes through fog once for each ray, whenever its hit has become known."""

    fog: Fog
    """As it is lit so far"""
    ways: fog_rays.FogWays
    walking: WorkList
    """Room for rays that go through fog that varies"""

    @classmethod
    def make(cls, fog: Fog, slots: int, device: str, before: FogWays | None) -> FogWays:
        """Return room for `slots` rays, that of before if it is right: 8 bytes each, 32 more before `Fog.first_ray`."""
        if before is not None and (slots, fog.first_ray, fog.varying) == (
                len(before.ways.varies), before.fog.first_ray, before.fog.varying):
            return replace(before, fog=fog)
        ways, asking = fog_rays.FogWays(), fog.first_ray
        ways.varies = wp.zeros(slots, dtype=int, device=device)
        ways.place, ways.weight = (wp.zeros(asking, dtype=wp.vec4, device=device) for _ in range(2))
        return cls(fog, ways, make_work_list(slots if fog.varying else 1, device))

    def record(
        self, graph: FrameGraph, views: wp.array, scene: Scene, paths: Paths, vertices: Vertices, offset: int,
        count: int,
    ) -> None:
        """Record weakening what `count` rays from slot `offset` on bring; comes after their hits' materials."""
        graph.launch(
            fog_rays.dim_cache_rays, count, [views, scene, self.fog, offset, paths], [vertices, self.ways])
        if self.fog.varying:
            walking = self.walking.part(offset, count)
            graph.fill_list(compaction.append_marked, count, [self.ways.varies, offset], walking)
            graph.launch_listed(
                fog_rays.walk_cache_rays, [views, scene, self.fog, paths], walking, [vertices, self.ways])

    def record_light(self, graph: FrameGraph, views: wp.array, fog: Fog, rays: ProbeRays) -> None:
        """Record adding what fog scatters, as it is lit now, to the answers to the probes' rays."""
        graph.launch(fog_rays.add_fog_light, fog.first_ray, [views, fog, self.ways], [rays])
