# SPDX-License-Identifier: GPL-3.0-or-later
"""Building all kernel modules, with progress. Warp keeps the results on disk; a second start only loads them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import warp as wp

from ..kernels import (
    albedo_tables,
    compaction,
    display,
    environment,
    film,
    flatten,
    layers,
    materials,
    misses,
    reference,
    shadow_layers,
    shadow_lights,
    tracing,
)
from .device import block_size, start_warp
from .errors import KernelBuildFailed

__all__ = ["KERNEL_MODULES", "warm_up"]

KERNEL_MODULES = (
    film, display, compaction, tracing, albedo_tables, flatten, environment, misses, layers, shadow_layers,
    shadow_lights, materials, reference,
)
"""Modules that own kernels, the quickest to build first."""

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
    # One at a time: concurrent first loads of CPU modules race in Warp.
    with _lock:
        if device in _ready:
            return 0.0
        for number, module in enumerate(KERNEL_MODULES, 1):
            name = module.__name__.rpartition(".")[2]
            if progress is not None:
                progress(name, number, len(KERNEL_MODULES))
            try:
                size = block_size(module.__name__, device)
                loaded = wp.get_module(module.__name__).load(wp.get_device(device), size)
            except Exception as error:
                raise KernelBuildFailed(f"The kernels '{name}' could not be built for {device}: {error}") from error
            if loaded is None:
                raise KernelBuildFailed(f"The kernels '{name}' could not be built for {device}; see the console.")
        _ready.add(device)
    return time.perf_counter() - start
