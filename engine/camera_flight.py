# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera flight made from one camera: the motion under which frames are timed."""

from __future__ import annotations

import dataclasses

import numpy as np

from .scene import CameraData

__all__ = ["fly", "fly_over"]

PAN = np.radians(24.0)
"""Over the whole flight"""
DOLLY = 0.15
"""Of the median depth, if nothing near is in the way"""


def fly(camera: CameraData, *, near: float, middle: float, count: int) -> list[CameraData]:
    """Return `count` cameras: a dolly forwards and to the right, and a pan to the left and back to the right.

    Args:
        camera: Where the flight begins.
        near: Depth of what is nearest [m].
        middle: Median depth [m].
        count: Frames.
    """
    start = np.array(camera.transform, float).reshape(4, 4)
    way = min(DOLLY * middle, 0.4 * near)
    cameras = []
    for share in np.linspace(0.0, 1.0, count):
        angle = 0.5 * PAN * np.sin(2.0 * np.pi * share)
        turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
        matrix = start.copy()
        matrix[:3, :3] = start[:3, :3] @ turn
        matrix[:3, 3] += way * share * (-start[:3, 2] + 0.5 * start[:3, 0])
        cameras.append(dataclasses.replace(camera, transform=tuple(matrix.ravel().tolist())))
    return cameras


def fly_over(camera: CameraData, positions: np.ndarray, count: int) -> list[CameraData]:
    """Return the cameras of `fly` with steps that are right for what is seen.

    Args:
        camera: Where the flight begins.
        positions: World position of the surface in each pixel [h, w, 3]; 0 without a surface.
        count: Frames.
    """
    start = np.array(camera.transform, float).reshape(4, 4)
    seen = positions.any(-1)
    depth = -((positions[seen] - start[:3, 3]) @ start[:3, 2])
    near, middle = np.percentile(depth, (2, 50)) if depth.size else (1.0, 1.0)
    return fly(camera, near=float(near), middle=float(middle), count=count)
