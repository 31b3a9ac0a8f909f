# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels do without a new sample of direct light in motion: their means over the frames before do for them."""

from __future__ import annotations

import warp as wp

from .camera_motion import only_camera_moves
from .direct_reservoir import TILE_SLOTS, DirectOptions, tile_columns
from .direct_temporal import DirectHistory, albedos
from .gbuffer import GBuffer
from .long_mean import pixel_before
from .packed_halves import unpack_halves
from .reprojection import Reprojection
from .view import View

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Frames in a pixel's mean from which on neighbours lend it nothing, and it leaves out every other turn of its own.
KNOWN_FRAMES = wp.constant(4.0)
# Part of the direct light that may be reflected by a pixel that does: highlights are elsewhere for each view.
WEAK_HIGHLIGHT = wp.constant(0.1)


@wp.func
def known_pixel(
    view: View, options: DirectOptions, reprojection: Reprojection, history: DirectHistory, pixel: int,
) -> int:
    """Return the pixel of the frame before whose mean does for one: long, of the same surface, nothing changes; or -1.

    `history` is of the frame before; without elements: no mean is kept.
    """
    if history.length.shape[0] == 0 or not only_camera_moves(view):
        return -1
    before = pixel_before(reprojection, pixel, options.width)
    if before < 0 or float(history.length[before]) < KNOWN_FRAMES:
        return -1
    return before


@wp.func
def leaves_turn_out(
    view: View, options: DirectOptions, gbuffer: GBuffer, reprojection: Reprojection, history: DirectHistory,
    slot: int, pixel: int,
) -> bool:
    """Return whether a pixel that has a sample of its own in this frame waits for its next turn.

    Every other tile may in a frame, as on a chessboard: where all of its pixels do, its warp has nothing to do.
    """
    tile = slot // TILE_SLOTS
    columns = tile_columns(options)
    turn = tile % columns + tile // columns + (view.frame >> 1)
    if options.quarter_rate == 0 or (turn & 1) == 1:
        return False
    before = known_pixel(view, options, reprojection, history, pixel)
    if before < 0:
        return False
    moments = unpack_halves(history.moments[before])
    albedo = albedos(gbuffer, pixel)
    return albedo[1] * moments[3] <= WEAK_HIGHLIGHT * albedo[0] * moments[2]
