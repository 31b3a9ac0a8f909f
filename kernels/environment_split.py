# SPDX-License-Identifier: GPL-3.0-or-later
"""The world split in two: a soft part that probes gather, and an excess (suns, windows) that is sampled as a light.

Radiance whose luminance is above a threshold is scaled down to it in the soft part; the excess is the rest, so the
two add up exactly. engine/environment_split.py chooses the threshold.
"""

from __future__ import annotations

import warp as wp

from .geometry_math import luminance
from .types import Environment

# A threshold from here on means that there is no excess.
NO_THRESHOLD = wp.constant(1.0e30)


@wp.struct
class EnvironmentSplit:
    """Where the world's radiance is cut, and how its excess is sampled."""

    threshold: float
    """Luminance of the brightest soft radiance [W/sr/m2]; NO_THRESHOLD where nothing is above it"""
    power: float
    """Luminance of the excess, integrated over the sphere"""
    share: float
    """Of the excess in all the world's light; 0: there is none"""
    table: Environment
    """Its weights are the chances of texels for the excess"""
    points: int
    """Cells a side into which `box` divides a texel"""
    excess: wp.array[wp.vec3]
    """Mean radiance of the excess inside each texel's box, so that no program runs for it; its detail is lost"""
    box: wp.array[wp.uint32]
    """Part of each texel that holds excess, in cells: first column | columns << 8 | first row << 16 | rows << 24"""


@wp.func
def soft_radiance(radiance: wp.vec3, threshold: float, weights: wp.vec3) -> wp.vec3:
    """Return the part of the world's radiance that probes gather: its luminance limited to the threshold.

    Args:
        radiance: Unfiltered, so that both parts cut the same value.
        threshold: EnvironmentSplit.threshold.
        weights: Scene.luminance.
    """
    brightness = luminance(radiance, weights)
    if brightness > threshold:
        return radiance * (threshold / brightness)
    return radiance


@wp.func
def excess_radiance(radiance: wp.vec3, threshold: float, weights: wp.vec3) -> wp.vec3:
    """Return the part of the world's radiance that is sampled as a light: all but soft_radiance."""
    brightness = luminance(radiance, weights)
    if brightness > threshold:
        return radiance * (1.0 - threshold / brightness)
    return wp.vec3(0.0, 0.0, 0.0)
