# SPDX-License-Identifier: GPL-3.0-or-later
"""Direct light at visible surfaces: resampled light samples and one shadow ray for each pixel."""

from __future__ import annotations

from functools import partial

import warp as wp

from ...kernels import (
    direct_candidates,
    direct_debug,
    direct_emitters,
    direct_shade,
    direct_shadow,
    direct_shapes,
    fog_rays,
    shadow_lights,
)
from ...kernels.direct_emitters import EMITTER_WORDS
from ...kernels.direct_light import DirectLight, PackedLight
from ...kernels.direct_reservoir import DirectOptions, Reservoirs, slots_of_color
from ...kernels.direct_temporal import DirectHistory
from ...kernels.environment_split import EnvironmentSplit
from ...kernels.fog import Fog
from ...kernels.gbuffer import GBuffer
from ...kernels.reprojection import Reprojection
from ...kernels.types import Scene
from ..clear_glass import passes_glass
from ..debug_views import DEBUG_VIEWS
from ..frame_graph import FrameGraph
from ..history import History, arrays_of
from ..ray_budget import HALF_RATE_PIXELS
from ..settings import DirectLightSettings, ReflectionSettings
from ..shadow_rays import make_options, make_shadow_rays
from ..work_list import make_queue, make_work_list, one_number
from .layer_rays import record_shadows
from .ray_scene import reflection_options

__all__ = ["DirectLightPass", "has_lights", "no_light"]

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


def no_light(count: int, device: str) -> DirectLight:
    """Return black for a number of pixels, which stands for direct light where nothing is sampled as a light."""
    black = DirectLight()
    for name in ("diffuse", "specular"):
        setattr(black, name, wp.full(count, wp.vec4h(0.0, 0.0, 0.0, 1.0), dtype=wp.vec4h, device=device))
    return black


def slots_of(width: int, height: int) -> int:
    """Return how many slots a picture has [px]: both colours of all tiles, whole ones at the border too."""
    options = DirectOptions()
    options.width, options.height = width, height
    return 2 * slots_of_color(options)


def light_count(scene: Scene, split: EnvironmentSplit, local_power: float) -> int:
    """Return how many lights there are to choose from; the world's excess counts as two: it has an extent."""
    lights = scene.lights
    local = lights.tree.places.shape[0] if local_power > 0.0 else 0
    return local + lights.lamp_count - lights.local_lamp_count + (2 if split.share > 0.0 else 0)


class DirectLightPass:
    """Reservoir sampling of lights, shadow rays and shading (Bitterli et al. 2020).

    80 bytes a pixel: two reservoirs of 16, a ray of 28, a weight of 4, light of 16. Layers or programs take 48 more,
    layers 24 besides, programs 8. Kernels run over slots: the pixels of one colour of a checkerboard after those of
    the other (direct_reservoir.pixel_of_slot).
    """

    name = "direct light"
    debug_views: dict[str, str] = {name: DEBUG_VIEWS[name] for name in DEBUG_CHANNELS}

    def __init__(self, device: str, settings: DirectLightSettings, reflections: ReflectionSettings | None = None):
        """Make the pass.

        Args:
            device: Where it runs.
            settings: Its settings.
            reflections: Which reflections are traced: their rays show a share of the lights, direct light has the
                rest. None: there are no such rays.
        """
        self.device = device
        self.settings = settings
        self.reflections = reflections
        self.half_rate_pixels = HALF_RATE_PIXELS
        self.width = self.height = 0

    def resize(self, width: int, height: int) -> None:
        """Allocate for a picture [px]."""
        self.width, self.height = width, height
        count = width * height
        self.slots = slots_of(width, height)
        self.reservoirs = History("direct.reservoirs", self._make_reservoirs)
        self.lent = wp.zeros(count, dtype=float, device=self.device)
        self.light = DirectLight()
        self.light.diffuse = wp.zeros(count, dtype=wp.vec4h, device=self.device)
        self.light.specular = wp.zeros(count, dtype=wp.vec4h, device=self.device)
        self._packed = PackedLight()
        self._packed.diffuse = self.light.diffuse.view(wp.uint64)
        self._packed.specular = self.light.specular.view(wp.uint64)
        self._emitters = wp.zeros(int(EMITTER_WORDS), dtype=wp.uint64, device=self.device)
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
        self.rays = make_shadow_rays(self.slots, self.device, layers=filtered, programs=programs)
        self.queue = make_queue(self.slots if filtered or programs else 1, self.device)
        self.layered = make_work_list(self.slots if filtered else 1, self.device)

    @property
    def emitters(self) -> wp.array:
        """Return the packed emissive triangles (record_emitters)."""
        return self._emitters

    def reset(self) -> None:
        """Forget all history."""
        self.reservoirs.reset()

    def record_emitters(self, graph: FrameGraph, scene: Scene, local_power: float) -> None:
        """Add the launch that packs emissive triangles for `record`, which it comes before; arguments as there."""
        emitters = scene.lights.tree.places.shape[0] - scene.lights.local_lamp_count if local_power > 0.0 else 0
        if self._emitters.shape[0] != max(emitters, 1) * int(EMITTER_WORDS):
            self._emitters = wp.zeros(max(emitters, 1) * int(EMITTER_WORDS), dtype=wp.uint64, device=self.device)
        if emitters > 0:
            with graph.section("Direct light"):
                graph.launch(direct_emitters.bake_emitters, emitters, [scene, local_power], [self._emitters])

    def record(
        self, graph: FrameGraph, parity: int, scene: Scene, views: wp.array, gbuffer: GBuffer,
        previous_gbuffer: GBuffer, reprojection: Reprojection, split: EnvironmentSplit, *, filtered: bool,
        textured: bool, local_power: float, lean_layers: bool = False, shaped: bool = False, fog: Fog | None = None,
        history: DirectHistory | None = None,
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
            lean_layers: Whether the lean node machine runs all transparency programs (MaterialTable.lean).
            shaped: Whether there are materials that direct_shapes.py has to ask (Reflectors.shaped).
            fog: What is between surfaces and lights; None: nothing.
            history: Means of the frame before; None: none are kept.
        """
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
            self._make_rays(
                filtered=filtered, programs=textured or fog is not None or passes_glass(scene))
            options = self._options(light_count(scene, split, local_power))
            history = history or DirectHistory()
            self._record_samples(
                graph, parity, scene, views, gbuffer, previous_gbuffer, reprojection, split, options, history)
        with graph.section("Direct shadows"):
            if fog is not None:
                graph.launch(fog_rays.dim_shadow_rays, self.slots, [views, scene, fog], [self.rays])
            record_shadows(
                graph, scene, self.rays, self.slots, self.queue, self.layered, filtered=filtered, lean=lean_layers)
            if textured:
                shadows = [scene, make_options(filtered=filtered), one_number(0, self.device)]
                graph.launch_queued(shadow_lights.shade_lights, shadows, self.queue, [self.rays])
        with graph.section("Direct light"):
            chosen = [views, scene, split, self._emitters, options, gbuffer, self.reservoirs.current(parity), self.lent,
                      self.rays]
            graph.launch(direct_shade.shade_direct, self.slots, [*chosen, reprojection, history], [self._packed])
            if shaped:
                graph.launch(direct_shapes.shape_direct, self.slots, chosen, [self._packed])
        return self.light

    def _record_samples(
        self, graph: FrameGraph, parity: int, scene: Scene, views: wp.array, gbuffer: GBuffer,
        previous_gbuffer: GBuffer, reprojection: Reprojection, split: EnvironmentSplit, options: DirectOptions,
        history: DirectHistory,
    ) -> None:
        """Add the launches that choose a light for each pixel and aim at it; arguments as of `record`."""
        now, before = self.reservoirs.current(parity), self.reservoirs.previous(parity)
        graph.launch(
            direct_candidates.resample_lights, self.slots,
            [views, scene, split, self._emitters, options, gbuffer, reprojection, history], [now, self.lent])
        if options.reuse > 0:
            graph.launch(
                direct_candidates.reuse_lights, self.slots,
                [views, scene, split, self._emitters, options, gbuffer, previous_gbuffer, reprojection, before],
                [now, self.lent])
        graph.launch(
            direct_shadow.aim_shadow_rays, self.slots,
            [views, scene, split, self._emitters, options, gbuffer, now], [self.rays, self._packed])

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Add the launch that draws one of `debug_views` of the frame recorded last into `picture`, vec4 a pixel."""
        graph.launch(
            direct_debug.show_direct, self.width * self.height,
            [self._views, self._options(1), int(DEBUG_CHANNELS[name]), self.reservoirs.current(parity), self.rays,
             self.light], [picture])

    def stats(self, parity: int) -> dict[str, int]:
        """Return how many pixels had a light for a shadow ray in the last frame, of this parity; waits for it."""
        sampled = self.light.diffuse.numpy()[:, 3] > 0.0
        chosen = (self.reservoirs.current(parity).sample.numpy() != 0).any(-1)
        return {"direct shadow rays": int((sampled & chosen).sum())}

    def _options(self, lights: int) -> DirectOptions:
        """Return the settings: no more candidates than lights; frames before help only where those are too few."""
        options = DirectOptions()
        options.width, options.height = self.width, self.height
        options.candidates = max(min(self.settings.candidates, lights), 1)
        options.reuse = self.settings.temporal_reuse if lights > self.settings.candidates else 0
        options.half_rate = int(self.settings.half_rate and self.width * self.height > self.half_rate_pixels)
        options.quarter_rate = options.half_rate * int(self.settings.quarter_rate)
        options.full = int(any(self._rays_for))
        options.rays = int(self.reflections is not None)
        if self.reflections is not None:
            options.reflection = reflection_options(self.reflections, self.width, self.height)
        return options
