# SPDX-License-Identifier: GPL-3.0-or-later
"""Which elements of a short list a thread takes.

Threads of a warp wait for each other: for each other's way through the BVH, and for all kinds of surfaces that any of
them meets. Where a list has fewer elements than a GPU has room for threads, they are dealt out over all warps.
"""

from __future__ import annotations

import warp as wp

__all__ = ["first_dealt", "first_listed"]

WARP = wp.constant(32)
# Warps that a large GPU has at work at a time, of kernels with many registers.
BUSY_WARPS = wp.constant(1 << 10)
# Number of threads to tell where each has one element, as on the processor, which has no warps.
EACH_ONE = wp.constant(1 << 30)


@wp.func
def first_dealt(thread: int, threads: int) -> int:
    """Return the first element of a thread of a launch, which takes each element `threads` further on too.

    The first as many elements as there are warps go to a warp each, and so on.
    """
    if threads >= EACH_ONE or threads % WARP != 0:
        return thread
    return thread % WARP * (threads // WARP) + thread // WARP


@wp.func
def first_listed(thread: int, threads: int, count: int) -> int:
    """Return the first element of a thread for a list of any length, or `count` where it has none.

    It takes each element `threads` further on too. Long lists are taken in their order, so that a warp's elements lie
    close together; of short ones each warp has fewer elements, down to one, as long as there are warps that idle.
    """
    lanes = wp.min(wp.min(threads, BUSY_WARPS * WARP) // wp.max(count, 1), WARP)
    if lanes < 2 or threads >= EACH_ONE:
        return thread
    if thread % lanes != 0:
        return count
    return thread // lanes
