# SPDX-License-Identifier: GPL-3.0-or-later
"""What each pixel shows: primary rays, materials, and where the same surface was in the frame before."""

from __future__ import annotations

from contextlib import nullcontext

import warp as wp

from ...kernels import (
    compaction,
    flat_tracing,
    gbuffer_behind,
    gbuffer_below,
    gbuffer_debug,
    gbuffer_exact,
    gbuffer_layers,
    gbuffer_layers_lean,
    gbuffer_lean,
    gbuffer_materials,
    gbuffer_rays,
    reproject,
)
from ...kernels.gbuffer import GBuffer
from ...kernels.gbuffer_rays import PrimaryHits
from ...kernels.motion import Motion
from ...kernels.reprojection import Reprojection
from ...kernels.types import Scene
from ..debug_views import DEBUG_VIEWS
from ..emitters import EmitterTable
from ..frame_graph import FrameGraph
from ..history import History
from ..structures import Structures, is_flat
from ..work_list import make_work_list
from .primary_raster import OTHER_PIXELS, PrimaryRaster, count_in_blocks, notes_all_veils

__all__ = ["LAMPS", "GBufferPass"]

LAMPS = "visible lamps"
"""Branch of the graph that adds what the camera sees of lamps; the composite waits for it"""

GBUFFER_ARRAYS = {
    "hit": wp.vec2i, "barycentrics": wp.uint32, "depth": wp.float32, "geometric_normal": wp.uint32,
    "normal": wp.uint32, "diffuse": wp.uint32, "specular": wp.uint32, "f0": wp.uint32, "material": wp.uint32,
    "translucent": wp.uint32, "transmitted": wp.uint32, "coat": wp.uint32, "emission": wp.vec4h,
}

DEBUG_CHANNELS = {
    "gbuffer.normal": gbuffer_debug.GBUFFER_NORMAL,
    "gbuffer.albedo": gbuffer_debug.GBUFFER_ALBEDO,
    "gbuffer.specular": gbuffer_debug.GBUFFER_SPECULAR,
    "gbuffer.transmitted": gbuffer_debug.GBUFFER_TRANSMITTED,
    "gbuffer.coat": gbuffer_debug.GBUFFER_COAT,
    "gbuffer.roughness": gbuffer_debug.GBUFFER_ROUGHNESS,
    "gbuffer.depth": gbuffer_debug.GBUFFER_DEPTH,
    "gbuffer.motion": gbuffer_debug.GBUFFER_MOTION,
    "gbuffer.instance": gbuffer_debug.GBUFFER_INSTANCE,
    "gbuffer.disocclusion": gbuffer_debug.GBUFFER_DISOCCLUSION,
}


def shines_plainly(scene: Scene, emitters: EmitterTable) -> bool:
    """Return whether the radiance of anything that is seen through layers may be known without a program."""
    return len(emitters.power) > 0 or (scene.environment.constant == 1 and max(scene.environment.radiance) > 0.0)


class GBufferPass:
    """Owns the G-buffers of this and the last frame and the reprojection between them."""

    name = "gbuffer"
    debug_views: dict[str, str] = {name: DEBUG_VIEWS[name] for name in DEBUG_CHANNELS}

    def __init__(self, device: str, *, rasterizing: bool | None = None):
        """Make the pass; `rasterizing`: whether triangles are drawn instead of rays traced (None: on CUDA)."""
        self.device = device
        self.width = self.height = 0
        if rasterizing is None:
            rasterizing = wp.get_device(device).is_cuda
        self.raster = PrimaryRaster(device) if rasterizing else None

    def resize(self, width: int, height: int) -> None:
        """Allocate for a picture of that size [px]."""
        self.width, self.height = width, height
        count = width * height
        self.history: History[GBuffer] = History("gbuffer", lambda: self._fill(GBuffer(), GBUFFER_ARRAYS, count))
        self.hits = self._fill(
            PrimaryHits(), {"t": wp.float32, "hit": wp.vec2i, "barycentrics": wp.vec2}, count)
        self._fit_layers(1)
        self.full = make_work_list(count, self.device)
        self._none = wp.zeros(0, dtype=wp.uint8, device=self.device)
        if self.raster is not None:
            self.raster.resize(width, height)
        self.reprojection = self._fill(Reprojection(), {"position": wp.vec2, "taps": wp.uint8}, count)

    def _fill(self, buffers: object, arrays: dict[str, type], count: int) -> object:
        for name, dtype in arrays.items():
            setattr(buffers, name, wp.zeros(count, dtype=dtype, device=self.device))
        return buffers

    def _fit_layers(self, count: int) -> None:
        """Allocate what only scenes with transparent layers need."""
        self._fill(self.hits, {
            "layer_t": wp.float32, "layer": wp.vec2i, "layer_barycentrics": wp.vec2, "weight": wp.vec3,
            "behind": wp.vec4}, count)
        self.layered = make_work_list(count, self.device)

    def _fit_scattering(self, scattering: bool) -> None:
        """Allocate what only scenes need that scatter light below surfaces."""
        for gbuffer in (self.current(0), self.current(1)):
            count = self.width * self.height if scattering else 0
            if gbuffer.below is None or len(gbuffer.below) != count:
                gbuffer.below = wp.zeros(count, dtype=wp.uint32, device=self.device)

    def reset(self) -> None:
        """Forget the frame before."""
        self.history.reset()

    def current(self, parity: int) -> GBuffer:
        """Return the G-buffer that a frame of this parity writes."""
        return self.history.current(parity)

    def previous(self, parity: int) -> GBuffer:
        """Return the G-buffer of the frame before one of this parity."""
        return self.history.previous(parity)

    def record(
        self, graph: FrameGraph, parity: int, scene: Scene, structures: Structures, views: wp.array, *,
        filtered: bool = True, all_lean: bool = False, lean_layers: bool = False, shining: bool = False,
        exact: bool = False, scattering: bool = False,
    ) -> GBuffer:
        """Record the G-buffer of a frame.

        Args:
            graph: What to add to.
            parity: 0 for even frames, 1 for odd ones.
            scene: The scene.
            structures: Its acceleration structures.
            views: One element.
            filtered: Whether the scene has triangles that need a test per hit (Structures.has_filtered).
            all_lean: Whether the lean node machine runs all materials (MaterialTable.lean).
            lean_layers: Whether it runs all transparency programs (MaterialTable.lean).
            exact: Whether any material has an exact program (MaterialTable.lean).
            shining: Whether layers may hide what shines without a program (see shines_plainly).
            scattering: Whether light is scattered below surfaces.
        """
        self._fit_scattering(scattering)
        width, height, gbuffer, hits = self.width, self.height, self.current(parity), self.hits
        count, in_blocks = width * height, count_in_blocks(width, height)
        layers = int(gbuffer_rays.LAYERS_NONE)
        if filtered:
            layers = int(gbuffer_rays.LAYERS_LIT if shining and lean_layers else gbuffer_rays.LAYERS_DARK)
            if len(hits.weight) != count:
                self._fit_layers(count)
        with graph.section("Primary rays"):
            if self.raster is not None:
                self.raster.record(graph, scene, structures, views, hits, self.layered, filtered=filtered)
            elif is_flat(scene):
                trace = flat_tracing.trace_flat_layered_primary if filtered else flat_tracing.trace_flat_primary
                graph.launch(trace, in_blocks, [views, scene, width, height], [hits])
            else:
                graph.launch(gbuffer_rays.trace_primary, count, [views, scene, width], [hits])
            noted = self.raster is not None and notes_all_veils(scene)
            later = filtered and lean_layers and noted
            if filtered:
                if not later:
                    graph.join(OTHER_PIXELS)
                with graph.branch(OTHER_PIXELS) if later else nullcontext():
                    self._record_layers(
                        graph, scene, views, in_blocks, lean_layers, layers == int(gbuffer_rays.LAYERS_LIT), noted)
        with graph.section("Materials"):
            # What is listed goes first, beside all others.
            with graph.branch(OTHER_PIXELS):
                if later:
                    graph.launch_listed(
                        gbuffer_lean.shade_lean_listed, [views, scene, width, layers, hits], self.raster.veiled,
                        [gbuffer])
                if not all_lean or scene.environment.constant == 0:
                    graph.fill_list(gbuffer_lean.append_full, in_blocks, [scene, width, height, hits], self.full)
                    shade = gbuffer_exact.shade_exact_primary if exact else gbuffer_materials.shade_primary
                    graph.launch_listed(shade, [views, scene, width, layers, hits], self.full, [gbuffer], few=True)
            graph.launch(
                gbuffer_lean.shade_lean, in_blocks,
                [views, scene, width, height, layers, self.raster.seen.veiled if later else self._none, hits],
                [gbuffer])
            graph.join(OTHER_PIXELS)
            if scattering:
                graph.launch(gbuffer_below.note_scattering, count, [views, scene, width], [gbuffer])
            if scene.lights.lamp_count > 0:
                # Nothing but the composite asks for them.
                with graph.branch(LAMPS):
                    graph.launch(
                        gbuffer_rays.add_lamps, count, [views, scene, width, layers, hits],
                        [gbuffer.emission, gbuffer.material])
        return gbuffer

    def record_reprojection(
        self, graph: FrameGraph, parity: int, scene: Scene, views: wp.array, motion: Motion,
    ) -> None:
        """Record finding the pixels' surfaces in the frame before; arguments as of `record`."""
        with graph.section("Reprojection"):
            graph.launch(
                reproject.reproject, self.width * self.height,
                [views, scene, motion, self.width, self.height, self.current(parity), self.previous(parity)],
                [self.reprojection])

    def _record_layers(
        self, graph: FrameGraph, scene: Scene, views: wp.array, in_blocks: int, lean: bool, lit: bool, listed: bool,
    ) -> None:
        """Record looking through the layers in front of what pixels show.

        `lit`: something may shine behind them; `listed`: pixels that have any are in their list already.
        """
        width, height, hits = self.width, self.height, self.hits
        if self.raster is None and not is_flat(scene):
            graph.launch(gbuffer_rays.trace_primary_layers, width * height, [views, scene, width], [hits])
        if lean:
            if not listed:
                graph.fill_list(
                    compaction.append_layered_pixels, in_blocks, [hits.layer, width, height], self.layered)
            if lit:
                graph.launch_listed(
                    gbuffer_behind.see_through, [views, scene, width], self.layered, [hits], few=True)
            graph.launch_listed(
                gbuffer_layers_lean.filter_primary_lean, [views, scene, width, int(lit)], self.layered, [hits],
                few=True)
        else:
            graph.launch(gbuffer_layers.filter_primary, width * height, [views, scene, width], [hits])

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record drawing one of `debug_views` into `picture`, vec4 a pixel."""
        graph.launch(
            gbuffer_debug.draw_gbuffer, self.width * self.height,
            [self.current(parity), self.reprojection, self.width, int(DEBUG_CHANNELS[name])], [picture])
