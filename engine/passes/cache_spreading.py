# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording how light spreads through the radiance cache: its balance, and sweeps from cell to cell within a frame."""

from __future__ import annotations

import warp as wp

from ...kernels import cache_spread
from ...kernels.cache_cells import CacheControl
from ...kernels.cache_rays import Vertices
from ...kernels.hash_grid import HashGrid
from ...kernels.paths import Paths
from ..frame_graph import FrameGraph

__all__ = ["SWEEPS", "light_sweeps", "record_spreading"]

SWEEPS = 6
"""Times that light goes on from cell to cell in a frame while it spreads: what is left after them the balance mends"""


def light_sweeps(frame: int, light_age: int) -> bool:
    """Tell whether light goes on from cell to cell within a frame, as cache_spread.sweeping does (View's counters)."""
    return min(light_age, frame) < float(cache_spread.SWEEP_FRAMES)


def record_spreading(
    graph: FrameGraph, views: wp.array, grid: HashGrid, control: CacheControl, paths: Paths, vertices: Vertices,
    count: int, bounces: int, sample_cap: float, *, all_bounces: bool,
) -> None:
    """Record finding what bounce rays carry from cell to cell; comes between gathering and adding up their light.

    Args:
        graph: Takes the launches.
        views: One View.
        grid: The cells.
        control: Has the factors of the balance afterwards.
        paths: The frame's rays.
        vertices: Where they ended; `carried` is found anew in sweeps.
        count: Probe rays: slots before those of the bounce rays.
        bounces: Slots of bounce rays.
        sample_cap: Most samples that a cell averages over while something moves.
        all_bounces: Whether cells light each other, and in frames that may sweep at all (light_sweeps).
    """
    graph.launch(cache_spread.balance_bounces, bounces, [views], [grid, control, vertices], banded=False)
    graph.launch(cache_spread.measure_balance, 1, [views, 0], [control], banded=False)
    if not all_bounces:
        return
    graph.launch(cache_spread.find_beyond, bounces, [views, grid, paths, count], [vertices])
    for sweep in range(SWEEPS):
        graph.launch(cache_spread.spread_cells, len(grid.keys), [views, control, sample_cap], [grid])
        graph.launch(
            cache_spread.spread_light, bounces, [views, count, int(sweep + 1 < SWEEPS)], [grid, control, vertices],
            banded=False)
    graph.launch(cache_spread.measure_balance, 1, [views, 1], [control], banded=False)
