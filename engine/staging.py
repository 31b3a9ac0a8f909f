# SPDX-License-Identifier: GPL-3.0-or-later
"""Small things on their way to the device, pictures on their way back, through memory that the device can reach.

Numbers that the host writes for every frame are sent in order with the device's work, without waiting for it.

A copy from a NumPy array makes Warp convert its type anew, which takes longer than all else that the host does for a
frame, and on CUDA it waits for all work before: the device would idle until the next frame is issued.
"""

from __future__ import annotations

import numpy as np
import warp as wp

__all__ = ["PictureInbox", "StagedRow"]

AHEAD = 2
"""Frames that may be on their way while the host writes the next one"""


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
