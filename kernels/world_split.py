# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that find where the world's radiance exceeds a threshold: see engine/environment_split.py."""

from __future__ import annotations

import warp as wp

from .environment_split import excess_radiance
from .environment_table import equirect_direction
from .geometry_math import finite_or_zero, luminance, max_component
from .packing import rgb

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.kernel
def aim_at_texels(
    # In:
    start: int,
    first: int,
    texels: wp.array[int],
    points: int,
    width: int,
    height: int,
    # Out:
    directions_out: wp.array[wp.vec3],
):
    """Write the directions of `points` x `points` places in each texel of the world's table, row by row.

    In detail:
        start: Direction of the first thread of this launch.
        first: Direction that goes to the first place of `directions_out`.
    """
    i = start + wp.tid()
    texel = texels[i / (points * points)]
    place = i % (points * points)
    x = float(texel % width) + (float(place % points) + 0.5) / float(points)
    y = float(texel / width) + (float(place / points) + 0.5) / float(points)
    directions_out[i - first] = equirect_direction(x / float(width), y / float(height))


@wp.kernel
def measure_texels(
    # In:
    first: int,
    points: int,
    radiance: wp.array[wp.vec4],
    # Out:
    peaks_out: wp.array[float],
):
    """Write the mean of the largest channel over each texel's points."""
    i = first + wp.tid()
    count = points * points
    total = float(0.0)
    for k in range(count):
        total += max_component(finite_or_zero(rgb(radiance[i * count + k])))
    peaks_out[i] = total / float(count)


@wp.kernel
def cut_texels(
    # In:
    first: int,
    points: int,
    threshold: float,
    weights: wp.vec3,
    radiance: wp.array[wp.vec4],
    # Out:
    excess_out: wp.array[float],
    box_out: wp.array[wp.uint32],
    color_out: wp.array[wp.vec3],
):
    """Write each texel's mean excess of luminance, the smallest box of points that holds it, and its mean in there.

    So a sun that is smaller than a texel keeps its sharp shadow. Boxes are packed as EnvironmentSplit.box.
    """
    i = first + wp.tid()
    count = points * points
    excess = float(0.0)
    color = wp.vec3(0.0, 0.0, 0.0)
    left = points
    right = int(-1)
    top = points
    bottom = int(-1)
    for k in range(count):
        value = finite_or_zero(rgb(radiance[i * count + k]))
        brightness = luminance(value, weights)
        if brightness > threshold:
            excess += brightness - threshold
            color += excess_radiance(value, threshold, weights)
            left = wp.min(left, k % points)
            right = wp.max(right, k % points)
            top = wp.min(top, k / points)
            bottom = wp.max(bottom, k / points)
    across = wp.max(right - left + 1, 0)
    down = wp.max(bottom - top + 1, 0)
    excess_out[i] = excess / float(count)
    box_out[i] = wp.uint32(left | (across << 8) | (top << 16) | (down << 24))
    color_out[i] = color / float(wp.max(across * down, 1))
