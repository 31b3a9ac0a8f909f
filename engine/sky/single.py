# SPDX-License-Identifier: GPL-3.0-or-later
"""The sky by single scattering, in the form that Cycles draws.

Nishita, Sirai, Tadamura and Nakamae 1993, "Display of the Earth Taking into Account Atmospheric Scattering", with the
ozone of Bruneton 2017, at 21 wavelengths. Lengths are metres, spectra W/(m^2 nm).
"""

from __future__ import annotations

import functools

import numpy as np

from .atmosphere import (
    HEIGHT,
    WIDTH,
    around,
    atmosphere_rays,
    azimuth_nodes,
    distance_to_sphere,
    rayleigh_phase,
    sun_direction,
)

__all__ = ["ALTITUDE_MAX", "sky", "sun"]

EARTH, TOP = 6360e3, 6420e3
"""Radii of the ground and of the atmosphere's edge"""

ALTITUDE_MAX = 59999.0

SCALE_HEIGHTS = (8000.0, 1200.0)
"""Over which the densities of air and aerosols fall to 1/e"""

OZONE_HEIGHT, OZONE_WIDTH = 25000.0, 15000.0
"""Ozone's density falls from here up and down, linearly, to nothing"""

MIE_SCATTERING = 2e-5
"""Coefficient at sea level [1/m]"""

MIE_EXTINCTION = 1.11 * MIE_SCATTERING

MIE_G = 0.76
"""Asymmetry of the aerosols' phase function"""

STEPS = 32
"""Places along a ray of the view"""

WAVELENGTHS = np.arange(380.0, 781.0, 20.0)
"""[nm]"""

RAYLEIGH_SCATTERING = 1.13114876e-30 / (WAVELENGTHS * 1e-9) ** 4
"""Coefficients of air at sea level [1/m], by Rayleigh's law"""

OZONE_ABSORPTION = 1e-6 * np.array([
    0.003251268, 0.005853954, 0.019771912, 0.073095688, 0.200845615, 0.403839581, 0.635513359, 0.967070412,
    1.547974004, 2.090386472, 2.461280562, 2.735512995, 2.151258631, 1.590518408, 1.123561980, 0.735275515,
    0.464501304, 0.330960799, 0.225126123, 0.148791293, 0.168286234])
"""Coefficients at the layer's middle [1/m]: measured cross-sections"""

COLOR_MATCHING = np.array([
    [0.001368, 0.000039, 0.006450], [0.014310, 0.000396, 0.067850], [0.134380, 0.004000, 0.645600],
    [0.348280, 0.023000, 1.747060], [0.290800, 0.060000, 1.669200], [0.095640, 0.139020, 0.812950],
    [0.004900, 0.323000, 0.272000], [0.063270, 0.710000, 0.078250], [0.290400, 0.954000, 0.020300],
    [0.594500, 0.995000, 0.003900], [0.916300, 0.870000, 0.001650], [1.062200, 0.631000, 0.000800],
    [0.854450, 0.381000, 0.000190], [0.447900, 0.175000, 0.000020], [0.164900, 0.061000, 0.000000],
    [0.046770, 0.017000, 0.000000], [0.011359, 0.004102, 0.000000], [0.002899, 0.001047, 0.000000],
    [0.000690, 0.000249, 0.000000], [0.000166, 0.000060, 0.000000], [0.000042, 0.000015, 0.000000]])
"""CIE 1931 2-degree standard observer at WAVELENGTHS"""

SUN_TEMPERATURE, SUN_SOLID_ANGLE = 5778.0, 6.790164e-5
"""[K] and [sr]: the sun is a black body"""

LAGUERRE_END = 25.0
"""The quadrature of optical depths towards the sun ends at its rays' length over this many scale lengths"""


def sun_spectrum() -> np.ndarray:
    """Return the sun's irradiance above the atmosphere at WAVELENGTHS, by Planck's law."""
    length = WAVELENGTHS * 1e-9
    planck, light, boltzmann = 6.62607015e-34, 299792458.0, 1.380649e-23
    radiance = 2.0 * planck * light**2 / length**5 / np.expm1(planck * light / (length * boltzmann * SUN_TEMPERATURE))
    return radiance * 1e-9 * SUN_SOLID_ANGLE


@functools.cache
def laguerre() -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and weights, as shares of a ray's length, of eight-point Gauss-Laguerre quadrature."""
    nodes, weights = np.polynomial.laguerre.laggauss(8)
    return nodes / LAGUERRE_END, weights * np.exp(nodes) / LAGUERRE_END


def densities(height: np.ndarray) -> np.ndarray:
    """Return the relative densities of air, aerosols and ozone at heights above the ground: [..., 3]."""
    air, aerosols = (np.exp(-height / scale) for scale in SCALE_HEIGHTS)
    ozone = np.maximum(1.0 - np.abs(height - OZONE_HEIGHT) / OZONE_WIDTH, 0.0)
    return np.stack([air, aerosols, ozone], -1)


def depth_upwards(radius: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Return the optical depths of relative density 1 [m] to the atmosphere's edge: [..., 3].

    Args:
        radius: Distance from the planet's centre [m].
        cosine: Between the ray and the vertical.
    """
    length = distance_to_sphere(radius, cosine, TOP)
    nodes, weights = laguerre()
    t = length[..., None] * nodes
    height = np.sqrt(radius[..., None] ** 2 + t * (t + 2.0 * (radius * cosine)[..., None])) - EARTH
    return np.einsum("...qc,q->...c", densities(height), weights) * length[..., None]


def to_xyz(spectra: np.ndarray) -> np.ndarray:
    """Return CIE XYZ of spectra at WAVELENGTHS."""
    return spectra @ COLOR_MATCHING * (WAVELENGTHS[1] - WAVELENGTHS[0])


def extinction() -> np.ndarray:
    """Return the extinction of air, aerosols and ozone of density 1 by wavelength: [3, 21]."""
    return np.stack([RAYLEIGH_SCATTERING, np.full(len(WAVELENGTHS), MIE_EXTINCTION), OZONE_ABSORPTION])


def scattered(elevations: np.ndarray, azimuths: np.ndarray, sun_elevation: float, altitude: float,
              scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what air and aerosols scatter towards the eye but for their phase functions, in XYZ: two [R, A, 3]."""
    rays = atmosphere_rays(elevations, azimuths)
    sun = sun_direction(sun_elevation)
    eye = EARTH + altitude
    length = distance_to_sphere(eye, np.sin(elevations), TOP)
    step = length / STEPS
    t = (np.arange(STEPS) + 0.5) * step[:, None]
    radius = np.sqrt(eye * eye + t * (t + 2.0 * eye * np.sin(elevations)[:, None]))
    density = densities(radius - EARTH) * scale
    # Optical depth up to the end of each step, as Cycles sums it up.
    to_eye = np.cumsum(density, 1) * step[:, None, None]
    along_sun = t[:, None, :] * (rays @ sun)[..., None] + eye * sun[2]
    cosine = along_sun / radius[:, None, :]
    wide = np.broadcast_to(radius[:, None, :], cosine.shape)
    # As Cycles asks: the ground hides a sun below the horizon, wherever the ray has come to.
    lit = np.isnan(distance_to_sphere(wide, cosine, EARTH)) | (sun[2] >= 0.0)
    to_sun = depth_upwards(wide, cosine) * scale
    # Through the earth the depths exceed float32.
    total = np.minimum(to_eye[:, None] + to_sun, 1e30).astype(np.float32)
    light = np.exp(-(total @ extinction().astype(np.float32))) * lit[..., None]
    source = (sun_spectrum() * (WAVELENGTHS[1] - WAVELENGTHS[0])).astype(np.float32)
    amount = (density[..., :2] * step[:, None, None]).astype(np.float32)
    # The spectrum at each azimuth, of air and of aerosols.
    air, aerosols = (np.einsum("rasw,rs->raw", light, amount[..., kind]) * source
                     for kind in range(2))
    observer = COLOR_MATCHING.astype(np.float32)
    return (air * RAYLEIGH_SCATTERING.astype(np.float32)) @ observer, aerosols @ observer * np.float32(MIE_SCATTERING)


def sky(sun_elevation: float, altitude: float, air: float, aerosols: float, ozone: float) -> np.ndarray:
    """Return the image of the sky without the sun, CIE XYZ: float32 [HEIGHT, WIDTH, 3], lowest row first.

    Args:
        sun_elevation: [rad]
        altitude: Of the eye above the ground [m].
        air: Density of the air, relative to that of a clear sky.
        aerosols: The same of dust and droplets.
        ozone: The same of the ozone layer.
    """
    half = HEIGHT // 2
    altitude = min(max(altitude, 1.0), ALTITUDE_MAX)
    elevations = 0.5 * np.pi * (np.arange(half) / half) ** 2
    scale = np.array([air, aerosols, ozone])
    parts = scattered(elevations, azimuth_nodes(sun_elevation), sun_elevation, altitude, scale)
    columns = np.pi - 2.0 * np.pi / WIDTH * np.arange(WIDTH // 2)
    directions = atmosphere_rays(elevations, columns)
    cosine = directions @ sun_direction(sun_elevation)
    # Cornette and Shanks 1992.
    g2 = MIE_G**2
    mie = 3.0 * (1.0 - g2) * (1.0 + cosine**2) / (
        8.0 * np.pi * (2.0 + g2) * (1.0 + g2 - 2.0 * MIE_G * cosine) ** 1.5)
    upper = around(parts[0], columns) * rayleigh_phase(cosine)[..., None] + around(parts[1], columns) * mie[..., None]
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    image[half:, : WIDTH // 2] = upper
    # Below the horizon its light fades with the depth below.
    depth = np.sin(0.5 * np.pi * (np.arange(half) / half - 1.0) ** 2)
    image[:half, : WIDTH // 2] = upper[0] * (np.maximum(1.0 - 2.5 * depth, 0.0) ** 3)[:, None, None]
    image[:, WIDTH // 2 :] = image[:, WIDTH // 2 - 1 :: -1]
    return image


def sun(elevations: np.ndarray, altitude: float, air: float, aerosols: float, ozone: float) -> np.ndarray:
    """Return the sun's irradiance through the atmosphere at elevations [rad], CIE XYZ [N, 3]; ozone counts for nothing.

    Arguments as of sky().
    """
    altitude = min(max(altitude, 1.0), ALTITUDE_MAX)
    elevations = np.maximum(np.asarray(elevations, np.float64), 0.0)
    depth = depth_upwards(np.full(len(elevations), EARTH + altitude), np.sin(elevations))
    return to_xyz(sun_spectrum() * np.exp(-(depth * np.array([air, aerosols, 0.0])) @ extinction()))
