# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender cameras and viewports to CameraData.

Everything that decides the projection (lens, sensor fit, shift, zoom, offset, pixel aspect) ends up in one rectangle
on the plane at distance 1, `CameraData.window`. Depth of field follows Cycles (intern/cycles/blender/camera.cpp).
Main thread only; keeps nothing of bpy.
"""

from __future__ import annotations

import math

import bpy
import numpy as np

from ...engine.errors import InvalidScene
from ...engine.scene import CameraData, CameraKind
from .panorama import is_panoramic, panorama_fields

__all__ = ["border_from_view", "camera_from_scene", "camera_from_view"]

_FSTOP_MIN = 1e-5
# What Cycles uses where something else than a camera is looked through.
_DEFAULT_LENS, _DEFAULT_SENSOR = 50.0, 36.0
_DEFAULT_CLIP = (1e-5, 1e5)

Window = tuple[float, float, float, float]


def camera_from_scene(scene: bpy.types.Scene, camera: bpy.types.Object | None, width: int, height: int,
                      pixel_aspect: tuple[float, float] | None = None) -> CameraData:
    """Return the camera of a final render.

    Args:
        scene: Evaluated scene (its pixel aspect is used where none is given).
        camera: Evaluated camera object; a lamp or another object is looked through with a 50 mm lens.
        width: Full frame in pixels.
        height: Full frame in pixels.
        pixel_aspect: Width and height of a pixel.

    Raises:
        InvalidScene: There is no camera, it is a custom one, it sees nothing, or its transform can't be used.
    """
    if camera is None:
        raise InvalidScene("The scene has no camera: add one, or choose one in the scene's properties.")
    if width < 1 or height < 1:
        raise InvalidScene(f"The picture has a size of {width} x {height} pixels: raise the resolution.")
    aspect = pixel_aspect or (scene.render.pixel_aspect_x, scene.render.pixel_aspect_y)
    _check_kind(camera)
    clip_start, clip_end = _clip_range(camera)
    return CameraData(
        transform=_transform(camera), clip_start=clip_start, clip_end=clip_end,
        **_projection(camera, width * aspect[0], height * aspect[1]), **_aperture(camera))


def camera_from_view(region: bpy.types.Region, rv3d: bpy.types.RegionView3D, v3d: bpy.types.SpaceView3D,
                     depsgraph: bpy.types.Depsgraph) -> CameraData:
    """Return the camera of a viewport; zoom, offset, shift and lens come out of Blender's own window matrix.

    Args:
        region: The window region (only checked for its size).
        rv3d: Its view.
        v3d: Its space: clipping of views that aren't through a camera.
        depsgraph: Finds the evaluated camera, for depth of field and clipping.

    Raises:
        InvalidScene: The view is through a camera that can't be used, or the region has no size.
    """
    if region.width < 1 or region.height < 1:
        raise InvalidScene("The viewport has no size.")
    projection = np.array(rv3d.window_matrix, np.float64)
    kind = CameraKind.PERSPECTIVE if projection[3, 3] == 0.0 else CameraKind.ORTHOGRAPHIC
    to_world = np.linalg.inv(np.array(rv3d.view_matrix, np.float64))
    camera = _view_camera(rv3d, v3d, depsgraph)
    window, aperture = {"kind": kind, "window": _window_of_projection(projection, kind)}, {}
    if camera is not None:
        _check_kind(camera)
        clip_start, clip_end = _clip_range(camera)
        aperture = _aperture(camera)
        if is_panoramic(camera):
            window = _panorama_in_view(camera, window["window"], depsgraph.scene.render)
    elif kind == CameraKind.ORTHOGRAPHIC:
        # Blender's orthographic views also show what lies behind the view point: start half the range behind it.
        clip_start, clip_end = 0.0, v3d.clip_end
        to_world[:3, 3] += to_world[:3, 2] / np.linalg.norm(to_world[:3, 2]) * (0.5 * v3d.clip_end)
    else:
        clip_start, clip_end = v3d.clip_start, v3d.clip_end
    return CameraData(transform=_without_scale(to_world, "The viewport"), clip_start=clip_start,
                      clip_end=clip_end, **window, **aperture)


def border_from_view(region: bpy.types.Region, rv3d: bpy.types.RegionView3D, v3d: bpy.types.SpaceView3D,
                     depsgraph: bpy.types.Depsgraph) -> tuple[int, int, int, int] | None:
    """Return the part of a viewport to draw as x, y, width, height in pixels (bottom-left origin), None for all.

    That is the viewport's render region, or in camera view the scene's render region or, behind an opaque
    passepartout, the camera's frame.
    """
    camera = _view_camera(rv3d, v3d, depsgraph)
    if camera is None:
        if not v3d.use_render_border:
            return None
        part = (v3d.render_border_min_x, v3d.render_border_max_x, v3d.render_border_min_y, v3d.render_border_max_y)
    else:
        render = depsgraph.scene.render
        if render.use_border:
            inside = (render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y)
        elif camera.type == 'CAMERA' and camera.data.show_passepartout and camera.data.passepartout_alpha == 1.0:
            inside = (0.0, 1.0, 0.0, 1.0)
        else:
            return None
        part = _part_of_view(rv3d, _render_window(camera, render), inside)
    left, right, bottom, top = (min(max(edge, 0.0), 1.0) for edge in part)
    x, y = int(left * region.width), int(bottom * region.height)
    x, y = min(x, region.width - 1), min(y, region.height - 1)
    return x, y, max(int(right * region.width) - x, 1), max(int(top * region.height) - y, 1)


def _view_camera(rv3d: bpy.types.RegionView3D, v3d: bpy.types.SpaceView3D,
                 depsgraph: bpy.types.Depsgraph) -> bpy.types.Object | None:
    """Return the evaluated object that the viewport looks through, if any."""
    if rv3d.view_perspective != 'CAMERA':
        return None
    camera = v3d.camera if v3d.use_local_camera else depsgraph.scene.camera
    return camera.evaluated_get(depsgraph) if camera is not None else None


def _check_kind(camera: bpy.types.Object) -> None:
    if camera.type == 'CAMERA' and camera.data.type not in {'PERSP', 'ORTHO', 'PANO'}:
        raise InvalidScene(f"Camera '{camera.name}' is custom, which is not supported: "
                           "choose Perspective, Orthographic or Panoramic in its lens settings.")


def _kind(camera: bpy.types.Object) -> CameraKind:
    orthographic = camera.type == 'CAMERA' and camera.data.type == 'ORTHO'
    return CameraKind.ORTHOGRAPHIC if orthographic else CameraKind.PERSPECTIVE


def _clip_range(camera: bpy.types.Object) -> tuple[float, float]:
    return (camera.data.clip_start, camera.data.clip_end) if camera.type == 'CAMERA' else _DEFAULT_CLIP


def _transform(camera: bpy.types.Object) -> tuple[float, ...]:
    return _without_scale(np.array(camera.matrix_world, np.float64), f"Camera '{camera.name}'")


def _without_scale(matrix: np.ndarray, owner: str) -> tuple[float, ...]:
    """Return 16 numbers, row-major: the axes of `matrix` at unit length."""
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or not (lengths > 0.0).all():
        raise InvalidScene(f"{owner} has a scale of zero or a broken transform: reset its scale.")
    result = matrix.copy()
    result[:3, :3] /= lengths
    result[3] = (0.0, 0.0, 0.0, 1.0)
    return tuple(result.reshape(-1).tolist())


def _window(camera: bpy.types.Object, width: float, height: float) -> Window:
    """Return left, right, bottom, top for a frame of `width` by `height`, pixel aspect included.

    The fitted side spans the sensor; both shifts count in units of that side. See Blender's
    BKE_camera_params_compute_viewplane.
    """
    lens, sensor, horizontal, shift, scale = _DEFAULT_LENS, _DEFAULT_SENSOR, width > height, (0.0, 0.0), None
    if camera.type == 'CAMERA':
        data = camera.data
        lens, shift = data.lens, (data.shift_x, data.shift_y)
        sensor = data.sensor_height if data.sensor_fit == 'VERTICAL' else data.sensor_width
        if data.sensor_fit != 'AUTO':
            horizontal = data.sensor_fit == 'HORIZONTAL'
        scale = data.ortho_scale if data.type == 'ORTHO' else None
    elif camera.type == 'LIGHT' and camera.data.type == 'SPOT':
        lens = 16.0 / max(math.tan(camera.data.spot_size * 0.5), 1e-6)
    side = sensor / lens if scale is None else scale
    span_x, span_y = (side, side * height / width) if horizontal else (side * width / height, side)
    x, y = shift[0] * side, shift[1] * side
    return (x - 0.5 * span_x, x + 0.5 * span_x, y - 0.5 * span_y, y + 0.5 * span_y)


def _window_of_projection(projection: np.ndarray, kind: CameraKind) -> Window:
    """Return the rectangle that a 4x4 projection maps to -1..1."""
    edges = []
    for row in (0, 1):
        scale = projection[row, row]
        # Perspective divides by -z, which is 1 on the image plane, where z = -1.
        offset = projection[row, 2] if kind == CameraKind.PERSPECTIVE else -projection[row, 3]
        edges += [float((-1.0 + offset) / scale), float((1.0 + offset) / scale)]
    return tuple(edges)


def _projection(camera: bpy.types.Object, width: float, height: float) -> dict:
    """Return the fields of CameraData that say what a frame of `width` by `height` shows, pixel aspect included."""
    if is_panoramic(camera):
        return panorama_fields(camera, (0.0, 1.0, 0.0, 1.0), width, height)
    return {"kind": _kind(camera), "window": _window(camera, width, height)}


def _panorama_in_view(camera: bpy.types.Object, view: Window, render: bpy.types.RenderSettings) -> dict:
    """Return the same for a viewport: its frame lies where a perspective camera's would."""
    frame = _render_window(camera, render)
    part = tuple((view[i] - frame[i & 2]) / (frame[(i & 2) + 1] - frame[i & 2]) for i in range(4))
    return panorama_fields(camera, part, render.resolution_x * render.pixel_aspect_x,
                           render.resolution_y * render.pixel_aspect_y)


def _render_window(camera: bpy.types.Object, render: bpy.types.RenderSettings) -> Window:
    return _window(camera, render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y)


def _part_of_view(rv3d: bpy.types.RegionView3D, frame: Window, inside: Window) -> Window:
    """Return where the part `inside` of the camera's `frame` lies in the viewport, both as fractions."""
    projection = np.array(rv3d.window_matrix, np.float64)
    kind = CameraKind.PERSPECTIVE if projection[3, 3] == 0.0 else CameraKind.ORTHOGRAPHIC
    view = _window_of_projection(projection, kind)
    result = []
    for low, high, edges in ((0, 1, inside[:2]), (2, 3, inside[2:])):
        for edge in edges:
            place = frame[low] + edge * (frame[high] - frame[low])
            result.append((place - view[low]) / (view[high] - view[low]))
    return tuple(result)


def _aperture(camera: bpy.types.Object) -> dict:
    """Return the fields of CameraData for depth of field; none where it is off."""
    if camera.type != 'CAMERA' or not camera.data.dof.use_dof:
        return {}
    data, dof = camera.data, camera.data.dof
    fstop = max(dof.aperture_fstop, _FSTOP_MIN)
    # The lens is in millimetres; an orthographic camera has none and takes 1 m.
    diameter = (1.0 if data.type == 'ORTHO' else data.lens * 1e-3) / fstop
    return {
        "aperture_radius": 0.5 * diameter,
        "focus_distance": max(_focus_distance(camera), 1e-5),
        "aperture_blades": dof.aperture_blades,
        "aperture_rotation": dof.aperture_rotation,
        "aperture_ratio": dof.aperture_ratio,
    }


def _focus_distance(camera: bpy.types.Object) -> float:
    """Return the distance of the plane in focus along the view axis [m]."""
    dof = camera.data.dof
    target = dof.focus_object
    if target is None:
        return dof.focus_distance
    matrix = target.matrix_world
    bone = target.pose.bones.get(dof.focus_subtarget) if target.pose and dof.focus_subtarget else None
    if bone is not None:
        matrix = matrix @ bone.matrix
    axis = camera.matrix_world.to_3x3().col[2].normalized()
    return abs(axis.dot(camera.matrix_world.translation - matrix.translation))
