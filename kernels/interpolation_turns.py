# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels do without new light from the probes while only the camera moves: their means do for it."""

from __future__ import annotations

import warp as wp

from .camera_motion import only_camera_moves
from .diffuse_temporal import DiffuseHistory
from .long_mean import pixel_before, unpack_mean
from .packed_halves import unpack_halves
from .packing import rgba, to_half
from .probe_types import ProbeGrid
from .reprojection import Reprojection
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Confidence that marks a pixel with what its mean was in the frame before: nothing new, which counts for nothing.
KEPT = wp.constant(-2.0)
# Frames in a pixel's mean from which on it does for a turn.
KNOWN_FRAMES = wp.constant(4.0)


@wp.struct
class InterpolatedBefore:
    """What the frame before knew of the light from probes, and where; without elements: nothing is kept."""

    reprojection: Reprojection
    """Of this frame"""
    mean: DiffuseHistory
    ratio: wp.array[wp.float16]
    """ScreenProbePass.specular_ratio"""


@wp.func
def known_pixel(view: View, grid: ProbeGrid, before: InterpolatedBefore, tile: int, pixel: int) -> int:
    """Return the pixel of the frame before whose light does for one of a tile; -1: it has its turn, or none does.

    Every other tile leaves a frame out, as on a chessboard: where all of its pixels do, its warps have nothing to do.
    """
    turn = tile % grid.tile_columns + tile // grid.tile_columns + view.frame
    if grid.half_rate == 0 or (turn & 1) == 1 or before.mean.state.shape[0] == 0 or not only_camera_moves(view):
        return -1
    found = pixel_before(before.reprojection, pixel, grid.width)
    if found < 0:
        return -1
    state = unpack_halves(before.mean.state[found])
    return wp.where(state[0] >= KNOWN_FRAMES and state[3] == 0.0, found, -1)


@wp.func
def kept_light(before: InterpolatedBefore, found: int) -> wp.vec4h:
    """Return what a pixel of the frame before knew, as kernels have it of this frame's: KEPT."""
    return to_half(rgba(unpack_mean(before.mean.irradiance[found]), KEPT))
