# SPDX-License-Identifier: GPL-3.0-or-later
"""What a real-time frame sees and remembers: the View, kept in a one-element device array, and its projections.

Everything that changes from frame to frame is here, so that a captured graph can be replayed with another camera.
Pixels count from the bottom left of the rendered region; film positions [px] from that of the full frame.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import transform_direction, transform_point
from .types import FrameData

# Depth [m] of pixels without a surface; fits a half-float after clamping and keeps ratios finite.
SKY_DEPTH = wp.constant(1.0e18)
# Frames after a movement of something but the camera in which shadows may still change: with a shadow ray for every
# other pixel in motion the second frame tells the rest.
MOVED_FRAMES = wp.constant(3)


@wp.struct
class View:
    """One frame of the real-time integrator."""

    camera: FrameData
    previous: FrameData
    """The camera of the frame before; equal to `camera` where `restart` is set"""
    jitter: wp.vec2
    """Offset of all this frame's camera rays from their pixels' centres [px], drawn from the pixel filter"""
    previous_jitter: wp.vec2
    frame: int
    """Frames since the integrator started: index of all random sequences"""
    rest: int
    """Frames since anything moved or changed, camera included; 0 in the frame in which it did"""
    light_age: int
    """Frames since a lamp, the world or emission was edited; 0 in the frame in which it was"""
    restart: int
    """1: nothing from the frame before is valid (first frame, cut, new size, new scene)"""
    exposure: float
    """Factor on radiance in all half-float buffers (pre-exposure): they hold radiance * exposure"""
    transparent: int
    """1: the world behind the scene leaves alpha 0"""
    moved_age: int
    """Frames since something but the camera moved; 0 in the frame in which it did"""


@wp.func
def film_position(view: View, x: int, y: int) -> wp.vec2:
    """Return where on the film this frame's camera ray of a pixel goes through [px]."""
    return wp.vec2(
        float(view.camera.crop_x + x) + 0.5 + view.jitter[0], float(view.camera.crop_y + y) + 0.5 + view.jitter[1])


@wp.func
def film_centre(view: View, width: int, pixel: int) -> wp.vec2:
    """Return where on the film the centre of a pixel is [px], in a picture of such a width."""
    return wp.vec2(
        float(view.camera.crop_x + pixel % width) + 0.5, float(view.camera.crop_y + pixel // width) + 0.5)


@wp.func
def previous_film_position(view: View, x: int, y: int) -> wp.vec2:
    """Return where the camera ray of the frame before went through [px]."""
    return wp.vec2(
        float(view.previous.crop_x + x) + 0.5 + view.previous_jitter[0],
        float(view.previous.crop_y + y) + 0.5 + view.previous_jitter[1])


@wp.func
def unproject(frame: FrameData, film: wp.vec2, depth: float) -> wp.vec3:
    """Return the point [m, scene space] seen at a film position [px] at a depth along the view axis [m]."""
    x = wp.lerp(frame.window[0], frame.window[1], film[0] / float(frame.width))
    y = wp.lerp(frame.window[2], frame.window[3], film[1] / float(frame.height))
    local = wp.vec3(x * depth, y * depth, -depth)
    if frame.orthographic == 1:
        local = wp.vec3(x, y, -depth)
    return transform_point(frame.camera_to_world, local)


@wp.func
def pixel_of(frame: FrameData, jitter: wp.vec2, film: wp.vec3, width: int, height: int) -> int:
    """Return the pixel whose square holds what `project` gave in a frame of that jitter; -1 outside of the picture."""
    if film[2] <= 0.0:
        return -1
    x = wp.floor(film[0] - float(frame.crop_x) - jitter[0])
    y = wp.floor(film[1] - float(frame.crop_y) - jitter[1])
    if not (x >= 0.0 and y >= 0.0 and x < float(width) and y < float(height)):
        return -1
    return int(y) * width + int(x)


@wp.func
def project(frame: FrameData, point: wp.vec3) -> wp.vec3:
    """Return film position [px] and depth along the view axis [m] of a point; depth <= 0 is behind the camera."""
    local = transform_point(frame.world_to_camera, point)
    depth = -local[2]
    x = local[0]
    y = local[1]
    if frame.orthographic == 0:
        scale = 1.0 / wp.max(depth, 1.0e-20)
        x = x * scale
        y = y * scale
    return wp.vec3(
        (x - frame.window[0]) / (frame.window[1] - frame.window[0]) * float(frame.width),
        (y - frame.window[2]) / (frame.window[3] - frame.window[2]) * float(frame.height),
        depth)


@wp.func
def project_direction(frame: FrameData, direction: wp.vec3) -> wp.vec3:
    """Return the film position [px] of a point at infinity (perspective only) and the cosine with the view axis."""
    local = transform_direction(frame.world_to_camera, direction)
    depth = -local[2]
    scale = 1.0 / wp.max(depth, 1.0e-20)
    return wp.vec3(
        (local[0] * scale - frame.window[0]) / (frame.window[1] - frame.window[0]) * float(frame.width),
        (local[1] * scale - frame.window[2]) / (frame.window[3] - frame.window[2]) * float(frame.height),
        depth)


@wp.func
def pixel_footprint(frame: FrameData, depth: float) -> float:
    """Return the width [m] of a pixel at a depth along the view axis."""
    return frame.pixel_size + frame.spread * depth


@wp.func
def eye_position(frame: FrameData) -> wp.vec3:
    """Return the camera's place in scene space."""
    m = frame.camera_to_world
    return wp.vec3(m[0, 3], m[1, 3], m[2, 3])


@wp.func
def direction_to_eye(frame: FrameData, point: wp.vec3) -> wp.vec3:
    """Return the unit vector from a point towards the camera (against the view axis where it is orthographic)."""
    if frame.orthographic == 1:
        m = frame.camera_to_world
        return wp.normalize(wp.vec3(m[0, 2], m[1, 2], m[2, 2]))
    return wp.normalize(eye_position(frame) - point)


@wp.func
def settling_frames(view: View) -> float:
    """Return for how many frames light has been spreading: since the first frame or the last edit of light.

    A bounce of light takes a frame, so early frames are too dark; means must leave them behind.
    """
    return float(wp.min(view.light_age, view.frame))


# A bounce of light takes a frame, so early frames are too dark: the share of the frames since the start or an edit of
# light that a mean may hold while light spreads, and the frames after which it has spread.
SETTLING_SHARE = wp.constant(0.3)
SETTLED_FRAMES = wp.constant(64.0)

# Frames after an edit of lights during which a picture's history weighs at most half.
LIGHT_EDIT_FRAMES = wp.constant(12)


@wp.func
def settled_length(view: View) -> float:
    """Return the most frames that a mean may hold: those that came before light had spread are left behind."""
    settling = settling_frames(view)
    return wp.max(SETTLING_SHARE * settling, settling - SETTLED_FRAMES)


@wp.func
def picture_limit(view: View) -> float:
    """Return as how many frames the mean of pictures before may count, for how long light has been spreading."""
    limit = settled_length(view)
    if view.light_age < LIGHT_EDIT_FRAMES:
        limit = wp.min(limit, 1.0)
    return limit
