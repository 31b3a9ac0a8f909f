# SPDX-License-Identifier: GPL-3.0-or-later
"""At rest: the filtered picture F and the mean P of path-traced samples, blended by their estimated errors.

F hardly varies but is biased by b, P is right on average but has the variance V of its mean: the mean square error of
F + w (P - F) is least at w = b^2 / (b^2 + V). V is known from the samples. b^2 is measured over 9x9 pixels in two ways,
each less two standard errors, so that F stays where P is still too noisy to say anything of its bias: the square of the
mean difference finds too much or too little light (noise of 81 pixels averages out), the mean square less V finds lost
detail. A small bias is always assumed, so w goes to 1 as the samples increase and the limit is exactly P. Errors are
relative to F's brightness, so that a lamp in the window does not decide for the wall around it.
"""

from __future__ import annotations

import warp as wp

from .film import Film, film_mean, film_samples, mean_square
from .geometry_math import is_finite3

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})

# Bias that F always has, relative: P takes over where its noise is less than this.
ASSUMED_BIAS = wp.constant(0.01)

# Exposed radiance (display white is 1) below which errors are no longer relative.
DARK = wp.constant(0.01)

# Relative variance taken for P where too few samples tell.
UNKNOWN = wp.constant(1.0)

# Samples from which P may tell of F's bias: what is rare has not been met with fewer, and P seems too dark.
TELLING_SAMPLES = wp.constant(8.0)

# Share of a pixel's own variance that holds against its neighbours' mean: fireflies stay out of the picture.
OWN_SHARE = wp.constant(0.25)

STANDARD_ERRORS = wp.constant(2.0)

# Relative errors above this are overflow; its square, summed over a window, is still finite.
LARGE = wp.constant(1.0e16)


@wp.func
def own_variance(film: Film, pixel: int, mean: wp.vec4) -> float:
    """Return the variance of a pixel's mean, from its own samples (two at least)."""
    n = film_samples(film, pixel)
    return wp.max(film.squares[pixel] / n - mean_square(mean), 0.0) / (n - 1.0)


@wp.func
def relative_variance(film: Film, picture: wp.array[wp.vec4], pixel: int) -> float:
    """Return the variance of P's mean relative to F squared; UNKNOWN with fewer than two samples."""
    v = float(UNKNOWN)
    if film_samples(film, pixel) >= 2.0:
        v = own_variance(film, pixel, film_mean(film, pixel)) / (mean_square(picture[pixel]) + DARK * DARK)
    # Squares may overflow.
    if not (v < LARGE):
        v = float(LARGE)
    return v


@wp.kernel
def measure_errors(
    first: int,
    # In:
    film: Film,
    picture: wp.array[wp.vec4],
    # Out:
    errors_out: wp.array[wp.vec4],
):
    """Write each pixel's noisy estimates, all relative: b, b^2 and b^4 (0 where they tell nothing), and V."""
    pixel = first + wp.tid()
    v = relative_variance(film, picture, pixel)
    errors = wp.vec4(0.0, 0.0, 0.0, v)
    if film_samples(film, pixel) >= TELLING_SAMPLES:
        f = picture[pixel]
        d = film_mean(film, pixel) - f
        scale = mean_square(f) + DARK * DARK
        bias = (d[0] + d[1] + d[2]) / (3.0 * wp.sqrt(scale))
        square = mean_square(d) / scale - v
        # Not so where the sums have overflowed, or are not numbers.
        if wp.abs(bias) < LARGE and wp.abs(square) < LARGE:
            errors = wp.vec4(bias, square, square * square, v)
    errors_out[pixel] = errors


@wp.kernel
def sum_rows(
    first: int,
    # In:
    errors: wp.array[wp.vec4],
    width: int,
    radius: int,
    # Out:
    sums_out: wp.array[wp.vec4],
):
    """Sum 2 radius + 1 pixels of a row; the edge pixel repeats."""
    pixel = first + wp.tid()
    x = pixel % width
    row = pixel - x
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for i in range(-radius, radius + 1):
        total += errors[row + wp.clamp(x + i, 0, width - 1)]
    sums_out[pixel] = total


@wp.func
def path_traced_share(sums: wp.vec4, pixels: float, own: float) -> float:
    """Return w from the sums over a window of pixels and the pixel's own relative variance."""
    mean = sums / pixels
    # Variance of the signed mean as the samples have it, and of the mean square as the pixels scatter.
    shift = wp.max(wp.abs(mean[0]) - STANDARD_ERRORS * wp.sqrt(mean[3] / pixels), 0.0)
    scatter = wp.sqrt(wp.max(mean[2] - mean[1] * mean[1], 0.0) / pixels)
    bias = wp.max(shift * shift, mean[1] - STANDARD_ERRORS * scatter) + ASSUMED_BIAS * ASSUMED_BIAS
    return bias / (bias + wp.max(mean[3], own * OWN_SHARE))


@wp.kernel
def blend(
    first: int,
    # In:
    sums: wp.array[wp.vec4],
    film: Film,
    picture: wp.array[wp.vec4],
    width: int,
    height: int,
    radius: int,
    transparent: int,
    # Out:
    picture_out: wp.array[wp.vec4],
    weight_out: wp.array[float],
):
    """Finish the window's sums and write F + w (P - F)."""
    pixel = first + wp.tid()
    x = pixel % width
    y = pixel // width
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for i in range(-radius, radius + 1):
        total += sums[wp.clamp(y + i, 0, height - 1) * width + x]
    side = float(2 * radius + 1)
    f = picture[pixel]
    p = film_mean(film, pixel)
    w = float(0.0)
    if film_samples(film, pixel) >= 1.0 and is_finite3(wp.vec3(p[0], p[1], p[2])):
        w = path_traced_share(total, side * side, relative_variance(film, picture, pixel))
    else:
        p = f
    alpha = wp.where(transparent == 1, wp.clamp(wp.lerp(f[3], p[3], w), 0.0, 1.0), 1.0)
    # Not f + w (p - f): with w = 1 the result is to be p to the last bit.
    picture_out[pixel] = wp.vec4(
        f[0] * (1.0 - w) + p[0] * w, f[1] * (1.0 - w) + p[1] * w, f[2] * (1.0 - w) + p[2] * w, alpha)
    weight_out[pixel] = w
