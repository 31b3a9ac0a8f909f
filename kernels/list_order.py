# SPDX-License-Identifier: GPL-3.0-or-later
"""Which elements of a short list a thread takes.

Threads of a warp wait for each other: for each other's way through the BVH, and for all kinds of surfaces that any of
them meets. Where a list has fewer elements than a GPU has room for threads, they are dealt out over all warps.
"""

from __future__ import annotations

import warp as wp

__all__ = ["first_dealt"]

WARP = wp.constant(32)
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
