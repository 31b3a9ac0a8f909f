# SPDX-License-Identifier: GPL-3.0-or-later
"""Spatial half of the diffuse indirect light's denoiser: a separable blur where the mean is short (method 7.6).

The radius falls by one pixel a frame, so that after a few frames nothing is blurred any more: most pixels are left as
accumulate_diffuse has written them.
"""

from __future__ import annotations

import warp as wp

from .diffuse_temporal import DiffuseHistory
from .filter_weights import pixel_plane, smooth_normal_weight, squared_cosine, surface_weight, unit_normal
from .gbuffer import GBuffer
from .long_mean import pack_mean, unpack_mean
from .packed_halves import pack_halves, unpack_first, unpack_halves
from .packing import rgb, rgba
from .view import SKY_DEPTH, View
from .wide_loads import load_view, load_word

# Fast: means and weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Frames from which on a mean is no longer replaced by what is shown of it: detail comes back the sooner.
FEEDBACK_FRAMES = wp.constant(4.0)
# How far the radius of a blurred neighbour is felt [px].
DILATION = wp.constant(2)

# What w says of the irradiance of a blurred pixel, or its negative where there was nothing to take light from. Then the
# mean along its row is in an array of its own, from the first pass on: while the second one writes its results in
# place, it reads no pixel's own irradiance but of those that are not blurred.
BLURRED = wp.constant(2.0)


@wp.func
def radius_of(length: float, radius: int) -> int:
    """Return the blur of a pixel with so many frames in its mean [px]."""
    return wp.max(radius - int(wp.max(length, 0.0) + 0.5), 0)


@wp.func
def blur_radius(
    state: wp.array[wp.uint64], width: int, height: int, pixel: int, radius: int,
) -> int:
    """Return the radius [px] at a pixel: its own, or half of a close neighbour's, so that blurs end softly."""
    own = radius_of(unpack_first(state[pixel]), radius)
    x = pixel % width
    y = pixel // width
    around = int(0)
    # Lengths of -1 (the world, no light known) ask for no blur around them.
    for k in range(4):
        i = wp.clamp(x + wp.where(k < 2, 2 * k - 1, 0) * DILATION, 0, width - 1)
        j = wp.clamp(y + wp.where(k < 2, 0, 2 * k - 5) * DILATION, 0, height - 1)
        length = unpack_first(state[j * width + i])
        if length >= 0.0:
            around = wp.max(around, radius_of(length, radius))
    return wp.max(own, around // 2)


@wp.func
def tap_factor(
    gbuffer: GBuffer, q: int, offset: int, radius: int, normal: wp.vec3,
) -> float:
    """Return the weight of a tap by its normal and by how far it is."""
    t = float(offset) / float(radius + 1)
    return smooth_normal_weight(squared_cosine(normal, gbuffer.normal[q])) * (1.0 - t * t)


@wp.kernel
def blur_diffuse_x(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    width: int,
    height: int,
    radius: int,
    history: DiffuseHistory,
    # Out:
    rows_out: wp.array[wp.uint64],
    irradiance_out: wp.array[wp.uint64],
):
    """Blur the mean along rows where it is short (method 7.6); banded over pixels.

    12 bytes a pixel (depth 4, state 8); where there is something to blur 16 written and 24 read of each pixel within
    the radius (cached).

    In detail:
        first: Of the band.
        radius: Largest [px].
        history: This frame's means.
        rows_out: Of blurred pixels: pack_halves of irradiance / pi; w = radius [px], -1 where nothing is known.
        irradiance_out: Of blurred pixels: w = BLURRED.
    """
    pixel = first + wp.tid()
    if gbuffer.depth[pixel] >= SKY_DEPTH:
        return
    reach = blur_radius(history.state, width, height, pixel, radius)
    if reach == 0:
        return
    out = wp.vec4(0.0, 0.0, 0.0, -1.0)
    if unpack_first(history.state[pixel]) >= 0.0:
        out = rgba(unpack_mean(history.irradiance[pixel]), float(reach))
    plane = pixel_plane(load_view(views), gbuffer, width, pixel)
    normal = unit_normal(gbuffer.normal[pixel])
    x = pixel % width
    sum = wp.vec3(0.0, 0.0, 0.0)
    total = float(0.0)
    offset = wp.max(-reach, -x)
    end = wp.min(reach, width - 1 - x)
    while offset <= end:
        # Without branches, so that all that is read of a tap is waited for together.
        q = pixel + offset
        w = surface_weight(plane, offset, 0, gbuffer.depth[q])
        w *= tap_factor(gbuffer, q, offset, reach, normal)
        w = wp.where(unpack_first(load_word(history.state, q)) >= 0.0, w, 0.0)
        sum += unpack_mean(load_word(history.irradiance, q)) * w
        total += w
        offset += 1
    if total > 1.0e-6:
        out = rgba(sum / total, float(reach))
    rows_out[pixel] = pack_halves(out)
    irradiance_out[pixel] = pack_halves(wp.vec4(0.0, 0.0, 0.0, BLURRED))


@wp.func
def row_mean(rows: wp.array[wp.uint64], irradiance: wp.array[wp.uint64], pixel: int) -> wp.vec4:
    """Return a pixel's light after the blur along rows; w is above 0 where it is known."""
    row = unpack_halves(load_word(rows, pixel))
    mean = unpack_halves(load_word(irradiance, pixel))
    return wp.where(wp.abs(mean[3]) == BLURRED, row, mean)


@wp.kernel(cuda_max_registers=64)
def blur_diffuse_y(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    width: int,
    height: int,
    radius: int,
    rows: wp.array[wp.uint64],
    # Out:
    history_out: DiffuseHistory,
    irradiance_out: wp.array[wp.uint64],
):
    """Blur along columns, and keep the result as the mean while that is short (method 7.6); banded over pixels.

    8 bytes a pixel; of blurred ones 24 more, 16 written, and 24 read of each pixel within the radius (cached).

    In detail:
        first: Of the band.
        radius: Largest [px].
        rows: As blur_diffuse_x writes it.
        history_out: This frame's means.
        irradiance_out: As blur_diffuse_x leaves it; then of blurred pixels the result. w is above 0 where light is
            known.
    """
    pixel = first + wp.tid()
    if unpack_halves(load_word(irradiance_out, pixel))[3] != BLURRED:
        return
    centre = unpack_halves(rows[pixel])
    reach = wp.where(centre[3] >= 0.0, int(centre[3]), radius)
    out = rgba(rgb(centre), wp.where(centre[3] >= 0.0, BLURRED, -BLURRED))
    plane = pixel_plane(load_view(views), gbuffer, width, pixel)
    normal = unit_normal(gbuffer.normal[pixel])
    y = pixel // width
    sum = wp.vec3(0.0, 0.0, 0.0)
    total = float(0.0)
    offset = wp.max(-reach, -y)
    end = wp.min(reach, height - 1 - y)
    while offset <= end:
        # Without branches, so that all that is read of a tap is waited for together.
        q = pixel + offset * width
        value = row_mean(rows, irradiance_out, q)
        w = surface_weight(plane, 0, offset, gbuffer.depth[q])
        w *= tap_factor(gbuffer, q, offset, reach, normal)
        w = wp.where(value[3] > 0.0, w, 0.0)
        sum += rgb(value) * w
        total += w
        offset += 1
    if total > 1.0e-6:
        out = rgba(sum / total, BLURRED)
        length = unpack_first(history_out.state[pixel])
        if length >= 0.0 and length < FEEDBACK_FRAMES:
            history_out.irradiance[pixel] = pack_mean(rgb(out))
    irradiance_out[pixel] = pack_halves(out)
