# SPDX-License-Identifier: GPL-3.0-or-later
"""The hash-grid radiance cache: follows the probes' rays to what they hit and tells the light that comes from there.

GI-1.0 (Boisse et al. 2023), section 4, with all bounces: a share of the hits sends a ray on, whose hit's cell, as of
the frame before, lights the cell that it came from. Owns the cells and the order of a frame, whose rays are
cached_rays.py's; knows nothing of probes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from ...kernels import cache_cells, cache_claim, cache_debug, cache_rays, cache_shade
from ...kernels.cache_mirrors import FOLLOWED_ROUGHNESS
from ...kernels.environment_split import NO_THRESHOLD
from ...kernels.fog import Fog
from ...kernels.gbuffer import GBuffer
from ...kernels.hash_grid import HashGrid
from ...kernels.probe_rays import ProbeRays
from ...kernels.types import Scene
from ..debug_views import DEBUG_VIEWS
from ..frame_graph import FrameGraph
from ..history import arrays_of, copy_struct
from ..ray_budget import HALF_RATE_PIXELS, SMALLEST_PIXELS
from ..settings import CacheSettings
from ..work_list import WorkList
from .cache_buffers import COUNTERS, count_rays, make_control, make_grid, threads_race
from .cache_spreading import LightPhase, record_coarse_cells, record_continuing, record_spreading, sweeps
from .cached_rays import CachedRays

__all__ = ["RadianceCachePass", "smallest_cell"]

BOUNCES = "bounces"
"""Branch of the graph on which light goes from cell to cell while it need not be waited for"""

SMALLEST_CELL = 0.1
"""Metres: the published minimum, for rooms"""

FINEST_CELLS = 0.5
"""Width of cells with CacheSettings.refine once rays have met them for some frames, by that of the first"""

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
        self.rays = CachedRays(device, settings, self.grid)
        self.live = WorkList(self._zeros(self.capacity), self._zeros(1))
        """Cells in use, listed while light goes on within frames"""
        self.pending = self._zeros(1)
        """The frame that has started bounce rays for the next one, plus one"""
        self._views, self._gbuffer = None, {}

    def _zeros(self, count: int) -> wp.array:
        return wp.zeros(count, dtype=int, device=self.device)

    def resize(self, width: int, height: int) -> None:
        """Take note of the picture's size [px]: debug views, bounce rays and the finest cells depend on it."""
        self.width, self.height = width, height
        refined = self.settings.refine and SMALLEST_PIXELS <= width * height <= HALF_RATE_PIXELS
        self.grid.finest = FINEST_CELLS if refined else 1.0

    def reset(self) -> None:
        """Forget all cells."""
        for buffers in (self.grid, self.control):
            for array in arrays_of(buffers):
                array.zero_()
        self.control.factors.fill_(wp.vec3(1.0, 1.0, 1.0))
        self.rays.forget()

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
        glossy: bool = True,
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
            glossy: Whether anything is glossy (Reflectors).
        """
        own = self._take(count, minimum_cell, filtered, all_lean, lean_layers, world, fog, polished, glossy)
        settled = self.is_settled(phase)
        self._views, self._gbuffer[parity] = views, gbuffer
        with graph.slots(0, count, own.total):
            with graph.section("Cache rays"):
                graph.launch(cache_rays.load_probe_rays, count, [views, rays, int(filtered)], [own.paths])
                own.record_hits(graph, scene, 0, count)
            own.record_materials(graph, scene, views, 0, count, threshold)
            # Others may make cells and add samples while this goes on, unless their order is to be fixed.
            if self.deterministic:
                graph.join(*after)
            if not started:
                self.record_start(graph, views, phase)
            own.record_insertion(graph, views, 0, count, deterministic=self.deterministic)
        bounces = 0 if settled else own.bounces
        if bounces > 0:
            self._record_start(graph, views, settled=False)
            self._record_bounces(graph, scene, views, threshold, 0, bounces)
        if phase is LightPhase.SWEEPING:
            bounces = self._record_further(graph, scene, views, threshold)
        with graph.slots(0, count + bounces, own.total):
            own.record_lights(graph, scene, views, 0, count + bounces, programs=programs, settled=settled)
        self._record_cells(graph, views, rays, after, phase, bounces)
        if settled and own.bounces > 0:
            # Beside all that follows.
            with graph.branch(BOUNCES):
                with graph.section("Cache cells"), graph.slots(count, own.bounces, own.total):
                    own.record_sums(graph, views, count, own.bounces)
                self._record_start(graph, views, settled=True)

    def _take(
        self, count: int, minimum_cell: float, filtered: bool, all_lean: bool, lean_layers: bool,
        world: wp.array | None, fog: Fog | None, polished: float, glossy: bool,
    ) -> CachedRays:
        """Take in what a record needs to know, and allocate for it; return the rays."""
        self.grid.minimum = minimum_cell
        mirrors = self.settings.follow_mirrors and polished < FOLLOWED_ROUGHNESS
        self.rays.fit(
            count, (self.width, self.height), layers=filtered, mirrors=mirrors,
            glossy=self.settings.highlights and glossy)
        self.rays.take(world, fog, all_lean=all_lean, lean_layers=lean_layers)
        self.rays.mirrors.struct.homes = self.grid.homes.of
        return self.rays

    def record_pending(
        self, graph: FrameGraph, scene: Scene, views: wp.array, phase: LightPhase, count: int, *, threshold: float,
        programs: bool, after: str, **what: Any,
    ) -> None:
        """Record following the bounce rays of the frame before, in settled frames: they are not waited for in theirs.

        Comes before `record`, on a branch of its own that waits for branch `after`, where record_start is; `record`
        goes on with it: their light is for the next frame. Other arguments as of `record`.
        """
        own = self._take(count, **what)
        if own.bounces == 0 or not self.is_settled(phase):
            return
        with graph.branch(BOUNCES), graph.slots(count, own.bounces, own.total):
            graph.join(after)
            with graph.section("Cache bounces"):
                graph.launch(
                    cache_rays.resume_bounces, own.bounces, [views, self.pending, count], [own.paths, own.vertices])
            self._record_bounces(graph, scene, views, threshold, 0, own.bounces)
            own.record_lights(graph, scene, views, count, own.bounces, programs=programs, settled=True)
            with graph.section("Cache cells"):
                self._record_gathering(graph, views, own.bounces)
                record_coarse_cells(graph, views, self.grid, self.control, own.vertices, own.bounces)

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

    def _record_start(self, graph: FrameGraph, views: wp.array, *, settled: bool) -> None:
        """Record sending rays on from the probes' hits."""
        own = self.rays
        with graph.section("Cache bounces"):
            graph.launch(
                cache_rays.start_bounces, own.bounces,
                [views, self.grid, own.count, own.bounces, own.settled, int(own.layers), int(settled)],
                [own.paths, own.vertices, self.pending])

    def _record_bounces(
        self, graph: FrameGraph, scene: Scene, views: wp.array, threshold: float, begin: int, count: int,
    ) -> None:
        """Record following `count` bounce rays that have been started, from `begin` on, up to their hits' cells."""
        own = self.rays
        first = own.count + begin
        with graph.section("Cache bounces"):
            own.record_hits(graph, scene, first, count)
        own.record_materials(graph, scene, views, first, count, threshold)
        own.record_insertion(graph, views, first, count, deterministic=self.deterministic)

    def _record_further(self, graph: FrameGraph, scene: Scene, views: wp.array, threshold: float) -> int:
        """Record sending rays on from where bounce rays have ended; return how many bounce rays there are in all."""
        own = self.rays
        begin, width = 0, own.bounces
        for further in own.further:
            with graph.section("Cache bounces"):
                record_continuing(
                    graph, views, self.grid, own.paths, own.vertices, own.count, begin, width, further,
                    int(own.layers))
            begin, width = begin + width, further
            self._record_bounces(graph, scene, views, threshold, begin, width)
        return begin + width

    def _record_cells(
        self, graph: FrameGraph, views: wp.array, rays: ProbeRays, after: tuple[str, ...], phase: LightPhase,
        bounces: int,
    ) -> None:
        """Record taking the light into the cells, also that of `bounces` bounce rays, and the answer."""
        grid, control, settings, own = self.grid, self.control, self.settings, self.rays
        sweeping, settled = phase is LightPhase.SWEEPING, self.is_settled(phase)
        with graph.section("Cache cells"):
            if settled:
                with graph.slots(0, own.count, own.total):
                    own.record_sums(graph, views, 0, own.count)
                    self._record_answer(graph, views, rays)
                return
            if bounces > 0:
                self._record_gathering(graph, views, bounces)
            if self.deterministic and bounces > 0:
                graph.launch(cache_claim.claim_coarse, bounces, [own.vertices], [grid], banded=False)
                graph.launch(cache_claim.settle_cells, self.capacity, [], [grid], banded=False)
            if bounces > 0:
                record_spreading(
                    graph, views, grid, control, own.paths, own.vertices, self.live, own.count, bounces,
                    float(settings.sample_cap), all_bounces=sweeping and settings.bounces != 2)
            own.record_sums(graph, views, 0, own.count + bounces)
            graph.join(*after)
            self._record_answer(graph, views, rays)

    def _record_gathering(self, graph: FrameGraph, views: wp.array, bounces: int) -> None:
        """Record collecting what `bounces` bounce rays bring to the cells that they came from."""
        own = self.rays
        graph.launch(
            cache_shade.gather_bounces, bounces,
            [views, self.grid, own.paths, own.count, int(self.settings.bounces != 2)], [own.vertices])

    def _record_answer(self, graph: FrameGraph, views: wp.array, rays: ProbeRays) -> None:
        """Record taking sums into the cells' means, and telling the probes' rays what they meet."""
        grid, settings, own = self.grid, self.settings, self.rays
        graph.launch(
            cache_cells.update_cells, self.capacity, [views, float(settings.sample_cap)], [grid, self.control])
        graph.launch(
            cache_shade.resolve_rays, own.count,
            [views, grid, own.paths, own.vertices, int(settings.cone_test)], [rays])

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` into `picture`, vec4 a pixel; record() must have got the G-buffer."""
        grid = copy_struct(self.grid)
        grid.level_blend = 0
        graph.launch(
            cache_debug.draw_cache, self.width * self.height,
            [self._views, grid, self._gbuffer[parity], self.width, int(DEBUG_CHANNELS[name])], [picture])

    def stats(self) -> dict[str, int]:
        """Return the last frame's counts; waits for the device."""
        own, counters = self.rays, np.zeros(int(cache_cells.COUNTERS), np.int64)
        if own.count >= 0:
            bounces = own.most_bounces if sweeps(self._views) else own.bounces
            counters = count_rays(own.paths, own.vertices, self.grid, own.count, self.control, own.count + bounces)
        counts = {name: int(counters[int(index)]) for name, index in COUNTERS.items()}
        counts |= {"cells live": int(self.grid.live.numpy()[0]), "cells": self.capacity}
        return counts | {"rays over mirrors": own.mirrors.followed() if own.mirrors else 0}
