# SPDX-License-Identifier: GPL-3.0-or-later
"""The sky of Preetham, Shirley, Smits 1999, "A Practical Analytic Model for Daylight": Perez' formula, appendix A.2."""

from __future__ import annotations

import numpy as np

from .atmosphere import atmosphere_rays, half_azimuths, mirrored, row_elevations

__all__ = ["LOWEST", "half_directions", "sky"]

LOWEST = 0.5 * np.pi - 0.001
"""Largest zenith angle [rad] that such formulas are asked for: what lies lower looks as the horizon does"""

LUMINANCE_SCALE = 0.06
"""Of the paper's kcd/m^2 to Cycles' radiance"""

PEREZ = {
    "Y": ((0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703)),
    "x": ((-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452)),
    "y": ((-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529)),
}
"""Coefficients A to E of luminance and chromaticities, as slope and offset over turbidity"""

ZENITH = {
    "x": ((0.00166, -0.00375, 0.00209, 0.0), (-0.02903, 0.06377, -0.03202, 0.00394),
          (0.11693, -0.21196, 0.06052, 0.25886)),
    "y": ((0.00275, -0.00610, 0.00317, 0.0), (-0.04214, 0.08970, -0.04153, 0.00516),
          (0.15346, -0.26756, 0.06670, 0.26688)),
}
"""Chromaticities of the zenith: cubics of the sun's zenith angle, for powers 2, 1 and 0 of turbidity"""


def half_directions(sun_zenith: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the zenith angles, at most LOWEST, and the angles from the sun of an image's left half: two [H, W / 2]."""
    elevations = row_elevations()
    cosine = atmosphere_rays(elevations, half_azimuths()) @ np.array([np.sin(sun_zenith), 0.0, np.cos(sun_zenith)])
    zenith = np.minimum(0.5 * np.pi - elevations, LOWEST)
    return np.broadcast_to(zenith[:, None], cosine.shape), np.arccos(np.clip(cosine, -1.0, 1.0))


def perez(coefficients: np.ndarray, zenith: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return Perez' function of zenith angle and angle from the sun [rad]."""
    a, b, c, d, e = coefficients
    return (1.0 + a * np.exp(b / np.cos(zenith))) * (1.0 + c * np.exp(d * angle) + e * np.cos(angle) ** 2)


def sky(sun_zenith: float, turbidity: float) -> np.ndarray:
    """Return the image of the sky, CIE XYZ: float32 [HEIGHT, WIDTH, 3], lowest row first.

    Args:
        sun_zenith: Angle of the sun from the vertical [rad].
        turbidity: Of the air: 2 clear, 10 hazy.
    """
    powers = np.array([turbidity**2, turbidity, 1.0])
    chi = (4.0 / 9.0 - turbidity / 120.0) * (np.pi - 2.0 * sun_zenith)
    zenith = {"Y": LUMINANCE_SCALE * (
        (4.0453 * turbidity - 4.9710) * np.tan(chi) - 0.2155 * turbidity + 2.4192)}
    for name, cubics in ZENITH.items():
        zenith[name] = powers @ [np.polyval(cubic, sun_zenith) for cubic in cubics]
    view, angle = half_directions(sun_zenith)
    found = {}
    for name, lines in PEREZ.items():
        coefficients = [slope * turbidity + offset for slope, offset in lines]
        found[name] = zenith[name] / perez(coefficients, 0.0, sun_zenith) * perez(coefficients, view, angle)
    x, y, luminance = found["x"], found["y"], found["Y"]
    half = np.stack([x / y * luminance, luminance, (1.0 - x - y) / y * luminance], -1)
    return mirrored(half)
