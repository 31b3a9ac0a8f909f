# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame's rays that end in cells of the radiance cache: those of the probes, and after them those that bounce.

Owns their slots; finds what they hit, of what it is made, its cells and the direct light there. In which order, and
what comes of it, is the pass's own (radiance_cache.py).
"""

from __future__ import annotations

import math

import warp as wp

from ...kernels import cache_lights
from ...kernels.fog import Fog
from ...kernels.hash_grid import NO_CELL, HashGrid
from ...kernels.types import Scene
from ..frame_graph import FrameGraph
from ..ray_budget import spreading_rays
from ..settings import CacheSettings
from ..structures import has_layers
from ..work_list import make_queue, make_work_list
from .cache_buffers import make_rays, record_insertion, record_materials, record_shadow_rays, record_sums
from .cache_spreading import FURTHER_SHARES
from .fog_ways import FogWays
from .layer_rays import record_hits
from .mirror_rays import MirrorRays

__all__ = ["CachedRays"]


class CachedRays:
    """Slots for rays: of `count` of probes, of `bounces` that bounce, and of those that go on from there."""

    def __init__(self, device: str, settings: CacheSettings, grid: HashGrid):
        """Make none yet; `grid` is the cells in which they end."""
        self.device, self.settings, self.grid = device, settings, grid
        self.count = self.bounces = -1
        self.settled = 0
        """Bounce rays of frames in which light has spread"""
        self.further: tuple[int, ...] = ()
        """Rays that go on from where bounce rays have ended, and again, while light spreads"""
        self.mirrors: MirrorRays | None = None
        self.ways: FogWays | None = None
        """The fog along all rays"""
        self.glossy = False
        """Whether their hits may show highlights"""
        self.layers = False
        """Whether they pass surfaces: triangles that need a test per hit, or clear glass"""

    def fit(self, count: int, size: tuple[int, int], *, layers: bool, mirrors: bool, glossy: bool) -> None:
        """Allocate for `count` rays of probes.

        Args:
            count: Slots.
            size: Of the picture [px], on which the number of bounce rays depends.
            layers: Whether rays pass surfaces.
            mirrors: Whether they go on over mirrors.
            glossy: Whether hits may show highlights.
        """
        share = 0.0 if self.settings.bounces == 1 else self.settings.bounce_share
        self.settled = math.ceil(share * count)
        # Room for as many as there are hits: light spreads faster with them after the start and edits.
        bounces = max(self.settled, spreading_rays(count, *size)) if share > 0.0 else 0
        made = self.count, self.bounces, self.layers, bool(self.mirrors), self.glossy
        if (count, bounces, layers, mirrors, glossy) == made:
            return
        self.count, self.bounces, self.layers, self.glossy = count, bounces, layers, glossy
        # Only where light goes on from cell to cell.
        sweeps_on = bounces > 0 and self.settings.bounces != 2
        self.further = tuple(math.ceil(each * bounces) for each in FURTHER_SHARES if sweeps_on)
        total = self.total
        self.paths, self.vertices = make_rays(count, self.most_bounces, layers, glossy, self.device)
        self.queue = make_queue(total if layers else 1, self.device)
        self.layered = make_work_list(total if layers else 1, self.device)
        self.left, self.lit = make_work_list(total, self.device), make_work_list(total, self.device)
        """Rays and shadow rays that need the full node machine; all shadow rays"""
        self.mirrors = MirrorRays(self.paths, total if mirrors else 0, self.queue, self.layered, self.device)

    @property
    def most_bounces(self) -> int:
        """Slots of bounce rays; frames while light spreads need them all, others the first `bounces`."""
        return self.bounces + sum(self.further)

    @property
    def total(self) -> int:
        """All slots."""
        return self.count + self.most_bounces

    def take(self, world: wp.array | None, fog: Fog | None, *, all_lean: bool, lean_layers: bool) -> None:
        """Take in what a record needs to know; arguments as of RadianceCachePass.record."""
        self._all_lean, self._lean_layers = all_lean, lean_layers
        self._world = wp.zeros(1, dtype=wp.vec3, device=self.device) if world is None else world
        self.ways = fog and FogWays.make(fog, self.total, self.device, self.ways)

    def forget(self) -> None:
        """Let no slot name a cell."""
        if self.count >= 0:
            self.vertices.cell.fill_(int(NO_CELL))

    def record_hits(self, graph: FrameGraph, scene: Scene, offset: int, count: int) -> None:
        """Record finding the hits of `count` rays from slot `offset` on."""
        record_hits(
            graph, scene, self.paths, offset, count, self.queue, self.layered, filtered=has_layers(scene),
            lean=self._lean_layers, through=True)

    def record_materials(
        self, graph: FrameGraph, scene: Scene, views: wp.array, offset: int, count: int, threshold: float,
    ) -> None:
        """Record what the hits of `count` rays from slot `offset` on are made of.

        `threshold`: luminance to which the world's radiance is limited for rays that miss (EnvironmentSplit).
        """
        with graph.section("Cache materials"):
            left = None
            if not self._all_lean or (scene.environment.constant == 0 and len(self._world) == 1):
                left = self.left.part(offset, count)
            what = [int(offset > 0), self.grid.weighed, threshold, int(self.layers)]
            record_materials(graph, scene, views, self.paths, self.vertices, self._world, offset, count, what, left,
                             self.ways, self.mirrors, self._lean_layers)

    def record_insertion(
        self, graph: FrameGraph, views: wp.array, offset: int, count: int, *, deterministic: bool,
    ) -> None:
        """Record finding or making the cells of the hits of `count` rays from slot `offset` on."""
        with graph.section("Cache cells"):
            record_insertion(
                graph, views, self.paths, self.vertices, self.grid, offset, count, deterministic=deterministic)

    def record_lights(
        self, graph: FrameGraph, scene: Scene, views: wp.array, offset: int, count: int, *, programs: bool,
        settled: bool,
    ) -> None:
        """Record direct light at the hits of `count` rays from slot `offset` on.

        Args:
            graph: What to add to.
            scene: The scene.
            views: One View.
            offset: First slot.
            count: Slots.
            programs: Whether lights may be programs (DeviceScene.has_hit_programs).
            settled: Whether cells whose mean is of as many samples as it may hold are watched in turns alone.
        """
        if scene.lights.class_count == 0:
            # Black samples: nothing else writes them.
            self.paths.radiance.zero_()
            self.paths.shadow_distance.zero_()
            return
        with graph.section("Cache lights"):
            graph.launch(
                cache_lights.choose_cache_lights, count,
                [views, scene, self._world, self.grid, float(self.settings.sample_cap if settled else math.inf)],
                [self.paths, self.vertices], start=offset)
        with graph.section("Cache shadow rays"):
            record_shadow_rays(
                graph, views, scene, self.paths, offset, count, self.queue, self.lit, self.layered, self.left,
                filtered=has_layers(scene), lean_layers=self._lean_layers, programs=programs,
                fog=self.ways and self.ways.fog)

    def record_sums(self, graph: FrameGraph, views: wp.array, offset: int, count: int) -> None:
        """Record adding the light of `count` hits from slot `offset` on to their cells, for the next update_cells."""
        record_sums(graph, views, self.paths, self.vertices, self.grid, offset, count, self.count)
