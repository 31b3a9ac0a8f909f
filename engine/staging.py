# SPDX-License-Identifier: GPL-3.0-or-later
"""Small things on their way to the device, pictures on their way back, through memory that the device can reach.

Numbers that the host writes for every frame are sent in order with the device's work, without waiting for it.

A copy from a NumPy array makes Warp convert its type anew, which takes longer than all else that the host does for a
frame, and on CUDA it waits for all work before: the device would idle until the next frame is issued.
"""

from __future__ import annotations

import weakref

import numpy as np
import warp as wp

__all__ = ["PicturePages", "RowWriter", "StagedRow", "overwrite"]

AHEAD = 2
"""Frames that may be on their way while the host writes the next one"""

HALVES = 2
"""Of the memory that rows pass through: while what one held is on its way the host writes into the other"""

SPARE = 1
"""Pages of pictures that nobody looks at any more and are kept beside the one that is read into"""

PAGE_ROWS = 1024
"""Rows of an array that are sent at once"""

NEAR_ROWS = 32
"""Rows that may lie between two that are sent together: a further copy costs more"""


class _Outbox:
    """Memory that rows pass through on their way to the device, PAGE_ROWS at a time, HALVES of it in turn.

    An event for each half, not for each copy: to note and to await one takes as long as the copy's call.
    """

    def __init__(self, dtype: type, device: str):
        self._cuda = wp.get_device(device).is_cuda
        self._page = wp.zeros(PAGE_ROWS * (HALVES if self._cuda else 1), dtype=dtype, device="cpu", pinned=self._cuda)
        view = self._page.numpy()
        self._size = view.dtype.itemsize if view.dtype.names else 0
        # NumPy copies structs field by field.
        self._view = view.view(np.uint8) if self._size else view
        self._sent: list[wp.Event | None] = [None] * HALVES
        self._half = self._used = 0

    def send(self, array: wp.array, values: np.ndarray, start: int) -> None:
        """Make rows of an array, from `start` on, those of the host, of its type and at most PAGE_ROWS."""
        count = len(values)
        place = self._place(count, array) if self._cuda else 0
        if self._size:
            self._view[place * self._size : (place + count) * self._size] = values.view(np.uint8)
        else:
            self._view[place : place + count] = values
        wp.copy(array, self._page, start, place, count)

    def _place(self, count: int, array: wp.array) -> int:
        """Return where in the memory so many rows are free; waits where what lies there has not arrived."""
        if self._used + count > PAGE_ROWS:
            self._sent[self._half] = wp.get_stream(array.device).record_event(self._sent[self._half])
            self._half, self._used = (self._half + 1) % HALVES, 0
            if self._sent[self._half] is not None:
                wp.synchronize_event(self._sent[self._half])
        place = self._half * PAGE_ROWS + self._used
        self._used += count
        return place


class RowWriter:
    """Writes rows of arrays on the device, in order with its work and without waiting for it."""

    def __init__(self, dtype: type, device: str):
        """Make the memory that rows pass through.

        Args:
            dtype: Warp's type of a row.
            device: Where the arrays are.
        """
        self._outbox = _Outbox(dtype, device)

    def write(self, array: wp.array, values: np.ndarray, chosen: np.ndarray) -> None:
        """Make rows of an array those of the host; waits only where HALVES pages have not arrived.

        Args:
            array: [N], on the device.
            values: [N, ...], what all of it shall hold; structs lie side by side.
            chosen: Ascending, the rows that differ; those between close ones are written too.
        """
        if len(chosen) == 0:
            return
        if chosen[-1] - chosen[0] <= NEAR_ROWS:
            starts, ends = [int(chosen[0])], [int(chosen[-1]) + 1]
        else:
            gaps = np.flatnonzero(np.diff(chosen) > NEAR_ROWS) + 1
            starts, ends = chosen[[0, *gaps]].tolist(), (chosen[[*(gaps - 1), -1]] + 1).tolist()
        for first, last in zip(starts, ends, strict=True):
            for start in range(first, last, PAGE_ROWS):
                self._outbox.send(array, values[start : min(start + PAGE_ROWS, last)], start)


class StagedRow:
    """One struct on the device, written on the host."""

    def __init__(self, struct: type, device: str):
        """Make both, zeros.

        Args:
            struct: A Warp struct.
            device: Where kernels read it.
        """
        self.array = wp.zeros(1, dtype=struct, device=device)
        """[1], the device's"""
        self.row = np.zeros(1, struct.numpy_dtype())
        """[1], the host's; `send` takes it over"""
        self._pages = [self.array]
        if self.array.device.is_cuda:
            self._pages = [wp.zeros(1, dtype=struct, device="cpu", pinned=True) for _ in range(AHEAD)]
        # NumPy copies structs field by field.
        self._views, self._bytes = [page.numpy().view(np.uint8) for page in self._pages], self.row.view(np.uint8)
        self._sent: list[wp.Event | None] = [None] * len(self._pages)
        self._next = 0

    def send(self) -> None:
        """Give what `row` holds to kernels launched from here on; waits only where AHEAD others have not arrived."""
        place, sent = self._next, self._sent[self._next]
        if sent is not None:
            wp.synchronize_event(sent)
        self._views[place][:] = self._bytes
        if self.array.device.is_cuda:
            wp.copy(self.array, self._pages[place])
            self._sent[place] = wp.get_stream(self.array.device).record_event(sent)
            self._next = (place + 1) % len(self._pages)


class PicturePages:
    """Pictures that arrive on the host and stay as they are while anybody looks at them.

    A page is used again once nobody holds what was read into it: a copy into memory that is new each time would take
    longer than the way from the device. The driver copies into memory that may be paged through buffers of its own,
    and pages that are new cost as much again: a picture of 1920 x 1080 took 29 ms.
    """

    def __init__(self) -> None:
        self._pages: list[tuple[wp.array, weakref.ref]] = []

    def read(self, picture: wp.array) -> np.ndarray:
        """Return what an array holds, the caller's to keep; waits for the device."""
        alike = [pair for pair in self._pages if _alike(pair[0], picture)]
        free = [page for page, seen in alike if seen() is None]
        page = free.pop() if free else wp.empty(
            picture.shape, dtype=picture.dtype, device="cpu", pinned=picture.device.is_cuda)
        wp.copy(page, picture)
        if picture.device.is_cuda:
            wp.synchronize_stream(wp.get_stream(picture.device))
        # A new one each time; all views of it hold it.
        values = page.numpy()
        spare = {id(other) for other in free[:SPARE]}
        left = [pair for pair in alike if pair[0] is not page and (pair[1]() is not None or id(pair[0]) in spare)]
        self._pages = [*left, (page, weakref.ref(values))]
        return values


def _alike(page: wp.array, picture: wp.array) -> bool:
    return (page.shape, page.dtype, page.pinned) == (picture.shape, picture.dtype, picture.device.is_cuda)


def overwrite(array: wp.array, values: np.ndarray) -> wp.array:
    """Put values on the device, into the same array if they fit: recorded frames go on using it."""
    if len(array) == len(values):
        array.assign(values)
        return array
    return wp.array(values, dtype=array.dtype, device=array.device)
