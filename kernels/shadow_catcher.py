# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow catchers: what the camera sees of them is how much darker all other things make them.

As Cycles has it (kernel/film/read.h, film_calculate_shadow_catcher): samples whose camera ray meets a catcher are
traced twice, among all things and among the catchers alone. The ratio of the sums is the shadow, which lies over what
is behind the scene; all other samples make the picture as always.
"""

from __future__ import annotations

import warp as wp

from .film import Film, film_mean, film_samples
from .geometry_math import is_finite3, mean_component
from .intersect import MISS
from .packing import rgb
from .paths import ENDED, Paths
from .types import SHADOW_CATCHER, Scene

wp.set_module_options({"enable_backward": False, "default_grid_stride": False})


@wp.struct
class Caught:
    """Of a batch's paths, what is known of those whose camera rays have met catchers."""

    caught: wp.array[int]
    """1: they have"""
    before: wp.array[wp.vec3]
    """Light that they had gathered when they came there"""
    weight: wp.array[wp.vec3]
    """What layers in front let through"""
    backdrop: wp.array[wp.vec3]
    """The world behind; zero where the film is transparent"""


@wp.struct
class CatcherFilm:
    """Sums over the samples that have met catchers, one entry a pixel."""

    lit: wp.array[wp.vec4]
    """Light with all things, and alpha"""
    alone: wp.array[wp.vec3]
    """Light with the catchers alone"""
    backdrop: wp.array[wp.vec3]


@wp.kernel
def note_caught(
    # In:
    scene: Scene,
    paths: Paths,
    bounces: wp.array[int],
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    caught_out: Caught,
):
    """Note which camera rays have met catchers, and what they brought along; `bounces`: surfaces met before."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if bounces[0] == 0:
            caught_out.caught[path] = 0
            instance = paths.hit[path][0]
            if paths.state[path] != ENDED and instance != MISS:
                if (scene.geometry.instances[instance].visibility & SHADOW_CATCHER) != 0:
                    caught_out.caught[path] = 1
                    caught_out.before[path] = rgb(paths.radiance[path])
                    caught_out.weight[path] = paths.throughput[path]


@wp.kernel
def miss_all(
    # In:
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """Let camera rays see nothing but the world."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        paths_out.hit[path] = wp.vec2i(MISS, MISS)


@wp.kernel
def keep_backdrop(
    # In:
    paths: Paths,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    caught_out: Caught,
):
    """Keep what they have seen of it."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        caught_out.backdrop[path] = rgb(paths.radiance[path])


@wp.kernel
def end_others(
    # In:
    caught: Caught,
    stride: int,
    count: wp.array[int],
    queue: wp.array[int],
    # Out:
    paths_out: Paths,
):
    """End the paths that have met no catcher before they begin."""
    i = wp.tid()
    while i < count[0]:
        path = queue[i]
        i = i + stride
        if caught.caught[path] == 0:
            paths_out.state[path] = ENDED


@wp.kernel
def add_caught(
    # In:
    paths: Paths,
    alone: Paths,
    caught: Caught,
    first_pixel: int,
    pixel_count: int,
    sample_count: int,
    # Out:
    film_out: CatcherFilm,
):
    """Add a batch's paths that have met catchers; what is not finite is left out as film.accumulate_samples does."""
    local = wp.tid()
    pixel = first_pixel + local
    lit = film_out.lit[pixel]
    bare = film_out.alone[pixel]
    backdrop = film_out.backdrop[pixel]
    for sample in range(sample_count):
        path = sample * pixel_count + local
        if caught.caught[path] == 1:
            r = paths.radiance[path]
            with_all = rgb(r)
            weight = caught.weight[path]
            with_none = wp.cw_mul(rgb(alone.radiance[path]), weight)
            if is_finite3(with_all) and is_finite3(with_none):
                light = with_all - caught.before[path]
                lit = lit + wp.vec4(light[0], light[1], light[2], r[3])
                bare = bare + with_none
                backdrop = backdrop + wp.cw_mul(caught.backdrop[path], weight)
    film_out.lit[pixel] = lit
    film_out.alone[pixel] = bare
    film_out.backdrop[pixel] = backdrop


@wp.func
def even_ratio(a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Return a / b by channel; channels without any b have the others' mean, 0 where none has."""
    r = wp.vec3(0.0, 0.0, 0.0)
    total = float(0.0)
    known = float(0.0)
    for c in range(3):
        if b[c] > 0.0:
            r[c] = a[c] / b[c]
            total = total + r[c]
            known = known + 1.0
    if known > 0.0 and known < 3.0:
        for c in range(3):
            if not b[c] > 0.0:
                r[c] = total / known
    return r


@wp.kernel
def resolve_caught(
    # In:
    film: Film,
    catchers: CatcherFilm,
    transparent: int,
    apart: int,
    exposure: float,
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Make the picture: other things over the shadow, which is alpha, or darkens the world behind.

    With `apart` 1 the shadow is a pass of its own: catchers are clear.
    """
    pixel = wp.tid()
    inverse = 1.0 / wp.max(film_samples(film, pixel), 1.0)
    seen = film_mean(film, pixel)
    lit = catchers.lit[pixel] * inverse
    matte = rgb(seen) - rgb(lit) * exposure
    # Light that other things add is left out: there is no negative alpha.
    left = float(1.0)
    if apart == 0:
        left = wp.min(mean_component(even_ratio(rgb(lit), catchers.alone[pixel] * inverse)), 1.0)
    alpha = wp.clamp(seen[3] - lit[3] * left, 0.0, 1.0)
    if transparent == 0 and apart == 0:
        matte = matte + catchers.backdrop[pixel] * (inverse * exposure * left)
        alpha = 1.0
    picture_out[pixel] = wp.vec4(wp.max(matte[0], 0.0), wp.max(matte[1], 0.0), wp.max(matte[2], 0.0), alpha)


@wp.kernel
def resolve_shadow(
    # In:
    film: Film,
    catchers: CatcherFilm,
    # Out:
    shadow_out: wp.array[wp.vec3],
):
    """Write by what the light of what lies behind is multiplied: the ratio of the sums, as far as anything is seen."""
    pixel = wp.tid()
    shadow = wp.vec3(1.0, 1.0, 1.0)
    if catchers.lit[pixel][3] > 0.0:
        ratio = even_ratio(rgb(catchers.lit[pixel]), catchers.alone[pixel])
        shadow = wp.lerp(shadow, ratio, wp.clamp(film_mean(film, pixel)[3], 0.0, 1.0))
    shadow_out[pixel] = shadow


@wp.kernel
def show_alpha(
    # In:
    picture: wp.array[wp.vec4],
    # Out:
    alpha_out: wp.array[wp.vec4],
):
    """Show alpha as grey, to be denoised."""
    pixel = wp.tid()
    alpha = picture[pixel][3]
    alpha_out[pixel] = wp.vec4(alpha, alpha, alpha, 1.0)


@wp.kernel
def take_alpha(
    # In:
    alpha: wp.array[wp.vec4],
    # Out:
    picture_out: wp.array[wp.vec4],
):
    """Take what has been denoised of it."""
    pixel = wp.tid()
    c = picture_out[pixel]
    picture_out[pixel] = wp.vec4(c[0], c[1], c[2], wp.clamp(mean_component(rgb(alpha[pixel])), 0.0, 1.0))
