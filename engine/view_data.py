# SPDX-License-Identifier: GPL-3.0-or-later
"""The View of each real-time frame: this camera and the last, jitter, and how long nothing has changed."""

from __future__ import annotations

import functools

import numpy as np

from ..kernels.view import View
from .staging import StagedRow

__all__ = ["ViewTracker"]

# Additive recurrence in two dimensions that stays even, and whose every 4th and 16th members do too: the pixels of a
# block take turns at their reflection rays. (Roberts' R2 of 2018 does not: four of its steps are nearly three pixels.)
JITTER_STEP = np.array([0.3869559942791564, 0.2936447304581302])

LONG_AGO = 1 << 20
"""Frames since an edit that is no more felt."""


class ViewTracker:
    """Fills the one-element array that all real-time kernels read."""

    def __init__(self, device: str):
        self._staged = StagedRow(View, device)
        self.array, self.row = self._staged.array, self._staged.row
        self.frame = -1
        self.rest = -1
        self.light_age = self.moved_age = LONG_AGO
        self._camera: np.ndarray | None = None
        self._jitter = np.zeros(2, np.float32)

    def restart(self) -> None:
        """Forget everything: the next frame is the first."""
        self.frame = self.rest = -1
        self.light_age = self.moved_age = LONG_AGO
        self._camera = None

    @property
    def parity(self) -> int:
        """Return which of the two buffers of each History the current frame writes."""
        return self.frame & 1

    def moved_by(self, camera: np.ndarray) -> float:
        """Return how far a camera (a FrameData row) is from that of the frame before [m]; 0 for the first."""
        if self._camera is None:
            return 0.0
        return float(np.linalg.norm(
            camera["camera_to_world"].reshape(4, 4)[:3, 3] - self._camera["camera_to_world"].reshape(4, 4)[:3, 3]))

    def advance(
        self, camera: np.ndarray, *, moved: bool, lit: bool, exposure: float, transparent: bool,
        filter_quantiles: np.ndarray | None, motion_reach: float = 0.5,
    ) -> None:
        """Go on to the next frame.

        Args:
            camera: A FrameData row, see frame_data.py.
            moved: Whether something but the camera has moved or changed since the frame before.
            lit: Whether a lamp, the world or a material has been edited since.
            exposure: Factor on radiance in half-float buffers.
            transparent: Whether the world leaves alpha 0.
            filter_quantiles: Inverse distribution of the pixel filter; None for no jitter.
            motion_reach: Half width [px] over which jitter is spread evenly in motion, see pixel_filter.motion_reach.
        """
        first = self._camera is None
        still = not first and not moved and not lit and camera.tobytes() == self._camera.tobytes()
        self.frame += 1
        self.rest = self.rest + 1 if still else 0
        # The first frame knows no light of before that would have to be forgotten.
        self.light_age = 0 if lit and not first else min(self.light_age + 1, LONG_AGO)
        self.moved_age = 0 if moved and not first else min(self.moved_age + 1, LONG_AGO)
        jitter = np.zeros(2, np.float32)
        if filter_quantiles is not None:
            u = (0.5 + JITTER_STEP * self.frame) % 1.0
            if still or first:
                jitter = np.interp(u, _steps(len(filter_quantiles)), filter_quantiles).astype(np.float32)
            else:
                # The anti-aliasing weighs samples by the filter then (kernels/antialias.py).
                jitter = (motion_reach * (2.0 * u - 1.0)).astype(np.float32)
        row = self.row
        row["camera"] = camera
        row["previous"] = camera if first else self._camera
        row["jitter"], row["previous_jitter"] = jitter, jitter if first else self._jitter
        row["frame"], row["rest"], row["light_age"], row["restart"] = self.frame, self.rest, self.light_age, int(first)
        row["exposure"], row["transparent"], row["moved_age"] = exposure, int(transparent), self.moved_age
        self._staged.send()
        self._camera, self._jitter = camera.copy(), jitter


@functools.cache
def _steps(count: int) -> np.ndarray:
    return np.linspace(0.0, 1.0, count)
