# SPDX-License-Identifier: GPL-3.0-or-later
"""The rays of the screen probes: what the probes ask of the radiance cache, and what it answers."""

from __future__ import annotations

import warp as wp

from .probe_types import FAR

# Distance [m] given for rays that leave the scene: fits a half-float, and means "a direction only".
MISS_DISTANCE = wp.constant(6.0e4)

# Least distance [m]: as a half-float it still is above 0, which stands for what is not known.
LEAST_DISTANCE = wp.constant(1.0e-7)


@wp.func
def inverse_distance(distance: float) -> float:
    """Return one over a distance [m]; 0 from FAR on, of which only the direction counts.

    Distances are averaged as their inverses, since parallax goes by these: those of the sky then say nothing, however
    large or small the scene is.
    """
    return wp.where(distance < FAR, 1.0 / wp.max(distance, LEAST_DISTANCE), 0.0)


@wp.func
def distance_of(inverse: float) -> float:
    """Return the distance of inverse_distance, at most MISS_DISTANCE."""
    return 1.0 / wp.max(inverse, 1.0 / MISS_DISTANCE)


@wp.struct
class ProbeRays:
    """One slot a ray: probe slot * 64 + cell of the probe's hemisphere."""

    origin: wp.array[wp.vec3]
    """[m, scene space], already off the surface"""
    direction: wp.array[wp.vec3]
    """Unit"""
    t_max: wp.array[float]
    """Limit of the ray [m]; 0: no ray in this slot"""
    probe: wp.array[int]
    """Slot of the probe that asks"""
    radiance: wp.array[wp.vec4]
    """Answer: radiance that arrives * exposure; w = distance of the hit [m], at most MISS_DISTANCE"""
