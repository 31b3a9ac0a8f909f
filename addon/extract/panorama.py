# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's panoramic cameras: what of the sphere of directions a frame shows, as CameraData.window has it.

Lenses, sensors and ranges follow Cycles (intern/cycles/blender/camera.cpp). Main thread only; keeps nothing of bpy.
"""

from __future__ import annotations

import math

import bpy

from ...engine.errors import InvalidScene
from ...engine.scene import CameraKind

__all__ = ["is_panoramic", "panorama_fields"]

Window = tuple[float, float, float, float]

KINDS = {
    'EQUIRECTANGULAR': CameraKind.EQUIRECTANGULAR, 'EQUIANGULAR_CUBEMAP_FACE': CameraKind.CUBE_FACE,
    'MIRRORBALL': CameraKind.MIRROR_BALL, 'FISHEYE_EQUIDISTANT': CameraKind.FISHEYE_EQUIDISTANT,
    'FISHEYE_EQUISOLID': CameraKind.FISHEYE_EQUISOLID, 'FISHEYE_LENS_POLYNOMIAL': CameraKind.FISHEYE_POLYNOMIAL,
    'CENTRAL_CYLINDRICAL': CameraKind.CYLINDER,
}


def is_panoramic(camera: bpy.types.Object) -> bool:
    """Tell whether an object is a panoramic camera."""
    return camera.type == 'CAMERA' and camera.data.type == 'PANO'


def panorama_fields(camera: bpy.types.Object, part: Window, width: float, height: float) -> dict:
    """Return the fields of CameraData that describe a panoramic camera's projection.

    Args:
        camera: Evaluated camera object.
        part: left, right, bottom, top of what is shown, in fractions of the camera's frame.
        width: Of the camera's frame, pixel aspect included.
        height: Of the camera's frame, pixel aspect included.

    Raises:
        InvalidScene: The panorama is of an unknown type, or shows nothing.
    """
    data = camera.data
    kind = KINDS.get(data.panorama_type)
    if kind is None:
        raise InvalidScene(f"Camera '{camera.name}' has a panorama of type {data.panorama_type}, which is not "
                           "supported: choose another in its lens settings.")
    left, right, bottom, top = _frame(data, kind, width, height)
    if left == right or bottom == top:
        raise InvalidScene(f"The panorama of camera '{camera.name}' ends where it begins: give its ranges a size in "
                           "its lens settings.")
    # The shift is a share of the frame.
    across = [left + (right - left) * (edge + data.shift_x) for edge in part[:2]]
    up = [bottom + (top - bottom) * (edge + data.shift_y) for edge in part[2:]]
    fields = {"kind": kind, "window": (*across, *up)}
    if kind.fisheye:
        if not data.fisheye_fov > 0.0:
            raise InvalidScene(f"Camera '{camera.name}' has a fisheye with a field of view of 0: raise it in its lens "
                               "settings.")
        fields["fov"] = data.fisheye_fov
    if kind == CameraKind.FISHEYE_POLYNOMIAL:
        fields["polynomial"] = tuple(getattr(data, f"fisheye_polynomial_k{power}") for power in range(5))
        if not any(fields["polynomial"][1:]):
            raise InvalidScene(f"The fisheye polynomial of camera '{camera.name}' sees one direction alone: set its "
                               "K1 to K4 in its lens settings.")
    return fields


def _frame(data: bpy.types.Camera, kind: CameraKind, width: float, height: float) -> Window:
    """Return what the whole frame shows, in the coordinates of CameraData.window."""
    if kind == CameraKind.EQUIRECTANGULAR:
        return data.longitude_min, data.longitude_max, data.latitude_min, data.latitude_max
    if kind == CameraKind.CYLINDER:
        return (data.central_cylindrical_range_u_min, data.central_cylindrical_range_u_max,
                data.central_cylindrical_range_v_min / data.central_cylindrical_radius,
                data.central_cylindrical_range_v_max / data.central_cylindrical_radius)
    if kind == CameraKind.CUBE_FACE:
        return _centered(0.5 * math.pi, 0.5 * math.pi)
    if kind == CameraKind.MIRROR_BALL:
        return _centered(2.0, 2.0)
    if kind == CameraKind.FISHEYE_EQUIDISTANT:
        return _centered(data.fisheye_fov, data.fisheye_fov)
    # The sensor has the frame's shape, and its fitted side a size [mm].
    wide = width > height if data.sensor_fit == 'AUTO' else data.sensor_fit == 'HORIZONTAL'
    side = data.sensor_height if data.sensor_fit == 'VERTICAL' else data.sensor_width
    across, up = (side, side * height / width) if wide else (side * width / height, side)
    scale = 0.5 / data.fisheye_lens if kind == CameraKind.FISHEYE_EQUISOLID else 1.0
    return _centered(across * scale, up * scale)


def _centered(width: float, height: float) -> Window:
    return -0.5 * width, 0.5 * width, -0.5 * height, 0.5 * height
