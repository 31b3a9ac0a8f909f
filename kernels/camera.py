# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays: perspective and orthographic, thin lens with polygonal aperture, pixel filter by importance."""

from __future__ import annotations

import warp as wp

from .geometry_math import TWO_PI, transform_direction, transform_point
from .sampling import sample_disk
from .types import FrameData


@wp.struct
class CameraRay:
    """A ray from the lens."""

    origin: wp.vec3
    direction: wp.vec3
    t_max: float


@wp.func
def filter_offset(table: wp.array[float], u: float) -> float:
    """Return an offset [px] from the pixel's centre distributed as the filter; `table` is its inverse CDF."""
    count = table.shape[0]
    x = u * float(count - 1)
    i = wp.min(int(x), count - 2)
    return wp.lerp(table[i], table[i + 1], x - float(i))


@wp.func
def sample_aperture(frame: FrameData, u: wp.vec2) -> wp.vec2:
    """Return a point on the lens of radius 1: a disk, or a regular polygon with `aperture_blades` corners."""
    if frame.aperture_blades < 3:
        d = sample_disk(u)
        return wp.vec2(d[0] / frame.aperture_ratio, d[1])
    blades = float(frame.aperture_blades)
    scaled = u[0] * blades
    blade = wp.floor(scaled)
    # Uniform over the triangle between the centre and one side, the first of which rotation turns from the right.
    r = wp.sqrt(scaled - blade)
    a0 = TWO_PI * (blade - 0.5) / blades + frame.aperture_rotation
    a1 = TWO_PI * (blade + 0.5) / blades + frame.aperture_rotation
    x = r * wp.lerp(wp.cos(a0), wp.cos(a1), u[1])
    y = r * wp.lerp(wp.sin(a0), wp.sin(a1), u[1])
    return wp.vec2(x / frame.aperture_ratio, y)


@wp.func
def camera_ray(frame: FrameData, film: wp.vec2, lens: wp.vec2) -> CameraRay:
    """Return the ray through the film position [px, bottom-left origin] and the lens point `lens` in [0, 1)^2."""
    x = wp.lerp(frame.window[0], frame.window[1], film[0] / float(frame.width))
    y = wp.lerp(frame.window[2], frame.window[3], film[1] / float(frame.height))
    origin = wp.vec3(0.0, 0.0, 0.0)
    direction = wp.vec3(x, y, -1.0)
    if frame.orthographic == 1:
        origin = wp.vec3(x, y, 0.0)
        direction = wp.vec3(0.0, 0.0, -1.0)
    if frame.aperture_radius > 0.0:
        focus = origin + direction * frame.focus_distance
        d = sample_aperture(frame, lens) * frame.aperture_radius
        origin = origin + wp.vec3(d[0], d[1], 0.0)
        direction = focus - origin
    # Clip planes are perpendicular to the axis: start and end scale with the ray's slant.
    slant = 1.0 / wp.max(-direction[2], 1.0e-20)
    origin = origin + direction * (frame.clip_start * slant)
    length = wp.length(direction)
    ray = CameraRay()
    ray.t_max = (frame.clip_end - frame.clip_start) * slant * length
    ray.origin = transform_point(frame.camera_to_world, origin)
    ray.direction = wp.normalize(transform_direction(frame.camera_to_world, direction / length))
    return ray
