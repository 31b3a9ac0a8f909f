# SPDX-License-Identifier: GPL-3.0-or-later
"""One real-time frame, top to bottom: the table of contents of the method.

GI-1.0 (Boissé et al. 2023) with its energy mended: screen probes gather diffuse light over a hash-grid radiance cache,
lamps light the visible surfaces by resampled importance sampling, and what both leave noisy is filtered in time and
space. The frame is recorded once for even and once for odd frames (their histories swap) and replayed; it is recorded
anew when settings or the scene's arrays change, not when the camera or objects move.
"""

from __future__ import annotations

import warp as wp

from ..kernels.direct_light import DirectLight
from ..kernels.fog import Fog
from ..kernels.gbuffer import GBuffer
from ..kernels.motion import Motion
from ..kernels.reflection_chain import MIRROR_ROUGHNESS
from ..kernels.reflection_sources import DISTANCE_ROUGHNESS
from ..kernels.types import Scene
from .clear_glass import light_scene, passes_glass
from .device_scene import DeviceScene
from .environment_split import split_environment
from .frame_fingerprint import fingerprint
from .frame_graph import FrameGraph
from .frame_passes import FramePasses
from .motion import MotionTracker
from .passes.absent import note_absent
from .passes.cache_spreading import LightPhase, light_phase
from .passes.depth_of_field import has_blur
from .passes.fog import FOG
from .passes.gbuffer import LAMPS, shines_plainly
from .passes.radiance_cache import smallest_cell
from .passes.ray_scene import scatters_below
from .passes.reflections import RayScene, ReflectionPass
from .settings import RenderSettings
from .view_data import ViewTracker

__all__ = ["Pipeline"]

PREPARATION, REPROJECTION, DIRECT = "preparation", "reprojection", "direct light"
"""Branches of the graph, besides the passes' own"""


class Pipeline(FramePasses):
    """The passes of a frame, their order and their recorded launches."""

    def __init__(self, device: str):
        super().__init__(device)
        self.times: dict[str, float] = {}
        """Milliseconds of each section of the last timed frame"""
        self.kernel_times: dict[str, float] = {}
        """The same by kernel"""
        self.skipped: dict[str, str] = {}
        """Sections that the scene does not need, with the reason"""
        self._parity = 0
        self._graph: FrameGraph | None = None
        self._graphs: dict[tuple[int, bool, LightPhase, bool], tuple[FrameGraph, wp.array | None, list]] = {}
        self._recorded_for = b""
        self.records = 0
        """Frames that were recorded so far: such a frame takes longer than those that follow"""
        self._picture: wp.array | None = None
        self._split_for = None
        self._debug: tuple | None = None
        self._blurred = False

    def configure(self, settings: RenderSettings, width: int, height: int, light_passes: bool) -> None:
        """Make the passes for settings and a size [px]."""
        self._make_passes(settings, width, height, light_passes)
        self._debug_picture = wp.zeros(width * height, dtype=wp.vec4, device=self.device)
        self.motion = MotionTracker(self.device)
        self.show(settings.debug.view)

    def show(self, name: str) -> None:
        """Draw an intermediate result of the frames to come (a name in debug_views.py) instead of the picture."""
        owner = next((each for each in self.passes if name in each.debug_views), None)
        self._debug = (owner, name) if owner is not None else None
        self._forget_records()

    def _forget_records(self) -> None:
        self._graphs, self._recorded_for = {}, b""

    def frame(self, scene: DeviceScene, views: ViewTracker, timed: bool = False, unseen: bool = False) -> None:
        """Render the frame that `views` has advanced to; its result is `picture`.

        Args:
            scene: The scene; its arrays are read while the frame runs.
            views: Camera and counters.
            timed: Whether to measure every section, which waits for each.
            unseen: Whether it only fills the radiance cache: there is no picture then.
        """
        motion = self.motion.advance(scene)
        self._update_split(scene)
        self._blurred = self._settings.denoiser.depth_of_field and has_blur(views.row["camera"])
        recorded_for = fingerprint(scene, motion, self.split, self._blurred)
        if recorded_for != self._recorded_for:
            self._graphs, self._recorded_for = {}, recorded_for
        # What only frames at rest need, or the first after an edit of light, costs the others nothing: they are records
        # of their own.
        resting = self._settings.denoiser.rest_gather and views.rest > 0 and not unseen
        phase = light_phase(views.frame, views.light_age, views.moved_age, resting=resting)
        key = views.parity, resting, phase, unseen
        if key not in self._graphs:
            self._graphs[key] = self._record(*key, scene, views.array, motion)
            self.records += 1
        graph, self._picture, self._recorded = self._graphs[key]
        self._parity, self._graph = views.parity, graph
        graph.replay(timed)
        self.times, self.skipped, self.kernel_times = graph.times or self.times, graph.skipped, graph.kernel_times

    def launches(self) -> list[tuple[str, str]]:
        """Return section and kernel of each launch of the last frame, in its order."""
        return [] if self._graph is None else self._graph.launch_list()

    @property
    def picture(self) -> wp.array:
        """Return the newest picture, or the debug view chosen: vec4 [h * w], as the film shows it."""
        return self._picture

    def counts(self) -> dict[str, int]:
        """Return what the last frame counted. Waits for the device."""
        counts = {"primary rays": self.gbuffer.width * self.gbuffer.height}
        if self.direct in self._recorded:
            counts |= self.direct.stats(self._parity)
        counts |= {f"probes {name}": value for name, value in self.probes.stats().items()}
        counts |= {f"cache {name}": value for name, value in self.cache.stats().items()}
        for each in (self.reflections, self.refraction, self.gather, self.hair):
            if each in self._recorded:
                counts |= each.stats()
        return counts

    def _update_split(self, scene: DeviceScene) -> None:
        """Split the world's light anew where the world has changed."""
        if self._split_for is not scene.environment:
            self.split = split_environment(scene.scene, self.device)
            self._split_for = scene.environment

    def _record_filter(
        self, graph: FrameGraph, parity: int, views: wp.array, surfaces: GBuffer, traced: ReflectionPass,
    ) -> wp.array:
        """Record denoising the samples of reflections or refraction; return their mean."""
        with graph.section(f"{traced.title} denoising"):
            return self._filters[traced].record(
                graph, parity, views, surfaces, self.gbuffer.previous(parity), self.gbuffer.reprojection,
                traced.options, traced.samples, jitter=self._settings.reflections.jitter)

    def _record_direct(
        self, graph: FrameGraph, parity: int, resting: bool, phase: LightPhase, scene: DeviceScene,
        kernels_scene: Scene, views: wp.array, surfaces: GBuffer, fog: Fog | None,
    ) -> DirectLight:
        """Record direct light and its filter; `kernels_scene`: from light_scene."""
        graph.join(REPROJECTION)
        before, reprojection = self.gbuffer.previous(parity), self.gbuffer.reprojection
        direct = self.direct.record(
            graph, parity, kernels_scene, views, surfaces, before, reprojection, self.split,
            filtered=scene.structures.has_filtered, textured=scene.emitters.textured, local_power=scene.local_power,
            lean_layers=scene.material_table.lean.transparency, shaped=scene.material_table.reflectors.shaped,
            fog=fog, history=self.direct_denoise.history.previous(parity))
        with graph.section("Direct denoising"):
            # A sun's shadows have narrow edges and no noise beside them: blurred they would be wider.
            return self.direct_denoise.record(
                graph, parity, views, surfaces, before, reprojection, direct,
                noisy=phase is LightPhase.SWEEPING and scene.local_power > 0.0,
                changing=resting or phase is not LightPhase.SETTLED)

    def _record(
        self, parity: int, resting: bool, phase: LightPhase, unseen: bool, scene: DeviceScene, views: wp.array,
        motion: Motion,
    ) -> tuple[FrameGraph, wp.array | None, list]:
        """Record a frame: the method in its order. With `resting` pixels gather indirect light themselves."""
        self._recorded = []
        self._prepare(self.gbuffer, self.cache, self.probes)
        if not unseen:
            self._prepare(self.diffuse_denoise, self.composite)
        graph, kernels_scene = FrameGraph(self.device), light_scene(scene.scene, self._settings.direct_light)
        filtered, programs = scene.structures.has_filtered, scene.has_hit_programs
        shining = shines_plainly(kernels_scene, scene.emitters)
        lean, reflectors = scene.material_table.lean, scene.material_table.reflectors
        below = scatters_below(scene, self._settings.reflections)
        # Branches run side by side: what needs no surfaces beside the primary rays, then direct light and each kind of
        # reflection ray beside the probes, whose chain of short kernels is the longest and goes first.
        fog = self._needs_fog(graph, parity, scene)
        lit = not (unseen and fog is None) and self._needs_direct(graph, scene, self.split)
        with graph.branch(PREPARATION):
            self.cache.record_start(graph, views, phase)
            if lit:
                self.direct.record_emitters(graph, kernels_scene, scene.local_power)
        smallest = smallest_cell(self._settings.cache, scene.radius)
        self.cache.grid.homes = scene.homes.struct(scene.instances)
        cache_scene = {
            "minimum_cell": smallest, "threshold": self.split.threshold, "programs": programs, "fog": fog,
            "filtered": filtered or passes_glass(kernels_scene), "polished": reflectors.polished,
            "all_lean": lean.flat, "lean_layers": lean.transparency, "world": scene.world_texels}
        self.cache.record_pending(
            graph, kernels_scene, views, phase, self.probes.rays_a_frame, after=PREPARATION, **cache_scene)
        surfaces = self.gbuffer.record(
            graph, parity, kernels_scene, scene.structures, views, filtered=filtered, all_lean=lean.surface,
            lean_layers=lean.transparency, shining=shining, exact=lean.exact, scattering=below)
        before, reprojection = self.gbuffer.previous(parity), self.gbuffer.reprojection
        color = matte = None
        if not unseen:
            with graph.branch(REPROJECTION):
                self.gbuffer.record_reprojection(graph, parity, kernels_scene, views, motion)
            color, matte = self.composite.color.previous(parity), self.composite.matte.previous(parity)
        graph.join(PREPARATION)
        traced = [] if unseen else self._reflecting(graph, scene)
        gathering = [] if unseen else self._gathering(graph, resting)
        what = RayScene(
            kernels_scene, self.split, motion, scene.world_texels, filtered, programs, lean.plain, lean.transparency,
            lean.lean_strands, reflectors.refracts or reflectors.sharpest < MIRROR_ROUGHNESS, reflectors.scatters,
            below, self.cache.deterministic, self.cache.is_settled(phase), reflectors.glossy,
            scene.media and scene.media.frames, fog)
        note_absent(graph, scene, what)
        branches: tuple[str, ...] = ()
        for each in traced + gathering:
            with graph.branch(each.name):
                each.record_rays(
                    graph, parity, views, surfaces, before, matte, what, self.cache.cells(smallest), after=branches,
                    known=self._filters[each].known(parity) if each in traced else None)
            branches += (each.name,)
        if hair := self.hair in self._recorded:
            with graph.branch(self.hair.name):
                self.hair.record(
                    graph, parity, views, surfaces, before, matte, what, self.cache.cells(smallest),
                    self.direct.emitters if lit else None, after=branches)
            branches += (self.hair.name,)
        with graph.branch(DIRECT):
            direct = self._black if not lit or unseen else self._record_direct(
                graph, parity, resting, phase, scene, kernels_scene, views, surfaces, fog)
        rays, count = self.probes.record_rays(graph, kernels_scene, views, surfaces)
        if fog is not None:
            self.fog.record_samples(
                graph, parity, kernels_scene, views, surfaces, fog, self.split, self.direct.emitters if lit else None,
                rays, filtered=filtered, textured=scene.emitters.textured, lean_layers=lean.transparency)
        self.cache.record(
            graph, parity, kernels_scene, views, rays, count, gbuffer=surfaces, started=True, after=branches,
            phase=phase, **cache_scene)
        if fog is not None:
            self.fog.record_light(graph, parity, kernels_scene, fog, self.cache.rays.ways, phase)
        if unseen:
            return graph, None, self._recorded
        graph.join(REPROJECTION, LAMPS)
        shown = {}
        for each in traced:
            with graph.branch(each.name):
                each.record_samples(graph, views, self.cache.grid)
                if not (each.asks_probes or below):
                    shown[each] = self._record_filter(graph, parity, views, surfaces, each)
        if hair:
            with graph.branch(self.hair.name):
                self.hair.record_means(graph, parity, views, surfaces, reprojection, self.cache.grid)
        indirect = self.probes.record_light(
            graph, views, surfaces, color, reprojection, parity, self.diffuse_denoise.history.previous(parity))
        for each in traced:
            if each.asks_probes:
                with graph.branch(each.name):
                    each.record_look_ups(graph, views, surfaces, self.probes)
                    shown[each] = self._record_filter(graph, parity, views, surfaces, each)
        with graph.section("Diffuse denoising"):
            indirect = self.diffuse_denoise.record(graph, parity, views, surfaces, before, reprojection, indirect)
        gathered = None
        for each in gathering:
            graph.join(each.name)
            each.record_samples(graph, views, self.cache.grid)
            with graph.section(f"{each.title} denoising"):
                gathered = self.rest_gather.record(
                    graph, parity, views, surfaces, before, reprojection, each.options, each.samples, indirect)
        graph.join(DIRECT, *branches)
        graph.join(FOG)
        if below:
            self.refraction.record_seen_light(graph, parity, self.composite.lights(direct, indirect, gathered))
            shown[self.refraction] = self._record_filter(graph, parity, views, surfaces, self.refraction)
        mirrors = None
        if self.reflections in traced and reflectors.sharpest < DISTANCE_ROUGHNESS:
            mirrors = self.reflection_denoise.mirrors(parity, surfaces)
        with graph.section("Composite"):
            picture = self.composite.record(
                graph, parity, views, surfaces, reprojection, direct, indirect,
                self.probes.specular_ratio, shown.get(self.reflections), shown.get(self.refraction),
                self.reflections.options if self.reflections in traced else None, gathered, mirrors,
                keeping_matte=bool(traced), over=None if not hair else lambda color: self.hair.record_picture(
                    graph, surfaces, self.gbuffer.hits.weight if filtered else None, color),
                veil=None if fog is None else lambda color: self.fog.record_picture(graph, parity, color))
        if self._blurred:
            self._prepare(self.depth_of_field)
            with graph.section("Depth of field"):
                picture = self.depth_of_field.record(graph, views, surfaces.depth, *self.composite.newest(parity))
        else:
            graph.skip("depth of field", "all is in focus, or it is switched off")
        if self._debug is not None:
            owner, name = self._debug
            with graph.section("Debug view"):
                graph.clear(self._debug_picture)
                if owner in self._recorded:
                    owner.record_debug(graph, parity, name, self._debug_picture)
            picture = self._debug_picture
        return graph, picture, self._recorded
