# SPDX-License-Identifier: GPL-3.0-or-later
"""The compute device: choosing one, launching on it, its memory. The only place that starts Warp.

On CUDA a kernel is one launch. On the CPU a Warp launch uses one core, so kernels that write only their own
elements run as bands of elements on a thread pool (`run_bands`); a kernel with an atomic must be one launch, since
Warp's CPU atomics are not atomic (a test lints both).
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp

from .errors import BurnishError, DeviceUnavailable, OutOfDeviceMemory
from .function_hashes import share_function_hashes
from .kernel_cache import chosen_folder
from .settings import Device

__all__ = [
    "DeviceInfo", "block_size", "choose_device", "device_errors", "device_info", "hear_of_build", "hear_of_builds",
    "host_array", "is_loaded", "kernel_cache_folder", "launch", "launch_bands", "load_module", "loaded_modules",
    "run_bands", "start_warp", "thread_count", "use_threads", "used_memory",
]

# Threads a block on CUDA. Paths in a block end their kernels at very different times and a block's room is free only
# when its slowest warp is done: on an H100 a sample of Sponza takes 45.2, 38.9 and 37.5 ms with 256, 128 and 64. So do
# some filters, by 4 to 8 %.
PATH_BLOCK = 64
BLOCK_SIZES = dict.fromkeys(
    ("tracing", "flat_tracing", "flat_paths", "misses", "layers", "layers_lean", "materials", "reference",
     "reference_film", "reference_lean", "reference_plain", "denoise_guides_lean", "first_hits", "occlusion",
     "shadow_share", "shadow_layers", "shadow_layers_lean", "shadow_lights", "gbuffer_rays", "gbuffer_layers",
     "gbuffer_layers_lean", "gbuffer_exact", "materials_exact", "materials_hair", "reference_hair",
     "reference_hair_lean",
     "gbuffer_behind", "gbuffer_below", "gbuffer_lean", "gbuffer_materials", "cache_rays", "cache_lean",
     "cache_materials", "reflection_below", "reflection_walks", "hair_place", "hair_walk", "hair_full",
     "hair_lean", "hair_light",
     "cache_lights", "cache_programs", "decided_instances", "decided_layers", "direct_candidates", "direct_shadow",
     "direct_shade", "direct_shapes", "probe_interpolate", "reproject", "probe_blend", "probe_gather", "probe_light",
     "reflection_probes", "reflection_choice", "reflection_choice_glossy", "reflection_lean", "reflection_materials",
     "reflection_refract", "reflection_start", "reflection_tail", "reflection_trace", "reference_subsurface",
     "subsurface_walk", "media_march", "media_scatter", "media_shadows", "reflection_media",
     "volume_march", "volume_scatter", "volume_shadows", "direct_temporal",
     "antialias", "clear_tracing", "defocus_layers", "defocus_gather", "depth_of_field",
     "reflection_upscale", "reflection_cleanup", "reflection_atrous", "raster_resolve", "diffuse_temporal", "composite",
     "fog_blend", "fog_cells", "fog_composite", "fog_rays", "fog_samples"),
    PATH_BLOCK) | {"reflection_temporal": 128}
DEFAULT_BLOCK = 256

SIDE_BY_SIDE = (1, 19)
"""Version of Warp from which modules are known to build side by side for a processor"""

FUSED = "-ffp-contract=fast"
"""Lets the processor's compiler make one instruction of a product and a sum, as CUDA's does: 2 to 5 % of a sample's
time. By itself Warp allows it within an expression alone, and its code has one operation in each"""

BAND = 4096
"""Elements for which another thread is worth its start"""

_start_lock = threading.Lock()
_started = False
_loaded: set[tuple[str, str]] = set()
_load_locks: defaultdict[tuple[str, str], threading.Lock] = defaultdict(threading.Lock)
_first_load = threading.Lock()
_listeners = threading.local()
_pool: ThreadPoolExecutor | None = None
_threads = 0


@dataclass(frozen=True)
class DeviceInfo:
    """What is known about a device, for panels and reports."""

    alias: str
    """Warp's name: `cpu` or `cuda:0`"""
    name: str
    cuda: bool
    total_memory: int
    """Bytes; 0 where unknown"""
    free_memory: int
    warp_version: str
    driver: str


@contextlib.contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Hide what native code writes to file descriptor 2 (Warp's note that there is no CUDA driver)."""
    try:
        saved = os.dup(2)
    except OSError:
        yield
        return
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(sink)
        os.close(saved)


def start_warp() -> None:
    """Initialise Warp once, quietly.

    Raises:
        DeviceUnavailable: Warp's native library can't be loaded.
    """
    global _started
    with _start_lock:
        if _started:
            return
        wp.config.log_level = wp.LOG_ERROR
        if wp.config.kernel_cache_dir is None:  # else another extension has started Warp, which reads it only then
            wp.config.kernel_cache_dir = chosen_folder()
        try:
            with _quiet_stderr():
                wp.init()
        except Exception as error:
            raise DeviceUnavailable(f"NVIDIA Warp could not be started ({error}); reinstall the extension.") from error
        share_function_hashes()
        _started = True


def kernel_cache_folder() -> str:
    """Return the folder in which this process finds and keeps built kernels."""
    start_warp()
    return str(wp.config.kernel_cache_dir)


def choose_device(device: Device | str) -> str:
    """Return Warp's alias of the device that a setting asks for.

    Raises:
        DeviceUnavailable: CUDA is asked for and there is none.
    """
    start_warp()
    device = Device(device)
    if device == Device.CPU:
        return "cpu"
    if wp.is_cuda_available():
        return wp.get_preferred_device().alias if device == Device.AUTO else "cuda:0"
    if device == Device.CUDA:
        raise DeviceUnavailable("No CUDA device was found; install NVIDIA's driver or choose the device 'cpu'.")
    return "cpu"


def device_info(alias: str) -> DeviceInfo:
    """Return what is known about a device."""
    start_warp()
    device = wp.get_device(alias)
    return DeviceInfo(
        alias=alias,
        name=device.name,
        cuda=device.is_cuda,
        total_memory=int(device.total_memory) if device.is_cuda else 0,
        free_memory=int(device.free_memory) if device.is_cuda else 0,
        warp_version=wp.config.version,
        driver=".".join(map(str, wp.get_cuda_driver_version() or ())) if device.is_cuda else "",
    )


@contextlib.contextmanager
def device_errors(what: str) -> Iterator[None]:
    """Turn Warp's allocation and launch failures into sentences about `what`."""
    try:
        yield
    except BurnishError:
        raise
    except (MemoryError, RuntimeError) as error:
        text = str(error).lower()
        if isinstance(error, MemoryError) or "alloc" in text or "out of memory" in text:
            raise OutOfDeviceMemory(
                f"The device has not enough memory for {what}; lower the resolution or the texture budget.") from error
        raise


def thread_count() -> int:
    """Return how many threads render on the CPU."""
    return _threads or max(1, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


def use_threads(count: int) -> None:
    """Render on the CPU with so many threads from now on, whatever the number of cores; 0: one for each core."""
    global _threads, _pool
    with _start_lock:
        if _pool is not None:
            _pool.shutdown()
        _threads, _pool = count, None


def run_bands(jobs: Iterable[Callable[[], None]]) -> None:
    """Run jobs that touch disjoint elements on all cores and wait; the first failure is raised.

    Warp's launches release the interpreter lock, so Python threads scale. The caller's is one of them: to hand over
    each job costs as much as a small launch takes.
    """
    global _pool
    waiting = deque(jobs)
    helpers = min(thread_count(), len(waiting)) - 1

    def work() -> None:
        while True:
            try:
                job = waiting.popleft()
            except IndexError:
                return
            try:
                job()
            except BaseException:
                waiting.clear()
                raise

    if helpers <= 0:
        work()
        return
    with _start_lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(thread_count(), thread_name_prefix="burnish")
    futures = [_pool.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        # Those that others' jobs have kept from starting have nothing left to do.
        begun = [future for future in futures if not future.cancel()]
        wait(begun)
    for future in begun:
        future.result()


def block_size(module_name: str, device: str) -> int:
    """Return the threads a block with which a kernel module is launched (modules are built for one size)."""
    # On the CPU Warp launches one thread a block.
    return 1 if device == "cpu" else BLOCK_SIZES.get(module_name.rpartition(".")[2], DEFAULT_BLOCK)


def host_array(values: np.ndarray, dtype: type) -> wp.array:
    """Return a Warp array in the host's memory that shares contiguous values."""
    return wp.array(values, dtype=dtype, device="cpu", copy=False)


def load_module(name: str, device: str) -> bool:
    """Build or load a kernel module for a device, once: threads that did it at the same time would unload each other's.

    Different modules are built side by side, but for the first one on a processor, with which Warp makes its linker,
    and others there with older Warps.

    Returns:
        Whether it could be built. Raises what Warp does.
    """
    key = name, device
    if key in _loaded:
        return True
    hear_of_build(name.rpartition(".")[2])
    with _load_locks[key]:
        if key in _loaded:
            return True
        alone = device == "cpu" and not (loaded_modules(device) and SIDE_BY_SIDE <= _warp_version())
        with _first_load if alone else contextlib.nullcontext():
            module = wp.get_module(name)
            with fused_operations(module) if device == "cpu" else contextlib.nullcontext():
                loaded = module.load(wp.get_device(device), block_size(name, device)) is not None
            if loaded:
                _loaded.add(key)
    return loaded


@contextlib.contextmanager
def fused_operations(module: wp.Module) -> Iterator[None]:
    """Add FUSED to what a module is built with for the processor within the block; older Warps take no flags.

    What is built for a GPU afterwards must not have it: Warp looks for kernels on disk by all flags, and would build
    them anew where a processor was used first.
    """
    own = module.options.get("cpu_compiler_flags")
    flags = own if own is not None else getattr(wp.config, "cpu_compiler_flags", None)
    if flags is None or "-ffp-contract" in flags:
        yield
        return
    module.options["cpu_compiler_flags"] = f"{flags} {FUSED}".strip()
    try:
        yield
    finally:
        module.options["cpu_compiler_flags"] = own


def _warp_version() -> tuple[int, ...]:
    return tuple(int(part) for part in wp.config.version.split(".")[:2])


@contextlib.contextmanager
def hear_of_builds(hear: Callable[[str], None]) -> Iterator[None]:
    """Call `hear` with the name of each kernel module for which the calling thread has to wait within the block.

    What it raises ends what needs the module.
    """
    outer = getattr(_listeners, "hear", None)
    _listeners.hear = hear
    try:
        yield
    finally:
        _listeners.hear = outer


def hear_of_build(name: str) -> None:
    """Tell who listens in the calling thread, if anyone does, of kernels that it waits for."""
    hear = getattr(_listeners, "hear", None)
    if hear is not None:
        hear(name)


def loaded_modules(device: str) -> set[str]:
    """Return the names of the kernel modules that are loaded for a device."""
    return {name for name, where in tuple(_loaded) if where == device}


def is_loaded(kernel: wp.Kernel, device: str) -> bool:
    """Return whether a kernel can be launched without being waited for."""
    return (kernel.module.name, device) in _loaded


def launch(kernel: wp.Kernel, count: int, inputs: list, outputs: list, device: str) -> None:
    """Launch a kernel over `count` threads with its module's block size."""
    load_module(kernel.module.name, device)
    wp.launch(kernel, count, inputs, outputs, device=device, block_dim=block_size(kernel.module.name, device))


def launch_bands(kernel: wp.Kernel, first: int, count: int, inputs: list, outputs: list) -> None:
    """Launch a kernel over elements from `first` on, if any, on the CPU in bands on all cores."""
    device = outputs[0].device
    size = max(count // thread_count() + 1, BAND) if device.is_cpu else max(count, 1)
    run_bands([
        partial(launch, kernel, min(size, first + count - start), [start, *inputs], outputs, device.alias)
        for start in range(first, first + count, size)])


def record(kernel: wp.Kernel, inputs: list, outputs: list, device: str, count: int = 1) -> wp.Launch:
    """Prepare a launch that is repeated; where `count` changes, `set_dim` comes before each `launch`."""
    load_module(kernel.module.name, device)
    return wp.launch(kernel, count, inputs, outputs, device=device, block_dim=block_size(kernel.module.name, device),
                     record_cmd=True)


def used_memory(alias: str) -> int:
    """Return how many bytes Warp's pool has handed out on a device; 0 where there is none."""
    device = wp.get_device(alias)
    return int(wp.get_mempool_used_mem_current(device)) if device.is_cuda and device.is_mempool_enabled else 0
