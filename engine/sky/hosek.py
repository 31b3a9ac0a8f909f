# SPDX-License-Identifier: GPL-3.0-or-later
"""The sky of Hosek and Wilkie 2012, "An Analytic Model for Full Spectral Sky-Dome Radiance", in CIE XYZ.

Its formula (equation 8) is the paper's; its coefficients, which the paper gives as a data set apart, were fitted to
pictures that Cycles drew (tests/fit_hosek.py), and lie in hosek.txt. A, B, E and H are quintic Bezier curves over the
cube root of the sun's elevation, linear in turbidity and in the ground's albedo between their knots. The five other
coefficients are products of two such functions, and so are exact as polynomials of twice the degree.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np

from .atmosphere import mirrored
from .preetham import half_directions

__all__ = ["curve_places", "evaluate", "sky", "terms"]

DEGREE = 5
PLACES = 2 * DEGREE + 1
"""Sun elevations at which the products are known"""

TURBIDITIES, ALBEDOS = 10, 2
"""Knots from 1 on, and from 0 to 1"""


@functools.cache
def tables() -> tuple[np.ndarray, np.ndarray]:
    """Return the control points of A, B, E, H, and the products: see tests/fit_hosek.py.

    Returns:
        [TURBIDITIES, ALBEDOS, 3 of XYZ, DEGREE + 1, 4]; [2 TURBIDITIES - 1, 2 ALBEDOS - 1, 3, PLACES, 5]
    """
    return read_tables(Path(__file__).with_name("hosek.txt"))


def read_tables(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read what tests/fit_hosek.py has written; returns as tables()."""
    rows = [line.split() for line in path.read_text("utf-8").splitlines() if not line.startswith("#")]
    shape, products = (TURBIDITIES, ALBEDOS, 3, DEGREE + 1, 4), (2 * TURBIDITIES - 1, 2 * ALBEDOS - 1, 3, PLACES, 5)
    count = math.prod(shape[:-1])
    return np.array(rows[:count], np.float64).reshape(shape), np.array(rows[count:], np.float64).reshape(products)


def curve_places() -> np.ndarray:
    """Return the places in [0, 1] of the curves at which the products are known: Chebyshev's, [PLACES]."""
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(PLACES) / (PLACES - 1))


def bezier(place: np.ndarray) -> np.ndarray:
    """Return the weights of the control points at places of the curve: [..., DEGREE + 1]."""
    x = np.asarray(place, np.float64)[..., None]
    k = np.arange(DEGREE + 1)
    return np.array([math.comb(DEGREE, i) for i in k]) * x**k * (1.0 - x) ** (DEGREE - k)


def lagrange(nodes: np.ndarray, x: float) -> np.ndarray:
    """Return the weights of values at nodes that a polynomial through them has at x."""
    differences = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(differences, 1.0)
    away = np.tile(x - nodes, (len(nodes), 1))
    np.fill_diagonal(away, 1.0)
    return (away / differences).prod(1)


def terms(shape: np.ndarray, zenith: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return what the coefficients C, D, F, G, I are multiplied by: [..., 5].

    Args:
        shape: A, B, E, H, [..., 4], to be broadcast with the angles.
        zenith: Of the view [rad].
        angle: Between the view and the sun [rad].
    """
    a, b, e, h = np.moveaxis(shape, -1, 0)
    up, along = np.cos(zenith), np.cos(angle)
    horizon = 1.0 + a * np.exp(b / (up + 0.01))
    glow = (1.0 + along**2) / np.maximum(1.0 + h * h - 2.0 * h * along, 1e-9) ** 1.5
    parts = (np.ones_like(horizon * angle), np.exp(e * angle), along**2, glow, np.sqrt(up))
    return np.stack(np.broadcast_arrays(*parts), -1) * (horizon * np.ones_like(angle))[..., None]


def evaluate(sun_zenith: float, turbidity: float, albedo: float, zenith: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the sky's radiance in CIE XYZ: [..., 3].

    Args:
        sun_zenith: Angle of the sun from the vertical [rad]; below the horizon it counts as on it.
        turbidity: 1 to 10.
        albedo: Of the ground, 0 to 1.
        zenith: Of the view [rad].
        angle: Between the view and the sun [rad].
    """
    shapes, weights = tables()
    elevation = min(max(0.5 * math.pi - sun_zenith, 0.0), 0.5 * math.pi)
    place = (elevation / (0.5 * math.pi)) ** (1.0 / 3.0)
    turbidity, albedo = min(max(turbidity, 1.0), float(TURBIDITIES)), min(max(albedo, 0.0), 1.0)
    knot = min(int(turbidity) - 1, TURBIDITIES - 2)
    rest = turbidity - 1.0 - knot
    linear = np.einsum("t,a,k->tak", (1.0 - rest, rest), (1.0 - albedo, albedo), bezier(place))
    shape = np.einsum("tak,tackp->cp", linear, shapes[knot : knot + 2])
    halves = np.array([0.0, 0.5, 1.0])
    products = np.einsum(
        "t,a,k->tak", lagrange(halves, rest), lagrange(halves, albedo), lagrange(curve_places(), place))
    factors = np.einsum("tak,tackp->cp", products, weights[2 * knot : 2 * knot + 3])
    return np.stack([terms(shape[c], zenith, angle) @ factors[c] for c in range(3)], -1)


def sky(sun_zenith: float, turbidity: float, albedo: float) -> np.ndarray:
    """Return the image of the sky, CIE XYZ: float32 [HEIGHT, WIDTH, 3], lowest row first.

    Arguments as of evaluate().
    """
    # Cycles measures angles from a sun that is on the horizon at least.
    sun_zenith = min(sun_zenith, 0.5 * math.pi)
    half = evaluate(sun_zenith, turbidity, albedo, *half_directions(sun_zenith))
    return mirrored(half)
