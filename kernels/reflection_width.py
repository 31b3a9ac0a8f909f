# SPDX-License-Identifier: GPL-3.0-or-later
"""How wide the filters of reflections stay at rest: as wide as the error that is left is worth."""

from __future__ import annotations

import warp as wp

from .long_mean import unpack_mean
from .packed_halves import unpack_halves
from .reflection_blocks import ReflectionHistory, light_strength
from .view import View

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Frames at rest between which the filters shrink to nothing, where the mean's relative error lies below the first; they
# stay as wide as they were where it is above the second. Light below ERROR_FLOOR is too dark to see errors in.
REST_START = wp.constant(16.0)
REST_END = wp.constant(160.0)
ERROR_LOW = wp.constant(0.01)
ERROR_HIGH = wp.constant(0.04)
ERROR_FLOOR = wp.constant(0.02)


@wp.func
def filter_reach(view: View) -> float:
    """Return by how much filters are narrower: 1 in motion, falling to nearly 0 at rest."""
    rest = float(wp.min(view.rest, view.light_age))
    return wp.clamp((REST_END - rest) / (REST_END - REST_START), 1.0e-3, 1.0)


@wp.func
def error_reach(history: ReflectionHistory, pixel: int) -> float:
    """Return how much of a filter's width is worth keeping at rest, 0..1, by the error left in a pixel's mean."""
    state = unpack_halves(history.state[pixel])
    error = state[2] / wp.sqrt(wp.max(wp.abs(state[0]), 1.0))
    error = error / (light_strength(unpack_mean(history.light[pixel])) + ERROR_FLOOR)
    return wp.clamp((error - ERROR_LOW) / (ERROR_HIGH - ERROR_LOW), 0.0, 1.0)
