# SPDX-License-Identifier: GPL-3.0-or-later
"""What a lamp's node tree depends on, hence what its table is over, and when it must be made anew."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from ..kernels import lamp_tables as layout
from ..kernels import node_codes as codes
from .program import Program
from .program_layout import OPERANDS, Instruction
from .report import Report, ReportKind
from .scene import LightData, LightKind

__all__ = ["Needs", "find_needs", "lamp_axes", "table_key", "tell_needs", "widest_angle"]

NORMALS = {codes.INPUT_NORMAL, codes.INPUT_TRUE_NORMAL, codes.INPUT_OBJECT_NORMAL}
DIRECTIONS = {codes.INPUT_INCOMING, codes.INPUT_REFLECTION}
PLACES = {
    codes.INPUT_POSITION, codes.INPUT_SCENE_POSITION, codes.INPUT_GENERATED, codes.INPUT_OBJECT, codes.INPUT_TANGENT_X,
    codes.INPUT_TANGENT_Y, codes.INPUT_TANGENT_Z,
}
MOVED = {codes.INPUT_POSITION, codes.INPUT_SCENE_POSITION, codes.INPUT_OBJECT_LOCATION}
"""Inputs that change where a lamp is moved; of suns also the coordinates of the object"""
TURNED = {codes.INPUT_NORMAL, codes.INPUT_TRUE_NORMAL, *DIRECTIONS, *MOVED}
"""The same where it is turned"""
TO_OBJECT = {codes.SPACE_DIRECTION_TO_OBJECT, codes.SPACE_NORMAL_TO_OBJECT}
RAYS = {codes.INPUT_RAY_KIND, codes.INPUT_RAY_DEPTH, codes.INPUT_KIND_DEPTH, codes.INPUT_WINDOW}

NEARLY_FLAT = 0.497 * math.pi
"""Largest angle with a spot's axis [rad]"""


@dataclass(frozen=True)
class Needs:
    """What a lamp's program depends on."""

    kind: int
    """TABLE_* of kernels/lamp_tables.py: what its table is over"""
    mixed: bool = False
    """Whether it depends on what the table isn't over, too"""
    distance: bool = False
    turned: bool = False
    moved: bool = False
    rays: bool = False
    """Whether it depends on the kind or depth of rays, or on the camera"""


def find_needs(light: LightData) -> Needs:
    """Return what the program of a lamp depends on."""
    program: Program = light.program
    heads = [word[0] for word in program.emission]
    inputs = {head >> 16 & 255 for head in heads if head & 255 == codes.OP_INPUT}
    facing = any(head & 255 == codes.OP_FRESNEL for head in heads)
    spot = light.kind == LightKind.SPOT
    round_lamp = light.kind in (LightKind.POINT, LightKind.SPOT)
    directed = bool(inputs & DIRECTIONS) or facing
    kind, mixed = layout.TABLE_DIRECTION, False
    if light.kind == LightKind.AREA:
        if inputs & (PLACES | {codes.INPUT_PARAMETRIC}):
            kind, mixed = layout.TABLE_PLACE, directed
    elif round_lamp and not light.soft_falloff and light.radius > 0.0:
        directed |= spot and codes.INPUT_PARAMETRIC in inputs
        if facing or inputs & (PLACES | NORMALS | (set() if spot else {codes.INPUT_PARAMETRIC})):
            kind, mixed = layout.TABLE_NORMAL, directed
    of_sun = light.kind == LightKind.SUN and bool(inputs & PLACES)
    turned = any(
        head & 255 == codes.OP_INPUT and head >> 16 & 255 in TURNED and not _is_of_object(program.emission, at)
        for at, head in enumerate(heads))
    return Needs(
        int(kind), mixed, distance=codes.INPUT_RAY_LENGTH in inputs and light.kind != LightKind.SUN,
        turned=turned or of_sun, moved=bool(inputs & MOVED) or of_sun,
        rays=program.uses_camera or bool(inputs & RAYS))


def _is_of_object(code: tuple[Instruction, ...], at: int) -> bool:
    """Return whether the direction that an instruction reads is only used as one in the lamp's own space."""
    register, words = code[at][0] >> 8 & 255, code[at + 1:]
    if code[at][0] >> 16 & 255 in MOVED:
        return False
    for head, *operands in words:
        op = head & 255
        if register in operands[:OPERANDS[op]] and not (op == codes.OP_SPACE and head >> 16 in TO_OBJECT):
            return False
        if op < codes.OP_EMIT and head >> 8 & 255 == register:
            return True
    return True


def lamp_axes(light: LightData) -> np.ndarray:
    """Return a lamp's axes without scale and shear, the last that along which it shines: float64 [3, 3], as rows."""
    matrix = np.asarray(light.transform, np.float64)[:3, :3]
    z = -matrix[:, 2]
    z = z / np.linalg.norm(z) if np.linalg.norm(z) > 0.0 else np.array([0.0, 0.0, -1.0])
    x = matrix[:, 0] - z * (z @ matrix[:, 0])
    if np.linalg.norm(x) <= 1e-6 * max(np.linalg.norm(matrix[:, 0]), 1e-30):
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x = x / np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def widest_angle(light: LightData, kind: int) -> float | None:
    """Return the largest angle with the axis [rad] at which a table's one picture is looked up; None: a sphere of two.

    Args:
        light: The lamp.
        kind: Of the table.
    """
    if kind == layout.TABLE_NORMAL or light.kind == LightKind.POINT:
        return None
    if light.kind == LightKind.SUN:
        return max(0.5 * min(light.angle, math.pi), 1e-4)
    if light.kind == LightKind.AREA:
        return max(0.5 * min(light.spread, math.pi), 0.01)
    scales = np.maximum(np.linalg.norm(np.asarray(light.transform, np.float64)[:3, :3], axis=0), 1e-12)
    half = min(0.5 * light.spot_size, NEARLY_FLAT)
    return max(min(math.atan(math.tan(half) * max(scales[:2]) / scales[2]), NEARLY_FLAT), 0.001)


def table_key(light: LightData, needs: Needs) -> Hashable:
    """Return what a lamp's table depends on, its images aside: lamps with equal keys share one."""
    matrix = np.asarray(light.transform, np.float64)
    linear = matrix[:3, :3]
    place: tuple[bytes, ...] = ()
    if needs.moved:
        place = (matrix.tobytes(),)
    elif needs.turned:
        place = (linear.tobytes(),)
    # However it is turned, its scale and shear stay: rounded, as rotations are not exact.
    gram = linear.T @ linear
    size = float(np.abs(gram).max())
    shape = (*np.round(gram / max(size, 1e-30), 5).ravel().tolist(), f"{size:.5g}", np.linalg.det(linear) < 0.0)
    own = (light.kind, light.radius, light.soft_falloff, light.angle, light.spot_size, light.spot_blend, light.shape,
           light.size_x, light.size_y, light.spread)
    return light.program, needs, own, shape, place


def tell_needs(light: LightData, needs: Needs, report: Report) -> None:
    """Name what a lamp's table leaves out of its node tree."""
    owner = f"light '{light.name}'"
    if needs.mixed:
        kept = "place on it" if needs.kind == layout.TABLE_PLACE else "normal"
        report.add(
            ReportKind.APPROXIMATED, owner,
            f"has a node tree that depends on the direction and on the {kept}; the mean over directions is drawn")
    if needs.rays:
        report.add(
            ReportKind.APPROXIMATED, owner,
            "has a node tree that depends on the camera or on kinds of rays; it shines as for rays of no kind")
