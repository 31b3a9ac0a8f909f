# SPDX-License-Identifier: GPL-3.0-or-later
"""One real-time frame, top to bottom: the table of contents of the method.

GI-1.0 (Boissé et al. 2023) with its energy mended: screen probes gather diffuse light over a hash-grid radiance cache,
lamps light the visible surfaces by resampled importance sampling, and what both leave noisy is filtered in time and
space. The frame is recorded once for even and once for odd frames (their histories swap) and replayed; it is recorded
anew when settings or the scene's arrays change, not when the camera or objects move.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import warp as wp

from ..kernels.direct_light import DirectLight
from ..kernels.fog import Fog
from ..kernels.gbuffer import GBuffer
from ..kernels.motion import Motion
from ..kernels.reflection_chain import MIRROR_ROUGHNESS
from ..kernels.reflection_sources import DISTANCE_ROUGHNESS
from ..kernels.reprojection import Reprojection
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


@dataclass
class Recording:
    """A frame that is being recorded: what its steps have in common, and what each leaves for those after it."""

    graph: FrameGraph
    parity: int
    resting: bool
    """Whether pixels gather indirect light themselves"""
    phase: LightPhase
    scene: DeviceScene
    kernels_scene: Scene
    """From light_scene"""
    views: wp.array
    motion: Motion
    fog: Fog | None = None
    lit: bool = False
    """Whether anything is sampled as a light"""
    below: bool = False
    """Whether light is scattered below surfaces"""
    surfaces: GBuffer | None = None
    before: GBuffer | None = None
    """The surfaces of the frame before"""
    reprojection: Reprojection | None = None
    traced: list[ReflectionPass] = field(default_factory=list)
    """Reflection, refraction"""
    gathering: list[ReflectionPass] = field(default_factory=list)
    """The final gather"""
    branches: tuple[str, ...] = ()
    """Those of all rays beside the probes'"""
    direct: DirectLight | None = None


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
        self._recorded_for: tuple | None = None
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
        self._graphs, self._recorded_for = {}, None

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
        """Return what the last frame counted; nothing before the first. Waits for the device."""
        if not self._ready:
            return {}
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

    def _record(
        self, parity: int, resting: bool, phase: LightPhase, unseen: bool, scene: DeviceScene, views: wp.array,
        motion: Motion,
    ) -> tuple[FrameGraph, wp.array | None, list]:
        """Record a frame: the method in its order.

        With `resting` pixels gather indirect light themselves; an `unseen` frame ends with the radiance cache.
        """
        self._recorded = []
        self._prepare(self.gbuffer, self.cache, self.probes)
        graph, kernels_scene = FrameGraph(self.device), light_scene(scene.scene, self._settings.direct_light)
        frame = Recording(graph, parity, resting, phase, scene, kernels_scene, views, motion)
        cells = self._record_start(frame, unseen)
        self._record_surfaces(frame)
        if unseen:
            graph.join(PREPARATION)
        else:
            self._record_beside(frame, cells["minimum_cell"])
        self._record_cells(frame, cells)
        if unseen:
            return graph, None, self._recorded
        shown, indirect, gathered = self._record_samples(frame)
        picture = self._record_composite(frame, shown, indirect, gathered)
        if self._blurred:
            self._prepare(self.depth_of_field)
            with graph.section("Depth of field"):
                picture = self.depth_of_field.record(
                    graph, views, frame.surfaces.depth, *self.composite.newest(parity))
        else:
            graph.skip("depth of field", "all is in focus, or it is switched off")
        return graph, picture if self._debug is None else self._record_debug(graph, parity), self._recorded

    def _record_start(self, frame: Recording, unseen: bool) -> dict[str, Any]:
        """Record what needs no surfaces, beside the primary rays; return what the cache's steps are told of the scene.

        Branches run side by side: later direct light and each kind of reflection ray beside the probes, whose chain of
        short kernels is the longest and goes first.
        """
        graph, scene, kernels_scene = frame.graph, frame.scene, frame.kernels_scene
        frame.fog = self._needs_fog(graph, frame.parity, scene)
        frame.lit = not (unseen and frame.fog is None) and self._needs_direct(graph, scene, self.split)
        with graph.branch(PREPARATION):
            self.cache.record_start(graph, frame.views, frame.phase)
            if frame.lit:
                self.direct.record_emitters(graph, kernels_scene, scene.local_power)
        self.cache.grid.homes = scene.homes.struct(scene.instances)
        if self._settings.cache.follow_shadows:
            self.cache.grid.ways = self.motion.ways.array
        lean = scene.material_table.lean
        cells = {
            "minimum_cell": smallest_cell(self._settings.cache, scene.radius), "threshold": self.split.threshold,
            "programs": scene.has_hit_programs, "fog": frame.fog,
            "filtered": scene.structures.has_filtered or passes_glass(kernels_scene),
            "polished": scene.material_table.reflectors.polished, "all_lean": lean.flat,
            "glossy": scene.material_table.reflectors.glossy,
            "lean_layers": lean.transparency, "world": scene.world_texels}
        self.cache.record_pending(
            graph, kernels_scene, frame.views, frame.phase, self.probes.rays_a_frame, after=PREPARATION, **cells)
        return cells

    def _record_surfaces(self, frame: Recording) -> None:
        """Record what pixels show."""
        scene, lean = frame.scene, frame.scene.material_table.lean
        frame.below = scatters_below(scene, self._settings.reflections)
        frame.surfaces = self.gbuffer.record(
            frame.graph, frame.parity, frame.kernels_scene, scene.structures, frame.views,
            filtered=scene.structures.has_filtered, all_lean=lean.surface, lean_layers=lean.transparency,
            shining=shines_plainly(frame.kernels_scene, scene.emitters), exact=lean.exact, scattering=frame.below)
        frame.before, frame.reprojection = self.gbuffer.previous(frame.parity), self.gbuffer.reprojection

    def _record_beside(self, frame: Recording, smallest: float) -> None:
        """Record what goes on beside the probes: rays of reflections, of hair and of pixels at rest, and direct light.

        `smallest`: smallest cell of the radiance cache [m].
        """
        graph, parity, views, surfaces = frame.graph, frame.parity, frame.views, frame.surfaces
        self._prepare(self.diffuse_denoise, self.composite)
        with graph.branch(REPROJECTION):
            self.gbuffer.record_reprojection(graph, parity, frame.kernels_scene, views, frame.motion)
        graph.join(PREPARATION)
        matte = self.composite.matte.previous(parity)
        frame.traced, frame.gathering = self._reflecting(graph, frame.scene), self._gathering(graph, frame.resting)
        what = self._ray_scene(frame)
        note_absent(graph, frame.scene, what)
        for each in frame.traced + frame.gathering:
            with graph.branch(each.name):
                each.record_rays(
                    graph, parity, views, surfaces, frame.before, matte, what, self.cache.cells(smallest),
                    after=frame.branches,
                    known=self._filters[each].known(parity) if each in frame.traced else None)
            frame.branches += (each.name,)
        if self.hair in self._recorded:
            with graph.branch(self.hair.name):
                self.hair.record(
                    graph, parity, views, surfaces, frame.before, matte, what, self.cache.cells(smallest),
                    self.direct.emitters if frame.lit else None, after=frame.branches)
            frame.branches += (self.hair.name,)
        with graph.branch(DIRECT):
            frame.direct = self._black if not frame.lit else self._record_direct(frame)

    def _ray_scene(self, frame: Recording) -> RayScene:
        """Return what rays of reflections meet."""
        scene, lean, reflectors = frame.scene, frame.scene.material_table.lean, frame.scene.material_table.reflectors
        return RayScene(
            frame.kernels_scene, self.split, frame.motion, scene.world_texels, scene.structures.has_filtered,
            scene.has_hit_programs, lean.plain, lean.transparency, lean.lean_strands,
            reflectors.refracts or reflectors.sharpest < MIRROR_ROUGHNESS, reflectors.scatters, frame.below,
            self.cache.deterministic, self.cache.is_settled(frame.phase), reflectors.glossy,
            scene.media and scene.media.frames, frame.fog)

    def _record_direct(self, frame: Recording) -> DirectLight:
        """Record direct light and its filter."""
        graph, parity, scene = frame.graph, frame.parity, frame.scene
        graph.join(REPROJECTION)
        direct = self.direct.record(
            graph, parity, frame.kernels_scene, frame.views, frame.surfaces, frame.before, frame.reprojection,
            self.split, filtered=scene.structures.has_filtered, textured=scene.emitters.textured,
            local_power=scene.local_power, lean_layers=scene.material_table.lean.transparency,
            shaped=scene.material_table.reflectors.shaped, fog=frame.fog,
            history=self.direct_denoise.history.previous(parity))
        with graph.section("Direct denoising"):
            # A sun's shadows have narrow edges and no noise beside them: blurred they would be wider.
            return self.direct_denoise.record(
                graph, parity, frame.views, frame.surfaces, frame.before, frame.reprojection, direct,
                noisy=frame.phase is LightPhase.SWEEPING and scene.local_power > 0.0,
                changing=frame.resting or frame.phase is not LightPhase.SETTLED)

    def _record_cells(self, frame: Recording, cells: dict[str, Any]) -> None:
        """Record the probes' rays, which the radiance cache answers, and the fog's; `cells`: from _record_start."""
        graph, parity, views, kernels_scene, fog = (
            frame.graph, frame.parity, frame.views, frame.kernels_scene, frame.fog)
        rays, count = self.probes.record_rays(graph, kernels_scene, views, frame.surfaces)
        if fog is not None:
            self.fog.record_samples(
                graph, parity, kernels_scene, views, frame.surfaces, fog, self.split,
                self.direct.emitters if frame.lit else None, rays, filtered=frame.scene.structures.has_filtered,
                textured=frame.scene.emitters.textured, lean_layers=frame.scene.material_table.lean.transparency)
        self.cache.record(
            graph, parity, kernels_scene, views, rays, count, gbuffer=frame.surfaces, started=True,
            after=frame.branches, phase=frame.phase, **cells)
        if fog is not None:
            self.fog.record_light(graph, parity, kernels_scene, fog, self.cache.rays.ways, frame.phase)

    def _record_samples(
        self, frame: Recording,
    ) -> tuple[dict[ReflectionPass, wp.array], wp.array, wp.array | None]:
        """Record what the rays have brought; return means of reflections, and indirect light from probes and pixels."""
        graph, parity, views, surfaces = frame.graph, frame.parity, frame.views, frame.surfaces
        graph.join(REPROJECTION, LAMPS)
        shown = {}
        for each in frame.traced:
            with graph.branch(each.name):
                each.record_samples(graph, views, self.cache.grid)
                if not (each.asks_probes or frame.below):
                    shown[each] = self._record_filter(frame, each)
        if self.hair in self._recorded:
            with graph.branch(self.hair.name):
                self.hair.record_means(graph, parity, views, surfaces, frame.reprojection, self.cache.grid)
        indirect = self.probes.record_light(
            graph, views, surfaces, self.composite.color.previous(parity), frame.reprojection, parity,
            self.diffuse_denoise.history.previous(parity), self.cache.rays.mirrors.struct.state,
            self.cache.grid.ways)
        for each in frame.traced:
            if each.asks_probes:
                with graph.branch(each.name):
                    each.record_look_ups(graph, views, surfaces, self.probes)
                    shown[each] = self._record_filter(frame, each)
        with graph.section("Diffuse denoising"):
            indirect = self.diffuse_denoise.record(
                graph, parity, views, surfaces, frame.before, frame.reprojection, indirect)
        gathered = None
        for each in frame.gathering:
            graph.join(each.name)
            each.record_samples(graph, views, self.cache.grid)
            with graph.section(f"{each.title} denoising"):
                gathered = self.rest_gather.record(
                    graph, parity, views, surfaces, frame.before, frame.reprojection, each.options, each.samples,
                    indirect)
        graph.join(DIRECT, *frame.branches)
        graph.join(FOG)
        if frame.below:
            self.refraction.record_seen_light(
                graph, parity, self.composite.lights(frame.direct, indirect, gathered))
            shown[self.refraction] = self._record_filter(frame, self.refraction)
        return shown, indirect, gathered

    def _record_filter(self, frame: Recording, traced: ReflectionPass) -> wp.array:
        """Record denoising the samples of reflections or refraction; return their mean."""
        with frame.graph.section(f"{traced.title} denoising"):
            return self._filters[traced].record(
                frame.graph, frame.parity, frame.views, frame.surfaces, frame.before, frame.reprojection,
                traced.options, traced.samples, jitter=self._settings.reflections.jitter)

    def _record_composite(
        self, frame: Recording, shown: dict[ReflectionPass, wp.array], indirect: wp.array, gathered: wp.array | None,
    ) -> wp.array:
        """Record putting all light together; arguments from _record_samples."""
        graph, surfaces, fog = frame.graph, frame.surfaces, frame.fog
        sharpest, filtered = frame.scene.material_table.reflectors.sharpest, frame.scene.structures.has_filtered
        mirrors = None
        if self.reflections in frame.traced and sharpest < DISTANCE_ROUGHNESS:
            mirrors = self.reflection_denoise.mirrors(frame.parity, surfaces)
        hair = self.hair in self._recorded
        with graph.section("Composite"):
            return self.composite.record(
                graph, frame.parity, frame.views, surfaces, frame.reprojection, frame.direct, indirect,
                self.probes.specular_ratio, shown.get(self.reflections), shown.get(self.refraction),
                self.reflections.options if self.reflections in frame.traced else None, gathered, mirrors,
                keeping_matte=bool(frame.traced), over=None if not hair else lambda color: self.hair.record_picture(
                    graph, surfaces, self.gbuffer.hits.weight if filtered else None, color),
                veil=None if fog is None else lambda color: self.fog.record_picture(graph, frame.parity, color))

    def _record_debug(self, graph: FrameGraph, parity: int) -> wp.array:
        """Record drawing the debug view that was chosen; return it."""
        owner, name = self._debug
        with graph.section("Debug view"):
            graph.clear(self._debug_picture)
            if owner in self._recorded:
                owner.record_debug(graph, parity, name, self._debug_picture)
        return self._debug_picture
