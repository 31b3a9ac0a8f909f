# SPDX-License-Identifier: GPL-3.0-or-later
"""How the light that pixels gather at rest replaces the probes' irradiance: filtered, and by how sure it is.

The filter takes a few other pixels in every frame, others each time: anti-aliasing averages their choices. It shrinks
as samples come together. The share of the samples goes by their number, and by how near other surfaces are: close to
them probes are wrong, far from them better than many samples. The light itself has no say: weights that knew it would
trust dark samples more.
"""

from __future__ import annotations

import warp as wp

from .composite import light_or_none, seen_share
from .filter_weights import inside, pixel_plane, smooth_normal_weight, squared_cosine, surface_weight
from .gather_temporal import GatherHistory
from .gbuffer import GBuffer
from .geometry_math import TWO_PI
from .long_mean import pack_mean, unpack_mean
from .packed_halves import unpack_halves
from .packing import unpack_normal
from .sampling import hash32, hash_combine, to_unit
from .view import SKY_DEPTH, View

# Fast: weights need no division that is exact to the last bit.
wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# Other pixels in a frame.
TAPS = wp.constant(12)
# Standard deviation of their distance [px] at one sample a pixel; it falls with the root of their number, between:
SIGMA_START = wp.constant(14.0)
SIGMA_LEAST = wp.constant(1.0)
SIGMA_MOST = wp.constant(5.0)
# The same as a share of the mean distance to what the pixel's rays meet, at most; and a tap's distance as a share of
# that of its own rays.
REACH_SHARE = wp.constant(0.1)
TAP_SHARE = wp.constant(0.25)
# Turn from a tap to the next: the golden angle.
TURN = wp.constant(2.3999632)
# As many samples is the probes' light worth for each pixel's width of distance to what is around; between:
PROBE_SAMPLES = wp.constant(1.0)
PROBE_LEAST = wp.constant(5.0)
PROBE_MOST = wp.constant(200.0)


@wp.kernel
def blend_gathered(
    first: int,
    # In:
    views: wp.array[View],
    gbuffer: GBuffer,
    width: int,
    height: int,
    stride: int,
    irradiance: wp.array[wp.vec4h],
    history: GatherHistory,
    # Out:
    indirect_out: wp.array[wp.uint64],
):
    """Write diffuse indirect light: irradiance / pi, exposed, with what leaning normals take from it.

    In detail:
        first: Of the band, over pixels.
        stride: Pixels of a block's side: each has a sample in so many frames, squared.
        irradiance: Of the probes.
    """
    pixel = first + wp.tid()
    result = wp.vec3(0.0, 0.0, 0.0)
    if gbuffer.depth[pixel] < SKY_DEPTH:
        view = views[0]
        plane = pixel_plane(view, gbuffer, width, pixel)
        normal = unpack_normal(gbuffer.normal[pixel])
        state = unpack_halves(history.state[pixel])
        total = state[0]
        closeness = state[2] * total
        light = unpack_mean(history.light[pixel]) * total
        samples = wp.max(float(view.rest) / float(stride * stride), 1.0)
        sigma = wp.clamp(SIGMA_START / wp.sqrt(samples), SIGMA_LEAST, SIGMA_MOST)
        if total > 0.0:
            # Beside a wall the rays are short: what lies beyond it must not be asked.
            sigma = wp.min(sigma, REACH_SHARE / wp.max(state[2], 1.0e-6))
        bits = hash_combine(hash32(wp.uint32(pixel)), wp.uint32(view.frame))
        turn = TWO_PI * to_unit(bits)
        shift = to_unit(hash32(bits))
        pixels = float(1.0)
        k = int(0)
        while k < TAPS:
            u = (float(k) + shift) / float(TAPS)
            distance = sigma * wp.sqrt(-2.0 * wp.log(wp.max(1.0 - u, 1.0e-6)))
            angle = turn + TURN * float(k)
            dx = int(wp.round(distance * wp.cos(angle)))
            dy = int(wp.round(distance * wp.sin(angle)))
            if (dx != 0 or dy != 0) and inside(pixel % width + dx, pixel // width + dy, width, height):
                q = pixel + dy * width + dx
                w = surface_weight(plane, dx, dy, gbuffer.depth[q])
                w *= smooth_normal_weight(squared_cosine(normal, gbuffer.normal[q]))
                if w > 0.0:
                    other = unpack_halves(history.state[q])
                    if other[2] * distance > TAP_SHARE:
                        other[0] = 0.0
                    pixels += wp.where(other[0] > 0.0, w, 0.0)
                    w *= other[0]
                    light += unpack_mean(history.light[q]) * w
                    closeness += other[2] * w
                    total += w
            k += 1
        result = light_or_none(irradiance[pixel]) * seen_share(gbuffer, pixel)
        if total > 0.0:
            apart = total / wp.max(closeness, 1.0e-9)
            known = wp.clamp(PROBE_SAMPLES * apart, PROBE_LEAST, PROBE_MOST)
            # What anti-aliasing will have averaged, not what is known here now: that is little at edges. Less, too,
            # where few pixels around show the same surface.
            found = samples * pixels
            result = wp.lerp(result, light / total, found / (found + known))
    indirect_out[pixel] = pack_mean(result)
