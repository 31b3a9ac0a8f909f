# SPDX-License-Identifier: GPL-3.0-or-later
"""Building kernel modules, with progress. Warp keeps the results on disk; a second start only loads them."""

from __future__ import annotations

import atexit
import logging
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from types import ModuleType

from ..kernels import (
    antialias,
    cache_cells,
    cache_claim,
    cache_debug,
    cache_lean,
    cache_lights,
    cache_materials,
    cache_mirror_lamps,
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
    probe_turns,
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
    reflection_movers,
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
    rest_lonely,
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
from .device import hear_of_build, load_module, loaded_modules, start_warp, thread_count
from .errors import KernelBuildFailed
from .settings import Integrator

__all__ = ["FIRST_MODULES", "KERNEL_MODULES", "build_rest", "warm_up"]

log = logging.getLogger(__name__)

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
    probe_place, probe_records, probe_sample, probe_spawn, probe_turns, raster, raster_resolve, reproject, rest_blend,
    rest_lonely,
    occlusion, shadow_share, environment, world_split, lamp_bake, misses,
    layers, shadow_layers, shadow_lights, materials, materials_exact, reference, cache_lean, cache_materials,
    cache_mirror_lamps, cache_programs,
    direct_shade, direct_shapes, gbuffer_layers, gbuffer_behind, gbuffer_layers_lean, gbuffer_lean,
    gbuffer_materials, gbuffer_exact, gbuffer_below, reflection_below, reflection_walks, hair_place, hair_walk,
    hair_light, hair_lean, hair_full, layers_lean, shadow_layers_lean, reflection_place, reflection_choice,
    reflection_debug, reflection_filter_debug,
    reflection_choice_glossy, reflection_resolve_glossy,
    reflection_trace, reflection_movers, reflection_lamps, reflection_screen, reflection_resolve, reflection_start,
    reflection_probes, reflection_blocks, reflection_cleanup, reflection_atrous, reflection_upscale,
    reflection_temporal, reflection_lean,
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

EVERY_PICTURE = (
    tube_items, triangle_split, cluster_tree, tree_reinsertion, wide_bvh_build, flatten, tracing, flat_paths, misses,
    path_lists, film, display, materials, reference, shadow_lights, reference_lean, reference_plain, mesh_checks,
    mip_levels,
)
"""What most scenes need before they are path-traced, as real-time frames are at rest"""

EVERY_FRAME = (
    antialias, cache_cells, cache_rays, cache_lights, cache_shade, cache_spread, composite, diffuse_blur,
    diffuse_temporal, direct_atrous, direct_change, direct_emitters, direct_shadow, direct_temporal, flat_tracing,
    gather_blend, gather_temporal, gbuffer_rays, lobe_moments, probe_blend, probe_gather, probe_interpolate,
    probe_light, probe_map, probe_place, probe_records, probe_sample, probe_spawn, probe_turns, reproject, rest_blend,
    rest_lonely,
    world_split, direct_candidates, direct_shade, cache_lean, cache_materials, gbuffer_lean, gbuffer_materials,
    gather_start, gather_further, reflection_atrous, reflection_blocks, reflection_choice, reflection_choice_glossy,
    reflection_cleanup, reflection_lamps, reflection_lean, reflection_materials, reflection_movers, reflection_place,
    reflection_probes, reflection_resolve, reflection_resolve_glossy, reflection_screen, reflection_start,
    reflection_tail, reflection_temporal, reflection_upscale,
)
"""What most scenes need besides in real-time frames on a processor"""

FIRST_MODULES = {Integrator.REFERENCE: EVERY_PICTURE, Integrator.REALTIME: EVERY_PICTURE + EVERY_FRAME}
"""What is built on a processor before the first picture. Others are built when something needs them, or meanwhile"""

BUILDERS = 16
"""Modules that are built at once, at most: each takes some hundred megabytes"""

_lock = threading.Lock()
_rest_lock = threading.Lock()
_stopping = threading.Event()
_rest: threading.Thread | None = None


def warm_up(
    device: str, progress: Callable[[str, int, int], None] | None = None, integrator: Integrator | None = None,
) -> float:
    """Build or load kernel modules for a device, on all cores, and return the seconds that it took.

    Args:
        device: `cpu` or `cuda:N`.
        progress: Called before each module with its name, its number from 1 and how many there are; what it raises
            ends the build. None: who listens in the calling thread (device.hear_of_builds) is told.
        integrator: On a processor only what most of its pictures need; None, and on other devices: every module.

    Raises:
        KernelBuildFailed: A module can't be compiled or loaded.
    """
    start_warp()
    start = time.perf_counter()
    modules = FIRST_MODULES.get(integrator) if device == "cpu" else None
    # Who lacks nothing does not wait for what another thread builds.
    if not _missing(device, modules):
        return 0.0
    with _lock:
        wanted = _missing(device, modules)
        if not wanted:
            return 0.0
        # The first one for a processor has to be alone; it is a short one.
        alone = int(device == "cpu" and not loaded_modules(device))
        _tell(progress, wanted[0][0], 1, len(wanted))
        for module in wanted[:alone]:
            _load(*module)
        with ThreadPoolExecutor(min(thread_count(), BUILDERS)) as pool:
            # The longest first: none is left for the end then, when threads have nothing else to do.
            loads = {pool.submit(_load, *module): module[0] for module in reversed(wanted[alone:])}
            try:
                for number, load in enumerate(as_completed(loads), 1 + alone):
                    _tell(progress, loads[load], number, len(wanted))
                    load.result()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return time.perf_counter() - start


def build_rest(device: str) -> None:
    """Begin to build all other modules for a processor, one after the other in a thread: an edit may need any of them.

    Does nothing on other devices, which have them all.
    """
    global _rest
    if device != "cpu" or _rest is not None:
        return
    with _rest_lock:
        if _rest is None:
            _rest = threading.Thread(target=_build_rest, args=(device,), name="burnish kernels", daemon=True)
            atexit.register(_stop)
            _rest.start()


def _build_rest(device: str) -> None:
    for name, where in _missing(device, None):
        if _stopping.is_set():
            break
        try:
            _load(name, where)
        except KernelBuildFailed:
            # Whatever needs it will tell.
            log.exception("Kernels could not be built ahead of time")


def _stop() -> None:
    """Let no compiler run while the process ends."""
    _stopping.set()
    _rest.join()


def _missing(device: str, modules: Sequence[ModuleType] | None) -> list[tuple[str, str]]:
    """Return names and devices of modules that are not loaded, the quickest to build first; None: of all."""
    beside = HOST_MODULES if device == "cpu" else HOST_MODULES + SHARED_MODULES
    wanted = [(module, "cpu") for module in beside] + [(module, device) for module in KERNEL_MODULES]
    loaded = {where: loaded_modules(where) for where in ("cpu", device)}
    return [(module.__name__, where) for module, where in wanted
            if (modules is None or module in modules) and module.__name__ not in loaded[where]]


def _tell(progress: Callable[[str, int, int], None] | None, name: str, number: int, count: int) -> None:
    title = name.rpartition(".")[2]
    if progress is not None:
        progress(title, number, count)
    else:
        hear_of_build(title)


def _load(name: str, device: str) -> None:
    """Build or load one module."""
    title = name.rpartition(".")[2]
    try:
        loaded = load_module(name, device)
    except Exception as error:
        raise KernelBuildFailed(f"The kernels '{title}' could not be built for {device}: {error}") from error
    if not loaded:
        raise KernelBuildFailed(f"The kernels '{title}' could not be built for {device}; see the console.")
