# SPDX-License-Identifier: GPL-3.0-or-later
"""The cache's rays over mirrors (kernels/cache_mirrors.py): which of a frame's rays go on, and what they meet then."""

from __future__ import annotations

import warp as wp

from ...kernels import compaction
from ...kernels.cache_mirrors import Mirrors
from ...kernels.paths import ENDED, Paths
from ...kernels.types import Scene
from ..frame_graph import FrameGraph
from ..history import copy_struct
from ..structures import has_layers
from ..work_list import WorkList, make_work_list
from .layer_rays import record_further

__all__ = ["MirrorRays"]


class MirrorRays:
    """Of all rays, a slot each; false in scenes without mirrors."""

    def __init__(self, paths: Paths, count: int, queue: wp.array, layered: WorkList, device: str):
        """Make room for `count` rays, 0 for none.

        Args:
            paths: The rays; those over mirrors lie in the same slots.
            count: Slots.
            queue: All slots.
            layered: Room for those that layers stand in the way of.
            device: Warp's name.
        """
        self.count, self._queue, self._layered = count, queue, layered
        self.struct = Mirrors()
        self.struct.state = wp.full(count, int(ENDED), dtype=int, device=device)
        self.struct.weight = wp.zeros(count, dtype=wp.vec4, device=device)
        self.struct.homes = wp.zeros(0, dtype=int, device=device)
        # To what traces rays all others have ended.
        self._paths = copy_struct(paths)
        self._paths.state = self.struct.state
        self._going_on = make_work_list(max(count, 1), device)

    def __bool__(self) -> bool:
        return self.count > 0

    def followed(self) -> int:
        """Return how many of the last frame's rays went on over mirrors. Waits for the device."""
        return int((self.struct.state.numpy() != int(ENDED)).sum())

    def record(self, graph: FrameGraph, scene: Scene, offset: int, count: int, *, lean: bool) -> WorkList:
        """Record finding what those of `count` rays from slot `offset` on meet that go on; return a list of them.

        `lean`: whether the lean node machine runs all transparency programs (MaterialTable.lean).
        """
        going_on = self._going_on.part(offset, count)
        graph.fill_list(compaction.append_mirrored, count, [self.struct, offset], going_on)
        record_further(
            graph, scene, self._paths, offset, count, going_on, self._queue, self._layered,
            filtered=has_layers(scene), lean=lean, through=True)
        return going_on
