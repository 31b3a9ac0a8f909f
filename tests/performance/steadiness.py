# SPDX-License-Identifier: GPL-3.0-or-later
"""How steady frames of a moving camera are: pictures of one frame looked up from another by world positions."""

from __future__ import annotations

import numpy as np
from burnish.engine.scene import CameraData, CameraKind


def project(camera: CameraData, points: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return film positions [px] and depths [m] of world points [..., 3]."""
    inverse = np.linalg.inv(np.array(camera.transform).reshape(4, 4))
    local = points @ inverse[:3, :3].T + inverse[:3, 3]
    depth = -local[..., 2]
    plane = local[..., :2]
    if camera.kind == CameraKind.PERSPECTIVE:
        plane = plane / np.maximum(depth, 1e-9)[..., None]
    left, right, bottom, top = camera.window
    film = (plane - (left, bottom)) / (right - left, top - bottom) * size
    return film, depth


def look_up(
    picture: np.ndarray, camera: CameraData, positions: np.ndarray, points: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the colours that another frame has at world points, and where it shows them.

    Args:
        picture: Of the other frame [h, w, c].
        camera: Of the other frame.
        positions: World position of the surface in each of its pixels; 0 without a surface.
        points: Looked for [..., 3]; 0 without a surface.

    Returns:
        Colours [..., c] by bilinear interpolation, and a mask [...]: all four pixels show the point's surface.
    """
    height, width = picture.shape[:2]
    film, depth = project(camera, points, (width, height))
    corner = np.floor(film - 0.5)
    share = film - 0.5 - corner
    x, y = corner[..., 0].astype(int), corner[..., 1].astype(int)
    valid = points.any(-1) & (depth > 0.0) & (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    x, y = np.clip(x, 0, width - 2), np.clip(y, 0, height - 2)
    color = np.zeros((*points.shape[:-1], picture.shape[-1]), np.float32)
    for i in (0, 1):
        for j in (0, 1):
            tap = positions[y + j, x + i]
            # A neighbouring pixel of the same surface lies a few pixels' footprints away, more at grazing angles.
            near = np.linalg.norm(tap - points, axis=-1) < 0.03 * np.maximum(depth, 1e-6)
            valid &= near & tap.any(-1)
            weight = (share[..., 0] if i else 1 - share[..., 0]) * (share[..., 1] if j else 1 - share[..., 1])
            color += weight[..., None] * picture[y + j, x + i]
    return color, valid


def flicker(pictures: list[np.ndarray], cameras: list[CameraData], positions: list[np.ndarray]) -> tuple[float, float]:
    """Return the mean standard deviation over time of what is seen of the same points, and the share of such pixels.

    The points are those of the last frame's pixels; a pixel counts where at least three quarters of the frames show
    its point. Pictures should be encoded for display: errors count as they are seen.
    """
    points = positions[-1]
    total, square, count = np.zeros_like(pictures[0]), np.zeros_like(pictures[0]), np.zeros(points.shape[:2])
    for picture, camera, place in zip(pictures, cameras, positions, strict=True):
        color, valid = look_up(picture, camera, place, points)
        total += color * valid[..., None]
        square += color**2 * valid[..., None]
        count += valid
    enough = count >= 0.75 * len(pictures)
    if not enough.any():
        return 0.0, 0.0
    mean = total[enough] / count[enough][:, None]
    variance = np.maximum(square[enough] / count[enough][:, None] - mean**2, 0.0)
    return float(np.sqrt(variance).mean()), float(enough.mean())


def blurred(picture: np.ndarray, size: int) -> np.ndarray:
    """Return means over `size` x `size` windows around each pixel, the border repeated: blotches without grain."""
    padded = np.pad(picture, ((size, size), (size, size), (0, 0)), "edge").astype(np.float64).cumsum(0).cumsum(1)
    low, high = size - size // 2 - 1, 2 * size - size // 2 - 1
    height, width = picture.shape[:2]
    a = padded[high:high + height, high:high + width] - padded[low:low + height, high:high + width]
    b = padded[high:high + height, low:low + width] - padded[low:low + height, low:low + width]
    return ((a - b) / size**2).astype(np.float32)


__all__ = ["blurred", "flicker", "look_up", "project"]
