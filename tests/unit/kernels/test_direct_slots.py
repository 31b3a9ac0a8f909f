# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the slots of direct light: one for each pixel, colours of a checkerboard after one another, tiles in warps."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from burnish.engine.passes.direct_light import slots_of
from burnish.kernels.direct_reservoir import SIDE, TILE_SLOTS, DirectOptions, pixel_of_slot, slot_of_pixel
from burnish.kernels.view import View

from tests.device import DEVICE

wp.set_module_options({"enable_backward": False})


@wp.kernel
def go_round(views: wp.array[View], options: DirectOptions, pixels_out: wp.array[int], slots_out: wp.array[int]):
    """Return each slot's pixel, and that pixel's slot."""
    slot = wp.tid()
    pixels_out[slot] = pixel_of_slot(views[0], options, slot)
    slots_out[slot] = slot
    if pixels_out[slot] >= 0:
        slots_out[slot] = slot_of_pixel(views[0], options, pixels_out[slot])


@pytest.mark.parametrize("frame", [0, 7])
@pytest.mark.parametrize("size", [(1, 1), (8, 8), (13, 9), (64, 3), (2, 17)])
def test_each_pixel_has_a_slot(size: tuple[int, int], frame: int) -> None:
    """Find the way back from each slot's pixel, every pixel once, those of a frame's colour first, a tile in a warp."""
    width, height = size
    row = np.zeros(1, View.numpy_dtype())
    row["frame"] = frame
    options = DirectOptions()
    options.width, options.height = size
    count = slots_of(width, height)
    pixels, slots = (wp.zeros(count, dtype=int, device=DEVICE) for _ in range(2))
    wp.launch(go_round, count, [wp.array(row, dtype=View, device=DEVICE), options], [pixels, slots], device=DEVICE)
    pixels = pixels.numpy()
    np.testing.assert_array_equal(slots.numpy(), np.arange(count))
    valid = pixels >= 0
    np.testing.assert_array_equal(np.sort(pixels[valid]), np.arange(width * height))
    x, y = pixels % width, pixels // width
    first = np.arange(count) < count // 2
    np.testing.assert_array_equal(((x + y + frame) % 2 == 0)[valid], first[valid])
    tiles = (y // int(SIDE) * 1000 + x // int(SIDE)).reshape(-1, int(TILE_SLOTS))
    for tile, used in zip(tiles, valid.reshape(tiles.shape), strict=True):
        assert len(set(tile[used])) <= 1
