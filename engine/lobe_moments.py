# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of where rough surfaces' reflections come from (kernels/lobe_moments.py), made once for each device."""

from __future__ import annotations

import functools

import warp as wp

from ..kernels import lobe_moments as kernels
from .device import launch

__all__ = ["lobe_moments"]

NODES = int(kernels.LOBE_NODES)


@functools.cache
def lobe_moments(device: str) -> wp.array:
    """Return the moments of the GGX lobes: uint64 [16 * 16 * 2 * 2], see kernels.lobe_moments.integrate_lobes."""
    count = NODES * NODES * 2
    moments = wp.zeros(2 * count, dtype=wp.uint64, device=device)
    launch(kernels.integrate_lobes, count, [int(kernels.LOBE_SAMPLES)], [moments], device)
    return moments
