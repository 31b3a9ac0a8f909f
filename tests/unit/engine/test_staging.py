# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the row that the host sends for every frame, and how pictures come back."""

from __future__ import annotations

import numpy as np
import warp as wp
from burnish.engine.staging import AHEAD, PictureInbox, StagedRow

wp.set_module_options({"enable_backward": False})


@wp.struct
class Row:
    """Some numbers."""

    number: int
    place: wp.vec3


@wp.kernel
def copy_row(rows: wp.array[Row], index: int, numbers_out: wp.array[int], places_out: wp.array[wp.vec3]):
    """Note what a row holds."""
    numbers_out[index] = rows[0].number
    places_out[index] = rows[0].place


def test_launches_see_their_own_row(device):
    """Send more rows than may be on their way, each before a launch, and wait for none: each launch sees its own."""
    staged, count = StagedRow(Row, device), 4 * AHEAD + 1
    numbers = wp.zeros(count, dtype=int, device=device)
    places = wp.zeros(count, dtype=wp.vec3, device=device)
    for index in range(count):
        staged.row["number"], staged.row["place"] = index + 1, (index, 2.0 * index, -1.0)
        staged.send()
        wp.launch(copy_row, 1, [staged.array, index, numbers, places], device=device)
    assert numbers.numpy().tolist() == list(range(1, count + 1))
    steps = np.arange(count)
    np.testing.assert_array_equal(places.numpy(), np.stack([steps, 2.0 * steps, np.full(count, -1.0)], 1))


def test_pictures_arrive_whole(device):
    """Read pictures of several sizes and types one after the other, each as it is at that time."""
    inbox, rng = PictureInbox(), np.random.default_rng(3)
    for count, dtype, width in ((7, wp.vec4, 4), (4096, wp.vec4, 4), (4096, wp.vec3, 3), (7, wp.vec4, 4)):
        values = rng.random((count, width), dtype=np.float32)
        picture = wp.array(values, dtype=dtype, device=device)
        np.testing.assert_array_equal(inbox.read(picture), values)
        picture.fill_(2.0)
        assert (inbox.read(picture) == 2.0).all()
