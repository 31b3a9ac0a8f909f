# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes of real-time frames, and which of them a frame needs: the others have no buffers and no launches."""

from __future__ import annotations

from typing import Any

from ..kernels.direct_light import DirectLight
from ..kernels.environment_split import EnvironmentSplit
from ..kernels.fog import Fog
from ..kernels.reflection_types import LOBE_DIFFUSE, LOBE_REFLECTION, LOBE_TRANSMISSION
from .device import device_errors
from .device_scene import DeviceScene
from .frame_graph import FrameGraph
from .passes.composite import CompositePass
from .passes.depth_of_field import DepthOfFieldPass
from .passes.diffuse_denoise import DiffuseDenoisePass
from .passes.direct_denoise import DirectDenoisePass
from .passes.direct_light import DirectLightPass, has_lights, no_light
from .passes.fog import FogPass
from .passes.gbuffer import GBufferPass
from .passes.hair import HairPass, scatters_in_hair
from .passes.radiance_cache import RadianceCachePass
from .passes.ray_scene import scatters_below
from .passes.reflection_denoise import ReflectionDenoisePass
from .passes.reflections import STRIDES, ReflectionPass, gather_settings
from .passes.rest_gather import RestGatherPass
from .passes.screen_probes import ScreenProbePass
from .settings import RenderSettings

__all__ = ["FramePasses"]


class FramePasses:
    """All passes; those that some frame so far needed have their buffers."""

    def __init__(self, device: str):
        self.device = device
        self.passes: tuple = ()
        self._ready: list = []
        """Passes that have their buffers"""
        self._recorded: list = []
        """Passes in the frames recorded last"""
        self._settings: RenderSettings | None = None

    def _make_passes(self, settings: RenderSettings, width: int, height: int, light_passes: bool) -> None:
        """Make the passes for settings and a size [px], without buffers."""
        self._settings = settings
        device = self.device
        self.gbuffer = GBufferPass(device)
        self.cache = RadianceCachePass(device, settings.cache, deterministic=settings.performance.deterministic)
        self.probes = ScreenProbePass(device, settings.probes)
        self.direct = DirectLightPass(device, settings.direct_light, settings.reflections)
        self.reflections = ReflectionPass(device, settings.reflections, int(LOBE_REFLECTION))
        self.refraction = ReflectionPass(device, settings.reflections, int(LOBE_TRANSMISSION))
        self.gather = ReflectionPass(
            device, gather_settings(settings), int(LOBE_DIFFUSE), highlights=settings.cache.highlights)
        self.hair = HairPass(device, settings.reflections)
        self.rest_gather = RestGatherPass(device)
        self.reflection_denoise = ReflectionDenoisePass(device, settings.denoiser, int(LOBE_REFLECTION))
        self.refraction_denoise = ReflectionDenoisePass(device, settings.denoiser, int(LOBE_TRANSMISSION))
        self._filters = {self.reflections: self.reflection_denoise, self.refraction: self.refraction_denoise}
        self.direct_denoise = DirectDenoisePass(device, settings.denoiser)
        self.diffuse_denoise = DiffuseDenoisePass(device, settings.denoiser)
        self.composite = CompositePass(device, settings.denoiser, light_passes)
        self.fog, self.depth_of_field = FogPass(device), DepthOfFieldPass(device)
        self.passes = (self.gbuffer, self.cache, self.probes, self.direct, self.direct_denoise, self.diffuse_denoise,
                       self.reflections, self.refraction, self.gather, self.rest_gather, self.composite, self.fog)
        self.passes += (self.hair, self.reflection_denoise, self.refraction_denoise, self.depth_of_field)
        self._size, self._ready, self._recorded = (width, height), [], []
        self._black: DirectLight | None = None

    def reset(self) -> None:
        """Forget all history."""
        for each in self._ready:
            each.reset()

    def _prepare(self, *passes: Any) -> None:
        """Note that a frame needs passes; those that never were needed so far get their buffers."""
        self._recorded += passes
        for each in passes:
            if each in self._ready:
                continue
            filters = isinstance(each, ReflectionDenoisePass)
            stride = (STRIDES[self._settings.reflections.resolution],) if filters else ()
            with device_errors("a picture of {} x {} pixels".format(*self._size)):
                each.resize(*self._size, *stride)
            self._ready.append(each)

    def _leave_out(self, graph: FrameGraph, name: str, reason: str, *passes: Any) -> None:
        """Note that a frame does without passes; what they know is too old once they come back."""
        graph.skip(name, reason)
        for each in passes:
            if each in self._ready:
                each.reset()

    def _reflecting(self, graph: FrameGraph, scene: DeviceScene) -> list[ReflectionPass]:
        """Return the passes of reflection and of light from behind that the scene needs."""
        reflectors = scene.material_table.reflectors
        needed = []
        if reflectors.sharpest < self._settings.reflections.roughness_diffuse:
            needed.append(self.reflections)
            self._prepare(self.reflections, self.reflection_denoise)
        else:
            self._leave_out(graph, "reflections", "nothing reflects sharply", self.reflections, self.reflection_denoise)
        if reflectors.refracts or reflectors.scatters or scatters_below(scene, self._settings.reflections):
            needed.append(self.refraction)
            self._prepare(self.refraction, self.refraction_denoise)
        else:
            self._leave_out(
                graph, "refraction", "nothing lets light through or scatters it below its surface", self.refraction,
                self.refraction_denoise)
        if scatters_in_hair(scene, self._settings.reflections):
            self._prepare(self.hair)
        else:
            self._leave_out(graph, "hair", "there is none that scatters light", self.hair)
        return needed

    def _gathering(self, graph: FrameGraph, resting: bool) -> list[ReflectionPass]:
        """Return the pass of the final gather where a frame has it."""
        if resting:
            self._prepare(self.gather, self.rest_gather)
            return [self.gather]
        # It keeps what it has gathered: frames without it are few, and it knows how old things are.
        graph.skip("final gather", "something moves" if self._settings.denoiser.rest_gather else "switched off")
        return []

    def _needs_direct(self, graph: FrameGraph, scene: DeviceScene, split: EnvironmentSplit) -> bool:
        """Return whether anything is sampled as a light; black stands for direct light where nothing is."""
        if has_lights(scene.scene, split):
            self._prepare(self.direct, self.direct_denoise)
            return True
        self._leave_out(graph, "direct light", "there are no lamps, emitters or sun", self.direct, self.direct_denoise)
        self._black = self._black or no_light(self._size[0] * self._size[1], self.device)
        return False

    def _needs_fog(self, graph: FrameGraph, parity: int, scene: DeviceScene) -> Fog | None:
        """Return the fog that a frame has to draw; None without."""
        data = scene.media and scene.media.fog
        self.probes.make_room(data.cells if data is not None else 0)
        if data is None:
            self._leave_out(graph, "fog", "there is none", self.fog)
            return None
        self._prepare(self.fog)
        return self.fog.fog_of(data, self.probes.rays_a_frame - data.cells, parity)
