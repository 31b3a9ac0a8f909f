# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog in real-time frames: froxels before the camera, and the fog's cells, which all rays ask that go through it.

Owns both, and the rays that look for light. Knows nothing of surfaces but how far they are. A froxel holds what its air
scatters into camera rays, per unit of scattering, as a mean over frames; a pixel integrates these over the media on its
way. What light does in between, from the second time that it is scattered on, is in the cells (kernels/fog.py), which
learn from each other over frames as those of the radiance cache do.
"""

from __future__ import annotations

import warp as wp

from ...kernels import (
    fog_blend,
    fog_cells,
    fog_composite,
    fog_rays,
    fog_samples,
    shadow_lights,
)
from ...kernels.direct_emitters import EMITTER_WORDS
from ...kernels.environment_split import EnvironmentSplit
from ...kernels.fog import MOMENTS, Fog
from ...kernels.froxels import FroxelOptions
from ...kernels.gbuffer import GBuffer
from ...kernels.paths import Paths
from ...kernels.probe_rays import ProbeRays
from ...kernels.types import Scene
from ..debug_views import DEBUG_VIEWS
from ..fog import FogData, fog_struct
from ..frame_graph import FrameGraph
from ..history import History, copy_struct
from ..shadow_rays import make_options, make_shadow_rays
from ..work_list import make_queue, make_work_list, one_number
from .cache_spreading import LightPhase
from .fog_ways import FogWays
from .layer_rays import record_shadows

__all__ = ["FOG", "FogPass"]

FOG = "fog"
"""Branch of the graph"""

TILE = 4
"""Least side of a froxel [px]"""

TILES_DOWN = 90
"""Most froxels over the height of a picture: of large ones they are larger"""

SLICES = 64

CANDIDATES = 4
"""Lights that are considered for each froxel and cell"""

SWEEPS_SETTLED = 8
"""By how many sweeps are fewer once light has spread"""

DEBUG_CHANNELS = {"fog.light": fog_composite.SHOW_LIGHT, "fog.passing": fog_composite.SHOW_PASSING}


class FogPass:
    """Lights the fog and lays it over the picture."""

    name = FOG
    debug_views: dict[str, str] = {name: DEBUG_VIEWS[name] for name in DEBUG_CHANNELS}

    def __init__(self, device: str):
        self.device = device
        self.width = self.height = 0
        self._inputs: dict[int, list] = {}

    def resize(self, width: int, height: int) -> None:
        """Allocate all buffers for a size [px]: 80 bytes a froxel, up to twice that where layers stop light."""
        self.width, self.height = width, height
        options = FroxelOptions()
        options.width, options.height = width, height
        options.tile = max(TILE, -(-height // TILES_DOWN))
        options.columns, options.rows = -(-width // options.tile), -(-height // options.tile)
        options.slices, options.candidates = SLICES, CANDIDATES
        self.options = options
        self.froxels = options.columns * options.rows * options.slices
        count, device = self.froxels, self.device
        self.light: History[wp.array] = History("fog.light", lambda: wp.zeros(count, dtype=wp.vec4h, device=device))
        self.smooth = wp.zeros(count, dtype=wp.vec4h, device=device)
        self.cells = 0
        self._picture = wp.zeros(width * height, dtype=wp.vec4h, device=device)
        self._no_emitters = wp.zeros(int(EMITTER_WORDS), dtype=wp.uint64, device=device)
        self._rays_for: bool | None = None

    def _make_cells(self, cells: int) -> None:
        """Allocate what cells need: 650 bytes each."""
        self.cells, self.slots, device = cells, self.froxels + cells, self.device
        words, links = cells * int(MOMENTS), cells * int(fog_cells.LINKS)
        self._cells: History[wp.array] = History("fog.cells", lambda: wp.zeros(words, dtype=wp.vec4, device=device))
        self._spreading = [wp.zeros(words, dtype=wp.vec4, device=device) for _ in range(2)]
        self._links = fog_cells.FogLinks()
        for name in ("place", "weight", "light", "direction"):
            setattr(self._links, name, wp.zeros(links, dtype=wp.vec4, device=device))
        self._count, self._weight = (wp.zeros(cells, dtype=float, device=device) for _ in range(2))
        self._key = wp.zeros(cells, dtype=int, device=device)
        self._place, self._sample = (wp.zeros(self.slots, dtype=wp.vec4, device=device) for _ in range(2))
        self._rays_for = None

    def reset(self) -> None:
        """Forget all light."""
        self.light.reset()
        if not self.cells:
            return
        self._cells.reset()
        for array in (self._count, self._key):
            array.zero_()

    def fog_of(self, data: FogData, first_ray: int, parity: int) -> Fog:
        """Return a scene's fog with the light that this pass knows of from before a frame of some parity.

        From slot `first_ray` on the cells have a ray each among those that the radiance cache answers.
        """
        fog = fog_struct(data)
        fog.first_ray = first_ray
        if data.cells != self.cells:
            self._make_cells(data.cells)
        self._sweeps = data.sweeps
        fog.light = fog.towards = self._cells.previous(parity)
        fog.count, fog.key = self._count, self._key
        return fog

    def _make_rays(self, filtered: bool) -> None:
        if self._rays_for != filtered:
            self._rays_for = filtered
            self._rays = make_shadow_rays(self.slots, self.device, layers=filtered, programs=True)
            self._queue = make_queue(self.slots, self.device)
            self._layered = make_work_list(self.slots if filtered else 1, self.device)

    def record_samples(
        self, graph: FrameGraph, parity: int, scene: Scene, views: wp.array, gbuffer: GBuffer, fog: Fog,
        split: EnvironmentSplit, emitters: wp.array | None, rays: ProbeRays, *, filtered: bool, textured: bool,
        lean_layers: bool,
    ) -> None:
        """Record lighting froxels, and sending the cells' rays; comes before the radiance cache answers these.

        Args:
            graph: What to add to.
            parity: 0 for even frames, 1 for odd ones.
            scene: The scene.
            views: One View.
            gbuffer: Of this frame.
            fog: From fog_of.
            split: How the world is split.
            emitters: From DirectLightPass.record_emitters; None where nothing is sampled as a light.
            rays: Those that the radiance cache answers.
            filtered: Whether the scene has triangles that need a test per hit (Structures.has_filtered).
            textured: Whether the emission of any sampled triangle is a program (EmitterTable.textured).
            lean_layers: Whether the lean node machine runs all transparency programs (MaterialTable.lean).
        """
        self._make_rays(filtered)
        options, slots, shadows = self.options, self.froxels + self.cells, self._rays
        self._answers, self._views = rays, views
        self._inputs[parity] = [views, scene, fog, options, self.smooth, gbuffer]
        with graph.section("Fog light"):
            graph.launch(
                fog_samples.place_fog_samples, slots,
                [views, scene, split, self._no_emitters if emitters is None else emitters, fog, options, gbuffer],
                [shadows, rays, self._place, self._sample])
        if emitters is not None:
            with graph.branch(FOG), graph.section("Fog shadows"):
                self._record_shadows(
                    graph, scene, fog, shadows, filtered=filtered, textured=textured, lean_layers=lean_layers)

    def _record_shadows(
        self, graph: FrameGraph, scene: Scene, fog: Fog, rays: Paths, *, filtered: bool, textured: bool,
        lean_layers: bool,
    ) -> None:
        """Record finding what becomes of the light of the samples."""
        slots = self.froxels + self.cells
        graph.launch(fog_rays.dim_shadow_rays, slots, [self._views, scene, fog], [rays])
        record_shadows(graph, scene, rays, slots, self._queue, self._layered, filtered=filtered, lean=lean_layers)
        if textured:
            graph.launch_queued(
                shadow_lights.shade_lights, [scene, make_options(filtered=filtered), one_number(0, self.device)],
                self._queue, [rays])

    def record_light(
        self, graph: FrameGraph, parity: int, scene: Scene, fog: Fog, ways: FogWays, phase: LightPhase,
    ) -> None:
        """Record taking in what cells and froxels have found, and adding fog to the radiance cache's answers.

        Comes after these. Each sweep reads what the one before it has written.
        """
        views, options = self._views, self.options
        samples = [self._rays, self._answers, self._links, self._sample, self._weight, fog.light]
        graph.join(FOG)
        with graph.section("Fog light"):
            graph.launch(fog_cells.open_cells, self.cells, [views, options, self._place], [fog, self._weight])
            graph.launch(
                fog_cells.link_cells, self.cells * int(fog_cells.LINKS),
                [views, scene, fog, self._answers, self._weight], [self._links])
            sweeps = self._sweeps if phase is LightPhase.SWEEPING else max(self._sweeps // SWEEPS_SETTLED, 1)
            read = copy_struct(fog)
            for sweep in range(sweeps):
                read.even = int(sweep < sweeps - 1)
                written = self._cells.current(parity) if sweep == sweeps - 1 else self._spreading[sweep & 1]
                graph.launch(
                    fog_cells.spread_fog, self.cells, [views, read, options, sweep, *samples], [written])
                read = copy_struct(fog)
                read.light = written
            read.towards = read.light
            ways.record_light(graph, views, read, self._answers)
        with graph.branch(FOG), graph.section("Fog light"):
            now, before = self.light.current(parity), self.light.previous(parity)
            graph.launch(
                fog_blend.blend_froxels, self.froxels,
                [views, read, options, self._rays, self._place, self._sample, before], [now])
            graph.launch(fog_blend.smooth_froxels, self.froxels, [options, now], [self.smooth])

    def record_picture(self, graph: FrameGraph, parity: int, color: wp.array) -> wp.array:
        """Record laying fog over a picture, vec4h [h * w], exposed; return it, valid until the next frame."""
        graph.launch(
            fog_composite.lay_fog, self.width * self.height, [*self._inputs[parity], color], [self._picture])
        return self._picture

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` of this frame into `picture`, vec4 a pixel; comes after the rest."""
        graph.launch(
            fog_composite.show_fog, self.width * self.height, [*self._inputs[parity], int(DEBUG_CHANNELS[name])],
            [picture])
