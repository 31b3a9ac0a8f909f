# SPDX-License-Identifier: GPL-3.0-or-later
"""Priorities of the kernels in a CUDA graph.

Where kernels run side by side, blocks of those with a higher priority begin first. Kernels are captured with the
priority of their stream, but a graph runs all of them with that of the stream it is launched on unless it is
instantiated with a flag that Warp does not set, and Warp's streams know two levels of a device's six (CUDA driver API,
sections "Stream Management" and "Graph Management"). Without priorities a chain of short kernels beside long ones
waits, for each of its links, until all blocks of these have begun.
"""

from __future__ import annotations

import ctypes
import functools
import sys
import weakref

import warp as wp

__all__ = ["LEVELS", "TRUNK", "keep_priorities", "make_stream"]

TRUNK = ""
"""Name of what is on no branch"""

LEVELS = {"other pixels": 3, TRUNK: 2, "reflections": 1, "refraction": 1, "final gather": 1, "bounces": 1}
"""Of a frame's branches by name, 0 of those not named: the higher, the sooner their kernels begin"""

NON_BLOCKING = 1
"""CU_STREAM_NON_BLOCKING: does not wait for the default stream, which nothing may do while it is captured"""

USE_NODE_PRIORITY = 8
"""CUDA_GRAPH_INSTANTIATE_FLAG_USE_NODE_PRIORITY"""


@functools.cache
def _driver() -> ctypes.CDLL | None:
    """Return CUDA's driver with the functions used here, None where there is none."""
    try:
        driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        driver.cuStreamCreateWithPriority.argtypes = [ctypes.POINTER(ctypes.c_void_p), ctypes.c_uint, ctypes.c_int]
        driver.cuStreamDestroy_v2.argtypes = [ctypes.c_void_p]
        driver.cuGraphInstantiateWithFlags.argtypes = [
            ctypes.POINTER(ctypes.c_void_p), ctypes.c_void_p, ctypes.c_ulonglong]
    except (OSError, AttributeError):
        return None
    return driver


def make_stream(device: str, level: int) -> wp.Stream:
    """Make a stream to capture kernels on: the higher its level (0 or more), the sooner they begin.

    Levels beyond those of the device count as its highest; without the driver's functions all are the same.
    """
    driver, handle = _driver(), ctypes.c_void_p()
    with wp.ScopedDevice(device):
        if driver is None or driver.cuStreamCreateWithPriority(ctypes.byref(handle), NON_BLOCKING, -level) != 0:
            return wp.Stream(device)
        stream = wp.Stream(device, cuda_stream=handle.value)
    weakref.finalize(stream, driver.cuStreamDestroy_v2, handle).atexit = False
    return stream


def keep_priorities(graph: wp.Graph) -> None:
    """Instantiate a captured graph so that its kernels keep their priorities.

    Where that can't be done, Warp instantiates the graph when it is launched: slower, with the same results.
    """
    driver = _driver()
    if driver is None or getattr(graph, "graph", None) is None or getattr(graph, "graph_exec", 0) is not None:
        return
    executable = ctypes.c_void_p()
    with wp.ScopedDevice(graph.device):
        failed = driver.cuGraphInstantiateWithFlags(ctypes.byref(executable), graph.graph, USE_NODE_PRIORITY) != 0
    if executable and not failed:
        graph.graph_exec = executable
