# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists of elements that a frame's kernels fill and work off: of many pixels or rays, the few that need more work.

Where one element in many does, a kernel over all of them has few busy threads in each warp and as long a tail in each
block. The list makes warps full. On the processor, where neither matters, it holds all elements once and for all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..kernels.list_order import EACH_ONE

__all__ = ["FEW_THREADS", "LISTED_THREADS", "ONCE", "WorkList", "make_queue", "make_work_list", "one_number"]

LISTED_THREADS = 1 << 18
"""Most threads that share a list's elements: some times what a large GPU has at work at a time, so that blocks that
end early make room for others; those without an element cost some microseconds"""

FEW_THREADS = 1 << 16
"""The same for lists that are mostly short, for kernels whose threads take a new element as soon as they are done with
one, and for the full node machine: as many as a large GPU has at work at a time, or some more"""

ONCE = int(EACH_ONE)
"""Number of threads to tell where each has one element"""


@dataclass
class WorkList:
    """Elements to work on."""

    queue: wp.array
    """int: elements"""
    count: wp.array
    """int [1]: how many they are"""

    def part(self, first: int, count: int) -> WorkList:
        """Return the list for `count` elements from one on."""
        return WorkList(self.queue[first : first + count], self.count)


def one_number(value: int, device: str) -> wp.array:
    """Return an array of one number, for kernels that may find another there at every launch."""
    return wp.array([value], dtype=int, device=device)


def make_queue(count: int, device: str) -> wp.array:
    """Return the queue of all elements in order."""
    return wp.array(np.arange(count, dtype=np.int32), dtype=int, device=device)


def make_work_list(capacity: int, device: str) -> WorkList:
    """Return a list with room for so many elements; on the processor it holds them all."""
    if wp.get_device(device).is_cuda:
        return WorkList(wp.zeros(capacity, dtype=int, device=device), one_number(0, device))
    return WorkList(make_queue(capacity, device), one_number(capacity, device))
