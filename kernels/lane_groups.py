# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums over threads that share one element.

Where a launch has few elements with much to read for each, a GPU's threads wait for memory one load after the other.
GROUP neighbours of a warp share an element there: each takes every GROUP-th part of it, and their sums are added up. On
the processor, and wherever `lanes` is 1, one thread does it all.
"""

from __future__ import annotations

import warp as wp

__all__ = ["GROUP", "group_sum"]

GROUP = 8
"""Threads that share an element; a warp has a whole number of such groups"""


@wp.func_native("""
#ifdef __CUDA_ARCH__
    if (lanes == GROUP) {
        // Of this group alone: others of the warp may have ended.
        const unsigned int group = 0xffu << (threadIdx.x & 24u);
        float sum = value;
        sum += __shfl_xor_sync(group, sum, 1);
        sum += __shfl_xor_sync(group, sum, 2);
        sum += __shfl_xor_sync(group, sum, 4);
        return sum;
    }
#endif
    return value;
""".replace("GROUP", str(GROUP)))
def group_sum(value: float, lanes: int) -> float:
    """Return the sum of the values of `lanes` threads, 1 or GROUP, all of which must call it, to each of them.

    Groups must begin where a multiple of GROUP threads of a block has gone before.
    """
    ...
