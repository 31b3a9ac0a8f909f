# SPDX-License-Identifier: GPL-3.0-or-later
"""Light in hair, in real-time frames: rays that follow it over strands, its means, and its way into the picture."""

from __future__ import annotations

import dataclasses

import warp as wp

from ...kernels import (
    compaction,
    flat_tracing,
    hair_full,
    hair_lean,
    hair_light,
    hair_place,
    hair_walk,
    reflection_trace,
)
from ...kernels.direct_emitters import EMITTER_WORDS
from ...kernels.gbuffer import GBuffer
from ...kernels.hair_light import HairHistory
from ...kernels.hair_walk import HairWalks
from ...kernels.hash_grid import HashGrid
from ...kernels.reflection_types import LOBE_TRANSMISSION
from ...kernels.reprojection import Reprojection
from ..device_scene import DeviceScene
from ..frame_graph import FrameGraph
from ..history import History
from ..settings import ReflectionSettings
from ..structures import is_flat
from ..work_list import make_work_list
from .cache_buffers import make_paths, record_shadow_rays
from .ray_scene import RayScene
from .reflections import ReflectionPass

__all__ = ["HairPass", "scatters_in_hair"]

STRANDS = 12
"""That a ray follows light over"""

WAVES = 3
"""Strands that have launches of their own; what is still under way then goes to its end in one"""

SPREAD = ((1, 3.0), (2, 0.7), (4, 0.2), (8, 0.0))
"""Of the passes that spread light over neighbours: distance of the taps [px], and how many frames a pixel must know for
its neighbours to count half"""


def scatters_in_hair(scene: DeviceScene, settings: ReflectionSettings) -> bool:
    """Return whether frames scatter light in hair (kernels/hair_walk.py)."""
    return settings.hair and scene.material_table.lean.strands


class HairPass(ReflectionPass):
    """Owns the rays through hair and what they have found; they end as other rays do."""

    def __init__(self, device: str, settings: ReflectionSettings):
        super().__init__(device, settings, int(LOBE_TRANSMISSION))
        self.name, self.title = "hair", "Hair"
        self._no_emitters = wp.zeros(int(EMITTER_WORDS), dtype=wp.uint64, device=device)
        self._emitters = self._no_emitters

    def resize(self, width: int, height: int) -> None:
        """Allocate for a picture of that size [px]."""
        super().resize(width, height)
        count, device = width * height, self.device

        def history() -> HairHistory:
            made = HairHistory()
            made.light = wp.zeros(count, dtype=wp.uint64, device=device)
            made.rest = wp.zeros(count, dtype=wp.uint64, device=device)
            made.frames = wp.zeros(count, dtype=float, device=device)
            return made

        self.history: History[HairHistory] = History("hair", history)
        self.shown = wp.zeros(count, dtype=wp.uint8, device=device)
        self._rooms = [[wp.zeros(count, dtype=wp.uint64, device=device) for _ in range(2)] for _ in range(2)]
        self._no_weights = wp.empty(0, dtype=wp.vec3, device=device)
        self._lit_for: bool | None = None

    def reset(self) -> None:
        """Forget all frames."""
        self.history.reset()

    def _fit_lit(self, filtered: bool) -> None:
        """Allocate the shadow rays of strands."""
        if self._lit_for == filtered:
            return
        self._lit_for, count = filtered, self.blocks
        self.lit_strands = make_paths(count, filtered, self.device)
        self._under_way, self._pending = (make_work_list(count, self.device) for _ in range(2))
        self.walks = self._fill(HairWalks(), {"kept": wp.vec3, "leaves": wp.uint8}, count)
        self._strand_layers = make_work_list(count if filtered else 1, self.device)

    def record(
        self, graph: FrameGraph, parity: int, views: wp.array, gbuffer: GBuffer, previous: GBuffer,
        previous_matte: wp.array, what: RayScene, grid: HashGrid, emitters: wp.array | None, *,
        after: tuple[str, ...] = (),
    ) -> None:
        """Record the rays of a frame, see `record_rays`; `emitters`: of DirectLightPass.record_emitters, or None."""
        self._emitters = self._no_emitters if emitters is None else emitters
        self._fit_lit(what.filtered)
        self.record_rays(
            graph, parity, views, gbuffer, previous, previous_matte, dataclasses.replace(what, below=False), grid,
            after=after)
        with graph.section(self._section("shadow rays")):
            record_shadow_rays(
                graph, views, what.scene, self.lit_strands, 0, self.blocks, self.queue, self._under_way,
                self._strand_layers, self._pending, filtered=what.filtered, lean_layers=what.lean_layers,
                programs=what.programs, fog=what.fog)

    def _record_places(self, graph: FrameGraph, views: wp.array, gbuffer: GBuffer, what: RayScene) -> None:
        graph.launch(
            hair_place.find_hair, self.blocks, [views, what.scene, self.options, gbuffer],
            [self.shown, self.samples, self.rays])

    def _record_directions(self, graph: FrameGraph, views: wp.array, gbuffer: GBuffer, what: RayScene) -> None:
        scene, outputs = what.scene, [self.paths, self.lit_strands, self.walks]
        lights = [scene, what.split, self._emitters]
        enter, scatter, follow = hair_full.enter_hair, hair_full.scatter_in_hair, hair_full.follow_hair
        if what.lean_strands:
            enter, scatter, follow = (
                hair_lean.enter_lean_hair, hair_lean.scatter_in_lean_hair, hair_lean.follow_lean_hair)
        graph.launch(
            enter, self.blocks, [views, *lights, self.options, gbuffer, STRANDS],
            [self.samples, self.rays, self.paths, self.vertices, self.lit_strands, self.walks])
        trace = flat_tracing.trace_flat_further if is_flat(scene) else reflection_trace.trace_further
        for _ in range(1, WAVES):
            graph.fill_list(compaction.append_living, self.blocks, [self.paths.state, self.queue], self.living)
            graph.launch_listed(trace, [scene, 0], self.living, [self.paths])
            graph.launch_listed(scatter, [*lights, STRANDS], self.living, outputs)
        graph.fill_list(compaction.append_living, self.blocks, [self.paths.state, self.queue], self.living)
        graph.launch_listed(follow, [*lights, STRANDS], self.living, outputs, few=True)
        graph.launch(
            hair_walk.leave_hair, self.blocks, [scene, self.walks], [self.paths, self.vertices, self.lit_strands])

    def record_means(
        self, graph: FrameGraph, parity: int, views: wp.array, gbuffer: GBuffer, reprojection: Reprojection,
        grid: HashGrid,
    ) -> None:
        """Record putting together what the rays have found, once the cache is up to date, and averaging it."""
        self.record_samples(graph, views, grid)
        count, history = self.width * self.height, self.history.current(parity)
        with graph.section(self._section("denoising")):
            graph.launch(
                hair_light.average_hair, count,
                [views, self.options, reprojection, self.shown, self.samples, self.rays, self.lit_strands,
                 self.history.previous(parity)], [history])
            lights = [history.light, history.rest]
            for index, (spacing, alone) in enumerate(SPREAD):
                room = self._rooms[index % 2]
                graph.launch(
                    hair_light.spread_hair, count,
                    [self.width, self.height, spacing, alone, gbuffer, self.shown, history.frames, *lights], room)
                lights = room
            self._lights = lights

    def record_picture(self, graph: FrameGraph, gbuffer: GBuffer, weight: wp.array | None, color: wp.array) -> None:
        """Record putting hair into a composite; `weight`: vec3 a pixel of transparent layers before it, or None."""
        graph.launch(
            hair_light.show_hair, self.width * self.height,
            [gbuffer, self.shown, self._no_weights if weight is None else weight, *self._lights], [color])
