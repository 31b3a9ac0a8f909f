# SPDX-License-Identifier: GPL-3.0-or-later
"""Building all kernel modules, with progress. Warp keeps the results on disk; a second start only loads them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed

from ..kernels import (
    antialias,
    cache_cells,
    cache_claim,
    cache_debug,
    cache_lean,
    cache_lights,
    cache_materials,
    cache_programs,
    cache_rays,
    cache_shade,
    cache_spread,
    clear_tracing,
    cluster_tree,
    compaction,
    composite,
    composite_debug,
    decided_instances,
    decided_layers,
    defocus,
    defocus_gather,
    defocus_layers,
    denoise_debug,
    denoise_guides,
    denoise_guides_lean,
    depth_of_field,
    diffuse_blur,
    diffuse_temporal,
    direct_atrous,
    direct_candidates,
    direct_change,
    direct_debug,
    direct_emitters,
    direct_shade,
    direct_shadow,
    direct_shapes,
    direct_temporal,
    display,
    environment,
    film,
    first_hits,
    flat_paths,
    flat_tracing,
    flatten,
    fog_blend,
    fog_cells,
    fog_composite,
    fog_rays,
    fog_samples,
    gather_blend,
    gather_further,
    gather_start,
    gather_temporal,
    gbuffer_behind,
    gbuffer_below,
    gbuffer_debug,
    gbuffer_exact,
    gbuffer_layers,
    gbuffer_layers_lean,
    gbuffer_lean,
    gbuffer_materials,
    gbuffer_rays,
    hair_full,
    hair_lean,
    hair_light,
    hair_place,
    hair_walk,
    lamp_bake,
    layers,
    layers_lean,
    light_groups,
    light_shares,
    light_split,
    lobe_moments,
    materials,
    materials_exact,
    materials_hair,
    media_march,
    media_scatter,
    media_shadows,
    mesh_checks,
    mesh_islands,
    mip_levels,
    misses,
    occlusion,
    opacity_answers,
    opacity_maps,
    path_lists,
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
    probe_spawn,
    raster,
    raster_resolve,
    reference,
    reference_film,
    reference_hair,
    reference_hair_lean,
    reference_lean,
    reference_plain,
    reference_subsurface,
    reflection_atrous,
    reflection_below,
    reflection_blocks,
    reflection_choice,
    reflection_choice_glossy,
    reflection_cleanup,
    reflection_debug,
    reflection_filter_debug,
    reflection_lamps,
    reflection_lean,
    reflection_materials,
    reflection_media,
    reflection_place,
    reflection_probes,
    reflection_refract,
    reflection_resolve,
    reflection_resolve_glossy,
    reflection_screen,
    reflection_start,
    reflection_tail,
    reflection_temporal,
    reflection_trace,
    reflection_upscale,
    reflection_walks,
    reproject,
    rest_blend,
    shadow_catcher,
    shadow_layers,
    shadow_layers_lean,
    shadow_lights,
    shadow_share,
    subsurface_walk,
    supersampling,
    tracing,
    tree_reinsertion,
    triangle_split,
    tube_items,
    volume_bake,
    volume_march,
    volume_scatter,
    volume_shadows,
    wide_bvh_build,
    wide_bvh_edit,
    wide_instances_edit,
    world_split,
)
from .device import load_module, start_warp, thread_count
from .errors import KernelBuildFailed

__all__ = ["KERNEL_MODULES", "warm_up"]

KERNEL_MODULES = (
    fog_blend, fog_cells, fog_composite, fog_rays, fog_samples, supersampling,
    film, display, shadow_catcher, compaction, path_lists, light_split, tracing, flat_tracing, flat_paths, flatten,
    cluster_tree, tree_reinsertion, triangle_split, tube_items, wide_bvh_build, wide_bvh_edit, wide_instances_edit,
    opacity_maps, opacity_answers, decided_instances, decided_layers, clear_tracing, lobe_moments,
    antialias, cache_cells, cache_claim, cache_debug, cache_lights, cache_rays, cache_shade, cache_spread, composite,
    composite_debug, denoise_debug, gather_blend, gather_temporal, probe_contact, diffuse_blur, diffuse_temporal,
    defocus, defocus_layers, defocus_gather, depth_of_field,
    direct_atrous, direct_candidates, direct_change, direct_debug, direct_emitters, direct_shadow, direct_temporal,
    gbuffer_debug, gbuffer_rays, probe_blend, probe_debug, probe_gather, probe_interpolate, probe_light, probe_map,
    probe_place, probe_records, probe_sample, probe_spawn, raster, raster_resolve, reproject, rest_blend, occlusion,
    shadow_share, environment, world_split, lamp_bake, misses,
    layers, shadow_layers, shadow_lights, materials, materials_exact, reference, cache_lean, cache_materials,
    cache_programs, direct_shade, direct_shapes, gbuffer_layers, gbuffer_behind, gbuffer_layers_lean, gbuffer_lean,
    gbuffer_materials, gbuffer_exact, gbuffer_below, reflection_below, reflection_walks, hair_place, hair_walk,
    hair_light, hair_lean, hair_full, layers_lean, shadow_layers_lean, reflection_place, reflection_choice,
    reflection_debug, reflection_filter_debug,
    reflection_choice_glossy, reflection_resolve_glossy,
    reflection_trace, reflection_lamps, reflection_screen, reflection_resolve, reflection_start, reflection_probes,
    reflection_blocks, reflection_cleanup, reflection_atrous, reflection_upscale, reflection_temporal, reflection_lean,
    reflection_refract, gather_start, gather_further, reflection_tail, reflection_materials, light_groups, light_shares,
    subsurface_walk, denoise_guides, denoise_guides_lean, reference_film, reference_lean, reference_plain,
    reference_subsurface, reference_hair, reference_hair_lean, materials_hair, first_hits, media_march, media_scatter,
    media_shadows, reflection_media, volume_bake, volume_march, volume_scatter, volume_shadows,
)
"""Modules that own kernels, the quickest to build first; but those below, and albedo_tables, which tables.py loads."""

HOST_MODULES = (mesh_checks, mesh_islands, mip_levels)
"""Modules that the processor alone runs, whatever the device: it reads meshes and images"""

SHARED_MODULES = (cluster_tree, tree_reinsertion)
"""Modules that the processor runs as well where it isn't the device"""

_lock = threading.Lock()
_ready: set[str] = set()


def warm_up(device: str, progress: Callable[[str, int, int], None] | None = None) -> float:
    """Build or load every kernel module for a device and return the seconds that it took.

    Args:
        device: `cpu` or `cuda:N`.
        progress: Called before each module with its name, its number from 1 and how many there are.

    Raises:
        KernelBuildFailed: A module can't be compiled or loaded.
    """
    start_warp()
    start = time.perf_counter()
    with _lock:
        if device in _ready:
            return 0.0
        names, own = ([module.__name__ for module in modules] for modules in (KERNEL_MODULES, HOST_MODULES))
        if device == "cpu":
            names, own = [], names + own
        else:
            own += [module.__name__ for module in SHARED_MODULES]
        count = len(names) + len(own)
        with ThreadPoolExecutor(thread_count()) as pool:
            # The longest first: none is left for the end then, when threads have nothing else to do.
            loads = {pool.submit(_load, name, device): name for name in reversed(names)}
            _tell(progress, (names or own)[-1], 1, count)
            for number, load in enumerate(as_completed(loads), 1):
                _tell(progress, loads[load], number, count)
                load.result()
        for number, name in enumerate(own, len(names) + 1):
            _tell(progress, name, number, count)
            _load(name, "cpu")
        _ready.add(device)
    return time.perf_counter() - start


def _tell(progress: Callable[[str, int, int], None] | None, name: str, number: int, count: int) -> None:
    if progress is not None:
        progress(name.rpartition(".")[2], number, count)


def _load(name: str, device: str) -> None:
    """Build or load one module."""
    title = name.rpartition(".")[2]
    try:
        loaded = load_module(name, device)
    except Exception as error:
        raise KernelBuildFailed(f"The kernels '{title}' could not be built for {device}: {error}") from error
    if not loaded:
        raise KernelBuildFailed(f"The kernels '{title}' could not be built for {device}; see the console.")
