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

__all__ = ["PictureInbox", "PicturePages", "RowWriter", "StagedRow", "overwrite"]

AHEAD = 2
"""Frames that may be on their way while the host writes the next one"""

PAGE_ROWS = 1024
"""Rows of an array that are sent at once"""

NEAR_ROWS = 32
"""Rows that may lie between two that are sent together: a further copy costs more"""


class RowWriter:
    """Writes rows of arrays on the device, in order with its work and without waiting for it."""

    def __init__(self, dtype: type, device: str):
        """Make the memory that rows pass through.

        Args:
            dtype: Warp's type of a row.
            device: Where the arrays are.
        """
        cuda = wp.get_device(device).is_cuda
        self._pages = [wp.zeros(PAGE_ROWS, dtype=dtype, device="cpu", pinned=cuda) for _ in range(AHEAD if cuda else 1)]
        self._views = [page.numpy() for page in self._pages]
        self._sent: list[wp.Event | None] = [None] * len(self._pages)
        self._next = 0

    def write(self, array: wp.array, values: np.ndarray, chosen: np.ndarray) -> None:
        """Make rows of an array those of the host; waits only where AHEAD pages have not arrived.

        Args:
            array: [N], on the device.
            values: [N, ...], what all of it shall hold.
            chosen: Ascending, the rows that differ; those between close ones are written too.
        """
        if len(chosen) == 0:
            return
        gaps = np.flatnonzero(np.diff(chosen) > NEAR_ROWS) + 1
        starts, ends = chosen[[0, *gaps]].tolist(), (chosen[[*(gaps - 1), -1]] + 1).tolist()
        for first, last in zip(starts, ends, strict=True):
            for start in range(first, last, PAGE_ROWS):
                self._send(array, values[start : min(start + PAGE_ROWS, last)], start)

    def _send(self, array: wp.array, values: np.ndarray, start: int) -> None:
        place, sent = self._next, self._sent[self._next]
        if sent is not None:
            wp.synchronize_event(sent)
        self._views[place][: len(values)] = values
        wp.copy(array, self._pages[place], start, 0, len(values))
        if array.device.is_cuda:
            self._sent[place] = wp.get_stream(array.device).record_event(sent)
            self._next = (place + 1) % len(self._pages)


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
        self._views = [page.numpy() for page in self._pages]
        self._sent: list[wp.Event | None] = [None] * len(self._pages)
        self._next = 0

    def send(self) -> None:
        """Give what `row` holds to kernels launched from here on; waits only where AHEAD others have not arrived."""
        place, sent = self._next, self._sent[self._next]
        if sent is not None:
            wp.synchronize_event(sent)
        np.copyto(self._views[place], self.row)
        if self.array.device.is_cuda:
            wp.copy(self.array, self._pages[place])
            self._sent[place] = wp.get_stream(self.array.device).record_event(sent)
            self._next = (place + 1) % len(self._pages)


class PictureInbox:
    """Where a device's pictures arrive on the host.

    The driver copies into memory that may be paged through buffers of its own, and pages that are new cost as much
    again: a picture of 1920 x 1080 took 29 ms.
    """

    def __init__(self) -> None:
        self._page: wp.array | None = None

    def read(self, picture: wp.array) -> np.ndarray:
        """Return what an array holds, valid until the next call; waits for the device."""
        if not picture.device.is_cuda:
            return picture.numpy()
        if self._page is None or (self._page.shape, self._page.dtype) != (picture.shape, picture.dtype):
            self._page = wp.empty(picture.shape, dtype=picture.dtype, device="cpu", pinned=True)
        wp.copy(self._page, picture)
        wp.synchronize_stream(wp.get_stream(picture.device))
        return self._page.numpy()


class PicturePages:
    """Pictures that arrive on the host and stay as they are while anybody looks at them.

    A page is used again once nobody holds what was read into it: a copy into memory that is new each time would take
    longer than the way from the device.
    """

    def __init__(self) -> None:
        self._pages: list[tuple[wp.array, weakref.ref]] = []

    def read(self, picture: wp.array) -> np.ndarray:
        """Return what an array holds, the caller's to keep; waits for the device."""
        self._pages = [pair for pair in self._pages if _alike(pair[0], picture)]
        free = next((page for page, seen in self._pages if seen() is None), None)
        page = wp.empty(picture.shape, dtype=picture.dtype, device="cpu",
                        pinned=picture.device.is_cuda) if free is None else free
        wp.copy(page, picture)
        if picture.device.is_cuda:
            wp.synchronize_stream(wp.get_stream(picture.device))
        # A new one each time; all views of it hold it.
        values = page.numpy()
        self._pages = [pair for pair in self._pages if pair[0] is not page] + [(page, weakref.ref(values))]
        return values


def _alike(page: wp.array, picture: wp.array) -> bool:
    return (page.shape, page.dtype, page.pinned) == (picture.shape, picture.dtype, picture.device.is_cuda)


def overwrite(array: wp.array, values: np.ndarray) -> wp.array:
    """Put values on the device, into the same array if they fit: recorded frames go on using it."""
    if len(array) == len(values):
        array.assign(values)
        return array
    return wp.array(values, dtype=array.dtype, device=array.device)
