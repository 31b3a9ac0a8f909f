# SPDX-License-Identifier: GPL-3.0-or-later
"""One real-time frame, top to bottom: the table of contents of the method.

GI-1.0 (Boissé et al. 2023) with its energy mended: screen probes gather diffuse light over a hash-grid radiance cache,
lamps light the visible surfaces by resampled importance sampling, and what both leave noisy is filtered in time and
space. The frame is recorded once for even and once for odd frames (their histories swap) and replayed; it is recorded
anew when settings or the scene's arrays change, not when the camera or objects move.
"""

from __future__ import annotations

import warp as wp

from ..kernels.motion import Motion
from ..kernels.reflection_chain import MIRROR_ROUGHNESS
from ..kernels.reflection_types import LOBE_DIFFUSE, LOBE_REFLECTION, LOBE_TRANSMISSION
from .device_scene import DeviceScene
from .environment_split import split_environment
from .frame_graph import FrameGraph
from .motion import MotionTracker
from .passes.composite import CompositePass
from .passes.diffuse_denoise import DiffuseDenoisePass
from .passes.direct_denoise import DirectDenoisePass
from .passes.direct_light import DirectLightPass
from .passes.gbuffer import GBufferPass
from .passes.radiance_cache import RadianceCachePass, smallest_cell
from .passes.reflection_denoise import ReflectionDenoisePass
from .passes.reflections import RayScene, ReflectionPass
from .passes.rest_gather import RestGatherPass
from .passes.screen_probes import ScreenProbePass
from .settings import RenderSettings
from .view_data import ViewTracker

__all__ = ["Pipeline"]


class Pipeline:
    """The passes of a frame, their order and their recorded launches."""

    def __init__(self, device: str):
        self.device = device
        self.times: dict[str, float] = {}
        """Milliseconds of each section of the last timed frame"""
        self.kernel_times: dict[str, float] = {}
        """The same by kernel"""
        self.skipped: dict[str, str] = {}
        """Sections that the scene does not need, with the reason"""
        self.passes: tuple = ()
        self._settings: RenderSettings | None = None
        self._graphs: dict[tuple[int, bool], tuple[FrameGraph, wp.array]] = {}
        self._recorded_for = b""
        self._picture: wp.array | None = None
        self._split_for = None
        self._debug: tuple | None = None

    def configure(self, settings: RenderSettings, width: int, height: int, light_passes: bool) -> None:
        """Make the passes for settings and a size [px]."""
        self._settings = settings
        device = self.device
        self.gbuffer = GBufferPass(device)
        self.cache = RadianceCachePass(device, settings.cache)
        self.probes = ScreenProbePass(device, settings.probes)
        self.direct = DirectLightPass(device, settings.direct_light, settings.reflections)
        self.reflections = ReflectionPass(device, settings.reflections, int(LOBE_REFLECTION))
        self.refraction = ReflectionPass(device, settings.reflections, int(LOBE_TRANSMISSION))
        self.gather = ReflectionPass(device, settings.reflections, int(LOBE_DIFFUSE))
        self.rest_gather = RestGatherPass(device)
        self.reflection_denoise = ReflectionDenoisePass(device, settings.denoiser, int(LOBE_REFLECTION))
        self.refraction_denoise = ReflectionDenoisePass(device, settings.denoiser, int(LOBE_TRANSMISSION))
        self.direct_denoise = DirectDenoisePass(device, settings.denoiser)
        self.diffuse_denoise = DiffuseDenoisePass(device, settings.denoiser)
        self.composite = CompositePass(device, settings.denoiser, light_passes)
        self.passes = (self.gbuffer, self.cache, self.probes, self.direct, self.direct_denoise, self.diffuse_denoise,
                       self.reflections, self.refraction, self.gather, self.rest_gather, self.composite)
        for each in self.passes:
            each.resize(width, height)
        filters = (self.reflection_denoise, self.refraction_denoise)
        for each in filters:
            each.resize(width, height, self.reflections.options.stride)
        self.passes += filters
        self._debug_picture = wp.zeros(width * height, dtype=wp.vec4, device=device)
        self.motion = MotionTracker(device)
        self.show(settings.debug.view)

    def show(self, name: str) -> None:
        """Draw an intermediate result of the frames to come (a name in debug_views.py) instead of the picture."""
        owner = next((each for each in self.passes if name in each.debug_views), None)
        self._debug = (owner, name) if owner is not None else None
        self._forget_records()

    def reset(self) -> None:
        """Forget all history."""
        for each in self.passes:
            each.reset()

    def _forget_records(self) -> None:
        self._graphs, self._recorded_for = {}, b""

    def frame(self, scene: DeviceScene, views: ViewTracker, timed: bool = False) -> None:
        """Render the frame that `views` has advanced to; its result is `picture`.

        Args:
            scene: The scene; its arrays are read while the frame runs.
            views: Camera and counters.
            timed: Whether to measure every section, which waits for each.
        """
        motion = self.motion.advance(scene)
        self._update_split(scene)
        recorded_for = self._fingerprint(scene, motion)
        if recorded_for != self._recorded_for:
            self._graphs, self._recorded_for = {}, recorded_for
        # What only frames at rest need costs the others nothing: they are records of their own.
        key = views.parity, self._settings.denoiser.rest_gather and views.rest > 0
        if key not in self._graphs:
            self._graphs[key] = self._record(*key, scene, views.array, motion)
        graph, self._picture = self._graphs[key]
        graph.replay(timed)
        self.times, self.skipped = graph.times or self.times, graph.skipped
        self.kernel_times = graph.kernel_times

    @property
    def picture(self) -> wp.array:
        """Return the newest picture, or the debug view chosen: vec4 [h * w], as the film shows it."""
        return self._picture

    def light_pass(self, name: str) -> wp.array:
        """Return a light pass, the mean of the frames at rest: vec3 [h * w]."""
        return self.composite.read_light_pass(name)

    def counts(self) -> dict[str, int]:
        """Return what the last frame counted. Waits for the device."""
        pixels = self.gbuffer.width * self.gbuffer.height
        counts = {"primary rays": pixels, "direct shadow rays": pixels}
        counts |= {f"probes {name}": value for name, value in self.probes.stats().items()}
        counts |= {f"cache {name}": value for name, value in self.cache.stats().items()}
        return counts | self.reflections.stats() | self.refraction.stats() | self.gather.stats()

    def _update_split(self, scene: DeviceScene) -> None:
        """Split the world's light anew where the world has changed."""
        if self._split_for is not scene.environment:
            self.split = split_environment(scene.scene, self.device)
            self._split_for = scene.environment

    def _fingerprint(self, scene: DeviceScene, motion: Motion) -> bytes:
        """Return everything that a record freezes besides settings: addresses and numbers in the by-value structs."""
        facts = (scene.structures.has_filtered, scene.has_hit_programs, scene.world_texels.ptr,
                 scene.emitters.textured, scene.local_power, scene.radius, self.split.share,
                 scene.material_table.lean, scene.material_table.reflectors)
        structs = (scene.scene, motion, self.split)
        return b"".join(bytes(struct._ctype) for struct in structs) + repr(facts).encode()

    def _reflecting(self, graph: FrameGraph, scene: DeviceScene) -> list[ReflectionPass]:
        """Return the passes of reflection and refraction that the scene needs."""
        reflectors = scene.material_table.reflectors
        needed = []
        if reflectors.sharpest < self._settings.reflections.roughness_diffuse:
            needed.append(self.reflections)
        else:
            graph.skip("reflections", "nothing reflects sharply")
        if reflectors.refracts:
            needed.append(self.refraction)
        else:
            graph.skip("refraction", "nothing refracts")
        return needed

    def _record(
        self, parity: int, resting: bool, scene: DeviceScene, views: wp.array, motion: Motion,
    ) -> tuple[FrameGraph, wp.array]:
        """Record a frame: the method in its order. With `resting` pixels gather indirect light themselves."""
        graph, kernels_scene = FrameGraph(self.device), scene.scene
        filtered, programs = scene.structures.has_filtered, scene.has_hit_programs
        lean = scene.material_table.lean
        surfaces = self.gbuffer.record(
            graph, parity, kernels_scene, views, motion, filtered=filtered, all_lean=lean.surface,
            lean_layers=lean.transparency)
        before, reprojection = self.gbuffer.previous(parity), self.gbuffer.reprojection
        rays, count = self.probes.record_rays(graph, parity, kernels_scene, views, surfaces)
        smallest = smallest_cell(self._settings.cache, scene.radius)
        color = self.composite.color.previous(parity)
        traced = self._reflecting(graph, scene)
        gathering = [self.gather] if resting else []
        what = RayScene(
            kernels_scene, self.split, motion, scene.world_texels, filtered, programs, lean.surface, lean.transparency,
            scene.material_table.reflectors.refracts or scene.material_table.reflectors.sharpest < MIRROR_ROUGHNESS)
        for each in traced + gathering:
            each.record_rays(graph, parity, views, surfaces, before, color, what, self.cache.cells(smallest))
        self.cache.record(
            graph, parity, kernels_scene, views, rays, count, minimum_cell=smallest, threshold=self.split.threshold,
            filtered=filtered, programs=programs, gbuffer=surfaces, all_lean=lean.flat, lean_layers=lean.transparency,
            world=scene.world_texels)
        indirect = self.probes.record_light(
            graph, parity, kernels_scene, views, surfaces, color, reprojection)
        filters = {self.reflections: self.reflection_denoise, self.refraction: self.refraction_denoise}
        shown = {}
        for each in traced:
            samples = each.record_samples(graph, views, surfaces, self.cache.grid, self.probes)
            with graph.section(f"{each.title} denoising"):
                shown[each] = filters[each].record(
                    graph, parity, kernels_scene, views, surfaces, before, reprojection, each.options, samples,
                    jitter=self._settings.reflections.jitter)
        direct = self.direct.record(
            graph, parity, kernels_scene, views, surfaces, before, reprojection, self.split, filtered=filtered,
            textured=scene.emitters.textured, local_power=scene.local_power, lean_layers=lean.transparency)
        with graph.section("Direct denoising"):
            direct = self.direct_denoise.record(graph, parity, views, surfaces, before, reprojection, direct)
        with graph.section("Diffuse denoising"):
            indirect = self.diffuse_denoise.record(graph, parity, views, surfaces, before, reprojection, indirect)
        gathered = None
        for each in gathering:
            samples = each.record_samples(graph, views, surfaces, self.cache.grid, self.probes)
            with graph.section(f"{each.title} denoising"):
                gathered = self.rest_gather.record(
                    graph, parity, views, surfaces, before, reprojection, each.options, samples, indirect)
        with graph.section("Composite"):
            picture = self.composite.record(
                graph, parity, kernels_scene, views, surfaces, reprojection, direct, indirect,
                self.probes.specular_ratio, shown.get(self.reflections), shown.get(self.refraction),
                self.reflections.options, gathered)
        if self._debug is not None:
            owner, name = self._debug
            with graph.section("Debug view"):
                graph.clear(self._debug_picture)
                if owner not in (self.reflections, self.reflection_denoise) or self.reflections in traced:
                    owner.record_debug(graph, parity, name, self._debug_picture)
            picture = self._debug_picture
        return graph, picture
