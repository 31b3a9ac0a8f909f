# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel that draws the G-buffer's contents as colours."""

from __future__ import annotations

import warp as wp

from .debug_colors import hash_color, heat
from .gbuffer import GBuffer, load_material
from .intersect import MISS
from .packing import rgba, unpack_normal
from .reprojection import Reprojection, has_tap, tap_weight

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

GBUFFER_NORMAL = wp.constant(0)
GBUFFER_ALBEDO = wp.constant(1)
GBUFFER_SPECULAR = wp.constant(2)
GBUFFER_ROUGHNESS = wp.constant(3)
GBUFFER_DEPTH = wp.constant(4)
GBUFFER_MOTION = wp.constant(5)
GBUFFER_INSTANCE = wp.constant(6)
GBUFFER_DISOCCLUSION = wp.constant(7)
GBUFFER_TRANSMITTED = wp.constant(8)
GBUFFER_COAT = wp.constant(9)

# Motion [px] that is drawn in full colour.
MOTION_RANGE = wp.constant(16.0)


@wp.func
def missing_history(reprojection: Reprojection, pixel: int) -> float:
    """Return the share of the bilinear weights that the frame before does not show."""
    missing = float(1.0)
    for tap in range(4):
        if has_tap(reprojection.taps[pixel], tap):
            missing = missing - tap_weight(reprojection.position[pixel], tap)
    return wp.max(missing, 0.0)


@wp.func
def surface_color(gbuffer: GBuffer, pixel: int, what: int) -> wp.vec3:
    """Return the colour of what is known where there is a surface."""
    m = load_material(gbuffer, pixel)
    c = m.diffuse
    if what == GBUFFER_NORMAL:
        c = unpack_normal(gbuffer.normal[pixel]) * 0.5 + wp.vec3(0.5, 0.5, 0.5)
    if what == GBUFFER_SPECULAR:
        c = m.specular
    if what == GBUFFER_ROUGHNESS:
        c = wp.vec3(m.roughness, m.roughness, m.roughness)
    if what == GBUFFER_TRANSMITTED:
        c = m.transmitted
    if what == GBUFFER_COAT:
        c = wp.vec3(m.coat, m.coat, m.coat)
    if what == GBUFFER_DEPTH:
        # 1 cm to 1 km in equal steps of the logarithm, near ones light.
        c = heat(1.0 - (wp.log(wp.max(gbuffer.depth[pixel], 1.0e-6)) / 2.3025851 + 2.0) / 5.0)
    if what == GBUFFER_INSTANCE:
        c = hash_color(gbuffer.hit[pixel][0])
    return c


@wp.kernel
def draw_gbuffer(
    # In:
    first: int,
    gbuffer: GBuffer,
    reprojection: Reprojection,
    width: int,
    what: int,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Draw one of GBUFFER_*, a pixel a thread."""
    pixel = first + wp.tid()
    c = wp.vec3(0.0, 0.0, 0.0)
    if gbuffer.hit[pixel][0] != MISS:
        c = surface_color(gbuffer, pixel, what)
    if what == GBUFFER_MOTION:
        centre = wp.vec2(float(pixel % width) + 0.5, float(pixel // width) + 0.5)
        motion = (centre - reprojection.position[pixel]) / (2.0 * MOTION_RANGE)
        c = wp.vec3(wp.clamp(0.5 + motion[0], 0.0, 1.0), wp.clamp(0.5 + motion[1], 0.0, 1.0), 0.5)
    if what == GBUFFER_DISOCCLUSION:
        missing = missing_history(reprojection, pixel)
        c = wp.vec3(missing, missing, missing)
    picture_out[pixel] = rgba(c, 1.0)
