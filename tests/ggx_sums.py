# SPDX-License-Identifier: GPL-3.0-or-later
"""GGX reflection as plain sums over directions, to compare kernels with."""

import numpy as np


def directions(steps=256):
    """Return unit vectors [n, 3] of the upper hemisphere, each for the same solid angle."""
    z = (np.arange(steps) + 0.5) / steps
    phi = 2 * np.pi * (np.arange(2 * steps) + 0.5) / (2 * steps)
    z, phi = (a.ravel() for a in np.meshgrid(z, phi))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)


def lobe_values(cosine, roughness, f0, f90, d):
    """Return f cos for a view in the xz plane: GGX with height-correlated Smith shadowing, 0 below the plane z = 0.

    Facets reflect as by fresnel.grazing_share.
    """
    alpha2 = roughness**4
    wo = np.array([np.sqrt(max(1 - cosine * cosine, 0.0)), 0.0, cosine])
    h = d + wo
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    density = alpha2 / (np.pi * (h[:, 2] ** 2 * (alpha2 - 1) + 1) ** 2)
    z = np.maximum(d[:, 2], 1e-6)

    def smith(c):
        return 0.5 * (np.sqrt(1 + alpha2 * (1 / (c * c) - 1)) - 1)

    facet = np.clip(h @ wo, 0.0, 1.0)
    bend = 0.75 if f0 < 0.15 * f90 else 0.0
    fresnel = f0 + (f90 - f0) * (1 - facet) ** 3 * ((1 - facet) ** 2 + bend * facet**2)
    return np.where(d[:, 2] > 0, density / (4 * cosine * (1 + smith(cosine) + smith(z))) * fresnel, 0.0)
