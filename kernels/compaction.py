# SPDX-License-Identifier: GPL-3.0-or-later
"""Compaction of the queue of living paths (CUDA only: its atomic append must be one launch, never bands)."""

from __future__ import annotations

import warp as wp

from .paths import ENDED

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def append_living(
    # In:
    state: wp.array[int],
    queue: wp.array[int],
    # Out:
    queue_out: wp.array[int],
    count_out: wp.array[int],
):
    """Append the paths that go on to the next queue; their order does not matter to any picture."""
    path = queue[wp.tid()]
    if state[path] != ENDED:
        queue_out[wp.atomic_add(count_out, 0, 1)] = path
