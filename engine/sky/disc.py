# SPDX-License-Identifier: GPL-3.0-or-later
"""The sun's disc in the skies by scattering: its picture as the eye sees it, and the sun lamp that shines as it does.

As in Cycles, the atmosphere's colour changes linearly from the disc's lower to its upper end, the limb is darkened
linearly, and what lies below the horizon of a round earth is hidden.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from . import multiple

__all__ = ["SunDisc", "sun_disc"]

SIZE = 64
"""Texels a side of the disc's picture"""

MARGIN = 2
"""Texels of it around the disc"""

SPLITS = 4
"""Points a side at which a texel is computed"""

LIMB_DARKENING = 0.6
"""How much darker the edge is than the middle"""

LEAST_SIZE = 0.0005
"""Smaller suns are drawn this large [rad], as in Cycles"""


@dataclass(frozen=True, eq=False)
class SunDisc:
    """The sun's disc, seen orthographically: what a square across it shows of the sphere of directions."""

    pixels: np.ndarray
    """float32 [SIZE, SIZE, 3], top row first: radiance over `peak`, 0 around the disc"""
    peak: np.ndarray
    """Largest radiance of each channel, float64 [3]"""
    elevation: float
    """Of the middle [rad]"""
    extent: float
    """Half the square's width, in sines of angles"""
    irradiance: np.ndarray
    """On a plane that faces what is seen of the disc, float64 [3]"""
    lamp_elevation: float
    """Elevation [rad] of the middle of what is seen"""
    lamp_angle: float
    """Angular diameter [rad] of a disc as large as what is seen"""


def horizon(altitude: float) -> float:
    """Return the elevation [rad] of the earth's edge from an altitude [m]."""
    return math.asin(min(multiple.EARTH / (multiple.EARTH + altitude * 1e-3), 1.0)) - 0.5 * math.pi


def sun_disc(bottom: np.ndarray, top: np.ndarray, to_rgb: np.ndarray, elevation: float, size: float, altitude: float,
             ) -> SunDisc | None:
    """Return the disc; None where nothing of it is seen.

    Args:
        bottom: Irradiance of the whole sun through the atmosphere at the disc's lower end, CIE XYZ.
        top: The same at its upper end.
        to_rgb: Matrix from XYZ to the colours' space.
        elevation: Of the sun [rad].
        size: Angular diameter [rad].
        altitude: Of the eye [m].
    """
    size = max(size, LEAST_SIZE)
    half = 0.5 * size
    extent = math.sin(half) * SIZE / (SIZE - 2 * MARGIN)
    points = SIZE * SPLITS
    x = ((np.arange(points) + 0.5) / points * 2.0 - 1.0)[None, :] * extent
    y = -x.T
    sine = np.sqrt(x * x + y * y)
    angle = np.arcsin(np.minimum(sine, 1.0))
    # Elevation of each point: y leads up the meridian.
    ahead = np.sqrt(np.maximum(1.0 - sine**2, 0.0))
    up = np.arcsin(np.clip(ahead * math.sin(elevation) + y * math.cos(elevation), -1.0, 1.0))
    seen = (angle < half) & (up > horizon(altitude))
    limb = 1.0 - LIMB_DARKENING * (1.0 - np.sqrt(np.maximum(1.0 - (angle / half) ** 2, 0.0)))
    share = ((up - elevation) / size + 0.5)[..., None]
    solid_angle = 2.0 * math.pi * (1.0 - math.cos(half))
    # Mixed as XYZ: of a red sun, one end may lie outside the colours that RGB can show.
    radiance = (np.asarray(bottom) * (1.0 - share) + np.asarray(top) * share) / solid_angle @ np.asarray(to_rgb).T
    radiance = np.maximum(radiance, 0.0) * (limb * seen)[..., None]
    pixels = radiance.reshape(SIZE, SPLITS, SIZE, SPLITS, 3).mean((1, 3))
    peak = pixels.max((0, 1))
    if not np.isfinite(peak).all() or not peak.any():
        return None
    # The area of an orthographic point is its solid angle times the cosine.
    area = (2.0 * extent / points) ** 2
    brightness = radiance.sum(-1)
    middle = float((brightness * y).sum() / brightness.sum())
    return SunDisc(
        pixels=(pixels / np.where(peak > 0.0, peak, 1.0)).astype(np.float32), peak=peak, elevation=elevation,
        extent=extent, irradiance=radiance.sum((0, 1)) * area, lamp_elevation=elevation + math.asin(middle),
        lamp_angle=2.0 * math.asin(math.sqrt(min(float(seen.sum()) * area / math.pi, 1.0))))
