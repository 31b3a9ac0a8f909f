# SPDX-License-Identifier: GPL-3.0-or-later
"""The rays of the screen probes: what the probes ask of the radiance cache, and what it answers."""

from __future__ import annotations

import warp as wp

# Distance [m] given for rays that leave the scene: fits a half-float, and means "a direction only".
MISS_DISTANCE = wp.constant(6.0e4)


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
