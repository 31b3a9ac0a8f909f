# SPDX-License-Identifier: GPL-3.0-or-later
"""The means of final gather at rest: each pixel's own samples alone, unfiltered, so that nothing blurs contacts."""

from __future__ import annotations

import warp as wp

from .gbuffer import GBuffer, Surface, load_previous_surface, load_surface, plane_distance
from .long_mean import nearest_tap, pack_mean, unpack_mean
from .packed_halves import pack_halves, unpack_halves
from .packing import rgb
from .reflection_types import ReflectionOptions, ReflectionSamples, block_of, sample_pixel
from .reprojection import Reprojection, has_tap, tap_pixel
from .view import SKY_DEPTH, View, pixel_footprint, settled_length

# Fast: means and weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Most samples that are counted, and most that a mean goes back over: anti-aliasing averages the means again, and only
# such as are short weigh all samples alike.
SAMPLES_MAX = wp.constant(1024.0)
MEAN_SAMPLES = wp.constant(16.0)
# A neighbour lends its mean if its normals' cosine is above the first and it lies off the plane by less pixels' widths.
LENDER_COSINE = wp.constant(0.95)
LENDER_PIXELS = wp.constant(1.0)
# Closeness from which a neighbour lends nothing.
LENDER_CLOSENESS = wp.constant(0.2)


@wp.struct
class GatherHistory:
    """What a frame leaves of gathered light for the next: 16 bytes a pixel."""

    light: wp.array[wp.uint64]
    """pack_mean of irradiance / pi, exposed"""
    state: wp.array[wp.uint64]
    """pack_halves: samples in the mean; unused; mean closeness of what they have met: a pixel's width by the distance
    """


@wp.func
def is_lender(view: View, gbuffer: GBuffer, width: int, surface: Surface, pixel: int) -> bool:
    """Return whether a pixel of the frame before shows the surface, so closely that its mean may stand in."""
    if not gbuffer.depth[pixel] < SKY_DEPTH:
        return False
    other = load_previous_surface(view, gbuffer, width, pixel)
    return (wp.dot(other.geometric_normal, surface.geometric_normal) > LENDER_COSINE
            and wp.dot(other.normal, surface.normal) > LENDER_COSINE
            and plane_distance(surface, other.position) < LENDER_PIXELS * pixel_footprint(view.camera, surface.depth))


@wp.func
def find_lender(
    view: View, gbuffer: GBuffer, previous: GBuffer, width: int, height: int, history: GatherHistory, pixel: int,
) -> int:
    """Return the neighbour with the longest mean of the pixel's surface, -1 for none.

    Camera rays move within their pixels, so at edges a pixel shows now this surface and now that.
    """
    surface = load_surface(view, gbuffer, width, pixel)
    x = pixel % width
    y = pixel // width
    found = int(-1)
    longest = float(0.0)
    for k in range(9):
        i = x + k % 3 - 1
        j = y + k // 3 - 1
        if k != 4 and i >= 0 and j >= 0 and i < width and j < height:
            q = j * width + i
            state = unpack_halves(history.state[q])
            length = state[0]
            # Beside a wall the neighbour may lie beyond it.
            if length > longest and state[2] < LENDER_CLOSENESS:
                if is_lender(view, previous, width, surface, q):
                    found = q
                    longest = length
    return found


@wp.kernel
def accumulate_gathered(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    previous_gbuffer: GBuffer,
    reprojection: Reprojection,
    options: ReflectionOptions,
    samples: ReflectionSamples,
    history: GatherHistory,
    # Out:
    history_out: GatherHistory,
):
    """Average each pixel's samples over the frames at rest; the first of them starts anew. Banded over pixels.

    In detail:
        first: Of the band.
        history: Of the frame before, if that was at rest.

    53 bytes a pixel: 37 read (depth 4, reprojection 9, its share of the samples 8, history 16), 16 written.
    """
    pixel = first + wp.tid()
    view = views[0]
    light = wp.vec3(0.0, 0.0, 0.0)
    state = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if gbuffer.depth[pixel] < SKY_DEPTH:
        if view.rest > 1:
            position = reprojection.position[pixel]
            source = int(-1)
            nearest = nearest_tap(position)
            if has_tap(reprojection.taps[pixel], nearest):
                source = tap_pixel(position, nearest, options.width)
            if source < 0:
                source = find_lender(
                    view, gbuffer, previous_gbuffer, options.width, options.height, history, pixel)
            if source >= 0:
                light = unpack_mean(history.light[source])
                state = unpack_halves(history.state[source])
        block = block_of(options, pixel)
        if sample_pixel(options, samples, block) == pixel and samples.pdf[block] > 0.0:
            # Finite and not negative, see resolve_reflections.
            new = unpack_halves(samples.radiance[block])
            turns = float(options.stride * options.stride)
            cap = wp.clamp(1.0 + settled_length(view) / turns, 1.0, SAMPLES_MAX)
            length = wp.min(state[0] + 1.0, cap)
            blend = 1.0 / wp.min(length, MEAN_SAMPLES)
            light = wp.lerp(light, rgb(new), blend)
            if new[3] > 0.0:
                footprint = pixel_footprint(view.camera, gbuffer.depth[pixel])
                state[2] = wp.lerp(state[2], wp.min(footprint / new[3], 1.0), blend)
            state[0] = length
    history_out.light[pixel] = pack_mean(light)
    history_out.state[pixel] = pack_halves(state)
