# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels whose rays go on behind clear glass (clear_glass.py); in scenes without it others take their place."""

from __future__ import annotations

import warp as wp

from .cache_rays import finish_cache_shadow
from .clear_glass import dim_all, dim_flat, follow_all, follow_flat
from .clear_paths import dim_path_all, dim_path_flat
from .decided_instances import meet_all_layers
from .decided_layers import meet_layers
from .intersect import MISS
from .list_order import first_listed
from .paths import ENDED, Paths
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel(cuda_max_registers=64)
def trace_flat_clear_rays(
    first: int,
    # In:
    scene: Scene,
    offset: int,
    decided: int,
    # Out:
    paths_out: Paths,
):
    """Find what every ray from slot `offset` on meets, by chance behind clear glass.

    `decided` 1: rays decide about the layers on their way, too (decided_layers.py).
    """
    slot = offset + first + wp.tid()
    if paths_out.state[slot] == ENDED:
        paths_out.hit[slot] = wp.vec2i(MISS, 0)
        return
    follow_flat(scene, paths_out, slot)
    if decided == 1:
        meet_layers(scene.geometry, paths_out, slot)


@wp.kernel(cuda_max_registers=80)
def trace_clear_rays(
    first: int,
    # In:
    scene: Scene,
    offset: int,
    decided: int,
    # Out:
    paths_out: Paths,
):
    """Do as trace_flat_clear_rays in scenes where not all is flattened."""
    slot = offset + first + wp.tid()
    if paths_out.state[slot] == ENDED:
        paths_out.hit[slot] = wp.vec2i(MISS, 0)
        return
    follow_all(scene, paths_out, slot)
    if decided == 1:
        meet_all_layers(scene.geometry, paths_out, slot)


@wp.kernel(cuda_max_registers=64)
def trace_flat_clear_further(
    # In:
    scene: Scene,
    decided: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Do as trace_flat_clear_rays for listed rays."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        if paths_out.state[slot] != ENDED:
            follow_flat(scene, paths_out, slot)
            if decided == 1:
                meet_layers(scene.geometry, paths_out, slot)


@wp.kernel(cuda_max_registers=80)
def trace_clear_further(
    # In:
    scene: Scene,
    decided: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Do as trace_clear_rays for listed rays."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        if paths_out.state[slot] != ENDED:
            follow_all(scene, paths_out, slot)
            if decided == 1:
                meet_all_layers(scene.geometry, paths_out, slot)


@wp.kernel(cuda_max_registers=64)
def dim_flat_shadows(
    first: int,
    # In:
    scene: Scene,
    # Out:
    rays_out: Paths,
):
    """Weaken shadow rays by clear glass and end those that anything opaque blocks."""
    slot = first + wp.tid()
    distance = rays_out.shadow_distance[slot]
    if distance > 0.0:
        dim_flat(scene, rays_out, slot, distance)


@wp.kernel(cuda_max_registers=80)
def dim_shadows(
    first: int,
    # In:
    scene: Scene,
    # Out:
    rays_out: Paths,
):
    """Do as dim_flat_shadows in scenes where not all is flattened."""
    slot = first + wp.tid()
    distance = rays_out.shadow_distance[slot]
    if distance > 0.0:
        dim_all(scene, rays_out, slot, distance)


@wp.kernel(cuda_max_registers=64)
def dim_flat_cache_shadows(
    # In:
    scene: Scene,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Do as dim_flat_shadows for listed rays of hits; see cache_rays.finish_cache_shadow."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[slot]
        if distance > 0.0:
            dim_flat(scene, paths_out, slot, distance)
        if distance != 0.0:
            finish_cache_shadow(paths_out, slot, paths_out.shadow_distance[slot] == 0.0, filtered)


@wp.kernel(cuda_max_registers=80)
def dim_cache_shadows(
    # In:
    scene: Scene,
    filtered: int,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Do as dim_flat_cache_shadows in scenes where not all is flattened."""
    i = wp.tid()
    while i < count[0]:
        slot = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[slot]
        if distance > 0.0:
            dim_all(scene, paths_out, slot, distance)
        if distance != 0.0:
            finish_cache_shadow(paths_out, slot, paths_out.shadow_distance[slot] == 0.0, filtered)


@wp.kernel(cuda_max_registers=64)
def dim_flat_path_shadows(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Weaken listed shadow rays of the path tracer by panes, and end those that anything else opaque blocks."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[path]
        if distance > 0.0:
            dim_path_flat(scene, paths_out, path, distance)


@wp.kernel(cuda_max_registers=80)
def dim_path_shadows(
    # In:
    scene: Scene,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Do as dim_flat_path_shadows in scenes where not all is flattened."""
    i = first_listed(wp.tid(), stride, count[0])
    while i < count[0]:
        path = queue[i]
        i = i + stride
        distance = paths_out.shadow_distance[path]
        if distance > 0.0:
            dim_path_all(scene, paths_out, path, distance)
