# SPDX-License-Identifier: GPL-3.0-or-later
"""Screen probes: diffuse light from all around, gathered at points of the picture (GI-1.0, section 3).

A frame in two halves. `record_rays` finds the pool's probes on the screen, chooses where probes are updated and makes
their rays; the radiance cache answers these; `record_light` puts the answers into the probes and interpolates the light
of each pixel. See kernels/probe_*.py.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ...kernels import (
    probe_blend,
    probe_contact,
    probe_debug,
    probe_gather,
    probe_interpolate,
    probe_light,
    probe_map,
    probe_place,
    probe_records,
    probe_sample,
    probe_turns,
    reflection_probes,
)
from ...kernels import probe_spawn as spawn
from ...kernels.diffuse_temporal import DiffuseHistory
from ...kernels.gbuffer import GBuffer
from ...kernels.interpolation_turns import InterpolatedBefore
from ...kernels.probe_rays import ProbeRays
from ...kernels.probe_types import BANDS, CELLS, TILE, ProbeGrid, ProbePool, ProbeTiles, ProbeUpdates
from ...kernels.reflection_types import ReflectionOptions, ReflectionSamples
from ...kernels.reprojection import Reprojection
from ...kernels.types import Scene
from ..debug_views import DEBUG_VIEWS
from ..device import launch
from ..frame_graph import FrameGraph
from ..history import History
from ..lobe_moments import lobe_moments
from ..ray_budget import HALF_RATE_PIXELS, SMALL_INTERVAL
from ..settings import ProbeSettings
from ..work_list import make_work_list

__all__ = ["ScreenProbePass"]

LEAST_SLOTS = 4096
"""Probes kept even for tiny pictures"""

SLOTS_PER_TILE = 2
"""One probe stands for the tile now, one is remembered from before"""

CELL_STEPS = 64
"""Steps a side with which the cells' integrals are tabulated"""

POOL = {"position": (wp.vec3, 1), "center": (wp.vec3, 1), "normal": (wp.uint32, 1),
        "radiance": (wp.vec4h, CELLS), "irradiance": (wp.vec4, BANDS), "residual": (wp.vec4, BANDS),
        "clear": (float, 1), "count": (float, 1), "noise": (float, 1), "used": (int, 1), "updated": (int, 1),
        "born": (int, 1), "updates": (int, 1), "tile": (int, 1)}
TILES = {"seed": (int, 1), "claim": (wp.int64, 1), "claim_other": (wp.int64, 1), "probe": (int, 1), "other": (int, 1),
         "empty": (int, 1), "rank": (int, 1), "empty_list": (int, 1)}
UPDATES = {"own": (int, 1), "free": (int, 1), "rank": (int, 1), "tile": (int, 1), "pixel": (int, 1), "slot": (int, 1),
           "fresh": (int, 1), "position": (wp.vec3, 1), "error": (float, 1), "normal": (wp.uint32, 1),
           "specular": (int, 1), "count": (float, 1), "change": (float, 1), "covered": (int, 1),
           "previous": (wp.vec4h, CELLS), "guide": (float, CELLS), "residual": (wp.vec4, BANDS),
           "expected": (float, CELLS),
           "cell": (wp.uint8, CELLS), "neighbor": (int, 9), "filtered": (wp.vec4h, CELLS)}
RAYS = {"origin": (wp.vec3, CELLS), "direction": (wp.vec3, CELLS), "t_max": (float, CELLS), "probe": (int, CELLS),
        "radiance": (wp.vec4, CELLS)}
"""Fields of the buffers, their types, and how many entries each element has"""


class ScreenProbePass:
    """Owns the pool of probes and everything about this frame's updates."""

    name = "screen probes"

    debug_views: dict[str, str] = {name: DEBUG_VIEWS[name] for name in DEBUG_VIEWS if name.startswith("probes.")}

    def __init__(self, device: str, settings: ProbeSettings | None = None):
        self.device = device
        self.settings = settings or ProbeSettings()
        self.half_rate_pixels = HALF_RATE_PIXELS
        self.width = self.height = 0

    def configure(self, settings: ProbeSettings) -> None:
        """Take other settings; the pass must be resized (and recorded again) after that."""
        self.settings = settings

    def resize(self, width: int, height: int) -> None:
        """Allocate all buffers for a picture of this size [px]; forgets all probes."""
        self.width, self.height = width, height
        grid = ProbeGrid()
        grid.width, grid.height = width, height
        # Spawn tiles are made of whole tiles.
        grid.side = max(1, round(self.settings.spawn_tile / TILE))
        grid.tile_columns, grid.tile_rows = -(-width // TILE), -(-height // TILE)
        grid.update_columns, grid.update_rows = -(-grid.tile_columns // grid.side), -(-grid.tile_rows // grid.side)
        self.tile_count = grid.tile_columns * grid.tile_rows
        self.update_count = grid.update_columns * grid.update_rows
        # Whole windows of slots, see probe_place.free_slot.
        windows = -(-max(SLOTS_PER_TILE * self.tile_count, LEAST_SLOTS) // self.update_count)
        grid.slots = windows * self.update_count
        grid.persistent, grid.guided = int(self.settings.persistence), int(self.settings.guiding)
        grid.filtered, grid.specular = int(self.settings.filtering), int(self.settings.specular_rays)
        large = width * height > self.half_rate_pixels
        grid.interval = self.settings.update_interval if large else min(self.settings.update_interval, SMALL_INTERVAL)
        grid.half_rate = int(self.settings.half_rate and large)
        grid.exact, grid.history = int(self.settings.energy_exact), float(self.settings.history)
        self.grid = grid
        self.pool = self._allocate(ProbePool, POOL, grid.slots)
        # A word for each cell loads at once.
        self.maps = self.pool.radiance.view(wp.uint64)
        self.tiles = self._allocate(ProbeTiles, TILES, self.tile_count)
        self.updates = self._allocate(ProbeUpdates, UPDATES, self.update_count)
        self.rays = self._allocate(ProbeRays, RAYS, self.update_count)
        self.guests = 0
        """Slots for rays of others, after the probes' own: the radiance cache answers all at once"""
        self.irradiance = wp.zeros(width * height, dtype=wp.vec4h, device=self.device)
        self._ratios: History[wp.array] = History(
            "specular ratio", lambda: wp.zeros(width * height, dtype=wp.float16, device=self.device))
        self.specular_ratio = self._ratios.current(0)
        """Luminance of the light of each pixel's reflection lobe by that of its irradiance / pi (float16 [h * w]), of
        the frame recorded last"""
        self.unfilled = make_work_list(width * height, self.device)
        self.records = wp.zeros(
            2 * self.tile_count * int(probe_records.RECORD_WORDS), dtype=wp.uint64, device=self.device)
        self.moments = lobe_moments(self.device)
        self.contact = wp.zeros(width * height, dtype=wp.vec4h, device=self.device)
        self.weights = wp.zeros(CELLS * BANDS, dtype=float, device=self.device)
        self.cosines = wp.zeros(CELLS, dtype=float, device=self.device)
        launch(probe_map.integrate_cells, CELLS, [CELL_STEPS, grid.exact], [self.weights, self.cosines], self.device)

    def _allocate(self, struct: type, fields: dict[str, tuple[type, int]], count: int) -> object:
        buffers = struct()
        for name, (dtype, each) in fields.items():
            setattr(buffers, name, wp.zeros(count * each, dtype=dtype, device=self.device))
        return buffers

    @property
    def rays_a_frame(self) -> int:
        """Slots of rays in a frame."""
        return self.update_count * CELLS + self.guests

    def make_room(self, guests: int) -> None:
        """Have slots for so many rays of others."""
        if guests != self.guests:
            self.guests = guests
            self.rays = self._allocate(ProbeRays, RAYS, self.update_count + -(-guests // CELLS))

    def reset(self) -> None:
        """Forget all probes."""
        self.pool.used.zero_()
        self.pool.updates.zero_()

    def record_rays(
        self, graph: FrameGraph, scene: Scene, views: wp.array, gbuffer: GBuffer,
    ) -> tuple[ProbeRays, int]:
        """Record choosing the probes of a frame and making their rays; returns the rays and how many slots they have.

        Probes are updated in place: frames of both parities are recorded alike.
        """
        grid, pool, tiles, updates = self.grid, self.pool, self.tiles, self.updates
        # The weights are numbers, frozen in the record like all settings.
        grid.luminance = scene.luminance
        self.views = views
        with graph.section("Probe placement"):
            graph.launch(spawn.seed_tiles, self.tile_count, [grid, views, gbuffer], [tiles])
            graph.launch(spawn.claim_tiles, grid.slots, [grid, views, gbuffer], [pool, tiles], banded=False)
            graph.launch(spawn.claim_other_surfaces, grid.slots, [views, pool], [tiles], banded=False)
            graph.launch(spawn.mark_used, grid.slots, [views, tiles], [pool])
            graph.launch(probe_turns.find_missing, self.tile_count, [grid, views, gbuffer, pool], [tiles])
            graph.launch(probe_turns.choose_tiles, self.update_count, [grid, views, tiles, pool], [updates])
            graph.launch(probe_turns.mark_empty, self.tile_count, [grid, updates], [tiles])
            graph.call(lambda: wp.utils.array_scan(updates.free, updates.rank, inclusive=True))
            graph.call(lambda: wp.utils.array_scan(tiles.empty, tiles.rank, inclusive=True))
            graph.launch(probe_turns.list_empty, self.tile_count, [], [tiles], banded=False)
            graph.launch(probe_place.place_updates, self.update_count, [grid, views, scene, gbuffer, tiles, pool],
                         [updates])
        count, lanes = self.update_count * CELLS, graph.lanes
        with graph.section("Probe rays"):
            graph.launch(probe_gather.gather_history, count, [grid, views, tiles, pool, self.cosines], [updates])
            graph.launch(probe_gather.count_history, lanes * self.update_count,
                         [grid, views, tiles, pool, lanes], [updates])
            graph.launch(probe_place.commit_updates, self.update_count, [views, updates], [pool, tiles], banded=False)
            graph.launch(probe_sample.make_rays, count, [grid, views, gbuffer, pool], [updates, self.rays])
        return self.rays, count + self.guests

    def record_light(
        self, graph: FrameGraph, views: wp.array, gbuffer: GBuffer,
        previous_color: wp.array, reprojection: Reprojection, parity: int = 0, known: DiffuseHistory | None = None,
        mirrored: wp.array | None = None, ways: wp.array | None = None,
    ) -> wp.array:
        """Record putting the rays' answers into the probes; returns the diffuse light of each pixel.

        vec4h per pixel: exposed irradiance / pi at the shading normal, and confidence 0..1 or KEPT
        (probe_interpolate.py); `specular_ratio` is what reflections get of it. With means of the frame before (`known`)
        pixels for which these do may leave turns out. `mirrored`: Mirrors.state of the rays; `ways`: where things have
        moved of late (MovedWays.array).
        """
        grid, pool, tiles, updates = self.grid, self.pool, self.tiles, self.updates
        with graph.section("Probe blending"):
            mirrored = wp.empty(0, dtype=int, device=self.device) if mirrored is None else mirrored
            ways = wp.empty(0, dtype=wp.vec3, device=self.device) if ways is None else ways
            with graph.slots(0, self.update_count * CELLS, len(mirrored)):
                graph.launch(probe_blend.detect_changes, graph.lanes * self.update_count,
                             [grid, views, self.rays, mirrored, ways, graph.lanes], [updates, pool])
            graph.launch(probe_blend.blend_rays, self.update_count * CELLS, [grid, views, updates, self.rays], [pool])
            graph.launch(probe_light.find_neighbors, self.update_count * 9, [grid, views, tiles, pool], [updates])
            graph.launch(probe_light.smooth_probes, self.update_count * CELLS, [grid, views, pool], [updates])
            graph.launch(probe_light.project_bands, self.update_count * BANDS,
                         [grid, updates, self.rays, self.weights], [pool])
        with graph.section("Probe interpolation"):
            before = InterpolatedBefore()
            before.reprojection, before.mean = reprojection, known or DiffuseHistory()
            before.ratio, self.specular_ratio = self._ratios.previous(parity), self._ratios.current(parity)
            images = [self.irradiance, self.specular_ratio]
            graph.launch(probe_records.record_probes, 2 * self.tile_count, [grid, views, tiles, pool], [self.records])
            graph.empty_list(self.unfilled)
            graph.launch(probe_interpolate.interpolate_probes, self.tile_count * TILE * TILE,
                         [grid, views, gbuffer, self.records, pool, self.moments, before, int(graph.cuda)],
                         [*images, self.unfilled.queue, self.unfilled.count])
            graph.launch_listed(
                probe_interpolate.fill_gaps, [grid, views, gbuffer, self.records, tiles, pool, self.moments],
                self.unfilled, images, few=True)
        if self.settings.contact_detail:
            with graph.section("Contact detail"):
                graph.launch(probe_contact.add_contact, self.width * self.height,
                             [grid, views, gbuffer, tiles, pool, previous_color, reprojection],
                             [self.irradiance, self.contact])
        else:
            graph.skip("contact detail", "switched off")
        return self.irradiance

    def record_look_ups(
        self, graph: FrameGraph, views: wp.array, gbuffer: GBuffer, options: ReflectionOptions, source: wp.array,
        samples: ReflectionSamples,
    ) -> None:
        """Record answering reflections from the probes; comes after record_light().

        Args:
            graph: Takes the launch.
            views: One View.
            gbuffer: Of this frame.
            options: Of the reflections.
            source: uint8 for each block; SOURCE_PROBE (reflection_types.py) where it asks the probes.
            samples: Have `place`; get the rest for these blocks.
        """
        graph.launch(
            reflection_probes.look_up_probes, options.columns * options.rows,
            [options, source, self.grid, views, gbuffer, self.records, self.pool, self.maps, self.irradiance,
             self.specular_ratio, self.moments], [samples])

    def record_debug(self, graph: FrameGraph, parity: int, name: str, picture: wp.array) -> None:
        """Record showing one of `debug_views` as linear colours, one vec4 per pixel."""
        count, views = self.width * self.height, self.views
        maps = {"probes.radiance": probe_debug.SHOW_RADIANCE, "probes.tiles": probe_debug.SHOW_TILES,
                "probes.age": probe_debug.SHOW_AGE, "probes.count": probe_debug.SHOW_COUNT}
        with graph.section("Debug view"):
            if name in maps:
                graph.launch(probe_debug.show_probes, count, [int(maps[name]), self.grid, views, self.tiles, self.pool],
                             [picture])
            elif name == "probes.specular":
                graph.launch(probe_debug.show_ratio, count, [self.specular_ratio], [picture])
            else:
                signed = int(name == "probes.contact")
                values = self.contact if signed else self.irradiance
                graph.launch(probe_debug.show_exposed, count, [signed, views, values], [picture])

    def stats(self) -> dict[str, int]:
        """Return counts of the last frame (waits for the device): probes in the pool and on screen, updates by kind."""
        used = self.pool.used.numpy()
        slot, tile, own = (getattr(self.updates, name).numpy() for name in ("slot", "tile", "own"))
        fresh = self.updates.fresh.numpy()
        active = slot >= 0
        return {
            "live": int((used > 0).sum()),
            "on screen": int((used == used.max()).sum()) if used.max() > 0 else 0,
            "updated": int(active.sum()),
            "spawned": int((active & (fresh == 1)).sum()),
            "patched": int((active & (tile != own)).sum()),
            "idle": int((~active).sum()),
            "rays": int(np.count_nonzero(self.rays.t_max.numpy() > 0.0)),
        }
