# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that bakes the world's sampling table (environment_table.py) from its program."""

from __future__ import annotations

import warp as wp

from .environment_table import equirect_direction
from .geometry_math import PI, max_component
from .nodes import evaluate_world
from .types import Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def bake_environment(
    # In:
    scene: Scene,
    width: int,
    height: int,
    first: int,
    points: int,
    # Out:
    importance_out: wp.array[float],
    radiance_out: wp.array[wp.vec3],
):
    """Fill the sampling table's texels with their largest radiance channel times solid angle, and with their radiance.

    `points` (4) a texel, so that a sun between two centres is not missed.
    """
    texel = first + wp.tid()
    i = texel % width
    j = texel // width
    footprint = PI / float(height)
    total = float(0.0)
    mean = wp.vec3(0.0, 0.0, 0.0)
    # Not a literal: Warp would unroll the loop and build the node machine four times.
    for k in range(points):
        dx = 0.25 + 0.5 * float(k % 2)
        dy = 0.25 + 0.5 * float(k // 2)
        direction = equirect_direction((float(i) + dx) / float(width), (float(j) + dy) / float(height))
        radiance = evaluate_world(scene, direction, 0, 1, 0.5 * footprint)
        value = max_component(radiance)
        if wp.isfinite(value) and value > 0.0:
            total += value
            mean += wp.max(radiance, wp.vec3(0.0, 0.0, 0.0)) / float(points)
    theta = PI * (float(j) + 0.5) / float(height)
    radiance_out[texel] = mean
    importance_out[texel] = total * wp.sin(theta) / float(points)
