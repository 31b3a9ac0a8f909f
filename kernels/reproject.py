# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that finds each pixel's surface in the frame before: its motion, and which pixels there show it."""

from __future__ import annotations

import warp as wp

from .gbuffer import (
    SURFACE_VEILED,
    GBuffer,
    Surface,
    barycentrics_of,
    has_surface,
    load_previous_surface,
    load_surface,
    plane_distance,
)
from .geometry_math import is_finite3, sqr
from .motion import Motion, previous_point
from .reprojection import MOVED, VEILED, Reprojection, tap_pixel
from .types import Scene
from .view import (
    View,
    direction_to_eye,
    eye_position,
    film_position,
    pixel_footprint,
    project,
    project_direction,
    unproject,
)
from .wide_loads import load_previous_view
from .wide_stores import store_vec2

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# A tap shows the same surface if the geometric normals' cosine is above the first and it lies off the plane by less
# than so many pixels' widths, up to GRAZING_SLACK times that where the plane is seen from the side (GI-1.0 code,
# ReprojectGI, which allows a probe's width).
NORMAL_COSINE = wp.constant(0.9)
PLANE_PIXELS = wp.constant(2.0)
GRAZING_SLACK = wp.constant(5.0)
# Motion [px] of what was behind the camera: out of any picture.
FAR_AWAY = wp.constant(1.0e6)


@wp.func
def plane_tolerance(view: View, s: Surface) -> float:
    """Return how far another point may lie off a surface's plane and still count as the same surface [m]."""
    cosine = wp.clamp(wp.dot(s.geometric_normal, direction_to_eye(view.camera, s.position)), 0.0, 1.0)
    slant = sqr(sqr(1.0 - cosine)) * sqr(1.0 - cosine)
    return PLANE_PIXELS * wp.lerp(1.0, GRAZING_SLACK, slant) * pixel_footprint(view.camera, s.depth)


@wp.func
def film_motion(now: wp.vec3, before: wp.vec3) -> wp.vec2:
    """Return the difference of two projections [px]; what was behind the camera comes from outside the picture."""
    x = now[0] - before[0]
    y = now[1] - before[1]
    if before[2] <= 0.0 or not (wp.abs(x) < FAR_AWAY and wp.abs(y) < FAR_AWAY):
        return wp.vec2(FAR_AWAY, FAR_AWAY)
    return wp.vec2(x, y)


@wp.func
def world_motion(view: View, x: int, y: int) -> wp.vec2:
    """Return the motion of the world: by the camera's rotation alone; none where all rays are parallel."""
    if view.camera.orthographic == 1 or view.previous.orthographic == 1:
        return wp.vec2(0.0, 0.0)
    direction = wp.normalize(unproject(view.camera, film_position(view, x, y), 1.0) - eye_position(view.camera))
    return film_motion(project_direction(view.camera, direction), project_direction(view.previous, direction))


@wp.func
def same_surface(a: Surface, b: Surface, tolerance: float) -> bool:
    """Return whether b (of the frame before) lies on the surface a; the world is one surface."""
    if not has_surface(a) or not has_surface(b):
        return not has_surface(a) and not has_surface(b)
    return wp.dot(a.geometric_normal, b.geometric_normal) > NORMAL_COSINE and plane_distance(a, b.position) < tolerance


@wp.kernel(cuda_max_registers=64)
def reproject(
    # In:
    first: int,
    views: wp.array[View],
    scene: Scene,
    motion: Motion,
    width: int,
    height: int,
    gbuffer: GBuffer,
    previous: GBuffer,
    # Out:
    reprojection_out: Reprojection,
):
    """Write a pixel's place in the frame before and the taps there that show the same surface."""
    pixel = first + wp.tid()
    view = load_previous_view(views)
    x = pixel % width
    y = pixel // width
    surface = load_surface(view, gbuffer, width, pixel)
    tolerance = plane_tolerance(view, surface)
    veiled = (gbuffer.material[pixel] & SURFACE_VEILED) != wp.uint32(0)
    change = wp.vec2(0.0, 0.0)
    taps = int(0)
    if not has_surface(surface):
        if view.rest == 0:
            change = world_motion(view, x, y)
    elif view.rest == 0 or motion.moved[0] != 0:
        now = project(view.camera, surface.position)
        if motion.moved[0] != 0:
            hit = gbuffer.hit[pixel]
            was = previous_point(scene.geometry, motion, hit[0], hit[1], barycentrics_of(gbuffer, pixel))
            if was.moved == 1 and is_finite3(was.displacement):
                taps = int(MOVED)
                surface.position = surface.position + was.displacement
                if wp.dot(was.now_normal, surface.geometric_normal) < 0.0:
                    was.normal = -was.normal
                surface.geometric_normal = was.normal
        change = film_motion(now, project(view.previous, surface.position))
    if view.restart == 1:
        change = wp.vec2(0.0, 0.0)
    position = wp.vec2(
        float(x + view.camera.crop_x - view.previous.crop_x) + 0.5 - change[0],
        float(y + view.camera.crop_y - view.previous.crop_y) + 0.5 - change[1])
    if view.restart == 0:
        left = int(wp.floor(position[0] - 0.5))
        bottom = int(wp.floor(position[1] - 0.5))
        for tap in range(4):
            i = left + (tap & 1)
            j = bottom + (tap >> 1)
            if i >= 0 and j >= 0 and i < width and j < height:
                if veiled:
                    taps = taps | int(VEILED)
                other = load_previous_surface(view, previous, width, tap_pixel(position, tap, width))
                if same_surface(surface, other, tolerance):
                    taps = taps | (1 << tap)
    store_vec2(reprojection_out.position, pixel, position)
    reprojection_out.taps[pixel] = wp.uint8(taps)
