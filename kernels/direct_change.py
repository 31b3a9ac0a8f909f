# SPDX-License-Identifier: GPL-3.0-or-later
"""Where direct light changes at once because something has moved: shadows that come and go.

A mean over frames follows them by a share a frame, and a short mean beside it (direct_atrous.py) needs two or three
frames to tell a change from noise: shadows of things that move fast would be left behind. Here the samples of a frame
are compared, over nine pixels, with the means that the same pixels had, so that what has changed is known in the frame
in which it does; the means are moved by the difference. As the temporal gradients of Schied, Peters and Dachsbacher
("Gradient Estimation for Real-Time Adaptive Temporal Filtering", HPG 2018, section 3), but without samples of their
own: where little noise is, shadows can be seen without them, and elsewhere they matter less.

In two kernels: each pixel is compared with its own mean once, and pixels then sum up what their neighbours have found.
"""

from __future__ import annotations

import warp as wp

from .direct_temporal import DirectHistory, albedos, has_sample, relative_albedo, standard_errors, terms_of_change
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
    """terms_of_change"""
    total: float
    """Of the weights"""


@wp.func
def add_pixel(sums: LightChange, compared: wp.vec4, deviation: float, level: float, weight: float) -> LightChange:
    """Return the sums after one pixel.

    Args:
        sums: So far.
        compared: Sample less mean; w: weight of the pixel's albedo.
        deviation: Standard deviation of a sample.
        level: The larger one of both luminances.
        weight: Of the pixel's surface.
    """
    out = sums
    share = weight * compared[3]
    terms = terms_of_change(brightness(rgb(compared)), level, deviation * deviation)
    out.difference = sums.difference + rgb(compared) * share
    out.terms = sums.terms + terms * share
    out.total = sums.total + share
    return out


@wp.func
def change_of(sums: LightChange) -> wp.vec4:
    """Return by how much the light has changed, and which share of that is surely no noise (0..1)."""
    if sums.total < 0.5:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    scale = 1.0 / sums.total
    errors = standard_errors(sums.terms, scale, sums.total, MARGIN)
    return rgba(sums.difference * scale, wp.clamp((errors - LEAST_ERRORS) / ERRORS_RANGE, 0.0, 1.0))


@wp.func
def looks_for_changes(view: View) -> bool:
    """Return whether light may have changed at once: something but the camera has moved a moment ago."""
    return view.moved_age < MOVED_FRAMES and view.restart == 0


@wp.kernel(cuda_max_registers=64)
def compare_direct(
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
    luminances_out: wp.array[wp.uint64],
):
    """Compare each pixel's sample with its mean where something has moved; else write nothing. Banded over pixels.

    In detail:
        first: Of the band.
        diffuse: pack_halves of this frame's samples; w = 0: none.
        specular: Like `diffuse`, whose w counts for both.
        history: Of the frame before.
        diffuse_out: pack_halves of the sample less the mean; w: weight by its albedo, 0: none.
        specular_out: Like `diffuse_out`.
        luminances_out: pack_halves of a sample's deviation and the larger one of both luminances, diffuse, then those
            of specular light.
    """
    pixel = first + wp.tid()
    view = load_view(views)
    if not looks_for_changes(view):
        return
    compared_d = wp.vec4(0.0, 0.0, 0.0, 0.0)
    compared_s = wp.vec4(0.0, 0.0, 0.0, 0.0)
    luminances = wp.vec4(0.0, 0.0, 0.0, 0.0)
    # Read before it is known whether they count: they wait for memory together.
    position = reprojection.position[pixel]
    taps = known_taps(reprojection, pixel)
    d = unpack_halves(diffuse[pixel])
    s = unpack_halves(specular[pixel])
    # The pixel of the frame before that is nearest.
    x = int(wp.floor(position[0]))
    y = int(wp.floor(position[1]))
    if taps != wp.uint8(0) and gbuffer.depth[pixel] < SKY_DEPTH and inside(x, y, width, height) and has_sample(d, s):
        before = y * width + x
        if float(history.length[before]) != 0.0:
            moments = unpack_halves(history.moments[before])
            mean_d = unpack_mean(history.diffuse[before])
            mean_s = unpack_mean(history.specular[before])
            # Samples count by albedo, as in the means.
            now = albedos(gbuffer, pixel)
            mean = unpack_unorm16(history.albedo[before])
            compared_d = rgba(rgb(d) - mean_d, relative_albedo(now[0], mean[0]))
            compared_s = rgba(rgb(s) - mean_s, relative_albedo(now[1], mean[1]))
            luminances = wp.vec4(
                moments[0], wp.max(brightness(rgb(d)), brightness(mean_d)),
                moments[1], wp.max(brightness(rgb(s)), brightness(mean_s)))
    diffuse_out[pixel] = pack_halves(compared_d)
    specular_out[pixel] = pack_halves(compared_s)
    luminances_out[pixel] = pack_halves(luminances)


@wp.kernel(cuda_max_registers=64)
def find_direct_changes(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    width: int,
    height: int,
    diffuse: wp.array[wp.uint64],
    specular: wp.array[wp.uint64],
    luminances: wp.array[wp.uint64],
    # Out:
    diffuse_out: wp.array[wp.uint64],
    specular_out: wp.array[wp.uint64],
):
    """Find by how much direct light has changed; writes nothing unless something has moved. Banded over pixels.

    In detail:
        first: Of the band.
        diffuse: As compare_direct writes it.
        specular: Like `diffuse`.
        luminances: Of both.
        diffuse_out: pack_halves of what to add to the mean of before; w: the share of it that counts.
        specular_out: Like `diffuse_out`.
    """
    pixel = first + wp.tid()
    view = load_view(views)
    if not looks_for_changes(view):
        return
    sums_d = LightChange()
    sums_s = LightChange()
    if gbuffer.depth[pixel] < SKY_DEPTH:
        plane = pixel_plane(view, gbuffer, width, pixel)
        x = pixel % width
        y = pixel // width
        index = int(0)
        while index < 9:
            dx = index % 3 - 1
            dy = index // 3 - 1
            index += 1
            q = wp.clamp(y + dy, 0, height - 1) * width + wp.clamp(x + dx, 0, width - 1)
            w = surface_weight(plane, dx, dy, gbuffer.depth[q])
            if not inside(x + dx, y + dy, width, height):
                w = 0.0
            around = unpack_halves(luminances[q])
            sums_d = add_pixel(sums_d, unpack_halves(diffuse[q]), around[0], around[1], w)
            sums_s = add_pixel(sums_s, unpack_halves(specular[q]), around[2], around[3], w)
    diffuse_out[pixel] = pack_halves(change_of(sums_d))
    specular_out[pixel] = pack_halves(change_of(sums_s))
