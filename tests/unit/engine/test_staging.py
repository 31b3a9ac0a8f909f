# SPDX-License-Identifier: GPL-3.0-or-later
"""Test the row that the host sends for every frame, and how pictures come back."""

from __future__ import annotations

import weakref

import numpy as np
import warp as wp
from burnish.engine.staging import (
    AHEAD,
    NEAR_ROWS,
    PAGE_ROWS,
    PicturePages,
    RowWriter,
    StagedRow,
)

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
    pages, rng = PicturePages(), np.random.default_rng(3)
    for count, dtype, width in ((7, wp.vec4, 4), (4096, wp.vec4, 4), (4096, wp.vec3, 3), (7, wp.vec4, 4)):
        values = rng.random((count, width), dtype=np.float32)
        picture = wp.array(values, dtype=dtype, device=device)
        np.testing.assert_array_equal(pages.read(picture), values)
        picture.fill_(2.0)
        assert (pages.read(picture) == 2.0).all()


def test_chosen_rows_are_written_and_far_ones_are_not(device):
    """Write rows near and far, first and last, none and more than pass at once, each time in order with launches."""
    count, rng = 3 * PAGE_ROWS + 7, np.random.default_rng(5)
    writer = RowWriter(wp.vec3, device)
    array, held = wp.zeros(count, dtype=wp.vec3, device=device), np.zeros((count, 3), np.float32)
    kept = wp.zeros(count, dtype=wp.vec3, device=device)
    for chosen in ([], [0], [count - 1], [3, 4, 9], [0, NEAR_ROWS + 5, count - 1], range(5, count - 5), range(count)):
        chosen = np.array(chosen, np.int64)
        values = rng.random((count, 3), dtype=np.float32)
        wp.copy(kept, array)
        writer.write(array, values, chosen)
        np.testing.assert_array_equal(kept.numpy(), held)
        now = array.numpy()
        np.testing.assert_array_equal(now[chosen], values[chosen])
        changed = np.flatnonzero((now != held).any(1))
        assert all(np.abs(chosen - each).min() <= NEAR_ROWS for each in changed.tolist())
        held = now.copy()


def test_rows_that_share_memory_stay_apart(device):
    """Write structs again and again, few or many at a time, until all memory has been used twice, and wait for none."""
    writer, rng, count = RowWriter(Row, device), np.random.default_rng(7), PAGE_ROWS + 5
    array, held = wp.zeros(count, dtype=Row, device=device), np.zeros(count, Row.numpy_dtype())
    kept, expected = [], []
    for size in [1, 2, 300] * 15 + [PAGE_ROWS, 1, count]:
        first = int(rng.integers(count - size + 1))
        held["number"][first:first + size] = rng.integers(1 << 30, size=size)
        held["place"][first:first + size] = rng.random((size, 3))
        writer.write(array, held, np.arange(first, first + size))
        kept.append(wp.clone(array))
        expected.append(held.tobytes())
    assert [each.numpy().tobytes() for each in kept] == expected


def test_pictures_last_while_they_are_looked_at(device):
    """Keep each picture as it was read as long as a view of it is held, and use the memory of others again."""
    pages, held = PicturePages(), []
    picture = wp.zeros(640, dtype=wp.uint32, device=device)
    for index in range(5):
        picture.fill_(index)
        held.append(pages.read(picture).view(np.float32).reshape(20, 32)[3:])
    assert [each.view(np.uint32).max() for each in held] == [0, 1, 2, 3, 4]
    places = {each.ctypes.data for each in held}
    assert len(places) == 5
    del held[1:]
    for _ in range(3):
        picture.fill_(9)
        last = pages.read(picture)
        assert (last == 9).all() and held[0].view(np.uint32).max() == 0
    assert last.ctypes.data != held[0].ctypes.data and last.ctypes.data + 3 * 32 * 4 in places
    assert (pages.read(wp.full(7, 3, dtype=wp.uint32, device=device)) == 3).all()


def test_memory_of_many_pictures_is_given_back(device):
    """Hold many pictures at once, then none: what the next ones are read into is memory of two of them at most."""
    pages, picture = PicturePages(), wp.zeros(4096, dtype=wp.vec4, device=device)
    held = [pages.read(picture) for _ in range(6)]
    assert len({each.ctypes.data for each in held}) == 6
    memory = [weakref.ref(each.base) for each in held]
    held.clear()
    places = {pages.read(picture).ctypes.data for _ in range(6)}
    assert len(places) <= 2
    assert sum(each() is not None for each in memory) <= 2
