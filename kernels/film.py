# SPDX-License-Identifier: GPL-3.0-or-later
"""The film: sums of samples per pixel that stay exact past ten thousand of them, and pictures made from the sums."""

from __future__ import annotations

import warp as wp

from .geometry_math import is_finite3
from .paths import Options, Paths

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.struct
class Film:
    """Compensated sums, one entry a pixel of the rendered region."""

    color: wp.array[wp.vec4]
    """Sum of radiance and alpha"""
    color_rest: wp.array[wp.vec4]
    """What rounding has kept from `color` (Kahan 1965)"""
    squares: wp.array[float]
    """Sum of squared samples, mean of the three channels: tells their variance"""
    normal: wp.array[wp.vec4]
    """Sum of normals; w = number of samples with a surface"""
    position: wp.array[wp.vec4]
    """First sample: position, object index"""
    uv: wp.array[wp.vec4]
    """Sum of u, v, coverage; w = material index of the first sample"""
    depth: wp.array[float]
    """First sample: distance along the view axis"""
    emission: wp.array[wp.vec3]
    environment: wp.array[wp.vec3]
    samples: wp.array[int]
    """Samples that the pixel has: after a cancel some pixels have one more than others"""
    rejected: wp.array[float]
    """Of them, left out because they were not finite"""
    overruns: wp.array[float]
    """Rays that met too many transparent layers"""


@wp.func
def mean_square(c: wp.vec4) -> float:
    """Return the mean of the three channels' squares."""
    return (c[0] * c[0] + c[1] * c[1] + c[2] * c[2]) / 3.0


@wp.func
def film_samples(film: Film, pixel: int) -> float:
    """Return how many samples went into a pixel's sums."""
    return float(film.samples[pixel]) - film.rejected[pixel]


@wp.func
def film_mean(film: Film, pixel: int) -> wp.vec4:
    """Return a pixel's mean colour and alpha; 0 without samples."""
    return (film.color[pixel] - film.color_rest[pixel]) / wp.max(film_samples(film, pixel), 1.0)


@wp.kernel
def accumulate_samples(
    # In:
    paths: Paths,
    options: Options,
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    first_sample: int,
    # Out:
    film_out: Film,
):
    """Add the finished paths of each pixel to the film, in the order of the samples."""
    local = wp.tid()
    pixel = first_pixel + local
    color = film_out.color[pixel]
    rest = film_out.color_rest[pixel]
    squares = film_out.squares[pixel]
    rejected = float(0.0)
    overruns = float(0.0)
    for sample in range(sample_count):
        r = paths.radiance[sample * pixel_count + local]
        overruns += float(paths.overruns[sample * pixel_count + local])
        if is_finite3(wp.vec3(r[0], r[1], r[2])):
            value = wp.vec4(r[0] * options.exposure, r[1] * options.exposure, r[2] * options.exposure, r[3])
            y = value - rest
            total = color + y
            rest = (total - color) - y
            color = total
            squares += mean_square(value)
        else:
            rejected += 1.0
    film_out.color[pixel] = color
    film_out.color_rest[pixel] = rest
    film_out.squares[pixel] = squares
    film_out.samples[pixel] = film_out.samples[pixel] + sample_count
    film_out.rejected[pixel] = film_out.rejected[pixel] + rejected
    film_out.overruns[pixel] = film_out.overruns[pixel] + overruns
    if options.passes == 1:
        for sample in range(sample_count):
            path = sample * pixel_count + local
            n = paths.surface_normal[path]
            s = film_out.normal[pixel]
            film_out.normal[pixel] = s + wp.vec4(n[0], n[1], n[2], paths.surface_uv[path][2])
            t = paths.surface_uv[path]
            w = film_out.uv[pixel]
            film_out.uv[pixel] = wp.vec4(w[0] + t[0], w[1] + t[1], w[2] + t[2], w[3])
            film_out.emission[pixel] = film_out.emission[pixel] + paths.surface_emission[path] * options.exposure
            film_out.environment[pixel] = film_out.environment[pixel] + paths.environment[path] * options.exposure
        if first_sample == 0:
            film_out.position[pixel] = paths.surface_position[local]
            film_out.depth[pixel] = paths.surface_normal[local][3]
            w = film_out.uv[pixel]
            film_out.uv[pixel] = wp.vec4(w[0], w[1], w[2], paths.surface_uv[local][3])


@wp.kernel
def clear_surfaces(
    # Out:
    paths_out: Paths,
):
    """Forget the first hits of a batch that starts."""
    path = wp.tid()
    paths_out.surface_normal[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    paths_out.surface_position[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    paths_out.surface_uv[path] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    paths_out.surface_emission[path] = wp.vec3(0.0, 0.0, 0.0)
    paths_out.environment[path] = wp.vec3(0.0, 0.0, 0.0)


@wp.kernel
def resolve_color(
    # In:
    film: Film,
    transparent: int,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Divide the sums by the number of samples that went into them."""
    pixel = wp.tid()
    c = film_mean(film, pixel)
    alpha = wp.where(transparent == 1, wp.clamp(c[3], 0.0, 1.0), 1.0)
    picture_out[pixel] = wp.vec4(wp.max(c[0], 0.0), wp.max(c[1], 0.0), wp.max(c[2], 0.0), alpha)
