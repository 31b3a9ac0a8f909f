# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording how rays and shadow rays look through transparent layers: triangles that need a test per hit."""

from __future__ import annotations

import warp as wp

from ...kernels import (
    cache_rays,
    clear_tracing,
    compaction,
    decided_instances,
    decided_layers,
    direct_shadow,
    flat_tracing,
    layers,
    layers_lean,
    reflection_trace,
    shadow_layers,
    shadow_layers_lean,
    tracing,
)
from ...kernels.paths import Paths
from ...kernels.types import Scene
from ..clear_glass import passes_glass
from ..frame_graph import FrameGraph
from ..shadow_rays import make_options
from ..structures import decides_layers, is_flat, without_opaque
from ..work_list import WorkList, one_number

__all__ = ["record_further", "record_hits", "record_layers", "record_shadow_layers", "record_shadows"]


def record_shadows(
    graph: FrameGraph, scene: Scene, rays: Paths, count: int, queue: wp.array, layered: WorkList, *, filtered: bool,
    lean: bool,
) -> None:
    """Record finding what is in the way of `count` shadow rays from visible places, and weakening or ending them.

    Args:
        graph: What to add to.
        scene: The scene.
        rays: The shadow rays.
        count: Their number.
        queue: All slots, where any triangle needs a test.
        layered: Room for those that layers stand in the way of.
        filtered: Whether any triangle needs a test per hit.
        lean: Whether the lean node machine runs all transparency programs (MaterialTable.lean).
    """
    between, flat = scene, is_flat(scene)
    if passes_glass(scene):
        graph.launch(clear_tracing.dim_flat_shadows if flat else clear_tracing.dim_shadows, count, [scene], [rays])
        between = without_opaque(scene)
    elif not (filtered and decides_layers(scene)):
        trace = flat_tracing.trace_flat_shadows if flat else direct_shadow.trace_direct_shadows
        graph.launch(trace, count, [scene], [rays])
    if filtered:
        record_shadow_layers(graph, between, rays, 0, count, queue, layered, bounces=0, lean=lean)


def record_hits(
    graph: FrameGraph, scene: Scene, paths: Paths, offset: int, count: int, queue: wp.array, layered: WorkList, *,
    filtered: bool, lean: bool, through: bool = False,
) -> None:
    """Record finding what rays meet.

    `filtered`: whether any triangle needs a test; `through`: whether they go on behind clear glass; else as
    record_layers.
    """
    decided = filtered and decides_layers(scene)
    if through and passes_glass(scene):
        trace = clear_tracing.trace_flat_clear_rays if is_flat(scene) else clear_tracing.trace_clear_rays
        graph.launch(trace, count, [scene, offset, int(decided)], [paths])
        if filtered and not decided:
            record_layers(graph, scene, paths, offset, count, queue, layered, lean=lean)
        return
    if decided:
        graph.launch(
            decided_layers.trace_decided_rays if is_flat(scene) else decided_instances.trace_all_decided_rays, count,
            [scene, offset], [paths])
        return
    trace = flat_tracing.trace_flat_rays if is_flat(scene) else cache_rays.trace_cache_rays
    graph.launch(trace, count, [scene, offset], [paths])
    if filtered:
        record_layers(graph, scene, paths, offset, count, queue, layered, lean=lean)


def record_further(
    graph: FrameGraph, scene: Scene, paths: Paths, offset: int, count: int, going_on: WorkList, queue: wp.array,
    layered: WorkList, *, filtered: bool, lean: bool, through: bool,
) -> None:
    """Record finding what the listed of `count` rays from slot `offset` on meet; else as record_hits.

    `going_on`: the list. Rays whose state is ENDED are left alone: on the processor they are in it too.
    """
    flat, decided = is_flat(scene), filtered and decides_layers(scene)
    if through and passes_glass(scene):
        trace = clear_tracing.trace_flat_clear_further if flat else clear_tracing.trace_clear_further
        graph.launch_listed(trace, [scene, int(decided)], going_on, [paths], few=True)
        if filtered and not decided:
            record_layers(graph, scene, paths, offset, count, queue, layered, lean=lean)
        return
    if decided:
        trace = decided_layers.trace_decided_further if flat else decided_instances.trace_all_decided_further
        graph.launch_listed(trace, [scene], going_on, [paths], few=True)
        return
    trace = flat_tracing.trace_flat_further if flat else reflection_trace.trace_further
    graph.launch_listed(trace, [scene, int(filtered)], going_on, [paths], few=True)
    if filtered:
        record_layers(graph, scene, paths, offset, count, queue, layered, lean=lean, traced=True)


def record_layers(
    graph: FrameGraph, scene: Scene, paths: Paths, offset: int, count: int, queue: wp.array, layered: WorkList, *,
    lean: bool, traced: bool = False,
) -> None:
    """Record looking through the layers in front of rays' hits.

    Args:
        graph: What to add to.
        scene: The scene.
        paths: The rays.
        offset: Their first slot.
        count: Their number.
        queue: All slots.
        layered: Room for those of all slots that layers stand in the way of.
        lean: Whether the lean node machine runs all transparency programs (MaterialTable.lean).
        traced: Whether the first layer of each is known.
    """
    queue, layered = queue[offset : offset + count], layered.part(offset, count)
    if not traced:
        if is_flat(scene):
            graph.launch(flat_tracing.trace_flat_layers, count, [scene, offset], [paths])
        else:
            graph.launch_queued(tracing.trace_layers, [scene], queue, [paths])
    if lean:
        graph.fill_list(compaction.append_layered_paths, count, [paths, offset], layered)
        graph.launch_listed(layers_lean.filter_paths_lean, [scene], layered, [paths], few=True)
    else:
        graph.launch_queued(layers.filter_paths, [scene], queue, [paths])


def record_shadow_layers(
    graph: FrameGraph, scene: Scene, paths: Paths, offset: int, count: int, queue: wp.array, layered: WorkList, *,
    bounces: int, lean: bool, under_way: WorkList | None = None,
) -> None:
    """Record weakening shadow rays by the layers that they meet, after `bounces` surfaces.

    `under_way`: those slots that have a shadow ray, where they are known; else as record_layers. Where rays decide
    layers this also traces them against opaque triangles.
    """
    queue, layered = queue[offset : offset + count], layered.part(offset, count)
    shadows = [scene, make_options(filtered=True), one_number(bounces, graph.device)]
    decided = decides_layers(scene)
    if decided:
        trace = (decided_layers.trace_decided_shadows if is_flat(scene)
                 else decided_instances.trace_all_decided_shadows)
    else:
        trace = flat_tracing.trace_flat_shadow_layers if is_flat(scene) else tracing.trace_shadow_layers
    if under_way is not None:
        graph.launch_listed(trace, shadows, under_way, [paths])
    else:
        graph.launch_queued(trace, shadows, queue, [paths])
    if decided:
        return
    if lean:
        graph.fill_list(compaction.append_layered_shadows, count, [paths, offset], layered)
        graph.launch_listed(shadow_layers_lean.weaken_shadow_rays_lean, shadows, layered, [paths], few=True)
    else:
        graph.launch_queued(shadow_layers.weaken_shadow_rays, shadows, queue, [paths])
