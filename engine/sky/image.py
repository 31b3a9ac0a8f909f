# SPDX-License-Identifier: GPL-3.0-or-later
"""A Sky Texture's settings to pictures in RGB: the sky, and the sun's disc. Each is computed once and remembered."""

from __future__ import annotations

import enum
import functools
import math
from dataclasses import dataclass

import numpy as np

from . import hosek, multiple, preetham, single
from .disc import SunDisc, sun_disc

__all__ = ["TO_REC709", "SkyKind", "SkySettings", "disc_of", "sky_at_sun", "sky_pixels"]

Matrix = tuple[tuple[float, float, float], ...]

TO_REC709: Matrix = (
    (3.2409699419045, -1.5373831775701, -0.4986107602930), (-0.9692436362809, 1.8759675015077, 0.0415550574072),
    (0.0556300796970, -0.2039769588890, 1.0569715142429))
"""CIE XYZ to linear Rec.709 (ITU-R BT.709, white D65)"""

BRIGHTEST = 6e4
"""What no sky exceeds in nature: fits half floats"""


class SkyKind(enum.StrEnum):
    """Models, named as in Blender."""

    SINGLE_SCATTERING = "SINGLE_SCATTERING"
    MULTIPLE_SCATTERING = "MULTIPLE_SCATTERING"
    PREETHAM = "PREETHAM"
    HOSEK_WILKIE = "HOSEK_WILKIE"


@dataclass(frozen=True)
class SkySettings:
    """What a sky looks like, but for its rotation about the vertical and the sun's disc."""

    kind: SkyKind
    sun_elevation: float
    """[rad], within a quarter turn"""
    altitude: float = 100.0
    """[m]; like the densities, of the models by scattering"""
    air: float = 1.0
    aerosols: float = 1.0
    ozone: float = 1.0
    turbidity: float = 2.2
    """Like the albedo, of the other models"""
    albedo: float = 0.3

    @property
    def atmosphere(self) -> tuple[float, float, float, float]:
        """Altitude and densities, as single.sky() takes them."""
        return self.altitude, self.air, self.aerosols, self.ozone

    @property
    def has_disc(self) -> bool:
        """Whether the model knows the sun itself."""
        return self.kind in (SkyKind.SINGLE_SCATTERING, SkyKind.MULTIPLE_SCATTERING)


def sky_xyz(settings: SkySettings) -> np.ndarray:
    """Return the image of a sky in CIE XYZ, float32 [HEIGHT, WIDTH, 3], lowest row first."""
    if settings.kind is SkyKind.SINGLE_SCATTERING:
        return single.sky(settings.sun_elevation, *settings.atmosphere)
    if settings.kind is SkyKind.MULTIPLE_SCATTERING:
        return multiple.sky(settings.sun_elevation, *settings.atmosphere)
    zenith = 0.5 * math.pi - settings.sun_elevation
    if settings.kind is SkyKind.HOSEK_WILKIE:
        return hosek.sky(zenith, settings.turbidity, settings.albedo)
    return preetham.sky(zenith, settings.turbidity)


@functools.lru_cache(maxsize=8)
def sky_pixels(settings: SkySettings, to_rgb: Matrix = TO_REC709) -> tuple[np.ndarray, float]:
    """Return a sky's picture as it is looked up, and what it must be multiplied by.

    Args:
        settings: Of the sky; the sun stands in the middle column.
        to_rgb: From CIE XYZ to the colours' space.

    Returns:
        float32 [HEIGHT, WIDTH, 3], top row first, not negative, finite, not to be written to; a power of two, 1 for
        skies by day.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        rgb = sky_xyz(settings)[::-1] @ np.asarray(to_rgb, np.float32).T
    pixels = np.clip(np.nan_to_num(rgb, nan=0.0), 0.0, BRIGHTEST)
    peak = float(pixels.max())
    # A night's radiance is raised to what half floats hold well.
    scale = 2.0 ** math.floor(math.log2(peak)) if 0.0 < peak < 0.25 else 1.0
    return np.ascontiguousarray(pixels / np.float32(scale)), scale


def sky_at_sun(settings: SkySettings, to_rgb: Matrix = TO_REC709) -> np.ndarray:
    """Return the sky's radiance about the sun, without it, float32 [3]; arguments as of sky_pixels()."""
    pixels, scale = sky_pixels(settings, to_rgb)
    share = settings.sun_elevation * 2.0 / math.pi
    row = int((0.5 - 0.5 * math.copysign(math.sqrt(abs(share)), share)) * len(pixels))
    return pixels[min(row, len(pixels) - 1), pixels.shape[1] // 2] * np.float32(scale)


@functools.lru_cache(maxsize=8)
def disc_of(settings: SkySettings, size: float, to_rgb: Matrix = TO_REC709) -> SunDisc | None:
    """Return the sun's disc in a sky, of intensity 1; None where it can't be seen or the model has none.

    Args:
        settings: Of the sky.
        size: Angular diameter of the sun [rad].
        to_rgb: From CIE XYZ to the colours' space.
    """
    if not settings.has_disc:
        return None
    model = single if settings.kind is SkyKind.SINGLE_SCATTERING else multiple
    half = 0.5 * size
    elevations = np.array([settings.sun_elevation - half, settings.sun_elevation + half])
    if model is single and elevations[1] <= 0.0:
        return None
    bottom, top = model.sun(elevations, *settings.atmosphere)
    return sun_disc(bottom, top, np.asarray(to_rgb), settings.sun_elevation, size, settings.altitude)
