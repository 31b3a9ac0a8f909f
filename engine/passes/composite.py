# SPDX-License-Identifier: GPL-3.0-or-later
"""The last pass of a real-time frame: the composite, its temporal anti-aliasing and the light passes.

Owns the composites of this frame and the last (other passes look for light of the frame before there), the averaged
picture and the sums of the light passes. Knows nothing of how the light was found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import warp as wp

from ...kernels import antialias, composite, composite_debug
from ...kernels.antialias import Accumulation, Mirrors
from ...kernels.composite import LightPasses, Lights
from ...kernels.gbuffer import GBuffer
from ...kernels.reflection_types import ReflectionOptions
from ..device import launch
from ..frame_graph import FrameGraph
from ..history import History, arrays_of
from ..pixel_filter import filter_table, sharpness_of
from ..settings import DenoiserSettings, FilmSettings

__all__ = ["LIGHT_PASSES", "CompositePass"]

PASS_LOBES = {
    "Diffuse": composite.PASS_DIFFUSE, "Glossy": composite.PASS_GLOSSY, "Transmission": composite.PASS_TRANSMISSION,
}
PASS_PARTS = ("Direct", "Indirect", "Color")
"""In the order of composite.resolve_light_passes' outputs"""

LIGHT_PASSES = tuple(f"{lobe} {part}" for lobe in PASS_LOBES for part in PASS_PARTS)
"""Names of the pictures that read_light_pass() gives, and light_split.py for the path tracer.

(direct + indirect) * color is a lobe's light; all three lobes, emission and the world make up the picture. Diffuse
transmission and sheen count as diffuse, as in Cycles. Of real-time frames Transmission Direct is always 0: light
arrives through glass by rays that may meet anything, so all of it is indirect.
"""

DEBUG_LIGHT = {
    "composite.direct": composite_debug.SHOW_DIRECT,
    "composite.indirect": composite_debug.SHOW_INDIRECT,
    "composite.reflection": composite_debug.SHOW_REFLECTION,
}


class CompositePass:
    """Puts light and surface colours together and averages the frames."""

    name = "composite"

    debug_views = {
        "composite.direct": "Emission and direct light with the surfaces' colours",
        "composite.indirect": "Indirect light with the surfaces' colours",
        "composite.reflection": "Indirect light that the surfaces reflect, with their colours",
        "composite.history": "Frames averaged by anti-aliasing: dark where it started anew",
    }

    def __init__(self, device: str, settings: DenoiserSettings, light_passes: Iterable[str] = ()):
        """Make the pass; `light_passes` are names from LIGHT_PASSES that will be read."""
        self.device = device
        self.settings = settings
        self.lobes = tuple(sorted({name.partition(" ")[0] for name in light_passes}))
        """Whose light passes are kept: keys of PASS_LOBES"""
        self.width = self.height = 0
        film = FilmSettings()
        self.sharpness = sharpness_of(filter_table(film.pixel_filter, film.filter_width))
        """Of the pixel filter, see antialias.antialias; before frames are recorded"""
        self._seen: wp.array | None = None
        self._inputs: dict[int, tuple] = {}
        """What compose() was recorded with for each parity: debug views read the same"""

    def resize(self, width: int, height: int) -> None:
        """Allocate all buffers for a size [px]."""
        self.width, self.height = width, height
        count, device = width * height, self.device

        def accumulation() -> Accumulation:
            a = Accumulation()
            a.color = wp.zeros(count, dtype=wp.vec4, device=device)
            a.samples = wp.zeros(count, dtype=wp.uint16, device=device)
            return a

        self.color: History[wp.array] = History(
            "composite.color", lambda: wp.zeros(count, dtype=wp.vec4h, device=device))
        self.matte: History[wp.array] = History(
            "composite.matte", lambda: wp.zeros(count, dtype=wp.uint64, device=device))
        """Diffuse light without the surfaces' colours, for reflections of the frame to come"""
        self.accumulated: History[Any] = History("composite.accumulated", accumulation)
        self._inputs = {}
        self._nothing = wp.empty(0, dtype=wp.uint64, device=device)
        self._sums = {lobe: light_passes(count, device) for lobe in self.lobes}

    def reset(self) -> None:
        """Forget all frames."""
        self.color.reset()
        self.matte.reset()
        self.accumulated.reset()
        for sums in self._sums.values():
            for array in arrays_of(sums):
                array.zero_()

    def record(
        self, graph: FrameGraph, parity: int, views: wp.array, gbuffer: GBuffer, reprojection: Any,
        direct: Any, irradiance: wp.array, specular_ratio: wp.array | None = None,
        reflection: wp.array | None = None, transmission: wp.array | None = None,
        options: ReflectionOptions | None = None, indirect: wp.array | None = None, mirrors: Mirrors | None = None,
        keeping_matte: bool = False, over: Callable[[wp.array], None] | None = None,
        veil: Callable[[wp.array], wp.array] | None = None,
    ) -> wp.array:
        """Record the composite and its anti-aliasing; return the picture.

        Args:
            graph: Takes the launches.
            parity: Of the frames recorded.
            views: One View.
            gbuffer: Of this frame.
            reprojection: Has `position` (vec2) and `taps` (uint8), see kernels/reprojection.py.
            direct: Has `diffuse` and `specular` (vec4h): exposed, without the surfaces' colours.
            irradiance: vec4h, diffuse indirect light: irradiance / pi, exposed.
            specular_ratio: float16, what a reflection gets of that light; None: 1 everywhere.
            reflection: uint64 (long_mean.pack_mean), exposed indirect light that reflections show, without the
                surfaces' colours; None: `irradiance` stands in for it.
            transmission: The same of light that arrives through glass.
            options: Of the reflections: tell which surfaces have them; must come with `reflection`.
            indirect: uint64 (long_mean.pack_mean), diffuse indirect light that stands in for `irradiance`, with what
                leaning normals take from it.
            mirrors: What tells how long mirrors have shown what they show; None: there are none.
            keeping_matte: Whether `matte` is wanted.
            over: Records what replaces the composite in some pixels; None: nothing.
            veil: Records what is before all surfaces: takes the composite and returns what is seen; None: nothing.

        Returns:
            vec4 [h * w]: exposed colour, premultiplied by alpha, as the film shows it; kept for two frames.
        """
        count = self.width * self.height
        color = self.color.current(parity)
        if specular_ratio is None:
            specular_ratio = wp.full(count, 1.0, dtype=wp.float16, device=self.device)
        lights = self.lights(direct, irradiance, indirect)
        lights.specular_ratio = specular_ratio
        if reflection is not None:
            lights.reflection, lights.options, lights.has_reflection = reflection, options, 1
        if transmission is not None:
            lights.transmission, lights.has_transmission = transmission, 1
        self._inputs[parity] = (gbuffer, lights)
        matte = self.matte.current(parity) if keeping_matte else self._nothing
        graph.launch(composite.compose, count, [views, gbuffer, lights], [color, matte])
        for lobe, sums in self._sums.items():
            graph.launch(
                composite.accumulate_light_passes, count, [views, gbuffer, lights, int(PASS_LOBES[lobe])], [sums])
        if over is not None:
            over(color)
        self._seen = seen = color if veil is None else veil(color)
        accumulated, before = self.accumulated.current(parity), self.accumulated.previous(parity)
        graph.launch(
            antialias.antialias, count,
            [views, seen.view(wp.uint64), gbuffer.depth, reprojection.position, reprojection.taps,
             mirrors or Mirrors(), before, self.width, self.height, int(self.settings.antialiasing),
             self.sharpness],
            [accumulated])
        return accumulated.color

    def lights(self, direct: Any, irradiance: wp.array, indirect: wp.array | None) -> Lights:
        """Return diffuse light alone, as kernels take it; arguments as of `record`."""
        lights = Lights()
        lights.direct_diffuse, lights.direct_specular, lights.irradiance = direct.diffuse, direct.specular, irradiance
        if indirect is not None:
            lights.indirect, lights.has_indirect = indirect, 1
        return lights

    def newest(self, parity: int) -> tuple[wp.array, Accumulation]:
        """Return the frame recorded last, vec4h [h * w] before anti-aliasing, and what that makes of it."""
        return self._seen, self.accumulated.current(parity)

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` of this frame into `picture` (vec4 [h * w]); comes after record()."""
        count = self.width * self.height
        if name == "composite.history":
            graph.launch(
                composite_debug.show_history, count, [self.accumulated.current(parity).samples], [picture])
            return
        graph.launch(composite_debug.show_light, count, [*self._inputs[parity], int(DEBUG_LIGHT[name])], [picture])

    def read_light_pass(self, name: str, average: Callable[[wp.array], wp.array] = lambda sums: sums) -> wp.array:
        """Return one of LIGHT_PASSES, the mean of the frames since the picture came to rest: vec3 [h * w], exposed.

        `average`: makes sums over the picture's pixels of those over a frame's (supersampling.py).

        Raises:
            KeyError: No such pass, or the light passes were not asked for.
        """
        lobe, _, part = name.partition(" ")
        if name not in LIGHT_PASSES or lobe not in self._sums:
            raise KeyError(name)
        kept, sums = self._sums[lobe], LightPasses()
        sums.direct, sums.indirect, sums.albedo = average(kept.direct), average(kept.indirect), average(kept.albedo)
        count = len(sums.direct)
        pictures = [wp.empty(count, dtype=wp.vec3, device=self.device) for _ in PASS_PARTS]
        launch(composite.resolve_light_passes, count, [0, sums], pictures, self.device)
        return pictures[PASS_PARTS.index(part)]


def light_passes(count: int, device: str) -> LightPasses:
    """Return empty sums for a number of pixels."""
    sums = LightPasses()
    sums.direct = wp.zeros(count, dtype=wp.vec3, device=device)
    sums.indirect = wp.zeros(count, dtype=wp.vec3, device=device)
    sums.albedo = wp.zeros(count, dtype=wp.vec4, device=device)
    return sums
