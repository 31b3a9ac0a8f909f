# SPDX-License-Identifier: GPL-3.0-or-later
"""The sky by multiple scattering, in the form that Cycles draws.

Fernando García Liñán 2024, "A Fast, Physically-based Sky Model with only 4 Wavelengths"
(https://fgarlin.com/posts/2024-12-06-spectral_sky), with his atmosphere of an urban area. Scattering beyond the first
is a fit that holds for the earth. Lengths are kilometres, the four wavelengths 630, 560, 490 and 430 nm.
"""

from __future__ import annotations

import functools

import numpy as np

from .atmosphere import (
    around,
    atmosphere_rays,
    azimuth_nodes,
    distance_to_sphere,
    half_azimuths,
    mirrored,
    rayleigh_phase,
    row_elevations,
    sun_direction,
)

__all__ = ["ALTITUDE_MAX", "EARTH", "sky", "sun"]

EARTH, THICKNESS = 6371.0, 100.0
"""Radius of the ground, height of the atmosphere [km]"""

ALTITUDE_MAX = 99999.0
"""[m]"""

STEPS = 64
"""Places along a ray, of the view and towards the sun"""

TABLE_WIDTH, TABLE_HEIGHT = 256, 64
"""Entries of the table of transmittances: cosines of the sun's zenith angle, and altitudes"""

GROUND_ALBEDO = 0.3
AEROSOL_G = 0.8
"""Asymmetry of the aerosols' phase function (Henyey and Greenstein 1941)"""

SUN = np.array([1.679, 1.828, 1.986, 1.307])
"""Irradiance above the atmosphere [W/(m^2 nm)]"""

AIR_SCATTERING = np.array([6.605e-3, 1.067e-2, 1.842e-2, 3.156e-2])
"""At sea level [1/km]"""

OZONE_CROSS_SECTION = np.array([3.472e-25, 3.914e-25, 1.349e-25, 11.03e-27])
OZONE_DOBSON = 334.5
AEROSOL_ABSORPTION = np.array([2.8722e-24, 4.6168e-24, 7.9706e-24, 1.3578e-23])
AEROSOL_SCATTERING = np.array([1.5908e-22, 1.7711e-22, 2.0942e-22, 2.4033e-22])
AEROSOL_DENSITY, AEROSOL_BACKGROUND, AEROSOL_SCALE_HEIGHT = 1.3681e20, 2e6, 0.73

FURTHER_SCATTERING = 0.02 * np.array([0.217, 0.347, 0.594, 1.0])
"""The fit of all scattering beyond the first, with the sun high"""

TO_XYZ = np.array([
    [53.386917738564668, 22.981337506691025, 0.0],
    [43.904844466369358, 71.347795700053394, 0.102506867965741],
    [1.613727825160896, 18.422960591455485, 31.742921188390806],
    [20.762668673810577, 2.361421352331437, 110.480096432521403]])
"""Of the four wavelengths to CIE XYZ, fitted to full spectra"""

Densities = tuple[float, float, float]
"""Of air, aerosols and ozone, relative to the urban atmosphere"""


def profiles(height: np.ndarray) -> np.ndarray:
    """Return how much of air, aerosols and ozone there is at heights [km], in their coefficients' units: [..., 3]."""
    height = np.maximum(height, 0.0)
    air = np.exp(-0.07771971 * height**1.16364243)
    aerosols = AEROSOL_DENSITY * np.exp(-height / AEROSOL_SCALE_HEIGHT) + AEROSOL_BACKGROUND
    log_height = np.log(np.maximum(height, 1e-4))
    ozone = OZONE_DOBSON * 3.78547397e20 * np.exp(-((log_height - 3.22261) ** 2) * 5.55555555 - log_height)
    return np.stack([air, aerosols, ozone], -1)


def extinction(densities: Densities) -> np.ndarray:
    """Return the extinction of a unit of each of the profiles: [3, 4]."""
    parts = np.stack([AIR_SCATTERING, AEROSOL_SCATTERING + AEROSOL_ABSORPTION, OZONE_CROSS_SECTION])
    return parts * np.asarray(densities)[:, None]


def depth_upwards(cosine: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Return the profiles integrated from heights [km] to the atmosphere's edge: [..., 3].

    Args:
        cosine: Between the ray and the vertical.
        height: Above the ground.
    """
    cosine, height = np.broadcast_arrays(cosine, height)
    radius = EARTH + height
    length = distance_to_sphere(radius, cosine, EARTH + THICKNESS)
    t = (np.arange(STEPS) + 0.5) / STEPS * length[..., None]
    heights = np.sqrt(radius[..., None] ** 2 + t * (t + 2.0 * (radius * cosine)[..., None])) - EARTH
    return profiles(heights).sum(-2) * (length / STEPS)[..., None]


@functools.cache
def depth_table() -> np.ndarray:
    """Return depth_upwards for the table of transmittances: [TABLE_HEIGHT, TABLE_WIDTH, 3]."""
    height = np.linspace(0.0, THICKNESS, TABLE_HEIGHT)
    return depth_upwards(np.linspace(-1.0, 1.0, TABLE_WIDTH)[None, :], height[:, None])


@functools.lru_cache(maxsize=4)
def transmittance_table(densities: Densities) -> np.ndarray:
    """Return the transmittance towards the sun, float32 [altitudes, cosines, 4]."""
    return np.exp(-(depth_table() @ extinction(densities))).astype(np.float32)


def look_up(table: np.ndarray, cosine: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Interpolate a transmittance_table linearly: [..., 4]."""
    x = np.clip(cosine * 0.5 + 0.5, 0.0, 1.0) * (TABLE_WIDTH - 1)
    y = np.clip(height / THICKNESS, 0.0, 1.0) * (TABLE_HEIGHT - 1)
    x0, y0 = np.minimum(x.astype(int), TABLE_WIDTH - 2), np.minimum(y.astype(int), TABLE_HEIGHT - 2)
    fx, fy = (x - x0).astype(np.float32)[..., None], (y - y0).astype(np.float32)[..., None]
    first = y0 * TABLE_WIDTH + x0
    flat = table.reshape(-1, table.shape[-1])
    low = flat[first] * (1.0 - fx) + flat[first + 1] * fx
    high = flat[first + TABLE_WIDTH] * (1.0 - fx) + flat[first + TABLE_WIDTH + 1] * fx
    return low * (1.0 - fy) + high * fy


def from_ground(table: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Return what of the light on the ground comes up to heights [km] from all sides: [..., 4]."""
    planet = 2.0 * np.pi * (1.0 - np.sqrt(np.maximum(1.0 - (EARTH / (EARTH + height)) ** 2, 0.0)))
    up, none = np.ones_like(height), np.zeros_like(height)
    passed = look_up(table, up, none) / np.maximum(look_up(table, up, height), 1e-30)
    return planet[..., None] * GROUND_ALBEDO / np.pi / (4.0 * np.pi) * passed


def scattered(elevations: np.ndarray, azimuths: np.ndarray, sun_elevation: float, altitude: float,
              densities: Densities) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return light that air, aerosols (but for their phase functions) and both further scatter: three [R, A, 4]."""
    rays = atmosphere_rays(elevations, azimuths)
    sun = sun_direction(sun_elevation)
    eye = EARTH + altitude
    up = np.sin(elevations)
    ground = distance_to_sphere(eye, up, EARTH, near=True)
    length = np.where(np.isnan(ground) | (up >= 0.0), distance_to_sphere(eye, up, EARTH + THICKNESS), ground)
    step = (length / STEPS)[:, None]
    t = (np.arange(STEPS) + 0.5) * step
    radius = np.sqrt(eye * eye + t * (t + 2.0 * eye * up[:, None]))
    height = np.maximum(radius - EARTH, 0.0)
    amounts = profiles(height)
    dimming = amounts @ extinction(densities)
    passed = np.exp(-dimming * step[..., None])
    before = np.cumprod(np.concatenate([np.ones_like(passed[:, :1]), passed[:, :-1]], 1), 1)
    # Light that enters evenly along a step and is dimmed on the way out (Hillaire 2016).
    weight = before * (1.0 - passed) / np.maximum(dimming, 1e-7)
    air, aerosols = ((weight * amounts[..., kind, None] * densities[kind] * each * SUN).astype(np.float32)
                     for kind, each in enumerate((AIR_SCATTERING, AEROSOL_SCATTERING)))
    cosine = ((t[:, None, :] * (rays @ sun)[..., None] + eye * sun[2]) / radius[:, None, :]).astype(np.float32)
    height = height.astype(np.float32)
    table = transmittance_table(densities)
    to_sun = look_up(table, cosine, np.broadcast_to(height[:, None, :], cosine.shape))
    ground = look_up(table[:2], cosine, np.zeros_like(cosine)) * cosine[..., None]
    ground *= from_ground(table, height)[:, None]
    fit = 1.0 / (1.0 + 5.0 * np.exp(-17.92 * cosine))
    both = air + aerosols
    further = np.einsum("rasw,rsw->raw", ground, both)
    further += np.einsum("ras,rsw->raw", fit, both) * FURTHER_SCATTERING
    return np.einsum("rasw,rsw->raw", to_sun, air), np.einsum("rasw,rsw->raw", to_sun, aerosols), further


def sky(sun_elevation: float, altitude: float, air: float, aerosols: float, ozone: float) -> np.ndarray:
    """Return the image of the sky without the sun, CIE XYZ: float32 [HEIGHT, WIDTH, 3], lowest row first.

    Arguments as of single.sky().
    """
    elevations, height = row_elevations(), min(max(altitude, 1.0), ALTITUDE_MAX) * 1e-3
    parts = scattered(elevations, azimuth_nodes(sun_elevation), sun_elevation, height, (air, aerosols, ozone))
    columns = half_azimuths()
    cosine = atmosphere_rays(elevations, columns) @ sun_direction(sun_elevation)
    g2 = AEROSOL_G**2
    mie = (1.0 - g2) / (4.0 * np.pi) / (1.0 + g2 - 2.0 * AEROSOL_G * cosine) ** 1.5
    by_air, by_aerosols, by_both = (around(part @ TO_XYZ, columns) for part in parts)
    half = by_air * rayleigh_phase(cosine)[..., None] + by_aerosols * mie[..., None] + by_both
    return mirrored(half)


def sun(elevations: np.ndarray, altitude: float, air: float, aerosols: float, ozone: float) -> np.ndarray:
    """Return the sun's irradiance through the atmosphere at elevations [rad], CIE XYZ [N, 3].

    Arguments as of sky().
    """
    height = min(max(altitude, 1.0), ALTITUDE_MAX) * 1e-3
    elevations = np.asarray(elevations, np.float64)
    depth = depth_upwards(np.sin(elevations), np.full(len(elevations), height))
    return SUN * np.exp(-(depth @ extinction((air, aerosols, ozone)))) @ TO_XYZ
