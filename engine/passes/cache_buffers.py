# SPDX-License-Identifier: GPL-3.0-or-later
"""Buffers of the radiance cache, and of other passes whose rays put their hits into it; what both do with them."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...kernels import (
    cache_cells,
    cache_claim,
    cache_lean,
    cache_materials,
    cache_mirror_lamps,
    cache_programs,
    cache_rays,
    clear_tracing,
    compaction,
    flat_tracing,
    fog_rays,
)
from ...kernels.cache_cells import CacheControl
from ...kernels.cache_rays import Vertices
from ...kernels.fog import Fog
from ...kernels.hash_grid import BUCKET, NO_CELL, HashGrid
from ...kernels.paths import Paths
from ...kernels.types import Closure, Scene
from ..clear_glass import passes_glass
from ..device import launch
from ..frame_graph import FrameGraph
from ..settings import CacheKey, CacheSettings
from ..structures import decides_layers, is_flat, without_opaque
from ..work_list import WorkList
from .fog_ways import FogWays
from .layer_rays import record_shadow_layers
from .mirror_rays import MirrorRays

__all__ = [
    "count_rays", "make_control", "make_grid", "make_paths", "make_rays", "record_insertion", "record_materials",
    "record_shadow_rays", "record_sums", "threads_race",
]

RAY_ARRAYS = {
    "state": int, "origin": wp.vec3, "direction": wp.vec3, "t": float, "hit": wp.vec2i, "barycentrics": wp.vec2,
    "radiance": wp.vec4, "pdf": float, "shadow_origin": wp.vec3, "shadow_direction": wp.vec3, "shadow_distance": float,
    "shadow_light": wp.vec3, "shadow_pending": int, "shadow_emitter": wp.vec2i, "shadow_barycentrics": wp.vec2,
}
LAYER_ARRAYS = {
    "seed": wp.uint32, "index": wp.uint32, "throughput": wp.vec3, "kind": int, "cone": wp.vec2, "overruns": int,
    "layer_t": float, "layer": wp.vec2i, "layer_barycentrics": wp.vec2,
}
"""For scenes with triangles that need a test per hit"""
STATE_ARRAYS = {"seed": wp.uint32, "index": wp.uint32, "throughput": wp.vec3, "kind": int, "cone": wp.vec2,
                "receiver": int}
"""What rays over mirrors need in every scene; the rest of LAYER_ARRAYS is for scenes with layers alone"""
UNUSED_ARRAYS = {
    "closure": Closure, "surface_normal": wp.vec4, "surface_position": wp.vec4, "surface_uv": wp.vec4,
    "surface_emission": wp.vec3, "environment": wp.vec3, "receiver": int,
}
"""Of the path tracer's states"""

VERTEX_ARRAYS = {
    "position": wp.vec4, "geometric_normal": wp.uint32, "normal": wp.uint32, "reflectance": wp.vec4,
    "emission": wp.vec4, "cell": int,
}
HIGHLIGHT_ARRAYS = {"lobe": wp.uint64, "highlight": float}
"""Of hits that may show highlights (kernels/cache_highlights.py)"""
BOUNCE_ARRAYS = {"source": int, "coarse": wp.int64, "arrived": wp.vec3, "carried": wp.vec3, "around": int,
                 "far": int, "beyond": int}

CELL_ARRAYS = {
    "keys": (wp.int64, 1), "direct": (wp.vec4, 1), "indirect": (wp.vec4, 1), "spread": (wp.vec4, 1),
    "touched": (int, 1), "linked": (int, 1), "sums": (wp.int64, 6), "counts": (int, 2),
    "crossing": (int, 2), "way_share": (float, 2),
}
"""Type and entries a cell"""

COUNTERS = {
    "rays": cache_cells.COUNT_RAYS, "bounce rays": cache_cells.COUNT_BOUNCES,
    "shadow rays": cache_cells.COUNT_SHADOWS, "cells failed": cache_cells.COUNT_FAILED,
    "hits": cache_cells.COUNT_HITS, "hits without indirect light": cache_cells.COUNT_UNKNOWN,
}
"""Statistics and their places in count_rays"""


def make_grid(settings: CacheSettings, device: str) -> HashGrid:
    """Return empty cells."""
    grid, capacity = HashGrid(), 1 << settings.capacity
    for name, (dtype, entries) in CELL_ARRAYS.items():
        setattr(grid, name, wp.zeros(capacity * entries, dtype=dtype, device=device))
    grid.live = wp.zeros(1, dtype=int, device=device)
    grid.ways = wp.zeros(1, dtype=wp.vec3, device=device)
    grid.bucket_mask = capacity // int(BUCKET) - 1
    grid.pixels = settings.cell_pixels
    grid.minimum = settings.minimum_cell
    grid.level_blend, grid.scan_all = int(settings.level_blend), int(settings.scan_all)
    grid.directions = int(settings.key == CacheKey.DIRECTION)
    # Only where cells read each other's indirect light, of which the bounce rays' share of emission is a part.
    grid.weighed = int(settings.bounces not in (1, 2) and settings.bounce_share > 0.0)
    return grid


def make_control(device: str) -> CacheControl:
    """Return counters and sums of no frames."""
    control, lanes = CacheControl(), int(cache_cells.LANES)
    control.age, control.live = wp.zeros(1, dtype=int, device=device), wp.zeros(1, dtype=int, device=device)
    control.balance = wp.zeros(2 * lanes * 9, dtype=wp.int64, device=device)
    control.factors = wp.full(2, wp.vec3(1.0, 1.0, 1.0), dtype=wp.vec3, device=device)
    control.counters = wp.zeros(lanes * int(cache_cells.COUNTERS), dtype=int, device=device)
    return control


def make_rays(count: int, bounces: int, filtered: bool, glossy: bool, device: str) -> tuple[Paths, Vertices]:
    """Return arrays for `count` rays and `bounces` bounce rays.

    `filtered`: some triangles need a test per hit; `glossy`: hits may show highlights.
    """
    paths, vertices, total = Paths(), Vertices(), count + bounces
    groups = (
        (paths, RAY_ARRAYS, total), (paths, LAYER_ARRAYS, total if filtered else 1), (paths, UNUSED_ARRAYS, 1),
        (vertices, VERTEX_ARRAYS, total), (vertices, BOUNCE_ARRAYS, bounces))
    for owner, arrays, size in groups:
        for name, dtype in arrays.items():
            setattr(owner, name, wp.zeros(max(size, 1), dtype=dtype, device=device))
    for name, dtype in HIGHLIGHT_ARRAYS.items():
        setattr(vertices, name, wp.zeros(total if glossy else 0, dtype=dtype, device=device))
    vertices.cell.fill_(int(NO_CELL))
    return paths, vertices


def make_paths(count: int, filtered: bool, device: str) -> Paths:
    """Return arrays for `count` rays that go on over surfaces; `filtered`: some triangles need a test per hit."""
    paths = Paths()
    for arrays, size in ((RAY_ARRAYS, count), (UNUSED_ARRAYS, 1), (LAYER_ARRAYS, count if filtered else 1),
                         (STATE_ARRAYS, count)):
        for name, dtype in arrays.items():
            setattr(paths, name, wp.zeros(size, dtype=dtype, device=device))
    return paths


def count_rays(
    paths: Paths, vertices: Vertices, grid: HashGrid, count: int, control: CacheControl, slots: int,
) -> np.ndarray:
    """Return the last frame's counts, by cache_cells.COUNT_*, and wait for the device.

    Of the first `slots` slots; the first `count` rays are no bounces.
    """
    control.counters.zero_()
    launch(cache_cells.count_rays, slots, [paths, vertices, grid, count], [control],
           str(control.counters.device))
    return control.counters.numpy().reshape(int(cache_cells.LANES), -1).sum(0, dtype=np.int64)


def threads_race(device: str) -> bool:
    """Return whether the threads of a launch with atomics come in an order that differs from run to run."""
    return wp.get_device(device).is_cuda


def record_insertion(
    graph: FrameGraph, views: wp.array, paths: Paths, vertices: Vertices, grid: HashGrid, offset: int, count: int, *,
    deterministic: bool,
) -> None:
    """Record finding or making the cells of `count` hits from slot `offset` on.

    With `deterministic` which cells find room, and where, depends on their keys alone (cache_claim.py).
    """
    if deterministic:
        graph.launch(cache_claim.claim_vertices, count, [views, paths, vertices, offset], [grid], banded=False)
        graph.launch(cache_claim.settle_cells, len(grid.keys), [], [grid], banded=False)
    graph.launch(cache_cells.insert_vertices, count, [views, paths, offset], [grid, vertices], banded=False)


def record_materials(
    graph: FrameGraph, scene: Scene, views: wp.array, paths: Paths, vertices: Vertices, world: wp.array, offset: int,
    count: int, what: list, left: WorkList | None, ways: FogWays | None, mirrors: MirrorRays, lean_layers: bool,
) -> None:
    """Record what the hits of `count` rays from slot `offset` on are made of, and what fog before them does.

    Those on mirrors are followed to what is seen there.

    Args:
        graph: What to add to.
        scene: The scene.
        views: One View.
        paths: The rays.
        vertices: Their hits.
        world: The world's radiance by texels, where it is known (DeviceScene.world_texels).
        offset: First slot.
        count: Number of slots.
        what: `bounce`, `weighed`, `threshold` and `filtered` of evaluate_cache_materials.
        left: Room for those hits that need the full node machine; None: there are none.
        ways: What fog does on their ways; None: there is none.
        mirrors: Those of the rays that go on over mirrors.
        lean_layers: Whether the lean node machine runs all transparency programs.
    """
    found = [paths, mirrors.struct, vertices]
    graph.launch(cache_lean.evaluate_cache_lean, count, [views, scene, world, offset, *what], found)
    if left is not None:
        graph.fill_list(compaction.append_left_hits, count, [vertices.emission, offset], left)
        graph.launch_listed(cache_materials.evaluate_cache_materials, [views, scene, *what], left, found, few=True)
    if mirrors:
        going_on = mirrors.record(graph, scene, offset, count, lean=lean_layers)
        graph.launch_listed(
            cache_lean.evaluate_mirrored_lean, [views, scene, world, *what], going_on, found, few=True)
        if left is not None:
            graph.launch_listed(
                cache_materials.evaluate_cache_materials, [views, scene, *what], going_on, found, few=True)
        if scene.lights.lamp_count > 0:
            graph.launch_listed(
                cache_mirror_lamps.meet_mirrored_lamps, [views, scene, what[-1], paths, mirrors.struct], going_on,
                [vertices], few=True)
    if ways is not None:
        ways.record(graph, views, scene, paths, vertices, offset, count)


def record_sums(
    graph: FrameGraph, views: wp.array, paths: Paths, vertices: Vertices, grid: HashGrid, offset: int, count: int,
    bounces: int,
) -> None:
    """Record adding the light of `count` hits from slot `offset` on to their cells, for the next update_cells.

    Slots from `bounces` on are bounce rays, whose sources get theirs.
    """
    graph.launch(
        cache_cells.accumulate_light, count, [views, paths, vertices, offset, bounces], [grid], banded=False)


def record_shadow_rays(
    graph: FrameGraph, views: wp.array, scene: Scene, paths: Paths, offset: int, count: int, queue: wp.array,
    under_way: WorkList, layered: WorkList, pending: WorkList, *, filtered: bool, lean_layers: bool, programs: bool,
    fog: Fog | None = None,
) -> None:
    """Record tracing hits' shadow rays to the lights chosen for them; what arrives is `paths.radiance`.

    Args:
        graph: What to add to.
        views: One View.
        scene: The scene.
        paths: Their rays.
        offset: Their first slot.
        count: Their number.
        queue: All slots, where there are triangles that need a test.
        under_way: Room for those that have a shadow ray.
        layered: Where there are triangles that need a test: room for those that transparent layers stand in the way of.
        pending: Room for those that reach lights whose radiance is a program.
        filtered: Whether the scene has triangles that need a test per hit (Structures.has_filtered).
        lean_layers: Whether the lean node machine runs all transparency programs (MaterialTable.lean).
        programs: Whether lights may be programs (DeviceScene.has_hit_programs).
        fog: What is in their way; None: nothing.
    """
    under_way = under_way.part(offset, count)
    graph.fill_list(compaction.append_shadows, count, [paths, offset], under_way)
    if fog is not None:
        graph.launch_listed(fog_rays.dim_listed_shadow_rays, [views, scene, fog], under_way, [paths])
    between = scene
    if passes_glass(scene):
        dim = clear_tracing.dim_flat_cache_shadows if is_flat(scene) else clear_tracing.dim_cache_shadows
        graph.launch_listed(dim, [scene, int(filtered)], under_way, [paths])
        between = without_opaque(scene)
    elif not filtered or not decides_layers(scene):
        trace = flat_tracing.trace_flat_cache_shadows if is_flat(scene) else cache_rays.trace_cache_shadows
        graph.launch_listed(trace, [scene, int(filtered)], under_way, [paths])
    if filtered:
        record_shadow_layers(
            graph, between, paths, offset, count, queue, layered, bounces=1, lean=lean_layers, under_way=under_way)
    if programs:
        pending = pending.part(offset, count)
        graph.fill_list(compaction.append_pending_shadows, count, [paths, offset], pending)
        graph.launch_listed(cache_programs.finish_cache_lights, [scene], pending, [paths])
