# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the virtual image of a reflection was in the frame before: in mirrors that moved, and in curved ones.

Method 7.4: the image lies behind the surface by the distance of what is reflected. In a mirror that has moved it was
where the plane of then puts it, in a curved one the mirror equation tells how far it moves over the surface. Functions.
"""

from __future__ import annotations

import warp as wp

from .filter_weights import squared_cosine, unit_normal
from .gbuffer import GBuffer
from .long_mean import TAP_MINIMUM
from .reflection_types import SAMPLE_FAR
from .reprojection import Reprojection, has_moved, has_tap, tap_pixel, tap_weight
from .view import (
    SKY_DEPTH,
    View,
    direction_to_eye,
    eye_position,
    film_position,
    previous_film_position,
    project,
    unproject,
)
from .wide_loads import load_previous_view, load_view

# Pixels to either side between which curvature is measured, the least cosine of normals there, and by how much hollow
# mirrors may stretch the motion of an image.
CURVATURE_PIXELS = wp.constant(2.0)
CURVATURE_COSINE2 = wp.constant(0.25)
STRETCH_MAX = wp.constant(2.0)


@wp.struct
class MirrorBefore:
    """Where a pixel's surface was in the frame before."""

    position: wp.vec3
    normal: wp.vec3
    """Shading normal, turned to the same side as this frame's"""
    plane_normal: wp.vec3
    """Geometric normal; zero where nothing is known"""
    moved: int
    """1: it has moved itself"""


@wp.func
def mirror_before(
    views: wp.array[View], gbuffer: GBuffer, previous: GBuffer, reprojection: Reprojection, width: int, pixel: int,
) -> MirrorBefore:
    """Return where a pixel's surface was; of one that has moved as the frame before shows it around its place."""
    out = MirrorBefore()
    view = load_previous_view(views)
    if not has_moved(reprojection.taps[pixel]):
        out.position = unproject(
            view.camera, film_position(view, pixel % width, pixel // width), gbuffer.depth[pixel])
        out.normal = unit_normal(gbuffer.normal[pixel])
        out.plane_normal = unit_normal(gbuffer.geometric_normal[pixel])
        return out
    out.moved = 1
    place = reprojection.position[pixel]
    total = float(0.0)
    tap = int(0)
    while tap < 4:
        if has_tap(reprojection.taps[pixel], tap):
            w = wp.max(tap_weight(place, tap), TAP_MINIMUM)
            q = tap_pixel(place, tap, width)
            total += w
            out.position += w * unproject(
                view.previous, previous_film_position(view, q % width, q // width), previous.depth[q])
            out.normal += w * unit_normal(previous.normal[q])
            out.plane_normal += w * unit_normal(previous.geometric_normal[q])
        tap += 1
    if total > 0.0:
        out.position = out.position / total
        out.normal = wp.normalize(out.normal)
        out.plane_normal = wp.normalize(out.plane_normal)
    return out


@wp.func
def image_position(
    views: wp.array[View], gbuffer: GBuffer, before: MirrorBefore, width: int, pixel: int, closeness: float,
) -> wp.vec2:
    """Return where in the frame before the virtual image of what a pixel reflects was: film-local [px].

    The image lies on the ray of view, behind the surface by the distance of what is reflected, as in a flat mirror. In
    a mirror that has moved it was where the plane of then puts it: what is reflected is taken to stand still.
    """
    # Read where it is needed: held for long, its matrices would fill the registers.
    view = load_previous_view(views)
    x = pixel % width
    y = pixel // width
    point = unproject(view.camera, film_position(view, x, y), gbuffer.depth[pixel])
    to_eye = direction_to_eye(view.camera, point)
    distance = wp.min(1.0 / wp.max(closeness, 1.0e-9), SAMPLE_FAR)
    image = point - to_eye * distance
    now = project(view.camera, image)
    if before.moved == 1:
        normal = unit_normal(gbuffer.normal[pixel])
        seen = point + (normal * (2.0 * wp.dot(normal, to_eye)) - to_eye) * distance
        image = seen - before.normal * (2.0 * wp.dot(before.normal, seen - before.position))
    then = project(view.previous, image)
    if then[2] <= 0.0:
        return wp.vec2(-1.0e6, -1.0e6)
    return wp.vec2(
        float(x + view.camera.crop_x - view.previous.crop_x) + 0.5 - now[0] + then[0],
        float(y + view.camera.crop_y - view.previous.crop_y) + 0.5 - now[1] + then[1])


@wp.struct
class SurfaceStep:
    """From a pixel to another of its surface."""

    away: wp.vec3
    """[m]"""
    normal: wp.vec3
    """Shading normal there; the pixel's own where there is no such surface"""


@wp.func
def surface_step(
    view: View, gbuffer: GBuffer, width: int, height: int, pixel: int, point: wp.vec3, normal: wp.vec3, dx: int,
    dy: int,
) -> SurfaceStep:
    """Return the step to the pixel that lies (dx, dy) aside; none where that shows another surface."""
    out = SurfaceStep()
    out.away = wp.vec3(0.0, 0.0, 0.0)
    out.normal = normal
    x = pixel % width + dx
    y = pixel // width + dy
    if x < 0 or y < 0 or x >= width or y >= height:
        return out
    q = y * width + x
    depth = gbuffer.depth[q]
    if depth >= SKY_DEPTH or squared_cosine(normal, gbuffer.normal[q]) < CURVATURE_COSINE2:
        return out
    away = unproject(view.camera, film_position(view, x, y), depth) - point
    # On one bent surface the way is at right angles to the normal half-way.
    middle = normal + unit_normal(gbuffer.normal[q])
    if wp.abs(wp.dot(away, middle)) > 0.5 * wp.length(away):
        return out
    out.away = away
    out.normal = unit_normal(gbuffer.normal[q])
    return out


@wp.func
def image_stretch(
    views: wp.array[View], gbuffer: GBuffer, width: int, height: int, pixel: int, apart: wp.vec2, closeness: float,
) -> float:
    """Return by how much an image in a curved mirror moves over it, as a share of the same in a flat one.

    The place of a reflection is where the way to what is reflected is shortest: the step to it is the way's slope by
    its second derivative along the surface, to which curvature adds (the mirror equation, for aslant views as well).
    """
    view = load_view(views)
    point = unproject(view.camera, film_position(view, pixel % width, pixel // width), gbuffer.depth[pixel])
    normal = unit_normal(gbuffer.normal[pixel])
    step = apart * (CURVATURE_PIXELS / wp.max(wp.length(apart), 1.0e-6))
    dx = int(wp.round(step[0]))
    dy = int(wp.round(step[1]))
    ahead = surface_step(view, gbuffer, width, height, pixel, point, normal, dx, dy)
    behind = surface_step(view, gbuffer, width, height, pixel, point, normal, -dx, -dy)
    away = ahead.away - behind.away
    square = wp.dot(away, away)
    if not square > 0.0:
        return 1.0
    curvature = wp.dot(ahead.normal - behind.normal, away) / square
    to_eye = direction_to_eye(view.camera, point)
    cosine = wp.max(wp.dot(normal, to_eye), 0.0)
    along = wp.dot(to_eye, away)
    slant = wp.max(1.0 - along * along / square, 1.0e-3)
    far = closeness
    if view.camera.orthographic == 0:
        far += 1.0 / wp.max(wp.length(eye_position(view.camera) - point), 1.0e-20)
    flat = slant * wp.max(far, 1.0e-9)
    return flat / wp.max(flat + 2.0 * cosine * curvature, flat / STRETCH_MAX)
