# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what frames before have found still holds, but for where the camera was."""

from __future__ import annotations

import warp as wp

from .long_mean import EDIT_FRAMES
from .view import MOVED_FRAMES, View


@wp.func
def only_camera_moves(view: View) -> bool:
    """Return whether a frame in motion has the light and the objects of the frames before."""
    if view.rest > 0 or view.restart == 1:
        return False
    return view.light_age >= EDIT_FRAMES and view.moved_age >= MOVED_FRAMES
