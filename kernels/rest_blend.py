# SPDX-License-Identifier: GPL-3.0-or-later
"""At rest: the mean P of path-traced samples, denoised by what the filtered picture F knows already.

F hardly varies but is biased, P is right on average but noisy. Their difference r = P - F is split into bands by an
a-trous transform (Dammertz et al. 2010) whose edges stop at F's brightness and the mean normal; r is small and smooth
where F is nearly right, so that it bears wide kernels: F's detail stays, P's light comes in. The variance of every
band is known from the samples. A band's coefficient d is noise where it is no larger than its deviation: with the ratio
z = d^2 / variance, averaged over 5x5 pixels, it is weighed by 1 - 1.5 / z (empirical Wiener shrinkage, as in image
denoising by wavelets; Ghael et al. 1997), or by its own z where it alone sticks out. The coarsest band passes whole: it
carries the light that F has too much or too little; but that of pixels at edges, which found no neighbours alike, has
all of their noise and is weighed as well (rest_lonely.py). As the samples increase every z grows and every weight goes
to 1: the limit is exactly P. A small error of F is always assumed, so that P also takes over where F is right.
"""

from __future__ import annotations

import warp as wp

from .film import Film, film_mean, film_samples, mean_square
from .gbuffer import GBuffer
from .geometry_math import is_finite3
from .packing import rgb, unpack_normal
from .supersampling import block_pixel
from .view import SKY_DEPTH

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Error that F always has, relative: a band of P passes where its noise is less than this.
ASSUMED_ERROR = wp.constant(0.01)

# Exposed radiance (display white is 1) below which errors and brightness are no longer relative.
DARK = wp.constant(0.02)

# Samples from which P may tell of F's error: what is rare has not been met with fewer, and P seems too dark.
TELLING_SAMPLES = wp.constant(4.0)

# Share of its neighbours' mean variance that a pixel has at least: its own few samples may have met nothing rare.
NEIGHBORS_SHARE = wp.constant(0.5)

# A pixel whose variance is so many times that of its neighbours has met a firefly, which they are not to share.
FIREFLY = wp.constant(128.0)

# Ratio z at which coefficients start to pass, as a mean of neighbours and alone; the latter rises by
# ALONE_FEW / samples, since the variance of few samples is uncertain.
TOGETHER = wp.constant(1.5)
ALONE = wp.constant(4.0)
ALONE_FEW = wp.constant(256.0)

# Largest z that counts in a mean of neighbours, so that an edge says nothing about the pixels beside it.
LARGEST_RATIO = wp.constant(6.0)

# Variance of filtered coefficients rises by 1 + UNCERTAIN / samples for the same reason.
UNCERTAIN = wp.constant(8.0)

# How fast weights fall with the logarithm of the ratio of F's brightness.
BRIGHTNESS_SLOPE = wp.constant(6.0)

# Largest factor by which light passes follow the picture.
LARGEST_FACTOR = wp.constant(4.0)

# Exposed radiance above which a sum of samples is no more than overflow.
LARGE = wp.constant(1.0e12)


@wp.struct
class Residual:
    """What is left of P - F on one level, one entry a pixel."""

    color: wp.array[wp.vec4]
    """r of the three channels; w = variance of their mean, negative where the pixel has no samples"""
    guide: wp.array[wp.vec4]
    """Mean normal, logarithm of F's brightness"""
    width: int
    height: int


@wp.kernel
def add_normals(
    first: int,
    # In:
    gbuffer: GBuffer,
    width: int,
    factor: int,
    frames: int,
    # Out:
    normals_out: wp.array[wp.vec3],
):
    """Average the shading normals of jittered frames: short across edges, 0 where nothing is hit.

    A pixel has factor x factor of the frame's (supersampling.py); `width` is the picture's [px].
    """
    pixel = first + wp.tid()
    mean = wp.vec3(0.0, 0.0, 0.0)
    if frames > 0:
        mean = normals_out[pixel]
    normal = wp.vec3(0.0, 0.0, 0.0)
    for k in range(factor * factor):
        sample = block_pixel(pixel, width, factor, k)
        if gbuffer.depth[sample] < SKY_DEPTH:
            normal += unpack_normal(gbuffer.normal[sample]) / float(factor * factor)
    normals_out[pixel] = mean + (normal - mean) / float(frames + 1)


@wp.func
def own_variance(film: Film, pixel: int) -> float:
    """Return the variance of the mean of a pixel's samples (two at least)."""
    n = film_samples(film, pixel)
    return wp.max(film.squares[pixel] / n - mean_square(film_mean(film, pixel)), 0.0) / (n - 1.0)


@wp.func
def tells(film: Film, picture: wp.array[wp.vec4], pixel: int) -> bool:
    """Tell whether a pixel's samples are enough, and numbers."""
    p = film_mean(film, pixel)
    f = picture[pixel]
    largest = wp.max(wp.max(wp.abs(p[0]), wp.abs(p[1])), wp.abs(p[2]))
    return (film_samples(film, pixel) >= TELLING_SAMPLES and is_finite3(rgb(p)) and is_finite3(rgb(f))
            and largest < LARGE and film.squares[pixel] < LARGE * LARGE)


@wp.kernel
def measure_variance(
    first: int,
    # In:
    film: Film,
    picture: wp.array[wp.vec4],
    # Out:
    variance_out: wp.array[float],
):
    """Write the variance of P from each pixel's own samples, -1 where they tell nothing."""
    pixel = first + wp.tid()
    variance = float(-1.0)
    if tells(film, picture, pixel):
        variance = own_variance(film, pixel)
    variance_out[pixel] = variance


@wp.kernel
def start_residual(
    first: int,
    # In:
    film: Film,
    picture: wp.array[wp.vec4],
    variance: wp.array[float],
    normals: wp.array[wp.vec3],
    width: int,
    height: int,
    # Out:
    color_out: wp.array[wp.vec4],
    trust_out: wp.array[float],
    guide_out: wp.array[wp.vec4],
    kept_out: wp.array[wp.vec4],
):
    """Write r with the variance of P, the guide, and the starting point of the picture: P."""
    pixel = first + wp.tid()
    x = pixel % width
    y = pixel // width
    f = picture[pixel]
    n = normals[pixel]
    brightness = 0.2126 * f[0] + 0.7152 * f[1] + 0.0722 * f[2]
    guide_out[pixel] = wp.vec4(n[0], n[1], n[2], wp.log(wp.max(brightness, 0.0) + DARK))
    kept = f
    color = wp.vec4(0.0, 0.0, 0.0, -1.0)
    trust = float(1.0)
    own = variance[pixel]
    if own >= 0.0:
        near = float(0.0)
        wide = float(0.0)
        near_count = float(0.0)
        wide_count = float(0.0)
        for dy in range(-2, 3):
            for dx in range(-2, 3):
                v = variance[wp.clamp(y + dy, 0, height - 1) * width + wp.clamp(x + dx, 0, width - 1)]
                if v >= 0.0:
                    if dx != 0 or dy != 0:
                        wide += v
                        wide_count += 1.0
                    if wp.abs(dx) <= 1 and wp.abs(dy) <= 1:
                        near += v
                        near_count += 1.0
        if own * wide_count > FIREFLY * wide and wide_count > 0.0:
            trust = FIREFLY * wide / (own * wide_count)
        kept = film_mean(film, pixel)
        color = wp.vec4(
            kept[0] - f[0], kept[1] - f[1], kept[2] - f[2], wp.max(own, NEIGHBORS_SHARE * near / near_count))
    color_out[pixel] = color
    trust_out[pixel] = trust
    kept_out[pixel] = kept


@wp.func
def closeness(a: wp.vec4, b: wp.vec4) -> float:
    """Return how far two pixels' guides tell of the same surface in the same light, 0..1."""
    na = wp.vec3(a[0], a[1], a[2])
    nb = wp.vec3(b[0], b[1], b[2])
    # A mean normal's missing length is the share of the pixel that shows no surface, or another one.
    missing = wp.max(1.0 - wp.length(na), 0.0) * wp.max(1.0 - wp.length(nb), 0.0)
    same = wp.clamp(wp.dot(na, nb) + missing, 0.0, 1.0)
    return same * same * wp.exp(-BRIGHTNESS_SLOPE * wp.abs(a[3] - b[3]))


@wp.func
def widening(film: Film, pixel: int) -> float:
    """Return the factor on variances that a pixel's number of samples asks for."""
    return 1.0 + UNCERTAIN / film_samples(film, pixel)


@wp.func
def noise_ratio(d: wp.vec3, variance: float) -> wp.vec2:
    """Return z of a coefficient, and its variance."""
    square = wp.dot(d, d) / 3.0
    return wp.vec2(square / wp.max(variance, 1.0e-6 * square + 1.0e-30), variance)


@wp.kernel
def split_band(
    first: int,
    # In:
    residual: Residual,
    film: Film,
    trust: wp.array[float],
    step: int,
    # Out:
    coarser_out: wp.array[wp.vec4],
    ratio_out: wp.array[wp.vec2],
):
    """Filter r with a 3x3 binomial kernel of spread pixels, and write z and the variance of what is left out.

    `trust` counts in the first band alone: there fireflies are kept to themselves.
    """
    pixel = first + wp.tid()
    x = pixel % residual.width
    y = pixel // residual.width
    own = residual.color[pixel]
    coarser = own
    ratio = wp.vec2(0.0, -1.0)
    if own[3] >= 0.0:
        guide = residual.guide[pixel]
        mine = float(0.25)
        if step == 1:
            mine *= trust[pixel]
        total = mine * rgb(own)
        weights = float(mine)
        variance = mine * mine * own[3]
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                qx = x + dx * step
                qy = y + dy * step
                inside = qx >= 0 and qy >= 0 and qx < residual.width and qy < residual.height
                if inside and (dx != 0 or dy != 0):
                    q = qy * residual.width + qx
                    c = residual.color[q]
                    if c[3] >= 0.0:
                        w = closeness(guide, residual.guide[q]) * 0.25 / float((1 + dx * dx) * (1 + dy * dy))
                        if step == 1:
                            w *= trust[q]
                        total += w * rgb(c)
                        weights += w
                        variance += w * w * c[3]
        mean = total / weights
        variance = widening(film, pixel) * variance / (weights * weights)
        coarser = wp.vec4(mean[0], mean[1], mean[2], variance)
        ratio = noise_ratio(rgb(own) - mean, wp.max(own[3] * (1.0 - 2.0 * mine / weights) + variance, 0.0))
    coarser_out[pixel] = coarser
    ratio_out[pixel] = ratio


@wp.func
def assumed_share(variance: float, brightness: float) -> float:
    """Return the share of a coefficient that passes where F seems right; `brightness`: F's mean square."""
    relative = variance / (brightness + DARK * DARK)
    return ASSUMED_ERROR * ASSUMED_ERROR / (ASSUMED_ERROR * ASSUMED_ERROR + relative)


@wp.func
def passing_share(together: float, alone: float, variance: float, brightness: float, samples: float) -> float:
    """Return the share of a coefficient that is signal, 0..1; exactly 1 without variance."""
    share = float(1.0)
    if variance > 0.0:
        share = wp.max(1.0 - TOGETHER / wp.max(together, TOGETHER),
                       1.0 - wp.min((ALONE + ALONE_FEW / samples) / wp.max(alone, 1.0e-3), 1.0))
        share = wp.max(share, assumed_share(variance, brightness))
    return share


@wp.func
def mean_ratio(residual: Residual, ratio: wp.array[wp.vec2], pixel: int) -> float:
    """Return the mean z of the 5x5 pixels around one that has one itself."""
    x = pixel % residual.width
    y = pixel // residual.width
    total = float(0.0)
    count = float(0.0)
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            qx = wp.clamp(x + dx, 0, residual.width - 1)
            qy = wp.clamp(y + dy, 0, residual.height - 1)
            z = ratio[qy * residual.width + qx]
            if z[1] >= 0.0:
                total += wp.min(z[0], LARGEST_RATIO)
                count += 1.0
    return total / count


@wp.kernel
def take_noise(
    first: int,
    # In:
    residual: Residual,
    coarser: wp.array[wp.vec4],
    ratio: wp.array[wp.vec2],
    film: Film,
    picture: wp.array[wp.vec4],
    # Out:
    kept_out: wp.array[wp.vec4],
    share_out: wp.array[float],
):
    """Take the part of a band that is noise off the picture."""
    pixel = first + wp.tid()
    own = residual.color[pixel]
    share = float(0.0)
    if own[3] >= 0.0:
        z = ratio[pixel]
        share = passing_share(
            mean_ratio(residual, ratio, pixel), z[0], z[1], mean_square(picture[pixel]), film_samples(film, pixel))
        d = (rgb(own) - rgb(coarser[pixel])) * (1.0 - share)
        kept_out[pixel] = kept_out[pixel] - wp.vec4(d[0], d[1], d[2], 0.0)
    share_out[pixel] = share


@wp.kernel
def finish(
    first: int,
    # In:
    film: Film,
    picture: wp.array[wp.vec4],
    kept: wp.array[wp.vec4],
    share: wp.array[float],
    transparent: int,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Write the picture: never negative where neither F nor P is, its alpha between theirs."""
    pixel = first + wp.tid()
    f = picture[pixel]
    c = kept[pixel]
    p = film_mean(film, pixel)
    # Bands may overshoot beside an edge.
    least = wp.min(wp.vec3(0.0, 0.0, 0.0), wp.min(rgb(f), rgb(p)))
    alpha = float(1.0)
    if transparent == 1:
        alpha = wp.clamp(wp.lerp(f[3], c[3], share[pixel]), 0.0, 1.0)
    picture_out[pixel] = wp.vec4(
        wp.max(c[0], least[0]), wp.max(c[1], least[1]), wp.max(c[2], least[2]), alpha)


@wp.kernel
def scale_light(
    first: int,
    # In:
    picture: wp.array[wp.vec4],
    blend: wp.array[wp.vec4],
    light: wp.array[wp.vec3],
    # Out:
    light_out: wp.array[wp.vec3],
):
    """Scale a lobe's light of `picture` by what that has become, so that the passes still make it up."""
    pixel = first + wp.tid()
    c = light[pixel]
    for k in range(3):
        f = picture[pixel][k]
        if f > 1.0e-6:
            c[k] = c[k] * wp.clamp(blend[pixel][k] / f, 0.0, LARGEST_FACTOR)
    light_out[pixel] = c
