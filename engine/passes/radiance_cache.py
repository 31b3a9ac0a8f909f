# SPDX-License-Identifier: GPL-3.0-or-later
"""The hash-grid radiance cache: follows the probes' rays to what they hit and tells the light that comes from there.

GI-1.0 (Boisse et al. 2023), section 4, with all bounces: a share of the hits sends a ray on, whose hit's cell, as of
the frame before, lights the cell that it came from. Owns the cells and the frame's rays; knows nothing of probes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from ...kernels import cache_cells, cache_claim, cache_debug, cache_lights, cache_rays, cache_shade
from ...kernels.cache_mirrors import FOLLOWED_ROUGHNESS
from ...kernels.environment_split import NO_THRESHOLD
from ...kernels.fog import Fog
from ...kernels.gbuffer import GBuffer
from ...kernels.hash_grid import NO_CELL, HashGrid
from ...kernels.probe_rays import ProbeRays
from ...kernels.types import Scene
from ..debug_views import DEBUG_VIEWS
from ..frame_graph import FrameGraph
from ..history import arrays_of, copy_struct
from ..ray_budget import spreading_rays
from ..settings import CacheSettings
from ..structures import has_layers
from ..work_list import WorkList, make_queue, make_work_list
from .cache_buffers import (
    COUNTERS,
    count_rays,
    make_control,
    make_grid,
    make_rays,
    record_insertion,
    record_materials,
    record_shadow_rays,
    record_sums,
    threads_race,
)
from .cache_spreading import (
    FURTHER_SHARES,
    LightPhase,
    record_coarse_cells,
    record_continuing,
    record_spreading,
    sweeps,
)
from .fog_ways import FogWays
from .layer_rays import record_hits
from .mirror_rays import MirrorRays

__all__ = ["RadianceCachePass", "smallest_cell"]

BOUNCES = "bounces"
"""Branch of the graph on which light goes from cell to cell while it need not be waited for"""

SMALLEST_CELL = 0.1
"""Metres: the published minimum, for rooms"""

CELLS_ACROSS = 500.0
"""Least number of smallest cells along a scene's diagonal"""

DEBUG_CHANNELS = {
    "cache.cells": cache_debug.CACHE_CELLS,
    "cache.levels": cache_debug.CACHE_LEVELS,
    "cache.light": cache_debug.CACHE_LIGHT,
    "cache.samples": cache_debug.CACHE_SAMPLES,
}


def smallest_cell(settings: CacheSettings, radius: float) -> float:
    """Return the smallest cell [m] for a scene whose bounds have half a diagonal of `radius` [m]."""
    if settings.minimum_cell > 0.0:
        return settings.minimum_cell
    return min(SMALLEST_CELL, 2.0 * radius / CELLS_ACROSS)


class RadianceCachePass:
    """Owns the cells; traces and answers the probes' rays."""

    name = "cache"
    debug_views: dict[str, str] = {name: DEBUG_VIEWS[name] for name in DEBUG_CHANNELS}

    def __init__(self, device: str, settings: CacheSettings, *, deterministic: bool = False):
        self.device, self.settings = device, settings
        self.deterministic = deterministic and threads_race(device)
        self.width = self.height = 0
        self.capacity = 1 << settings.capacity
        self.grid = make_grid(settings, device)
        self.control = make_control(device)
        # Cells in use, listed while light goes on within frames.
        self.live = WorkList(self._zeros(self.capacity, int), self._zeros(1, int))
        self.pending = self._zeros(1, int)  # frame that has started bounce rays for the next one, plus one
        self.count = self.bounces = self.settled = -1
        self.further: tuple[int, ...] = ()  # from where this frame's have ended, and again, while light spreads
        self._layers, self.mirrors = False, None
        self.ways: FogWays | None = None  # the fog along all rays
        self._views, self._gbuffer = None, {}

    def _zeros(self, count: int, dtype: type) -> wp.array:
        return wp.zeros(count, dtype=dtype, device=self.device)

    def resize(self, width: int, height: int) -> None:
        """Take note of the picture's size [px], which debug views and the number of bounce rays depend on."""
        self.width, self.height = width, height

    def reset(self) -> None:
        """Forget all cells."""
        for buffers in (self.grid, self.control):
            for array in arrays_of(buffers):
                array.zero_()
        self.control.factors.fill_(wp.vec3(1.0, 1.0, 1.0))
        if self.count >= 0:
            self.vertices.cell.fill_(int(NO_CELL))

    def _fit(self, count: int, filtered: bool, mirrors: bool) -> None:
        """Allocate for so many probe rays."""
        share = 0.0 if self.settings.bounces == 1 else self.settings.bounce_share
        self.settled = math.ceil(share * count)
        # Room for as many as there are hits: light spreads faster with them after the start and edits.
        bounces = max(self.settled, spreading_rays(count, self.width, self.height)) if share > 0.0 else 0
        if (count, bounces, filtered, mirrors) == (self.count, self.bounces, self._layers, bool(self.mirrors)):
            return
        self.count, self.bounces, self._layers = count, bounces, filtered
        # Only where light goes on from cell to cell.
        sweeps_on = bounces > 0 and self.settings.bounces != 2
        self.further = tuple(math.ceil(each * bounces) for each in FURTHER_SHARES if sweeps_on)
        total = count + self.most_bounces
        self.paths, self.vertices = make_rays(count, self.most_bounces, filtered, self.device)
        self.queue = make_queue(total if filtered else 1, self.device)
        self.layered = make_work_list(total if filtered else 1, self.device)
        self.left, self.lit = make_work_list(total, self.device), make_work_list(total, self.device)
        """Rays and shadow rays that need the full node machine; all shadow rays"""
        self.mirrors = MirrorRays(self.paths, total if mirrors else 0, self.queue, self.layered, self.device)

    @property
    def most_bounces(self) -> int:
        """Slots of bounce rays; frames while light spreads need them all, others the first `bounces`."""
        return self.bounces + sum(self.further)

    def cells(self, minimum_cell: float) -> HashGrid:
        """Return the cells for rays of other passes, with the smallest size [m] set (see smallest_cell).

        Their samples of direct light must be added before the cache's own frame, which takes them in.
        """
        self.grid.minimum = minimum_cell
        return self.grid

    def record(
        self, graph: FrameGraph, parity: int, scene: Scene, views: wp.array, rays: ProbeRays, count: int, *,
        minimum_cell: float, threshold: float = float(NO_THRESHOLD), filtered: bool = True, programs: bool = True,
        gbuffer: GBuffer | None = None, all_lean: bool = False, lean_layers: bool = False,
        world: wp.array | None = None, started: bool = False, after: tuple[str, ...] = (),
        phase: LightPhase = LightPhase.SWEEPING, fog: Fog | None = None, polished: float = math.inf,
    ) -> None:
        """Record a frame of the cache: answers the rays (`rays.radiance`).

        Args:
            graph: What to add to.
            parity: 0 for even frames, 1 for odd ones.
            scene: The scene.
            views: One View.
            rays: Of the probes.
            count: Slots of rays.
            minimum_cell: Smallest cell [m], see smallest_cell.
            threshold: Luminance to which the world's radiance is limited for rays that miss (EnvironmentSplit).
            filtered: Whether rays pass surfaces: triangles that need a test per hit, or clear glass.
            programs: Whether lights may be programs (DeviceScene.has_hit_programs).
            gbuffer: For debug views alone.
            all_lean: Whether the lean node machine runs all flat programs (MaterialTable.lean).
            lean_layers: Whether it runs all transparency programs.
            world: The world's radiance by texels, where it is known (DeviceScene.world_texels).
            started: Whether record_start has been called, as it must be before anything makes cells.
            after: Branches of the graph that add cells and samples.
            phase: How far light has spread in these frames.
            fog: What is along the rays; None: nothing.
            polished: Least roughness of surfaces that mostly reflect (Reflectors).
        """
        self._take(count, minimum_cell, filtered, all_lean, lean_layers, world, fog, polished)
        settled = self.is_settled(phase)
        self._views, self._gbuffer[parity] = views, gbuffer
        total = count + self.most_bounces
        with graph.slots(0, count, total):
            with graph.section("Cache rays"):
                graph.launch(cache_rays.load_probe_rays, count, [views, rays, int(filtered)], [self.paths])
                self._record_hits(graph, scene, 0, count)
            self._record_materials(graph, scene, views, 0, count, threshold)
            # Others may make cells and add samples while this goes on, unless their order is to be fixed.
            if self.deterministic:
                graph.join(*after)
            if not started:
                self.record_start(graph, views, phase)
            self._record_insertion(graph, views, 0, count)
        bounces = 0 if settled else self.bounces
        if bounces > 0:
            self._record_start(graph, views, settled=False)
            self._record_bounces(graph, scene, views, threshold, 0, bounces)
        if phase is LightPhase.SWEEPING:
            bounces = self._record_further(graph, scene, views, threshold)
        with graph.slots(0, count + bounces, total):
            self._record_lights(graph, scene, views, programs, 0, count + bounces, settled=settled)
        self._record_cells(graph, views, rays, after, phase, bounces)
        if settled and self.bounces > 0:
            # Beside all that follows.
            with graph.branch(BOUNCES):
                with graph.section("Cache cells"), graph.slots(count, self.bounces, total):
                    self._record_sums(graph, views, count, self.bounces)
                self._record_start(graph, views, settled=True)

    def _take(
        self, count: int, minimum_cell: float, filtered: bool, all_lean: bool, lean_layers: bool,
        world: wp.array | None, fog: Fog | None, polished: float,
    ) -> None:
        """Take in what a record needs to know, and allocate for it."""
        self._all_lean, self._lean_layers = all_lean, lean_layers
        self._world = self._zeros(1, wp.vec3) if world is None else world
        self.grid.minimum = minimum_cell
        self._fit(count, filtered, self.settings.follow_mirrors and polished < FOLLOWED_ROUGHNESS)
        self.ways = fog and FogWays.make(fog, self.count + self.most_bounces, self.device, self.ways)

    def record_pending(
        self, graph: FrameGraph, scene: Scene, views: wp.array, phase: LightPhase, count: int, *, threshold: float,
        programs: bool, after: str, **what: Any,
    ) -> None:
        """Record following the bounce rays of the frame before, in settled frames: they are not waited for in theirs.

        Comes before `record`, on a branch of its own that waits for branch `after`, where record_start is; `record`
        goes on with it: their light is for the next frame. Other arguments as of `record`.
        """
        self._take(count, **what)
        if self.bounces == 0 or not self.is_settled(phase):
            return
        with graph.branch(BOUNCES), graph.slots(count, self.bounces, count + self.most_bounces):
            graph.join(after)
            with graph.section("Cache bounces"):
                graph.launch(
                    cache_rays.resume_bounces, self.bounces, [views, self.pending, count], [self.paths, self.vertices])
            self._record_bounces(graph, scene, views, threshold, 0, self.bounces)
            self._record_lights(graph, scene, views, programs, count, self.bounces, settled=True)
            with graph.section("Cache cells"):
                self._record_gathering(graph, views, self.bounces)
                record_coarse_cells(graph, views, self.grid, self.control, self.vertices, self.bounces)

    def is_settled(self, phase: LightPhase) -> bool:
        """Return whether cells take the light of bounce rays and of other passes' hits in the frame after.

        What they hold is a mean of many frames by then, and nobody has to wait for these rays.
        """
        return phase is LightPhase.SETTLED and not self.deterministic

    def record_start(self, graph: FrameGraph, views: wp.array, phase: LightPhase) -> None:
        """Record making room for a frame's cells; a frame that goes on with `record`."""
        share = int(cache_cells.PURGE_SHARE)
        with graph.section("Cache cells"):
            if phase is LightPhase.SWEEPING:
                # Settled frames leave samples for the next one, which an edit of light has made obsolete.
                graph.clear(self.grid.sums, self.grid.counts)
            if not self.is_settled(phase):
                graph.clear(self.control.balance)
            graph.launch(
                cache_cells.purge_cells, self.capacity // share, [views, self.capacity, self.settings.lifetime],
                [self.grid, self.control], banded=False)

    def _record_hits(self, graph: FrameGraph, scene: Scene, offset: int, count: int) -> None:
        """Record finding the hits of `count` rays from slot `offset` on."""
        record_hits(
            graph, scene, self.paths, offset, count, self.queue, self.layered, filtered=has_layers(scene),
            lean=self._lean_layers, through=True)

    def _record_materials(
        self, graph: FrameGraph, scene: Scene, views: wp.array, offset: int, count: int, threshold: float,
    ) -> None:
        """Record what the hits of `count` rays from slot `offset` on are made of."""
        with graph.section("Cache materials"):
            left = None
            if not self._all_lean or (scene.environment.constant == 0 and len(self._world) == 1):
                left = self.left.part(offset, count)
            what = [int(offset > 0), self.grid.weighed, threshold, int(self._layers)]
            record_materials(graph, scene, views, self.paths, self.vertices, self._world, offset, count, what, left,
                             self.ways, self.mirrors, self._lean_layers)

    def _record_insertion(self, graph: FrameGraph, views: wp.array, offset: int, count: int) -> None:
        """Record finding or making the cells of the hits of `count` rays from slot `offset` on."""
        with graph.section("Cache cells"):
            record_insertion(
                graph, views, self.paths, self.vertices, self.grid, offset, count, deterministic=self.deterministic)

    def _record_start(self, graph: FrameGraph, views: wp.array, *, settled: bool) -> None:
        """Record sending rays on from the probes' hits."""
        with graph.section("Cache bounces"):
            graph.launch(
                cache_rays.start_bounces, self.bounces,
                [views, self.grid, self.count, self.bounces, self.settled, int(self._layers), int(settled)],
                [self.paths, self.vertices, self.pending])

    def _record_bounces(
        self, graph: FrameGraph, scene: Scene, views: wp.array, threshold: float, begin: int, count: int,
    ) -> None:
        """Record following `count` bounce rays that have been started, from `begin` on, up to their hits' cells."""
        first = self.count + begin
        with graph.section("Cache bounces"):
            self._record_hits(graph, scene, first, count)
        self._record_materials(graph, scene, views, first, count, threshold)
        self._record_insertion(graph, views, first, count)

    def _record_further(self, graph: FrameGraph, scene: Scene, views: wp.array, threshold: float) -> int:
        """Record sending rays on from where bounce rays have ended; return how many bounce rays there are in all."""
        begin, width = 0, self.bounces
        for further in self.further:
            with graph.section("Cache bounces"):
                record_continuing(
                    graph, views, self.grid, self.paths, self.vertices, self.count, begin, width, further,
                    int(self._layers))
            begin, width = begin + width, further
            self._record_bounces(graph, scene, views, threshold, begin, width)
        return begin + width

    def _record_lights(
        self, graph: FrameGraph, scene: Scene, views: wp.array, programs: bool, offset: int, count: int, *,
        settled: bool,
    ) -> None:
        """Record direct light at the hits of `count` rays from slot `offset` on."""
        if scene.lights.class_count == 0:
            # Black samples: nothing else writes them.
            self.paths.radiance.zero_()
            self.paths.shadow_distance.zero_()
            return
        with graph.section("Cache lights"):
            graph.launch(
                cache_lights.choose_cache_lights, count,
                [views, scene, self._world, self.vertices, self.grid,
                 float(self.settings.sample_cap if settled else math.inf)], [self.paths], start=offset)
        with graph.section("Cache shadow rays"):
            record_shadow_rays(
                graph, views, scene, self.paths, offset, count, self.queue, self.lit, self.layered, self.left,
                filtered=has_layers(scene), lean_layers=self._lean_layers, programs=programs,
                fog=self.ways and self.ways.fog)

    def _record_cells(
        self, graph: FrameGraph, views: wp.array, rays: ProbeRays, after: tuple[str, ...], phase: LightPhase,
        bounces: int,
    ) -> None:
        """Record taking the light into the cells, also that of `bounces` bounce rays, and the answer."""
        grid, control, settings = self.grid, self.control, self.settings
        sweeping, settled = phase is LightPhase.SWEEPING, self.is_settled(phase)
        with graph.section("Cache cells"):
            if settled:
                with graph.slots(0, self.count, self.count + self.most_bounces):
                    self._record_sums(graph, views, 0, self.count)
                    self._record_answer(graph, views, rays)
                return
            if bounces > 0:
                self._record_gathering(graph, views, bounces)
            if self.deterministic and bounces > 0:
                graph.launch(cache_claim.claim_coarse, bounces, [self.vertices], [grid], banded=False)
                graph.launch(cache_claim.settle_cells, self.capacity, [], [grid], banded=False)
            if bounces > 0:
                record_spreading(
                    graph, views, grid, control, self.paths, self.vertices, self.live, self.count, bounces,
                    float(settings.sample_cap), all_bounces=sweeping and settings.bounces != 2)
            self._record_sums(graph, views, 0, self.count + bounces)
            graph.join(*after)
            self._record_answer(graph, views, rays)

    def _record_gathering(self, graph: FrameGraph, views: wp.array, bounces: int) -> None:
        graph.launch(
            cache_shade.gather_bounces, bounces,
            [views, self.grid, self.paths, self.count, int(self.settings.bounces != 2)], [self.vertices])

    def _record_sums(self, graph: FrameGraph, views: wp.array, offset: int, count: int) -> None:
        record_sums(graph, views, self.paths, self.vertices, self.grid, offset, count, self.count)

    def _record_answer(self, graph: FrameGraph, views: wp.array, rays: ProbeRays) -> None:
        grid, settings = self.grid, self.settings
        graph.launch(
            cache_cells.update_cells, self.capacity, [views, float(settings.sample_cap)], [grid, self.control])
        graph.launch(
            cache_shade.resolve_rays, self.count,
            [views, grid, self.paths, self.vertices, int(settings.cone_test)], [rays])

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` into `picture`, vec4 a pixel; record() must have got the G-buffer."""
        grid = copy_struct(self.grid)
        grid.level_blend = 0
        graph.launch(
            cache_debug.draw_cache, self.width * self.height,
            [self._views, grid, self._gbuffer[parity], self.width, int(DEBUG_CHANNELS[name])], [picture])

    def stats(self) -> dict[str, int]:
        """Return the last frame's counts; waits for the device."""
        counters = np.zeros(int(cache_cells.COUNTERS), np.int64)
        if self.count >= 0:
            bounces = self.most_bounces if sweeps(self._views) else self.bounces
            counters = count_rays(self.paths, self.vertices, self.grid, self.count, self.control, self.count + bounces)
        counts = {name: int(counters[int(index)]) for name, index in COUNTERS.items()}
        counts |= {"cells live": int(self.grid.live.numpy()[0]), "cells": self.capacity}
        return counts | {"rays over mirrors": self.mirrors.followed() if self.mirrors else 0}
