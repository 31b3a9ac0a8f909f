# SPDX-License-Identifier: GPL-3.0-or-later
"""Direct light at visible surfaces: resampled light samples and one shadow ray for each pixel."""

from __future__ import annotations

from functools import partial

import warp as wp

from ...kernels import (
    direct_candidates,
    direct_debug,
    direct_shade,
    direct_shadow,
    shadow_layers,
    shadow_lights,
    tracing,
)
from ...kernels.direct_light import DirectLight
from ...kernels.direct_reservoir import DirectOptions, Reservoirs, Shadows
from ...kernels.environment_split import EnvironmentSplit
from ...kernels.gbuffer import GBuffer
from ...kernels.reprojection import Reprojection
from ...kernels.types import Scene
from ..debug_views import DEBUG_VIEWS
from ..frame_graph import FrameGraph
from ..history import History, arrays_of
from ..settings import DirectLightSettings
from ..shadow_rays import launch_queued, make_options, make_queue, make_shadow_rays

__all__ = ["DirectLightPass", "has_lights"]

DEBUG_CHANNELS = {
    "direct.diffuse": direct_debug.SHOW_DIFFUSE,
    "direct.specular": direct_debug.SHOW_SPECULAR,
    "direct.light": direct_debug.SHOW_LIGHT,
    "direct.weight": direct_debug.SHOW_WEIGHT,
    "direct.visibility": direct_debug.SHOW_VISIBILITY,
}


def has_lights(scene: Scene, split: EnvironmentSplit) -> bool:
    """Return whether anything is sampled as a light: lamps, emissive triangles, or an excess of the world's."""
    if split.share > 0.0 or scene.lights.lamp_count > 0:
        return True
    return scene.lights.class_count > 0 and bool(scene.lights.weight.numpy()[0] > 0.0)


class DirectLightPass:
    """Reservoir sampling of lights, shadow rays and shading (Bitterli et al. 2020).

    76 bytes a pixel: two reservoirs of 16, a ray of 28, light of 16. Layers or programs take 61 more, both 93.
    """

    name = "direct light"
    debug_views: dict[str, str] = {name: DEBUG_VIEWS[name] for name in DEBUG_CHANNELS}

    def __init__(self, device: str, settings: DirectLightSettings):
        self.device = device
        self.settings = settings
        self.width = self.height = 0

    def resize(self, width: int, height: int) -> None:
        """Allocate for a picture [px]."""
        self.width, self.height = width, height
        count = width * height
        self.reservoirs = History("direct.reservoirs", self._make_reservoirs)
        self.light = DirectLight()
        self.light.diffuse = wp.zeros(count, dtype=wp.vec4h, device=self.device)
        self.light.specular = wp.zeros(count, dtype=wp.vec4h, device=self.device)
        self._rays_for: tuple[bool, bool] | None = None
        self._make_rays(filtered=False, programs=False)

    def _make_reservoirs(self) -> Reservoirs:
        reservoirs = Reservoirs()
        reservoirs.sample = wp.zeros(self.width * self.height, dtype=wp.vec2ui, device=self.device)
        reservoirs.weight = wp.zeros(self.width * self.height, dtype=wp.vec2, device=self.device)
        return reservoirs

    def _make_rays(self, *, filtered: bool, programs: bool) -> None:
        """Allocate ray states for what the scene needs; they hold nothing from frame to frame."""
        if self._rays_for == (filtered, programs):
            return
        self._rays_for = (filtered, programs)
        count = self.width * self.height
        self.rays = make_shadow_rays(count, self.device, layers=filtered, programs=programs)
        extra = count if filtered or programs else 1
        self.shadows = Shadows()
        self.shadows.visibility = wp.zeros(extra, dtype=wp.vec4h, device=self.device)
        self.shadows.program = wp.zeros(extra, dtype=wp.uint8, device=self.device)
        self.queue = make_queue(extra, self.device)

    def reset(self) -> None:
        """Forget all history."""
        self.reservoirs.reset()

    def record(
        self, graph: FrameGraph, parity: int, scene: Scene, views: wp.array, gbuffer: GBuffer,
        previous_gbuffer: GBuffer, reprojection: Reprojection, split: EnvironmentSplit, *, filtered: bool,
        textured: bool, local_power: float,
    ) -> DirectLight:
        """Add the launches of a frame of one parity; return its light, valid until the next frame.

        Args:
            graph: Receives the launches.
            parity: 0 or 1.
            scene: The scene.
            views: One View.
            gbuffer: Of this frame.
            previous_gbuffer: Of the frame before.
            reprojection: From this frame to the one before.
            split: How the world is split.
            filtered: Whether the scene has triangles that need a test per hit (Structures.has_filtered).
            textured: Whether the emission of any sampled triangle is a program (EmitterTable.textured).
            local_power: Power of all lamps with a place and all emissive triangles [W], as the light tree was given.
        """
        count = self.width * self.height
        self._views = views
        with graph.section("Direct light"):
            if not has_lights(scene, split):
                graph.skip("Direct light", "the scene has no lamps, emitters or sun")
                graph.clear(self.rays.shadow_distance)
                for image in (self.light.diffuse, self.light.specular):
                    # Black samples, not none: a mean without new samples would keep the light of before.
                    graph.call(partial(image.fill_, wp.vec4h(0.0, 0.0, 0.0, 1.0)), "clear")
                for array in arrays_of(self.reservoirs.current(parity)):
                    graph.clear(array)
                return self.light
            programs = textured or split.share > 0.0
            self._make_rays(filtered=filtered, programs=programs)
            options = self._options(local_power)
            now, before = self.reservoirs.current(parity), self.reservoirs.previous(parity)
            graph.launch(
                direct_candidates.resample_lights, count,
                [views, scene, split, options, gbuffer, previous_gbuffer, reprojection, before], [now])
            graph.launch(
                direct_candidates.aim_shadow_rays, count, [views, scene, split, options, gbuffer, now],
                [self.rays, self.shadows])
        with graph.section("Direct shadows"):
            graph.launch(direct_shadow.trace_direct_shadows, count, [scene], [self.rays])
            shadows = [scene, make_options(filtered=filtered), 0]
            if filtered:
                launch_queued(graph, tracing.trace_shadow_layers, shadows, self.queue, self.rays)
                launch_queued(graph, shadow_layers.weaken_shadow_rays, shadows, self.queue, self.rays)
            if filtered or programs:
                graph.launch(direct_shadow.finish_shadows, count, [], [self.rays, self.shadows])
            if programs:
                launch_queued(graph, shadow_lights.shade_lights, shadows, self.queue, self.rays)
        with graph.section("Direct light"):
            graph.launch(
                direct_shade.shade_direct, count,
                [views, scene, split, options, gbuffer, now, self.rays, self.shadows], [self.light])
        return self.light

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Add the launch that draws one of `debug_views` of the frame recorded last into `picture`, vec4 a pixel."""
        graph.launch(
            direct_debug.show_direct, self.width * self.height,
            [self._views, self._options(0.0), int(DEBUG_CHANNELS[name]), self.reservoirs.current(parity), self.rays,
             self.shadows, self.light], [picture])

    def _options(self, local_power: float) -> DirectOptions:
        options = DirectOptions()
        options.width, options.height = self.width, self.height
        options.candidates = self.settings.candidates
        options.reuse = self.settings.temporal_reuse
        options.half_rate = int(self.settings.half_rate)
        options.full = int(any(self._rays_for))
        options.local_power = local_power
        return options
