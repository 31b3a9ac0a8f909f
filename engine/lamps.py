# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps from Blender's units to the kernels' structs (watts to radiance, as Cycles 5.2 does)."""

from __future__ import annotations

import math

import numpy as np

from ..kernels import types
from .light_linking import emitted_visibility
from .report import Report, ReportKind
from .scene import LightData, LightKind

__all__ = ["drawn_lamps", "lamp_array", "lamp_bounds", "lamp_power", "lamp_rows"]

# Spreads below this are drawn as this [rad]; a spread of 0 is a beam that no sample could find.
MIN_SPREAD = math.radians(0.5)

# Radii below this are drawn as points [m]: their radiance would not fit float32.
MIN_RADIUS = 1e-9

KINDS = {LightKind.POINT: 0, LightKind.SUN: 1, LightKind.SPOT: 2, LightKind.AREA: 3}


NUMBERS = ("radius", "angle", "spot_size", "spot_blend", "size_x", "size_y", "spread")
"""Fields of LightData that are single numbers"""


def _unit(vector: np.ndarray, fallback: tuple[float, float, float]) -> np.ndarray:
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else np.asarray(fallback, np.float64)


def _round_lamp(row: np.void, light: LightData, matrix: np.ndarray) -> None:
    """Fill in a point or spot lamp: radiance P / (4 pi^2 r^2), intensity P / 4 pi for radius 0."""
    radius = light.radius if light.radius >= MIN_RADIUS else 0.0
    color = np.asarray(light.color, np.float64)
    # Without normalisation the strength is not divided by the area.
    area = 4.0 * math.pi * radius * radius if radius > 0 else 4.0
    row["radius"] = radius
    row["radiance"] = color / math.pi / (area if light.normalize else 1.0)
    row["flags"] |= 0 if light.soft_falloff or radius == 0 else 1
    if radius > 0 and light.use_mis:
        row["flags"] |= 8
    if light.kind == LightKind.SPOT:
        half = 0.5 * light.spot_size
        scales = np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-12)
        row["axis_u"] = matrix[:3, 0] / scales[0] * (scales[2] / scales[0])
        row["axis_v"] = matrix[:3, 1] / scales[1] * (scales[2] / scales[1])
        row["spot_cos"] = math.cos(half)
        row["spot_smooth"] = 1.0 / max((1.0 - math.cos(half)) * light.spot_blend, 1e-6)


def _sun(row: np.void, light: LightData) -> None:
    """Fill in a sun: irradiance for an angle of 0, else radiance over the disk of its angle."""
    half = 0.5 * light.angle
    color = np.asarray(light.color, np.float64)
    area = math.pi * math.sin(min(half, 0.5 * math.pi)) ** 2 if half > 0 else 1.0
    row["radiance"] = color / (area if light.normalize else 1.0)
    row["one_minus_cos"] = 2.0 * math.sin(0.5 * half) ** 2
    if half > 0 and light.use_mis:
        row["flags"] |= 8


def _area_lamp(row: np.void, light: LightData, matrix: np.ndarray, report: Report) -> None:
    """Fill in an area lamp: radiance P / (pi A), times the spread's normalised attenuation."""
    size_y = light.size_x if light.shape in ("SQUARE", "DISK") else light.size_y
    axis_u = matrix[:3, 0] * light.size_x
    axis_v = matrix[:3, 1] * size_y
    area = float(np.linalg.norm(axis_u) * np.linalg.norm(axis_v))
    if light.shape in ("DISK", "ELLIPSE"):
        area *= 0.25 * math.pi
        row["flags"] |= 2
    row["axis_u"] = axis_u
    row["axis_v"] = axis_v
    row["area"] = area
    color = np.asarray(light.color, np.float64)
    row["radiance"] = color / math.pi / (max(area, 1e-30) if light.normalize else 1.0)
    if light.spread < math.pi - 1e-4:
        if light.spread < MIN_SPREAD:
            owner = f"light '{light.name}'"
            report.add(ReportKind.APPROXIMATED, owner, "spread below 0.5 degrees drawn as 0.5 degrees")
        half = 0.5 * max(light.spread, MIN_SPREAD)
        row["spread_tan"] = math.tan(half)
        # The integral of cos (1 - tan / tan half) over the cone is what the attenuation leaves of the power.
        small = half <= 0.05
        row["spread_norm"] = 3.0 / half**3 if small else 1.0 / (math.tan(half) - half)
    if light.use_mis and area > 0:
        row["flags"] |= 8


def lamp_array(lights: list[LightData], origin: np.ndarray, report: Report) -> np.ndarray:
    """Return the lamps as a structured array of kernels.types.Light, [L], suns last; see drawn_lamps."""
    return lamp_rows(drawn_lamps(lights, origin, report))


def lamp_rows(drawn: list[tuple[LightData, np.void]]) -> np.ndarray:
    """Return the rows of drawn_lamps as one array."""
    return np.array([row for _, row in drawn], types.Light.numpy_dtype())


def drawn_lamps(
    lights: list[LightData], origin: np.ndarray, report: Report,
) -> list[tuple[LightData, np.void]]:
    """Return the lamps that give light with their rows of lamp_array; those without power or size are left out.

    Args:
        lights: Lamps in world space.
        origin: float64 [3], the scene's origin, subtracted.
        report: Receives what is approximated.
    """
    rows = []
    for light in lights:
        matrix = np.asarray(light.transform, np.float64)
        row = np.zeros((), types.Light.numpy_dtype())
        if not (np.isfinite(matrix).all() and np.isfinite([getattr(light, name) for name in NUMBERS]).all()):
            report.add(ReportKind.ERROR, f"light '{light.name}'", "place, size or angle is not finite; left out")
            continue
        row["kind"] = KINDS[light.kind]
        row["position"] = matrix[:3, 3] - origin
        row["direction"] = _unit(-matrix[:3, 2], (0.0, 0.0, -1.0))
        row["visibility"] = emitted_visibility(light.visibility, light.linked_to, light.blocked_by)
        row["flags"] = 0 if light.cast_shadow else 4
        # What doesn't fit float32 overflows, and is left out below.
        with np.errstate(over="ignore"):
            if light.kind == LightKind.AREA:
                _area_lamp(row, light, matrix, report)
                if row["area"] <= 0:
                    report.add(ReportKind.SKIPPED, f"light '{light.name}'", "an area lamp without size gives no light")
                    continue
            elif light.kind == LightKind.SUN:
                _sun(row, light)
            else:
                _round_lamp(row, light, matrix)
        if not all(np.isfinite(row[name]).all() for name in row.dtype.names):
            report.add(ReportKind.ERROR, f"light '{light.name}'", "strength or position is not finite; left out")
            continue
        if (np.asarray(row["radiance"]) != 0).any():
            rows.append((light, row))
    rows.sort(key=lambda drawn: drawn[1]["kind"] == KINDS[LightKind.SUN])
    return rows


def lamp_bounds(lamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper bounds of lamps, float64 [L, 3]; meaningless for suns."""
    position = lamps["position"].astype(np.float64).reshape(-1, 3)
    area = (np.abs(lamps["axis_u"]) + np.abs(lamps["axis_v"])).astype(np.float64).reshape(-1, 3) * 0.5
    half = np.where((lamps["kind"] == KINDS[LightKind.AREA])[:, None], area, lamps["radius"][:, None])
    return position - half, position + half


def lamp_power(lamps: np.ndarray, radius: float) -> np.ndarray:
    """Return each lamp's power within the scene [W], by which light sampling chooses.

    Args:
        lamps: As from lamp_array.
        radius: Of the scene [m]; what a sun delivers is its irradiance over the scene's disk.
    """
    mean = np.maximum(lamps["radiance"].mean(-1, dtype=np.float64), 0.0) if len(lamps) else np.zeros(0)
    kind = lamps["kind"]
    ball = lamps["radius"].astype(np.float64)
    intensity = np.where(ball > 0, mean * math.pi * ball**2, mean)
    cone = np.where(kind == 2, np.maximum(1.0 - lamps["spot_cos"], 1e-4) * 0.5, 1.0)
    solid_angle = 2.0 * math.pi * lamps["one_minus_cos"].astype(np.float64)
    sun = mean * np.where(solid_angle > 0, solid_angle, 1.0) * math.pi * radius**2
    area = mean * math.pi * lamps["area"]
    return np.select([kind == 1, kind == 3], [sun, area], 4.0 * math.pi * intensity * cone)
