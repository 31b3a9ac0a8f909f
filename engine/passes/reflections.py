# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of glossy reflections, or of refraction: one for each block of pixels and frame (Eto et al. 2023).

A frame in two halves, around the radiance cache. `record_rays` chooses the pixels, traces rays over mirrors and
through glass and puts their hits into the cache, so that they are lit like those of probe rays; `record_samples`
reads the cache there and asks the probes about rougher surfaces. Denoising is a pass of its own.
"""

from __future__ import annotations

import dataclasses

import warp as wp

from ...kernels import (
    cache_cells,
    compaction,
    fog_rays,
    gather_further,
    gather_start,
    reflection_chain,
    reflection_choice,
    reflection_choice_glossy,
    reflection_debug,
    reflection_lamps,
    reflection_lean,
    reflection_materials,
    reflection_movers,
    reflection_place,
    reflection_refract,
    reflection_resolve,
    reflection_resolve_glossy,
    reflection_screen,
    reflection_start,
    reflection_tail,
)
from ...kernels.cache_cells import CacheControl
from ...kernels.cache_rays import Vertices
from ...kernels.composite import Lights
from ...kernels.gbuffer import GBuffer
from ...kernels.hash_grid import HashGrid
from ...kernels.reflection_blocks import ReflectionHistory
from ...kernels.reflection_highlights import HIGHLIGHT_DENSITY
from ...kernels.reflection_rays import GATHERED, REFLECTED, REFRACTED, ReflectionRays
from ...kernels.reflection_types import (
    LOBE_DIFFUSE,
    LOBE_REFLECTION,
    LOBE_TRANSMISSION,
    ReflectionSamples,
)
from ..debug_views import DEBUG_VIEWS
from ..frame_graph import FrameGraph
from ..ray_budget import HALF_RATE_PIXELS
from ..settings import ReflectionSettings, RenderSettings
from ..structures import decides_layers
from ..work_list import WorkList, make_queue, make_work_list
from .cache_buffers import (
    BOUNCE_ARRAYS,
    VERTEX_ARRAYS,
    count_rays,
    make_paths,
    record_insertion,
    record_shadow_rays,
    record_sums,
)
from .layer_rays import record_further, record_hits
from .ray_media import RayMedia, last_of
from .ray_scene import STRIDES, RayScene, reflection_options
from .screen_probes import ScreenProbePass
from .walks import WalkPass

__all__ = ["STRIDES", "RayScene", "ReflectionPass", "gather_settings", "reflection_options"]

SAMPLE_ARRAYS = {"place": wp.uint8, "radiance": wp.uint64, "direction": wp.uint32, "pdf": float}

LOBES = {
    int(LOBE_REFLECTION): ("reflections", "Reflection", int(REFLECTED), reflection_start.start_reflections),
    int(LOBE_TRANSMISSION): ("refraction", "Refraction", int(REFRACTED), reflection_refract.start_refractions),
    int(LOBE_DIFFUSE): ("final gather", "Final gather", int(GATHERED), gather_start.start_gathering),
}
"""The pass's name, its sections' title, what kernels know as `reflection`, the kernel that draws directions"""

WAVES = 2
"""Segments that have launches of their own; what is still under way then is little and goes to its end in one"""

GATHER_SEGMENTS = 2
"""Most segments of a final gather ray, each over a mirror besides"""
MIRRORS_GATHERED = 1
"""That those rays go on over, as those of the probes do"""

CANDIDATES = 4
"""Samples of light considered at each hit"""

DEBUG_CHANNELS = {
    "reflections.classes": reflection_debug.REFLECTION_CLASSES,
    "reflections.hits": reflection_debug.REFLECTION_HITS,
    "reflections.radiance": reflection_debug.REFLECTION_RADIANCE,
    "reflections.distance": reflection_debug.REFLECTION_DISTANCE,
}


def gather_settings(settings: RenderSettings) -> ReflectionSettings:
    """Return the settings of final gather's rays, which go on over as many mirrors as those of the probes."""
    reflections, mirrors = settings.reflections, MIRRORS_GATHERED if settings.cache.follow_mirrors else 0
    return dataclasses.replace(reflections, bounces=min(reflections.bounces, mirrors))


class ReflectionPass:
    """Owns a frame's samples of one lobe and the rays that find them."""

    def __init__(
        self, device: str, settings: ReflectionSettings, lobe: int = int(LOBE_REFLECTION), *, highlights: bool = True,
    ):
        """Make the pass for a lobe: LOBE_*. `highlights`: what rays meet may show some."""
        self.device, self.settings, self.lobe, self._highlights = device, settings, int(lobe), highlights
        self.name, self.title, self.reflection, self._start = LOBES[self.lobe]
        names = DEBUG_CHANNELS if self.lobe == int(LOBE_REFLECTION) else ()
        self.debug_views: dict[str, str] = {name: DEBUG_VIEWS[name] for name in names}
        self.width = self.height = 0
        self._room: tuple | None = None

    def _fill(self, buffers: object, arrays: dict[str, type], count: int) -> object:
        for name, dtype in arrays.items():
            setattr(buffers, name, wp.zeros(count, dtype=dtype, device=self.device))
        return buffers

    def resize(self, width: int, height: int) -> None:
        """Allocate the samples for a picture of that size [px]; rays get room once they are recorded."""
        self.width, self.height = width, height
        self.options = reflection_options(self.settings, width, height, self.lobe)
        self.options.half_rate = int(self.settings.half_rate and width * height > HALF_RATE_PIXELS)
        self.blocks = self.options.columns * self.options.rows
        self.samples = self._fill(ReflectionSamples(), SAMPLE_ARRAYS, self.blocks)
        self._fill(self.samples, {"shift": wp.uint32}, self.blocks if self.lobe == int(LOBE_REFLECTION) else 1)
        self.rays = ReflectionRays()
        self._fill(self.rays, {"source": wp.uint8, "flag": int, "rank": int}, self.blocks)
        self._room: tuple | None = None
        self._gbuffer: dict[int, GBuffer] = {}
        self._media: RayMedia | None = None
        self._walks = WalkPass(self.device, self.blocks)

    def _fit(self, filtered: bool, glossy: bool) -> None:
        """Allocate rays, one for each block."""
        if self._room == (self.blocks, filtered, glossy):
            return
        self._room = (self.blocks, filtered, glossy)
        count = self.blocks
        self.paths, self.vertices = make_paths(count, filtered, self.device), Vertices()
        self._fill(self.vertices, VERTEX_ARRAYS, count)
        self._fill(self.vertices, BOUNCE_ARRAYS, 1)
        self._fill(self.rays, {"block": int, "found": wp.uint8}, count)
        self.rays.glossy = int(glossy)
        # Diffuse light gathers from everywhere what glossy surfaces send on.
        self.rays.least_density = 0.0 if self.lobe == int(LOBE_DIFFUSE) else float(HIGHLIGHT_DENSITY)
        self._fill(self.rays, {"lobe": wp.uint64, "highlight": float, "shared": float}, count if glossy else 1)
        self.queue = make_queue(count, self.device)
        self.all = WorkList(self.queue, self.rays.rank[count - 1 : count])
        """All rays, from the first slot on"""
        self.living, self.left, self.lit = (make_work_list(count, self.device) for _ in range(3))
        self.layered = make_work_list(count if filtered else 1, self.device)
        # The cache's counters are those of the probes' rays.
        self.control = self._fill(CacheControl(), {"age": int, "live": int, "balance": wp.int64, "factors": wp.vec3}, 1)
        self._fill(self.control, {"counters": int}, int(cache_cells.LANES) * int(cache_cells.COUNTERS))

    def reset(self) -> None:
        """Forget the frame before: nothing is kept."""

    def record_rays(
        self, graph: FrameGraph, parity: int, views: wp.array, gbuffer: GBuffer, previous: GBuffer,
        previous_matte: wp.array, what: RayScene, grid: HashGrid, *, after: tuple[str, ...] = (),
        known: ReflectionHistory | None = None,
    ) -> None:
        """Record choosing the pixels and tracing rays; comes before the cache's frame, which takes in their light.

        Args:
            graph: What to add to.
            parity: 0 for even frames, 1 for odd ones.
            views: One View.
            gbuffer: Of this frame.
            previous: Of the frame before.
            previous_matte: CompositePass.matte of the frame before.
            what: The scene.
            grid: The radiance cache's cells, ready for this scene.
            after: Branches of the graph that make cells before, where their order is to be fixed.
            known: Means of the frame before, None without: blocks whose means do for them leave turns out.
        """
        self._before = known or ReflectionHistory(), previous_matte
        lit = what.scene.lights.class_count > 0 and self.settings.hit_lighting
        self._fit(what.filtered, what.glossy and lit and self._highlights)
        self._gbuffer[parity], self._surfaces, self._grid, self._views = gbuffer, gbuffer, grid, views
        scene, blocks, options = what.scene, self.blocks, self.options
        paths, vertices, rays = self.paths, self.vertices, self.rays
        with graph.section(self._section("rays")):
            self._record_places(graph, views, gbuffer, what)
            graph.call(lambda: wp.utils.array_scan(rays.flag, rays.rank, inclusive=True))
            graph.launch(reflection_place.list_rays, blocks, [], [rays], banded=False)
            self._record_directions(graph, views, gbuffer, what)
        follows = what.mirrors or (what.scatters and self.lobe == int(LOBE_TRANSMISSION))
        segments = 1 + (self.settings.bounces if follows else 0)
        # Layers that only the full machine knows take a kernel of their own, for each segment.
        waves = min(segments, WAVES) if what.lean_layers or not what.filtered else segments
        if what.fog is not None:
            waves = segments
        self._media = None
        if what.media is not None and self.lobe != int(LOBE_DIFFUSE):
            # So do media, and segments that are for glass alone.
            self._media = RayMedia(what.media, scene, blocks, self.device)
            self._media.record_start(graph, views, options, gbuffer, self.samples, rays, paths)
            waves = segments + int(reflection_chain.GLASS_FACTOR) * (segments - 1)
        for index in range(waves):
            self._record_segment(graph, what, index, last=last_of(index + 1, segments, self._media is not None))
        if waves < segments:
            self._record_ends(graph, what, segments)
        if what.deterministic:
            graph.join(*after)
        reuse = self.settings.screen_reuse
        if self.lobe == int(LOBE_TRANSMISSION) and what.below:
            self._walks.record(
                graph, views, scene, self.options, gbuffer, grid, self.samples, rays, paths, vertices)
            self._record_segment(graph, what, 1, last=int(reflection_chain.LAST))
        if self.lobe == int(LOBE_DIFFUSE):
            self._record_near_hits(graph, views, what, grid)
            # The frame before is noisier than the hits' own light, and has its error.
            reuse = False
        with graph.section(self._section("hits")):
            graph.launch(
                reflection_screen.look_back, blocks,
                [views, scene, what.motion, self.width, self.height, int(reuse), previous,
                 previous_matte], [rays, paths, vertices])
        self._late = self.settings.hit_lighting and what.settled
        if self.settings.hit_lighting:
            self._record_lights(graph, views, what, grid)
            if not self._late:
                self._record_sums(graph, views, grid)

    def _record_places(self, graph: FrameGraph, views: wp.array, gbuffer: GBuffer, what: RayScene) -> None:
        """Record choosing the pixels."""
        graph.launch(
            reflection_place.place_samples, self.blocks,
            [views, self.options, gbuffer, *self._before], [self.samples, self.rays])

    def _record_directions(self, graph: FrameGraph, views: wp.array, gbuffer: GBuffer, what: RayScene) -> None:
        """Record drawing the rays' first directions."""
        graph.launch(
            self._start, self.blocks, [views, what.scene, self.options, gbuffer],
            [self.samples, self.rays, self.paths, self.vertices])

    def _record_near_hits(self, graph: FrameGraph, views: wp.array, what: RayScene, grid: HashGrid) -> None:
        """Record following rays from near hits further: over as many surfaces as there are segments."""
        for surfaces in range(1, GATHER_SEGMENTS):
            with graph.section(self._section("hits")):
                graph.launch(
                    gather_further.follow_near_hits, self.blocks, [views, grid, surfaces],
                    [self.rays, self.paths, self.vertices])
            self._record_segment(graph, what, surfaces, last=int(reflection_chain.LAST))

    def _section(self, part: str) -> str:
        return f"{self.title} {part}"

    def _record_segment(self, graph: FrameGraph, what: RayScene, index: int, *, last: int) -> None:
        """Record one segment of all rays under way: what it meets, and how it goes on; `last`: 0 or LAST*."""
        scene, blocks, paths, vertices, rays = what.scene, self.blocks, self.paths, self.vertices, self.rays
        work = self.all
        with graph.section(self._section("rays")):
            if index == 0:
                record_hits(
                    graph, scene, paths, 0, blocks, self.queue, self.layered, filtered=what.filtered,
                    lean=what.lean_layers, through=self.lobe == int(LOBE_DIFFUSE))
                # In settled frames nothing but the camera moves (light_phase).
                if self.lobe == int(LOBE_REFLECTION) and not what.settled:
                    graph.launch(
                        reflection_movers.find_image_shifts, blocks,
                        [self._views, scene, what.motion, self.options, self._surfaces, rays, paths, self.samples],
                        [self.samples.shift])
            else:
                work = self.living
                graph.fill_list(compaction.append_living, blocks, [paths.state, self.queue], work)
                record_further(
                    graph, scene, paths, 0, blocks, work, self.queue, self.layered, filtered=what.filtered,
                    lean=what.lean_layers, through=self.lobe == int(LOBE_DIFFUSE))
            if scene.lights.lamp_count > 0 and (self.lobe != int(LOBE_DIFFUSE) or index > 0):
                graph.launch_listed(
                    reflection_lamps.meet_lamps, [scene, self.reflection, rays], work, [paths, vertices])
        with graph.section(self._section("materials")):
            arguments = [self.reflection, last]
            if self._media is not None:
                self._media.record_dimming(graph, paths, vertices, work)
            if what.fog is not None:
                graph.launch_listed(
                    fog_rays.dim_fog_segments, [self._views, scene, what.fog, index], work, [paths, vertices])
            graph.launch_listed(
                reflection_lean.follow_lean, [scene, what.split, what.world, *arguments], work,
                [rays, paths, vertices])
            if what.needs_full:
                if index == 0:
                    work = self.left
                    graph.fill_list(reflection_place.append_left, blocks, [paths, vertices], work)
                graph.launch_listed(
                    reflection_materials.follow_full, [scene, what.split, *arguments, 0, 0], work,
                    [rays, paths, vertices], few=True)
            if self._media is not None:
                self._media.record_crossing(graph, paths, self.all if index == 0 else self.living)

    def _record_ends(self, graph: FrameGraph, what: RayScene, segments: int) -> None:
        """Record following the rays that are still under way to their ends, over so many segments in all."""
        paths, outputs = self.paths, [self.rays, self.paths, self.vertices]
        # Of instances programs decide for the few rays that come so far: one more way would cost all scenes registers.
        decided = decides_layers(what.scene) and int(what.scene.geometry.instanced_filtered.nodes) == 0
        layers = reflection_tail.TAIL_LAYERS_DECIDED if decided else reflection_tail.TAIL_LAYERS
        last = [segments, int(layers) if what.filtered else 0]
        with graph.section(self._section("materials")):
            graph.fill_list(compaction.append_living, self.blocks, [paths.state, self.queue], self.living)
            graph.launch_listed(
                reflection_tail.follow_tail, [what.scene, what.split, what.world, self.reflection, *last],
                self.living, outputs, few=True)
            if what.needs_full:
                graph.fill_list(compaction.append_living, self.blocks, [paths.state, self.queue], self.living)
                graph.launch_listed(
                    reflection_materials.follow_full, [what.scene, what.split, self.reflection, 1, *last],
                    self.living, outputs, few=True)

    def _record_lights(self, graph: FrameGraph, views: wp.array, what: RayScene, grid: HashGrid) -> None:
        """Record lighting the hits in which rays have ended, with a shadow ray each, for them and for their cells."""
        scene, blocks, paths, vertices = what.scene, self.blocks, self.paths, self.vertices
        with graph.section(self._section("hits")):
            record_insertion(graph, views, paths, vertices, grid, 0, blocks, deterministic=what.deterministic)
        if scene.lights.class_count > 0:
            self._record_shadows(graph, views, what, grid)
        else:
            # Black samples: nothing else writes them.
            paths.radiance.zero_()
            paths.shadow_distance.zero_()

    def _record_sums(self, graph: FrameGraph, views: wp.array, grid: HashGrid) -> None:
        """Record adding the hits' light to their cells: all are hits of rays, none of bounces."""
        with graph.section(self._section("hits")):
            record_sums(graph, views, self.paths, self.vertices, grid, 0, self.blocks, self.blocks)

    def _record_shadows(self, graph: FrameGraph, views: wp.array, what: RayScene, grid: HashGrid) -> None:
        """Record choosing a light for each hit, and its shadow ray."""
        scene, blocks, paths, vertices = what.scene, self.blocks, self.paths, self.vertices
        with graph.section(self._section("hits")):
            candidates = 1 if what.programs else CANDIDATES
            choose = reflection_choice_glossy.choose_glossy_lights if self.rays.glossy else (
                reflection_choice.choose_reflection_lights)
            graph.launch(choose, blocks, [scene, what.world, grid, candidates], [self.rays, paths, vertices])
        with graph.section(self._section("shadow rays")):
            record_shadow_rays(
                graph, views, scene, paths, 0, blocks, self.queue, self.lit, self.layered, self.left,
                filtered=what.filtered, lean_layers=what.lean_layers, programs=what.programs, fog=what.fog)

    @property
    def asks_probes(self) -> bool:
        """Whether samples come from the screen probes too (record_look_ups)."""
        return self.lobe == int(LOBE_REFLECTION)

    def record_samples(self, graph: FrameGraph, views: wp.array, grid: HashGrid) -> None:
        """Record finishing the traced samples, once the cache is up to date."""
        if self._late:
            self._record_sums(graph, views, grid)
        with graph.section(self._section("samples")):
            resolve = reflection_resolve_glossy.resolve_glossy_reflections if self.rays.glossy else (
                reflection_resolve.resolve_reflections)
            graph.launch(
                resolve, self.blocks,
                [views, self.options, grid, int(self.settings.hit_lighting), int(self.settings.jitter), self.paths,
                 self.vertices], [self.rays, self.samples])

    def record_seen_light(self, graph: FrameGraph, parity: int, lights: Lights) -> None:
        """Record adding the light of this frame that is scattered below surfaces, once it is there."""
        with graph.section(self._section("samples")):
            self._walks.record_light(graph, self.options, self._gbuffer[parity], lights, self.rays, self.samples)

    def record_look_ups(
        self, graph: FrameGraph, views: wp.array, gbuffer: GBuffer, probes: ScreenProbePass,
    ) -> None:
        """Record asking the probes for the samples that are not traced, once their light is up to date."""
        with graph.section(self._section("samples")):
            probes.record_look_ups(graph, views, gbuffer, self.options, self.rays.source, self.samples)

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` of this frame into `picture`, vec4 a pixel; comes after the samples."""
        graph.launch(
            reflection_debug.show_samples, self.width * self.height,
            [int(DEBUG_CHANNELS[name]), self.options, self._gbuffer[parity], self.rays, self.samples], [picture])

    def stats(self) -> dict[str, int]:
        """Return the last frame's counts; waits for the device."""
        if self._room is None:
            return {}
        counters = count_rays(self.paths, self.vertices, self._grid, self.blocks, self.control, len(self.paths.state))
        what = self.title.lower()
        return {f"{what} rays": int(self.rays.rank.numpy()[-1]),
                f"{what} shadow rays": int(counters[int(cache_cells.COUNT_SHADOWS)])}
