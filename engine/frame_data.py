# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera and the frame as the row of numbers that kernels read."""

from __future__ import annotations

import math

import numpy as np

from ..kernels import panorama
from ..kernels.types import FrameData
from .errors import InvalidScene
from .scene import CameraData, CameraKind

__all__ = ["frame_row"]

PANORAMAS = {
    CameraKind.EQUIRECTANGULAR: panorama.EQUIRECTANGULAR, CameraKind.CUBE_FACE: panorama.CUBE_FACE,
    CameraKind.MIRROR_BALL: panorama.MIRROR_BALL, CameraKind.FISHEYE_EQUIDISTANT: panorama.FISHEYE_EQUIDISTANT,
    CameraKind.FISHEYE_EQUISOLID: panorama.FISHEYE_EQUISOLID, CameraKind.CYLINDER: panorama.CYLINDER,
    CameraKind.FISHEYE_POLYNOMIAL: panorama.FISHEYE_POLYNOMIAL,
}
"""Mappings of the kernels"""

FRAME_TYPE = np.dtype(FrameData.numpy_dtype())
"""Asked for once: Warp works it out anew each time"""

FARTHEST = 1e17
"""Metres: squares of distances stay within float32"""


def _within(value: float, fallback: float, low: float, high: float) -> float:
    """Return a number between two bounds; `fallback` for NaN."""
    return fallback if math.isnan(value) else min(max(value, low), high)


def frame_row(
    camera: CameraData, width: int, height: int, crop: tuple[int, int, int, int], seed: int, origin: np.ndarray,
) -> np.ndarray:
    """Return one kernels.types.FrameData as a structured array of length 1.

    Args:
        camera: In world space.
        width: Of the full frame [px].
        height: Of the full frame [px].
        crop: x, y, width, height of the rendered region, bottom-left origin.
        seed: Of the random numbers.
        origin: float64 [3], the scene's origin, subtracted from the camera's position.

    Raises:
        InvalidScene: The camera's transform is not finite, or its panorama shows nothing.
    """
    row = np.zeros(1, FRAME_TYPE)
    matrix = np.asarray(camera.transform, np.float64).reshape(4, 4).copy()
    if not np.isfinite(matrix).all() or not np.isfinite(camera.window).all():
        raise InvalidScene("The camera's transform or lens is not finite; reset its location, rotation and lens.")
    matrix[:3, 3] -= origin
    left, right, bottom, top = camera.window
    row["camera_to_world"] = matrix
    try:
        row["world_to_camera"] = np.linalg.inv(matrix)
    except np.linalg.LinAlgError as error:
        raise InvalidScene("The camera is scaled to nothing; reset its scale.") from error
    row["window"] = camera.window
    orthographic = camera.kind == CameraKind.ORTHOGRAPHIC
    row["orthographic"] = int(orthographic)
    start = _within(camera.clip_start, 0.0, 0.0, FARTHEST)
    row["clip_start"] = start
    row["clip_end"] = _within(camera.clip_end, FARTHEST, start, FARTHEST)
    row["aperture_radius"] = _within(camera.aperture_radius, 0.0, 0.0, FARTHEST)
    row["focus_distance"] = _within(camera.focus_distance, FARTHEST, 1e-6, FARTHEST)
    row["aperture_blades"] = camera.aperture_blades
    row["aperture_rotation"] = math.fmod(camera.aperture_rotation, 2.0 * math.pi) if math.isfinite(
        camera.aperture_rotation) else 0.0
    row["aperture_ratio"] = _within(camera.aperture_ratio, 1.0, 1e-3, 1e3)
    row["width"], row["height"] = width, height
    row["crop_x"], row["crop_y"], row["crop_width"], row["crop_height"] = crop
    row["seed"] = seed
    step = 0.5 * (abs(right - left) / width + abs(top - bottom) / height)
    row["spread" if not orthographic else "pixel_size"] = step
    if camera.panoramic:
        _set_panorama(row, camera)
    return row


def _set_panorama(row: np.ndarray, camera: CameraData) -> None:
    """Fill in what a panoramic camera has beside its window."""
    left, right, bottom, top = (float(edge) for edge in row["window"][0])
    if not np.isfinite(row["window"]).all() or left == right or bottom == top:
        raise InvalidScene("The camera's panorama covers nothing or too much; let its longitude, latitude or range end "
                           "elsewhere than where it begins.")
    row["panorama"] = int(PANORAMAS[camera.kind])
    if camera.kind.fisheye and not 0.0 < camera.fov < math.inf:
        raise InvalidScene(f"The camera's fisheye has a field of view of {camera.fov:g}; raise it above 0.")
    row["edge"] = 0.5 * camera.fov
    if camera.kind in (CameraKind.MIRROR_BALL, CameraKind.FISHEYE_EQUISOLID):
        # The radius is the sine of half the angle.
        row["spread"] *= 2.0
    if camera.kind == CameraKind.FISHEYE_POLYNOMIAL:
        if not np.isfinite(camera.polynomial).all() or not any(camera.polynomial[1:]):
            raise InvalidScene("The camera's fisheye polynomial sees one direction alone; reset its K1 to K4.")
        numbers = [_within(factor, 0.0, -FARTHEST, FARTHEST) for factor in camera.polynomial]
        row["polynomial_start"], row["polynomial"] = numbers[0], numbers[1:]
        # The mean along half the picture's shorter side; textures need no more than a guess.
        radius = 0.5 * min(abs(right - left), abs(top - bottom))
        angle = sum(factor * radius ** power for power, factor in enumerate(numbers) if power)
        row["spread"] *= min(abs(angle) / radius, FARTHEST)
