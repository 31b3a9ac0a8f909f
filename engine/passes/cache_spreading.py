# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording how light spreads through the radiance cache: its balance, and sweeps from cell to cell within a frame."""

from __future__ import annotations

import enum

import warp as wp

from ...kernels import cache_cells, cache_rays, cache_spread
from ...kernels.cache_cells import CacheControl
from ...kernels.cache_rays import Vertices
from ...kernels.hash_grid import BUCKET, HashGrid
from ...kernels.paths import Paths
from ...kernels.view import MOVED_FRAMES
from ..frame_graph import FrameGraph
from ..work_list import LISTED_THREADS, WorkList

__all__ = [
    "FURTHER_SHARES", "SWEEPS", "LightPhase", "light_phase", "record_coarse_cells", "record_continuing",
    "record_spreading", "sweeps",
]

SWEEPS = 16
"""Times that light goes on from cell to cell in a frame while it spreads: what is left after them the balance mends"""

FURTHER_SHARES = (0.5, 0.25)
"""Rays by bounce ray that go on from where bounce rays have ended in the same frame while light spreads, and from there
again. A third of them find cells from which none has started: they cost 4 to 5 % of such a frame's rays"""

PROCESSOR_THREADS = 1 << 12
"""The same as work_list.LISTED_THREADS on a processor: enough to be dealt out evenly over its cores"""

SETTLED = int(cache_cells.REBALANCE_FRAMES) + 1
"""Frames after which the balance has left the cells alone for one frame"""


class LightPhase(enum.Enum):
    """How far light has spread since the first frame or the last edit of light."""

    SWEEPING = "sweeping"
    """It goes on from cell to cell within a frame."""
    SPREADING = "spreading"
    """It takes a frame for each bounce; cells are kept in balance."""
    SETTLED = "settled"
    """Cells are means of many frames."""


def light_phase(frame: int, light_age: int, moved_age: int, *, resting: bool) -> LightPhase:
    """Return the phase of a frame, by View's counters; as cache_spread.sweeping and REBALANCE_FRAMES.

    Where something but the camera has moved light counts as still spreading: bounce rays of the frame before would
    start where surfaces were, and shadows may have changed (kernels/direct_change.py), for which frames that are
    `resting` need no record of their own.
    """
    age = min(light_age, frame)
    if age < float(cache_spread.SWEEP_FRAMES):
        return LightPhase.SWEEPING
    moved = moved_age < (1 if resting else int(MOVED_FRAMES))
    return LightPhase.SPREADING if age < SETTLED or moved else LightPhase.SETTLED


def sweeps(views: wp.array) -> bool:
    """Return whether the last frame of one View was LightPhase.SWEEPING; waits for the device."""
    view = views.numpy()[0]
    return min(view["light_age"], view["frame"]) < float(cache_spread.SWEEP_FRAMES)


def record_continuing(
    graph: FrameGraph, views: wp.array, grid: HashGrid, paths: Paths, vertices: Vertices, count: int, begin: int,
    width: int, further: int, filtered: int,
) -> None:
    """Record sending `further` rays on from where `width` bounce rays of this frame, from `begin` on, have ended.

    Theirs are the slots of the bounce rays after those. Other arguments as of record_spreading; `filtered` 1: they
    may meet transparent layers.
    """
    graph.launch(cache_rays.mark_sources, width, [views, vertices, begin], [grid], banded=False)
    graph.launch(
        cache_rays.continue_bounces, further, [views, grid, count, begin, width, further, filtered], [paths, vertices])


def record_coarse_cells(
    graph: FrameGraph, views: wp.array, grid: HashGrid, control: CacheControl, vertices: Vertices, bounces: int,
) -> None:
    """Record making the coarse cells about the bounce rays' sources; sums up the balance while there is one."""
    graph.launch(cache_spread.balance_bounces, bounces, [views], [grid, control, vertices], banded=False)


def record_spreading(
    graph: FrameGraph, views: wp.array, grid: HashGrid, control: CacheControl, paths: Paths, vertices: Vertices,
    live: WorkList, count: int, bounces: int, sample_cap: float, *, all_bounces: bool,
) -> None:
    """Record finding what bounce rays carry from cell to cell; comes between gathering and adding up their light.

    Args:
        graph: Takes the launches.
        views: One View.
        grid: The cells.
        control: Has the factors of the balance afterwards.
        paths: The frame's rays.
        vertices: Where they ended; `carried` is found anew in sweeps.
        live: Takes the cells in use, with room for all.
        count: Probe rays: slots before those of the bounce rays.
        bounces: Slots of bounce rays.
        sample_cap: Most samples that a cell averages over while something moves.
        all_bounces: Whether cells light each other, and in frames that may sweep at all (LightPhase.SWEEPING).
    """
    record_coarse_cells(graph, views, grid, control, vertices, bounces)
    graph.launch(cache_spread.measure_balance, 1, [views, 0], [control], banded=False)
    if not all_bounces:
        return
    graph.launch(
        cache_spread.find_beyond, bounces, [views, control, paths, count], [grid, vertices], banded=False)
    # Of a million cells some thousand are in use.
    graph.clear(live.count)
    graph.launch(
        cache_spread.list_cells, len(grid.keys) // int(BUCKET), [views, grid], [live.queue, live.count], banded=False)
    threads = min(len(live.queue), LISTED_THREADS if graph.cuda else PROCESSOR_THREADS)
    for sweep in range(SWEEPS):
        graph.launch(
            cache_spread.spread_cells, threads, [views, control, sample_cap, live.queue, live.count, threads], [grid])
        graph.launch(
            cache_spread.spread_light, bounces, [views, count, int(sweep + 1 < SWEEPS)], [grid, control, vertices],
            banded=False)
    graph.launch(cache_spread.measure_balance, 1, [views, 1], [control], banded=False)
