# SPDX-License-Identifier: GPL-3.0-or-later
"""Walks below surfaces: they find where the light has gone in that comes out at the pixels of a frame's rays."""

from __future__ import annotations

import warp as wp

from ...kernels import reflection_below, reflection_walks
from ...kernels.cache_rays import Vertices
from ...kernels.composite import Lights
from ...kernels.gbuffer import GBuffer
from ...kernels.hash_grid import HashGrid
from ...kernels.paths import Paths
from ...kernels.reflection_rays import ReflectionRays
from ...kernels.reflection_types import ReflectionOptions, ReflectionSamples
from ...kernels.reflection_walks import Walks
from ...kernels.subsurface import Medium
from ...kernels.types import Scene
from ..frame_graph import FrameGraph
from ..work_list import make_work_list

__all__ = ["WalkPass"]


ARRAYS = {"medium": Medium, "depth": float, "share": wp.vec3, "nearby": wp.vec3i, "pixel": wp.vec3i,
          "weight": wp.vec3, "light": wp.vec3}
CHANNEL_ARRAYS = {"face": int, "place": wp.uint32, "arriving": wp.uint32, "brought": float}
"""Three entries a ray"""


class WalkPass:
    """Owns what walks need and find; has no buffers until it records some."""

    def __init__(self, device: str, blocks: int):
        """Make it for so many rays."""
        self.device, self.blocks = device, blocks
        self.walks: Walks | None = None

    def _make_room(self) -> None:
        if self.walks is not None:
            return
        self.walks = Walks()
        for arrays, count in ((ARRAYS, self.blocks), (CHANNEL_ARRAYS, 3 * self.blocks)):
            for name, dtype in arrays.items():
                setattr(self.walks, name, wp.zeros(count, dtype=dtype, device=self.device))
        self._rays, self._channels = (make_work_list(count, self.device) for count in (self.blocks, 3 * self.blocks))

    def record(
        self, graph: FrameGraph, views: wp.array, scene: Scene, options: ReflectionOptions, gbuffer: GBuffer,
        grid: HashGrid, samples: ReflectionSamples, rays: ReflectionRays, paths: Paths, vertices: Vertices,
    ) -> None:
        """Record the walks of those rays that go below their surfaces; some of them go on outside after it.

        Args:
            graph: What to add to.
            views: One View.
            scene: The scene.
            options: Of the rays' pass.
            gbuffer: Of this frame.
            grid: The radiance cache.
            samples: Where the rays start.
            rays: The rays.
            paths: Their states.
            vertices: Where they end.
        """
        self._make_room()
        pixels, outputs = [views, scene, options, gbuffer, samples], [self.walks, rays, paths, vertices]
        with graph.section("Refraction walks"):
            graph.fill_list(reflection_walks.append_below, self.blocks, [options, rays], self._rays)
            graph.launch_listed(reflection_below.enter_surfaces, pixels, self._rays, outputs, few=True)
            graph.fill_list(
                reflection_walks.append_walks, 3 * self.blocks, [options, rays, self.walks], self._channels)
            graph.launch_listed(
                reflection_walks.walk_below_pixels, [*pixels, rays, paths], self._channels, [self.walks], few=True)
            graph.launch_listed(reflection_walks.settle_walks, [*pixels, grid], self._rays, outputs)
            graph.launch(
                reflection_below.go_on_outside, self.blocks, [views, scene, options, grid], [rays, paths, vertices])

    def record_light(
        self, graph: FrameGraph, options: ReflectionOptions, gbuffer: GBuffer, lights: Lights, rays: ReflectionRays,
        samples: ReflectionSamples,
    ) -> None:
        """Record adding the light of places that the frame shows to the rays' samples; `lights`: of this frame."""
        graph.launch(
            reflection_walks.add_seen_light, self.blocks, [options, gbuffer, lights, rays], [self.walks, samples])
