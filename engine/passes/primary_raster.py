# SPDX-License-Identifier: GPL-3.0-or-later
"""What pixels show, found by drawing triangles instead of tracing rays: the same picture in two thirds of the time.

Only on CUDA: a processor would have to draw in one thread, since its atomics are not atomic, and traces faster.
"""

from __future__ import annotations

import warp as wp

from ...kernels import raster, raster_resolve
from ...kernels.gbuffer_rays import PrimaryHits
from ...kernels.pixel_order import PIXEL_BLOCK
from ...kernels.raster import RasterLists
from ...kernels.raster_pixels import TILE, Visibility
from ...kernels.types import FlatTriangles, Scene
from ..flat_structure import FlatStructure
from ..frame_graph import FrameGraph
from ..structures import Structures
from ..work_list import WorkList, make_work_list

__all__ = ["OTHER_PIXELS", "PrimaryRaster", "count_in_blocks", "notes_all_veils"]

OTHER_PIXELS = "other pixels"
"""Branch of the graph for pixels behind triangles that need a test, and for those that take the full node machine"""

RECORDS = 1 << 18
"""Triangles that may be dealt out: 12 MiB"""
TILES = 1 << 20
"""Tiles of triangles that may wait: 16 MiB. One triangle over all of a 1080p picture has 8,160"""
BLOCKS = 1 << 17
GROUPS = 1 << 13
"""Tiles that are drawn at a time: as many warps as a large GPU has under way, or some more"""


def count_in_blocks(width: int, height: int) -> int:
    """Return how many threads a kernel has whose pixels go by pixel_in_blocks."""
    side = int(PIXEL_BLOCK)
    return -(-width // side) * -(-height // side) * side * side


def notes_all_veils(scene: Scene) -> bool:
    """Return whether all triangles that need a test are drawn: those of instances are not."""
    return int(scene.geometry.instanced_filtered.nodes) == 0


class PrimaryRaster:
    """Owns the visibility buffer and the lists of what waits to be drawn."""

    def __init__(self, device: str):
        self.device = device
        self.records, self.tiles, self.blocks = RECORDS, TILES, BLOCKS

    def resize(self, width: int, height: int) -> None:
        """Allocate for a picture of that size [px]."""
        self.width, self.height = width, height
        self.seen = Visibility()
        self.seen.nearest = wp.zeros(width * height, dtype=wp.uint64, device=self.device)
        self.seen.veiled = wp.zeros(1, dtype=wp.uint8, device=self.device)
        side = int(TILE)
        self.seen.covers = wp.zeros(-(-width // side) * -(-height // side), dtype=int, device=self.device)
        self.veiled: WorkList | None = None
        self.lists = RasterLists()
        self.lists.records = wp.zeros(3 * self.records, dtype=wp.vec4, device=self.device)
        self.lists.tiles = wp.zeros(self.tiles, dtype=wp.vec4i, device=self.device)
        self.lists.blocks = wp.zeros(self.blocks, dtype=wp.vec4i, device=self.device)
        self.lists.counts = wp.zeros(3, dtype=int, device=self.device)

    def record(
        self, graph: FrameGraph, scene: Scene, structures: Structures, views: wp.array, hits: PrimaryHits,
        layered: WorkList, *, filtered: bool,
    ) -> None:
        """Record finding what pixels show and, with `filtered`, the first triangle before it that needs a test.

        Where `seen.veiled` is 0 it is known then what a pixel shows, elsewhere, if notes_all_veils, once the branch
        OTHER_PIXELS is through. In that case pixels that have such a triangle are put into `layered`.
        """
        geometry = scene.geometry
        count, in_blocks = self.width * self.height, count_in_blocks(self.width, self.height)
        graph.clear(self.seen.nearest)
        graph.clear(self.seen.covers)
        self._record_triangles(graph, structures.opaque, geometry.flat, views, veils=False)
        if filtered:
            if self.veiled is None:
                self.seen.veiled = wp.zeros(count, dtype=wp.uint8, device=self.device)
                self.veiled = make_work_list(count, self.device)
            with graph.branch(OTHER_PIXELS):
                graph.clear(self.seen.veiled)
                self._record_triangles(graph, structures.filtered, geometry.flat_filtered, views, veils=True)
        view = [views, scene, self.width]
        graph.launch(
            raster_resolve.resolve_hits, in_blocks, [*view, self.height, int(filtered), self.seen.nearest], [hits])
        if int(geometry.instanced.nodes) != 0:
            graph.launch(raster_resolve.resolve_instances, in_blocks, [*view, self.height], [hits])
        if not filtered:
            return
        graph.join(OTHER_PIXELS)
        if not notes_all_veils(scene):
            graph.launch(raster_resolve.trace_instanced_veils, count, [*view, self.seen], [hits])
            return
        with graph.branch(OTHER_PIXELS):
            graph.fill_list(raster_resolve.append_veiled, in_blocks, [self.seen, self.width, self.height], self.veiled)
            graph.empty_list(layered)
            graph.launch_listed(
                raster_resolve.trace_veils, [*view, self.seen, int(graph.cuda)], self.veiled,
                [hits, layered.queue, layered.count])

    def _record_triangles(
        self, graph: FrameGraph, structure: FlatStructure, flat: FlatTriangles, views: wp.array, *, veils: bool,
    ) -> None:
        if structure.wide is None:
            return
        wide, how = structure.wide, int(veils)
        graph.clear(self.lists.counts)
        graph.launch(
            raster.raster_triangles, wide.triangle_count,
            [views, flat.triangles, wide.wholes, self.width, self.height, how], [self.lists, self.seen], banded=False)
        threads, drawing = GROUPS * int(raster.LANES), [views, self.width, self.height, how, GROUPS]
        graph.launch(raster.raster_blocks, threads, drawing, [self.lists, self.seen], banded=False)
        graph.launch(raster.raster_tiles, threads, [*drawing, self.lists], [self.seen], banded=False)
