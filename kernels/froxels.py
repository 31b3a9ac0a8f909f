# SPDX-License-Identifier: GPL-3.0-or-later
"""Froxels: the part of space that the camera sees, cut into tiles of pixels and slices of distance. No kernels.

As in Wronski 2014, "Volumetric fog", and Hillaire 2015, "Physically based and unified volumetric rendering in
Frostbite" (SIGGRAPH courses); slices count the distance along rays and grow with it, from where the fog begins.
"""

from __future__ import annotations

import warp as wp

from .fog import Fog
from .geometry_math import transform_direction, transform_point
from .lamp_hit import FAR
from .types import FrameData
from .view import SKY_DEPTH, View, eye_position, settling_frames, unproject

WIDEN = wp.constant(256.0)
"""How many times as far as the first slice the last one reaches, where the camera is in the fog"""

CHANGE_AGE = wp.constant(4)
"""Frames for which a change counts: shadows and means of the cells follow it"""
SPREADING = wp.constant(64.0)
"""Frames since the start or an edit of light for which fog's light spreads"""


@wp.struct
class FroxelOptions:
    """How the froxels of a picture lie."""

    width: int
    height: int
    """Of the picture [px]"""
    tile: int
    """Of a froxel [px]"""
    columns: int
    rows: int
    slices: int
    candidates: int
    """Lights that each considers"""


@wp.struct
class EyeRay:
    """A camera ray from the eye, or from the camera's plane."""

    origin: wp.vec3
    direction: wp.vec3
    slant: float
    """Distance along it for each metre of depth"""


@wp.func
def eye_ray(frame: FrameData, film: wp.vec2) -> EyeRay:
    """Return the ray through a film position [px]."""
    ray = EyeRay()
    if frame.orthographic == 1:
        ray.origin = unproject(frame, film, 0.0)
        ray.direction = wp.normalize(transform_direction(frame.camera_to_world, wp.vec3(0.0, 0.0, -1.0)))
        ray.slant = 1.0
    else:
        ray.origin = eye_position(frame)
        way = unproject(frame, film, 1.0) - ray.origin
        ray.slant = wp.length(way)
        ray.direction = way / ray.slant
    return ray


@wp.func
def surface_distance(ray: EyeRay, depth: float) -> float:
    """Return how far along its ray a pixel's surface is [m]; FAR for none."""
    return wp.where(depth < SKY_DEPTH, depth * ray.slant, FAR)


@wp.func
def froxel_range(fog: Fog, frame: FrameData) -> wp.vec2:
    """Return between which distances froxels lie [m]."""
    local = transform_point(frame.world_to_camera, fog.middle)
    away = wp.length(local)
    if frame.orthographic == 1:
        away = -local[2]
    begin = wp.max(away - fog.radius, 0.0)
    end = wp.max(away + fog.radius, begin + 1.0e-3 * fog.radius)
    return wp.vec2(begin, wp.min(end, begin + fog.reach))


@wp.func
def first_step(span: wp.vec2) -> float:
    """Return the distance by which slices grow [m]."""
    return wp.max(span[0], (span[1] - span[0]) / WIDEN)


@wp.func
def slice_distance(span: wp.vec2, slices: int, slice: float) -> float:
    """Return where a slice begins [m]."""
    b = first_step(span)
    growth = wp.log(1.0 + (span[1] - span[0]) / b)
    return span[0] + b * (wp.exp(growth * slice / float(slices)) - 1.0)


@wp.func
def slice_at(span: wp.vec2, slices: int, distance: float) -> float:
    """Return the slice at a distance, and how far into it."""
    b = first_step(span)
    growth = wp.log(1.0 + (span[1] - span[0]) / b)
    return wp.log(1.0 + wp.max(distance - span[0], 0.0) / b) * float(slices) / growth


@wp.func
def has_changed(view: View) -> bool:
    """Return whether something but the camera has moved or changed of late."""
    return view.moved_age < CHANGE_AGE or view.light_age < CHANGE_AGE


@wp.func
def has_spread(view: View) -> bool:
    """Return whether the light of fog has had time to spread."""
    return settling_frames(view) >= SPREADING
