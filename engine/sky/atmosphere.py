# SPDX-License-Identifier: GPL-3.0-or-later
"""What the scattering models of the sky share: the image's directions, rays in a round atmosphere, Cycles' grid.

The image of a sky is looked up as Cycles does it (PROJECTION_SKY in kernels/node_texture.py): columns are azimuths,
the sun in the middle; rows are elevations whose root is even, so that most of them lie near the horizon.
"""

from __future__ import annotations

import numpy as np

__all__ = [
    "HEIGHT", "WIDTH", "around", "atmosphere_rays", "azimuth_nodes", "distance_to_sphere", "half_azimuths", "mirrored",
    "rayleigh_phase", "row_elevations", "sun_direction",
]

WIDTH, HEIGHT = 512, 256
"""Size of a sky's image, as in Cycles"""

NODES, NODES_BY_DAY = 33, 17
"""Azimuths at which what varies slowly is computed, from the sun's to the one opposite it; the low sun's shadows are
narrower"""

DAY = 0.1
"""Elevation of the sun [rad] from which on it is day"""


def row_elevations() -> np.ndarray:
    """Return the elevations [rad] of the image's rows at their centres, lowest first: float64 [HEIGHT]."""
    y = 2.0 * (np.arange(HEIGHT) + 0.5) / HEIGHT - 1.0
    return np.copysign(y * y, y) * 0.5 * np.pi


def half_azimuths() -> np.ndarray:
    """Return the azimuths from the sun [rad] of the columns of the image's left half, at their centres: [WIDTH / 2]."""
    return np.pi - 2.0 * np.pi * (np.arange(WIDTH // 2) + 0.5) / WIDTH


def mirrored(half: np.ndarray) -> np.ndarray:
    """Return the image, float32 [HEIGHT, WIDTH, 3], of its left half: the right one mirrors it."""
    return np.concatenate([half, half[:, ::-1]], 1).astype(np.float32)


def sun_direction(elevation: float) -> np.ndarray:
    """Return the unit vector towards a sun at an elevation [rad]; its azimuth is 0."""
    return np.array([np.cos(elevation), 0.0, np.sin(elevation)])


def rayleigh_phase(cosine: np.ndarray) -> np.ndarray:
    """Return the phase function of air by the cosine of the angle by which it scatters [1/sr]."""
    return 3.0 / (16.0 * np.pi) * (1.0 + cosine**2)


def azimuth_nodes(sun_elevation: float) -> np.ndarray:
    """Return the azimuths from the sun [rad] that `around` interpolates between, float64, evenly from 0 to pi."""
    return np.linspace(0.0, np.pi, NODES_BY_DAY if sun_elevation > DAY else NODES)


def around(values: np.ndarray, azimuths: np.ndarray) -> np.ndarray:
    """Interpolate along the second axis from azimuth_nodes to other azimuths in [0, pi].

    Args:
        values: [rows, nodes, channels]
        azimuths: [columns]

    Returns:
        [rows, columns, channels]
    """
    last = values.shape[1] - 1
    place = np.clip(azimuths / np.pi * last, 0.0, last)
    low = np.minimum(place.astype(int), last - 1)
    share = (place - low)[None, :, None]
    return values[:, low] * (1.0 - share) + values[:, low + 1] * share


def atmosphere_rays(elevations: np.ndarray, azimuths: np.ndarray) -> np.ndarray:
    """Return the unit directions of all pairs, the azimuth 0 along +x, z up: [rows, columns, 3]."""
    elevation, azimuth = elevations[:, None], azimuths[None, :]
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], -1)


def distance_to_sphere(height: np.ndarray, cosine: np.ndarray, radius: float, *, near: bool = False) -> np.ndarray:
    """Return the distance along a ray to a sphere about the planet's centre, NaN where it misses.

    Args:
        height: Distance of the ray's origin from the centre.
        cosine: Between the ray and the vertical.
        radius: Of the sphere, in the same unit.
        near: The first of the two places, where the ray enters, instead of the last.
    """
    along = height * cosine
    # (h - r) (h + r), not h^2 - r^2: the ground is a millionth of the radius away.
    root = along * along - (height - radius) * (height + radius)
    with np.errstate(invalid="ignore"):
        half = np.sqrt(root)
    return -along - half if near else half - along
