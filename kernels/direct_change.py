# SPDX-License-Identifier: GPL-3.0-or-later
"""Where direct light changes at once because something has moved: shadows that come and go.

A mean over frames follows them by a share a frame, and a short mean beside it (direct_atrous.py) needs two or three
frames to tell a change from noise: shadows of things that move fast would be left behind. Here the samples of a frame
are compared, over nine pixels, with the means that the same pixels had, so that what has changed is known in the frame
in which it does; the means are moved by the difference. As the temporal gradients of Schied, Peters and Dachsbacher
("Gradient Estimation for Real-Time Adaptive Temporal Filtering", HPG 2018, section 3), but without samples of their
own: where little noise is, shadows can be seen without them, and elsewhere they matter less.
"""

from __future__ import annotations

import warp as wp

from .direct_temporal import DirectHistory, albedos, change_terms, has_sample, relative_albedo, standard_errors
from .filter_weights import brightness, inside, pixel_plane, surface_weight
from .gbuffer import GBuffer
from .long_mean import unpack_mean
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb, rgba, unpack_unorm16
from .reprojection import Reprojection, known_taps
from .view import MOVED_FRAMES, SKY_DEPTH, View
from .wide_loads import load_view

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Relative difference that is always taken for noise.
MARGIN = wp.constant(0.05)
# Standard errors from which on a difference is a change, and by how many more it is wholly one.
LEAST_ERRORS = wp.constant(2.5)
ERRORS_RANGE = wp.constant(1.0)


@wp.struct
class LightChange:
    """Sums over pixels of one signal."""

    difference: wp.vec3
    """Samples less means"""
    terms: wp.vec4
    """change_terms"""


@wp.func
def add_pixel(sums: LightChange, sample: wp.vec3, mean: wp.vec3, deviation: float, weight: float) -> LightChange:
    """Return the sums after one pixel."""
    out = sums
    out.difference = sums.difference + (sample - mean) * weight
    out.terms = sums.terms + change_terms(brightness(sample), brightness(mean), deviation * deviation) * weight
    return out


@wp.func
def change_of(sums: LightChange, total: float) -> wp.vec4:
    """Return by how much the light has changed, and which share of that is surely no noise (0..1)."""
    if total < 0.5:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    scale = 1.0 / total
    errors = standard_errors(sums.terms, scale, total, MARGIN)
    return rgba(sums.difference * scale, wp.clamp((errors - LEAST_ERRORS) / ERRORS_RANGE, 0.0, 1.0))


@wp.kernel(cuda_max_registers=64)
def find_direct_changes(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    reprojection: Reprojection,
    width: int,
    height: int,
    diffuse: wp.array[wp.uint64],
    specular: wp.array[wp.uint64],
    history: DirectHistory,
    # Out:
    diffuse_out: wp.array[wp.uint64],
    specular_out: wp.array[wp.uint64],
):
    """Find by how much direct light has changed; writes nothing unless something has moved. Banded over pixels.

    In detail:
        first: Of the band.
        diffuse: pack_halves of this frame's samples; w = 0: none.
        specular: Like `diffuse`, whose w counts for both.
        history: Of the frame before.
        diffuse_out: pack_halves of what to add to the mean of before; w: the share of it that counts.
        specular_out: Like `diffuse_out`.
    """
    pixel = first + wp.tid()
    view = load_view(views)
    if view.moved_age >= MOVED_FRAMES or view.restart == 1:
        return
    changed_d = wp.vec4(0.0, 0.0, 0.0, 0.0)
    changed_s = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if gbuffer.depth[pixel] < SKY_DEPTH and known_taps(reprojection, pixel) != wp.uint8(0):
        plane = pixel_plane(view, gbuffer, width, pixel)
        x = pixel % width
        y = pixel // width
        # The pixel of the frame before that is nearest.
        to_x = int(wp.floor(reprojection.position[pixel][0])) - x
        to_y = int(wp.floor(reprojection.position[pixel][1])) - y
        sums_d = LightChange()
        sums_s = LightChange()
        total_d = float(0.0)
        total_s = float(0.0)
        index = int(0)
        while index < 9:
            dx = index % 3 - 1
            dy = index // 3 - 1
            index += 1
            if inside(x + dx, y + dy, width, height) and inside(x + dx + to_x, y + dy + to_y, width, height):
                q = (y + dy) * width + x + dx
                before = q + to_y * width + to_x
                d = unpack_halves(diffuse[q])
                s = unpack_halves(specular[q])
                w = surface_weight(plane, dx, dy, gbuffer.depth[q])
                if w > 0.0 and float(history.length[before]) != 0.0 and has_sample(d, s):
                    moments = unpack_halves(history.moments[before])
                    # Samples count by albedo, as in the means.
                    now = albedos(gbuffer, q)
                    mean = unpack_unorm16(history.albedo[before])
                    w_d = w * relative_albedo(now[0], mean[0])
                    w_s = w * relative_albedo(now[1], mean[1])
                    sums_d = add_pixel(sums_d, rgb(d), unpack_mean(history.diffuse[before]), moments[0], w_d)
                    sums_s = add_pixel(sums_s, rgb(s), unpack_mean(history.specular[before]), moments[1], w_s)
                    total_d += w_d
                    total_s += w_s
        changed_d = change_of(sums_d, total_d)
        changed_s = change_of(sums_s, total_s)
    diffuse_out[pixel] = pack_halves(changed_d)
    specular_out[pixel] = pack_halves(changed_s)
