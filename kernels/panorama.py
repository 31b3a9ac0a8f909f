# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramic cameras: rays of every direction at once, as Cycles maps them (kernel/camera/projection.h).

FrameData.window spans coordinates of the projection itself, so that a mapping needs no ranges, lens or sensor:
longitude and latitude [rad], angles across a cube's face [rad], a unit disk, or a fisheye's plane. Camera space is
Blender's: x right, y up, the view along -z. The real-time integrator's frames know no panoramas: path tracing alone
starts its rays with film_ray.
"""

from __future__ import annotations

import warp as wp

from .camera import CameraRay, camera_ray, sample_aperture
from .geometry_math import PI, normalize_or, transform_direction, transform_point
from .types import FrameData

# FrameData.panorama; 0: none.
EQUIRECTANGULAR = wp.constant(1)
CUBE_FACE = wp.constant(2)
MIRROR_BALL = wp.constant(3)
FISHEYE_EQUIDISTANT = wp.constant(4)
FISHEYE_EQUISOLID = wp.constant(5)
FISHEYE_POLYNOMIAL = wp.constant(6)
CYLINDER = wp.constant(7)

# CameraRay.t_max where the film shows nothing, outside of a fisheye's circle.
NOWHERE = wp.constant(-1.0)

NEWTON_STEPS = wp.constant(20)
CONVERGED = wp.constant(1.0e-6)


@wp.func
def polynomial_angle(frame: FrameData, r: float) -> float:
    """Return the angle with the view axis [rad] at a distance from a fisheye's centre, by its polynomial."""
    k = frame.polynomial
    return -(frame.polynomial_start + r * (k[0] + r * (k[1] + r * (k[2] + r * k[3]))))


@wp.func
def fisheye_direction(frame: FrameData, x: float, y: float) -> wp.vec3:
    """Return the unit direction of a place on a fisheye's plane; zero outside of its field of view."""
    r = wp.sqrt(x * x + y * y)
    theta = r
    if frame.panorama == FISHEYE_EQUISOLID:
        if r > wp.sin(wp.min(0.5 * frame.edge, 0.5 * PI)):
            return wp.vec3(0.0, 0.0, 0.0)
        theta = 2.0 * wp.asin(wp.min(r, 1.0))
    elif frame.panorama == FISHEYE_POLYNOMIAL:
        theta = polynomial_angle(frame, r)
    # So that an overflow of the polynomial is outside too.
    within = wp.abs(theta) <= frame.edge
    if frame.panorama != FISHEYE_EQUISOLID and not within:
        return wp.vec3(0.0, 0.0, 0.0)
    across = wp.sin(theta) / wp.max(r, 1.0e-20)
    return wp.vec3(x * across, y * across, -wp.cos(theta))


@wp.func
def panorama_direction(frame: FrameData, x: float, y: float) -> wp.vec3:
    """Return the unit direction in camera space at a place in the window; zero where there is none."""
    if frame.panorama == EQUIRECTANGULAR:
        return wp.vec3(wp.cos(y) * wp.sin(x), wp.sin(y), -wp.cos(y) * wp.cos(x))
    if frame.panorama == CUBE_FACE:
        return wp.normalize(wp.vec3(wp.tan(x), wp.tan(y), -1.0))
    if frame.panorama == CYLINDER:
        return wp.normalize(wp.vec3(wp.sin(x), y, -wp.cos(x)))
    if frame.panorama == MIRROR_BALL:
        square = x * x + y * y
        if square > 1.0:
            return wp.vec3(0.0, 0.0, 0.0)
        slant = 2.0 * wp.sqrt(1.0 - square)
        return wp.vec3(x * slant, y * slant, 2.0 * square - 1.0)
    return fisheye_direction(frame, x, y)


@wp.func
def fisheye_radius(frame: FrameData, theta: float) -> float:
    """Return the distance from a fisheye's centre at which an angle with the view axis [rad] is seen."""
    if frame.panorama == FISHEYE_EQUISOLID:
        return wp.sin(0.5 * theta)
    if frame.panorama == FISHEYE_EQUIDISTANT:
        return theta
    # Newton's method, from the solution of the linear part.
    k = frame.polynomial
    r = float(1.0)
    if k[0] != 0.0:
        r = -(theta + frame.polynomial_start) / k[0]
    step = int(0)
    while step < NEWTON_STEPS:
        slope = -(k[0] + r * (2.0 * k[1] + r * (3.0 * k[2] + r * 4.0 * k[3])))
        change = float(0.0)
        if slope != 0.0:
            change = (theta - polynomial_angle(frame, r)) / slope
        r += change
        step += 1
        if wp.abs(change) < CONVERGED:
            step = NEWTON_STEPS
    return r


@wp.func
def panorama_window(frame: FrameData, d: wp.vec3) -> wp.vec2:
    """Return the place in the window that shows a unit direction in camera space."""
    if frame.panorama == EQUIRECTANGULAR:
        return wp.vec2(wp.atan2(d[0], -d[2]), wp.asin(wp.clamp(d[1], -1.0, 1.0)))
    if frame.panorama == CUBE_FACE:
        return wp.vec2(wp.atan2(d[0], -d[2]), wp.atan2(d[1], -d[2]))
    across = wp.sqrt(d[0] * d[0] + d[1] * d[1])
    if frame.panorama == CYLINDER:
        return wp.vec2(wp.atan2(d[0], -d[2]), d[1] / wp.max(wp.sqrt(d[0] * d[0] + d[2] * d[2]), 1.0e-20))
    if frame.panorama == MIRROR_BALL:
        half = wp.sqrt(wp.max(2.0 - 2.0 * d[2], 1.0e-20))
        return wp.vec2(d[0] / half, d[1] / half)
    scale = fisheye_radius(frame, wp.atan2(across, -d[2])) / wp.max(across, 1.0e-20)
    return wp.vec2(d[0] * scale, d[1] * scale)


@wp.func
def panorama_film(frame: FrameData, point: wp.vec3) -> wp.vec2:
    """Return the film position [px] that shows a point; what lies beyond the window's edges is beyond the film."""
    local = transform_point(frame.world_to_camera, point)
    place = panorama_window(frame, normalize_or(local, wp.vec3(0.0, 0.0, -1.0)))
    return wp.vec2(
        (place[0] - frame.window[0]) / (frame.window[1] - frame.window[0]) * float(frame.width),
        (place[1] - frame.window[2]) / (frame.window[3] - frame.window[2]) * float(frame.height))


@wp.func
def panorama_ray(frame: FrameData, film: wp.vec2, lens: wp.vec2) -> CameraRay:
    """Return the ray of a panoramic camera, see film_ray.

    Its lens faces each direction, which is in focus at a distance from the camera's place; so are the clip distances.
    """
    x = wp.lerp(frame.window[0], frame.window[1], film[0] / float(frame.width))
    y = wp.lerp(frame.window[2], frame.window[3], film[1] / float(frame.height))
    direction = panorama_direction(frame, x, y)
    ray = CameraRay()
    if wp.length_sq(direction) == 0.0:
        ray.t_max = NOWHERE
        return ray
    origin = wp.vec3(0.0, 0.0, 0.0)
    if frame.aperture_radius > 0.0:
        d = sample_aperture(frame, lens) * frame.aperture_radius
        # Cycles lays the lens out by its x axis: the view axis, for mirror balls (whose space is mirrored) the right.
        pole = wp.vec3(0.0, 0.0, -1.0)
        side = float(1.0)
        if frame.panorama == MIRROR_BALL:
            pole = wp.vec3(1.0, 0.0, 0.0)
            side = float(-1.0)
        u = normalize_or(pole - direction * wp.dot(pole, direction), wp.vec3(0.0, 1.0, 0.0))
        v = wp.cross(direction, u) * side
        origin = u * d[0] + v * d[1]
        direction = wp.normalize(direction * frame.focus_distance - origin)
    ray.t_max = frame.clip_end - frame.clip_start
    ray.origin = transform_point(frame.camera_to_world, origin + direction * frame.clip_start)
    ray.direction = wp.normalize(transform_direction(frame.camera_to_world, direction))
    return ray


@wp.func
def film_ray(frame: FrameData, film: wp.vec2, lens: wp.vec2) -> CameraRay:
    """Return the ray of any camera through a film position [px, bottom-left origin] and a lens point in [0, 1)^2.

    Where the film shows nothing its `t_max` is negative.
    """
    if frame.panorama != 0:
        return panorama_ray(frame, film, lens)
    return camera_ray(frame, film, lens)
