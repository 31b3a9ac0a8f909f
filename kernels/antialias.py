# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporal anti-aliasing of the composite: an exact running mean at rest, a rectified history in motion.

All camera rays of a frame are offset by the same jitter. At rest it is drawn from the pixel filter by importance, so
the plain mean of frames is the filtered picture: nothing else may happen to it. In motion, where a few frames count and
the mean of their jitter is not 0, edges would lie beside their place: there frames sample all of the pixel alike, and
the samples around its centre are weighed by the filter (Karis, "High Quality Temporal Supersampling", SIGGRAPH 2014).
The history is resampled where the pixel was in the frame before, limited to what this frame shows around it (variance
clipping: Salvi, "An Excursion in Temporal Supersampling", GDC 2016) and averaged with a constant weight. That
resampling is repeated with every frame, so its kernel must pass details undamped: 0.8 Lanczos-3 + 0.2 Catmull-Rom keeps
0.995 to 1.004 of waves of 4 pixels and longer; Catmull-Rom alone keeps 0.88 of those of 4 pixels, of which half is left
after ten frames.

While the camera alone moves, surfaces of which the frame before has no sample have a history too: of what is thinner
than a pixel, as the jitter meets it in some frames only. It was a row of dashes where each of these began anew.
"""

from __future__ import annotations

import warp as wp

from .gbuffer import unpack_roughness
from .long_mean import only_camera_moved
from .packed_halves import unpack_halves
from .reflection_sources import DISTANCE_ROUGHNESS
from .reflection_temporal import RENEWED_LENGTH
from .view import MOVED_FRAMES, View, picture_limit
from .wide_loads import load_vec4, load_view
from .wide_stores import store_vec4

wp.set_module_options({"enable_backward": False, "default_grid_stride": False, "fast_math": True})

# A colour is no firefly up to so many times the mean luma of the pixels around it.
VEILED = wp.constant(4.0)

# Frames that the history counts as in motion: the weight of a new frame, which is a mean of nine samples, falls to 1/6.
MOTION_SAMPLES = wp.constant(5.0)

# ... and once it comes to rest: what motion left fades, but noise grows by a quarter at most.
FIRST_REST_SAMPLES = wp.constant(4.0)

# Half the size of the box around the neighbourhood's mean, in standard deviations: while things move, and while the
# camera alone does, when what the history shows has only been seen from elsewhere.
CLIP_DEVIATIONS = wp.constant(1.25)
CLIP_STILL = wp.constant(2.5)

# Display white is 1: light above this is weighed down in motion, where single samples would flicker.
FIREFLY_LUMA = wp.constant(2.0)

# Bounds the exponents of weights: of jitter as wide as the widest pixel filter.
WEIGHT_LIMIT = wp.constant(30.0)

LANCZOS_SHARE = wp.constant(0.8)

# Up to this distance [px] Lanczos-3 is its series' first two terms, to 2e-6: the quotient of small sines errs more.
SERIES_REACH = wp.constant(0.03)
LANCZOS_CURVATURE = wp.constant(1.8277045)
SAMPLES_MAX = wp.constant(65535.0)

vec6 = wp.types.vector(length=6, dtype=wp.float32)


@wp.struct
class Accumulation:
    """Averaged frames, one entry a pixel: 18 bytes."""

    color: wp.array[wp.vec4]
    """Mean of exposed colour and alpha at the pixel's centre"""
    samples: wp.array[wp.uint16]
    """Frames that it counts as"""


@wp.struct
class Mirrors:
    """What mirrors tell about the age of what they show."""

    material: wp.array[wp.uint32]
    """GBuffer.material"""
    state: wp.array[wp.uint64]
    """ReflectionHistory.state of this frame; not read without `known`"""
    known: float
    """Frames in the mean of a mirror whose image stays; 0: there are no mirrors"""


@wp.struct
class Neighborhood:
    """What this frame shows around a pixel."""

    mean: wp.vec4
    """Y, Co, Cg, alpha"""
    deviation: wp.vec4
    filtered: wp.vec4
    """Red, green, blue, alpha at the pixel's centre, by sample_weights"""
    nearest: int
    """The pixel of the 3x3 that is closest to the camera"""


@wp.func
def to_ycocg(c: wp.vec4) -> wp.vec4:
    """Turn RGB into luma and two chroma; alpha stays."""
    return wp.vec4(
        0.25 * c[0] + 0.5 * c[1] + 0.25 * c[2], 0.5 * c[0] - 0.5 * c[2], 0.5 * c[1] - 0.25 * c[0] - 0.25 * c[2], c[3])


@wp.func
def from_ycocg(c: wp.vec4) -> wp.vec4:
    """Turn luma and chroma into RGB."""
    t = c[0] - c[2]
    return wp.vec4(t + c[1], c[0] + c[2], t - c[1], c[3])


@wp.func
def luma(c: wp.vec4) -> float:
    """Return the Y of YCoCg."""
    return 0.25 * c[0] + 0.5 * c[1] + 0.25 * c[2]


@wp.func
def near_lanczos(d: float, quotient: float) -> float:
    """Return Lanczos-3 at a distance d <= 1 [px]: the quotient of the sines, or where that errs its series."""
    return wp.where(d > SERIES_REACH, quotient, 1.0 - LANCZOS_CURVATURE * d * d)


@wp.func
def kernel_weights(t: float) -> vec6:
    """Return the weights of six taps at -2..3, for a position t in 0..1 past tap 0; they sum to 1.

    Distances are t + n and n - t, so the sines of Lanczos-3 are those of three angles, and of one but for the sign.
    """
    s = 1.0 - t
    third = 3.14159265 / 3.0
    below = wp.sin(third * t)
    above = wp.sin(third * s)
    between = wp.sin(third * (1.0 + t))
    # 3 / pi^2, and the shorter way to a tap: there the sine has most digits.
    scale = 0.303963551 * wp.sin(3.14159265 * wp.min(t, s))
    p = 1.0 + t
    q = 1.0 + s
    w = vec6()
    w[0] = LANCZOS_SHARE * (scale * above / ((2.0 + t) * (2.0 + t)))
    w[1] = wp.lerp(((-0.5 * p + 2.5) * p - 4.0) * p + 2.0, -scale * between / (p * p), LANCZOS_SHARE)
    w[2] = wp.lerp((1.5 * t - 2.5) * t * t + 1.0, near_lanczos(t, scale * below / (t * t)), LANCZOS_SHARE)
    w[3] = wp.lerp((1.5 * s - 2.5) * s * s + 1.0, near_lanczos(s, scale * above / (s * s)), LANCZOS_SHARE)
    w[4] = wp.lerp(((-0.5 * q + 2.5) * q - 4.0) * q + 2.0, -scale * between / (q * q), LANCZOS_SHARE)
    w[5] = LANCZOS_SHARE * (scale * below / ((2.0 + s) * (2.0 + s)))
    return w * (1.0 / (w[0] + w[1] + w[2] + w[3] + w[4] + w[5]))


@wp.func
def resample_row(image: wp.array[wp.vec4], row: int, x: int, last: int, w: vec6) -> wp.vec4:
    """Return the weighted sum of six pixels of a row, x - 2 .. x + 3; the edge pixel repeats."""
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for i in range(6):
        total += load_vec4(image, row + wp.clamp(x + i - 2, 0, last)) * w[i]
    return total


@wp.func
def without_ringing(value: float, least: float) -> float:
    """Return a resampled value that has not fallen far below the least of the four pixels about it.

    Beside what is many times as bright negative lobes take away more than there is, frame after frame: bars of windows
    and all edges before the sky had black dashes. Where textures differ by less than that they pass undamped.
    """
    share = wp.clamp(2.0 * (1.0 - value / wp.max(least, 1.0e-20)) - 0.5, 0.0, 1.0)
    return value + (wp.max(value, least) - value) * share * share * (3.0 - 2.0 * share)


@wp.func
def resample(image: wp.array[wp.vec4], position: wp.vec2, width: int, height: int) -> wp.vec4:
    """Return the image at a position [px]; the 28 taps that matter of 6x6."""
    px = position[0] - 0.5
    py = position[1] - 0.5
    # A camera at rest while objects move: the pixel itself.
    near_x = wp.round(px)
    near_y = wp.round(py)
    if wp.abs(px - near_x) < 1.0e-3 and wp.abs(py - near_y) < 1.0e-3:
        return load_vec4(
            image, wp.clamp(int(near_y), 0, height - 1) * width + wp.clamp(int(near_x), 0, width - 1))
    x = int(wp.floor(px))
    y = int(wp.floor(py))
    wx = kernel_weights(px - float(x))
    wy = kernel_weights(py - float(y))
    x0 = wp.clamp(x, 0, width - 1)
    x1 = wp.clamp(x + 1, 0, width - 1)
    y0 = wp.clamp(y, 0, height - 1) * width
    y1 = wp.clamp(y + 1, 0, height - 1) * width
    least = wp.min(
        wp.min(load_vec4(image, y0 + x0), load_vec4(image, y0 + x1)),
        wp.min(load_vec4(image, y1 + x0), load_vec4(image, y1 + x1)))
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for j in range(4):
        total += resample_row(image, wp.clamp(y + j - 1, 0, height - 1) * width, x, width - 1, wx) * wy[j + 1]
    below = wp.clamp(y - 2, 0, height - 1) * width
    above = wp.clamp(y + 3, 0, height - 1) * width
    total += (load_vec4(image, below + x0) * wx[2] + load_vec4(image, below + x1) * wx[3]) * wy[0]
    total += (load_vec4(image, above + x0) * wx[2] + load_vec4(image, above + x1) * wx[3]) * wy[5]
    # What the eight taps left out would have weighed.
    total = total / (1.0 - (1.0 - wx[2] - wx[3]) * (wy[0] + wy[5]))
    for i in range(4):
        total[i] = without_ringing(total[i], least[i])
    return total


@wp.func
def sample_weights(jitter: wp.vec2, sharpness: float) -> vec6:
    """Return what this frame's samples weigh for a pixel's centre: of three columns, then of three rows around it.

    By a Gaussian of their distance, exp(-sharpness d^2) by that of the pixel's own sample, which lies `jitter` [px]
    beside the centre; others lie a pixel further each.
    """
    w = vec6()
    for axis in range(2):
        w[3 * axis] = wp.exp(wp.min(-sharpness * (1.0 - 2.0 * jitter[axis]), WEIGHT_LIMIT))
        w[3 * axis + 1] = 1.0
        w[3 * axis + 2] = wp.exp(wp.min(-sharpness * (1.0 + 2.0 * jitter[axis]), WEIGHT_LIMIT))
    return w


@wp.func
def gather_neighborhood(
    color: wp.array[wp.uint64], depth: wp.array[float], weights: vec6, x: int, y: int, width: int, height: int,
) -> Neighborhood:
    """Gather the statistics of the 3x3 pixels around one, and their mean with sample_weights."""
    n = Neighborhood()
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    squares = wp.vec4(0.0, 0.0, 0.0, 0.0)
    filtered = wp.vec4(0.0, 0.0, 0.0, 0.0)
    nearest = y * width + x
    least = depth[nearest]
    for k in range(9):
        dx = k % 3 - 1
        dy = k // 3 - 1
        pixel = wp.clamp(y + dy, 0, height - 1) * width + wp.clamp(x + dx, 0, width - 1)
        v = to_ycocg(unpack_halves(color[pixel]))
        total += v
        squares += wp.cw_mul(v, v)
        filtered += v * (weights[dx + 1] * weights[dy + 4])
        found = depth[pixel]
        if found < least:
            least = found
            nearest = pixel
    n.mean = total / 9.0
    variance = squares / 9.0 - wp.cw_mul(n.mean, n.mean)
    n.deviation = wp.vec4(
        wp.sqrt(wp.max(variance[0], 0.0)), wp.sqrt(wp.max(variance[1], 0.0)), wp.sqrt(wp.max(variance[2], 0.0)),
        wp.sqrt(wp.max(variance[3], 0.0)))
    n.filtered = from_ycocg(filtered / (
        (weights[0] + weights[1] + weights[2]) * (weights[3] + weights[4] + weights[5])))
    n.nearest = nearest
    return n


@wp.func
def firefly_weight(c: wp.vec4, around: float) -> float:
    """Return the weight of a colour in motion: nothing that a display shows is weighed down, only what is brighter.

    And brighter than pixels around it, whose mean luma is `around`: where all are bright now and then, as behind a
    veil, that is no firefly, and to weigh it down would lose half of the light.
    """
    return 1.0 / wp.max(1.0, luma(c) / wp.max(FIREFLY_LUMA, VEILED * around))


@wp.func
def filter_frame(color: wp.array[wp.uint64], weights: vec6, x: int, y: int, width: int, height: int) -> wp.vec4:
    """Return this frame's mean with sample_weights, fireflies weighed down: what is shown without a history."""
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    sum = float(0.0)
    for k in range(9):
        dx = k % 3 - 1
        dy = k // 3 - 1
        c = unpack_halves(color[wp.clamp(y + dy, 0, height - 1) * width + wp.clamp(x + dx, 0, width - 1)])
        w = weights[dx + 1] * weights[dy + 4] * firefly_weight(c, 0.0)
        total += c * w
        sum += w
    return total / sum


@wp.func
def rectify(history: wp.vec4, n: Neighborhood, deviations: float) -> wp.vec4:
    """Move a history colour towards the neighbourhood's mean until it lies in a box of so many deviations around it."""
    d = to_ycocg(history) - n.mean
    # Half-floats are 1 / 2048 apart: less than twice that is no change.
    slack = n.mean[0] / 1024.0 + 1.0e-6
    excess = float(1.0)
    for i in range(3):
        excess = wp.max(excess, wp.abs(d[i]) / (n.deviation[i] * deviations + slack))
    reach = n.deviation[3] * deviations + 1.0e-3
    return from_ycocg(n.mean + wp.vec4(d[0] / excess, d[1] / excess, d[2] / excess, wp.clamp(d[3], -reach, reach)))


@wp.func
def clamp_color(c: wp.vec4) -> wp.vec4:
    """Take away what negative lobes and rounding leave below 0, and alpha above 1."""
    return wp.vec4(wp.max(c[0], 0.0), wp.max(c[1], 0.0), wp.max(c[2], 0.0), wp.clamp(c[3], 0.0, 1.0))


@wp.func
def mirrored_limit(mirrors: Mirrors, position: wp.vec2, taps: wp.uint8, pixel: int) -> float:
    """Return as how many frames the history may count by what a mirror shows: few where that is something new.

    The mean of its reflection has been made anew there (reflection_temporal.renewed), which a camera that moves leaves
    alone. Whatever moves in a mirror would be smeared: the surface's motion is not its image's.
    """
    if mirrors.known <= 0.0 or only_camera_moved(position, taps):
        return MOTION_SAMPLES
    if unpack_roughness(mirrors.material[pixel]) > DISTANCE_ROUGHNESS:
        return MOTION_SAMPLES
    length = wp.abs(unpack_halves(mirrors.state[pixel])[0])
    if length <= 0.0:
        return MOTION_SAMPLES
    known = wp.clamp((length - RENEWED_LENGTH) / wp.max(mirrors.known - RENEWED_LENGTH, 1.0e-3), 0.0, 1.0)
    return MOTION_SAMPLES * known * known


@wp.kernel(cuda_max_registers=56)
def antialias(
    first: int,
    # In:
    views: wp.array[View],
    color: wp.array[wp.uint64],
    depth: wp.array[float],
    position: wp.array[wp.vec2],
    taps: wp.array[wp.uint8],
    mirrors: Mirrors,
    previous: Accumulation,
    width: int,
    height: int,
    enabled: int,
    sharpness: float,
    # Out:
    accumulation_out: Accumulation,
):
    """Average this frame with those before. At rest 26 bytes read a pixel, in motion 38 (once cached); 18 written.

    `color` is pack_halves of colours; `sharpness` is the pixel filter's, 1 / (2 variance) [1/px^2].
    """
    pixel = first + wp.tid()
    view = load_view(views)
    current = unpack_halves(color[pixel])
    mean = current
    samples = float(0.0)
    if enabled == 1 and view.restart == 0:
        if view.rest > 0:
            samples = float(previous.samples[pixel])
            if view.rest == 1:
                samples = wp.min(samples, FIRST_REST_SAMPLES)
            samples = wp.min(samples, picture_limit(view))
            mean = load_vec4(previous.color, pixel)
            mean += (current - mean) / (samples + 1.0)
        else:
            x = pixel % width
            y = pixel // width
            weights = sample_weights(view.jitter, sharpness)
            n = gather_neighborhood(color, depth, weights, x, y, width, height)
            # Edges move with what is in front: their history is where that was.
            p = position[n.nearest] + wp.vec2(float(x - n.nearest % width), float(y - n.nearest // width))
            still = view.moved_age > MOVED_FRAMES
            known = int(taps[n.nearest]) != 0
            if still and not known:
                known = p[0] >= 0.0 and p[1] >= 0.0 and p[0] < float(width) and p[1] < float(height)
            if not known or not wp.isfinite(p[0] + p[1]):
                mean = filter_frame(color, weights, x, y, width, height)
            else:
                old = wp.clamp(int(p[1]), 0, height - 1) * width + wp.clamp(int(p[0]), 0, width - 1)
                samples = wp.min(float(previous.samples[old]), picture_limit(view))
                samples = wp.min(samples, mirrored_limit(mirrors, position[pixel], taps[pixel], pixel))
                history = clamp_color(rectify(
                    clamp_color(resample(previous.color, p, width, height)), n,
                    wp.where(still, CLIP_STILL, CLIP_DEVIATIONS)))
                around = 1.125 * n.mean[0] - 0.125 * luma(current)
                w_new = firefly_weight(n.filtered, around)
                w_old = firefly_weight(history, around) * samples
                mean = (n.filtered * w_new + history * w_old) / (w_new + w_old)
    store_vec4(accumulation_out.color, pixel, clamp_color(mean))
    accumulation_out.samples[pixel] = wp.uint16(wp.min(samples + 1.0, SAMPLES_MAX))
